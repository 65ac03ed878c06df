"""Controllers that are classes of a user's own: what they are given, what becomes of it, how they fail."""

from __future__ import annotations

import json
import sys
from io import StringIO
from pathlib import Path
from textwrap import dedent
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.errors import InputError, RunError
from facts_damping.simulation import loop
from facts_damping.simulation.programs.policies import step_times
from facts_damping.simulation.programs.user_code import find
from tests.commands import assert_one_line, changes

if TYPE_CHECKING:
    from facts_damping.record import Record

ROOT = Path(__file__).parents[2]
LEAD_LAG = f"{ROOT / 'examples' / 'lead_lag.py'}:LeadLag"


def with_policy(policy: str, *sets: str, **fields: Any) -> list[str]:
    """`--set` of a run with a class of its own, on two_area_large."""
    return [*sets, "controllers=" + json.dumps([{"name": "mine", "policy": policy, **fields}])]


def run(policy: str, *sets: str, **fields: Any) -> Record:
    return loop.run(load_case("two_area_large", with_policy(policy, "duration=5", *sets, **fields)))


def written(folder: Path, text: str, name: str = "mine.py") -> str:
    """A file with a class `Mine`; its name as the field `policy` has it."""
    (folder / name).write_text(dedent(text))
    return f"{folder / name}:Mine"


@pytest.mark.parametrize(("link", "frame_rate"), [("ideal", 60), ("pdci", 50), ("plc", 60), ("lossy_bursts", 50)])
def test_lead_lag_as_a_class_is_the_shipped_one_bit_for_bit(link: str, frame_rate: int) -> None:
    sets = [f"link={link}" if link != "lossy_bursts" else LOSSY, f"frame_rate={frame_rate}"]
    shipped = loop.run(load_case("two_area_large", ["duration=5", *sets]))
    by_policy = run(LEAD_LAG, *sets)
    assert len(shipped.issued) > 0
    assert by_policy.issued.tobytes() == shipped.issued.tobytes()
    assert by_policy.machines.tobytes() == shipped.machines.tobytes()
    assert by_policy.controller_names == ["controller_0_mine"]


LOSSY = "link={up: [{model: bernoulli, loss: 0.3}, {model: uniform, low: 0.0, high: 0.15}]}"
NOTES = """
    import numpy as np

    class Mine:
        heard = []

        def __init__(self, spec):
            self.spec = spec
            type(self).made = spec

        def step(self, t_s, y, age_s, fresh):
            self.heard.append((t_s, y, age_s, fresh))
            y[:] = np.nan  # its own: nobody else sees that
            return np.zeros(len(self.spec.devices))
"""


def test_policy_is_given_the_delivered_signals_when_they_arrive(tmp_path: Path) -> None:
    policy = written(tmp_path, NOTES)
    record = run(policy, LOSSY, "seed=4", signals=["speed", "power"])
    steps = find(policy, "policy").heard
    assert len(steps) == len(record.issued) > 100
    signals = load_case("two_area_large", []).system.signals
    places = [[record.pmus.index(name) for name in signals[signal].weights] for signal in ("speed", "power")]
    rows, taken_ns = record.delivered, np.full((2, len(record.pmus)), -1)
    newest = np.full(len(record.pmus), -1)
    at = 0
    for (t_s, y, age_s, fresh), issued in zip(steps, record.issued, strict=True):
        assert round(t_s * 1e9) == issued["issued_ns"]
        while at < len(rows) and rows[at]["arrival_ns"] <= issued["issued_ns"]:
            newest[rows[at]["pmu"]] = max(newest[rows[at]["pmu"]], rows[at]["measured_ns"])
            at += 1
        for i, mine in enumerate(places):
            assert age_s[i] == pytest.approx((issued["issued_ns"] - newest[mine].max()) * 1e-9, abs=1e-15)
            assert fresh[i] == bool((newest[mine] != taken_ns[i, mine]).any())
            taken_ns[i, mine] = newest[mine]
        assert np.isnan(y).all()  # as it has written itself
    assert {tuple(fresh) for _, _, _, fresh in steps} > {(True, True)}


def test_once_a_tick_it_is_called_at_the_last_arrival_with_all_that_is_new(tmp_path: Path) -> None:
    always = run(written(tmp_path, NOTES), LOSSY, "seed=4", signals=["speed", "power"])
    once = written(tmp_path, NOTES.replace("heard = []", "heard, once_a_tick = [], True"), "once.py")
    seldom = run(once, LOSSY, "seed=4", signals=["speed", "power"])
    last = {int(row["tick"]): row for row in always.issued}
    assert len(seldom.issued) == len(last) < len(always.issued)
    for row, (t_s, _, _, fresh) in zip(seldom.issued, find(once, "policy").heard, strict=True):
        assert row["issued_ns"] == round(t_s * 1e9) == last[int(row["tick"])]["issued_ns"]
        assert row["measured_ns"] == last[int(row["tick"])]["measured_ns"]
        assert fresh.any()


def test_policy_is_given_its_signals_devices_limits_and_plant(tmp_path: Path) -> None:
    policy = written(tmp_path, NOTES)
    run(policy, "seed=4", "devices=[sssc, statcom]", signals=["w13"], parameters={"gain": 3, "taps": [1, 2], "a": "b"})
    spec, case = find(policy, "policy").made, load_case("two_area_large", [])
    assert (spec.name, spec.signals, spec.devices, spec.frame_rate) == ("mine", ["w13"], ["sssc"], 60)
    assert spec.parameters == {"gain": 3.0, "taps": [1.0, 2.0], "a": "b"}
    assert (spec.limits, spec.rates) == (case.system.device("sssc").setpoint_max, case.system.device("sssc").rate_max)
    plant = spec.plant
    assert plant.devices == ["sssc", "statcom"]
    assert plant.A.shape[0] == len(plant.states)
    assert "w13" in plant.signals


def test_its_seed_is_of_the_run_and_its_place(tmp_path: Path) -> None:
    policy = written(tmp_path, NOTES)
    seeds = []
    for seed in (1, 1, 2):
        rows = [{"name": n, "policy": policy, "devices": [n]} for n in ("sssc", "statcom")]
        sets = ["devices=[sssc, statcom]", f"seed={seed}", "duration=0.1", "controllers=" + json.dumps(rows)]
        built = loop.build_loop(load_case("two_area_large", sets))
        seeds.append([program._step.__self__.spec.seed for program in built.programs])
    assert seeds[0] == seeds[1]
    assert len({*seeds[0], *seeds[2]}) == 4


def test_setpoints_are_limited_like_others(tmp_path: Path) -> None:
    policy = written(tmp_path, "class Mine:\n    def __init__(self, spec): pass\n    def step(self, *a): return 7.0\n")
    record = run(policy)
    assert set(record.issued["value"]) == {load_case("two_area_large", []).system.device("sssc").setpoint_max}


def test_file_is_read_again_when_it_is_written_anew(tmp_path: Path) -> None:
    text = "class Mine:\n    def __init__(self, spec): pass\n    def step(self, *a): return {}\n"
    for value in (0.001, 0.002, 0.0025):
        assert set(run(written(tmp_path, text.format(value)), "duration=0.2").issued["value"]) == {value}


def test_policy_may_import_modules_beside_it_and_in_the_working_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "beside_it.py").write_text("VALUE = 0.002\n")
    text = "from beside_it import VALUE\nclass Mine:\n    def __init__(self, s): pass\n    step = lambda *a: VALUE\n"
    written(tmp_path, text, "importing.py")
    assert set(run(f"{tmp_path / 'importing.py'}:Mine", "duration=0.2").issued["value"]) == {0.002}
    monkeypatch.chdir(tmp_path)
    assert set(run("importing:Mine", "duration=0.2").issued["value"]) == {0.002}


MINE = "class Mine:\n    def __init__(self, spec): {}\n    def step(self, t_s, y, age_s, fresh): {}\n"


@pytest.mark.parametrize(
    ("policy", "said"),
    [
        ("nowhere.py:Mine", "controllers.0.policy: nowhere.py: no such file; allowed: a file in Python"),
        ("nowhere:Mine", "ModuleNotFoundError: No module named 'nowhere', as nowhere was loaded"),
        ("json:Mine", "controllers.0.policy: no class 'Mine' in json; allowed: one with a step"),
        ("Mine", "'Mine' given; allowed: module:Class, path/to/file.py:Class"),
        ("builtins:list", "controllers.0.policy: TypeError: 'Spec' object is not iterable, as list was made"),
        (1, "policy"),
    ],
)
def test_classes_that_are_not_there_are_one_line(policy: Any, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    refused(2, with_policy(policy), said, capsys)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("class Mine:\n    pass\n", "policy: TypeError: Mine() takes no arguments, as Mine was made"),
        ("class Mine:\n    def __init__(self, spec): pass\n", "Mine has no step; allowed: a class with step(self, t_s"),
        (
            "class Mine:\n    def __init__(self, spec): pass\n    def step(self, y): pass\n",
            "Mine: step(self, y) given; allowed: step(self, t_s, y, age_s, fresh)",
        ),
        ("import nothing_like_it\n", "mine.py:1: ModuleNotFoundError: No module named 'nothing_like_it'"),
        ("class Mine:\n  def\n", "mine.py:2: SyntaxError"),
        (MINE.format("spec.parameters['gain']", "pass"), "mine.py:2: KeyError: 'gain', as Mine was made"),
        ("class Other:\n    def step(self): pass\n", "no class 'Mine' in" ),
        ("raise SystemExit(5)\n", "mine.py:1: SystemExit: 5, as"),
        ("open('nowhere.npz')\n", "mine.py:1: FileNotFoundError: [Errno 2] No such file or directory: 'nowhere"),
    ],
)  # fmt: skip
def test_classes_that_do_not_fit_are_one_line(
    tmp_path: Path, text: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    refused(2, with_policy(written(tmp_path, text)), said, capsys)


@pytest.mark.parametrize(
    ("step", "said"),
    [
        ("return 1 / (t_s < 1.0)", "controllers.0.policy: mine.py:3: ZeroDivisionError: division by zero, in step of"),
        ("return float('nan') if t_s > 1 else 0", "ValueError: [nan] p.u. given, no number for sssc; allowed: finite"),
        ("return [0.0, 0.0]", "ValueError: u of shape (2,) given; allowed: (1,), one a device, in step of mine at 0 s"),
        ("return 'zero'", "ValueError: could not convert string to float: 'zero', in step of mine"),
        ("return None", "ValueError: None returned; allowed: u of shape (1,), one a device, in step of mine at 0 s"),
        ("raise SystemExit", "mine.py:3: SystemExit, in step of mine at 0 s"),
    ],
)
def test_steps_that_fail_end_the_run_by_name(
    tmp_path: Path, step: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    refused(1, with_policy(written(tmp_path, MINE.format("pass", step))), said, capsys)


def refused(status: int, sets: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert_one_line(status, ["simulate", "two_area_large", *changes(["duration=3", *sets])], said, capsys)


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"name": "LLC"}, "controllers.0.name: 'LLC' given with `policy`; allowed: a name that is not taken"),
        ({"linear": {"D": [[1]]}}, "'mine' given with `linear` and `policy`; allowed: one of linear, policy"),
        ({"scheme": "direct"}, "controllers.0.scheme: 'direct' given; allowed: none for mine"),
        ({"compensation": "lead"}, "controllers.0.compensation: 'lead' given; allowed: none for mine"),
        ({"signals": ["nothing"]}, "controllers.0.signals: 'nothing' given"),
        ({"devices": ["statcom"]}, "controllers.0.devices: 'statcom' given"),
    ],
)
def test_options_that_do_not_fit_a_policy_are_refused_in_one_line(
    fields: dict[str, Any], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    sets = ["controllers=" + json.dumps([{"name": "mine", "policy": LEAD_LAG, **fields}])]
    refused(2, sets, said, capsys)


def test_interruption_in_a_step_interrupts_the_run(tmp_path: Path) -> None:
    policy = written(tmp_path, MINE.format("pass", "raise KeyboardInterrupt('enough')"))
    with pytest.raises(KeyboardInterrupt, match="enough"):
        run(policy)


def test_policy_failure_is_raised_at_once_in_a_loop_stepped_by_hand(tmp_path: Path) -> None:
    policy = written(tmp_path, MINE.format("pass", "return 0 if t_s < 0.5 else 1 / 0"))
    built = loop.build_loop(load_case("two_area_large", with_policy(policy, "duration=2")))
    for tick in range(30):
        assert loop.step(built, tick)
    with pytest.raises(RunError, match="ZeroDivisionError") as failure:
        loop.step(built, 30)
    assert isinstance(failure.value.__cause__, ZeroDivisionError)


def test_step_times_of_a_policy_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = "import time\n" + MINE.format("pass", "time.sleep(0.002 if t_s < 1.5 else 0.0); return 0")
    policy, target = written(tmp_path, text), tmp_path / "told.json"
    asked = changes(with_policy(policy, "duration=2"))
    assert main(["simulate", *asked, "--json", str(target)]) == 0
    times = json.loads(target.read_text())["step_times"]["controller_0_mine"]
    assert times["steps"] == 120
    assert 0.0015 < times["mean_s"] < times["p99_s"] <= times["max_s"]
    assert "controller_0_mine: 120 steps of " in capsys.readouterr().out
    assert step_times([]) == {}


STUDY = """
run: two_area_large
set: {{duration: 8, link: pdci}}
sweep:
  - name: law
    labels: [LLC, mine]
    rows:
      - {{controllers.0.name: LLC}}
      - {{controllers.0.name: mine, controllers.0.policy: "{policy}"}}
margin:
  name: added_s
  fields: {{link.down.1.delay: 1}}
  low: 0
  high: 0.9
  coarse: 3
  tolerance: 0.05
  criteria: [unstable]
modes: false
"""


def test_sweep_takes_the_delay_margin_of_a_class_beside_others(tmp_path: Path) -> None:
    (tmp_path / "copy.py").write_text((ROOT / "examples" / "lead_lag.py").read_text())
    study, out = tmp_path / "study.yaml", tmp_path / "out"
    study.write_text(STUDY.format(policy=f"{tmp_path / 'copy.py'}:LeadLag"))
    sweep = ["sweep", str(study), "--out", str(out), "--jobs", "1"]
    assert main([*sweep, "--json", str(tmp_path / "told.json")]) == 0
    rows = json.loads((tmp_path / "told.json").read_text())["margins"]
    assert [row["controller"] for row in rows] == ["LLC", "mine"]
    assert [rows[0][end] for end in ("low_s", "high_s")] == [rows[1][end] for end in ("low_s", "high_s")]
    assert 0.3 < rows[0]["low_s"] < rows[0]["high_s"] < 0.5
    # What the class says belongs to what the rows depend on.
    (tmp_path / "copy.py").write_text((tmp_path / "copy.py").read_text() + "\n# another one\n")
    assert main(sweep) == 2


def test_study_of_a_class_that_is_not_there_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study = tmp_path / "study.yaml"
    study.write_text(STUDY.format(policy="nowhere.py:Mine"))
    assert_one_line(2, ["sweep", str(study), "--out", str(tmp_path / "out")], "nowhere.py: no such file", capsys)
    assert not (tmp_path / "out").exists()


def test_linear_margins_refuse_it(capsys: pytest.CaptureFixture[str]) -> None:
    asked = changes(with_policy(LEAD_LAG))
    assert_one_line(
        2, ["margin", "two_area_small", *asked], "'mine' given, which is not linear and has no linear margin", capsys
    )


def test_errors_are_input_errors_for_scripts(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        run(f"{tmp_path / 'nowhere.py'}:Mine")


CLOSES = """
    import sys

    class Silent:
        def write(self, text): raise RuntimeError("no writing")
        def flush(self): raise RuntimeError("no writing")

    class Mine:
        def __init__(self, spec): {act}
        def step(self, t_s, y, age_s, fresh): return 0.0
"""


@pytest.mark.parametrize(
    ("act", "status", "said"),
    [
        ("sys.stdout.close()", 2, "standard output: cannot be written: closed, or replaced by code of the user (I/O"),
        ("sys.stdout = Silent()", 2, "replaced by code of the user (no writing); allowed: a place with room for it"),
        ("sys.stdout = None", 2, "replaced by code of the user"),
        ("sys.stdout = Silent(); sys.stderr = None", 2, ""),
        ("sys.stderr.close()", 0, ""),
        ("sys.stderr = Silent()", 0, ""),
    ],
)
def test_class_that_closes_the_streams_ends_a_command_in_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, act: str, status: int, said: str
) -> None:
    out, errors = StringIO(), StringIO()
    monkeypatch.setattr("sys.stdout", out)
    monkeypatch.setattr("sys.stderr", errors)
    asked = changes(with_policy(written(tmp_path, CLOSES.format(act=act)), "duration=0.1"))
    assert main(["simulate", "two_area_small", *asked]) == status
    assert (sys.stdout, sys.stderr) == (out, errors)  # as before
    if not errors.closed:
        assert said in errors.getvalue()
        assert errors.getvalue().count("\n") == int(bool(said))
