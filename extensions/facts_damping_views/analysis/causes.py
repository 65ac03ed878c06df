"""What an oscillation's measurements are explained by: a source at each unit and load in turn, in the linear grid.

A source within a unit or load acts on the grid as a current there, of which two phasors u are unknown (active and
reactive part, or d and q axis). With the linear grid, which has each machine's, control's and load's own response, the
phasors m that PMUs measure (of P, Q, ln V, and theta against that of the first PMU) are

    m = G u + e,    G = C (2 pi j f - A)^-1 B + D,    covariance of e: S = N N* + diag(s^2)

N: what noise of loads gives in the band of a window; s: noise of PMUs, and what the model lacks. What is explained of a
window's oscillation is the fraction of |L^-1 m|^2, S = L L*, that lies in the span of L^-1 G: the matched subspace
detector. Setpoints of devices are known to nobody here: they are noise of any size.

Sources: S. Chevalier, P. Vorobev, K. Turitsyn, Using effective generator impedance for forced oscillation source
location, IEEE Trans. Power Systems 33(6), 2018 (each unit's own response, from its data); L. Scharf, B. Friedlander,
Matched subspace detectors, IEEE Trans. Signal Processing 42(8), 1994.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.devices.load_modulation import LoadModulation
from facts_damping.parameters.events import GeneratorTrip, LineSwitch
from facts_damping.parameters.plant.pmus import Signal
from facts_damping.plant.build import build
from facts_damping.small_signal import descriptor
from facts_damping.small_signal.linearisation import linear_model
from facts_damping_views.analysis.cells import areas

if TYPE_CHECKING:
    from collections.abc import Sequence
    from collections.abc import Set as AbstractSet

    from facts_damping.compiling.structs import Complex2, Complex3, Float1, Float2
    from facts_damping.parameters.plant.pmus import Pmu
    from facts_damping.parameters.plant.system import System
    from facts_damping.plant.build import Built
    from facts_damping.small_signal.linearisation import LinearModel
    from facts_damping_views.analysis.energy_flow import EnergyFlow

CHANNELS = ("active_power", "reactive_power", "voltage_angle", "voltage_magnitude")  # as EnergyFlow's phasors
LOAD, METER = 0.008, 3e-4  # noise in a window of 1 s: of loads, relative to them; of PMUs, p.u. and rad
MODEL = 0.1  # error of the model, relative to what is measured
SMALLEST = 0.1  # p.u., power up to which a PMU's noise does not fall: a sum of all branches of a bus has none
DEVICE = 1.0  # p.u., of setpoints: more than any has
BAND = ((-1.0, 0.3), (-0.5, 0.5), (0.0, 0.6), (0.5, 0.5), (1.0, 0.3))  # of a Hann window: 1 / its length, amplitude
ALIKE = 1e-3  # relative difference of what is explained, up to which places cannot be told apart


class Cause(NamedTuple):
    """Units and loads at which a source would explain an oscillation; they cannot be told apart.

    `explained`: fraction of what noise and the model's error leave of the oscillation; `first`: of the windows in which
    it explains most.
    """

    units: list[str]
    loads: list[str]
    buses: list[str]
    areas: list[str]
    explained: float
    first: float


class Grid(NamedTuple):
    """The linear grid, its PMUs with their measured quantities, and its inputs: devices, then two of each load."""

    system: System
    built: Built
    model: LinearModel
    signals: list[tuple[int, int]]  # index of the PMU and of the channel
    devices: int


def causes(
    system: System, whole: EnergyFlow, flows: EnergyFlow, devices: Sequence[str], out: AbstractSet[str]
) -> list[Cause]:
    """Places that explain an oscillation, the best first.

    `whole`: the phasors in one window; `flows`: in several; `devices`: installed; `out`: branches and units out of
    service. Raises `InputError` if the grid does not start, or falls into islands, with these.
    """
    there = [p for p in np.flatnonzero(np.isfinite(flows.flow).all(axis=0)) if _in_service(system.pmus[p], out)]
    if not there:
        return []
    grid = linear_grid(system, [system.pmus[p] for p in there], devices, out)
    length = float(np.ptp(whole.windows[0]))
    of_states, of_inputs = _answers(grid, whole.frequency)
    in_band = [share * _answers(grid, whole.frequency + step / length)[1] for step, share in BAND]
    noise = np.hstack([_of_loads(grid, answer) for answer in in_band]) / np.sqrt(length)
    wide = np.hstack([noise, DEVICE * of_inputs[:, : grid.devices]])
    measured = _measured(grid, np.concatenate([whole.phasor, flows.phasor])[:, there])
    meters = _of_meters(grid, whole.power[there]) / np.sqrt(length)
    model = MODEL * np.abs(measured[:, 0])
    factor = np.linalg.cholesky(wide @ wide.conj().T + np.diag(meters**2 + model**2))
    white = np.linalg.solve(factor, measured)
    rows, energy = [], []
    for row, answer in _candidates(grid, of_states, of_inputs, out):
        base, _ = np.linalg.qr(np.linalg.solve(factor, answer))
        rows.append(row)
        energy.append((np.abs(base.conj().T @ white) ** 2).sum(axis=0))
    return _ranked(system, rows, np.array(energy) / (np.abs(white) ** 2).sum(axis=0))


def _in_service(pmu: Pmu, out: AbstractSet[str]) -> bool:
    return out.isdisjoint([pmu.machine, *pmu.branches])


def linear_grid(system: System, pmus: Sequence[Pmu], devices: Sequence[str], out: AbstractSet[str]) -> Grid:
    """The grid at its start, with elements out of service, and with two modulations of power at each load."""
    at_loads = [
        LoadModulation(name=f"{x.name}.{pf}", kind="load_modulation", bus=x.bus, setpoint_max=1.0, rate_max=1.0, pf=pf)
        for x in system.loads
        for pf in (1.0, 0.5)
    ]
    units = {unit.name for unit in system.units}
    events = [
        GeneratorTrip(time=0.0, kind="generator_trip", machine=name)
        if name in units
        else LineSwitch(time=0.0, kind="line_out", line=name)
        for name in sorted(out)
    ]
    wide = system.model_copy(update={"pmus": list(pmus), "devices": [*system.devices, *at_loads], "signals": {}})
    built = build(wide, [*devices, *(d.name for d in at_loads)], events)
    quantities = {
        (p, c): Signal(channel=channel, weights={pmu.name: 1.0} | ({pmus[0].name: -1.0} if c == 2 else {}))  # type: ignore[arg-type]
        for p, pmu in enumerate(pmus)
        for c, channel in enumerate(CHANNELS)
        if p > 0 or c != 2
    }
    model = linear_model(built, {f"{p}/{c}": signal for (p, c), signal in quantities.items()}, [s.name for s in pmus])
    return Grid(wide, built, model, list(quantities), len(devices))


def _answers(grid: Grid, frequency: float) -> tuple[Complex2, Complex2]:
    """Answers of the measured quantities to rates of all states, and to the inputs, (quantities, states or inputs)."""
    s, A, C = 2j * np.pi * frequency, grid.model.matrix, grid.model.C
    voltage = grid.built.flow.by_bus
    of_bus = [abs(voltage[bus]) for bus in grid.system.pmu_buses().values()]
    scale = np.array([1.0 / of_bus[p] if c == 3 else 1.0 for p, c in grid.signals])[:, None]  # d ln V
    if isinstance(A, descriptor.Descriptor):
        from_states = descriptor.solved(A._replace(matrix=A.matrix.T.tocsc()), s, C.T).T
    else:
        from_states = np.linalg.solve((s * np.eye(len(A)) - A).T, C.T.astype(complex)).T
    return scale * from_states, scale * (from_states @ grid.model.B + grid.model.D)


def _measured(grid: Grid, phasor: Complex3) -> Complex2:
    """Phasors of the quantities, (quantities, windows)."""
    against_first = phasor.copy()
    against_first[:, :, 2] -= phasor[:, :1, 2]
    return np.array([against_first[:, p, c] for p, c in grid.signals])


def _of_loads(grid: Grid, from_inputs: Complex2) -> Complex2:
    """What noise of loads gives in a window of 1 s, (quantities, two of each load)."""
    sizes = np.repeat([abs(complex(x.P, x.Q)) / grid.system.base_power for x in grid.system.loads], 2)
    return np.asarray(LOAD * from_inputs[:, grid.devices :] * sizes)


def _of_meters(grid: Grid, power: Float1) -> Float1:
    """Noise of PMUs in the quantities in a window of 1 s; `power`: apparent, p.u., (PMUs,)."""
    return METER * np.array([np.sqrt(2.0) * max(power[p], SMALLEST) if c < 2 else 1.0 for p, c in grid.signals])


def _candidates(
    grid: Grid, from_states: Complex2, from_inputs: Complex2, out: AbstractSet[str]
) -> list[tuple[Any, Complex2]]:
    """Units and loads, and what two independent sources there give, (quantities, 2)."""
    owners = [name.partition(".")[0] for name in grid.built.state_names]
    several: list[tuple[Any, Complex2]] = []
    for unit in grid.system.units:
        if unit.name not in out:
            columns = from_states[:, [owner == unit.name for owner in owners]]
            left, *_ = np.linalg.svd(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-30), full_matrices=False)
            several.append((unit, left[:, :2]))
    first = grid.devices
    several += [(x, from_inputs[:, first + 2 * i : first + 2 * i + 2]) for i, x in enumerate(grid.system.loads)]
    return several


def _ranked(system: System, rows: list[Any], explained: Float2) -> list[Cause]:
    """Causes from what each unit or load explains of the whole and of each window, (rows, 1 + windows)."""
    total, units, area = explained[:, 0], {unit.name for unit in system.units}, areas(system)
    firsts = np.bincount(explained[:, 1:].argmax(axis=0), minlength=len(rows)) / (explained.shape[1] - 1)
    groups: list[list[int]] = []
    for i in np.argsort(-total, kind="stable").tolist():
        if groups and total[i] > (1.0 - ALIKE) * total[groups[-1][0]]:
            groups[-1].append(i)
        else:
            groups.append([i])
    several = []
    for group in groups:
        of_group = [rows[i] for i in group]
        names, buses = [x.name for x in of_group], list(dict.fromkeys(x.bus for x in of_group))
        several.append(
            Cause(
                [name for name in names if name in units],
                [name for name in names if name not in units],
                buses,
                sorted({area[bus] for bus in buses if bus in area}),
                float(total[group[0]]),
                float(firsts[group].sum()),
            )
        )
    return several
