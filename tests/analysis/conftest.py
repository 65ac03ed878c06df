"""Records of which every figure is known."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.record import GridEvent, Record
from facts_damping.signals import CHANNELS, DELIVERY, DEVICE_TRUTH, MACHINE_TRUTH, NANOSECONDS, SETPOINT

if TYPE_CHECKING:
    from collections.abc import Callable

RATE = 60


def make_record(ticks: int = 1200, damping: float = 0.3, **changes: Any) -> Record:
    """Two machines that swing against each other at 0.5 Hz from 1 s on, and a tie; delay up 100 ms."""
    time_ns = np.arange(ticks) * NANOSECONDS // RATE
    t = time_ns / NANOSECONDS
    swing = np.where(t < 1, 0.0, 1e-3 * np.exp(-damping * (t - 1)) * np.sin(np.pi * (t - 1)))
    frames = np.full((ticks, 3, len(CHANNELS)), np.nan)
    frames[:, 0, 2], frames[:, 1, 2], frames[:, 2, 3] = swing, -swing, 4 + 100 * swing
    devices = np.zeros((ticks, 1), DEVICE_TRUTH)
    devices["setpoint"][:, 0] = 50 * swing
    devices["injected_voltage"][:, 0] = -40 * swing
    applied = np.zeros(ticks, SETPOINT)
    applied["measured_ns"], applied["effective_ns"] = time_ns, time_ns + 120_000_000
    arrived = np.repeat(np.arange(ticks - 6), 3)
    delivered = np.zeros(len(arrived), DELIVERY)
    delivered["pmu"] = np.tile([0, 1, 2], ticks - 6)
    delivered["measured_ns"] = time_ns[arrived]
    delivered["arrival_ns"] = delivered["measured_ns"] + 100_000_000
    machines = np.zeros((ticks, 2), MACHINE_TRUTH)
    machines["speed_deviation"], machines["terminal_voltage"] = frames[:, :2, 2], 1.0
    record: dict[str, Any] = {
        "configuration": {
            "asked": {"system": "pair", "controllers": []},
            "system": {
                "name": "pair",
                "measures": {"local": ["w12"], "interarea": []},
                "signals": {"w12": {"weights": {"G1": 1.0, "G2": -1.0}}},
                "devices": [{"name": "sssc", "setpoint_max": 0.1}],
            },
            "frame_rate": RATE,
            "duration": ticks / RATE,
        },
        "pmus": ["G1", "G2", "TIE"],
        "machine_names": ["G1", "G2"],
        "device_names": ["sssc"],
        "controller_names": ["controller_0_LLC"],
        "time_ns": time_ns,
        "frames": frames,
        "measured_ns": np.repeat(time_ns[:, None], 3, axis=1),
        "status": np.zeros((ticks, 3), np.int64),
        "delivered": delivered,
        "issued": applied,
        "applied": applied,
        "machines": machines,
        "devices": devices,
        "in_synchronism": np.ones(ticks, np.bool_),
        "events": [GridEvent(NANOSECONDS, "load_step", "L", 0.1)],
    }
    return Record(**{**record, **changes})


@pytest.fixture
def swing_record() -> Callable[..., Record]:
    return make_record
