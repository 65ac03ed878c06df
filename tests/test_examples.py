"""Examples as a user runs them."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.studies.linear_margin import margin
from facts_damping.studies.linear_margin_runs import pulse_margin

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "robust_design.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def damper(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the robust design leaves."""
    folder = tmp_path_factory.mktemp("robust")
    plant, law = folder / "plant.npz", folder / "damper.npz"
    assert main(["modes", "two_area", "--devices", "sssc", "--linear", str(plant)]) == 0
    script = ROOT / "examples" / "robust_damper.py"
    done = subprocess.run([sys.executable, script, plant, law], capture_output=True, text=True, check=True, cwd=folder)
    assert done.stdout.startswith("gamma 1.92, a controller of 6 states")
    return law


def controller(law: Path) -> str:
    return "controllers.0=" + json.dumps({"name": "robust", "linear": str(law)})


def test_the_robust_designs_margin_is_the_pages_linear_and_in_time(damper: Path) -> None:
    case = load_case("two_area_small", [controller(damper)])
    found = margin(case, 0.5, 6, lambda _done, _of: None)
    assert found.margin == pytest.approx(0.3486, abs=2e-4)
    assert found.margin is not None
    assert pulse_margin(case, found.margin) == pytest.approx(found.margin, abs=5e-4)
    assert f"is {1000 * found.margin:.1f} ms, linear" in PAGE


@pytest.mark.parametrize(("link", "scenario"), [("delay_100ms", "large"), ("plc", "small"), ("plc", "large")])
def test_it_is_damped_behind_delay(damper: Path, tmp_path: Path, link: str, scenario: str) -> None:
    target = tmp_path / "told.json"
    sets = [f"link={link}", "seed=1", "duration=30", controller(damper)]
    asked = [part for text in sets for part in ("--set", text)]
    assert main(["simulate", f"two_area_{scenario}", *asked, "--json", str(target)]) == 0
    told = json.loads(target.read_text())
    assert told["verdict"] == "damped"
    assert f"{told['indices']['ITAE']:.3g}" in PAGE
