"""Sweeps as users run them: rows are what `simulate` gives, also after a kill; margins are where runs change."""

from __future__ import annotations

import csv
import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow.parquet as pq
import pytest

from facts_damping.analysis.summary import summarise
from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.errors import InputError
from facts_damping.output.terminal import Progress
from facts_damping.parameters import files
from facts_damping.parameters.files import shipped
from facts_damping.parameters.yaml_text import dump
from facts_damping.simulation import loop
from facts_damping_studies.margins.criteria import fails
from facts_damping_studies.sweeps import axes, batch, sweep
from facts_damping_studies.sweeps.batch import RunRequest, make, names, one_run
from facts_damping_studies.sweeps.journal import Journal
from facts_damping_studies.sweeps.results import cell
from facts_damping_studies.sweeps.sweep_rows import SweepRow
from tests.commands import assert_one_line

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

ONE = """
run: two_area_small
set: {duration: 4}
sweep:
  - {name: delay, fields: {link.up.0.delay: 0.5, link.down.0.delay: 0.5}, values: [0, 0.1, 0.2]}
  - {field: controllers.0.parameters.gain, values: [5, 10]}
"""


def study(tmp_path: Path, text: str = ONE, name: str = "mine") -> Path:
    path = tmp_path / f"{name}.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def swept(tmp_path: Path, path: Path | str, *more: str, status: int = 0) -> dict[str, Any]:
    target = tmp_path / "result.json"
    command = ["sweep", str(path), "--jobs", "1", "--out", str(tmp_path / "out"), "--json", str(target), *more]
    assert main(command) == status
    return dict(json.loads(target.read_text()))


def test_sweep_rows_have_the_figures_that_simulate_gives(tmp_path: Path) -> None:
    """All six, although they share a plant."""
    rows = swept(tmp_path, study(tmp_path))["rows"]
    assert [(row["delay"], row["controllers.0.parameters.gain"]) for row in rows] == [
        (delay, gain) for delay in (0, 0.1, 0.2) for gain in (5, 10)
    ]
    for row in rows:
        run_sets = [f"link.up.0.delay={row['delay'] / 2}", f"link.down.0.delay={row['delay'] / 2}", "duration=4"]
        gain = f"controllers.0.parameters.gain={row['controllers.0.parameters.gain']}"
        summary: Any = summarise(loop.run(load_case("two_area_small", [*run_sets, gain])))
        for name in ("stable", "damped", "instability", "duration_s", "roughness", "max_injected_voltage_pu"):
            assert row[name] == getattr(summary, name), name
        assert row["settling_time_s"] == summary.settling_time_s
        assert {name: row[name] for name in summary.indices} == summary.indices
        assert row["latency_max_ms"] == pytest.approx(1e3 * row["delay"], abs=1e-6)
        assert row["latency_mean_ms"] == summary.latency_ms.mean
        assert row["interarea_hz"] == next((m.frequency_hz for m in summary.modes if m.frequency_hz < 0.9), None)
        assert (row["error"], row["scenario"], row["controller"], row["scheme"]) == (None, "small", "LLC", None)
        assert (row["link"], row["seed"], row["horizon_s"]) == ("ideal", 0, 4)


def test_folder_explains_itself(tmp_path: Path) -> None:
    path = study(tmp_path)
    rows = swept(tmp_path, path)["rows"]
    out = tmp_path / "out"
    assert pq.read_table(out / "rows.parquet").to_pylist() == rows
    with (out / "rows.csv").open(encoding="utf-8") as file:
        read = list(csv.DictReader(file))
    assert [float(row["ITAE"]) for row in read] == [row["ITAE"] for row in rows]
    assert (out / "study.yaml").read_text() == path.read_text()
    assert {"facts_damping", "python", "numpy", "numba", "scipy", "git"} <= set(
        json.loads((out / "versions.json").read_text())
    )
    assert {picture.name for picture in out.glob("*.png")} == {"curves.png"}
    assert all(picture.stat().st_size > 5000 for picture in out.glob("*.png"))


def test_networks_share_sensitivities_and_stay_the_same(tmp_path: Path) -> None:
    """Each controller and frame rate beside a run by itself, in an order in which what is shared is used again."""
    text = """
run: two_area_small
set: {duration: 3}
sweep:
  - rows:
      - {controllers.0.name: HBsWC, controllers.0.scheme: indirect}
      - {controllers.0.name: ANFTSC, controllers.0.scheme: direct}
  - {field: frame_rate, values: [60, 30, 60.0e0]}
  - {field: scenario, values: [large, small]}
""".replace("60.0e0", "50")
    rows = swept(tmp_path, study(tmp_path, text))["rows"]
    assert len(rows) == 12
    for row in rows:
        run_sets = [
            f"{name}={row[name]}" for name in ("scenario", "frame_rate", "controllers.0.name", "controllers.0.scheme")
        ]
        summary: Any = summarise(loop.run(load_case("two_area_small", [*run_sets, "duration=3"])))
        assert {name: row[name] for name in summary.indices} == summary.indices


def test_runs_on_the_same_network_follow_each_other(tmp_path: Path) -> None:
    """Whatever the order of the axes; the table has theirs."""
    text = """
run: {duration: 2}
sweep:
  - {field: controllers.0.parameters.gain, values: [5, 10, 20]}
  - {field: scenario, values: [small, large]}
  - {field: seed, values: [1, 2]}
"""
    path = study(tmp_path, text)
    tasks = sweep._tasks(sweep.plan(str(path), []), {})
    assert sorted(task.key for task in tasks) == sorted(map(str, range(12)))
    assert [task.columns["scenario"] for task in tasks] == ["small"] * 6 + ["large"] * 6
    rows = swept(tmp_path, path)["rows"]
    assert [(row["controllers.0.parameters.gain"], row["scenario"], row["seed"]) for row in rows] == [
        (gain, scenario, seed) for gain in (5, 10, 20) for scenario in ("small", "large") for seed in (1, 2)
    ]


def test_system_that_changes_between_two_sweeps_of_a_process_is_built_anew(tmp_path: Path) -> None:
    system, itae = files.read_table(files.find("systems", "two_area")), {}
    path = study(tmp_path, f"run: {{system: {tmp_path / 'grid.yaml'}, duration: 3}}\n")
    for factor in (1.0, 1.5):
        system["machines"][0]["H"] *= factor
        (tmp_path / "grid.yaml").write_text(dump(system), encoding="utf-8")
        out, target = tmp_path / str(factor), tmp_path / "result.json"
        assert main(["sweep", str(path), "--jobs", "1", "--out", str(out), "--json", str(target)]) == 0
        itae[factor] = json.loads(target.read_text())["rows"][0]["ITAE"]
        case = load_case(None, [f"system={tmp_path / 'grid.yaml'}", "duration=3"])
        assert itae[factor] == (summarise(loop.run(case)).indices or {})["ITAE"]
    assert itae[1.0] != itae[1.5]


def test_saturation_duty_is_the_share_of_frames_at_the_limit(tmp_path: Path) -> None:
    text = "run: two_area_large\nset: {duration: 5}\nsweep: [{field: controllers.0.parameters.gain, values: [200]}]\n"
    (row,) = swept(tmp_path, study(tmp_path, text))["rows"]
    record = loop.run(load_case("two_area_large", ["duration=5", "controllers.0.parameters.gain=200"]))
    assert row["saturation_duty"] == pytest.approx((abs(record.devices["setpoint"]) > 0.0999999).mean())
    assert 0.1 < row["saturation_duty"] < 1


def test_sweep_draws_every_picture_that_its_table_has_data_for(tmp_path: Path) -> None:
    """Two controllers with links of their own, so latencies vary; two numbers; seeds."""
    text = """
run: two_area_decentralised
set: {duration: 2, scenario: small}
sweep:
  - {field: controllers.0.link.up.0.delay, range: {start: 0, step: 0.01, number: 3}}
  - {field: controllers.1.link.up.1.delay, range: {start: 0.03, step: 0.01, number: 3}}
  - {field: seed, values: [1, 2]}
"""
    document = swept(tmp_path, study(tmp_path, text))
    pictures = {path.stem for path in (tmp_path / "out").glob("*.png")}
    assert pictures == {
        "curves",
        "latency",
        *(f"{picture}{of}" for picture in ("probability", "map") for of in ("", "_not_damped")),
    }
    (row,) = [r for r in document["rows"] if r["latency_max_ms"] == pytest.approx(70.0) and r["latency_p0_ms"] == 0.0][
        :1
    ]
    assert (row["controller"], row["scheme"]) == ("ANFTSC@two_area_power_rate+HBsWC@two_area_statcom", "indirect")
    assert (row["controllers.0.link.up.0.delay"], row["controllers.1.link.up.1.delay"]) == (0, 0.05)
    assert [fraction["runs"] for fraction in document["fractions"]] == [2] * 18
    for fraction in document["fractions"]:
        rows_of_fraction = [
            row for row in document["rows"] if all(row[name] == fraction[name] for name in row if name in fraction)
        ]
        figure = {"unstable": "stable", "not_damped": "damped"}[fraction["criterion"]]
        assert fraction["failed"] == sum(not row[figure] for row in rows_of_fraction)


def test_all_that_cannot_be_made_is_refused_before_the_first_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A gain out of range, a device that is not there, a class that is none: in one line, whatever the seed."""
    (tmp_path / "bad.py").write_text("class Bad:\n    def __init__(self, spec):\n        raise ValueError('no')\n")
    text = f"""
run: two_area_small
set: {{duration: 2}}
sweep:
  - {{field: controllers.0.parameters.gain, values: [10, 1.0e+9]}}
  - {{field: devices, values: [[sssc], [statcom]]}}
  - name: kind
    labels: [LLC, mine]
    rows: [{{controllers.0.name: LLC}}, {{controllers.0.name: mine, controllers.0.policy: "{tmp_path}/bad.py:Bad"}}]
  - {{field: seed, range: {{start: 1, step: 1, number: 500}}}}
"""
    out = tmp_path / "out"
    said = "mine.yaml: 4 of 5 different runs cannot be made (--only leaves runs out): "
    assert main(["sweep", str(study(tmp_path, text)), "--jobs", "1", "--out", str(out)]) == 2
    errors = capsys.readouterr().err
    assert said in errors
    assert errors.count("\n") == 1
    assert not out.exists()
    for reason in (
        "gain=10 devices=['statcom'] LLC",
        "controllers.0.devices: 'sssc' given; allowed: statcom",
        "--set controllers.0.parameters.gain=1000000000.0: ",
        "ValueError: no",
    ):
        assert reason in errors


FAILING = """
class Failing:
    def __init__(self, spec):
        self.gain = spec.parameters.get("gain", 0.0)

    def step(self, t_s, y, age_s, fresh):
        if self.gain > 1.0 and t_s > 0.5:
            raise ValueError("too much")
        return [0.0]
"""


def test_run_that_fails_is_a_row_and_the_status_tells(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What only shows while it runs: a line of `error`; the others are run."""
    (tmp_path / "failing.py").write_text(FAILING, encoding="utf-8")
    text = f"""
run: two_area_small
set: {{duration: 1, controllers: [{{name: mine, policy: "{tmp_path}/failing.py:Failing"}}]}}
sweep: [{{field: controllers.0.parameters.gain, values: [1, 2]}}]
tables: {{rows: [controllers.0.parameters.gain], figures: [ITAE]}}
"""
    first, second = swept(tmp_path, study(tmp_path, text), status=3)["rows"]
    said = capsys.readouterr()
    assert first["error"] is None
    assert "ValueError: too much" in second["error"]
    assert "\n" not in second["error"]
    assert pq.read_table(tmp_path / "out" / "rows.parquet")["error"].null_count == 1
    missing = f"1 of 2 runs could not be made, the first: {second['error']}"
    assert said.err == f"facts-damping: the study ended, but: {missing}\n"
    assert missing in said.out
    assert missing in (tmp_path / "out" / "tables.md").read_text()
    assert "| 2 | - | error |" in said.out


def test_lost_synchronism_is_a_row_without_indices(tmp_path: Path) -> None:
    text = "run: two_area_large\nset: {controllers: []}\nsweep: [{field: duration, values: [20, 5]}]\n"
    lost, short = swept(tmp_path, study(tmp_path, text))["rows"]
    assert (lost["stable"], lost["damped"], lost["ITAE"], lost["controller"]) == (False, False, None, "none")
    assert lost["instability"] == "loss of synchronism"
    assert 14 < lost["duration_s"] < 15
    assert short["stable"] is True


# Margins

MARGIN = """
run: two_area_small
sweep:
  - rows:
      - {scenario: large, link: delay_100ms}
margin:
  field: link.up.1.delay
  low: 0
  high: 0.4
  coarse: 5
  tolerance: 0.02
  criteria: [unstable, not_damped]
"""


def test_margins_are_bracketed_as_single_runs_say(tmp_path: Path) -> None:
    document = swept(tmp_path, study(tmp_path, MARGIN))
    assert [margin["criterion"] for margin in document["margins"]] == ["unstable", "not_damped"]
    for margin, figure in zip(document["margins"], ("stable", "damped"), strict=True):
        assert {"controller", "scheme", "link", "scenario", "margin_s", "low_s", "high_s"} <= set(margin)
        assert (margin["controller"], margin["scheme"], margin["link"], margin["scenario"]) == (
            "LLC",
            None,
            "delay_100ms",
            "large",
        )
        assert (margin["horizon_s"], margin["field"]) == (20, "link.up.1.delay")
        assert 0 < margin["high_s"] - margin["low_s"] <= 0.02 * (1 + 1e-9)
        assert margin["low_s"] < margin["margin_s"] < margin["high_s"]
        for value, holds in ((margin["low_s"], True), (margin["high_s"], False)):
            run_sets = ["scenario=large", "link=delay_100ms", f"link.up.1.delay={value}"]
            assert getattr(summarise(loop.run(load_case("two_area_small", run_sets))), figure) is holds
    assert document["margins"][1]["high_s"] <= document["margins"][0]["low_s"]  # it grows before it is lost
    assert (tmp_path / "out" / "margins.csv").is_file()
    assert (tmp_path / "out" / "margins.png").is_file()


def test_seeds_make_one_margin_and_shares(tmp_path: Path) -> None:
    """Nothing is random in a constant delay: all seeds agree, and the interval is the bracket."""
    text = MARGIN.replace("criteria: [unstable, not_damped]", "criteria: [unstable]")
    text = text.replace("margin:", "  - {field: seed, range: {start: 1, number: 3, step: 1}}\nmargin:")
    document = swept(tmp_path, study(tmp_path, text))
    (margin,) = document["margins"]
    assert margin["seeds"] == 3
    assert margin["per_seed"] == [margin["margin_s"]] * 3
    assert 0 < margin["high_s"] - margin["low_s"] <= 0.02 * (1 + 1e-9)
    assert {row["seed"] for row in document["rows"]} == {1, 2, 3}
    by_value = {
        fraction["link.up.1.delay"]: fraction
        for fraction in document["fractions"]
        if fraction["criterion"] == "unstable"
    }
    assert by_value[0.0]["runs"] == by_value[0.4]["failed"] == 3
    assert by_value[0.4]["low"] == pytest.approx(0.4385, abs=1e-4)  # Wilson's, of 3 of 3: 3 / (3 + 1.96^2)


@pytest.mark.parametrize("tolerance", [0.02, 1e-6])
def test_margin_is_converged_if_its_ends_do_the_same_with_half_the_step(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], tolerance: float
) -> None:
    """The step moves an edge by far less than 20 ms, and by more than a microsecond."""
    text = MARGIN.replace("tolerance: 0.02", f"tolerance: {tolerance}").replace(", not_damped", "") + "check_step: true"
    document = swept(tmp_path, study(tmp_path, text))
    (margin,) = document["margins"]
    ends = {margin["low_s"], margin["high_s"]}
    assert {row["link.up.1.delay"] for row in document["rows"] if row.get("verdict_half_step")} == ends
    stable = []
    for end in sorted(ends):
        case = load_case("two_area_small", ["scenario=large", "link=delay_100ms", f"link.up.1.delay={end}"])
        stable.append(summarise(loop.run(loop.with_half_step(case))).stable)
    assert margin["converged"] is (stable == [True, False]) is (tolerance > 0.01)
    assert ("] ~" in capsys.readouterr().out) is not margin["converged"]


def test_share_counts_the_runs_that_do_otherwise_with_half_the_step(tmp_path: Path) -> None:
    text = """
run: two_area_small
set:
  scenario: large
  controllers.0.name: ANFTrMeC
  controllers.0.scheme: indirect
  link: {up: [{delay: 0}, {model: bernoulli, loss: 0.1}]}
sweep:
  - {name: delay, field: link.up.0.delay, values: [0, 0.05, 0.1]}
  - {field: seed, values: [1, 2, 3]}
modes: false
check_step: true
"""
    document = swept(tmp_path, study(tmp_path, text))
    for fraction in document["fractions"]:
        rows_of_delay = [row for row in document["rows"] if row["delay"] == fraction["delay"]]
        holds = "damped" if fraction["criterion"] == "not_damped" else None
        outcomes = [
            [row[v] == holds if holds else row[v] != "lost synchronism" for row in rows_of_delay] for v in VERDICTS
        ]
        assert fraction["not_converged"] == sum(a != b for a, b in zip(*outcomes, strict=True))
    assert sum(fraction["not_converged"] for fraction in document["fractions"]) > 0


VERDICTS = ("verdict", "verdict_half_step")

# Interruption


def rows_there(out: Path) -> int:
    journal = out / sweep.JOURNAL
    return max(0, journal.read_bytes().count(b"\n") - 1) if journal.is_file() else 0


MANY = """
run: two_area_small
set: {duration: 2}
sweep: [{field: link.up.0.delay, range: {start: 0, step: 0.005, number: 24}}]
modes: false
"""
STRUCK = 6  # runs in the journal when something strikes
APPEND = Journal.append


def table(out: Path) -> list[dict[str, Any]]:
    return list(pq.read_table(out / "rows.parquet").to_pylist())


def at_strike(monkeypatch: pytest.MonkeyPatch, strike: Callable[[], None]) -> None:
    """What happens as soon as the journal holds `STRUCK` runs."""

    def append_and_strike(journal: Journal[SweepRow], key: str, row: SweepRow) -> None:
        APPEND(journal, key, row)
        if len(journal.rows) == STRUCK:
            strike()

    monkeypatch.setattr(Journal, "append", append_and_strike)


def goes_on(path: Path, out: Path) -> None:
    """The same command ends what was begun: what is there stays, nothing is run twice, the table is that of a whole.

    The first rows are from processes, so their figures are the same there as here.
    """
    before = (out / sweep.JOURNAL).read_bytes()
    assert main(["sweep", str(path), "--jobs", "1", "--out", str(out)]) == 0
    assert (out / sweep.JOURNAL).read_bytes().startswith(before)
    assert rows_there(out) == 24
    assert main(["sweep", str(path), "--jobs", "1", "--out", str(out.parent / "whole")]) == 0
    assert table(out) == table(out.parent / "whole")


# The command, which says that it is struck and waits for it.
WAITING = """
import sys, time
from facts_damping.cli.main import main
from facts_damping.errors import InputError
from tests.studies.test_sweep import at_strike
import pytest

at_strike(pytest.MonkeyPatch(), lambda: (print("struck", flush=True), time.sleep(600)))
main(sys.argv[1:])
"""


def test_sweep_that_is_killed_leaves_no_process_and_goes_on_where_it_stopped(tmp_path: Path) -> None:
    path, out = study(tmp_path, MANY), tmp_path / "out"
    command = [sys.executable, "-c", WAITING, "sweep", str(path), "--jobs", "2", "--out", str(out)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == b"struck\n"
        left = children(child.pid)
        child.kill()
    assert len(left) >= 2
    gone(left)
    assert rows_there(out) == STRUCK
    goes_on(path, out)


def test_interrupted_sweep_leaves_no_process_and_goes_on_where_it_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ctrl-C, which strikes the command alone: its processes are its own to end."""
    path, out, left = study(tmp_path, MANY), tmp_path / "out", list[int]()

    def interrupt() -> None:
        left.extend(pid for pid in children(os.getpid()) if is_worker(pid))
        signal.raise_signal(signal.SIGINT)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # as at a terminal, not in the background
    try:
        with monkeypatch.context() as patched:
            at_strike(patched, interrupt)
            assert main(["sweep", str(path), "--jobs", "2", "--out", str(out)]) == 130
    finally:
        signal.signal(signal.SIGINT, before)
    said = capsys.readouterr().err
    assert said == f"facts-damping: interrupted; the same command continues the study: {out}\n"
    assert len(left) >= 2
    gone(left)
    assert rows_there(out) == STRUCK
    goes_on(path, out)


DEADLY = """
import os, signal
from pathlib import Path


class Deadly:
    def __init__(self, spec):
        pass

    def step(self, t_s, y, age_s, fresh):
        if not Path(__file__).with_name("spared").exists():
            os.kill(os.getpid(), signal.SIGKILL)
        return [0.0]
"""


def test_process_that_is_killed_ends_the_sweep_with_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The last run kills it; the others stay, and are not run again."""
    (tmp_path / "deadly.py").write_text(DEADLY, encoding="utf-8")
    deadly = f"{{controllers.0.name: mine, controllers.0.policy: '{tmp_path / 'deadly.py'}:Deadly'}}"
    path = study(
        tmp_path,
        "run: two_area_small\nset: {duration: 1, controllers: [{}]}\nsweep:\n"
        f"  - {{rows: [{'{controllers.0.name: LLC}, ' * 8}{deadly}]}}\n",
    )
    assert main(["sweep", str(path), "--jobs", "2", "--out", str(tmp_path / "out")]) == 1
    said = capsys.readouterr().err
    assert said.startswith("facts-damping: a process of the sweep was killed")
    assert said.count("\n") == 1
    gone([pid for pid in children(os.getpid()) if is_worker(pid)])
    before = (tmp_path / "out" / sweep.JOURNAL).read_bytes()
    (tmp_path / "spared").touch()
    assert main(["sweep", str(path), "--jobs", "1", "--out", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / sweep.JOURNAL).read_bytes().startswith(before)
    assert rows_there(tmp_path / "out") == 9


def children(pid: int) -> list[int]:
    text = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii")
    return [int(pid_text) for pid_text in text.split()]


def is_worker(pid: int) -> bool:
    with suppress(FileNotFoundError):
        return b"popen_loky" in Path(f"/proc/{pid}/cmdline").read_bytes()
    return False


def gone(pids: list[int]) -> None:
    """No process is left behind, but for those that only wait to be collected."""
    deadline = time.monotonic() + 60
    for pid in pids:
        with suppress(OSError):  # it ends while its state is read
            while ") Z" not in Path(f"/proc/{pid}/stat").read_text(encoding="ascii"):
                assert time.monotonic() < deadline, Path(f"/proc/{pid}/cmdline").read_bytes()
                time.sleep(0.05)


def test_torn_or_damaged_line_costs_its_run_only(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Also one that still is JSON: a digit that has changed."""
    path, out = study(tmp_path), tmp_path / "out"
    swept(tmp_path, path)
    whole, journal = table(out), out / sweep.JOURNAL
    lines = journal.read_bytes().splitlines(keepends=True)
    assert len(lines) == 7
    changed = re.sub(rb"(\d\.)\d", lambda match: match[1] + (b"1" if match[0].endswith(b"7") else b"7"), lines[2])
    assert json.loads(changed) != json.loads(lines[2])
    journal.write_bytes(b"".join([*lines[:2], changed, b"\x00\x00\xff\n", *lines[4:6], lines[6][:40]]))
    capsys.readouterr()
    assert swept(tmp_path, path)["rows"] == json.loads(json.dumps(whole))
    assert capsys.readouterr().err == f"{journal}: 3 damaged lines; those runs are repeated\n"
    assert table(out) == whole
    assert (
        len([line for line in journal.read_bytes().splitlines() if b'"row"' in line]) == 6 + 2
    )  # a changed, a torn one


def test_finished_sweep_is_not_run_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = study(tmp_path)
    first = swept(tmp_path, path)
    monkeypatch.setattr(loop, "finish", None)
    assert swept(tmp_path, path) == first


TABLES = "a table with rows, across, figures, such as {figures: [ITAE, trips]}"


@pytest.mark.parametrize(
    ("field", "said"),
    [
        ("tables: [ITAE]", f"tables: ['ITAE'] given; allowed: {TABLES}"),
        ("tables: ITAE", f"tables: 'ITAE' given; allowed: {TABLES}"),
        ("tables: {figures: ITAE}", "tables.figures: 'ITAE' given; allowed: a list, such as [ITAE]"),
        ("sweep: {field: seed}", "sweep: {'field': 'seed'} given; allowed: a list"),
        ("set: [3]", "set: [3] given; allowed: a table, key: value"),
    ],
)
def test_field_of_another_form_is_refused_with_an_example(field: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as error:
        sweep.plan(str(study(tmp_path, f"run: two_area_small\n{field}\n")), [])
    assert str(error.value).endswith(f": {said}")
    assert sweep.plan(str(study(tmp_path, "tables: {figures: [ITAE, trips]}\n")), []).study.tables


@pytest.mark.parametrize("change", ["study", "set", "run"])
def test_another_study_in_the_same_folder_is_refused(
    tmp_path: Path, change: str, capsys: pytest.CaptureFixture[str]
) -> None:
    base = tmp_path / "base.yaml"
    base.write_text("scenario: small\nduration: 2\n", encoding="utf-8")
    text = f"run: {base}\nsweep: [{{field: link.up.0.delay, values: [0, 0.1]}}]\n"
    path, more = study(tmp_path, text), []
    swept(tmp_path, path)
    before = (tmp_path / "out" / sweep.JOURNAL).read_bytes()
    if change == "study":
        path.write_text(text.replace("0.1", "0.2"), encoding="utf-8")
    elif change == "run":
        base.write_text("scenario: small\nduration: 3\n", encoding="utf-8")
    else:
        more = ["--set", "scenario=large"]
    capsys.readouterr()
    assert_one_line(
        2,
        ["sweep", str(path), "--jobs", "1", "--out", str(tmp_path / "out"), *more],
        "holds runs of another study",
        capsys,
    )
    assert (tmp_path / "out" / sweep.JOURNAL).read_bytes() == before
    assert (tmp_path / "out" / sweep.COPY).read_text() == text


def test_two_sweeps_cannot_write_the_same_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = study(tmp_path), tmp_path / "out"
    out.mkdir()
    with Journal(out / sweep.JOURNAL, sweep.plan(str(path), []).fingerprint, SweepRow.read):
        assert_one_line(2, ["sweep", str(path), "--jobs", "1", "--out", str(out)], "another sweep writes there", capsys)


# Where it runs


def test_dask_cluster_gives_the_same_table(tmp_path: Path) -> None:
    from distributed import LocalCluster  # noqa: PLC0415 (a second to load)

    path = study(tmp_path)
    with LocalCluster(n_workers=1, threads_per_worker=2, processes=True, dashboard_address=":0") as cluster:
        out = str(tmp_path / "dask")
        assert main(["sweep", str(path), "--scheduler", cluster.scheduler_address, "--out", out]) == 0
    assert main(["sweep", str(path), "--jobs", "1", "--out", str(tmp_path / "here")]) == 0
    assert table(tmp_path / "dask") == table(tmp_path / "here")


def test_scheduler_that_does_not_answer_is_told_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("facts_damping_studies.sweeps.pool.CONNECT_S", 0.5)
    out = str(tmp_path / "out")
    assert_one_line(
        2,
        ["sweep", str(study(tmp_path)), "--scheduler", "tcp://127.0.0.1:9", "--out", out],
        "--scheduler tcp://127.0.0.1:9: no scheduler answers",
        capsys,
    )
    assert not Path(out).exists()


# What users get wrong


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "swep: []",
            "swep: unknown key (did you mean sweep?); allowed: description, run, set, seed, sweep, margin, modes",
        ),
        ("run: nowhere", "runs: 'nowhere' given; allowed: "),
        (
            "sweep: [{field: link.up.0.delay}]",
            "sweep.0: none given; allowed: one of values, range, rows, every, draws, zip",
        ),
        ("sweep: [{values: [1]}]", "sweep.0: needs either `field` or `fields`"),
        ("sweep: [{fields: {duration: 1}, values: [1]}]", "`fields` need a `name`"),
        ("sweep: [{name: a, fields: {duration: 1}, values: [x]}]", "'x' given; allowed: numbers"),
        (
            "sweep: [{field: duration, range: {start: 1, number: 0, stop: 2}}]",
            "sweep.0.range.number: 0 given; allowed: ",
        ),
        ("sweep: [{field: duration, range: {start: 1}}]", "needs two of `stop`, `step` and `number`"),
        ("sweep: [{field: duration, range: {start: 1, stop: 2, step: -1}}]", "step: -1 given"),
        ("sweep: [{field: duration, values: [1]}, {field: duration, values: [1]}]", "'duration' given by two axes"),
        (
            "sweep: [{zip: [{field: seed, values: [1, 2]}, {field: duration, values: [1]}]}]",
            "axes of 2, 1 values given",
        ),
        (
            "sweep: [{name: a, rows: [{duration: 1}], labels: [1, 2]}]",
            "sweep.0: labels: 2 given; allowed: 1, one a row",
        ),
        ("sweep: [{rows: [{duration: 1}], labels: [1]}]", "labels: given; allowed: beside `rows` and a `name`"),
        (
            "margin: {field: link.up.0.delay, high: 1, tolerance: 0.1, across: who}",
            "margin.across: 'who' given; allowed: system, scenario, controller, scheme, link, seed",
        ),
        (
            "sweep: [{field: duratoin, values: [1]}]",
            "duratoin: unknown key (did you mean duration?); allowed: description, system, scenario",
        ),
        ("sweep: [{field: 'link up', values: [1]}]", "sweep.0.field: 'link up' given; allowed: "),
        (
            "sweep: [{field: link.up.0.delay, values: [-1]}]",
            "link.up.0.delay: -1 given; allowed: greater than or equal to 0",
        ),
        (
            "sweep: [{draws: {number: 2, variables: [{field: duration, distribution: normal, mean: 1}]}}]",
            "std: missing; allowed: normal with mean and std",
        ),
        (
            "sweep: [{draws: {number: 2, variables: [{field: duration, distribution: gumbel}]}}]",
            "distribution: 'gumbel' given; allowed: 'uniform', 'loguniform', 'normal' or 'lognormal'",
        ),
        (
            "margin: {field: link.up.0.delay, high: 1, tolerance: 0}",
            "margin.tolerance: 0 given; allowed: greater than 0",
        ),
        (
            "margin: {field: link.up.0.delay, low: 2, high: 1, tolerance: 0.1}",
            "high: 1 given; allowed: more than low, 2",
        ),
        ("margin: {field: link.up.0.delay, high: 1, tolerance: 0.1, criteria: [lost]}", "'lost' given; allowed: "),
        ("set: {controllers.0.name: PID}", "'PID' given; allowed: LLC"),
        (
            "sweep: [{field: seed, range: {step: 1, number: 2000}}, {field: duration, range: {step: 1, number: 2000}}]",
            "4000000 points given; allowed: at most 1000000",
        ),
    ],
)
def test_bad_studies_are_one_line_that_names_the_file(
    tmp_path: Path, text: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = study(tmp_path, text + "\n")
    assert main(["sweep", str(path), "--out", str(tmp_path / "out")]) == 2
    errors = capsys.readouterr().err
    assert said in errors
    assert errors.startswith(f"facts-damping: {path}: ") or "runs: " in errors
    assert errors.count("\n") == 1
    assert not (tmp_path / "out").exists()


# What is shipped


@pytest.mark.parametrize("name", sorted(shipped("studies")))
def test_shipped_studies_can_be_planned(name: str) -> None:
    plan = sweep.plan(name, [])
    assert plan.study.description
    assert plan.points


def test_example(tmp_path: Path) -> None:
    document = swept(tmp_path, "example")
    assert len(document["rows"]) == 16
    assert all(row["error"] is None for row in document["rows"])
    assert document["margins"] == []
    assert {row["scheme"] for row in document["rows"]} == {None, "direct"}


def test_report_has_the_runs_of_a_study_side_by_side_named_by_what_differs(tmp_path: Path) -> None:
    """Whose figures are those of the rows."""
    page = tmp_path / "out" / "report.html"
    chosen = ["--only", "delay=0.1", "--report", str(page)]
    rows = swept(tmp_path, study(tmp_path), *chosen)["rows"]
    text = page.read_text(encoding="utf-8")
    assert "2 runs side by side" in text
    for row in rows:
        assert f"{row['ITAE']:.4g}" in text
    assert re.findall(r"<label>.*?</span> *([^<]+)</label>", text) == ["5", "10"]


@pytest.mark.parametrize(
    ("text", "page", "said"),
    [
        (
            "sweep: [{field: duration, range: {start: 1, step: 1, number: 8}}]",
            "report.html",
            "--report: given with 8 runs; allowed: 1 to 7, chosen by --only COLUMN=VALUE,...",
        ),
        (
            "margin: {field: link.up.0.delay, high: 1, tolerance: 0.1}",
            "report.html",
            "--report: given with a study that searches margins; allowed: with other studies",
        ),
        (ONE, "nowhere/report.html", "nowhere/report.html: cannot be written; allowed: a file in an existing folder"),
    ],
)
def test_report_that_cannot_be_is_refused_before_anything_runs(
    tmp_path: Path, text: str, page: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert_one_line(
        2, ["sweep", str(study(tmp_path, text)), "--out", str(out), "--report", str(out / page)], said, capsys
    )
    assert not (out / sweep.JOURNAL).exists()


Place = tuple[tuple[str, str], ...]  # columns that tell a margin apart, with what they say
BRACKET = re.compile(r"[\d.]+ \[([\d.]+), ([\d.]+)\]|> ([\d.]+)|< ([\d.]+)")


def listed_margins(table: str, plan: sweep.SweepPlan) -> Iterator[tuple[str, Place, str]]:
    """Criterion, what tells a margin apart, and its bracket, of a table in the docs, as `sweep` writes it."""
    assert plan.study.margin is not None
    named = ("controller", "scheme", "scenario", "architecture", "gain", plan.study.margin.across)
    with (Path(__file__).parents[2] / "docs" / table).open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            low, high = row["low_s"], row["high_s"]
            text = {"high": f"> {low}", "low": f"< {high}", "": f"{row['margin_s']} [{low}, {high}]"}[row["beyond"]]
            place = {name: row[name] or "-" for name in named if name in row}
            yield row["criterion"], tuple(sorted(place.items())), text + ("" if row["converged"] == "true" else " ~")


@pytest.mark.parametrize(
    ("name", "table", "every"),
    [
        ("delay_margin", "images/delay_margin/margins.csv", 5),
        ("compensation", "images/compensation/margins.csv", 7),
        ("asymmetric_signals", "images/asymmetric_signals/margins.csv", 11),
        ("asymmetric_devices", "images/asymmetric_devices/margins.csv", 11),
    ],
)
def test_margins_in_the_docs_hold_at_their_lower_ends_and_fail_at_their_upper_ones(
    name: str, table: str, every: int
) -> None:
    """By single runs; they were found by `facts-damping sweep`. All points of the study are there, twice.

    Of them every so many are run, so that each value of each column is there.
    """
    plan = sweep.plan(name, [])
    margin = plan.study.margin
    assert margin is not None
    written = list(listed_margins(table, plan))
    assert len(written) == 2 * len(plan.points)
    finest = (margin.high - margin.low) / (margin.coarse - 1)
    while finest > margin.tolerance:
        finest /= 2
    points = {}
    for point in plan.points:
        identity = {
            **names(plan.base, point.changes)._asdict(),
            **batch.identity(make(plan.base, point.changes)),
            **point.columns,
        }
        identity["controller"] = re.sub(r"@\w+", "", identity["controller"])  # older tables have the kinds
        points[tuple(sorted((column_name, cell(identity[column_name])) for column_name, _ in written[0][1]))] = point
    tasks: dict[str, RunRequest] = {}
    expected: list[tuple[str, str, bool]] = []
    for criterion, place, text in written[::every]:
        if text.endswith("~"):  # not converged: another processor may do otherwise, as half the step does
            continue
        match = BRACKET.match(text)
        assert match, text
        low, high = match[1] or match[3], match[2] or match[4]
        for end, failed in ((low, False), (high, True)):
            if end is not None:  # the table is rounded; values that were run are multiples of the last step
                value = round(round(float(end) / finest) * finest, 9)
                both = axes.joined([points[place], axes.placed(margin, value)])
                key = f"{place} {value}"
                tasks[key] = RunRequest(key, both.changes, {})
                expected.append((key, criterion, failed))
    rows = dict(one_run(plan.base, task) for task in tasks.values())
    assert len(expected) >= 1.5 * len(written[::every]) - 2 * sum(text.endswith("~") for *_, text in written)
    assert [
        expected_end
        for expected_end in expected
        if fails(expected_end[1], rows[expected_end[0]].judged) is not expected_end[2]
    ] == []


def test_study_of_delay_margins_asks_for_every_controller_and_scenario() -> None:
    plan = sweep.plan("delay_margin", [])
    assert len(plan.points) == 3 * (2 + 2 * 11)
    assert len({json.dumps(point.changes, sort_keys=True) for point in plan.points}) == len(plan.points)


def test_progress_tells_what_is_left_and_leaves_out_what_was_there_before(monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    now, shown = [0.0], Terminal()
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    monkeypatch.setattr(sys, "stderr", shown)
    with Progress("mine", "runs") as progress:
        progress.resume(100)
        progress(100, 200)
        now[0] = 10.0
        progress(120, 200)
    first, second = shown.getvalue().split("\r")[1:]
    assert "100/200 runs, 0 s\x1b" in first
    assert "120/200 runs, 10 s, 40 s left" in second
