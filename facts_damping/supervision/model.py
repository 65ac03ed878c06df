"""Supervisors as arrays: frozen parameters and state, side by side; how they are made of data."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facts_damping.compiling import entry_point
from facts_damping.compiling.structs import Array, Bool2, Complex2, Float1, Float3, Float4, Int2, Struct
from facts_damping.control.inputs import TURN, UNSET, Inputs, LatestSamples, inputs
from facts_damping.monitor_table import CONSEQUENCES, CYCLES, MONITORS, NO_CAUSE, OFF, PLAUSIBLE, SHADOW
from facts_damping.parameters.supervision import watches
from facts_damping.signals import CHANNELS, NANOSECONDS, to_ns

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from facts_damping.parameters.plant.stations import Signal
    from facts_damping.parameters.run import Controller
    from facts_damping.parameters.supervision import Supervision

NEVER = np.iinfo(np.int64).max  # ns
CYCLES_KEPT = 4  # of the mode: three of growth need four
NOBODY, CONTROLLER, RESERVE = range(3)  # whose setpoints act
UNKNOWNS = 6  # of a probe's answer: the known answer and its quadrature, the mode's own swing, mean and slope
LATEST_S = 2.0  # age of a frame up to which a probe knows what it should show

# What a supervisor is set to.
SETTINGS = np.dtype(
    [
        ("controller", "i8"),  # index of the controller in the run
        ("reserve", "i8"),  # and of its fallback; UNSET: none
        ("link", "i8"),  # by which its frames come
        ("frame_rate", "i8"),
        ("arm_ns", "i8"),  # when it is to be armed; NEVER: when an operator asks
        ("probe_ns", "i8"),
        ("needs_probe", "i8"),
        ("dead_ns", "i8"),  # when it fails, and from when on it is there again; NEVER: not
        ("back_ns", "i8"),
        ("hung", "i8"),  # it goes on where it was
        ("ramp", "f8"),  # s, of arming, of a trip, of a change to the fallback or back
        ("trip_ramp", "f8"),
        ("fall_back_ramp", "f8"),
        ("recovery", "f8"),  # s
        ("rate", "f8"),  # p.u./s; inf: any
        ("energy", "f8"),  # s of full output, squared, at once, and as much again in a minute; inf: any
        ("nominal", "f8"),  # Hz
        ("sigma", "f8"),  # 1/s and rad/s: the watched mode's eigenvalue; omega 0: there is none
        ("omega", "f8"),
        ("cycle", "i8"),  # ticks of a cycle of it
        ("amplitude", "f8"),  # share of a device's limit
        ("probe_s", "f8"),  # s, of a device
        ("apart", "f8"),
        ("coherence", "f8"),
        ("gain", "f8"),
        ("phase", "f8"),  # rad
    ]
)

THRESHOLD = np.dtype([("limit", "f8"), ("lasts_ns", "i8"), ("follows", "i8")])

# What a supervisor knows, beside arrays.
SUPERVISOR = np.dtype(
    [
        ("state", "i8"),
        ("cause", "i8"),  # why it is in it: `monitors.cause_name`
        ("refused", "i8"),  # why it was not armed, when that was asked for last
        ("asked", "i8"),  # what an operator asks for from the next tick on
        ("tick", "i8"),  # the newest
        ("start_ns", "i8"),  # its start, and its end
        ("now_ns", "i8"),
        ("begun_ns", "i8"),  # when the newest change of whose setpoints act began
        ("ramp", "f8"),  # s, how long it takes
        ("arrived_ns", "i8"),  # when frames came last that its signals can be made of
        ("owed_ns", "i8"),  # since when frames wait for an answer; UNSET: none does
        ("reserve_ns", "i8"),  # when its fallback last said something
        ("sound_ns", "i8"),  # since when data are sound
        ("issued_ns", "i8"),  # when its newest setpoint was issued,
        ("since", "f8"),  # s, and how long after those before it
        ("spent", "f8"),  # s of full output, squared
        ("norm_at_start", "f8"),
        ("latency", "f8"),  # s, mean and mean deviation over a second
        ("jitter", "f8"),
        ("probe_ns", "i8"),  # when the probe of a device began; UNSET: none is under way
        ("probed", "i8"),  # devices whose probe is done
        ("squares", "f8"),  # of the signal, for a probe's fit
        ("finite", "i8"),  # of the controller's health: whether its outputs are finite,
        ("norm", "f8"),  # Euclidean norm of its network's parameters,
        ("lyapunov", "f8"),  # its Lyapunov function
        ("fall", "f8"),  # and the fall of that by the newest step
        ("values", "f8", (len(MONITORS),)),
        ("over_ns", "i8", (len(MONITORS),)),  # since when a limit is passed; UNSET: it is not
    ]
)

# What it knows of a station.
STATION = np.dtype(
    [
        ("measured_ns", "i8"),  # of the newest frame; UNSET: none yet
        ("angle", "f8"),  # rad, of it, whole turns counted
        ("angle_at_start", "f8"),
        ("same_ns", "i8"),  # measurement since which values repeat
        ("turning", "f8"),  # Hz, frequency less the angle's change, over a tenth of a second
        ("slipping", "f8"),  # Hz, speed less frequency, likewise
        ("status", "i8"),
        ("early", "f8"),  # s, measurement after arrival
    ]
)

# A device that it commands.
DEVICE = np.dtype(
    [
        ("place", "i8"),  # among the installed ones; UNSET: there is none
        ("limit", "f8"),  # p.u., of its authority
        ("residue", "c16"),  # 1/s, from a setpoint as issued to its first signal
    ]
)

# What it knows of a device.
COMMANDED = np.dtype(
    [
        ("given", "f8", (3,)),  # p.u., newest setpoints: nobody's, the controller's, the fallback's
        ("output", "f8"),  # p.u.
        ("begun", "f8"),  # p.u., the output when the newest change began
        ("extreme", "f8"),  # p.u., since the output has turned, and which way it went then
        ("direction", "f8"),
        ("gain", "f8"),  # of a probe's answer, beside the known one; NaN: not probed
        ("phase", "f8"),  # rad, ahead of it
        ("coherence", "f8"),
        ("added", "c16"),  # what the controller would have added to the mode's eigenvalue by this device, 1/s
    ]
)


SupervisorRows = Annotated[NDArray[Any], Array(SUPERVISOR, 1)]


class Supervisors(Struct):
    """Frozen parameters of all supervisors; the first axis is the supervisor."""

    settings: Annotated[NDArray[Any], Array(SETTINGS, 1)]  # (supervisors,) of SETTINGS
    thresholds: Annotated[NDArray[Any], Array(THRESHOLD, 2)]  # (supervisors, monitors) of THRESHOLD
    inputs: Inputs
    plausible: Float1  # (channels,)
    used: Bool2  # (supervisors, channels)
    ends: Int2  # (pairs, 2): stations at both ends of a line
    devices: Annotated[NDArray[Any], Array(DEVICE, 2)]  # (supervisors, most devices) of DEVICE


class SupervisorState(Struct):
    """State of all supervisors; the first axis is the supervisor."""

    rows: SupervisorRows  # (supervisors,) of SUPERVISOR
    held: LatestSamples
    stations: Annotated[NDArray[Any], Array(STATION, 2)]  # (supervisors, stations) of STATION
    commanded: Annotated[NDArray[Any], Array(COMMANDED, 2)]  # (supervisors, most devices) of COMMANDED
    past: Float3  # (supervisors, ticks, 4): first signal, largest output that acts, which limit, reversals
    phasors: Float3  # (supervisors, 1 + most devices, 3), of the first signal and of the outputs
    expected: Complex2  # (supervisors, ticks), of a probe, the modal state
    sums: Float4  # (supervisors, 2, UNKNOWNS + 1, UNKNOWNS + 1), products of a probe's fit; room to solve it


class Watched(NamedTuple):
    """What a supervisor is made for."""

    controller: int
    reserve: int  # its fallback; UNSET: none
    link: int
    arm_at: float | None
    eigenvalue: complex  # of the watched mode, 1/s; 0: none
    residue: Sequence[complex]  # (devices,), from a setpoint as issued to the first signal


def supervisors(
    watched: Sequence[Watched],
    controllers: Sequence[Controller],
    given: Supervision,
    signals: Mapping[str, Signal],
    stations: Sequence[str],
    limits: Mapping[str, float],
    frame_rate: int,
    nominal: float,
    ends: Sequence[tuple[int, int]] = (),
) -> tuple[Supervisors, SupervisorState]:
    """Supervisors of controllers, in shadow; `limits`: p.u., of the installed devices in their order."""
    n, order = len(watched), list(limits)
    own = [controllers[one.controller] for one in watched]
    most = max([len(c.devices) for c in own], default=0)
    made, held = inputs([c.signals for c in own], signals, stations, nominal)
    settings, thresholds = np.zeros(n, SETTINGS), np.zeros((n, len(MONITORS)), THRESHOLD)
    devices, used = np.zeros((n, most), DEVICE), np.zeros((n, len(CHANNELS)), np.bool_)
    devices["place"] = UNSET
    for s, one in enumerate(watched):
        _set(settings[s], one, given, frame_rate, nominal)
        _thresholds(thresholds[s], given, settings[s])
        for d, name in enumerate(own[s].devices):
            devices[s, d] = order.index(name), limits[name] * given.authority.share, one.residue[d]
        for name in own[s].signals:
            used[s, list(CHANNELS).index(signals[name].channel)] = True
    ticks = max([CYCLES_KEPT * int(one["cycle"]) + 1 for one in settings], default=1)
    ticks = max(ticks, round(2.0 * frame_rate) + 1)
    frozen = Supervisors(
        settings=settings,
        thresholds=thresholds,
        inputs=made,
        plausible=np.array([PLAUSIBLE[name] for name in CHANNELS]),
        used=used,
        ends=np.array(ends, np.int64).reshape(-1, 2),
        devices=devices,
    )
    state = SupervisorState(
        rows=np.zeros(n, SUPERVISOR),
        held=held,
        stations=np.zeros((n, len(stations)), STATION),
        commanded=np.zeros((n, most), COMMANDED),
        past=np.zeros((n, ticks, 4)),
        phasors=np.zeros((n, 1 + most, 3)),
        expected=np.zeros((n, round(LATEST_S * frame_rate) + 1), np.complex128),
        sums=np.zeros((n, 2, UNKNOWNS + 1, UNKNOWNS + 1)),
    )
    for s in range(n):
        begin(state, s)
    return frozen, state


@entry_point
def begin(state: SupervisorState, s: int) -> None:
    """Supervisor s as at the start of a run: in shadow, knowing nothing."""
    row, held = state.rows[s], state.held
    row.state, row.cause, row.refused, row.asked = SHADOW, NO_CAUSE, NO_CAUSE, 0
    row.tick = row.start_ns = -1
    row.begun_ns, row.ramp, row.issued_ns, row.sound_ns, row.now_ns = 0, 0.0, 0, 0, 0
    row.arrived_ns = row.owed_ns = row.reserve_ns = row.probe_ns = UNSET
    row.squares = row.spent = row.norm_at_start = row.latency = row.jitter = row.since = 0.0
    row.probed = 0
    held.entry[s], held.entry_ns[s], held.newest_ns[s] = math.nan, UNSET, UNSET
    held.baseline[s], held.washed[s], held.signal[s] = math.nan, 0.0, math.nan
    for i in range(state.stations.shape[1]):
        station = state.stations[s, i]
        station.angle = station.angle_at_start = math.nan
        station.turning = station.slipping = station.early = 0.0
        station.measured_ns, station.same_ns, station.status = UNSET, UNSET, 0
    state.past[s], state.phasors[s], state.expected[s], state.sums[s] = 0.0, 0.0, 0.0, 0.0
    for m in range(row.values.size):
        row.values[m], row.over_ns[m] = 0.0, UNSET
    for d in range(state.commanded.shape[1]):
        device = state.commanded[s, d]
        device.given[0] = device.given[1] = device.given[2] = 0.0
        device.output = device.begun = device.extreme = device.direction = 0.0
        device.gain = device.phase = device.coherence = math.nan
        device.added = 0j


def _set(row: Any, one: Watched, given: Supervision, frame_rate: int, nominal: float) -> None:
    """A supervisor's settings."""
    arming, probe = given.arming, given.probe
    omega = one.eigenvalue.imag
    row["controller"], row["reserve"], row["link"] = one.controller, one.reserve, one.link
    row["frame_rate"], row["nominal"] = frame_rate, nominal
    row["arm_ns"] = NEVER if one.arm_at is None else to_ns(one.arm_at)
    row["probe_ns"] = NEVER if probe.start is None else to_ns(probe.start)
    row["needs_probe"] = arming.probe
    row["ramp"], row["trip_ramp"], row["fall_back_ramp"] = arming.ramp, arming.trip_ramp, arming.fall_back_ramp
    row["recovery"] = arming.recovery
    row["rate"] = math.inf if given.authority.rate is None else given.authority.rate
    row["energy"] = math.inf if given.authority.energy is None else given.authority.energy / 2.0
    row["sigma"], row["omega"] = one.eigenvalue.real, omega
    row["cycle"] = frame_rate if omega == 0.0 else max(2, round(TURN / omega * frame_rate))
    row["amplitude"], row["apart"] = probe.amplitude, probe.apart
    row["probe_s"] = row["cycle"] * probe.cycles / frame_rate
    row["coherence"], row["gain"], row["phase"] = probe.coherence, probe.gain, math.radians(probe.phase)
    row["dead_ns"] = row["back_ns"] = NEVER
    if (fault := given.fault) is not None:
        row["dead_ns"], row["hung"] = to_ns(fault.start), fault.kind == "hung"
        if fault.duration is not None:
            row["back_ns"] = to_ns(fault.start + fault.duration)


def _thresholds(rows: NDArray[Any], given: Supervision, settings: Any) -> None:
    """What a supervisor's monitors are set to."""
    cycle_s = float(settings["cycle"]) / float(settings["frame_rate"])
    for row, (name, watch) in zip(rows, watches(given).items(), strict=True):
        seconds = watch.lasts * (cycle_s if MONITORS[name].lasts_unit == CYCLES else 1.0)
        row["limit"], row["follows"] = watch.limit, CONSEQUENCES.get(watch.follows, OFF)
        row["lasts_ns"] = max(0, round(seconds * NANOSECONDS) - 1)  # ticks are rounded down to a nanosecond
