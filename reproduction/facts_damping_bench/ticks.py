"""Ticks a second of our lockstep graph beside steps a second of two HELICS federates, in turns."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, NamedTuple

from facts_damping.case.loading import load_case
from facts_damping.errors import FactsDampingError, RunError, one_line
from facts_damping.recording.scan import scan
from facts_damping_bench.programs import HELICS, missing

if TYPE_CHECKING:
    from collections.abc import Callable

TURNS = 3
SECONDS = 60.0  # of our graph, simulated: 3600 ticks
STEPS = 3000  # of HELICS
LONGEST_S = 60.0
OURS, THEIRS = "facts_damping", "HELICS"
NOTES = {
    OURS: "plant, link, controller and recorder in a process each; a tick is four messages one after the other, with "
    "all that plant, link and controller compute, and recorded",
    THEIRS: "two federates in a process each, nothing computed; a step is two doubles there and two back at once",
}


class Rate(NamedTuple):
    """Ticks or steps a second, median; `failed` says why there is none."""

    title: str
    per_s: float
    note: str
    failed: str


def ours(run: str | None = None, seconds: float = SECONDS) -> float:
    """Ticks a second of a run, by default the lightest, between first and last frame: start and end not counted."""
    from facts_damping.nodes.launching import graph  # noqa: PLC0415 (it needs ROS, the other programs do not)

    with TemporaryDirectory() as folder:
        outcome = graph.run(load_case(run, [f"duration={seconds}"]), "lockstep", Path(folder), lambda *_: None)
        if outcome.messages_lost:
            raise RunError(f"{outcome.messages_lost} messages were lost")
        times = [m.publish_ns for m in scan(outcome.recording).messages if m.topic == "/pmu/frames"]
    return (len(times) - 1) / (max(times) - min(times)) * 1e9


def theirs() -> float:
    """Steps a second, each with two doubles there and two back."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [
        sys.executable,
        "-m",
        "facts_damping_bench.with_helics",
        "plant",
        str(port),
        str(STEPS),
        str(os.getpid()),
    ]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=LONGEST_S)
    except subprocess.TimeoutExpired as error:
        raise RunError(f"nothing after {LONGEST_S:g} s") from error
    if done.returncode:
        said = [line for line in done.stderr.splitlines() if line.strip()]
        raise RunError(f"its process ended with {done.returncode}: {said[-1] if said else 'it said nothing'}")
    return float(json.loads(done.stdout)["per_s"])


def _without_ros() -> str:
    """What of ROS 2 is not there; empty: nothing."""
    lacking = [name for name in ("rclpy", "facts_damping_msgs") if find_spec(name) is None]
    return f"not installed: {', '.join(lacking)} (make demo installs them)" if lacking else ""


def measure(progress: Callable[[int, int], None]) -> list[Rate]:
    """Both, in turns; ours first."""
    rows: dict[str, tuple[Callable[[], float], list[float]]] = {OURS: (ours, []), THEIRS: (theirs, [])}
    lacking = {OURS: _without_ros(), THEIRS: missing(HELICS)}
    failed = {title: why for title, why in lacking.items() if why}
    for turn in range(TURNS):
        progress(2 * turn, 2 * TURNS)
        for title, (exchanged, turn_rates) in rows.items():
            if title not in failed:
                try:
                    turn_rates.append(exchanged())
                except FactsDampingError as error:
                    failed[title] = one_line(error)
    progress(2 * TURNS, 2 * TURNS)
    return [
        Rate(title, float("nan") if title in failed else median(rates), NOTES[title], failed.get(title, ""))
        for title, (_, rates) in rows.items()
    ]
