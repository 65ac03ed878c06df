"""Ports: places of nonlinear elements in the network."""

from __future__ import annotations

import numpy as np

from facts_damping.devices.kind import Start as Start

# Kinds of ports.
SALIENT, LOAD, DEVICE, OTHER_END, INVERTER = 0, 1, 2, 3, 4  # OTHER_END: of a device at a second bus

# A port: its kind, the row of its table (machines, loads, devices, inverters), and the responses below and above which
# it is blocked.
PORT = np.dtype([("kind", "i8"), ("row", "i8"), ("minimum", "f8"), ("maximum", "f8")])
