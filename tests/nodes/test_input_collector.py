"""When a tick is complete, of which several nodes send messages."""

from __future__ import annotations

from typing import Any

import pytest

from facts_damping.nodes.base.parameters import Options
from facts_damping.nodes.input_collector import AWAITED, InputCollector


def gathering(mode: str) -> tuple[InputCollector, list[tuple[int, dict[str, Any]]]]:
    """A collector of two senders, and the calls of its step."""
    done: list[tuple[int, dict[str, Any]]] = []
    options = Options(mode, 5.0, 30.0, recorder=False, view=False)
    return InputCollector(options, {"a": "node_a", "b": "node_b"}, lambda tick, parts: done.append((tick, parts))), done


@pytest.mark.parametrize("mode", ["lockstep", "realtime"])
def test_tick_is_over_when_all_have_spoken(mode: str) -> None:
    collector, done = gathering(mode)
    collector.store("a")(0, "a0")
    collector.frames(0, "f0")
    assert done == []
    collector.store("b")(0, "b0")
    assert done == [(0, {"frames": "f0", "a": ["a0"], "b": ["b0"]})]


def test_in_lockstep_who_is_silent_is_waited_for() -> None:
    collector, done = gathering("lockstep")
    for tick in range(3 * AWAITED):
        collector.frames(tick, "")
        collector.store("a")(tick, "")
    assert done == []


def test_by_the_clock_who_is_silent_is_waited_for_a_few_ticks_and_again_once_it_speaks() -> None:
    collector, done = gathering("realtime")
    for tick in range(10):
        collector.frames(tick, "")
        collector.store("a")(tick, "")
        if tick == 0:
            collector.store("b")(0, "")
        late = 0 < tick <= AWAITED  # over when the next frames come
        assert [at for at, _ in done] == list(range(tick + 1 - late))
    collector.store("b")(9, "b9")
    collector.frames(10, "")
    collector.store("a")(10, "")
    assert done[-1][0] == 9
    collector.store("b")(10, "b10")
    assert done[-1] == (10, {"frames": "", "a": [""], "b": ["b9", "b10"]})
