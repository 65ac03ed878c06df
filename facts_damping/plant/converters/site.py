"""Ports, and where a device stands: what its kind is told, and how it begins."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

# Kinds of ports: places where something beside the linear network acts.
SALIENT, LOAD, DEVICE, OTHER_END = 0, 1, 2, 3  # the last: of a device at a second bus

# A port: its kind, the row of its table (machines, loads, devices), and the responses below and above which it is
# blocked.
PORT = np.dtype([("kind", "i8"), ("row", "i8"), ("least", "f8"), ("most", "f8")])


class Site(NamedTuple):
    """Where a device stands as the power flow leaves it."""

    offset: int  # of its states in the plant's
    omega_0: float  # rad/s
    size: float  # p.u., of what its port sees: in series its current, in parallel its bus voltage
    other: float = math.nan  # p.u., of its second bus
    base_power: float = math.nan  # MVA


class Start(NamedTuple):
    """A device at rest: the row of its kind's table, its states, and between which responses it is not blocked."""

    row: tuple[Any, ...]
    states: list[float]
    least: float  # p.u.; 0: never for too small a response
    most: float = math.inf  # p.u.
