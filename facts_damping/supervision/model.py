"""Parameters and state of all supervisors as arrays, and their construction."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facts_damping.compiling import entry_point
from facts_damping.compiling.structs import Array, Bool2, Complex2, Float1, Float3, Float4, Int2, Struct
from facts_damping.control.inputs import TURN, UNSET, Inputs, LatestSamples, Wiring, clear, inputs
from facts_damping.monitor_table import CONSEQUENCES, CYCLES, MONITORS, NO_CAUSE, OFF, PLAUSIBLE, SHADOW
from facts_damping.parameters.supervision import watches
from facts_damping.signals import CHANNELS, NANOSECONDS, NEVER, to_ns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping.parameters.run import Controller
    from facts_damping.parameters.supervision import Supervision

CYCLES_KEPT = 4  # cycles of the mode: three growth ratios need four
NOBODY, CONTROLLER, RESERVE = range(3)  # source of the setpoints that act
UNKNOWNS = 6  # of a probe's fit: modal state (2), free swing of the mode (2), mean, slope
LATEST_S = 2.0  # age up to which a probe uses a frame

# Settings of a supervisor.
SETTINGS = np.dtype(
    [
        ("controller", "i8"),  # index in the run
        ("reserve", "i8"),  # index of the fallback; UNSET: none
        ("link", "i8"),  # index of the link that delivers its frames
        ("frame_rate", "i8"),
        ("arm_ns", "i8"),  # time of arming; NEVER: only on an operator's command
        ("probe_ns", "i8"),
        ("needs_probe", "i8"),
        ("dead_ns", "i8"),  # start and end of its failure; NEVER: none
        ("back_ns", "i8"),
        ("hung", "i8"),  # 1: it resumes with its old state after the failure; 0: it restarts
        ("ramp", "f8"),  # s: ramps of arming, of a trip, of a change to the fallback or back
        ("trip_ramp", "f8"),
        ("fall_back_ramp", "f8"),
        ("recovery", "f8"),  # s
        ("rate", "f8"),  # p.u./s; inf: no limit
        ("energy", "f8"),  # s of full output, squared: usable at once, and regained each minute; inf: no limit
        ("nominal", "f8"),  # Hz
        ("sigma", "f8"),  # 1/s, and omega in rad/s: eigenvalue of the watched mode; omega 0: no mode
        ("omega", "f8"),
        ("cycle", "i8"),  # ticks in a cycle of the mode
        ("amplitude", "f8"),  # of each tone of a probe, fraction of the device's limit
        ("probe_s", "f8"),  # s, duration of the probe of one device
        ("apart", "f8"),  # distance of each tone from the mode, fraction of omega
        ("coherence", "f8"),
        ("gain", "f8"),
        ("phase", "f8"),  # rad
    ]
)

THRESHOLD = np.dtype([("limit", "f8"), ("lasts_ns", "i8"), ("follows", "i8")])

# State of a supervisor, except arrays.
SUPERVISOR = np.dtype(
    [
        ("state", "i8"),
        ("cause", "i8"),  # of the newest change of state: `monitor_table.cause_name`
        ("refused", "i8"),  # why the newest request to arm was refused
        ("asked", "i8"),  # operator's command for the next tick; 0: none
        ("tick", "i8"),  # newest tick
        ("start_ns", "i8"),  # its start and end
        ("now_ns", "i8"),
        ("begun_ns", "i8"),  # start of the newest change of state
        ("ramp", "f8"),  # s, its duration
        ("arrived_ns", "i8"),  # newest arrival that gave new signals; UNSET: none yet
        ("owed_ns", "i8"),  # since when frames wait for an answer of the controller; UNSET: none
        ("reserve_ns", "i8"),  # issue of the fallback's newest setpoint; UNSET: none
        ("sound_ns", "i8"),  # newest tick's end with a `fall_back` monitor over its limit
        ("issued_ns", "i8"),  # issue of its newest setpoints
        ("since", "f8"),  # s, interval between these and the previous ones
        ("spent", "f8"),  # energy used, s of full output, squared
        ("norm_at_start", "f8"),
        ("latency", "f8"),  # s, mean and mean deviation over a second
        ("jitter", "f8"),
        ("probe_ns", "i8"),  # start of the running probe; UNSET: none
        ("probed", "i8"),  # number of devices already probed
        ("squares", "f8"),  # sum of the signal's squares in a probe's fit
        ("slow", "f8", (2,)),  # sections of the signal's slow part
        ("free", "f8"),  # largest range of that over a cycle, as it would be by now without control
        ("effort", "f8"),  # output / its limit, the largest at the newest tick, also if it does not act
        ("wave", "f8", (4,)),  # ticks in means of: signal^2, signal^4, effort^2
        ("finite", "i8"),  # controller's health: 1: all outputs are finite
        ("norm", "f8"),  # Euclidean norm of its network's parameters
        ("lyapunov", "f8"),  # its Lyapunov function
        ("fall", "f8"),  # decrease of the Lyapunov function in the newest step
        ("values", "f8", (len(MONITORS),)),
        ("over_ns", "i8", (len(MONITORS),)),  # since when each limit is exceeded; UNSET: not exceeded
    ]
)

# State kept for each PMU.
PMU = np.dtype(
    [
        ("measured_ns", "i8"),  # measurement of the newest frame; UNSET: none yet
        ("angle", "f8"),  # rad, unwrapped voltage angle
        ("angle_at_start", "f8"),
        ("turning", "f8"),  # Hz, frequency minus rate of the angle, smoothed over 0.1 s
        ("slipping", "f8"),  # Hz, speed minus frequency, smoothed likewise
        ("early", "f8"),  # s, measurement time minus arrival time
    ]
)

# Parameters of a commanded device.
DEVICE = np.dtype(
    [
        ("place", "i8"),  # index among the installed devices; UNSET: unused row
        ("limit", "f8"),  # p.u., authority
        ("residue", "c16"),  # 1/s, from issued setpoint to the supervisor's first signal
    ]
)

# State kept for each commanded device.
COMMANDED = np.dtype(
    [
        ("given", "f8", (3,)),  # p.u., newest setpoints by source: NOBODY, CONTROLLER, RESERVE
        ("output", "f8"),  # p.u.
        ("begun", "f8"),  # p.u., output at the start of the newest change of state
        ("extreme", "f8"),  # p.u., extreme since the last turn of the output, and its direction, +1 or -1
        ("direction", "f8"),
        ("slow", "f8", (2,)),  # p.u., sections of the output's slow part
        ("gain", "f8"),  # probed response / known response; NaN: not probed
        ("phase", "f8"),  # rad, lead over the known response
        ("coherence", "f8"),
        ("added", "c16"),  # 1/s, shift of the mode's eigenvalue by the controller through this device
    ]
)


SupervisorRows = Annotated[NDArray[Any], Array(SUPERVISOR, 1)]


class Supervisors(Struct):
    """Constant parameters of all supervisors; arrays of (supervisors, ...) have the supervisor first."""

    settings: Annotated[NDArray[Any], Array(SETTINGS, 1)]  # (supervisors,) of SETTINGS
    thresholds: Annotated[NDArray[Any], Array(THRESHOLD, 2)]  # (supervisors, monitors) of THRESHOLD
    inputs: Inputs
    plausible: Float1  # (channels,): largest plausible value
    used: Bool2  # (supervisors, channels): channels in its signals
    ends: Int2  # (pairs, 2): PMUs at the two ends of a line
    devices: Annotated[NDArray[Any], Array(DEVICE, 2)]  # (supervisors, most devices) of DEVICE


class SupervisorState(Struct):
    """State of all supervisors; the first axis is the supervisor."""

    rows: SupervisorRows  # (supervisors,) of SUPERVISOR
    held: LatestSamples
    pmus: Annotated[NDArray[Any], Array(PMU, 2)]  # (supervisors, PMUs) of PMU
    commanded: Annotated[NDArray[Any], Array(COMMANDED, 2)]  # (supervisors, most devices) of COMMANDED
    # (supervisors, ticks, 5): slow signal, largest acting output / limit, limit hit (+1, -1), reversals, slow output
    past: Float3
    phasors: Float3  # (supervisors, 1 + most devices, 3): of the first signal, then of each output
    expected: Complex2  # (supervisors, ticks): modal state during a probe
    sums: Float4  # (supervisors, 2, UNKNOWNS + 1, UNKNOWNS + 1): products of a probe's fit; work space


class Watched(NamedTuple):
    """Controller, fallback, link and mode of one supervisor."""

    controller: int
    reserve: int  # index of the fallback; UNSET: none
    link: int
    arm_at: float | None
    eigenvalue: complex  # of the watched mode, 1/s; 0: no mode
    residue: Sequence[complex]  # (devices,), 1/s, from issued setpoint to the first signal


def supervisors(
    watched: Sequence[Watched],
    controllers: Sequence[Controller],
    wanted: Supervision,
    wiring: Wiring,
    ends: Sequence[tuple[int, int]] = (),
) -> tuple[Supervisors, SupervisorState]:
    """Build the supervisors of controllers, in shadow; `ends`: PMUs at both ends of each line that has two."""
    n, order, frame_rate = len(watched), list(wiring.limits), wiring.frame_rate
    supervised = [controllers[watch.controller] for watch in watched]
    maximum = max([len(c.devices) for c in supervised], default=0)
    receivers, held = inputs([c.signals for c in supervised], wiring.signals, wiring.pmus, wiring.nominal)
    settings, thresholds = np.zeros(n, SETTINGS), np.zeros((n, len(MONITORS)), THRESHOLD)
    devices, used = np.zeros((n, maximum), DEVICE), np.zeros((n, len(CHANNELS)), np.bool_)
    devices["place"] = UNSET
    for s, row in enumerate(watched):
        _set(settings[s], row, wanted, frame_rate, wiring.nominal)
        _thresholds(thresholds[s], wanted, settings[s])
        for d, name in enumerate(supervised[s].devices):
            devices[s, d] = order.index(name), wiring.limits[name][0] * wanted.authority.fraction, row.residue[d]
        for name in supervised[s].signals:
            used[s, list(CHANNELS).index(wiring.signals[name].channel)] = True
    ticks = max([CYCLES_KEPT * int(setting["cycle"]) + 1 for setting in settings], default=1)
    ticks = max(ticks, round(2.0 * frame_rate) + 1)
    frozen = Supervisors(
        settings=settings,
        thresholds=thresholds,
        inputs=receivers,
        plausible=np.array([PLAUSIBLE[name] for name in CHANNELS]),
        used=used,
        ends=np.array(ends, np.int64).reshape(-1, 2),
        devices=devices,
    )
    state = SupervisorState(
        rows=np.zeros(n, SUPERVISOR),
        held=held,
        pmus=np.zeros((n, len(wiring.pmus)), PMU),
        commanded=np.zeros((n, maximum), COMMANDED),
        past=np.zeros((n, ticks, 5)),
        phasors=np.zeros((n, 1 + maximum, 3)),
        expected=np.zeros((n, round(LATEST_S * frame_rate) + 1), np.complex128),
        sums=np.zeros((n, 2, UNKNOWNS + 1, UNKNOWNS + 1)),
    )
    state.rows["finite"] = 1  # until the controller tells its health, which a user's own node need not
    for s in range(n):
        begin(frozen.inputs, state, s)
    return frozen, state


@entry_point
def begin(receivers: Inputs, state: SupervisorState, s: int) -> None:
    """Reset supervisor s to the start of a run: in shadow, without data."""
    row = state.rows[s]
    row.state, row.cause, row.refused, row.asked = SHADOW, NO_CAUSE, NO_CAUSE, 0
    row.tick = row.start_ns = -1
    row.begun_ns, row.ramp, row.issued_ns, row.sound_ns, row.now_ns = 0, 0.0, 0, 0, 0
    row.arrived_ns = row.owed_ns = row.reserve_ns = row.probe_ns = UNSET
    row.slow[0] = row.slow[1] = row.free = row.effort = 0.0
    row.wave[:] = 0.0
    row.squares = row.spent = row.norm_at_start = row.latency = row.jitter = row.since = 0.0
    row.probed = 0
    clear(receivers, state.held, s)
    for i in range(state.pmus.shape[1]):
        pmu = state.pmus[s, i]
        pmu.angle = pmu.angle_at_start = math.nan
        pmu.turning = pmu.slipping = pmu.early = 0.0
        pmu.measured_ns = UNSET
    state.past[s], state.phasors[s], state.expected[s], state.sums[s] = 0.0, 0.0, 0.0, 0.0
    for m in range(row.values.size):
        row.values[m], row.over_ns[m] = 0.0, UNSET
    for d in range(state.commanded.shape[1]):
        device = state.commanded[s, d]
        device.given[0] = device.given[1] = device.given[2] = 0.0
        device.output = device.begun = device.extreme = device.direction = 0.0
        device.slow[0] = device.slow[1] = 0.0
        device.gain = device.phase = device.coherence = math.nan
        device.added = 0j


def _set(row: Any, watched: Watched, supervision: Supervision, frame_rate: int, nominal: float) -> None:
    arming, probe = supervision.arming, supervision.probe
    omega = watched.eigenvalue.imag
    row["controller"], row["reserve"], row["link"] = watched.controller, watched.reserve, watched.link
    row["frame_rate"], row["nominal"] = frame_rate, nominal
    row["arm_ns"] = NEVER if watched.arm_at is None else to_ns(watched.arm_at)
    row["probe_ns"] = NEVER if probe.start is None else to_ns(probe.start)
    row["needs_probe"] = arming.probe
    row["ramp"], row["trip_ramp"], row["fall_back_ramp"] = arming.ramp, arming.trip_ramp, arming.fall_back_ramp
    row["recovery"] = arming.recovery
    row["rate"] = math.inf if supervision.authority.rate is None else supervision.authority.rate
    row["energy"] = math.inf if supervision.authority.energy is None else supervision.authority.energy / 2.0
    row["sigma"], row["omega"] = watched.eigenvalue.real, omega
    row["cycle"] = frame_rate if omega == 0.0 else max(2, round(TURN / omega * frame_rate))
    row["amplitude"], row["apart"] = probe.amplitude, probe.apart
    row["probe_s"] = row["cycle"] * probe.cycles / frame_rate
    row["coherence"], row["gain"], row["phase"] = probe.coherence, probe.gain, math.radians(probe.phase)
    row["dead_ns"] = row["back_ns"] = NEVER
    if (fault := supervision.fault) is not None:
        row["dead_ns"], row["hung"] = to_ns(fault.start), fault.kind == "hung"
        if fault.duration is not None:
            row["back_ns"] = to_ns(fault.start + fault.duration)


def _thresholds(rows: NDArray[Any], supervision: Supervision, settings: Any) -> None:
    cycle_s = float(settings["cycle"]) / float(settings["frame_rate"])
    for row, (name, watch) in zip(rows, watches(supervision).items(), strict=True):
        seconds = watch.lasts * (cycle_s if MONITORS[name].lasts_unit == CYCLES else 1.0)
        row["limit"], row["follows"] = watch.limit, CONSEQUENCES.get(watch.follows, OFF)
        row["lasts_ns"] = max(0, round(seconds * NANOSECONDS) - 1)  # tick times are rounded down to 1 ns
