"""Lines on standard output between nodes and the program that runs their graph: each is written and read here.

A node writes them if its parameter `progress` is true. The first line of a live view or cockpit is its address.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator

    from facts_damping.simulation.programs.policies import StepTimes

_TICK = re.compile(r"^tick (\d+) (\d+) (\d+)$", re.MULTILINE)
_REFUSED = re.compile(r"^refused (\d+) (\S+) (\S+) (\S+)$", re.MULTILINE)
_STEPS = re.compile(r"^steps (\d+) (\S+) (\S+) (\S+)$", re.MULTILINE)
_LOST = re.compile(r"^lost (\d+)$", re.MULTILINE)
_ORDER = re.compile(r"^(kill|restart) (\S+)$", re.MULTILINE)  # of a cockpit: what its page asks for


class Ticks(NamedTuple):
    """Progress of a source of frames."""

    newest: int  # tick
    of: int  # number of ticks
    late: int  # deadline misses


def ticks_line(progress: Ticks) -> str:
    """Progress of a source of frames."""
    return f"tick {progress.newest} {progress.of} {progress.late}"


def ticks(output: str) -> list[Ticks]:
    """Progress in the output of a source of frames."""
    return [Ticks(*map(int, numbers)) for numbers in _TICK.findall(output)]


def refused_line(count: int, cause: str, topic: str, source: str) -> str:
    """How many messages a node has refused so far, of a cause, topic and source."""
    return f"refused {count} {cause} {topic} {source}"


def refusals(output: str) -> Iterator[tuple[tuple[str, str, str], int]]:
    """Cause, topic and source of refused messages, and their count, as often as a node tells it."""
    return (((cause, topic, source), int(count)) for count, cause, topic, source in _REFUSED.findall(output))


def steps_line(times: StepTimes) -> str:
    """Step times of a user's program."""
    return f"steps {' '.join(map(repr, times))}"


def steps(output: str) -> tuple[int, float, float, float] | None:
    """Fields of StepTimes in the output of a controller; None: it runs no user's program, or has not ended."""
    match = _STEPS.search(output)
    return (int(match[1]), float(match[2]), float(match[3]), float(match[4])) if match else None


def lost_line(count: int) -> str:
    """How many messages the recorder has lost."""
    return f"lost {count}"


def lost(output: str) -> int:
    """Lost messages in the output of a recorder."""
    match = _LOST.search(output)
    return int(match[1]) if match else 0


def orders(output: str) -> list[tuple[str, str]]:
    """What the page of a cockpit asks for: `kill` or `restart`, and a node."""
    return _ORDER.findall(output)
