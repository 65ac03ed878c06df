"""Verdict of a run: of its response to the events where there is a twin, of its modes in noise alone, or of itself.

What is not damped may be forced from outside of the loop (`forced`): then the verdict says so, as no damping control
removes it.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.analysis import forced
from facts_damping.analysis.effort import saturation_duty
from facts_damping.analysis.measures import device_limits, inline_system
from facts_damping.analysis.modes.ambient import fit_ambient
from facts_damping.analysis.modes.oscillation import RESOLUTION
from facts_damping.analysis.modes.ringdown import SKIP, fit_ringdown, interval
from facts_damping.analysis.response import PULSE_END, less_noise, noisy
from facts_damping.analysis.verdict import DAMPED, FORCED, GROWING, LIMIT_CYCLE, UNDECIDED, Judgement, envelopes, judge

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.analysis.modes.ringdown import Fit
    from facts_damping.analysis.response import Swings, Twin
    from facts_damping.record import Record

RESPONSE, RUN, AMBIENT, PULSE = "response", "run", "ambient noise", "response to a pulse"  # what a verdict is of
CLEAR_DB = 10.0  # signal-to-residual ratio of a ringdown of a response that may decide
ABOVE_DB = 10.0  # level of a response above what noise leaves in it, from which on it may be called undamped
LIMITED, LAST = 0.1, 10.0  # fraction of the last seconds with a device at a limit; above, a loop is at its limits
FULL = 0.99  # of its limit, from which on a current, which follows it with a lag, is at it
GROWN, END = 4.5, 4.0  # s: noise grows if its envelope in the last seconds is so many times that of the first half
STEADY = 0.005  # damping ratio; a mode in noise whose interval ends below it is a steady oscillation
AT_LIMITS = "a device is at its limits to the end"
SMALL = "the response is small beside the noise"
LOST_TWIN = "the twin of the run loses synchronism"


class Judged(NamedTuple):
    """A verdict, and what it is of: RESPONSE, RUN, AMBIENT or PULSE."""

    judgement: Judgement
    of: str


def judge_run(
    record: Record,
    twin: Twin | None,
    swings: Swings,
    ringdown: Callable[[], Fit | None] | None = None,
    noise: Callable[[], Fit | None] | None = None,
) -> Judged:
    """Judge a run in synchronism.

    `ringdown`, `noise`: give fits already made, of what is judged and of the run. No loop at limits is called forced.
    """
    limited = _at_limits(record, max(swings.last, swings.time_s[-1] - LAST)) > LIMITED
    judged = _judge(record, twin, swings, ringdown, noise, limited=limited)
    small = judged.judgement.because.startswith(SMALL)  # a source is an event, so that its response is not
    if limited or small or judged.judgement.verdict == DAMPED or judged.of == PULSE:
        return judged
    for x in (swings.own,) if swings.response is None else (swings.response, swings.own):
        origin = forced.origin(swings.time_s[: len(x)], x, swings.last)
        if origin.kind == forced.FORCED:
            because = forced.words(origin, inline_system(record.configuration).get("frequency"))
            return judged._replace(judgement=judged.judgement._replace(verdict=FORCED, because=because))
    return judged


def _judge(
    record: Record,
    twin: Twin | None,
    swings: Swings,
    ringdown: Callable[[], Fit | None] | None,
    noise: Callable[[], Fit | None] | None,
    *,
    limited: bool,
) -> Judged:
    """The verdict by growth and decay alone."""
    t, last = swings.time_s, swings.last
    if swings.times and twin is not None:
        ringdown = ringdown or cache(lambda: fit_ringdown(t[: swings.ringing], swings.judged[: swings.ringing], last))
        return judge_response(swings, ringdown, limited=limited)
    if not swings.times and (twin is not None or record.configuration.get("load_noise")):
        return judge_ambient(noise() if noise else fit_ambient(t, swings.own), swings)
    itself = judge(t, swings.own, last, swings.names, ringdown)
    words = "; noise is in it" if noisy(record.configuration) else ""
    return Judged(itself._replace(because=f"{itself.because}{words}"), RUN)


def _at_limits(record: Record, since: float) -> float:
    """Largest fraction of the frames from `since` (s) on at which a device's setpoint or current is at its limit."""
    limits = device_limits(record.configuration, "I_max")
    most = FULL * np.array([limits.get(name, np.inf) for name in record.device_names])
    full = (record.devices["current"][record.time_s >= since] >= most).mean(axis=0)
    return float(max([0.0, *saturation_duty(record, since).values(), *full]))


def judge_response(swings: Swings, ringdown: Callable[[], Fit | None], *, limited: bool) -> Judged:
    """Judge a run by its response; without one, its twin has lost synchronism.

    `ringdown`: gives that of the response; `limited`: a device is at its limits to the end. Then it is not the image of
    its mirror, and the run itself counts where it does not decay; so it does if its noise grows.
    """
    ticks = len(swings.judged)
    t, swing = swings.time_s[:ticks], swings.own[:ticks]
    if swings.response is None or limited:
        itself = judge(t, swing, swings.last, swings.names)
        if itself.verdict in (GROWING, LIMIT_CYCLE):
            return Judged(itself, RUN)
        return Judged(itself._replace(verdict=UNDECIDED, because=AT_LIMITS if limited else LOST_TWIN), RUN)
    judgement = judge(t, swings.response, swings.last, swings.names, ringdown)
    if judgement.verdict != DAMPED and swings.quiet is not None:
        judgement, ringdown = _judge_less_noise(swings)
    if judgement.verdict == UNDECIDED and _decays(ringdown()):
        judgement = judgement._replace(verdict=DAMPED, because="the modes of its response are damped")
    if judgement.verdict in (DAMPED, UNDECIDED) and (grows := _noise_grows(swings)) is not None:
        return Judged(grows, RUN)
    return Judged(judgement, RESPONSE)


def _judge_less_noise(swings: Swings) -> tuple[Judgement, Callable[[], Fit | None]]:
    """Judgement and ringdown of a response without what noise leaves in it; undecided if that is not much smaller."""
    clear, left = less_noise(swings)
    t, x = clear.time_s[: len(clear.judged)], clear.judged
    fit = cache(lambda: fit_ringdown(t[: clear.ringing], x[: clear.ringing], clear.last))
    judgement = judge(t, x, clear.last, clear.names, fit)
    noise = float(np.sqrt(2.0) * left[t >= judgement.start_s].std(axis=0).max())
    level = 20.0 * np.log10(max(judgement.amplitude_pu, RESOLUTION) / max(noise, RESOLUTION))
    if judgement.verdict != DAMPED and level < ABOVE_DB:
        because = f"{SMALL}: {level:.0f} dB, {ABOVE_DB:g} dB are needed"
        judgement = judgement._replace(verdict=UNDECIDED, because=because)
    return judgement, fit


def _noise_grows(swings: Swings) -> Judgement | None:
    """The judgement of the noise in a run after the last event if its largest envelope grows, else None.

    Noise of a sound loop has envelopes that vary by a factor of 2 to 4, and may look as if it grew for a while.
    """
    if swings.noise is None:
        return None
    t = swings.time_s[: len(swings.noise)]
    points, sizes = envelopes(swings.noise[t >= swings.last + SKIP], float(np.median(np.diff(t))))
    if len(points) < 2:
        return None
    usual = np.median(sizes[: len(sizes) // 2], axis=0).max()
    if sizes[points > points[-1] - END].max() <= GROWN * usual:
        return None
    judgement = judge(t, swings.noise, swings.last, swings.names)
    return None if judgement.verdict == DAMPED else judgement._replace(verdict=GROWING, because="the noise in it grows")


def _decays(fit: Fit | None) -> bool:
    """Whether a ringdown is clear, and the damping ratios of all its modes are above zero with their intervals."""
    if fit is None or not fit.modes or fit.snr_db < CLEAR_DB:
        return False
    return all(low > 0.0 for low, _ in _intervals(fit))


def _intervals(fit: Fit) -> list[tuple[float, float]]:
    """95 % intervals of the modes' damping ratios; infinite without an error."""
    return [interval(mode.damping_ratio, np.nan_to_num(mode.damping_ratio_error, nan=np.inf)) for mode in fit.modes]


def judge_ambient(fit: Fit | None, swings: Swings) -> Judged:
    """Judge a run with noise and no event: by its modes and their 95 % intervals, else by the response to a pulse."""
    ends = _intervals(fit) if fit else []
    verdict, because = UNDECIDED, "no event, and no mode found in the noise"
    if any(high < STEADY for _, high in ends):
        verdict, because = LIMIT_CYCLE, "a mode neither grows nor decays in the noise"
    elif ends and all(low > 0.0 for low, _ in ends):
        verdict, because = DAMPED, "no event: its modes in the noise are damped"
    elif swings.pulse is not None:
        return Judged(judge(swings.time_s[: len(swings.pulse)], swings.pulse, PULSE_END, swings.names), PULSE)
    elif ends:
        because = "no event: the interval of a mode's damping ratio in the noise holds zero"
    amplitude = float(np.sqrt(2.0) * swings.own.std(axis=0).max())
    return Judged(Judgement(verdict, because, None, 0.0, amplitude), AMBIENT)
