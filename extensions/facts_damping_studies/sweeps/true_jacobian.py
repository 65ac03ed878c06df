"""The true Jacobian of the nonlinear plant during a run, for comparison with the identifier's estimate.

It starts from the plant's state some frames earlier, with the references of all devices held, and repeats this with
one reference changed by 1e-4 p.u.; the derivative is the difference of the signals over 1e-4.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.control.lead_lag import section
from facts_damping.errors import InputError
from facts_damping.plant.integration import advance
from facts_damping.plant.measurement import measure
from facts_damping.plant.model import copy, workspace
from facts_damping.signals import DEVICE_TRUTH, MACHINE_TRUTH, SETPOINT
from facts_damping.simulation import loop
from facts_damping.simulation.assembly import build_plant
from facts_damping.simulation.measured_plant import tick_ns
from facts_damping.small_signal.linearisation import weights_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.plant.model import PlantState
    from facts_damping.record import Record

MOVE = 1e-4  # p.u., of a reference
EVERY = 6  # frames between two evaluations
ANSWER = 0.01  # fraction of the root mean square below which a true derivative counts as no response
FIGURES = ("right_sign", "error", "right_sign_stated", "answering")
ROUND = 1e-9  # normalised: a smaller true derivative counts as zero


class Followed(NamedTuple):
    """Estimated and true derivatives at some ticks, for controller 0; 1 = `scale` for the device's limit."""

    time_s: NDArray[np.float64]  # (evaluations,)
    estimate: NDArray[np.float64]  # (evaluations, signals, devices)
    true: NDArray[np.float64]  # same shape, over the identifier's own horizon
    stated: NDArray[np.float64]  # same shape, over the requested horizon


class Respondent:
    """A plant that can be reset to any tick of a run to compute the response of the signals to the devices."""

    def __init__(self, case: Case, record: Record) -> None:
        """Repeat the run with the applied setpoints and store the states."""
        self.case, self.rate = case, case.run.frame_rate
        built = build_plant(case)
        self.plant, self.work = built.plant, workspace(built.plant, built.state)
        self.states: list[PlantState] = []
        first = np.searchsorted(record.applied["tick"], np.arange(len(record.time_ns) + 1))
        state = built.state
        for k in range(len(record.time_ns)):
            self.states.append(copy(state))
            self._advance(state, k, record.applied[first[k] : first[k + 1]])
        pmus = [pmu.name for pmu in case.system.pmus]
        signals = [case.system.signals[name] for name in case.controllers[0].signals]
        self.weights = np.array([weights_of(signal, pmus, case.system.frequency) for signal in signals])
        self.washout = [signal.washout for signal in signals]
        self.devices = [case.run.devices.index(name) for name in case.controllers[0].devices]

    def _advance(self, state: PlantState, tick: int, rows: NDArray[Any]) -> None:
        advance(self.plant, state, tick_ns(tick, self.rate), tick_ns(tick + 1, self.rate), rows, len(rows), self.work)

    def _signals(self, state: PlantState, tick: int) -> NDArray[np.float64]:
        """The signals before their washouts, (signals,)."""
        frame = np.zeros(self.weights.shape[1:])
        truth = np.zeros(len(self.plant.machines), MACHINE_TRUTH), np.zeros(len(self.plant.devices), DEVICE_TRUTH)
        measure(self.plant, state, tick_ns(tick, self.rate), frame, *truth, self.work)
        return np.asarray((self.weights * np.nan_to_num(frame)).sum(axis=(1, 2)))

    def _held(self, tick: int, frames: int, reference: NDArray[np.float64]) -> NDArray[np.float64]:
        """Signals in the frames after a tick with held references, (frames, signals)."""
        state = copy(self.states[tick])
        state.reference[:] = state.target[:] = reference
        state.waiting[:] = 0  # pending setpoints would change the references
        responses, nothing = [], np.zeros(0, SETPOINT)
        for k in range(frames):
            self._advance(state, tick + k, nothing)
            responses.append(self._signals(state, tick + k + 1))
        return np.array(responses)

    def jacobian(self, tick: int, frames: int) -> NDArray[np.float64]:
        """Derivative of the signals by held references, `frames` after a tick, (signals, devices), p.u./p.u."""
        reference = self.states[tick].reference
        rest = self._held(tick, frames, reference)
        derivative = np.zeros((len(self.washout), len(self.devices)))
        for d, device in enumerate(self.devices):
            move = -MOVE if reference[device] > 0.0 else MOVE  # away from the limit
            moved = reference.copy()
            moved[device] += move
            answer = (self._held(tick, frames, moved) - rest) / move
            for i, tau in enumerate(self.washout):
                derivative[i, d] = _washed(answer[:, i], tau, 1.0 / self.rate)
        return derivative


def _washed(y: NDArray[np.float64], tau: float, dt: float) -> float:
    """The last output of a washout that starts at rest."""
    memory, value = np.zeros(2), float(y[-1])
    if tau > 0.0:
        for sample in y:
            value = float(section(tau, 0.0, tau, dt, memory, 0, float(sample)))
    return value


def follow(case: Case, record: Record, horizon: int) -> Followed:
    """Estimated and true derivatives over a run. Raises `InputError` if controller 0 has no identifier."""
    derivatives(case)
    c = case.controllers[0]
    identified_horizon = int(c.number("identifier_horizon"))
    p, q = len(c.signals), len(c.devices)
    rows = record.estimates[record.estimates["controller"] == 0]
    estimates = rows["jacobian"].reshape(-1, p, q)
    respondent = Respondent(case, record)
    ticks = np.arange(max(identified_horizon, horizon), len(record.time_ns), EVERY)
    built = loop.build_loop(case)
    limits, scale = built.control.bank.actuators.limit[0, :q], built.control.bank.settings[0]["scale"][:p]
    unit = limits / scale[:, None]
    true, stated = (
        np.array([respondent.jacobian(int(k) - frames, frames) for k in ticks]).reshape(-1, p, q) * unit
        for frames in (identified_horizon, horizon)
    )
    return Followed(record.time_s[ticks], estimates[ticks] * unit, true, stated)


def derivatives(case: Case) -> list[str]:
    """The derivatives estimated by controller 0's identifier, `signal/device`. Raises `InputError` if it has none."""
    c = case.controllers[0] if case.controllers else None
    if c is None or c.scheme != "indirect":
        controller_text = f"{c.name} {c.scheme or ''}".strip() if c else "no controller"
        raise InputError(
            f"jacobian: {controller_text} given, which has no identifier; allowed: neuro-fuzzy, scheme indirect"
        )
    return [f"{signal}/{device}" for signal in c.signals for device in c.devices]


def names(case: Case) -> list[str]:
    """Column names of the comparison, such as `right_sign.speed/sssc`."""
    return [f"{figure}.{name}" for figure in FIGURES for name in derivatives(case)]


def figures(case: Case, followed: Followed) -> dict[str, float]:
    """The result of `compared` as a flat dictionary."""
    by_name = compared(followed)
    return dict(zip(names(case), np.ravel([by_name[figure] for figure in FIGURES]).tolist(), strict=True))


def compared(followed: Followed) -> dict[str, NDArray[np.float64]]:
    """For each derivative, (signals, devices): fraction of right signs, median error, and fraction with a response.

    The error is relative to the root mean square of the true derivative over the run. A sign counts only if the device
    responds: the true derivative is at least a hundredth of that (a device at its limit does not respond).
    """
    size = np.sqrt(np.mean(followed.true**2, axis=0))
    return {
        "right_sign": _right(followed.estimate, followed.true),
        "right_sign_stated": _right(followed.estimate, followed.stated),
        "error": np.median(np.abs(followed.estimate - followed.true), axis=0) / np.maximum(size, ROUND),
        "answering": np.mean(_answers(followed.true), axis=0),
    }


def _answers(true: NDArray[np.float64]) -> NDArray[np.bool_]:
    return np.asarray(np.abs(true) > np.maximum(ANSWER * np.sqrt(np.mean(true**2, axis=0)), ROUND))


def _right(estimate: NDArray[np.float64], true: NDArray[np.float64]) -> NDArray[np.float64]:
    """Fraction of the evaluations with a response in which the estimate has the true sign."""
    answers = _answers(true)
    return np.asarray(((estimate * true > 0.0) & answers).sum(axis=0) / np.maximum(answers.sum(axis=0), 1))
