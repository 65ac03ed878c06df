"""Tables of a campaign: invariants, actions of the supervisor, effects on the grid, cost of supervision."""

from __future__ import annotations

import math
from statistics import median
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.monitor_table import MONITORS
from facts_damping.output.tables import table
from facts_damping_studies.campaigns import campaign as study
from facts_damping_studies.campaigns.faults import FAULTS, NOTHING
from facts_damping_studies.campaigns.invariants import HARM, INVARIANTS
from facts_damping_studies.margins.margins import failed_fraction

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    Rows = Sequence[dict[str, Any]]

CYCLING, FREQUENT = "limit cycle at the control rate", MONITORS["reversals"].limit
WORDS = {
    "within_limits": "outputs within limits, rates and authority",
    "lets_go": "the device at zero within time-out and ramp after the last accepted setpoint",
    "zero_after_trip": "the supervisor sends zero from a trip to the end of the run",
    "device_at_zero": "the device at zero after a trip",
    "cause_recorded": "every trip has its cause recorded",
    "keeps_synchronism": "synchronism kept if it is kept without control",
    "does_no_harm": f"ITAE at most {HARM:g} times that without control",
    "recorded": "the recording complete and readable",
    "as_computed": "the recording equal to the in-process run, bit for bit",
    "nothing_forged_acts": "no forged message has an effect",
}


TURNED = ("wrong_sign", "sign_swapped")  # faults by which control adds to an oscillation


LONG_S = 5.0  # s: a fault that lasts as long should be found


WHICH = ("", "unsupervised_", "uncontrolled_")  # prefixes of a row's figures


LISTED = 4  # number of places listed for a violated invariant


class Fraction(NamedTuple):
    """A count, and what fraction it is, in per cent with Wilson's interval; None without cases."""

    number: int
    percent: float | None
    low: float | None
    high: float | None

    @classmethod
    def of(cls, part: int, whole: int) -> Fraction:
        """So many of the whole."""
        if not whole:
            return cls(part, None, None, None)
        ends = failed_fraction(part, whole)
        return cls(part, *(round(100.0 * value, 2) for value in (part / whole, ends["low"], ends["high"])))

    def __str__(self) -> str:
        """As in a page: `4: 0.28 % (0.11 to 0.71)`."""
        if self.percent is None:
            return f"{self.number}"
        return f"{self.number}: {self.percent:.2f} % ({self.low:.2f} to {self.high:.2f})"


class Pair(NamedTuple):
    """A figure with supervision and without."""

    supervised: str
    unsupervised: str

    def __str__(self) -> str:
        """As in a page."""
        return " / ".join(self)


class Table(NamedTuple):
    """A table of a page: cells are texts, fractions or pairs."""

    titles: list[str]
    rows: list[list[Any]]
    left: int = 1  # number of columns that are names

    def markdown(self) -> list[str]:
        """Its lines; none if it has no row."""
        return table(*self, markdown=True) if self.rows else []


def invariant_table(rows: Rows, names: Sequence[str] = INVARIANTS) -> Table:
    """Invariants: of the draws that can violate each, how many do; faults, systems and scenarios of these."""
    lines = []
    for name in names:
        asked = [row for row in rows if row.get(name) is not None]
        failed = [row for row in asked if not row[name]]
        places = _largest(failed, lambda row: f"{row['fault']}, {row['base_run']} {row.get('scenario', '')}".strip())
        lines.append([WORDS[name], str(len(asked)), Fraction.of(len(failed), len(asked)), places])
    heads = ["what must hold", "cases that can violate it", "violated", "most frequent"]
    return Table(heads, lines)


def outcome_table(rows: Rows) -> Table:
    """With supervision, without it, and without control: synchronism of all draws, harm to those that can be harmed."""
    able = [row for row in rows if row["does_no_harm"] is not None]
    known = [which for which in WHICH if any(f"{which}lost_s" in row for row in rows)]
    found: list[list[Any]] = [["synchronism lost", str(len(rows)), *(_lost(rows, which) for which in known)]]
    found.append(["the same, if it is kept without control", str(len(able)), *(_lost(able, which) for which in known)])
    harms = [sum(row[f"{which}does_no_harm"] is False for row in able) for which in known if which != WHICH[-1]]
    words = f"ITAE above {HARM:g} times that without control, or synchronism lost; of those that keep it without"
    found.append([words, str(len(able)), *(Fraction.of(count, len(able)) for count in harms), "-"])
    titles = {"": "with supervision", "unsupervised_": "without supervision", "uncontrolled_": "without control"}
    return Table(["what", "cases", *(titles[which] for which in known)], found)


def _lost(rows: Rows, which: str) -> Fraction:
    return Fraction.of(sum(row[f"{which}lost_s"] is not None for row in rows), len(rows))


def healthy_table(rows: Rows) -> Table:
    """Of all draws in which nothing fails, by system and monitor: how many were taken off, and how many with harm."""
    healthy, lines = [row for row in rows if row["fault"] == NOTHING], []
    for system in [*sorted({row["base_run"] for row in healthy}), ""]:
        own = [row for row in healthy if system in ("", row["base_run"])]
        off = [row for row in own if _taken_off(row)]
        monitors = sorted({_cause(row) for row in off})
        for monitor in ["", *monitors] if system else [""]:
            by = [row for row in off if monitor in ("", _cause(row))]
            counts = [sum(which(row) for row in by) for which in (_harmed, _helped)]
            never = str(sum(row["armed_s"] is None for row in own)) if not monitor else ""
            lines.append([system or "all", monitor or "all", str(len(own)), never, Fraction.of(len(by), len(own))])
            lines[-1] += [Fraction.of(count, len(own)) for count in counts]
    heads = ["system", "monitor", "healthy cases", "never armed", "fell back or tripped", "harmful", "helpful"]
    return Table(heads, lines, 2)


def missed_table(rows: Rows) -> Table:
    """Faults by which control adds to an oscillation and which last: how many were never found, and with what harm."""
    long = [row for row in rows if row["fault"] in TURNED and (not row["lasts"] or float(row["lasts"]) >= LONG_S)]
    acting = [row for row in long if row["armed_s"] is not None and not row["early"]]
    lines = []
    for fault, system in sorted({(row["fault"], row["base_run"]) for row in acting}):
        own = [row for row in acting if (row["fault"], row["base_run"]) == (fault, system)]
        missed = [row for row in own if row["detected_s"] is None]
        harmed = sum(row["does_no_harm"] is False for row in missed)
        lines.append([fault, system, str(len(own)), Fraction.of(len(missed), len(own)), str(harmed)])
    heads = [
        "fault",
        "system",
        f"armed cases, {LONG_S:g} s or longer",
        "missed",
        f"of these above {HARM:g}",
    ]
    return Table(heads, lines, 2)


def limit_table(rows: Rows) -> Table:
    """By the limit that was drawn: harm to healthy draws, and wrong signs found with the monitor `harm` and without."""
    lines = []
    for name in sorted({row["limit"] for row in rows}, key=float):
        own = [row for row in rows if row["limit"] == name]
        healthy = [row for row in own if row["fault"] == NOTHING]
        lines.append([name, str(len(healthy))])
        lines[-1] += [Fraction.of(sum(which(row) for row in healthy), len(healthy)) for which in (_taken_off, _harmed)]
        wrong = [row for row in own if row["fault"] in TURNED and row["armed_s"] is not None and not row["early"]]
        for harm in ("on", "off"):
            asked = [row for row in wrong if row["harm"] == harm]
            found = [row["detected_s"] for row in asked if row["detected_s"] is not None]
            lines[-1] += [str(len(asked)), Fraction.of(len(found), len(asked)), _times(found)[0]]
    heads = ["limit, 1/s", "healthy cases", "tripped", "harmful", "wrong signs", "found", "median, s"]
    heads += ["wrong signs without harm", "found without harm", "median without harm, s"]
    return Table(heads, lines)


def _taken_off(row: dict[str, Any]) -> bool:
    """Whether a controller fell back or was tripped."""
    return row["fallback_s"] is not None or row["tripped_s"] is not None


def _cause(row: dict[str, Any]) -> str:
    return str(row["fallback_cause"] or row["cause"])


def _harmed(row: dict[str, Any]) -> bool:
    """Whether it was taken off with harm: beside the same controller without supervision."""
    own, free = row["ITAE"], row.get("unsupervised_ITAE")
    return _taken_off(row) and free is not None and (own is None or own > HARM * free)


def _helped(row: dict[str, Any]) -> bool:
    """Whether it was taken off to the grid's benefit, by the same measure."""
    own, free = row["ITAE"], row.get("unsupervised_ITAE")
    return _taken_off(row) and own is not None and (free is None or HARM * own < free)


def fault_table(rows: Rows) -> Table:
    """By fault: armed draws, how many fell back and tripped, how soon, and the most frequent cause."""
    lines = []
    for fault in [name for name in FAULTS if name != NOTHING]:
        own = [row for row in rows if row["fault"] == fault and row["armed_s"] is not None and not row["early"]]
        if own:
            counts = [sum(row[name] is not None for row in own) for name in ("fallback_s", "tripped_s")]
            detected = [row for row in own if row["detected_s"] is not None]
            causes = _largest(detected, lambda row: str(row["fallback_cause"] or row["cause"]))
            lines.append(
                [fault, str(len(own)), *map(str, counts), *_times([row["detected_s"] for row in detected]), causes]
            )
    heads = ["fault", "armed", "fell back", "tripped", "median, s", "99 %, s", "monitor"]
    return Table(heads, lines)


def grid_table(rows: Rows) -> Table:
    """Effects on the grid of faults that make control wrong, with and without supervision."""
    lines = []
    groups: dict[str, Callable[[dict[str, Any]], bool]] = {
        fault: (lambda row, fault=fault: row["fault"] == fault)  # type: ignore[misc]
        for fault, row in FAULTS.items()
        if row.wrong
    }
    calm = f"nothing fails, {CYCLING}"
    groups[calm] = lambda row: row["fault"] == NOTHING and row["reversals"] > FREQUENT
    for name, fits in groups.items():
        own = [row for row in rows if fits(row)]
        able = [row for row in own if row["does_no_harm"] is not None]
        if own:
            cells = [
                [
                    str(sum(row[f"{which}lost_s"] is not None for row in own)),
                    str(sum(row[f"{which}does_no_harm"] is False for row in able)),
                    *_ratios(able, which),
                ]
                for which in WHICH[:2]
            ]
            pairs = [Pair(*pair) for pair in zip(*cells, strict=True)]
            lines.append([name, str(len(own)), pairs[0], str(len(able)), *pairs[1:]])
    heads = ["what is wrong", "cases", "synchronism lost", "compared", f"above {HARM:g}"]
    heads += ["ITAE, median", "ITAE, 90 %", "ITAE, 99 %"]
    return Table(heads, lines)


def place_table(rows: Rows) -> Table:
    """By system and scenario: how often ITAE exceeds that without control, and how often before or without a fault."""
    lines = []
    for place in sorted({(row["base_run"], row.get("scenario", "")) for row in rows}):
        own = [row for row in rows if (row["base_run"], row.get("scenario", "")) == place]
        above = [row for row in own if row["does_no_harm"] is False]
        able = [row for row in own if row["does_no_harm"] is not None]
        calm = sum(row["early"] or row["fault"] == NOTHING for row in above)
        bare = [row for row in own if row.get("unsupervised_does_no_harm") is False]
        plain = [row["uncontrolled_ITAE"] for row in own if row["uncontrolled_ITAE"] is not None]
        without = f"{median(plain):.3g}" if plain else "synchronism lost"
        cells = [without, str(len(able)), str(len(above)), percent(len(above), len(able)), str(calm), str(len(bare))]
        lines.append([" ".join(place), str(len(own)), *cells])
    heads = ["system, scenario", "cases", "ITAE without control", "can violate", f"above {HARM:g}, or lost", "%"]
    heads += ["of these before a fault", "without supervision"]
    return Table(heads, lines)


def cost_table(rows: Rows) -> Table:
    """Cost of supervision without faults: loss of damping of those that are taken off, and of the others."""
    healthy, lines = [row for row in rows if row["fault"] == NOTHING], []
    for name, off in (("stays armed", False), ("falls back or is tripped", True)):
        own = [row for row in healthy if _taken_off(row) == off]
        pairs = [row["ITAE"] / row["unsupervised_ITAE"] for row in own if row["ITAE"] and row.get("unsupervised_ITAE")]
        found = [f"{np.percentile(pairs, q):.3f}" for q in (50, 90, 99)] if pairs else ["-"] * 3
        lines.append([name, str(len(own)), *found])
    heads = ["the controller", "healthy cases", "ITAE beside no supervision, median", "90 %", "99 %"]
    return Table(heads, lines)


def controller_table(rows: Rows) -> Table:
    """By controller: how often it was armed, tripped without a fault, and did harm."""
    lines = []
    for name in dict.fromkeys((row["controller"], row["scheme"]) for row in rows):
        own = [row for row in rows if (row["controller"], row["scheme"]) == name]
        calm = [row for row in own if row["fault"] == NOTHING and row["armed_s"] is not None]
        tripped = sum(row["tripped_s"] is not None for row in calm)
        able = sum(row["does_no_harm"] is not None for row in own)
        harmful = sum(row["does_no_harm"] is False for row in own)
        lost, never = (
            sum(row[name] is kind for row in own) for name, kind in (("keeps_synchronism", False), ("armed_s", None))
        )
        counts = [str(len(own)), str(never), f"{tripped} of {len(calm)}", f"{harmful} of {able}", str(lost)]
        lines.append([" ".join(part for part in name if part), *counts])
    heads = ["controller", "cases", "never armed", "tripped although nothing failed"]
    heads += [f"ITAE above {HARM:g}, or lost", "synchronism lost that is kept without"]
    return Table(heads, sorted(lines))


def holds(row: dict[str, Any]) -> bool:
    """Whether all invariants hold for a draw or a graph."""
    return study.holds(row, tuple(WORDS))


def _largest(rows: Rows, what: Callable[[dict[str, Any]], str]) -> str:
    found: dict[str, int] = {}
    for row in rows:
        found[what(row)] = found.get(what(row), 0) + 1
    ranked = sorted(found.items(), key=lambda one: -one[1])
    more = [f"{len(ranked) - LISTED} others"] if len(ranked) > LISTED else []
    return "; ".join([*(f"{name} {count}" for name, count in ranked[:LISTED]), *more]) or "-"


def percent(part: int, of: int) -> str:
    """A fraction in per cent, to two digits after the point."""
    return f"{100.0 * part / of:.2f}" if of else "-"


def _times(times: Sequence[float]) -> list[str]:
    return [f"{median(times):.2f}", f"{np.percentile(times, 99):.2f}"] if times else ["-", "-"]


def _ratios(rows: Rows, which: str) -> list[str]:
    """Quantiles of ITAE relative to no control; a run that loses synchronism alone counts as the largest."""
    values = [math.inf if not row[f"{which}keeps_synchronism"] else row[f"{which}ratio"] for row in rows]
    known = [value for value in values if value is not None]
    method = "higher" if math.inf in known else "linear"  # nothing lies between a number and infinity
    found = [np.percentile(known, q, method=method) for q in (50, 90, 99)] if known else []  # type: ignore[call-overload]
    return ["lost" if math.isinf(x) else f"{x:.2f}" for x in found] or ["-"] * 3
