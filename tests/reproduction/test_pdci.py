"""The tuned controllers of the Pacific DC Intertie are judged where none was tuned."""

from __future__ import annotations

from facts_damping_reproduction.pdci import study, tuned

PLACES = ("bus", "line", "machine", "load")


def places(case: dict[str, object]) -> set[str]:
    """Where the events of a case are."""
    events = study.made({"scenario": case["scenario"]}).scenario.events
    return {str(getattr(event, name)) for event in events for name in PLACES if getattr(event, name, None)}


def test_held_out_cases_share_no_place_and_no_draw_with_training() -> None:
    known, held = ([case["set"] for case in tuned.cases(which)] for which in ("training", "held_out"))
    assert not set[str]().union(*map(places, known)) & set[str]().union(*map(places, held))
    assert len(held) >= 24
    for drawn in ("seed", "link.up.1.delay", "system.loads.0.P"):
        assert not {case_sets[drawn] for case_sets in known} & {case_sets[drawn] for case_sets in held}
    assert len({case_sets["seed"] for case_sets in held}) == len(held)
