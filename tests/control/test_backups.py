"""Backups of a signal's PMUs: which data count, by an independent statement of the rule over random frames."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facts_damping.control.inputs import candidates, compute_signals, ingest, inputs, sources
from facts_damping.parameters.plant.pmus import Signal
from facts_damping.signals import CHANNELS, DELIVERY

if TYPE_CHECKING:
    from numpy.typing import NDArray

PMUS, HZ, MS = ["A", "A2", "B", "B2", "B3"], list(CHANNELS).index("frequency"), 1_000_000
FRAME = 20  # ms
SIGNAL = Signal(channel="frequency", weights={"A": 60.0, "B": -60.0}, backups={"A": ["A2"], "B": ["B2", "B3"]})
FAULTS = ("none", "lost", "frozen", "not a number", "not synchronised")


class Receiver:
    """A receiver of the signal, frame by frame."""

    def __init__(self) -> None:
        self.given, self.held = inputs([["hertz"]], {"hertz": SIGNAL}, PMUS, 60.0)
        self.pairs = candidates(self.given, 0)

    def take(self, rows: NDArray[Any]) -> tuple[str, str]:
        """Give the entries of one arrival; returns the PMUs whose data count."""
        assert ingest(self.given, self.held, 0, rows, 0, len(rows)) == len(rows)
        compute_signals(self.given, self.held, 0)
        choice = sources(self.pairs, self.held, 0)
        a, b = (PMUS[self.pairs.candidates[i, k]] for i, k in enumerate(choice))
        return a, b


def frame(k: int, faults: dict[str, str], frozen: dict[str, float]) -> NDArray[Any]:
    """Entries of frame k, in which PMUs have faults; each has a value of its own."""
    rows = []
    for s, name in enumerate(PMUS):
        fault, value = faults.get(name, "none"), 60.0 + 0.1 * (s + 1) + 0.01 * np.sin(k)
        value = frozen.setdefault(name, value) if fault == "frozen" else value
        if fault != "frozen":
            frozen.pop(name, None)
        row = np.zeros(1, DELIVERY)
        row["pmu"], row["measured_ns"], row["arrival_ns"] = s, k * FRAME * MS, (k * FRAME + 5) * MS
        row["values"][0, HZ] = np.nan if fault == "not a number" else value
        row["status"] = 8192 if fault == "not synchronised" else 0
        if fault != "lost":
            rows.append(row)
    return np.concatenate(rows).view(np.recarray) if rows else np.zeros(0, DELIVERY).view(np.recarray)


@settings(deadline=None, max_examples=30)
@given(
    st.lists(
        st.tuples(st.integers(1, 12), st.dictionaries(st.sampled_from(PMUS), st.sampled_from(FAULTS), max_size=4)),
        max_size=8,
    )
)
def test_first_good_one_takes_over_and_stays_until_its_own_data_are_bad(spells: list[Any]) -> None:
    """The rule once more, in Python: per PMU since when a fault lasts, in frames."""
    receiver, frozen, chosen, k = Receiver(), {}, {"A": "A", "B": "B"}, 0  # type: ignore[var-annotated]
    last = dict.fromkeys(PMUS, 0)
    same, before = dict.fromkeys(PMUS, 0), dict.fromkeys(PMUS, float("nan"))
    state = dict.fromkeys(PMUS, "none")
    for frames, faults in [(3, {}), *spells]:
        for _ in range(frames):
            rows = frame(k, faults, frozen)
            for row in rows:
                name, value = PMUS[row["pmu"]], float(row["values"][HZ])
                state[name], last[name] = faults.get(name, "none"), k
                if value != before[name]:
                    same[name] = k
                before[name] = value
            newest = max(last.values())
            good = {
                name
                for name in PMUS
                if (newest - last[name]) * FRAME <= 100
                and (last[name] - same[name]) * FRAME <= 100
                and state[name] not in ("not a number", "not synchronised")
            }
            for pmu, others in {"A": ["A", "A2"], "B": ["B", "B2", "B3"]}.items():
                if chosen[pmu] not in good:
                    chosen[pmu] = next((candidate for candidate in others if candidate in good), chosen[pmu])
            if len(rows):
                assert receiver.take(rows) == (chosen["A"], chosen["B"]), (k, faults)
            k += 1
    sizes = [receiver.held.entry[0, PMUS.index(pmu), HZ] for pmu in chosen.values()]
    assert receiver.held.signal[0, 0] == pytest.approx(sizes[0] - sizes[1], abs=1e-12, nan_ok=True)


def test_pmus_whose_filters_fill_are_waited_for() -> None:
    """A second at most: then a PMU that has never been available is replaced."""
    receiver = Receiver()
    for k in range(100):
        bad = {"A": "not a number"} | ({} if k else {"B": "not a number"})
        assert receiver.take(frame(k, bad, {})) == ("A" if k * FRAME <= 1000 else "A2", "B"), k


def test_backups_of_another_pmu_are_refused() -> None:
    with pytest.raises(ValueError, match=r"backups: C given; allowed: A, B, its PMUs"):
        Signal(channel="frequency", weights={"A": 1.0, "B": -1.0}, backups={"C": ["A"]})
