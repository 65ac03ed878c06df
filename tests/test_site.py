"""The documentation as a site: it builds without a warning, and what its pages name exists."""

from __future__ import annotations

import re
import runpy
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import yaml

import facts_damping
from facts_damping.analysis.summary_table import ROWS
from facts_damping.cli.parser import parser
from tests.passed import inputs

pytestmark = inputs(
    contents=["*.md", "*.cff", "mkdocs.yml", "pyproject.toml", "setup.py"]
    + [
        f"{folder}/**/*"
        for folder in ("docs", "facts_damping", "extensions", "examples", "config", "msg_defs", "launch")
    ],
    names=["tests/**/*.py"],
)

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "SECURITY.md", *sorted((ROOT / "docs").glob("*.md"))]
GENERATED = runpy.run_path(str(ROOT / "docs" / "generated.py"))
# Options of other programs that pages name.
OTHERS = {"--ros-args", "--log-level", "--help", "--version"}


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    return folder


def test_links_of_pages_lead_to_files_in_the_checkout() -> None:
    """As GitHub and an editor follow them; the site checks its own, and the places in pages."""
    links = [
        (page, target)
        for page in [*PAGES, ROOT / "CHANGELOG.md", *(ROOT / "extensions").glob("*/README.md")]
        for target in re.findall(r"\]\(([^)\s#]+)[^)]*\)", _without_code(page.read_text(encoding="utf-8")))
        if "://" not in target and not target.startswith("mailto:")
    ]
    assert len(links) > 400
    assert [(page.name, target) for page, target in links if not (page.parent / target).exists()] == []


def _without_code(text: str) -> str:
    text = re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
    return re.sub(r"`[^`\n]*`", "", re.sub(r"^    .*$", "", text, flags=re.MULTILINE))


def test_site_builds_strictly_with_search_and_all_pages(site: Path) -> None:
    assert (site / "search" / "search_index.json").stat().st_size > 100_000
    for page in PAGES[3:]:
        assert (site / page.stem / "index.html").is_file(), page.stem


def test_notebooks_are_executed_and_nothing_in_them_failed(site: Path) -> None:
    notebooks = sorted((ROOT / "docs" / "notebooks").glob("*.py"))
    assert notebooks
    for script in notebooks:
        text = (site / "notebooks" / script.stem / "index.html").read_text(encoding="utf-8")
        assert "Traceback" not in text
        assert "jp-OutputArea-output" in text


GENERATED_PAGES = ("commands", "fields")
WORDS, WORDS_OF_A_PAGE, NUMBER = 55_000, 1200, 46


def words(page: Path) -> int:
    """Words of a page as a reader counts them: without code, addresses and lines of tables."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"\]\([^)]*\)", "]", re.sub(r"^    .*$", "", text, flags=re.MULTILINE))
    return sum(1 for word in text.split() if re.search("[A-Za-z]", word))


def test_documentation_stays_short() -> None:
    pages = {page.stem: words(page) for page in (ROOT / "docs").glob("*.md")}
    assert len(pages) <= NUMBER
    assert sum(pages.values()) <= WORDS, sum(pages.values())
    longer = {name: many for name, many in pages.items() if many > WORDS_OF_A_PAGE and name not in GENERATED_PAGES}
    assert not longer


def test_addresses_of_earlier_versions_lead_to_a_page(site: Path) -> None:
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    moved = dict(re.findall(r"^        ([\w/]+)\.md: (\w+)\.md$", text, re.MULTILINE))
    assert len(moved) > 70
    for old, new in moved.items():
        page = (site / old / "index.html").read_text(encoding="utf-8")
        assert f"../{new}/" in page if new != "index" else "url=.." in page, old


def test_page_loads_nothing_from_other_hosts(site: Path) -> None:
    text = (site / "index.html").read_text(encoding="utf-8")
    assert not re.search(r'<(script|link|img)[^>]+(src|href)="https?://(?!.*rel="canonical")', text)


@cache
def verbs() -> dict[str, set[str]]:
    """All commands, and the options of each."""
    (commands,) = (action.choices for action in parser()._actions if isinstance(action.choices, dict))
    return {name: set(command.options()) for name, command in commands.items()}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_commands_and_options_that_a_page_names_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for verb in re.findall(r"facts-damping ([a-z]+)\b(?!-)", re.sub(r"facts-damping:.*", "", text)):
        assert verb in verbs(), verb
    for line in re.findall(r"^    \$? ?facts-damping .*$", text, re.MULTILINE):
        for option in re.findall(r"(?<=\s)--[a-z-]+", line):
            assert option in OTHERS.union(*verbs().values()), line


@cache
def fields() -> set[str]:
    """All names of fields of files."""
    return {"extends", "description", *re.findall(r"^\| `([\w-]+)`", GENERATED["fields"](), re.MULTILINE)}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_yaml_of_a_page_has_fields_that_exist(page: Path) -> None:
    known = fields()
    for block in re.findall(r"^```yaml\n(.*?)^```$", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE):
        content: Any = yaml.safe_load(block)
        if isinstance(content, dict) and "/**" not in content:
            assert set(content) <= known, set(content) - known


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_picture_has_a_caption(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for picture, after in re.findall(r"^!\[[^\]]+\]\(([^)]+)\)\n+(.)", text, re.MULTILINE):
        assert after in "*_", picture


def test_pages_that_follow_from_the_code_are_what_it_says() -> None:
    """`python docs/generated.py` writes them."""
    for name, text in GENERATED["pages"]().items():
        assert (ROOT / "docs" / name).read_text(encoding="utf-8").split() == text.split(), name


def test_versions_are_one() -> None:
    version = facts_damping.__version__
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(rf"^## \[{version}\]", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_tables_of_runs_have_the_rows_that_are_printed(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    labels = {row.label.strip() for row in ROWS} | {"..."}
    for table in re.findall(r"^    \$ facts-damping simulate (?:.*\\\n)*.*\n((?:    .*\n)+)", text, re.MULTILINE):
        rows = [row.strip() for row in table.splitlines()]
        shown = {re.split(r"  +", row)[0] for row in rows if not row.startswith(("plot:", "facts-damping:"))}
        assert shown <= labels


def test_tutorials_class_is_the_templates() -> None:
    text = (ROOT / "docs" / "tutorial_controller.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    template = (ROOT / "facts_damping" / "templates" / "controller" / "controller.py.txt").read_text(encoding="utf-8")
    lines = [line for line in block.splitlines()[2:] if line.strip()]
    assert len(lines) == 6
    assert all(line in template for line in lines)
