"""The true Jacobian over a run, beside the identifier's.

The true one is that of the nonlinear plant: from its state some frames before, with the references of all devices held,
and once more with that of one device moved by 1e-4 p.u.: what the signals differ by, over 1e-4.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.control.lead_lag import section
from facts_damping.errors import InputError
from facts_damping.plant.integration import advance
from facts_damping.plant.measurement import measure
from facts_damping.plant.model import copy, workspace
from facts_damping.signals import DEVICE_TRUTH, MACHINE_TRUTH, SETPOINT, Record
from facts_damping.simulation import loop
from facts_damping.simulation.build import build_plant
from facts_damping.simulation.measured_plant import tick_ns
from facts_damping.small_signal.linearisation import weights_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.plant.model import PlantState

MOVE = 1e-4  # p.u., of a reference
EVERY = 6  # frames between two looks at the plant
ANSWER = 0.01  # of the root mean square: a true derivative below is no answer
FIGURES = ("right_sign", "error", "right_sign_stated", "answering")
ROUND = 1e-9  # normalised: a true derivative below is taken for zero


class Followed(NamedTuple):
    """Estimate and truth at some ticks of a run, of controller 0; normalised: 1 = `scale` for the device's limit."""

    time_s: NDArray[np.float64]  # (looks,)
    estimate: NDArray[np.float64]  # (looks, signals, devices)
    true: NDArray[np.float64]  # the same shape, over the identifier's own horizon
    stated: NDArray[np.float64]  # the same over the horizon asked for


class Respondent:
    """A plant that can be taken back to any tick of a run and asked how signals answer the devices."""

    def __init__(self, case: Case, record: Record) -> None:
        """Follow the run once more by the setpoints that were applied, and keep the states."""
        self.case, self.rate = case, case.run.frame_rate
        built = build_plant(case)
        self.plant, self.work = built.plant, workspace(built.plant, built.state)
        self.states: list[PlantState] = []
        first = np.searchsorted(record.applied["tick"], np.arange(len(record.time_ns) + 1))
        state = built.state
        for k in range(len(record.time_ns)):
            self.states.append(copy(state))
            rows = record.applied[first[k] : first[k + 1]]
            self._advance(state, k, rows)
        stations = [station.name for station in case.system.stations]
        own = [case.system.signals[name] for name in case.controllers[0].signals]
        self.weights = np.array([weights_of(signal, stations, case.system.frequency) for signal in own])
        self.washout = [signal.washout for signal in own]
        self.devices = [case.run.devices.index(name) for name in case.controllers[0].devices]

    def _advance(self, state: PlantState, tick: int, rows: NDArray[Any]) -> None:
        advance(self.plant, state, tick_ns(tick, self.rate), tick_ns(tick + 1, self.rate), rows, len(rows), self.work)

    def _signals(self, state: PlantState, tick: int) -> NDArray[np.float64]:
        """The signals before their washouts, (signals,)."""
        frame = np.zeros(self.weights.shape[1:])
        machines, devices = (
            np.zeros(len(self.plant.machines), MACHINE_TRUTH),
            np.zeros(len(self.plant.devices), DEVICE_TRUTH),
        )
        measure(self.plant, state, tick_ns(tick, self.rate), frame, machines, devices, self.work)
        return np.asarray((self.weights * np.nan_to_num(frame)).sum(axis=(1, 2)))

    def _held(self, tick: int, frames: int, reference: NDArray[np.float64]) -> NDArray[np.float64]:
        """Signals of the frames after a tick with references held since, (frames, signals)."""
        state = copy(self.states[tick])
        state.reference[:] = state.target[:] = reference
        state.waiting[:] = 0  # nothing is under way that would change them
        found, nothing = [], np.zeros(0, SETPOINT)
        for k in range(frames):
            self._advance(state, tick + k, nothing)
            found.append(self._signals(state, tick + k + 1))
        return np.array(found)

    def jacobian(self, tick: int, frames: int) -> NDArray[np.float64]:
        """How the signals, so many frames after a tick, answer references held since, (signals, devices), p.u./p.u."""
        reference = self.states[tick].reference
        rest = self._held(tick, frames, reference)
        found = np.zeros((len(self.washout), len(self.devices)))
        for d, device in enumerate(self.devices):
            move = -MOVE if reference[device] > 0.0 else MOVE  # away from the limit
            moved = reference.copy()
            moved[device] += move
            answer = (self._held(tick, frames, moved) - rest) / move
            for i, tau in enumerate(self.washout):
                found[i, d] = _washed(answer[:, i], tau, 1.0 / self.rate)
        return found


def _washed(y: NDArray[np.float64], tau: float, dt: float) -> float:
    """The last value behind a washout that was at rest."""
    kept, value = np.zeros(2), float(y[-1])
    if tau > 0.0:
        for one in y:
            value = float(section(tau, 0.0, tau, dt, kept, 0, float(one)))
    return value


def follow(case: Case, record: Record, horizon: int) -> Followed:
    """Estimate and truth over a run. Raises `InputError` where controller 0 has no identifier."""
    derivatives(case)
    c = case.controllers[0]
    own = int(c.number("identifier_horizon"))
    p, q = len(c.signals), len(c.devices)
    rows = record.estimates[record.estimates["controller"] == 0]
    estimates = rows["jacobian"].reshape(-1, p, q)
    respondent = Respondent(case, record)
    ticks = np.arange(max(own, horizon), len(record.time_ns), EVERY)
    built = loop.build_loop(case)
    limits, scale = built.control.bank.actuators.limit[0, :q], built.control.bank.settings[0]["scale"][:p]
    unit = limits / scale[:, None]
    true, stated = (
        np.array([respondent.jacobian(int(k) - frames, frames) for k in ticks]).reshape(-1, p, q) * unit
        for frames in (own, horizon)
    )
    return Followed(record.time_s[ticks], estimates[ticks] * unit, true, stated)


def derivatives(case: Case) -> list[str]:
    """What the identifier of controller 0 estimates, `signal/device`. Raises `InputError` where there is none."""
    c = case.controllers[0] if case.controllers else None
    if c is None or c.scheme != "indirect":
        given = f"{c.name} {c.scheme or ''}".strip() if c else "no controller"
        raise InputError(f"jacobian: {given} given, which has no identifier; allowed: networks with scheme indirect")
    return [f"{signal}/{device}" for signal in c.signals for device in c.devices]


def names(case: Case) -> list[str]:
    """What a run's row has of it, `right_sign.speed/sssc`."""
    return [f"{figure}.{name}" for figure in FIGURES for name in derivatives(case)]


def figures(case: Case, found: Followed) -> dict[str, float]:
    """`compared`, flat."""
    told = compared(found)
    return dict(zip(names(case), np.ravel([told[figure] for figure in FIGURES]).tolist(), strict=True))


def compared(found: Followed) -> dict[str, NDArray[np.float64]]:
    """Of each derivative, (signals, devices): shares of looks with the right sign, the median error, and the answering.

    The error is relative to the true derivative's root mean square over the run. A sign is asked for where the device
    answers: where the true derivative is at least a hundredth of that (a device at its limit gives none).
    """
    size = np.sqrt(np.mean(found.true**2, axis=0))
    return {
        "right_sign": _right(found.estimate, found.true),
        "right_sign_stated": _right(found.estimate, found.stated),
        "error": np.median(np.abs(found.estimate - found.true), axis=0) / np.maximum(size, ROUND),
        "answering": np.mean(_answers(found.true), axis=0),
    }


def _answers(true: NDArray[np.float64]) -> NDArray[np.bool_]:
    return np.asarray(np.abs(true) > np.maximum(ANSWER * np.sqrt(np.mean(true**2, axis=0)), ROUND))


def _right(estimate: NDArray[np.float64], true: NDArray[np.float64]) -> NDArray[np.float64]:
    """Share of the looks at which a device answers where the estimate has the true sign."""
    answers = _answers(true)
    return np.asarray(((estimate * true > 0.0) & answers).sum(axis=0) / np.maximum(answers.sum(axis=0), 1))
