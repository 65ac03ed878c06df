"""Examples as a user runs them."""

from __future__ import annotations

import importlib
import io
import json
import runpy
import sys
from contextlib import redirect_stdout
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
import pytest

from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.nodes.launching import graph
from facts_damping.recording.reader import load
from facts_damping.simulation import loop
from facts_damping_gym import NAME
from facts_damping_studies.margins.delay_margin import margin
from facts_damping_studies.margins.delay_margin_runs import pulse_margin
from facts_damping_testing.loopback.opening import opened
from tests.appendix_b import bilinear
from tests.lead_lag_fmu import build
from tests.nodes.graphs import LOADED_S, assert_same, quiet

if TYPE_CHECKING:
    from types import ModuleType

    from numpy.typing import NDArray

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "own_controllers.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def damper(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the robust design leaves."""
    folder = tmp_path_factory.mktemp("robust")
    plant, law = folder / "plant.npz", folder / "damper.npz"
    assert main(["modes", "two_area", "--devices", "sssc", "--linear", str(plant)]) == 0
    assert run_example("robust_damper.py", str(plant), str(law)).startswith("gamma 1.92, a controller of 6 states")
    return law


def run_example(name: str, *arguments: str) -> str:
    """What an example says, called as a program."""
    said = io.StringIO()
    with pytest.MonkeyPatch.context() as patched, redirect_stdout(said):
        patched.setattr(sys, "argv", [name, *arguments])
        patched.syspath_prepend(str(ROOT / "examples"))
        runpy.run_path(str(ROOT / "examples" / name), run_name="__main__")
    return said.getvalue()


def controller(law: Path) -> str:
    return "controllers.0=" + json.dumps({"name": "robust", "linear": str(law)})


def test_robust_designs_margin_is_the_pages_linear_and_in_time(damper: Path) -> None:
    case = load_case("two_area_small", [controller(damper)])
    loop_margin = margin(case, 0.5, 6, lambda _done, _of: None)
    assert loop_margin.margin == pytest.approx(0.3486, abs=2e-4)
    assert loop_margin.margin is not None
    assert pulse_margin(case, loop_margin.margin) == pytest.approx(loop_margin.margin, abs=5e-4)
    assert PAGE.count(f"{1000 * loop_margin.margin:.1f} ms") == 2


@pytest.mark.parametrize(("link", "scenario"), [("delay_100ms", "large"), ("plc", "small"), ("plc", "large")])
def test_robust_damper_damps_behind_delay(damper: Path, tmp_path: Path, link: str, scenario: str) -> None:
    target = tmp_path / "told.json"
    sets = [f"link={link}", "seed=1", "duration=30", controller(damper)]
    asked = [part for text in sets for part in ("--set", text)]
    assert main(["simulate", f"two_area_{scenario}", *asked, "--json", str(target)]) == 0
    document = json.loads(target.read_text())
    assert document["verdict"] == "damped"
    assert f"{document['indices']['ITAE']:.3g}" in PAGE


# Five ways to bring a controller: the same lead-lag on two_area_large over pdci, beside the shipped one.
FRAMES_50 = ["link=pdci", "duration=5", "frame_rate=50"]  # whose period is a whole number of ns


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(build(tmp_path_factory.mktemp("fmu"), ROOT / "examples", 2))


def setpoints(*sets: str, **controller: Any) -> NDArray[Any]:
    rows = [f"controllers.0={json.dumps(controller)}"] if controller else []
    return loop.run(load_case("two_area_large", [*sets, *rows])).issued


@pytest.mark.parametrize("sets", [["link=pdci", "duration=20"], FRAMES_50], ids=["60 frames/s", "50 frames/s"])
def test_class_and_fmu_are_the_shipped_lead_lag_bit_for_bit(fmu: str, sets: list[str]) -> None:
    shipped = setpoints(*sets)
    for law in ({"policy": f"{ROOT / 'examples' / 'lead_lag.py'}:LeadLag"}, {"fmu": fmu}):
        assert setpoints(*sets, name="mine", **law).tobytes() == shipped.tobytes()


def test_matrices_are_it_within_rounding_where_all_frames_are_as_long() -> None:
    """At 60 frames/s they are not: stamps are whole ns, and the lead-lag goes by them."""
    shipped = setpoints(*FRAMES_50)
    law = setpoints(*FRAMES_50, name="mine", linear=bilinear(50))
    assert np.abs(law["value"] - shipped["value"]).max() < 1e-12
    assert np.abs(setpoints("link=pdci", "duration=5", name="mine", linear=bilinear())["value"]).max() > 0.01
    differs = setpoints("link=pdci", "duration=5")["value"]
    assert np.abs(setpoints("link=pdci", "duration=5", name="mine", linear=bilinear())["value"] - differs).max() < 1e-9


def test_environment_is_it_bit_for_bit() -> None:
    """Where there is one arrival a tick: an agent answers once."""
    env: Any = gymnasium.make(NAME, link="delay_100ms", duration=5, scale=1.0).unwrapped
    law = example("lead_lag").LeadLag(SimpleNamespace(parameters={}))
    env.reset(seed=0)
    record, over = None, False
    limit = load_case("two_area_large", []).system.device("sssc").setpoint_max
    while not over:
        held = env.episode.eyes.held
        y, measured = held.signal[0], held.newest_ns[0]
        u = law.step(measured * 1e-9, y, [0.0], [True]) if measured >= 0 else 0.0
        _, _, _, over, _ = env.step(np.array([u / limit]))
        record = env.record()
    shipped = setpoints("link=delay_100ms", "duration=5")
    assert record is not None
    assert np.abs(record.issued["value"] - shipped["value"][: len(record.issued)]).max() < 1e-12


def example(name: str) -> ModuleType:
    """An example as a module, which finds those beside it."""
    sys.path.insert(0, str(ROOT / "examples"))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(str(ROOT / "examples"))


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What three generations of the training leave: less than the page's forty."""
    target = tmp_path_factory.mktemp("trained") / "damper.npz"
    said = run_example("train_damper.py", str(target), "3").splitlines()
    means = [float(line.rpartition(" ")[2]) for line in said if line.startswith("generation")]
    assert len(means) == 3
    assert means[-1] > 0.2 * means[0]  # rewards are negative: less of it
    return target


def test_trained_damper_gives_the_same_bits_in_process_and_as_a_node(
    trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    sets = ["duration=5", f"controllers.0.parameters.weights={trained}"]
    case = load_case("examples/trained_damper.yaml", sets)
    computed = loop.run(case)
    assert np.abs(computed.issued["value"]).max() > 0.0
    with opened():
        outcome = graph.run(case, "lockstep", tmp_path, quiet, LOADED_S)
    assert_same(load(outcome.recording), computed)


def test_trained_damper_gives_the_same_bits_in_the_environment_and_a_run(trained: Path) -> None:
    module = example("trained_damper")
    with np.load(trained) as file:
        weights = file["weights"]
    env: Any = gymnasium.make(NAME, link="pdci", duration=5, window=module.WINDOW).unwrapped
    seen, info = env.reset(seed=3)
    over = False
    while not over:
        seen, _, _, over, _ = env.step(module.action(weights, seen))
    policy = f"{ROOT / 'examples' / 'trained_damper.py'}:TrainedDamper"
    parameters = {"weights": str(trained)}
    theirs = setpoints(
        "link=pdci", "duration=5", f"seed={info['seed']}", name="x", policy=policy, parameters=parameters
    )
    ours = env.record().issued
    assert len(ours) > 200
    assert theirs[: len(ours)].tobytes() == ours.tobytes()


def test_run_files_of_examples_are_runs() -> None:
    names = sorted(path.name for path in (ROOT / "examples").glob("*.yaml"))
    assert names == ["lead_lag.yaml", "lead_lag_node.yaml", "trained_damper.yaml"]
    for name in names:
        assert load_case(str(ROOT / "examples" / name)).run.link == "pdci"


def test_policies_of_the_baseline_meet_the_same_episodes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
    baseline = runpy.run_path(str(ROOT / "examples" / "gym_baselines.py"))["baseline"]
    rows = baseline("two_area", tmp_path, generations=1, episodes=4)
    total = {name: returns for name, (returns, synchronous) in rows.items() if synchronous.all()}
    assert len(total) == 3
    assert (total["tuned lead-lag"] > total["no control"]).all()
