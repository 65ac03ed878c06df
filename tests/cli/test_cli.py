"""The commands as a user types them: exit status, one line on errors, JSON alone on standard output."""

from __future__ import annotations

import json
import os
import re
import signal
import struct
import subprocess
import sys
from argparse import Namespace
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from shutil import rmtree
from typing import IO, TYPE_CHECKING, Any

import pytest

from facts_damping.analysis.summary import summarise
from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.cli.reporting import check_ended_well
from facts_damping.cli.runs import out_folder
from facts_damping.errors import DegradedError
from facts_damping.input_files import share_folder
from facts_damping.nodes.launching.graph import Outcome
from facts_damping.parameters.files import new_folder
from facts_damping.record import NodeJoined, RefusedMessages
from facts_damping.simulation import loop
from facts_damping_studies.sweeps import results
from facts_damping_studies.sweeps.journal import Journal
from tests.commands import assert_one_line

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    Inside = Callable[..., str]


def call(*arguments: str, output: int | IO[str] = subprocess.PIPE) -> subprocess.CompletedProcess[str]:
    """The program as a process of its own."""
    command = [sys.executable, "-m", "facts_damping.cli.main", *arguments]
    return subprocess.run(command, stdout=output, stderr=subprocess.PIPE, text=True, check=False, timeout=300)


@pytest.fixture
def inside(capsys: pytest.CaptureFixture[str]) -> Iterator[Inside]:
    """The program within this process, which is quicker: standard output of a call that must succeed."""
    handler = signal.getsignal(signal.SIGTERM)

    def run(*arguments: str) -> str:
        status = main(list(arguments))
        out, err = capsys.readouterr()
        assert (status, err) == (0, "")
        return out

    yield run
    signal.signal(signal.SIGTERM, handler)


@pytest.fixture
def json_of(inside: Inside) -> Callable[..., Any]:
    """What a command says as JSON, with nothing around it."""
    return lambda *arguments: json.loads(inside(*arguments, "--json", "-"))


def test_digest_is_the_last_line_where_it_is_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    last_lines, run = [], ["simulate", "two_area_small", "--json", str(tmp_path / "result.json"), "--set"]
    for more in (["duration=2", "--digest"], ["duration=1", "--digest"], ["duration=2"]):
        assert main([*run, *more]) == 0
        last_lines.append(capsys.readouterr().out.splitlines()[-1])
    digest = json.loads((tmp_path / "result.json").read_text())["digest"]
    assert last_lines[0] == f"digest: {digest}"
    assert last_lines[1].startswith("digest: ")
    assert last_lines[1] != last_lines[0]
    assert not last_lines[2].startswith("digest")


def test_simulate_gives_the_promised_fields(json_of: Callable[..., Any]) -> None:
    result = json_of("simulate", "two_area_small", "--set", "link=delay_100ms")
    assert set(result["indices"]) == {"ITAE", "IAE", "ITSE", "ISE"}
    assert all(value > 0 for value in result["indices"].values())
    assert result["stable"] is True
    assert result["damped"] is True
    assert result["latency_ms"]["mean"] == pytest.approx(100.0)
    assert result["frames_lost"] == 0
    assert result["recording"] is None
    assert result["duration_s"] == 20.0
    assert result["run"]["link"] == "delay_100ms"
    assert len(result["digest"]) == 16
    assert {"facts_damping", "python", "processor", "numpy", "scipy", "numba", "llvmlite"} == result["versions"].keys()
    assert {"roughness", "settling_time_s", "max_injected_voltage_pu", "modes", "wall_s"} <= set(result)


def test_run_whose_device_let_go_ends_with_3_and_one_line() -> None:
    link = "link={up: [{model: bernoulli, loss: 1.0, start: 1.0}]}"
    done = call("simulate", "--set", "duration=2", "--set", link, "--json", "-")
    assert done.returncode == 3
    assert done.stderr == "facts-damping: the run ended, but: sssc was released at 1.20 s: no setpoint for 0.2 s\n"
    assert json.loads(done.stdout)["releases"][0]["device"] == "sssc"


@pytest.mark.parametrize(("json_to", "named"), [("/dev/full", "/dev/full"), ("-", "standard output")])
def test_full_disk_is_told_in_one_line(json_to: str, named: str) -> None:
    with Path("/dev/full" if json_to == "-" else os.devnull).open("w") as output:
        done = call("list", "runs", "--json", json_to, output=output)
    assert done.returncode == 2
    problem = "cannot be written: No space left on device; allowed: a place with room for it"
    assert done.stderr == f"facts-damping: {named}: {problem}\n"


def test_unstable_run_is_a_result(json_of: Callable[..., Any]) -> None:
    result = json_of("simulate", "two_area_large", "--set", "controllers=[]")
    assert result["stable"] is False
    assert result["damped"] is False
    assert result["indices"] is None
    assert result["duration_s"] < 20.0
    assert result["latency_ms"] is None or result["latency_ms"]["mean"] is None


def test_control_damps_what_grows_without_it(json_of: Callable[..., Any]) -> None:
    without = json_of("simulate", "two_area_small", "--set", "controllers=[]")
    with_control = json_of("simulate", "two_area_small")
    assert without["stable"] is True
    assert without["damped"] is False
    assert with_control["damped"] is True
    for name, value in with_control["indices"].items():
        assert value < 0.5 * without["indices"][name]


def test_simulate_writes_pictures(tmp_path: Path, inside: Inside) -> None:
    inside("simulate", "two_area_small", "--set", "duration=3", "--out", str(tmp_path / "out"))
    pictures = sorted((tmp_path / "out").glob("*.png"))
    assert {p.stem for p in pictures} >= {"speeds", "tie_power", "injected_voltage"}
    assert all(p.read_bytes().startswith(b"\x89PNG") and p.stat().st_size > 5000 for p in pictures)
    assert (tmp_path / "out" / "result.json").is_file()


def test_modes_of_two_area_are_the_thesis_s(json_of: Callable[..., Any]) -> None:
    result = json_of("modes", "two_area")
    buses = {bus["name"]: bus for bus in result["power_flow"]["buses"]}
    # Thesis 4.5.2, four digits on 900 MVA.
    for name, p, q in [("B1", 0.7778, 0.1021), ("B2", 0.7777, 0.1307), ("B3", 0.7989, 0.0914), ("B4", 0.7778, 0.0919)]:
        assert buses[name]["p_mw"] / 900 == pytest.approx(p, abs=2e-4)
        assert buses[name]["q_mvar"] / 900 == pytest.approx(q, abs=2e-4)
    interarea = [mode for mode in result["modes"] if 0.3 < mode["frequency_hz"] < 0.9]
    assert len(interarea) == 1
    assert 0.60 < interarea[0]["frequency_hz"] < 0.66
    assert -0.03 < interarea[0]["damping_ratio"] < 0.0
    assert max(interarea[0]["participation"], key=interarea[0]["participation"].get).split(".")[1] in ("delta", "omega")


@pytest.mark.parametrize(
    ("kind", "some"),
    [("systems", "two_area"), ("scenarios", "two_area/small"), ("controllers", "LLC"), ("links", "delay_100ms")],
)
def test_list_names_what_there_is(json_of: Callable[..., Any], kind: str, some: str) -> None:
    assert some in {row["name"] for row in json_of("list", kind)}


@pytest.mark.parametrize(
    "arguments",
    [
        ["simulate", "no_such_run"],
        ["simulate", "no_such_file.yaml"],
        ["simulate", "--set", "frame_rate=fast"],
        ["simulate", "--frobnicate"],
        ["simulate", "two_area_small", "--set", "scenario.0.load=load_9"],
        ["run", "two_area_small", "--mode", "warp"],
        ["run", "two_area_small", "--timeout", "-1"],
        ["modes", "no_such_system"],
        ["modes", "two_area", "--set", "machines.0.H=-1"],
        ["analyze", "no_such_recording"],
        ["simulate", "--out", "/proc/nowhere/out"],
        ["simulate", "--json", "no/such/folder/result.json"],
        ["run", "--json", "no/such/folder/result.json"],
        ["list", "unicorns"],
        ["frobnicate"],
    ],
    ids=" ".join,
)
def test_bad_input_is_exit_2_one_line_and_nothing_else(
    tmp_path: Path, arguments: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert_one_line(2, arguments, "facts-damping: ", capsys)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("arguments", [["run", "two_area_small", "--set", "scenario.0.load=load_9"], []], ids=" ".join)
def test_process_says_no_more_of_bad_input(
    tmp_path: Path, arguments: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = call(*arguments)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert done.stderr.startswith("facts-damping: ")
    assert list(tmp_path.iterdir()) == []


MODE = {"real", "imag", "frequency_hz", "damping_ratio", "label", "participation", "shape", "residues"}


def test_modes_with_both_devices_gives_the_promised_fields_and_pictures(tmp_path: Path, inside: Inside) -> None:
    """JSON in a file, pictures in a folder, a table for people."""
    out, path = tmp_path / "modes", tmp_path / "modes.json"
    text = inside("modes", "two_area", "--devices", "sssc,statcom", "--out", str(out), "--json", str(path))
    result = json.loads(path.read_text())
    assert set(result) == {"power_flow", "devices", "modes", "transfer_functions", "relative_gains"}
    assert result["devices"] == ["sssc", "statcom"]
    assert all(set(mode) == MODE for mode in result["modes"])
    swings = [mode for mode in result["modes"] if mode["residues"]]
    assert [mode["label"] for mode in swings] == ["interarea", "local", "local"]
    washed = ["power", "power_rate", "voltage", "angle", "angle_rate"]
    signals = ["w12", "w34", "w13", "speed", "frequency", "f12", "f34", "f13", *washed]
    channels = [(device, signal) for device in ("sssc", "statcom") for signal in signals]
    for mode in swings:
        assert [(r["device"], r["signal"]) for r in mode["residues"]] == channels
        assert set(mode["residues"][0]) == {"device", "signal", "magnitude", "angle_deg", "sign", "lead_deg"}
        assert {r["sign"] for r in mode["residues"]} <= {1, -1}
        assert set(mode["shape"]) == {"G1", "G2", "G3", "G4"}
        assert max(polar["magnitude"] for polar in mode["shape"].values()) == pytest.approx(1)
    assert [(t["device"], t["signal"]) for t in result["transfer_functions"]] == channels
    states = sum(1 if mode["imag"] == 0 else 2 for mode in result["modes"])
    for t in result["transfer_functions"]:
        assert set(t) == {"device", "signal", "gain", "zeros", "poles", "feedthrough", "dead_time_s"}
        assert len(t["poles"]) == states + (t["signal"] in washed)
    pictures = sorted(out.iterdir())
    assert [p.name for p in pictures] == ["mode_shapes.png", "one_line.png", "transfer_functions.png"]
    assert all(p.read_bytes().startswith(b"\x89PNG") and p.stat().st_size > 10_000 for p in pictures)
    assert all(f"plot: {p}" in text for p in pictures)
    assert "devices installed: sssc, statcom\n" in text
    assert "0.6423 Hz, interarea: machines that swing against each other\n" in text


def test_modes_without_devices_has_no_inputs(tmp_path: Path, inside: Inside) -> None:
    result = json.loads(inside("modes", "two_area", "--devices", "none", "--out", str(tmp_path), "--json", "-"))
    assert result["devices"] == result["transfer_functions"] == []
    assert [mode["residues"] for mode in result["modes"]] == [[]] * len(result["modes"])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["mode_shapes.png", "one_line.png"]
    assert json.loads(inside("modes", "two_area", "--json", "-"))["devices"] == ["sssc"]
    assert json.loads(inside("modes", "kundur_12_6", "--json", "-"))["devices"] == []


def test_modes_starts_from_the_dispatch_of_a_scenario(inside: Inside) -> None:
    """Heavy loading of the single machine: 2100 MW, and a mode that grows."""
    starts = {}
    for scenario in ("heavy", "light"):
        result = json.loads(inside("modes", "smib", "--scenario", scenario, "--json", "-"))
        (mode,) = [mode for mode in result["modes"] if mode["label"] == "local"]
        starts[scenario] = next(b["p_mw"] for b in result["power_flow"]["buses"] if b["name"] == "B1"), mode
    assert starts["heavy"][0] == pytest.approx(2100)
    assert starts["light"][0] == pytest.approx(840)
    assert starts["heavy"][1]["frequency_hz"] == pytest.approx(1.236, abs=5e-4)
    assert starts["heavy"][1]["damping_ratio"] == pytest.approx(-0.005, abs=5e-4)
    assert starts["light"][1]["damping_ratio"] > 0.05


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["two_area", "--devices", "tcsc"], "--devices: 'tcsc' given; allowed: sssc, statcom"),
        (["two_area", "--devices", "sssc,sssc"], "--devices: 'sssc' given; allowed: statcom"),
        (["kundur_12_6", "--devices", "sssc"], "--devices: 'sssc' given; allowed: none"),
        (["smib", "--scenario", "large"], "'large' given; allowed: heavy, light, multiple, nominal"),
        (["two_area", "--out", "/proc/nowhere/out"], "/proc/nowhere/out"),
        (["two_area", "--json", "no/such/folder/modes.json"], "no/such/folder"),
    ],
)
def test_modes_refuses_what_is_not_there(
    arguments: list[str], said: str, inside: Inside, capsys: pytest.CaptureFixture[str]
) -> None:
    assert_one_line(2, ["modes", *arguments], said, capsys)


def test_degraded_run_is_told_in_one_line() -> None:
    record = loop.run(load_case(None, ["duration=0.2"]))
    result = summarise(record)
    check_ended_well(result, record)
    sound = Outcome(Path("recording"), 1.0, len(record.time_ns), 0, 0, {}, [], {})
    check_ended_well(result, record, sound)
    refused = {
        ("wan_link", "publisher", "/pmu/frames", "/forger"): 3,
        ("wan_link", "publisher", "/diagnostics", "x"): 9,
    }
    fallen = ["controller_0_LLC was killed by SIGKILL"]
    bad = replace(sound, ticks=sound.ticks + 5, messages_refused=refused, fallen=fallen)
    said = (
        "the run ended, but: /n joined at 1.00 s, disarmed; controller_0_LLC was killed by SIGKILL; "
        "refused messages: 3 by publisher; the recorder lost 2 messages; 5 of 17 ticks were not recorded; "
        "of tick 7 not all was recorded"
    )
    joined = replace(result, joined=[NodeJoined("/n", 1.0, None)])
    with pytest.raises(DegradedError) as caught:
        check_ended_well(joined, replace(record, gap_tick=7, messages_lost=2), bad)
    assert str(caught.value) == said
    recorded = [RefusedMessages("/wan_link", "/pmu/frames", "publisher", "/forger", 2)]
    reason = r"refused messages: 2 by publisher; 5 of 17 ticks were not recorded$"  # as the table of the recording
    with pytest.raises(DegradedError, match=reason):
        check_ended_well(replace(result, refused_messages=recorded), record, bad)


ADAPTS = ["simulate", "two_area_small", "--set", "controllers.0.name=HBsWC", "--set", "duration=0.2"]
REMOVED = {
    "simulate": (ADAPTS, "facts_damping.analysis.plotting.plots.plot_comparison", "out/result.json"),
    "sweep, runs": (["sweep", "study.yaml", "--jobs", "1"], f"{Journal.__module__}.Journal.append", "out/rows.jsonl"),
    "sweep, end": (["sweep", "study.yaml", "--jobs", "1"], f"{results.__name__}.write", "out/rows.parquet"),
}


@pytest.mark.parametrize("when", REMOVED)
def test_folder_that_is_removed_under_way_ends_the_command_in_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], when: str
) -> None:
    """It is not made again: what was in it is lost."""
    command, place, named = REMOVED[when]
    monkeypatch.chdir(tmp_path)
    Path("study.yaml").write_text(
        "run: two_area_small\nset: {duration: 0.2}\nsweep: [{field: seed, values: [1, 2]}]\n", encoding="utf-8"
    )
    module, _, name = place.rpartition(".")
    holder = Journal if module.endswith("Journal") else sys.modules.get(module) or import_module(module)
    before = getattr(holder, name)

    def removing(*positional: Any) -> Any:
        rmtree("out", ignore_errors=True)
        return before(*positional)

    monkeypatch.setattr(holder, name, removing)
    assert main([*command, "--out", "out"]) == 2
    errors = capsys.readouterr().err
    assert errors.startswith(f"facts-damping: {named}: cannot be written: ")
    assert errors.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["study.yaml"]


def test_runs_of_the_same_second_have_folders_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("time.strftime", lambda _: "20260101-120000")
    folders = [new_folder(out_folder(Namespace(out=None), "one")) for _ in range(3)]
    assert [folder.name for folder in folders] == [f"20260101-120000-one{more}" for more in ("", "-2", "-3")]


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (
            "simulate comparison",
            "runs: 'comparison' given, one of the studies, which `facts-damping sweep` takes; allowed: ",
        ),
        (
            "sweep two_area_small",
            "'two_area_small' given, one of the runs, which `facts-damping simulate` takes; allowed: ",
        ),
        (
            "sweep config/runs/two_area_small.yaml",
            "small.yaml: one of the runs given, which `facts-damping simulate` takes",
        ),
        (
            "simulate config/studies/comparison.yaml",
            "comparison.yaml: one of the studies given, which `facts-damping sweep`",
        ),
        (
            "simulate two_area_small controllers.0.name=LLC",
            "given (did you mean --set controllers.0.name=LLC?); allowed: ",
        ),
        ("simulate --set link=pcdi", "links: 'pcdi' given (did you mean pdci?); allowed: "),
        ("simulate --set controllers.0.name=LCC", "'LCC' given (did you mean LLC?); allowed: LLC, "),
        (
            "simulate --set controller.0.gain=12",
            "--set controller.0.gain=12: controller: unknown key (did you mean controllers?)",
        ),
        (
            "simulate --set link=csg --set link.up.0.delay=5Hz",
            "--set link.up.0.delay=5Hz: link.up.0.delay: '5Hz' given; allowed: a ",
        ),
        (
            "simulate --set link=csg --set link.up.0.delay=70",
            "delay: 70 given; allowed: less than or equal to 60, in s",
        ),
    ],
)
def test_error_of_a_mistyped_command_suggests_what_was_meant(
    command: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert_one_line(2, command.split(), said, capsys)


def test_missing_fields_of_a_device_are_named_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With unit, range and a usual value."""
    system = (share_folder() / "config" / "systems" / "two_area.yaml").read_text(encoding="utf-8")
    path = tmp_path / "grid.yaml"
    path.write_text(re.sub(r"kind: statcom, bus: B8W, .*}", "kind: statcom}", system))
    said = "devices.1: bus, setpoint_max, rate_max, I_max: missing; allowed: bus: a value of this field; "
    said += "setpoint_max: in p.u., "
    assert_one_line(2, ["modes", str(path)], f"{path}: {said}more than 0, at most 1, usual 0.1; rate_max: ", capsys)


def test_pictures_for_a_paper(tmp_path: Path) -> None:
    """As wide as a column, in the format that is asked for, with text of its size."""
    asked = ["simulate", "--set", "duration=2", "--width", "8.8", "--font", "8", "--out", str(tmp_path)]
    for ending in ("png", "pdf", "svg"):
        assert main([*asked, "--format", ending]) == 0
    assert {path.stem for path in tmp_path.glob("*.pdf")} == {path.stem for path in tmp_path.glob("*.png")}
    width, _ = struct.unpack(">II", (tmp_path / "speeds.png").read_bytes()[16:24])
    assert width == round(8.8 / 2.54 * 300)
    assert (tmp_path / "speeds.pdf").read_bytes()[:5] == b"%PDF-"
    drawn = (tmp_path / "speeds.svg").read_text(encoding="utf-8")
    assert float(re.findall(r'width="([\d.]+)pt"', drawn)[0]) == pytest.approx(8.8 / 2.54 * 72, abs=0.01)
    assert main(["simulate", "--set", "duration=2", "--out", str(tmp_path / "usual")]) == 0
    width, _ = struct.unpack(">II", (tmp_path / "usual" / "speeds.png").read_bytes()[16:24])
    assert width == 1350
