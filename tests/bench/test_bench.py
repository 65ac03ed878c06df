"""The comparison with other programs: its figures, its table with programs that are not there, our own ladder."""

from __future__ import annotations

import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from facts_damping.case.loading import load_system
from facts_damping.cli.main import main
from facts_damping.errors import RunError
from facts_damping_bench import ours, pages, study, ticks
from facts_damping_bench.figures import Result, Rung, Sweep, at_equal_error, difference, ratio, sweep_step
from facts_damping_bench.grid import FAULT_END, FAULT_START, LOAD, RATE, SYSTEM, TimedRun, grid, swings
from facts_damping_bench.programs import HELICS, OURS, PROGRAMS, Program, missing
from facts_damping_bench.session import session

if TYPE_CHECKING:
    from collections.abc import Callable

FAKE = '''
import os
import re
import numpy as np
from facts_damping_bench.grid import TimedRun

def prepare(grid, folder):
    """What is made once."""
    return ORDER

def run(made, grid, step, model="", more=()):
    if step < 0.005 and made == "dies":
        print("the last line", flush=True)
        os._exit(3)
    order = 2 if isinstance(made, str) else made
    t = np.arange(0.0, 20.0 + 1e-9, 0.01)
    swing = 1e-3 * np.exp(-0.1 * t) * np.sin((4.0 + 5.0 * step**order) * t)
    speeds = np.array([swing, -swing, 0 * t, 0 * t]).T + 0.01
    return TimedRun(0.01, 1e-4 * COST / step, t, speeds)
'''


def fake(path: Path, name: str, order: str, cost: float = 1.0) -> Program:
    path.joinpath(f"{name}.py").write_text(FAKE.replace("ORDER", order).replace("COST", f"{cost}"))
    return Program(name.title(), name, (), (0.02, 0.01, 0.005), "genrou", (), f"note of {name}")


@pytest.fixture
def table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Program]:
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    return {
        OURS: fake(tmp_path, "fourth", "4"),
        "second": fake(tmp_path, "second", "2", 3.0),
        "dies": fake(tmp_path, "dies", "'dies'"),
        "absent": fake(tmp_path, "absent", "2")._replace(distributions=("no-such-distribution", "numpy")),
    }


def ladder(order: float, *steps: float) -> list[Rung]:
    return [Rung(h, 10.0 * h**order, 1e-3 / h, 0.0) for h in steps]


def test_time_at_equal_error_lies_on_the_power_law() -> None:
    equal = at_equal_error(ladder(2.0, 0.04, 0.02, 0.005), 1e-3)
    assert equal is not None
    assert equal.step_s == 0.005
    assert equal.error == pytest.approx(2.5e-4)
    assert equal.at_error_s == pytest.approx(1e-3 / math.sqrt(1e-4))
    assert equal.wall_s == pytest.approx(0.2)


def test_time_at_equal_error_is_not_extrapolated() -> None:
    assert at_equal_error(ladder(2.0, 0.02), 1e-4) is None
    equal = at_equal_error(ladder(2.0, 0.002, 0.001), 1e-3)
    assert equal is not None
    assert equal.at_error_s == equal.wall_s == pytest.approx(0.5)
    assert sweep_step(ladder(2.0, 0.02, 0.01)) == 0.01  # none is within: the finest
    assert ratio(3.0, 1.5) == 2.0
    assert math.isnan(ratio(None, 1.0))
    assert math.isnan(ratio(1.0, None))


def test_common_drift_hides_nothing() -> None:
    t = np.arange(0.0, 20.001, 0.01)
    speeds = np.outer(np.sin(4 * t), [1e-3, -1e-3, 0.0, 0.0])
    drift = speeds + 0.01 * t[:, None]
    still, other = swings(TimedRun(0.0, 0.0, t, speeds)), swings(TimedRun(0.0, 0.0, t, drift))
    assert still.shape == (4, round((20.0 - FAULT_END) * RATE))
    assert difference(still, other) < 1e-9
    assert difference(2 * still, still) == pytest.approx(1.0)


@pytest.mark.parametrize("name", PROGRAMS)
def test_steps_meet_instants_and_fault(name: str) -> None:
    steps = PROGRAMS[name].steps
    assert list(steps) == sorted(steps, reverse=True)
    for step in steps:
        for time_s in (1.0 / RATE, FAULT_START, FAULT_END):
            assert time_s / step == pytest.approx(round(time_s / step), abs=1e-9)


def test_extra_names_what_the_table_asks_for() -> None:
    text = (Path(__file__).parents[2] / "reproduction" / "pyproject.toml").read_text()
    for name in (*HELICS, *(distribution_name for row in PROGRAMS.values() for distribution_name in row.distributions)):
        assert re.search(rf"['\"]{name}==", text)
    assert missing(("numpy", "no-such-distribution")) == "not installed (pip install no-such-distribution)"
    assert missing(("numpy",)) == ""


def test_load_is_that_of_the_file() -> None:
    system = load_system(SYSTEM)
    assert (system.loads[0].bus, system.loads[0].P) == ("B7", LOAD)
    bench_grid = grid(1.1)
    assert bench_grid.loads[0][2] == pytest.approx(complex(1.1 * LOAD, system.loads[0].Q) / system.base_power)
    assert sum(bench_grid.power.values()).real > sum(s.real for _, _, s in bench_grid.loads)  # and losses


def test_our_errors_fall_with_the_step() -> None:
    case, end = grid(), 3.0
    courses = {step: swings(ours.run(None, case, step, end=end), end) for step in (0.02, 0.01, 0.005, 0.00125)}
    errors = [difference(courses[step], courses[0.00125]) for step in (0.02, 0.01, 0.005)]
    assert errors == sorted(errors, reverse=True)
    assert errors[1] < 1e-3
    assert errors[2] < errors[0] / 16


def test_programs_side_by_side(table: dict[str, Program], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study, "VARIED", {OURS: 10})
    shown: list[tuple[int, int]] = []
    results = study.measure(["second", "dies", "absent"], lambda *at: shown.append(at), 2, table)
    first, second, dies, absent = results
    assert [result.name for result in results] == [OURS, "second", "dies", "absent"]
    assert absent.failed == "not installed (pip install no-such-distribution)"
    assert dies.failed == "its process ended with 3: the last line"
    assert all(not result.rungs for result in (dies, absent))
    assert [step_rung.step_s for step_rung in second.rungs] == [0.02, 0.01, 0.005]
    assert second.rungs[0].error / second.rungs[1].error == pytest.approx(4.0, rel=0.2)
    assert first.rungs[0].error / first.rungs[1].error == pytest.approx(16.0, rel=0.2)
    assert second.from_ours < 1e-3
    assert first.sweep is not None
    assert second.sweep is not None
    assert (first.sweep.runs, second.sweep.runs) == (10, study.OTHERS)
    assert [done for done, _ in shown] == sorted(done for done, _ in shown)
    assert shown[-1][0] == shown[-1][1]
    text = "\n".join(pages.text(results, []))
    assert "Absent: not installed (pip install no-such-distribution)" in text
    assert "Second: note of second" in text
    beside = {program["name"]: program for program in pages.document(results, [])["programs"]}
    costs = [beside[name]["at_equal_error"]["at_error_s"] for name in ("second", OURS)]
    assert beside["second"]["ratio"] == pytest.approx(costs[0] / costs[1])
    assert beside[OURS]["ratio"] == 1.0


def test_without_a_sweep_there_are_ladders_alone(table: dict[str, Program]) -> None:
    done: list[tuple[int, int]] = []
    results = study.measure(["second"], lambda *at: done.append(at), 1, table, sweep=False)
    assert [len(result.rungs) for result in results] == [3, 3]
    assert all(result.sweep is None for result in results)
    assert done[-1][0] == done[-1][1]
    assert all(program["sweep"] is None for program in pages.document(results, [])["programs"])


WAITS = """
import time
from pathlib import Path

def prepare(grid, folder):
    Path(__file__).with_name("at work").touch()
    time.sleep(600)
"""


def waits(path: Path) -> str:
    path.joinpath("waits.py").write_text(WAITS)
    return "waits"


def gone(pid: int) -> bool:
    state = Path(f"/proc/{pid}/stat")
    return not state.exists() or state.read_text().rpartition(")")[2].split()[0] == "Z"


def test_interrupt_leaves_no_process(table: dict[str, Program], tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), session(waits(tmp_path)) as started:
        raise KeyboardInterrupt
    assert started.process.returncode is not None
    with session("no_such_module") as started, pytest.raises(RunError, match="No module named 'no_such_module'"):
        started.read()


@pytest.mark.parametrize("starts", [True, False])
def test_killed_command_leaves_no_process(
    table: dict[str, Program], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, starts: bool
) -> None:
    """Whether it is killed while the other starts, or while that is at work."""
    text = "import sys\nfrom facts_damping_bench.session import session\nwith session('waits') as one:\n"
    waits(tmp_path)
    monkeypatch.setenv("TMPDIR", str(tmp_path))  # its folder is left
    command = [sys.executable, "-c", text + "    print(one.process.pid, flush=True)\n    sys.stdin.read()\n"]
    end = time.monotonic() + 60.0
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        while not (starts or (tmp_path / "at work").exists()):
            assert time.monotonic() < end
            time.sleep(0.02)
        parent.send_signal(signal.SIGKILL)
    while not gone(pid):
        assert time.monotonic() < end
        time.sleep(0.05)


RESULTS = [
    Result(
        OURS, "facts_damping", "0.1.0", "ours", "", 0.0006, math.nan, tuple(ladder(4.0, 0.02)), Sweep(0.02, 100, 0.02)
    ),
    Result("tops", "TOPS", "", "another", "not installed (pip install tops)"),
]


def answers(what: list[Result] | list[ticks.Rate]) -> Callable[..., object]:
    return lambda *_, **__: what


def test_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(study, "measure", answers(RESULTS))
    rates = [ticks.Rate("ours", 900.0, "", ""), ticks.Rate("HELICS", math.nan, "", missing(("no-such",)))]
    monkeypatch.setattr(ticks, "measure", answers(rates))
    assert main(["bench", "--out", str(tmp_path / "new"), "--json", str(tmp_path / "bench.json")]) == 0
    said = capsys.readouterr().out
    assert "TOPS: not installed (pip install tops)" in said
    assert "HELICS: not installed (pip install no-such)" in said
    assert (tmp_path / "new" / "bench.png").stat().st_size > 1000
    report = json.loads((tmp_path / "bench.json").read_text())
    assert [program["failed"] for program in report["programs"]] == [None, "not installed (pip install tops)"]
    assert report["programs"][0]["sweep"]["runs_per_s"] == 50.0
    assert report["lockstep"][1]["per_s"] is None
    assert main(["bench", "tops", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["lockstep"] == []
    assert main(["bench", "helics", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["programs"] == []


def test_program_that_is_not_known(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "psse"]) == 2
    said = capsys.readouterr().err
    assert said == "facts-damping: PROGRAM: 'psse' given; allowed: andes, dpsim, stepss, pydae, tops, helics\n"
