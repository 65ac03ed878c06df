"""A supervisor by itself: given frames, setpoints and commands tick by tick, as its node or the loop does."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.control.inputs import Wiring
from facts_damping.monitor_table import COMMANDS, MONITORS, STATES, cause_name
from facts_damping.parameters.plant.pmus import Signal
from facts_damping.parameters.run import Controller
from facts_damping.parameters.supervision import Supervision
from facts_damping.signals import CHANNELS, DELIVERY, DEVICE_TRUTH, SETPOINT, SUPERVISION, Span
from facts_damping.simulation.measured_plant import tick_ns
from facts_damping.supervision.model import Watched, supervisors
from facts_damping.supervision.step import supervise, write_status

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

RATE = 60  # frames/s
TICK = 1.0 / RATE  # s
LIMITS = {"first": 0.3, "second": 0.1}  # p.u.
NOMINAL = 60.0  # Hz
SIGNALS = {"speed": Signal(channel="speed_deviation", weights={"A": 1.0})}
EIGENVALUE = complex(-0.1, 3.8)  # 1/s, of the watched mode
RESIDUE = -0.2 + 0j  # 1/s


class Told(NamedTuple):
    """What a supervisor says in a tick, and tells of itself; `told` none: it has failed."""

    said: NDArray[Any]  # SETPOINT
    state: str
    cause: str
    refused: str
    fraction: float
    values: dict[str, float]


class Guarded:
    """The supervisor of a controller of one signal, and of its fallback."""

    def __init__(
        self,
        fields: dict[str, Any],
        devices: Sequence[str] = ("first",),
        arm_at: float | None = None,
        *,
        mode: bool = True,
    ) -> None:
        """`fields`: its supervision; `mode`: whether it knows one."""
        self.devices = list(devices)
        rows = [Controller(signals=["speed"], devices=self.devices, fallback_of=place) for place in (None, 0)]
        known = EIGENVALUE if mode else 0j
        watched = Watched(0, 1, 0, arm_at, known, [RESIDUE] * len(self.devices))
        supervision = Supervision.model_validate(fields)
        limits = {name: (limit, 1.0) for name, limit in LIMITS.items()}
        wiring = Wiring(SIGNALS, ["A"], limits, RATE, NOMINAL)
        self.made, self.state = supervisors([watched], rows, supervision, wiring)
        self.row, self.tick = self.state.rows[0], 0
        self.row["finite"] = 1
        self.truth = np.zeros(len(LIMITS), DEVICE_TRUTH)
        self._entry, self._out, self._told = np.zeros(1, DELIVERY), np.zeros(64, SETPOINT), np.zeros(1, SUPERVISION)

    @property
    def limits(self) -> NDArray[np.float64]:
        """Of each device, p.u., as its authority has it."""
        return np.array(self.made.devices["limit"][0], np.float64)

    def setpoints(self, controller: int, at_ns: int, values: Sequence[float]) -> list[tuple[Any, ...]]:
        """A controller's setpoints of a time."""
        places = [list(LIMITS).index(name) for name in self.devices]
        return [(self.tick, controller, d, at_ns, at_ns, at_ns, v) for d, v in zip(places, values, strict=True)]

    def give(
        self,
        controller: Sequence[float] | None = None,
        reserve: Sequence[float] | None = None,
        *,
        speed: float | None = 0.0,
        late: float = 0.0,
        blocked: bool = False,
        command: str | None = None,
        status: int = 0,
    ) -> Told:
        """A tick: `controller`, `reserve`: their setpoints, none: silent; `speed`: of the frame, none: there is none.

        `late`: s, its delay.
        """
        start, end = (tick_ns(k, RATE) for k in (self.tick, self.tick + 1))
        middle = (start + end) // 2
        if command is not None:
            self.row["asked"] = COMMANDS[command]
        issued = np.array(
            [
                *([] if controller is None else self.setpoints(0, middle, controller)),
                *([] if reserve is None else self.setpoints(1, middle + 1, reserve)),
            ],
            SETPOINT,
        )
        if speed is not None:
            self._entry["tick"], self._entry["status"] = self.tick, status
            self._entry["measured_ns"], self._entry["arrival_ns"] = middle - round(late * 1e9), middle
            self._entry["values"] = 0.0
            self._entry["values"][0, list(CHANNELS).index("speed_deviation")] = speed
            self._entry["values"][0, list(CHANNELS).index("frequency")] = NOMINAL
        self.truth["blocked"] = float(blocked)
        this, span = (self.made, self.state, 0), Span(self.tick, start, end)
        count = supervise(*this, span, self._entry[: int(speed is not None)], issued, self.truth, self._out)
        assert write_status(*this, self.tick, self._told, 0)
        self.tick += 1
        row = self._told[0]
        values = dict(zip(MONITORS, row["values"].tolist(), strict=True))
        cause, refused = (cause_name(int(row[name])) for name in ("cause", "refused"))
        return Told(self._out[:count].copy(), STATES[row["state"]], cause, refused, float(row["fraction"]), values)

    def arm(self, ticks: int = 3) -> None:
        """Some quiet ticks, and armed with the last of them."""
        for k in range(ticks):
            tick = self.give([0.0] * len(self.devices), command="arm" if k == ticks - 1 else None)
        assert tick.state == "armed", tick.refused


def watching(**follows: str) -> dict[str, Any]:
    """Monitors: those named with what follows, all others off."""
    return {name: {"follows": follows[name]} if name in follows else "off" for name in MONITORS}
