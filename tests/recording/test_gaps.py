"""What a recorder that found a link late has missed, and what nobody has said."""

from __future__ import annotations

import numpy as np
import pytest

from facts_damping.record import Absence
from facts_damping.recording.decode import Series
from facts_damping.recording.gaps import find_absences, first_missing, gap_notes

LEFT, FOUND = 10, 14  # the first tick without them; the first at which the recorder heard the link again


def series(topic: str, first: int) -> Series:
    ticks = np.concatenate([np.arange(LEFT), np.arange(first, 20)])
    return Series(topic, ticks, [])


@pytest.mark.parametrize(("began", "answered"), [(12, 12), (13, FOUND), (FOUND, FOUND)])
def test_deliveries_answered_before_the_link_was_heard_are_missing(began: int, answered: int) -> None:
    """The link began again at tick 12, the controller at another; the recorder found that when it `answered`."""
    late = {("link", 0, 12), ("controller", 0, began)}
    topics = {
        "delivered": [series("/pmu/delivered", FOUND)],
        "applied": [series("/setpoints/delivered", FOUND)],
        "issued": [series("/controller_0_LLC/setpoints", answered)],
    }
    away = find_absences(topics, late, 0, 20)
    heard_late = began < FOUND
    assert Absence("link", 0, LEFT, 12 if heard_late else FOUND, "delivered") in away
    assert Absence("controller", 0, LEFT, answered, "issued") in away
    assert first_missing(topics, away, np.arange(20)) == (12 if heard_late else None)
    notes = [f"{topic}: 2 of 20 ticks are missing (12, 13)" for topic in ("/pmu/delivered", "/setpoints/delivered")]
    assert gap_notes(topics, away, 19) == (notes if heard_late else [])


def test_absent_link_explains_gaps_of_the_nodes_that_use_it_alone() -> None:
    """Controller 1 has a link of its own, controllers 0 and 2 share the first."""
    topics = {
        "delivered": [Series("/pmu/delivered", np.arange(20), []), series("/controller_1_LLC/pmu/delivered", FOUND)],
        "issued": [series(f"/controller_{c}_LLC/setpoints", FOUND) for c in range(3)],
    }
    away = find_absences(topics, {("link", 1, FOUND)}, 0, 20)
    assert away == [
        Absence("link", 1, LEFT, FOUND, "delivered"),
        Absence("controller", 1, LEFT, FOUND, "issued"),
    ]
    assert first_missing(topics, away, np.arange(20)) == LEFT
