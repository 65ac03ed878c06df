"""Tables of a campaign: invariants, actions of the supervisor, effects on the grid, cost of supervision."""

from __future__ import annotations

import math
from statistics import median
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.monitor_table import MONITORS
from facts_damping.output.tables import table
from facts_damping_studies.campaigns.faults import FAULTS, NOTHING
from facts_damping_studies.campaigns.invariants import HARM, INVARIANTS
from facts_damping_studies.margins.margins import failed_fraction

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from facts_damping_studies.campaigns.draw_rows import DrawRow
    from facts_damping_studies.campaigns.invariants import Effect, EffectAlone

    Rows = Sequence[DrawRow]  # without an error

# Harm is beside no control: a case's ITAE is above `HARM` times that without, or it loses synchronism that is kept
# without. A trip is costly or helpful beside the same controller without supervision, by the same factor.
CYCLING, FREQUENT = "limit cycle at the control rate", MONITORS["reversals"].limit
WORDS = {
    "within_limits": "outputs within limits, rates and authority",
    "lets_go": "the device at zero within time-out and ramp after the last accepted setpoint",
    "zero_after_trip": "the supervisor sends zero from a trip to the end of the run",
    "device_at_zero": "the device at zero after a trip",
    "cause_recorded": "every trip has its cause recorded",
    "keeps_synchronism": "synchronism kept if it is kept without control",
    "does_no_harm": f"no harm: ITAE at most {HARM:g} times that without control",
    "recorded": "the recording complete and readable",
    "as_computed": "the recording equal to the in-process run, bit for bit",
    "nothing_forged_acts": "no forged message has an effect",
}


TURNED = ("wrong_sign", "wrong_sign_behind", "sign_swapped")  # faults by which control adds to an oscillation


LONG_S = 5.0  # s: a fault that lasts as long should be found


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
        return cls(part, *(round(100.0 * value, 2) for value in (part / whole, ends.low, ends.high)))

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
        asked = [row for row in rows if row.invariants.get(name) is not None]
        failed = [row for row in asked if not row.invariants[name]]
        places = most_frequent(failed, lambda row: f"{row.drawn.fault}, {' '.join(row.drawn.place)}".strip())
        lines.append([WORDS[name], str(len(asked)), Fraction.of(len(failed), len(asked)), places])
    heads = ["what must hold", "cases that can violate it", "violated", "most frequent"]
    return Table(heads, lines)


def outcome_table(rows: Rows) -> Table:
    """With supervision, without it, and without control: synchronism of all draws, harm to those that can be harmed."""
    able = [row for row in rows if row.effect.does_no_harm is not None]
    free, lines = any(row.unsupervised is not None for row in rows), list[list[Any]]()
    words = ("synchronism lost", "the same, if it is kept without control")
    for what, some in zip(words, (rows, able), strict=True):
        lost = [sum(effect.lost_s is not None for effect in effects) for effects in _effects(some, free=free)]
        lost.append(sum(row.effect.uncontrolled_lost_s is not None for row in some))
        lines.append([what, str(len(some)), *(Fraction.of(count, len(some)) for count in lost)])
    harms = [sum(effect.does_no_harm is False for effect in effects) for effects in _effects(able, free=free)]
    harm = f"harm: ITAE above {HARM:g} times that without control, or synchronism lost; of those that keep it without"
    lines.append([harm, str(len(able)), *(Fraction.of(count, len(able)) for count in harms), "-"])
    without = ["without supervision"] if free else []
    return Table(["what", "cases", "with supervision", *without, "without control"], lines)


def _effects(rows: Rows, *, free: bool) -> list[list[Effect] | list[EffectAlone]]:
    """With supervision; `free`: and without."""
    without = [row.unsupervised for row in rows if row.unsupervised is not None]
    return [[row.effect for row in rows], *([without] if free else [])]


def healthy_table(rows: Rows) -> Table:
    """Of all draws in which nothing fails, by system and monitor: how many were taken off, at a cost or to benefit."""
    healthy, lines = [row for row in rows if row.drawn.fault == NOTHING], []
    for system in [*sorted({row.drawn.base_run for row in healthy}), ""]:
        system_rows = [row for row in healthy if system in ("", row.drawn.base_run)]
        off = [row for row in system_rows if taken_off(row)]
        monitors = sorted({cause(row) for row in off})
        for monitor in ["", *monitors] if system else [""]:
            by = [row for row in off if monitor in ("", cause(row))]
            counts = [sum(which(row) for row in by) for which in (_costly, _helpful)]
            never = str(sum(row.actions.armed_s is None for row in system_rows)) if not monitor else ""
            lines.append(
                [
                    system or "all",
                    monitor or "all",
                    str(len(system_rows)),
                    never,
                    Fraction.of(len(by), len(system_rows)),
                ]
            )
            lines[-1] += [Fraction.of(count, len(system_rows)) for count in counts]
    heads = ["system", "monitor", "healthy cases", "never armed", "fell back or tripped", "costly", "helpful"]
    return Table(heads, lines, 2)


def missed_table(rows: Rows) -> Table:
    """Faults by which control adds to an oscillation and which last: how many were never found, and with what harm."""
    turned = [row for row in rows if row.drawn.fault in TURNED]
    acting = [row for row in turned if _acts(row) and float(row.drawn.labels["lasts"] or math.inf) >= LONG_S]
    lines = []
    for fault, system in sorted({(row.drawn.fault, row.drawn.base_run) for row in acting}):
        fault_rows = [row for row in acting if (row.drawn.fault, row.drawn.base_run) == (fault, system)]
        missed = [row for row in fault_rows if row.actions.detected_s is None]
        harmed = sum(row.effect.does_no_harm is False for row in missed)
        lines.append([fault, system, str(len(fault_rows)), Fraction.of(len(missed), len(fault_rows)), str(harmed)])
    heads = [
        "fault",
        "system",
        f"armed cases, {LONG_S:g} s or longer",
        "missed",
        "of these with harm",
    ]
    return Table(heads, lines, 2)


def limit_table(rows: Rows) -> Table:
    """By the limit that was drawn: trips of healthy draws; wrong signs found with the monitor `harm` and without."""
    lines: list[list[Any]] = []
    for name in sorted({row.drawn.labels["limit"] for row in rows}, key=float):
        limit_rows = [row for row in rows if row.drawn.labels["limit"] == name]
        healthy = [row for row in limit_rows if row.drawn.fault == NOTHING]
        lines.append([name, str(len(healthy))])
        lines[-1] += [Fraction.of(sum(which(row) for row in healthy), len(healthy)) for which in (taken_off, _costly)]
        wrong = [row for row in limit_rows if row.drawn.fault in TURNED and _acts(row)]
        for harm in ("on", "off"):
            asked = [row for row in wrong if row.drawn.labels["harm"] == harm]
            detected = _detected(asked)
            lines[-1] += [str(len(asked)), Fraction.of(len(detected), len(asked)), _times(detected)[0]]
    heads = ["limit, 1/s", "healthy cases", "tripped", "costly", "wrong signs", "found", "median, s"]
    heads += ["wrong signs, monitor harm off", "found, monitor harm off", "median, monitor harm off, s"]
    return Table(heads, lines)


def _acts(row: DrawRow) -> bool:
    """Whether a controller was armed, and still acted when the fault began."""
    return row.actions.armed_s is not None and not row.actions.early


def _detected(rows: Rows) -> list[float]:
    """Times from the fault to its detection, s, where it was detected."""
    return [row.actions.detected_s for row in rows if row.actions.detected_s is not None]


def taken_off(row: DrawRow) -> bool:
    """Whether a controller fell back or was tripped."""
    return row.actions.fallback_s is not None or row.actions.tripped_s is not None


def cause(row: DrawRow) -> str:
    """The monitor that made a controller fall back, or be tripped."""
    return str(row.actions.fallback_cause or row.actions.cause)


def _costly(row: DrawRow) -> bool:
    """Whether it was taken off at a cost: its ITAE is above that of the same controller without supervision."""
    index, free = row.effect.ITAE, row.unsupervised_itae
    return taken_off(row) and free is not None and (index is None or index > HARM * free)


def _helpful(row: DrawRow) -> bool:
    """Whether it was taken off to the grid's benefit, by the same measure."""
    index, free = row.effect.ITAE, row.unsupervised_itae
    return taken_off(row) and index is not None and (free is None or HARM * index < free)


def fault_table(rows: Rows) -> Table:
    """By fault: armed draws, how many fell back and tripped, how soon, and the most frequent cause."""
    lines = []
    for fault in [name for name in FAULTS if name != NOTHING]:
        fault_rows = [row for row in rows if row.drawn.fault == fault and _acts(row)]
        if fault_rows:
            fell = sum(row.actions.fallback_s is not None for row in fault_rows)
            tripped = sum(row.actions.tripped_s is not None for row in fault_rows)
            causes = most_frequent([row for row in fault_rows if row.actions.detected_s is not None], cause)
            lines.append([fault, str(len(fault_rows)), str(fell), str(tripped), *_times(_detected(fault_rows)), causes])
    heads = ["fault", "armed", "fell back", "tripped", "median, s", "99 %, s", "monitor"]
    return Table(heads, lines)


def grid_table(rows: Rows) -> Table:
    """Effects on the grid of faults that make control wrong, with and without supervision."""
    lines = []
    groups: dict[str, Callable[[DrawRow], bool]] = {
        fault: (lambda row, fault=fault: row.drawn.fault == fault)  # type: ignore[misc]
        for fault, kind in FAULTS.items()
        if kind.wrong
    }
    calm = f"nothing fails, {CYCLING}"
    groups[calm] = lambda row: row.drawn.fault == NOTHING and row.actions.reversals > FREQUENT
    for name, fits in groups.items():
        fitting = [row for row in rows if fits(row)]
        able = [row for row in fitting if row.effect.does_no_harm is not None]
        if fitting:
            cells = [
                [
                    str(sum(effect.lost_s is not None for effect in effects)),
                    str(sum(effect.does_no_harm is False for effect in compared)),
                    *_ratios(compared),
                ]
                for effects, compared in zip(_effects(fitting, free=True), _effects(able, free=True), strict=True)
            ]
            pairs = [Pair(*pair) for pair in zip(*cells, strict=True)]
            lines.append([name, str(len(fitting)), pairs[0], str(len(able)), *pairs[1:]])
    heads = ["what is wrong", "cases", "synchronism lost", "compared", "harm"]
    heads += ["ITAE, median", "ITAE, 90 %", "ITAE, 99 %"]
    return Table(heads, lines)


def place_table(rows: Rows) -> Table:
    """By system and scenario: how often control does harm, and how often before or without a fault."""
    lines = []
    for place in sorted({row.drawn.place for row in rows}):
        place_rows = [row for row in rows if row.drawn.place == place]
        above = [row for row in place_rows if row.effect.does_no_harm is False]
        able = [row for row in place_rows if row.effect.does_no_harm is not None]
        calm = sum(row.actions.early or row.drawn.fault == NOTHING for row in above)
        bare = [row for row in place_rows if row.unsupervised is not None and row.unsupervised.does_no_harm is False]
        plain = [row.effect.uncontrolled_ITAE for row in place_rows if row.effect.uncontrolled_ITAE is not None]
        without = f"{median(plain):.3g}" if plain else "synchronism lost"
        cells = [without, str(len(able)), str(len(above)), percent(len(above), len(able)), str(calm), str(len(bare))]
        lines.append([" ".join(place), str(len(place_rows)), *cells])
    heads = ["system, scenario", "cases", "ITAE without control", "can be harmed", "harm", "%"]
    heads += ["of these before a fault", "without supervision"]
    return Table(heads, lines)


def cost_table(rows: Rows) -> Table:
    """Cost of supervision without faults: loss of damping of those that are taken off, and of the others."""
    healthy, lines = [row for row in rows if row.drawn.fault == NOTHING], []
    for name, off in (("stays armed", False), ("falls back or is tripped", True)):
        group_rows = [row for row in healthy if taken_off(row) == off]
        both = [(row.effect.ITAE, row.unsupervised_itae) for row in group_rows]
        pairs = [supervised / free for supervised, free in both if supervised and free]
        quantiles = [f"{np.percentile(pairs, q):.3f}" for q in (50, 90, 99)] if pairs else ["-"] * 3
        lines.append([name, str(len(group_rows)), *quantiles])
    heads = ["the controller", "healthy cases", "ITAE beside no supervision, median", "90 %", "99 %"]
    return Table(heads, lines)


def controller_table(rows: Rows) -> Table:
    """By controller: how often it was armed, tripped without a fault, and did harm."""
    lines = []
    for law in dict.fromkeys(row.law for row in rows):
        controller_rows = [row for row in rows if row.law == law]
        calm = [row for row in controller_rows if row.drawn.fault == NOTHING and row.actions.armed_s is not None]
        tripped = sum(row.actions.tripped_s is not None for row in calm)
        able = sum(row.effect.does_no_harm is not None for row in controller_rows)
        harmful = sum(row.effect.does_no_harm is False for row in controller_rows)
        lost = sum(row.effect.keeps_synchronism is False for row in controller_rows)
        never = sum(row.actions.armed_s is None for row in controller_rows)
        counts = [str(len(controller_rows)), str(never), f"{tripped} of {len(calm)}", f"{harmful} of {able}", str(lost)]
        lines.append([" ".join(part for part in law if part), *counts])
    heads = ["controller", "cases", "never armed", "tripped although nothing failed"]
    heads += ["harm", "synchronism lost that is kept without"]
    return Table(heads, sorted(lines))


def most_frequent(rows: Rows, what: Callable[[DrawRow], str]) -> str:
    """What occurs most in rows, each with its number; the rest as a number."""
    counts: dict[str, int] = {}
    for row in rows:
        counts[what(row)] = counts.get(what(row), 0) + 1
    ranked = sorted(counts.items(), key=lambda pair: -pair[1])
    more = [f"{len(ranked) - LISTED} others"] if len(ranked) > LISTED else []
    return "; ".join([*(f"{name} {count}" for name, count in ranked[:LISTED]), *more]) or "-"


def percent(part: int, of: int) -> str:
    """A fraction in per cent, to two digits after the point."""
    return f"{100.0 * part / of:.2f}" if of else "-"


def _times(times: Sequence[float]) -> list[str]:
    return [f"{median(times):.2f}", f"{np.percentile(times, 99):.2f}"] if times else ["-", "-"]


def _ratios(effects: Sequence[Effect] | Sequence[EffectAlone]) -> list[str]:
    """Quantiles of ITAE relative to no control; a run that loses synchronism alone counts as the largest."""
    values = [math.inf if not effect.keeps_synchronism else effect.ratio for effect in effects]
    known = [value for value in values if value is not None]
    method = "higher" if math.inf in known else "linear"  # nothing lies between a number and infinity
    quantiles = [np.percentile(known, q, method=method) for q in (50, 90, 99)] if known else []  # type: ignore[call-overload]
    return ["lost" if math.isinf(x) else f"{x:.2f}" for x in quantiles] or ["-"] * 3
