"""minniwecc against PSTess (MATLAB), whose case it is: power flow, eigenvalues, transfer functions, loops, faults.

The speed multiplies a machine's EMF, E'' (1 + omega). PSTess leaves it out of the voltage that supplies an exciter,
the plant does not; `_like_pstess` leaves it out of the linear plant.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.interpolate import AAA

from facts_damping.case.loading import load_system
from facts_damping.parameters.events import Scenario
from facts_damping.parameters.plant.pmus import Signal
from facts_damping.plant.build import build
from facts_damping.plant.dynamics import derivatives
from facts_damping.plant.grid.power_flow import solve
from facts_damping.plant.machines.blocks import SOURCE
from facts_damping.plant.measurement import measure
from facts_damping.plant.model import copy, workspace
from facts_damping.signals import CHANNELS, DEVICE_TRUTH, MACHINE_TRUTH
from facts_damping.small_signal.linearisation import linear_model
from facts_damping_validation.table import ValidationTable, compare, figures, within
from facts_damping_validation.time_domain import follow

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.compiling.structs import Complex1, Float1, Float2
    from facts_damping.parameters.plant.system import System
    from facts_damping.plant.build import Built
    from facts_damping.plant.model import Plant

SYSTEM = "minniwecc"
SOURCE_TEXT = "PSTess 1.1 (Octave)"
LEAST, HIGHEST = 0.01, 3.0  # rad/s and Hz, of the eigenvalues that are compared
BAND = 1.0  # Hz, of the transfer functions
STEP = 1e-5  # relative, of the difference quotients
ROOT = 1e-7  # 1/s, accuracy of the modes of closed loops
PER_MW_PER_MHZ = 10.0  # p.u. of 100 MVA per Hz
LAG = 0.05  # s, of the modulation in PSTess
ENDS = {"pdci_north": "B24", "pdci_south": "B49"}  # loads of the intertie's schedule, and their buses
NORTH = "NORTH"  # PMU at B24
SOUTH = {49: "SOUTH", 63: "SOUTH_2"}  # PMUs by bus
LOW = {0.207: "north-south A", 0.370: "north-south B"}  # by frequency, Hz
LOOPS = ((5.0, 0.1), (10.0, 0.05), (10.0, 0.3))  # gain, MW/mHz, and delay, s, of the closed loops
TURNS = 50  # steps from gain 0 to the whole gain
BRAKE = {"kind": "brake", "bus": "B18", "power": 1400.0, "duration": 0.5}
EVENTS: dict[str, tuple[str, dict[str, Any], float]] = {
    "brake": ("brake of 1.4 GW at B18 for 0.5 s", BRAKE, 0.02),
    "colstrip_trip": ("loss of G14", {"kind": "generator_trip", "machine": "G14"}, 0.02),
}


class Linear(NamedTuple):
    """dx = A x + B u, y = C x + D u: angle of B24 less those of the southern buses, rad; u: conductance to be moved."""

    A: Float2
    B: Float1
    C: Float2
    D: Float1


def power_flow() -> ValidationTable:
    """All voltages."""
    flow = solve(load_system(SYSTEM))
    voltage = dict(zip(flow.names, flow.voltage, strict=True))
    theirs = figures("minniwecc_voltages_pstess")
    turned = np.array([voltage[f"B{bus}"] for bus in theirs["bus"]]) * np.exp(-1j * np.deg2rad(theirs["angle"]))
    rows = [
        within("voltages of the 122 buses", "p.u.", turned.real - theirs["magnitude"], 1e-6),
        within("angles of the 122 buses", "deg", np.rad2deg(np.angle(turned)), 1e-6),
    ]
    return ValidationTable("Power flow of minniwecc", SOURCE_TEXT, "facts-damping modes minniwecc", rows)


def eigenvalues() -> ValidationTable:
    """Oscillatory eigenvalues: all with the terms of the speed, the two lowest interarea modes as shipped."""
    case, theirs = _case(), _read()
    apart = _nearest(_eigenvalues(_like_pstess(case).A), theirs) - theirs
    what = f"all {len(theirs)} below {HIGHEST:g} Hz, with exciters supplied as in PSTess"
    rows = [
        within(f"{what}: real part", "1/s", apart.real, 1e-3),
        within(f"{what}: imaginary part", "rad/s", apart.imag, 1e-3),
    ]
    rows.append(within("all, as shipped", "1/s", _nearest(_eigenvalues(_linear(case).A), theirs) - theirs, 0.01))
    swings = _nearest(theirs, np.array([2j * np.pi * hertz for hertz in LOW]))
    for name, ours, mode in zip(LOW.values(), _nearest(_eigenvalues(_linear(case).A), swings), swings, strict=True):
        what, radians = f"{name}, as shipped", 2.0 * np.pi
        rows.append(compare(f"{what}: frequency", "Hz", ours.imag / radians, mode.imag / radians, 1e-3))
        rows.append(compare(f"{what}: damping ratio", "-", -ours.real / abs(ours), -mode.real / abs(mode), 0.005))
    return ValidationTable("Eigenvalues of minniwecc", SOURCE_TEXT, "facts-damping modes minniwecc", rows)


def transfer() -> ValidationTable:
    """From the intertie's modulation to differences of frequency."""
    response, theirs, rows = _response(_like_pstess(_case())), figures("minniwecc_transfer_pstess"), []
    for i, (bus, pmu) in enumerate(SOUTH.items()):
        row = theirs[(theirs["south_bus"] == bus) & (theirs["frequency"] <= BAND)]
        ours = np.array([response(2j * np.pi * hertz)[i] for hertz in row["frequency"]])
        ratio = ours / (row["re"] + 1j * row["im"]) - 1.0
        rows.append(within(f"B24 less B{bus} ({pmu}), 0.1 to {BAND:g} Hz", "relative", ratio, 0.01))
    title = "Transfer functions of minniwecc, exciters supplied as in PSTess"
    return ValidationTable(title, SOURCE_TEXT, "facts-damping modes minniwecc --devices pdci", rows)


def closed_loops() -> ValidationTable:
    """Damping ratios with a proportional law and a delay.

    PSTess's loop follows from its transfer function alone, continued into the complex plane by a rational function.
    """
    case, row = _case(), figures("minniwecc_transfer_pstess")
    row = row[row["south_bus"] == min(SOUTH)]
    s, values = 2j * np.pi * row["frequency"], row["re"] + 1j * row["im"]
    theirs = AAA(np.r_[s, -s], np.r_[values, values.conj()], rtol=1e-6)
    alike, shipped, rows = _response(_like_pstess(case)), _response(_linear(case)), []
    for gain, delay in LOOPS:
        for hertz, name in LOW.items():
            ratios = [
                _damping_ratio(response, hertz, gain, delay)
                for response in (theirs, lambda x: alike(x)[0], lambda x: shipped(x)[0])
            ]
            what = f"{name}, {gain:g} MW/mHz, {delay:g} s"
            rows.append(compare(f"{what}, exciters supplied as in PSTess", "-", ratios[1], ratios[0], 0.002))
            rows.append(compare(f"{what}, as shipped", "-", ratios[2], ratios[0], 0.003))
    return ValidationTable("Closed loops of minniwecc", SOURCE_TEXT, "facts-damping margin minniwecc", rows)


def _damping_ratio(response: Callable[[complex], complex], hertz: float, gain: float, delay: float) -> float:
    """Damping ratio of the mode that begins at `hertz` without control.

    It solves k H(s) K exp(-s delay) = 1 by Newton's method while k rises to 1; H(s): Hz/p.u., K: `gain`, p.u./Hz.
    """
    s = 2j * np.pi * hertz * (1.0 + 0.1j)

    def off(x: complex, k: float) -> complex:
        return complex(np.exp(x * delay) / (PER_MW_PER_MHZ * gain * response(x)) - k)

    for k in np.linspace(0.0, 1.0, TURNS)[1:]:
        step = 1.0 + 0.0j
        while abs(step) > ROOT:
            step = off(s, k) * 2.0 * STEP / (off(s + STEP, k) - off(s - STEP, k))
            s -= step
    return -s.real / abs(s)


def disturbances() -> ValidationTable:
    """Speeds after the brake and after the loss of Colstrip."""
    system, rows = load_system(SYSTEM), []
    names = [m.name for m in system.machines]
    for name, (what, event, tolerance) in EVENTS.items():
        theirs = figures(f"minniwecc_{name}_pstess")
        seen = [g for g in names if f"w{g[1:]}" in (theirs.dtype.names or ()) and g != event.get("machine")]
        speeds = np.array([theirs[f"w{g[1:]}"] - 1.0 for g in seen]).T
        run = follow(system, [], theirs["t"], [{**event, "time": 1.0}]).machines["speed_deviation"]
        apart = run[:, [names.index(g) for g in seen]] - speeds
        rows.append(within(f"{what}, as shipped: speeds", "of the peak", apart / np.abs(speeds).max(), tolerance))
    return ValidationTable("Disturbances of minniwecc", SOURCE_TEXT, "facts-damping simulate minniwecc", rows)


def _read() -> Complex1:
    """PSTess's eigenvalues with an imaginary part above zero, up to HIGHEST, 1/s."""
    rows = figures("minniwecc_eigenvalues_pstess")
    values = np.asarray(rows["re"] + 1j * rows["im"], np.complex128)
    return np.asarray(values[(values.imag > LEAST) & (values.imag < 2.0 * np.pi * HIGHEST)])


def _eigenvalues(A: Float2) -> Complex1:
    return np.asarray(np.linalg.eigvals(A), np.complex128)


def _nearest(ours: Complex1, theirs: Complex1) -> Complex1:
    """For each of `theirs` the nearest of `ours`."""
    return np.asarray(ours[np.abs(ours[:, None] - theirs[None]).argmin(axis=0)])


def _response(linear: Linear) -> Callable[[complex], Complex1]:
    """Frequency differences by the modulation before its lag, Hz/p.u., as a function of s."""
    poles, right = np.linalg.eig(linear.A)
    residues = (linear.C @ right) * np.linalg.solve(right, linear.B)

    def at(s: complex) -> Complex1:
        angles = (residues / (s - poles)).sum(axis=1) + linear.D
        return np.asarray(angles * s / (2.0 * np.pi) / (1.0 + LAG * s))

    return at


class _Case(NamedTuple):
    """The system, and its plant without device."""

    system: System
    built: Built


def _case() -> _Case:
    system = load_system(SYSTEM)
    return _Case(system, build(system, [], []))


def _linear(case: _Case) -> Linear:
    """The plant as it is. PSTess modulates a conductance: a power times the square of the voltage at rest."""
    system, built = case
    angles = {pmu: Signal(channel="voltage_angle", weights={NORTH: 1, pmu: -1}) for pmu in SOUTH.values()}
    model = linear_model(built, angles, [s.name for s in system.pmus])
    change = {}
    for load, bus in ENDS.items():
        scheduled = next(row.P for row in system.loads if row.name == load) / system.base_power
        change[load] = abs(built.flow.voltage[built.flow.names.index(bus)]) ** 2 / abs(scheduled)

    def loaded(h: float) -> Plant:
        steps = [{"time": 0.0, "kind": "load_step", "load": name, "change": h * by} for name, by in change.items()]
        return build(system, [], Scenario.model_validate({"name": "inline", "events": steps}).events).plant

    by = _quotient(case, loaded)
    return Linear(model.A, by[: len(model.A)], model.C, by[len(model.A) :])


def _like_pstess(case: _Case) -> Linear:
    """With exciters supplied as in PSTess: the column of a speed gains the effect of its exciter's lower supply."""
    linear = _linear(case)
    A = linear.A.copy()
    for g, m in enumerate(case.built.plant.machines):
        A[:, m["offset"] + 1] += _quotient(case, partial(_supplied, case, g))[: len(A)]
    return linear._replace(A=A)


def _supplied(case: _Case, g: int, h: float) -> Plant:
    """A plant whose exciter of machine g is supplied as if its EMF were (1 - h) times as large."""
    built = case.built
    m, control = built.plant.machines[g], built.plant.controls[g]
    rows = built.plant.blocks.copy()
    delta, *circuits = np.delete(built.state.x[m["offset"] : m["offset"] + 2 + m["circuits"]], 1)
    emf_q, emf_d = m["C"][:, : m["circuits"]] @ circuits
    voltage = built.flow.voltage[built.flow.names.index(case.system.machines[g].bus)] * np.exp(1j * (np.pi / 2 - delta))
    along = (voltage * np.conj(complex(emf_d, emf_q))).real / abs(voltage) ** 2
    blocks = rows[control["exciter_first"] : control["exciter_end"]]
    blocks["p"][blocks["kind"] == SOURCE] *= 1.0 - h * along
    return built.plant._replace(blocks=rows)


def _quotient(case: _Case, plant: Callable[[float], Plant]) -> Float1:
    """Central difference of derivatives and angles by a change of the plant."""
    return np.asarray((_seen(case, plant(STEP)) - _seen(case, plant(-STEP))) / (2.0 * STEP))


def _seen(case: _Case, plant: Plant) -> Float1:
    """Derivatives of the states (1/s) and angle differences (rad) of a changed plant at the start."""
    state = copy(case.built.state)
    dx, work = np.zeros_like(state.x), workspace(plant, state)
    derivatives(plant, state.x, state.reference, state.source, 0, dx, work)
    frame = np.zeros((len(plant.pmu_machine), len(CHANNELS)))
    truths = np.zeros(len(plant.machines), MACHINE_TRUTH), np.zeros(len(plant.devices), DEVICE_TRUTH)
    measure(plant, copy(case.built.state), 0, frame, *truths, work)
    angles = frame[:, list(CHANNELS).index("voltage_angle")]
    at = [s.name for s in case.system.pmus].index
    return np.append(dx, [angles[at(NORTH)] - angles[at(pmu)] for pmu in SOUTH.values()])
