"""Lead-lag design by the residue for a mode, a damping ratio and a delay; the gain is tuned on the closed loop.

At the eigenvalue lambda of the mode, the controller (gain K, washout, two equal sections) compensates the phase of the
residue R, the delay T and half a frame of hold, so that the mode moves to the left:

    arg(K s Tw/(1 + s Tw) ((1 + s T1)/(1 + s T2))^2 R exp(-s (T + 1/(2 f)))) = 180 deg   at s = lambda

with T1 = 1/(w sqrt(a)), T2 = a T1, w = |lambda|; a is found so that this phase holds at lambda. For an undamped mode
and a lead phi of both sections, a = (1 - sin(phi/2))/(1 + sin(phi/2)) (Kundur 1994, 12.5). The gain is raised from zero
on the sampled closed loop, with its delay and hold, and the modes are followed. Tuning stops when the mode has the
wanted ratio, or before a gain that makes another mode worse than allowed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.optimize import brentq

from facts_damping.case.loading import make_case
from facts_damping.control.parameter_tables import LEAD_LAG_PARAMETERS
from facts_damping.small_signal import eigenmodes
from facts_damping_studies.margins.delay_margin import STILL, followed, oscillations
from facts_damping_studies.margins.linear_closed_loop import delayed_loop, eigen, sampled

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from facts_damping.case.model import Case
    from facts_damping.small_signal.eigenmodes import Eigenmode
    from facts_damping_studies.margins.linear_closed_loop import DelayedLoop

WASHOUT = 10.0  # s
STEPS, BEYOND = 32, 4.0  # number of gains tried, up to this multiple of the gain given by the residue
WORSE = 0.1  # fraction of its damping ratio that another mode may lose, if it then is below the wanted ratio
FIGURES = 4  # significant figures of parameters
MAX_SPREAD = 6.0  # ln of T2 / T1: more than 90 degrees of both sections, at any damping
MAX_GAIN = LEAD_LAG_PARAMETERS["gain"].high


class LeadLag(NamedTuple):
    """Parameters of `LLC` except the size of the gain: u = K y with a gain of this sign."""

    sign: int
    lead_deg: float  # of both sections together
    T1: float  # s, of both
    T2: float

    def response(self, s: complex) -> complex:
        """K at a complex frequency (1/s) for a gain of size one."""
        return self.sign * s * WASHOUT / (1.0 + s * WASHOUT) * ((1.0 + s * self.T1) / (1.0 + s * self.T2)) ** 2

    def parameters(self, gain: float) -> dict[str, float]:
        """Parameters of `LLC` for a gain of this size."""
        return {"gain": self.sign * gain, "Tw": WASHOUT, "T1": self.T1, "T2": self.T2, "T3": self.T1, "T4": self.T2}


class Tuned(NamedTuple):
    """The tuned gain, and the electromechanical modes without and with it, matched by following them."""

    gain: float
    reached: bool  # whether the target mode has the wanted ratio
    before: list[Eigenmode]
    after: list[Eigenmode | None]  # None: lost on the way
    target: int  # index of the target mode
    growing: Eigenmode | None  # a mode other than the target that is unstable without control as well
    limit: Eigenmode | None  # the oscillation that the next higher gain would make worse than allowed; or None


def rounded(value: float) -> float:
    """A number rounded to `FIGURES` significant figures."""
    return float(f"{value:.{FIGURES}g}")


def late(eigenvalue: complex, delay: float, frame_rate: int) -> complex:
    """Factor of delay (s) and hold on a signal at an eigenvalue."""
    return complex(np.exp(-eigenvalue * (delay + 0.5 / frame_rate)))


def lead_lag(residue: complex, eigenvalue: complex, delay: float, frame_rate: int) -> LeadLag:
    """The sections and the sign for a residue (1/s) with a delay (s)."""
    washed = eigenvalue * WASHOUT / (1.0 + eigenvalue * WASHOUT)
    angle = float(np.rad2deg(np.angle(residue * washed * late(eigenvalue, delay, frame_rate))))
    sign, lead = eigenmodes.sign_and_lead(angle)
    w = abs(eigenvalue)

    def beyond(exponent: float) -> float:
        """Lead of sections with a = e^exponent at the eigenvalue minus the wanted lead, deg."""
        T1 = np.exp(-0.5 * exponent) / w
        section = (1.0 + eigenvalue * T1) / (1.0 + eigenvalue * T1 * np.exp(exponent))
        return 2.0 * float(np.rad2deg(np.angle(section))) - lead

    exponent = float(brentq(beyond, -MAX_SPREAD, MAX_SPREAD))
    T1 = float(np.exp(-0.5 * exponent)) / w
    return LeadLag(sign, lead, rounded(T1), rounded(T1 * float(np.exp(exponent))))


def tune(
    run: dict[str, Any],
    law: LeadLag,
    residue: complex,
    mode: Eigenmode,
    wanted: float,
    delay: float,
    progress: Callable[[int, int], None],
) -> Tuned:
    """The gain that gives a mode the wanted damping ratio, or the highest ratio that the other modes allow.

    `run`: content of a run file with `LLC`. `residue`: from its device to its signal. `delay` (s): of its link.
    """
    # First estimate of the gain from the residue: d lambda = R K exp(-lambda (T + 1/(2 f))).
    moved = abs(residue * law.response(mode.eigenvalue) * late(mode.eigenvalue, delay, int(run["frame_rate"])))
    first = (wanted - mode.damping_ratio) * abs(mode.eigenvalue) / moved
    gains = [0.0, *(np.linspace(BEYOND / STEPS, BEYOND, STEPS) * min(first, MAX_GAIN / BEYOND)).tolist()]
    unit = {**run["controllers"][0], "parameters": law.parameters(1.0)}
    case = make_case({**run, "controllers": [unit]}, "design")
    loop = delayed_loop(case)
    listed: list[list[Eigenmode]] = []
    for i, gain in enumerate(gains):
        progress(i, len(gains))
        listed.append(_oscillations(loop, gain, delay, case))
    progress(len(gains), len(gains))
    before = [eigenmode for eigenmode in listed[0] if eigenmode.swings]
    target = int(np.argmin(eigenmodes.unlike([mode], before)))
    tracks = [[start, *later] for start, later in zip(before, followed(before, listed[1:]), strict=True)]
    ratios = [_ratio(eigenmode) for eigenmode in tracks[target]]
    good, limit = _harmless(listed, tracks, target, wanted)
    enough = next((k for k in range(good) if ratios[k] >= wanted), None)
    last = int(np.argmax(ratios[:good])) if enough is None else max(0, enough - 1)
    gain = rounded(gains[last])
    if enough is not None:

        def missing(at: float) -> float:
            return _ratio(_next(tracks[target][last], _oscillations(loop, at, delay, case))) - wanted

        gain = 0.0
        if enough:  # rounded up
            exact = float(brentq(missing, gains[last], gains[enough], rtol=1e-4))
            near = rounded(exact)
            gain = near if near >= exact else rounded(exact * (1.0 + 0.6 * 10.0 ** (1 - FIGURES)))
    if enough is not None or last < good - 1:
        limit = None
    then = _oscillations(loop, gain, delay, case)
    after = [_next(track[last], then) for track in tracks]
    growing = next(
        (eigenmode for eigenmode in listed[0] if eigenmode.eigenvalue.real > STILL and eigenmode is not before[target]),
        None,
    )
    return Tuned(gain, enough is not None, before, after, target, growing, limit)


def _next(mode: Eigenmode | None, modes: Sequence[Eigenmode]) -> Eigenmode | None:
    """A mode at another gain; None: it is lost, or was lost before."""
    return None if mode is None else followed([mode], [modes])[0][0]


def _oscillations(loop: DelayedLoop, gain: float, delay: float, case: Case) -> list[Eigenmode]:
    """The oscillations of the closed loop; the controller's gain, which is one, is multiplied by `gain`."""
    c = loop.controllers[0]
    scaled = loop._replace(controllers=[c._replace(C=gain * c.C, D=gain * c.D)])
    return oscillations(scaled, eigen(scaled, sampled(scaled, delay)), case)


def _ratio(mode: Eigenmode | None) -> float:
    """Damping ratio of a followed mode; the worst possible value for a lost mode."""
    return -1.0 if mode is None else mode.damping_ratio


def _floor(ratio: float, wanted: float) -> float:
    """The lowest damping ratio allowed for another mode that had `ratio`."""
    return min(ratio, wanted) - WORSE * abs(min(ratio, wanted))


def _harmless(
    listed: Sequence[Sequence[Eigenmode]], tracks: Sequence[Sequence[Eigenmode | None]], target: int, wanted: float
) -> tuple[int, Eigenmode | None]:
    """The number of gains, from the first, at which no other oscillation is too bad, and the first one that then is."""
    floors = [_floor(_ratio(track[0]), wanted) for track in tracks]
    minimum = None
    for k, modes in enumerate(listed):
        swings = [(track[k], floor) for track, floor in zip(tracks, floors, strict=True)]
        swinging = {id(mode) for mode, _ in swings}
        rest = [mode for mode in modes if id(mode) not in swinging]
        minimum = min((mode.damping_ratio for mode in rest), default=1.0) if minimum is None else minimum
        del swings[target]
        for mode, floor in [*swings, *((mode, _floor(minimum, wanted)) for mode in rest)]:
            if mode is not None and mode.damping_ratio < floor:
                return k, mode
    return len(listed), None
