"""Many runs at once, each in a process of its own; results in order, progress as they come."""

from __future__ import annotations

import multiprocessing
import signal
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


def _quiet() -> None:
    """An interrupt is the parent's to answer: it ends its workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


def run_all(
    function: Callable[[Any], Any], todo: Sequence[Any], jobs: int, progress: Callable[[int, int], None]
) -> list[Any]:
    """`function` of everything, `jobs` at a time."""
    found: list[Any] = []
    progress(0, len(todo))
    with multiprocessing.get_context("spawn").Pool(min(jobs, max(1, len(todo))), _quiet) as pool:
        for one in pool.imap(function, todo):
            found.append(one)
            progress(len(found), len(todo))
    return found
