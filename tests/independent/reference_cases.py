"""Systems and courses on which the package is compared with the reference model, by name.

Bounds are of speeds, a few times the measured differences. Smooth courses agree to 1e-10 p.u. and better. Where
a limit acts, the package's fixed step meets it somewhere within a step: see `limited`. STATCOMs are as quick as 1 ms.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.parameters.plant.placement import place
from facts_damping.parameters.plant.system import System
from tests.plant.running import shipped

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.independent.reference_devices import Targets

Row = dict[str, Any]


class Case(NamedTuple):
    """A system's content, what happens, setpoints by device, the course's length (s), its bound (p.u.)."""

    system: Callable[[], Row]
    events: list[Row]
    targets: dict[str, Targets]
    end: float
    bound: float
    method: str = "DOP853"  # of the reference; implicit where a STATCOM is at a limit of its current
    step: float = 1 / 480

    def build(self) -> System:
        """The system, checked as one that is read."""
        return place(System.model_validate({**self.system(), "step": self.step}))


MACHINES = ("G1", "G2", "G3", "G4")
IMPEDANCE, CURRENT, POWER = ({kind: 1.0} for kind in ("impedance", "current", "power"))
MIXED_P, MIXED_Q = {"power": 0.3, "current": 0.5, "impedance": 0.2}, {"power": 0.1, "current": 0.4, "impedance": 0.5}
SATURATION = {"S10": 0.04, "S12": 0.22}
SALIENT = {"Xq1": None, "Tq01": None}
APART = {"Xd2": 0.22, "Xq2": 0.3}  # subtransient reactances of the two axes
STATIC = {"model": "static", "KA": 200.0, "TR": 0.02}
FEEDBACK = {"model": "static", "KA": 150.0, "TR": 0.0, "KF": 0.01, "TF": 0.5}
REDUCED = {"model": "static", "KA": 200.0, "TR": 0.01, "TB": 10.0, "TC": 1.0}
DC: Row = {"model": "dc", "KA": 20.0, "TA": 0.055, "TE": 0.36, "KF": 0.125, "TF": 1.8, "TR": 0.05, "AEX": 0.0056}
DC["BEX"] = 1.075


def content(name: str, **fields: Any) -> Row:
    """A shipped system's content with other fields."""
    return {**shipped(name).model_dump(by_alias=True), **fields}


def at_all(**row: Any) -> list[Row]:
    """A control at every machine of the four."""
    return [{"machine": machine, **row} for machine in MACHINES]


def kundur(machine: Row | None = None, load: Row | None = None, **fields: Any) -> Row:
    """kundur_12_6 with other data of all machines and loads."""
    system = content("kundur_12_6", **fields)
    system["machines"] = [{**m, **(machine or {})} for m in system["machines"]]
    system["loads"] = [{**row, **(load or {})} for row in system["loads"]]
    return system


def two_area(devices: tuple[str, ...], machine: Row | None = None, **fields: Any) -> Row:
    """two_area with some of its devices."""
    system = content("two_area", **fields)
    # The SSSC joins its two halves.
    system["devices"] = [d for d in system["devices"] if d["name"] in devices]
    system["machines"] = [{**m, **(machine or {})} for m in system["machines"]]
    return system


def various() -> Row:
    """Four machines of four models, each with other controls."""
    system = kundur()
    models: list[Row] = [
        {"model": "classical", "D": 1.5},
        {"model": "two_axis", **SALIENT, **SATURATION},
        {"model": "cascade", "Ra": 0.004, **SALIENT, **APART, "Xl": None, **SATURATION},
        {"model": "genrou", **APART, "D": 0.5, "S10": 0.0, "S12": 0.2},
    ]
    system["machines"] = [{**m, **data} for m, data in zip(system["machines"], models, strict=True)]
    system["exciters"] = [{**FEEDBACK, "machine": "G2"}, {**DC, "machine": "G3"}, {**STATIC, "machine": "G4"}]
    system["stabilisers"] = [{"machine": "G2", "K": 5.0}, {"machine": "G4", "T1": 0.1, "T2": 0.03}]
    system["governors"] = [{"machine": "G1", "Dt": 0.5}, {"machine": "G3", "r": 0.3, "Tw": 1.5, "R": 0.04}]
    system["loads"] = [{**row, "P_fractions": MIXED_P, "Q_fractions": MIXED_Q} for row in system["loads"]]
    return system


def saturated() -> Row:
    """The four machines of PSS/E that saturate: GENROU, GENROE, GENSAL, GENSAE."""
    system = kundur()
    exponential = {**SATURATION, "saturation": "exponential"}
    forms: list[Row] = [SATURATION, exponential, {**SALIENT, **SATURATION}, {**SALIENT, **exponential}]
    models = ("genrou", "genrou", "gensal", "genrou")
    rows = zip(system["machines"], models, forms, strict=True)
    system["machines"] = [{**m, "model": model, **data} for m, model, data in rows]
    return system


def reduced() -> Row:
    """Transient gain reduction: as it is, with rate feedback, as a mere lag without transducer, within limits."""
    rows: list[Row] = [
        REDUCED,
        {**REDUCED, "KF": 0.01, "TF": 0.5},
        {**REDUCED, "TR": 0.0, "TB": 0.1, "TC": 0.0, "KA": 50.0},
        {**REDUCED, "TB": 1.0, "minimum": 0.0, "maximum": 4.0},
    ]
    exciters = [{**row, "machine": machine} for row, machine in zip(rows, MACHINES, strict=True)]
    return kundur(exciters=exciters, stabilisers=at_all())


def in_lines(*more: Row) -> Row:
    """Two SSSCs in two lines, with losses; static exciters and stabilisers that reach their limits."""
    a = {"name": "a", "kind": "sssc", "line": "line_3", "end": "from", "g": 0.05, "I_rated": 2.3}
    b = {
        "name": "b",
        "kind": "sssc",
        "line": "line_2",
        "end": "to",
        "rs": 2e-4,
        "xs": 3e-3,
        "Kp": 0.05,
        "Ki": 0.5,
        "g": 0.01,
    }
    limits = {"minimum": -0.002, "maximum": 0.02}
    return kundur(devices=[a, b, *more], exciters=at_all(**STATIC), stabilisers=at_all(**limits))


def statcom(name: str, bus: str, **fields: Any) -> Row:
    """A STATCOM with a slower voltage regulator than the default's."""
    return {
        "name": name,
        "kind": "statcom",
        "bus": bus,
        "setpoint_max": 0.1,
        "rate_max": 10.0,
        "I_max": 3.0,
        "Ki": 50.0,
        **fields,
    }


def svc(name: str, bus: str, **fields: Any) -> Row:
    """An SVC."""
    limits = {"setpoint_max": 0.05, "rate_max": 2.0, "B_max": 1.5, "B_min": -1.0}
    return {"name": name, "kind": "svc", "bus": bus, **limits, "K": 25.0, **fields}


def modulated() -> Row:
    """Two loads that are modulated, the first with a lag; the fault takes the second below its V_min."""
    limits = {"kind": "load_modulation", "rate_max": 4.0}
    first = {"name": "m", "bus": "B9", "setpoint_max": 0.6, "pf": 0.9, "response_time": 0.05, "dead_time": 0.01}
    second = {"name": "n", "bus": "B7", "setpoint_max": 1.5, "V_min": 0.9}
    return kundur(devices=[{**limits, **first}, {**limits, **second}], exciters=at_all(**STATIC))


def stored() -> Row:
    """Two batteries: one gets empty, the other full; the first supports its voltage and reaches its rating."""
    limits = {"kind": "bess", "rate_max": 4.0, "setpoint_max": 1.5, "S_rated": 80.0, "eta_in": 0.8, "eta_out": 0.9}
    first = {"name": "p", "bus": "B9", "K": 20.0, "E_rated": 0.05, "charge": 0.4, "charge_min": 0.3, "taper": 0.1}
    second = {"name": "q", "bus": "B7", "E_rated": 0.04, "charge": 0.8, "V_min": 0.9, "taper": 0.05}
    devices = [{**limits, **first, "response_time": 0.05}, {**limits, **second}]
    return kundur(devices=devices, exciters=at_all(**STATIC))


def capacitors() -> Row:
    """Two series capacitors that are controlled, one in a line; the fault takes the first above its largest current."""
    kind = {"kind": "tcsc", "rate_max": 0.4, "setpoint_max": 0.02}
    first = {"name": "v", "line": "line_3", "X": 0.02, "X_min": 0.005, "X_max": 0.03, "I_max": 4.0, "xs": 0.004}
    second = {"name": "w", "line": "line_2", "end": "to", "X": 0.01, "X_min": -0.002, "X_max": 0.022, "T": 0.05}
    devices = [{**kind, **first}, {**kind, **second, "response_time": 0.03}]
    return kundur(devices=devices, exciters=at_all(**STATIC))


def commanded() -> Row:
    """Inputs at a static exciter beside a stabiliser, at its ceiling at times, and at a DC exciter."""
    first = {"name": "g", "kind": "exciter_input", "machine": "G1", "response_time": 0.03}
    second = {"name": "h", "kind": "exciter_input", "machine": "G3", "setpoint_max": 0.05, "rate_max": 0.5}
    exciters = [{"machine": m, **(DC if m == "G3" else {**STATIC, "maximum": 5.0})} for m in MACHINES]
    return kundur(devices=[first, second], exciters=exciters, stabilisers=at_all()[:2])


def compensated() -> Row:
    """Two devices of each kind, of which no two are alike."""
    devices = [
        statcom("c", "B9"),
        svc("e", "B8"),
        statcom("d", "B6", droop=0.02, tau=0.01),
        svc("f", "B10", K=8.0, T=0.2),
    ]
    return in_lines(*devices)


def svcs() -> Row:
    """Two SVCs, of which the first reaches both its limits and is blocked by the fault."""
    devices = [svc("e", "B8", B_max=0.5, B_min=-0.4, V_min=0.6), svc("f", "B6", K=10.0, T=0.2)]
    return kundur(devices=devices, exciters=at_all(**STATIC))


def in_lines_limited() -> Row:
    """Two SSSCs, the first with a slack DC link and limits of its voltages that it reaches."""
    system = in_lines()
    system["devices"][0].update(tau=0.05, Kd=0.1, Kdi=0.5, vp_max=0.025, vc_max=0.06)
    return system


def weak() -> Row:
    """The nine buses with an SSSC in a line whose current falls below the least at times."""
    device = {"name": "sssc", "kind": "sssc", "line": "line_7_8", "xs": 0.01, "g": 0.002, "I_min": 0.7}
    return content("wscc_9", devices=[device])


def tapped() -> Row:
    """Taps, phase shifts that differ by 60 degrees, a phase shifter beside the tie, losses, long lines."""
    system = kundur(line_model="distributed")
    first, _, third, _ = system["transformers"]
    first.update(tap=1.05, phase_shift=30.0, r=0.003, magnetising_r=300.0, magnetising_x=200.0)
    third.update(tap=0.97, phase_shift=-30.0)
    shifter = {"name": "shifter", "from": "B7", "to": "B9", "rating": 100, "x": 0.5, "phase_shift": 10.0, "tap": 0.98}
    system["transformers"].append(shifter)
    system["shunts"].append({"name": "reactor", "bus": "B8", "Q": -20.0, "P": 3.0})
    return system


def deployed() -> Row:
    """two_area with converters that answer late, lose power and keep their ratings, which they reach."""
    system = two_area(BOTH)
    sssc, shunt = system["devices"]
    sssc.update(response_time=0.015, dead_time=0.0123, g=0.02, I_rated=4.3, enforce_rating=True)
    shunt.update(response_time=0.0004, dead_time=0.0071, g=0.3, R=0.02, I_max=0.7, enforce_rating=True, Ki=50.0)
    return system


def hvdc(**fields: Any) -> Row:
    """two_area_hvdc with other data of its link."""
    system = content("two_area_hvdc")
    system["devices"][0].update(fields)
    return system


def infinite() -> Row:
    """Area 1 of two_area against two infinite buses, with both devices."""
    system = two_area(("sssc", "statcom"), signals={}, measures={})
    system["machines"] = [{**m, "slack": False, "P": 700.0} for m in system["machines"][:2]]
    for controls in ("exciters", "stabilisers", "governors"):
        system[controls] = system[controls][:2]
    for rows in ("transformers", "pmus"):
        system[rows] = system[rows][:2]
    system["buses"] = [bus for bus in system["buses"] if bus["name"] not in ("B3", "B4")]
    ends = (("north", "B10", 1.0, -33.0), ("south", "B11", 0.99, -30.0))
    system["infinite_buses"] = [{"name": n, "bus": bus, "V": V, "angle": angle} for n, bus, V, angle in ends]
    return system


def hydro() -> Row:
    """The single machine with a stabiliser and a turbine whose gate reaches its limits."""
    governor = {"machine": "G1", "gate_min": 0.7, "gate_max": 0.715, "rate_max": 0.05, "Dt": 0.3}
    return content("smib", governors=[governor], stabilisers=[{"machine": "G1"}])


def fault(line: str = "line_4", location: float = 0.3, duration: float = 0.1, **more: Any) -> Row:
    """A fault on a line at 0.5 s."""
    place = {} if "bus" in more else {"line": line, "location": location}
    return {"kind": "fault", "time": 0.5, **place, "duration": duration, **more}


def load_step(load: str, change: float) -> Row:
    """A load step at 0.5 s."""
    return {"kind": "load_step", "time": 0.5, "load": load, "change": change}


IN_LINES: dict[str, Targets] = {"a": [(0.2, 0.05), (1.0, -0.07)], "b": [(0.3, -0.03), (1.2, 0.06)]}
EACH: dict[str, Targets] = {
    "c": [(0.2, 0.01)],
    "d": [(0.25, -0.008), (0.7, 0.0)],
    "e": [(0.3, 0.02)],
    "f": [(0.4, -0.03)],
}
SVCS: dict[str, Targets] = {"e": [(0.2, 0.04), (0.9, -0.3)], "f": [(0.3, -0.01), (1.2, 0.02)]}
LOADS: dict[str, Targets] = {"m": [(0.2, 0.4), (0.8, -2.0)], "n": [(0.3, 1.2), (1.1, -0.5)]}
POWERS: dict[str, Targets] = {"p": [(0.1, 0.7), (1.2, -0.3)], "q": [(0.1, -1.0), (1.3, 0.5)]}
REACTANCES: dict[str, Targets] = {"v": [(0.1, 0.02), (1.0, -0.03)], "w": [(0.2, -0.015), (1.1, 0.01)]}
INPUTS: dict[str, Targets] = {"g": [(0.1, 0.03), (1.0, -0.2)], "h": [(0.2, -0.02), (1.1, 0.05)]}
HVDC: dict[str, Targets] = {"hvdc": [(0.2, 0.3), (0.7, -0.4), (1.3, 0.1)]}
MODULATED: dict[str, Targets] = {"hvdc": [(0.2, 1.5), (1.0, -2.5)]}
BEYOND: dict[str, Targets] = {"a": [(0.2, 0.05), (0.7, 0.3)], "b": [(0.3, -0.03), (1.2, 0.06)]}
SSSC: dict[str, Targets] = {"sssc": [(0.2, 0.05), (0.9, -0.05), (1.4, 0.02)]}
SMALL: dict[str, Targets] = {"sssc": [(0.2, 0.05), (0.7, -0.03)], "statcom": [(0.3, 0.004), (0.8, -0.003)]}
LARGE: dict[str, Targets] = {"sssc": [(0.2, 0.05), (0.7, -0.08)], "statcom": [(0.3, -0.03), (0.8, 0.06)]}
BOTH = ("sssc", "statcom")
AREA_FAULTS: list[Row] = [
    {"kind": "fault", "time": 0.5, "bus": "B9", "r": 0.01, "x": 0.02},
    {"kind": "fault", "time": 0.52, "line": "line_1", "location": 0.7, "x": 0.03, "duration": 0.05},
    {"kind": "clear", "time": 0.6, "bus": "B9"},
    {"kind": "line_out", "time": 0.8, "line": "line_2"},
]
OUT_AND_IN: list[Row] = [
    {"kind": "line_out", "time": 0.5, "line": "line_3"},
    {"kind": "line_in", "time": 1.2, "line": "line_3"},
]
PUSH: Row = {"kind": "mechanical_power_step", "time": 0.5, "machine": "G1", "change": 0.4}
PULL: Row = {**PUSH, "time": 1.5, "change": -0.5}
TRIP: list[Row] = [{"kind": "generator_trip", "time": 0.5, "machine": "G4"}]
LIMITED_DC = {**DC, "KA": 100.0, "minimum": 0.0, "maximum": 4.0}

CASES: dict[str, Case] = {
    "smib": Case(lambda: content("smib"), [fault("line_1", 0.5, 5 / 60)], SSSC, 1.8, 2e-6),
    "hydro": Case(hydro, [PUSH, PULL], {"sssc": [(0.2, 0.02)]}, 2.5, 2e-7),
    "two_area": Case(lambda: two_area(BOTH), [load_step("load_2", -0.02)], SMALL, 1.0, 1e-9, "LSODA"),
    "two_area_limited": Case(lambda: two_area(BOTH), [load_step("load_2", -0.1)], LARGE, 1.0, 2e-7, "LSODA"),
    "two_area_faults": Case(lambda: two_area(("sssc",)), AREA_FAULTS, SSSC, 1.5, 1e-6),
    "infinite": Case(infinite, [fault()], SMALL, 0.9, 5e-7, "LSODA"),
    "in_lines": Case(in_lines, [fault()], IN_LINES, 1.5, 5e-8),
    "compensated": Case(compensated, [load_step("load_2", -0.05)], {**IN_LINES, **EACH}, 1.05, 2e-9, "LSODA"),
    "deployed": Case(deployed, [load_step("load_2", -0.03)], LARGE, 1.0, 2e-6, "LSODA"),  # bypassed at times
    "hvdc": Case(hvdc, [load_step("load_2", -0.05)], HVDC, 1.6, 1e-9),
    "hvdc_limited": Case(
        lambda: hvdc(setpoint_max=3.0, rate_max=5.0, P_min=100.0, pf_to=1.0, dead_time=0.03, response_time=0.0),
        [fault(location=0.9, x=0.01)],
        MODULATED,
        1.3,
        1e-6,
    ),
    "modulated": Case(modulated, [fault(x=0.03)], LOADS, 1.4, 1e-8),
    "stored": Case(stored, [fault(x=0.03)], POWERS, 1.6, 1e-8),
    "capacitors": Case(capacitors, [fault()], REACTANCES, 1.4, 3e-6),  # bypassed at times
    "commanded": Case(commanded, [fault()], INPUTS, 1.4, 1e-6),
    "svcs": Case(svcs, [fault()], SVCS, 1.4, 1e-8),
    "in_lines_limited": Case(in_lines_limited, [fault()], BEYOND, 1.5, 5e-8),
    "in_lines_out": Case(in_lines, OUT_AND_IN, IN_LINES, 1.6, 1e-8),
    "dc": Case(lambda: content("kundur_12_6_dc"), [fault(bus="B8")], {}, 3.0, 1e-9),
    "current": Case(lambda: kundur(load={"P_fractions": CURRENT}), [fault()], {}, 1.2, 1e-9),
    "mixture": Case(lambda: kundur(load={"P_fractions": MIXED_P, "Q_fractions": MIXED_Q}), [fault()], {}, 1.2, 1e-9),
    "power": Case(
        lambda: kundur(load={"P_fractions": POWER, "Q_fractions": POWER}, exciters=at_all(**STATIC)),
        [fault(duration=0.05)],
        {},
        1.1,
        1e-9,
    ),
    "nominal": Case(
        lambda: kundur(load={"P_fractions": MIXED_P, "Q_fractions": CURRENT, "at": "nominal", "V_min": 0.8}),
        [fault()],
        {},
        1.2,
        1e-9,
    ),
    "saturation": Case(saturated, [fault()], {}, 1.2, 1e-9),
    "saturation_cascade": Case(
        lambda: two_area(("sssc",), {"S10": 0.06, "S12": 0.3, **APART}, exciters=at_all(**FEEDBACK)),
        [fault()],
        SSSC,
        1.6,
        1e-9,
    ),
    "two_axis": Case(
        lambda: kundur({"S10": 0.0, "S12": 0.3, "model": "two_axis"}, exciters=at_all(**DC)), [fault()], {}, 1.2, 1e-9
    ),
    "classical": Case(lambda: kundur({"model": "classical", "D": 1.0}), [fault()], {}, 1.2, 1e-9),
    "salient": Case(
        lambda: kundur({**SALIENT, **APART, **SATURATION}, exciters=at_all(**DC, KE=0.9)), [fault()], {}, 1.2, 1e-9
    ),
    "limited": Case(lambda: kundur(SALIENT, exciters=at_all(**LIMITED_DC)), [fault()], {}, 1.2, 5e-5),
    "limited_fine": Case(
        lambda: kundur(SALIENT, exciters=at_all(**LIMITED_DC)), [fault()], {}, 1.2, 5e-6, step=1 / 7680
    ),
    "various": Case(various, [load_step("load_1", 0.05)], {}, 1.5, 1e-9),
    "controls": Case(
        lambda: kundur(
            exciters=at_all(**STATIC),
            stabilisers=at_all(minimum=-0.01),
            governors=at_all(Dt=0.5, rate_max=0.02, gate_max=0.9),
        ),
        [load_step("load_2", 0.08), {**PUSH, "time": 1.0, "machine": "G3"}],
        {},
        2.0,
        1e-9,
    ),
    "reduction": Case(reduced, [load_step("load_1", 0.05)], {}, 1.5, 1e-9),
    "reduction_limited": Case(reduced, [fault()], {}, 1.5, 1e-6),
    "trip": Case(
        lambda: kundur(
            load={"P_fractions": CURRENT}, exciters=at_all(**STATIC, minimum=-5.0, maximum=6.0), governors=at_all()
        ),
        TRIP,
        {},
        2.0,
        1e-6,
    ),
    "tapped": Case(tapped, [fault()], {}, 1.5, 1e-9),
    "wscc_9": Case(lambda: content("wscc_9"), [fault(bus="B7", duration=0.05)], {}, 1.5, 1e-9),
    "wscc_9_weak": Case(weak, [fault("line_4_6", 0.5, 0.1)], {"sssc": [(0.2, 0.03)]}, 1.0, 2e-5),
    "wscc_9_power": Case(lambda: content("wscc_9_constant_power"), [load_step("load_A", 0.2)], {}, 1.5, 1e-9),
    "new_england_39": Case(lambda: content("new_england_39"), [load_step("load_4", 0.4)], {}, 1.5, 1e-9),
}
