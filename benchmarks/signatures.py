"""What signing adds to writing and reading a frame of five PMUs, in turns, in one process."""

from __future__ import annotations

import statistics
import time
from typing import TYPE_CHECKING

import numpy as np

from facts_damping.case.loading import load_case
from facts_damping.nodes.transport.signing import Seal, Signing
from facts_damping.nodes.transport.tables import FramesMessage
from facts_damping.signals import DELIVERY

if TYPE_CHECKING:
    from collections.abc import Callable

TURNS, MESSAGES = 7, 2000


def per_message_us(do: Callable[[], object]) -> float:
    """Time of one of many, us."""
    began = time.perf_counter()
    for _ in range(MESSAGES):
        do()
    return (time.perf_counter() - began) / MESSAGES * 1e6


def main() -> None:
    """Print writing and reading without and with a signature, and the difference."""
    case = load_case(None)
    by = Signing({1: bytes(32)}, time.time_ns(), 10**9)
    rows = np.zeros(5, DELIVERY)
    rows["pmu"] = np.arange(5)
    kinds = {
        "not signed": (FramesMessage(case), FramesMessage(case)),
        "signed": (FramesMessage(case, Seal(by, "pmu/frames")), FramesMessage(case, Seal(by, "pmu/frames"))),
    }
    took: dict[str, list[tuple[float, float]]] = {name: [] for name in kinds}
    for _ in range(TURNS):
        for name, (writer, reader) in kinds.items():
            data = writer.fill(0, 0, rows, 5)
            reader.read(data)
            write = per_message_us(lambda writer=writer: writer.fill(0, 0, rows, 5))  # type: ignore[misc]
            read = per_message_us(lambda reader=reader, data=data: reader.read(data))  # type: ignore[misc]
            took[name].append((write, read))
    for name, pairs in took.items():
        write, read = (statistics.median(column) for column in zip(*pairs, strict=True))
        print(f"{name}: written in {write:.1f} us, read in {read:.1f} us")


if __name__ == "__main__":
    main()
