"""What passes between a run and the process of a controller: frames, each a length and so many bytes.

To the process: first `Begin`, then a frame for each step (`step_content`), and the plant where it asks. The run is
trusted, so what it sends may be pickled. From the process: a byte that says what it is, and text or numbers; nothing
that it sends is run.
"""

from __future__ import annotations

import os
import secrets
import struct
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.parameters.run import Controller
    from facts_damping_studies.score.isolation.readable import Readable

    Floats = NDArray[np.float64]

LENGTH = struct.Struct("<I")
TIME = struct.Struct("<d")
TOKEN = 8  # random bytes at the end of a step's frame, with which its answer begins: none can be given before
MOST_BYTES = 1 << 16  # of what a process may send at once
MOST_TEXT = 2000  # characters of an error
# First byte of what the process sends.
CONFINED, READY, SETPOINTS, ERROR, BREACH, PLANT = b"C", b"R", b"U", b"E", b"B", b"P"


class Begin(NamedTuple):
    """All that the process of a controller gets at its start.

    `facts`: fields of the specification that the controller may know, by name (`child.KnownSpec`).
    """

    folder: str  # the current one
    path: list[str]  # where modules are looked for
    controller: Controller | None  # None: only be confined
    where: str  # for errors
    facts: dict[str, Any]
    readable: Readable
    memory: int  # bytes of address space


def frame(content: bytes) -> bytes:
    """A frame with content."""
    return LENGTH.pack(len(content)) + content


def step_content(t_s: float, y: Floats, age_s: Floats, fresh: NDArray[np.bool_]) -> bytes:
    """Content of a step's frame: time of arrival, s; signals, (signals,), p.u.; their ages, s; which are new; token."""
    return TIME.pack(t_s) + y.tobytes() + age_s.tobytes() + fresh.tobytes() + secrets.token_bytes(TOKEN)


def step_of(content: bytes, signals: int) -> tuple[float, Floats, Floats, NDArray[np.bool_]]:
    """What a step's frame holds, as arrays that may be changed."""
    begin, size = TIME.size, 8 * signals
    y = np.frombuffer(content, np.float64, signals, begin).copy()
    age = np.frombuffer(content, np.float64, signals, begin + size).copy()
    fresh = np.frombuffer(content, np.bool_, signals, begin + 2 * size).copy()
    return TIME.unpack_from(content)[0], y, age, fresh


def read_frame(descriptor: int) -> bytes | None:
    """Content of the next frame from a file descriptor; None at its end."""
    head = _read(descriptor, LENGTH.size)
    return None if head is None else _read(descriptor, LENGTH.unpack(head)[0])


def _read(descriptor: int, size: int) -> bytes | None:
    content = b""
    while len(content) < size:
        part = os.read(descriptor, size - len(content))
        if not part:
            return None
        content += part
    return content
