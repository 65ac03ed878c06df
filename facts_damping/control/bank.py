"""The controllers of a run side by side, and what each does in a tick; compiled.

A controller acts once per arrival, with the arrival's exact time: it updates what it holds of each
station, forms its signals, and issues a setpoint for each device it commands. Between arrivals the
setpoint stands (zero-order hold).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.control import lead_lag
from facts_damping.control.table import CONTROLLERS
from facts_damping.signals import CHANNELS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.parameters.run import Controller
    from facts_damping.parameters.system import Signal

UNSET = -1
IMPLAUSIBLE = 1e6  # p.u. or rad: a quantity of this size or more counts as not available


class Bank(NamedTuple):
    """Frozen parameters of all controllers of a run; the first axis is the controller."""

    code: NDArray[np.int64]
    parameters: NDArray[np.float64]  # (controllers, most parameters)
    signals: NDArray[np.int64]  # (controllers,), how many
    channel: NDArray[np.int64]  # (controllers, most signals)
    weight: NDArray[np.float64]  # (controllers, most signals, stations)
    deviation: NDArray[np.bool_]  # (controllers, most signals)
    devices: NDArray[np.int64]  # (controllers, most devices), UNSET beyond its own
    limit: NDArray[np.float64]  # (controllers, most devices), p.u.


class BankState(NamedTuple):
    """State of all controllers; the first axis is the controller."""

    held: NDArray[np.float64]  # (controllers, stations, channels): newest entry of each station; NaN: none yet
    held_ns: NDArray[np.int64]  # (controllers, stations): its time of measurement
    newest_ns: NDArray[np.int64]  # (controllers,): newest time of measurement acted on; UNSET: none
    baseline: NDArray[np.float64]  # (controllers, most signals): first value of each signal
    inputs: NDArray[np.float64]  # (controllers, most signals): newest signals
    unlimited: NDArray[np.float64]  # (controllers, most devices), p.u.
    outputs: NDArray[np.float64]  # (controllers, most devices), p.u.
    internal: NDArray[np.float64]  # (controllers, most states)


def bank(
    controllers: Sequence[Controller],
    signals: Mapping[str, Signal],
    stations: Sequence[str],
    limits: Mapping[str, float],
) -> tuple[Bank, BankState]:
    """The controllers of a run as tables; `limits` are the installed devices' limits in their order, p.u."""
    n = len(controllers)
    kinds = [CONTROLLERS[c.name] for c in controllers]
    most_signals = max([len(c.signals) for c in controllers], default=0)
    most_devices = max([len(c.devices) for c in controllers], default=0)
    made = Bank(
        code=np.array([k.code for k in kinds], np.int64),
        parameters=np.zeros((n, max([len(k.parameters) for k in kinds], default=0))),
        signals=np.array([len(c.signals) for c in controllers], np.int64),
        channel=np.zeros((n, most_signals), np.int64),
        weight=np.zeros((n, most_signals, len(stations))),
        deviation=np.zeros((n, most_signals), np.bool_),
        devices=np.full((n, most_devices), UNSET, np.int64),
        limit=np.zeros((n, most_devices)),
    )
    order = list(limits)
    for c, controller in enumerate(controllers):
        made.parameters[c] = parameters(controller)
        for i, name in enumerate(controller.signals):
            signal = signals[name]
            made.channel[c, i] = list(CHANNELS).index(signal.channel)
            made.deviation[c, i] = signal.deviation
            for station, weight in signal.weights.items():
                made.weight[c, i, stations.index(station)] = weight
        for d, device in enumerate(controller.devices):
            made.devices[c, d] = order.index(device)
            made.limit[c, d] = limits[device]
    state = BankState(
        held=np.full((n, len(stations), len(CHANNELS)), np.nan),
        held_ns=np.full((n, len(stations)), UNSET, np.int64),
        newest_ns=np.full(n, UNSET, np.int64),
        baseline=np.full((n, most_signals), np.nan),
        inputs=np.full((n, most_signals), np.nan),
        unlimited=np.zeros((n, most_devices)),
        outputs=np.zeros((n, most_devices)),
        internal=np.zeros((n, max([k.states for k in kinds], default=0))),
    )
    return made, state


def parameters(controller: Controller) -> list[float]:
    """A controller's parameters in the order of its row: the table's defaults where the run says nothing."""
    row = CONTROLLERS[controller.name].parameters
    return [controller.parameters.get(name, p.default) for name, p in row.items()]


@compiled
def _signals(bank: Bank, state: BankState, c: int) -> bool:
    """Form the signals of controller c from what it holds; whether all are available."""
    complete = True
    for i in range(bank.signals[c]):
        total = 0.0
        for s in range(bank.weight.shape[2]):
            if bank.weight[c, i, s] != 0.0:
                total += bank.weight[c, i, s] * state.held[c, s, bank.channel[c, i]]
        if bank.deviation[c, i]:
            if math.isnan(state.baseline[c, i]) and math.isfinite(total):
                state.baseline[c, i] = total
            total -= state.baseline[c, i]
        state.inputs[c, i] = total
        complete = complete and math.isfinite(total)
    return complete


@compiled
def _act(bank: Bank, state: BankState, c: int) -> bool:
    """Let controller c act on what it holds; whether it did (a frame newer than all before, all signals there)."""
    newest = state.newest_ns[c]
    for s in range(state.held_ns.shape[1]):
        newest = max(newest, state.held_ns[c, s])
    if newest <= state.newest_ns[c] or not _signals(bank, state, c):
        return False
    dt = 0.0 if state.newest_ns[c] == UNSET else (newest - state.newest_ns[c]) * 1e-9
    state.newest_ns[c] = newest
    # The code selects the kind; the lead-lag is the only row so far.
    state.unlimited[c, 0] = lead_lag.step(bank.parameters[c], state.internal[c], state.inputs[c, 0], dt)
    for d in range(bank.devices.shape[1]):
        limit = bank.limit[c, d]
        state.outputs[c, d] = min(max(state.unlimited[c, d], -limit), limit)
    return True


@compiled
def act(
    bank: Bank,
    state: BankState,
    c: int,
    tick: int,
    delivered: NDArray[Any],
    count: int,
    out: NDArray[Any],
    first: int,
) -> int:
    """One tick of controller c: `count` delivered entries in, setpoints into `out` from index `first` on.

    Entries of the same arrival are taken together. Returns the index after the last setpoint written.
    """
    i = 0
    while i < count:
        arrival = delivered[i].arrival_ns
        while i < count and delivered[i].arrival_ns == arrival:
            entry = delivered[i]
            if entry.measured_ns > state.held_ns[c, entry.station]:
                state.held_ns[c, entry.station] = entry.measured_ns
                for j in range(state.held.shape[2]):
                    value = entry.values[j]
                    state.held[c, entry.station, j] = value if abs(value) < IMPLAUSIBLE else math.nan
            i += 1
        if not _act(bank, state, c):
            continue
        for d in range(bank.devices.shape[1]):
            if bank.devices[c, d] != UNSET:
                made = out[first]
                made.tick = tick
                made.controller = c
                made.device = bank.devices[c, d]
                made.measured_ns = state.newest_ns[c]
                made.issued_ns = arrival
                made.effective_ns = arrival
                made.value = state.outputs[c, d]
                first += 1
    return first
