"""The page of the cockpit: it is installed as a whole, and needs nothing from elsewhere."""

from __future__ import annotations

import re
import runpy
from pathlib import Path
from typing import Any

import pytest
import setuptools

from tests.passed import inputs

pytestmark = inputs(contents=["setup.py", "extensions/*/cockpit/static/**/*"], names=["extensions/**/*.py"])

ROOT = Path(__file__).parents[3]
STATIC = ROOT / "extensions" / "facts_damping_views" / "cockpit" / "static"
FILES = [path for path in sorted(STATIC.rglob("*")) if path.is_file()]
NAMESPACE = "http://www.w3.org/2000/svg"
COMMENT = re.compile(r"/\*.*?\*/|(?<!:)//[^\n]*", re.DOTALL)
LINK = re.compile(r"""(?:\b(?:src|href)=|\b(?:from|import)\s*\(?\s*|url\()["']([^"'#]+)["']""")


def code(path: Path) -> str:
    text = path.read_text()
    return text if path.suffix == ".html" else COMMENT.sub("", text)


def test_cockpit_page_is_installed_with_all_its_files(monkeypatch: pytest.MonkeyPatch) -> None:
    keywords: dict[str, Any] = {}
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(setuptools, "setup", keywords.update)
    runpy.run_path("setup.py")
    assert "facts_damping_views.cockpit" in keywords["packages"]
    patterns = keywords["package_data"]["facts_damping_views.cockpit"]
    installed = {path for pattern in patterns for path in STATIC.parent.glob(pattern) if path.is_file()}
    assert sorted(installed) == FILES


@pytest.mark.parametrize("path", [path for path in FILES if path.name != "LICENSE"], ids=lambda path: path.name)
def test_page_refers_to_nothing_outside(path: Path) -> None:
    text = code(path).replace(NAMESPACE, "")
    assert not re.search(r"(?:https?|wss?)?://", text)
    folder = STATIC.parent if path.suffix == ".html" else path.parent  # "static/..." is below the page's address
    missing = [name for name in LINK.findall(text) if name != "data:," and not (folder / name).is_file()]
    assert missing == []


def test_chart_library_has_its_licence() -> None:
    assert "MIT" in (STATIC / "uplot" / "uPlot.esm.js").read_text()[:200]
    assert "Leon Sorokin" in (STATIC / "uplot" / "LICENSE").read_text()
