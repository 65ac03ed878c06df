"""Many runs at once: what happens to the processes."""

from __future__ import annotations

import time

from facts_damping_studies.sweeps.pool import run_all

_kept: list[bytes] = []


def growing(number: int) -> int:
    """Take memory and never give it back."""
    _kept.append(b"1" * 200_000_000)
    time.sleep(0.6)
    return number


def test_worker_whose_memory_grows_is_replaced_and_nothing_is_lost() -> None:
    """The library warns of it in a thread: as an error, as here, the warning must not end the thread."""
    assert run_all(growing, range(8), 2, lambda _done, _all: None) == list(range(8))
