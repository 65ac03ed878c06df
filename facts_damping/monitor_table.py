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
        "time without frames from which its signals can be computed",
        "s", 0.16, 0.01, 60.0, 0.0,
        "nine missing frames at 60 frames/s are tolerated: single losses, and bursts of 0.1 s",
    ),
    "stale": _data(
        "age of the oldest frame that its signals use",
        "s", 0.4, 0.01, 60.0, 0.05,
        "more than twice the delay of the Pacific DC Intertie, 69 to 113 ms, plus one lost frame; less than the delay "
        "that most controllers tolerate",
    ),
    "jitter": Monitor(
        "data",
        "mean deviation of the latency from its mean, both over 1 s",
        "s", 0.05, 0.001, 10.0, 1.0, "s", "warn",
        "three frames of jitter: controllers were not designed for such a link",
    ),
    "misaligned": _data(
        "difference of the time stamps of the PMUs that its signals use",
        "s", 0.1, 0.001, 10.0, 0.05,
        "0.1 s shifts the phase of a 1 Hz mode by 36 degrees",
    ),
    "stuck": _data(
        "time for which a PMU repeats its values although its frequency is not nominal",
        "s", 0.2, 0.02, 60.0, 0.0,
        "off nominal frequency the voltage angle cannot be constant; twelve equal frames are no coincidence",
    ),
    "range": _data(
        "largest value of a channel that it uses, relative to the largest plausible value",
        "-", 1.0, 0.01, 100.0, 0.0,
        "plausible: speed 0.1 p.u., frequency 6 Hz from nominal, ROCOF 30 Hz/s, voltage 2 p.u., power and current "
        "50 p.u.",
    ),
    "angle": _data(
        "difference between a PMU's frequency and the rate of change of its voltage angle, over 0.1 s",
        "Hz", 0.25, 0.01, 30.0, 0.3,
        "near a fault angles jump, but for less than 0.3 s; a frequency error of 0.25 Hz is half of the swing after "
        "a fault",
    ),
    "speed": _data(
        "difference between a PMU's rotor speed and its frequency, over 0.1 s",
        "Hz", 0.5, 0.01, 30.0, 0.5,
        "after a fault the two differ by up to 0.4 Hz (`two_area_large`)",
    ),
    "powers": _data(
        "sum of the powers that PMUs measure into both ends of a line, relative to the larger one",
        "-", 0.2, 0.01, 10.0, 0.2,
        "losses of a line are a few per cent; with a reversed current transformer the value is 2",
    ),
    "status": _data(
        "PMUs with status data error, test mode or not synchronised (bits 15 to 13)",
        "pmus", 0.5, 0.5, 100.0, 0.05,
        "IEEE C37.118.2: such frames must not be used",
    ),
    "clock": _data(
        "how much a frame's time stamp is later than its arrival",
        "s", 0.001, 1e-6, 10.0, 0.0,
        "no frame arrives before it is measured; a synchronised clock is accurate to 1 us",
    ),
    "local": Monitor(
        "data",
        "time without a setpoint of the fallback while it acts",
        "s", 0.16, 0.01, 60.0, 0.0, "s", "trip",
        "the same limit as for remote frames; there is no other fallback",
    ),
    "silent": Monitor(
        "controller",
        "time since the first frames that the controller has not answered: it is hung, dead or too slow",
        "s", 0.16, 0.01, 60.0, 0.0, "s", "fall_back",
        "less than the 0.2 s after which the watchdog releases the device",
    ),
    "non_finite": Monitor(
        "controller",
        "outputs that are not finite",
        "-", 0.0, 0.0, 1e9, 0.0, "s", "trip",
        "after one such output the state of the controller is lost",
    ),
    "saturated": Monitor(
        "controller",
        "fraction of the last 2 s in which an output is at one of its limits",
        "-", 0.95, 0.01, 1.0, 2.0, "s", "trip",
        "an output that damps changes sign each half cycle (1 s at 0.5 Hz) and after an event may stay at a limit "
        "for two of them; an output that stays for four does not damp",
    ),
    "reversals": Monitor(
        "controller",
        "number of reversals of an output by more than 10 % of its limit, over 1 s",
        "1/s", 12.0, 1.0, 1000.0, 0.5, "s", "warn",
        "the fastest electromechanical modes, 2 Hz, give 4 reversals per second; three times as many are a limit "
        "cycle. Its effect on the grid is judged by `harm` and `growing`; with the preset `strict` it is a trip",
    ),
    "weights": Monitor(
        "controller",
        "Euclidean norm of a neuro-fuzzy controller's parameters, relative to the start",
        "-", 10.0, 1.0, 1e9, 0.0, "s", "trip",
        "in the scenarios of `two_area` the thesis's variants stay below 1.7; without safety measures one reaches 7 "
        "without delay, and two reach 1000 with the link `pdci`",
    ),
    "lyapunov": Monitor(
        "controller",
        "relative increase of the Lyapunov function by one learning step",
        "-", 1.0, 0.001, 1e9, 0.5, "s", "trip",
        "learning that doubles the function which it should reduce, frame after frame, diverges",
    ),
    "harm": Monitor(
        "grid",
        "growth rate that the output adds to the watched mode; a positive value reduces damping",
        "1/s", 0.03, 0.0, 10.0, 1.5, CYCLES, "trip",
        "a damping ratio of 0.5 % at 1 Hz; smaller values are uncertain when the grid is quiet",
    ),
    "growing": Monitor(
        "grid",
        "mean growth rate of the oscillation over three cycles, minus the rate without control; 0 unless it grows "
        "faster in each cycle, the output may drive it, and it is 1.6 times what earlier ones would be by now",
        "1/s", 0.15, 0.0, 10.0, 0.6, CYCLES, "trip",
        "chosen on 3,400 training cases: with `harm` it trips 4 in 1,000 sound controllers on one machine, and finds "
        "as many wrong ones as when it tripped 14 in 100. Relative to the rate without control, so that an "
        "oscillation that control sustains counts, and one that control contains does not",
    ),
    "frequency": Monitor(
        "grid",
        "largest deviation of a PMU's frequency",
        "Hz", 3.0, 0.05, 30.0, 0.2, "s", "trip",
        "generator protection tolerates 57 to 62.5 Hz for seconds only; the thesis's runs, without governors, end "
        "2.5 Hz above nominal frequency",
    ),
    "islanding": Monitor(
        "grid",
        "largest change, since the start, of the angle between two PMUs that its signals use",
        "deg", 150.0, 10.0, 1e6, 0.1, "s", "trip",
        "two areas so far apart lose synchronism; damping one against the other is then meaningless",
    ),
    "device": Monitor(
        "grid",
        "devices that are blocked, or released by their watchdog",
        "devices", 0.5, 0.5, 100.0, 0.5, "s", "trip",
        "a controller of a device that does not follow learns wrongly, and would act at once when the device returns; "
        "undervoltage in a fault is shorter",
    ),
    "forced": Monitor(
        "grid",
        "how constant the size of the oscillation is: 1: a sine wave, 0: a mode that noise drives; 0 unless an output "
        "answers it; unknown while an output is at its limit, and then for 20 cycles or four memories of the mode",
        "-", 0.85, 0.5, 2.0, 2.0, CYCLES, "warn",
        "a wave of twelve times the power of the noise has 0.85; a mode of 1 % in noise gets there in less than one of "
        "a hundred periods of ten minutes. A source outside of the loop forces what is constant, no control removes it",
    ),
}  # fmt: skip
COUNTED = {  # monitors whose values are numbers of things, and what these are
    "status": ("PMU", "of bad status"),
    "non_finite": ("output", "not finite"),
    "device": ("device", "blocked or released"),
}
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


def count_text(cause: str, value: float) -> str:
    """A number of things in words, for a cause of COUNTED: `1 device blocked or released`."""
    thing, how = COUNTED[cause]
    return f"{value:.0f} {thing}{'' if value == 1.0 else 's'} {how}"


def reason_of(row: Any, thresholds: NDArray[Any], *, refused: bool = False) -> str:
    """Text for the cause in a SUPERVISION record, or with `refused` for the refusal to arm."""
    code = int(row["refused"] if refused else row["cause"])
    if code >= 0:
        monitor = MONITORS[_NAMES[code]]
        value, limit = float(row["values"][code]), float(thresholds["limit"][code])
        if _NAMES[code] in COUNTED:
            then = "; re-arm released devices first" if refused and _NAMES[code] == "device" else ""
            return f"{count_text(_NAMES[code], value)}; allowed: {math.floor(limit) or 'none'}{then}"
        return f"{_NAMES[code]} ({monitor.description}): {value:.3g} {monitor.unit}; allowed: {limit:g}"
    texts = {
        NOT_PROBED: "no probe; allowed: after ~/probe",
        PROBE_WEAK: f"probe: coherence {row['probe_coherence']:.2f}, the response is lost in noise",
        PROBE_GAIN: f"probe: response {row['probe_gain']:.2f} times that of the model",
        PROBE_HARM: f"probe: control would reduce damping by {-row['added_damping']:.3g} 1/s",
        PROBE_PHASE: f"probe: response {math.degrees(row['probe_phase']):.0f} degrees from that of the model",
    }
    return texts.get(code, cause_name(code))


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
