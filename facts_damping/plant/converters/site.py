"""Ports, and the data of a device's location for its initial state."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

# Kinds of ports: places of nonlinear elements in the network.
SALIENT, LOAD, DEVICE, OTHER_END = 0, 1, 2, 3  # the last: of a device at a second bus

# A port: its kind, the row of its table (machines, loads, devices), and the responses below and above which it is
# blocked.
PORT = np.dtype([("kind", "i8"), ("row", "i8"), ("minimum", "f8"), ("maximum", "f8")])


class Site(NamedTuple):
    """Location of a device in the solved power flow."""

    offset: int  # index of its states in the plant's
    omega_0: float  # rad/s
    size: float  # p.u., response of its port: current in series, bus voltage in parallel
    other: float = math.nan  # p.u., voltage of its second bus
    base_power: float = math.nan  # MVA
    machine: int = -1  # index of the machine of a device without a port


class Start(NamedTuple):
    """A device at rest: the row of its kind's table, its states, and the range of responses without blocking."""

    row: tuple[Any, ...]
    states: list[float]
    minimum: float  # p.u.; 0: never for too small a response
    maximum: float = math.inf  # p.u.
