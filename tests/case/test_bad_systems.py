"""Systems that cannot be: each is refused in one line that names the field, what was given and what is allowed."""

from __future__ import annotations

import copy
import signal
from typing import TYPE_CHECKING, Any

import pytest

from facts_damping.case.loading import installed, load_case, load_system, make_case
from facts_damping.cli.main import main
from facts_damping.errors import InputError
from facts_damping.parameters.field_errors import check
from facts_damping.parameters.plant.system import System
from facts_damping.parameters.yaml_text import dump
from tests import two_plants
from tests.case.test_loading import assert_one_line

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

Changes = dict[str, Any]
NAMES = {"two_area": "two_area", "smib": "smib", **{name: two_plants.path(name) for name in two_plants.NAMES}}
SYSTEMS = {name: load_system(at).model_dump(by_alias=True) for name, at in NAMES.items()}


def altered(name: str, changes: Changes) -> dict[str, Any]:
    """A shipped system with other values at key paths: `+` adds a row, a value of ... takes the key away."""
    content = copy.deepcopy(SYSTEMS[name])
    for path, value in changes.items():
        *keys, last = path.split(".")
        here: Any = content
        for key in keys:
            here = here[int(key) if isinstance(here, list) else key]
        if last == "+":
            here.append(value)
        elif value is ...:
            del here[last]
        else:
            here[int(last) if isinstance(here, list) else last] = value
    return content


def sssc(name: str, **fields: Any) -> dict[str, Any]:
    return {"name": name, "kind": "sssc", **fields}


IN_LINE_1 = sssc("second", line="line_1")
ONE_PLACE = "where first stands already; allowed: one device in a line, or between two buses"
ONE_BALANCE = "allowed: exactly one, or none beside an infinite bus"

# Name of the case: system, what is changed, what the message must say.
REFUSED: dict[str, tuple[str, Changes, str]] = {
    "device in a line that is not there": (
        "two_area",
        {"devices.+": sssc("second", line="line_99")},
        "devices: second.line: 'line_99' given; allowed: line_1, line_10_11, line_2",
    ),
    "device in a transformer": (
        "two_area",
        {"devices.+": sssc("second", line="T1")},
        "devices: second.line: 'T1' given; allowed: line_1",
    ),
    "two in one line": (
        "two_area",
        {"devices.0": sssc("first", line="line_1"), "devices.+": IN_LINE_1},
        f"devices: second: 'line_1' given, {ONE_PLACE}",
    ),
    "two in one line, at its two ends": (
        "two_area",
        {"devices.0": sssc("first", line="line_1"), "devices.+": {**IN_LINE_1, "end": "to"}},
        f"devices: second: 'line_1' given, {ONE_PLACE}",
    ),
    "two between the same buses": (
        "two_area",
        {"devices.0.name": "first", "devices.+": sssc("second", **{"from": "B8E", "to": "B8W"})},
        f"devices: second: 'B8E to B8W' given, {ONE_PLACE}",
    ),
    "device from a bus to itself": (
        "two_area",
        {"devices.+": sssc("second", **{"from": "B7", "to": "B7"})},
        "devices: second.to: 'B7' given twice; allowed: two different buses",
    ),
    "device at a bus that is not there": (
        "two_area",
        {"devices.+": sssc("second", **{"from": "B7", "to": "B77"})},
        "devices: second.to: 'B77' given; allowed: B1, B10",
    ),
    "device with one bus": ("two_area", {"devices.+": sssc("second", **{"from": "B7"})}, "needs either `line`, or"),
    "device with no place": (
        "two_area",
        {"devices.+": sssc("second")},
        "devices.2: a device in series needs either `line`, or",
    ),
    "device with two places": (
        "two_area",
        {"devices.+": {**IN_LINE_1, "from": "B7", "to": "B8W"}},
        "devices.2: a device in series needs either `line`, or `from` and `to`",
    ),
    "end that a line does not have": (
        "two_area",
        {"devices.+": {**IN_LINE_1, "end": "middle"}},
        "devices.2.end: 'middle' given; allowed: 'from' or 'to'",
    ),
    "name given twice": ("two_area", {"devices.+": {**IN_LINE_1, "name": "sssc"}}, "'sssc' stands twice"),
    "name of a line": ("two_area", {"devices.+": {**IN_LINE_1, "name": "line_1"}}, "'line_1' stands twice"),
    "statcom without a limit of its offset": (
        "two_area",
        {"devices.1.setpoint_max": ...},
        "devices.1.setpoint_max: missing",
    ),
    "statcom without a limit of the rate": ("two_area", {"devices.1.rate_max": ...}, "devices.1.rate_max: missing"),
    "statcom without a limit of its current": ("two_area", {"devices.1.I_max": ...}, "devices.1.I_max: missing"),
    "statcom with no current": ("two_area", {"devices.1.I_max": 0.0}, "I_max: 0.0 given; allowed: greater than 0"),
    "statcom at a bus that is not there": (
        "two_area",
        {"devices.1.bus": "B99"},
        "statcom.bus: 'B99' given; allowed: B1",
    ),
    "field of another kind of device": (
        "two_area",
        {"devices.1.xs": 0.1},
        "devices.1.xs: 0.1 given; allowed for kind statcom: name, kind, response_time, dead_time, bus",
    ),
    "device of no kind": (
        "two_area",
        {"devices.1.kind": "upfc"},
        "kind: 'upfc' given; allowed: 'sssc', 'statcom', 'hvdc'",
    ),
    "negative inertia": ("two_area", {"machines.0.H": -6.5}, "machines.0.H: -6.5 given; allowed: greater than 0"),
    "no inertia": ("two_area", {"machines.0.H": 0.0}, "machines.0.H: 0.0 given; allowed: greater than 0"),
    "fractions above one": (
        "two_area",
        {"loads.0.P_fractions": {"impedance": 0.5, "power": 0.6}},
        "loads.0.P_fractions: impedance + current + power must be 1, given 1.1",
    ),
    "fractions below one": (
        "two_area",
        {"loads.1.Q_fractions": {"current": 0.5}},
        "loads.1.Q_fractions: impedance + current",
    ),
    "no fractions": ("two_area", {"loads.1.Q_fractions": {}}, "must be 1, given 0"),
    "negative fraction": (
        "two_area",
        {"loads.1.Q_fractions": {"impedance": 1.2, "power": -0.2}},
        "loads.1.Q_fractions.impedance: 1.2 given; allowed: less than or equal to 1",
    ),
    "load that is an impedance from no voltage on": ("two_area", {"loads.1.V_min": 0.0}, "loads.1.V_min: 0.0 given"),
    "stabiliser of an unknown machine": (
        "two_area",
        {"stabilisers.0.machine": "G9"},
        "stabilisers.0.machine: 'G9' given; allowed: G1, G2, G3, G4",
    ),
    "governor of an unknown machine": ("two_area", {"governors.3.machine": "G9"}, "governors.3.machine: 'G9' given"),
    "exciter of an unknown machine": ("two_area", {"exciters.1.machine": "G9"}, "exciters.1.machine: 'G9' given"),
    "two exciters of one machine": ("two_area", {"exciters.1.machine": "G1"}, "'G1' stands twice"),
    "two stabilisers of one machine": ("two_area", {"stabilisers.1.machine": "G1"}, "'G1' stands twice"),
    "two governors of one machine": ("two_area", {"governors.1.machine": "G1"}, "'G1' stands twice"),
    "stabiliser without an exciter": (
        "two_area",
        {"exciters": SYSTEMS["two_area"]["exciters"][:2], "stabilisers.2.enabled": True},
        "stabilisers.2.machine: 'G3' given, which has no exciter; allowed: G1, G2",
    ),
    "exciter of a machine without a field": (
        "two_area",
        {"machines.0.model": "classical"},
        "exciters.0.machine: 'G1' given; allowed: G2, G3, G4",
    ),
    "area of some machines": (
        "two_area",
        {"machines.2.area": None},
        "machines.*.area: given for some machines; allowed:",
    ),
    "subtransient reactance missing": (
        "two_area",
        {"machines.0.Xq2": None},
        "machines.0: a machine of model cascade needs Xq2",
    ),
    "leakage and a time constant missing": (
        "two_area",
        {"machines.1.model": "genrou", "machines.1.Xl": None, "machines.1.Td02": None},
        "machines.1: a machine of model genrou needs Xl, Td02",
    ),
    "synchronous reactance missing": (
        "two_area",
        {"machines.0.model": "two_axis", "machines.0.Xd": None},
        "two_axis needs Xd",
    ),
    "transient reactance missing": (
        "two_area",
        {"machines.0.model": "classical", "machines.0.Xd1": None},
        "machines.0: a machine of model classical needs Xd1",
    ),
    "machine of no model": ("two_area", {"machines.0.model": "ideal"}, "model: 'ideal' given; allowed: 'classical'"),
    "half a circuit of the q axis": (
        "two_area",
        {"machines.0.Xq1": None},
        "Xq1 and Tq01 must be given both or neither",
    ),
    "reactances that rise": ("two_area", {"machines.0.Xd1": 0.2}, "Xl < Xd2 < Xd1 < Xd must hold"),
    "saturation that falls": ("two_area", {"machines.0.S10": 0.3, "machines.0.S12": 0.2}, "S10 must be below S12"),
    "saturation by half": ("two_area", {"machines.0.S10": 0.3}, "S10 = 0.3 needs S12 above it"),
    "two voltages at one bus": (
        "two_area",
        {"machines.0.bus": "B2", "machines.0.V": 1.01},
        "machines.*.V: 1.01 of G1, 1 of G2 given at bus B2; allowed: one voltage",
    ),
    "a machine at an infinite bus": ("smib", {"machines.0.bus": "B4"}, "'B4' stands twice; allowed: each name once"),
    "two slack machines": (
        "two_area",
        {"machines.0.slack": True, "machines.0.P": None},
        f"machines.*.slack: 2 slack machines given (G1, G2); {ONE_BALANCE}",
    ),
    "no slack machine": (
        "two_area",
        {"machines.1.slack": False, "machines.1.P": 700.0},
        f"machines.*.slack: 0 slack machines given (); {ONE_BALANCE}",
    ),
    "slack machine with a power": (
        "two_area",
        {"machines.1.P": 700.0},
        "P must be given for every machine but the slack",
    ),
    "slack machine beside an infinite bus": (
        "smib",
        {"machines.0.slack": True, "machines.0.P": None},
        f"machines.*.slack: 1 slack machines given (G1); {ONE_BALANCE}",
    ),
    "infinite bus at a machine": ("smib", {"infinite_buses.0.bus": "B1"}, "'B1' stands twice"),
    "infinite bus at no bus": (
        "smib",
        {"infinite_buses.0.bus": "B9"},
        "infinite_buses: GRID.bus: 'B9' given; allowed: B1",
    ),
    "infinite bus without voltage": (
        "smib",
        {"infinite_buses.0.V": 0.0},
        "infinite_buses.0.V: 0.0 given; allowed: greater",
    ),
    "nothing that balances": ("smib", {"infinite_buses": []}, ONE_BALANCE),
    "tap of zero": (
        "two_area",
        {"transformers.0.tap": 0.0},
        "transformers.0.tap: 0.0 given; allowed: greater than 0.5",
    ),
    "gate without room": ("two_area", {"governors.0.gate_min": 1.0}, "governors.0: gate_min must be below gate_max"),
    "transducer too fast": ("two_area", {"exciters.0.TR": 0.001}, "exciters.0: TR must be 0 or at least 0.002 s"),
    "field of the other exciter": (
        "two_area",
        {"exciters.0.TA": 0.055},
        "exciters.0.TA: 0.055 given; allowed for model static: machine, model, KA, TR, KF, TF, minimum, maximum, TB",
    ),
    "exciter constant of an exciter that names no model": (
        "two_area",
        {"exciters.0": {"machine": "G1", "KE": 1.0}},
        "exciters.0.KE: 1.0 given; allowed for model static: machine, model, KA",
    ),
    "gain reduction at a DC exciter": (
        "two_area",
        {"exciters.0": {"machine": "G1", "model": "dc", "TB": 10.0}},
        "exciters.0.TB: 10.0 given; allowed for model dc: machine, model, KA, TR, KF, TF, minimum, maximum, TA, KE",
    ),
    "exciter of no model": (
        "two_area",
        {"exciters.0.model": "ac4a"},
        "exciters.0.model: 'ac4a' given; allowed: 'static', 'dc'",
    ),
    "gain reduction too fast": ("two_area", {"exciters.0.TB": 0.005}, "exciters.0: TB must be 0 or at least 0.01 s"),
    "half a gain reduction": ("two_area", {"exciters.0.TC": 1.0}, "exciters.0: TC = 1 needs TB above 0"),
    "control of an unknown inverter": (
        "solar",
        {"inverter_controls.1.inverter": "WIND"},
        "inverter_controls.1.inverter: 'WIND' given; allowed: SOLAR",
    ),
    "input of an unknown inverter": (
        "solar",
        {"devices.0.inverter": "G1"},
        "devices: pod_p.inverter: 'G1' given; allowed: SOLAR",
    ),
    "two controls of one sort": (
        "solar",
        {"inverter_controls.+": {**SYSTEMS["solar"]["inverter_controls"][1], "RefFlag": 0}},
        "inverter_controls.2: REPCA1 given for SOLAR, which has REPCA1; allowed: one control of each sort",
    ),
    "branch elsewhere": (
        "solar",
        {"inverter_controls.1.bus": "B2", "inverter_controls.1.branch": "line_1"},
        "inverter_controls.1.branch: 'line_1' given; allowed: line_3",
    ),
    "inverter without power": (
        "solar",
        {"inverters.0.P": None},
        "inverters.0: P, V: none given; allowed: P, or V for the slack or at its bus",
    ),
    "inverter without power away from the slack": (
        "solar",
        {"inverters.0.P": None, "inverters.0.V": 1.0},
        "inverters: SOLAR.P: none given; allowed: at the bus of the slack",
    ),
    "inverter of no model": ("solar", {"inverters.0.model": "REGC"}, "inverters.0.model: 'REGC' given; allowed: "),
    "inverter with the name of a machine": (
        "solar",
        {"inverters.0.name": "G1", "devices": [], "inverter_controls": []},
        "machines, inverters: 'G1' stands twice",
    ),
    "grid without a source": (
        "solar",
        {"machines": []},
        "machines: none given; allowed: at least one, an infinite bus, or a grid-forming inverter",
    ),
    "speed where there is no rotor": (
        "solar",
        {"signals.w12.weights": {"G1": 1.0, "SOLAR": -1.0}},
        "signals: w12 (speed_deviation).weights: 'SOLAR' given; allowed: G1, G2",
    ),
    "area of machines alone": (
        "battery",
        {"machines.0.area": "west", "machines.1.area": "east"},
        "machines.*.area: given for some machines; allowed: for all, and all grid-forming inverters, or for none",
    ),
    "PMU that measures a line elsewhere": (
        "two_area",
        {"pmus.4.branches": ["line_4"]},
        "pmus: TIE.branches: 'line_4' given; allowed: line_1, line_2, sssc",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_system_is_refused_by_name_in_one_line(case: str) -> None:
    name, changes, said = REFUSED[case]
    with pytest.raises(InputError) as caught:
        check(System, altered(name, changes), "my.yaml")
    assert str(caught.value).startswith("my.yaml: ")
    assert said in str(caught.value)
    assert_one_line(caught.value)
    with pytest.raises(InputError, match=r"^run\.yaml: system") as caught:
        make_case({"system": altered(name, changes)}, "run.yaml")
    assert_one_line(caught.value)


@pytest.mark.parametrize("name", SYSTEMS)
def test_system_is_valid_before_it_is_altered(name: str) -> None:
    assert check(System, altered(name, {}), "my.yaml") == load_system(NAMES[name])


@pytest.fixture
def _polite() -> Iterator[None]:
    """The program installs a handler of its own."""
    before = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, before)


@pytest.mark.usefixtures("_polite")
@pytest.mark.parametrize(
    "case",
    [
        "device in a line that is not there",
        "two in one line",
        "statcom without a limit of its current",
        "negative inertia",
        "fractions above one",
        "stabiliser without an exciter",
        "slack machine beside an infinite bus",
    ],
)
def test_commands_end_with_2_and_one_line(case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A file of one's own, named in the message."""
    name, changes, said = REFUSED[case]
    path = tmp_path / "my.yaml"
    path.write_text(dump(altered(name, changes)))
    for arguments in (["modes", str(path)], ["simulate", "--set", f"system={path}"]):
        assert main(arguments) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert err.count("\n") == 1
        assert str(path) in err
        assert said in err


@pytest.mark.usefixtures("_polite")
@pytest.mark.parametrize(
    ("dispatch", "said"),
    [
        ({"G9": 700.0}, "dispatch: 'G9' given; allowed: G1, G3, G4"),
        ({"G2": 700.0}, "dispatch: 'G2' given; allowed: G1, G3, G4"),  # the slack machine
        ({"G1": "much"}, "dispatch.G1: 'much' given; allowed: a valid number"),
    ],
)
def test_dispatch_of_what_is_not_scheduled_is_refused(
    dispatch: dict[str, Any], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "my.yaml"
    path.write_text(dump({"name": "my", "dispatch": dispatch}))
    for arguments in (["modes", "two_area", "--scenario", str(path)], ["simulate", "--set", f"scenario={path}"]):
        assert main(arguments) == 2
        out, err = capsys.readouterr()
        assert (out, err.count("\n")) == ("", 1)
        assert str(path) in err
        assert said in err


@pytest.mark.parametrize("devices", ["[sssc, sssc]", "[sssc, statcom, sssc]"])
def test_device_installed_twice_is_refused(devices: str) -> None:
    with pytest.raises(InputError, match=r"devices\.\d: 'sssc' given twice; allowed: each once"):
        load_case(None, [f"devices={devices}"])
    with pytest.raises(
        InputError, match=r"--devices: 'sssc' given; allowed: statcom|--devices: 'sssc' given; allowed: none"
    ):
        installed(load_system("two_area"), devices.strip("[]").replace(" ", ""))


def test_device_that_the_system_does_not_have_is_refused() -> None:
    with pytest.raises(InputError, match=r"devices\.1: 'statcom' given; allowed: sssc"):
        load_case(None, ["system=smib", "scenario=nominal", "devices=[sssc, statcom]"])
    with pytest.raises(InputError, match="--devices: 'statcom' given; allowed: sssc"):
        installed(load_system("smib"), "statcom")
