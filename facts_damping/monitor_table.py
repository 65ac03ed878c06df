"""Tables of supervision: states, commands, consequences, and one row per monitor."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from numpy.typing import NDArray

DISARMED, SHADOW, ARMED, FALLBACK, TRIPPED = range(5)
STATES = ("disarmed", "shadow", "armed", "fallback", "tripped")  # names in messages, YAML and pictures

ARM, DISARM, RESET, PROBE = range(1, 5)
COMMANDS = {"arm": ARM, "disarm": DISARM, "reset": RESET, "probe": PROBE}  # an operator's commands; 0: none

OFF, WARN, FALL_BACK, TRIP = range(4)
CONSEQUENCES = {"warn": WARN, "fall_back": FALL_BACK, "trip": TRIP}

CYCLES = "cycles"  # of the mode that the supervisor watches


class Monitor(NamedTuple):
    """A monitor: what it watches, its limit, how long it must be exceeded, and the consequence."""

    group: str  # data, controller or grid
    description: str
    unit: str
    limit: float  # exceeded by larger values
    low: float  # smallest limit allowed
    high: float
    lasts: float  # time that the limit must be exceeded, s or cycles of the mode
    lasts_unit: str
    follows: str
    reason: str  # why this limit


def _data(description: str, unit: str, limit: float, low: float, high: float, lasts: float, reason: str) -> Monitor:
    return Monitor("data", description, unit, limit, low, high, lasts, "s", "fall_back", reason)


# In the order of their codes (supervision/monitors.py).
MONITORS = {
    "missing": _data(
        "since frames have come that its signals can be made of",
        "s", 0.16, 0.01, 60.0, 0.0,
        "nine frames of 60 a second pass: single losses, and bursts of a tenth of a second",
    ),
    "stale": _data(
        "age of the oldest frame that its signals are made of",
        "s", 0.4, 0.01, 60.0, 0.05,
        "more than twice the 69 to 113 ms of the Pacific DC Intertie, with a frame that is lost, and less than most "
        "controllers tolerate",
    ),
    "jitter": Monitor(
        "data",
        "mean deviation of the latency from its mean, both over a second",
        "s", 0.05, 0.001, 10.0, 1.0, "s", "warn",
        "a link that is uneven by three frames is not the one that controllers were chosen for",
    ),
    "misaligned": _data(
        "between the times of measurement of the PMUs that its signals are made of",
        "s", 0.1, 0.001, 10.0, 0.05,
        "a tenth of a second turns the phase of a 1 Hz mode by 36 degrees",
    ),
    "stuck": _data(
        "a PMU repeats its values though its frequency is not the nominal one",
        "s", 0.2, 0.02, 60.0, 0.0,
        "the angle of a voltage off its nominal frequency cannot stand still; twelve frames tell a repeated one apart",
    ),
    "range": _data(
        "largest value of a channel that it uses, beside what is plausible of such a channel",
        "-", 1.0, 0.01, 100.0, 0.0,
        "plausible: 0.1 p.u. of speed, 6 Hz off the nominal frequency, 30 Hz/s, 2 p.u. of voltage, 50 p.u. of power "
        "and current",
    ),
    "angle": _data(
        "a PMU's frequency beside the change of its voltage's angle, over a tenth of a second",
        "Hz", 0.25, 0.01, 30.0, 0.3,
        "at a bus near a fault angles jump, for less than that time; a bias of this size is a step of half the swing "
        "after a fault",
    ),
    "speed": _data(
        "a PMU's rotor speed beside its frequency, over a tenth of a second",
        "Hz", 0.5, 0.01, 30.0, 0.5,
        "after a fault the two differ by up to 0.4 Hz (`two_area_large`)",
    ),
    "powers": _data(
        "sum of the powers that PMUs at both ends of a line measure into it, beside the larger one",
        "-", 0.2, 0.01, 10.0, 0.2,
        "a line loses a few per cent; a current transformer the wrong way round doubles the sum",
    ),
    "status": _data(
        "PMUs whose frames say data error, test mode or no time (bits 15 to 13)",
        "pmus", 0.5, 0.5, 100.0, 0.05,
        "IEEE C37.118.2: such frames are not to be used",
    ),
    "clock": _data(
        "how far a frame's time of measurement lies after its arrival",
        "s", 0.001, 1e-6, 10.0, 0.0,
        "nothing arrives before it is measured; a clock in time is right to a microsecond",
    ),
    "local": Monitor(
        "data",
        "since the fallback has said something, while it acts",
        "s", 0.16, 0.01, 60.0, 0.0, "s", "trip",
        "as of remote frames; nothing is left to fall back on",
    ),
    "silent": Monitor(
        "controller",
        "since frames have come that the controller has not answered: it hangs, has died, or needs more than a frame",
        "s", 0.16, 0.01, 60.0, 0.0, "s", "fall_back",
        "less than the 0.2 s after which the device lets go by itself",
    ),
    "non_finite": Monitor(
        "controller",
        "outputs that are not finite",
        "-", 0.0, 0.0, 1e9, 0.0, "s", "trip",
        "a controller that does so once has lost its state",
    ),
    "saturated": Monitor(
        "controller",
        "fraction of the last 2 s in which an output is at the same limit",
        "-", 0.95, 0.01, 1.0, 2.0, "s", "trip",
        "an output that damps changes sign each half cycle, 1 s of a mode of 0.5 Hz, and may stay at a limit for two "
        "of them after an event; one that stays for four does not damp",
    ),
    "reversals": Monitor(
        "controller",
        "reversals of an output by more than a tenth of its limit, over a second",
        "1/s", 12.0, 1.0, 1000.0, 0.5, "s", "warn",
        "an oscillation of 2 Hz, the fastest of machines, reverses four times a second; three times as many are a "
        "limit cycle. What it does to the grid is judged by `harm` and `growing`; the preset strict trips it",
    ),
    "weights": Monitor(
        "controller",
        "Euclidean norm of what a network has learnt, beside its norm at the start",
        "-", 10.0, 1.0, 1e9, 0.0, "s", "trip",
        "in the scenarios of `two_area` the thesis's variants stay below 1.7; without guards one comes to 7 without "
        "delay, and two to a thousand with that of the Pacific DC Intertie",
    ),
    "lyapunov": Monitor(
        "controller",
        "rise of the Lyapunov function by a step of learning, beside the function",
        "-", 1.0, 0.001, 1e9, 0.5, "s", "trip",
        "learning that doubles what it is to make small, frame after frame, runs away",
    ),
    "harm": Monitor(
        "grid",
        "what the output adds to the growth rate of the watched mode; more than zero takes damping away",
        "1/s", 0.03, 0.0, 10.0, 1.5, CYCLES, "trip",
        "half a per cent of damping ratio at 1 Hz; below it phasors of a quiet grid are uncertain",
    ),
    "growing": Monitor(
        "grid",
        "how much faster the oscillation grows, or slower it fades, than without control: the least of three cycles, "
        "while the output drives it, and once it is larger than earlier ones would be by now without control",
        "1/s", 0.15, 0.0, 10.0, 0.6, CYCLES, "trip",
        "chosen on 3,400 training cases: of sound controllers on one machine it trips 4 in 1,000 with harm, and it "
        "finds as many wrong ones as when it tripped 14 in 100. Beside the plant's own rate, so that an oscillation "
        "that control sustains counts where there would be none, and one that it contains does not",
    ),
    "frequency": Monitor(
        "grid",
        "largest deviation of a PMU's frequency",
        "Hz", 3.0, 0.05, 30.0, 0.2, "s", "trip",
        "generators' own protection lets 57 to 62.5 Hz pass for seconds only; the thesis's runs, without governors, "
        "end 2.5 Hz above the nominal frequency",
    ),
    "islanding": Monitor(
        "grid",
        "largest angle between two PMUs that its signals are made of, from that at the start",
        "deg", 150.0, 10.0, 1e6, 0.1, "s", "trip",
        "two areas so far apart slip; damping by the one against the other has no meaning any more",
    ),
    "device": Monitor(
        "grid",
        "devices that are blocked, or released by their watchdog",
        "devices", 0.5, 0.5, 100.0, 0.5, "s", "trip",
        "who commands a device that does not follow learns nonsense, and would act at once when it comes back; a "
        "fault's undervoltage is over before",
    ),
}  # fmt: skip
CODES = {name: code for code, name in enumerate(MONITORS)}

# Causes of a supervisor's state, beside monitors.
NO_CAUSE, BY_OPERATOR, BY_SCHEDULE = -1, -2, -3
# Causes for refusing to arm, beside monitors.
NOT_IN_SHADOW, NOT_PROBED, PROBE_WEAK, PROBE_GAIN, PROBE_PHASE, PROBE_HARM = range(-4, -10, -1)
CAUSES = {
    NO_CAUSE: "",
    BY_OPERATOR: "operator",
    BY_SCHEDULE: "schedule",
    NOT_IN_SHADOW: "not in shadow",
    NOT_PROBED: "no probe",
    PROBE_WEAK: "probe: coherence",
    PROBE_GAIN: "probe: gain",
    PROBE_PHASE: "probe: phase",
    PROBE_HARM: "probe: damping",
}
_NAMES = list(MONITORS)
_CODES_OF_CAUSES = {text: code for code, text in CAUSES.items()}


def cause_name(code: int) -> str:
    """Name of a cause in messages: a monitor or a text; empty for none."""
    return CAUSES[code] if code < 0 else _NAMES[code]


def cause_code(name: str) -> int:
    """Code of a cause. Raises `KeyError` for an unknown name."""
    return CODES[name] if name in CODES else _CODES_OF_CAUSES[name]


def reason_of(row: Any, thresholds: NDArray[Any], *, refused: bool = False) -> str:
    """Text for the cause in a SUPERVISION record, or with `refused` for the refusal to arm."""
    code = int(row["refused"] if refused else row["cause"])
    if code >= 0:
        monitor = MONITORS[_NAMES[code]]
        value, limit = float(row["values"][code]), float(thresholds["limit"][code])
        return f"{_NAMES[code]} ({monitor.description}): {value:.3g} {monitor.unit}; allowed: {limit:g}"
    found = {
        NOT_PROBED: "no probe; allowed: after ~/probe",
        PROBE_WEAK: f"probe with coherence {row['probe_coherence']:.2f}: the answer is lost in others' noise",
        PROBE_GAIN: f"probe with {row['probe_gain']:.2f} times the known answer",
        PROBE_HARM: f"probe by which control would take {-row['added_damping']:.3g} 1/s of damping away",
        PROBE_PHASE: f"probe with {math.degrees(row['probe_phase']):.0f} degrees off the known answer",
    }
    return found.get(code, cause_name(code))


# Largest plausible deviation of each channel (signals.CHANNELS) from zero or, for frequency, from nominal.
PLAUSIBLE = {
    "voltage_magnitude": 2.0,
    "voltage_angle": math.inf,
    "speed_deviation": 0.1,
    "active_power": 50.0,
    "reactive_power": 50.0,
    "frequency": 6.0,
    "rocof": 30.0,
    "current_magnitude": 50.0,
    "current_angle": math.inf,
}
BAD = 32768 + 16384 + 8192  # bits of a frame's status: data error, test mode, not in synchronism with UTC
