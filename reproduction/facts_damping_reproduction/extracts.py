"""What the page takes from the findings: figures in sentences, and tables in Markdown."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.analysis.indices import THESIS_INDICES
from facts_damping.output.tables import table
from facts_damping_reproduction.agreement import name
from facts_damping_reproduction.explanations import TABLE
from facts_damping_reproduction.printed import LLC
from facts_damping_reproduction.results import LINK
from facts_damping_reproduction.runs import TUNED

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping_reproduction.agreement import Signs
    from facts_damping_reproduction.ensembles import Interval
    from facts_damping_reproduction.findings import Agreement, Findings
    from facts_damping_reproduction.results import Results

JUDGED = ("ITAE", "ISE")  # of the way to the bound: one that weighs late deviations, one that the bound is made for


class Agreed(NamedTuple):
    """In how many cases a statement of the thesis holds here, of how many."""

    statement: str
    here: int
    of: int


def agreed(findings: Findings) -> list[Agreed]:
    """The statements of docs/reproduction.md, with their counts."""
    plain, drawn, counts = findings.plain, findings.drawn, []
    for words, where, over in (
        ("better than LLC", plain, "MISO LLC"),
        ("better than LLC, medians over random cases", drawn, "MISO LLC"),
        ("better than direct ANFTSC", plain, "MISO ANFTSC direct"),
    ):
        signs = _signs(where, over)
        counts += [Agreed(words, signs.agree, signs.statements)] if signs else []
    counts.append(Agreed("better than LLC-tuned, medians over random cases", *_over_tuned(findings)))
    if plain.totals:
        counts.append(
            Agreed("the same controller first in an order", plain.totals[-1].same_best, plain.totals[-1].rankings)
        )
    counts.append(Agreed("indirect better than direct", *_better(plain, "MISO indirect", "MISO direct")[1:]))
    counts.append(Agreed("both devices better than the SSSC", *_better(plain, "MIMO indirect", "MISO indirect")[1:]))
    counts.append(Agreed("indirect smoother than direct", *_smoother(plain, "smoother than direct")))
    counts.append(Agreed("smoother than LLC", *_smoother(plain, "smoother than LLC")))
    return [count for count in counts if count.of]


def _signs(agreement: Agreement, over: str) -> Signs | None:
    signs = [
        row for row in agreement.signs_by_reference if (row.table, row.what) == ("all", f"improvement over {over}")
    ]
    return signs[0] if signs else None


def fraction(agreement: Agreement, over: str) -> str:
    """How many of the improvements over a controller have the thesis's sign: `66 of 100 (66.0 %)`."""
    signs = _signs(agreement, over)
    return f"{signs.agree} of {signs.statements} ({100 * signs.fraction:.1f} %)" if signs else "none"


def rho(agreement: Agreement) -> str:
    """Mean rank correlation over all orders."""
    value = agreement.totals[-1].mean_rho if agreement.totals else None
    return "-" if value is None else f"{value:.2f}"


def firm(findings: Findings) -> str:
    """How firm orders are, by system and scheme: a row each, over scenarios and quantities."""
    rows = []
    for key in dict.fromkeys((order.system, order.scheme) for order in findings.firmness):
        orders = [order for order in findings.firmness if (order.system, order.scheme) == key]
        same = sum(order.first == order.first_of_medians for order in orders)
        first = np.array([order.first_in_draws for order in orders])
        known = [order.rho for order in orders if order.rho is not None]
        spread = f"{100 * first.mean():.0f} ({100 * first.min():.0f} to {100 * first.max():.0f})"
        drawn = float(np.mean([order.rho_in_draws for order in orders]))
        rows.append([*key, f"{same} of {len(orders)}", spread, f"{np.mean(known):.2f}", f"{drawn:.2f}"])
    titles = ["first is first by medians", "fraction of draws in which it is first [%]", "rho, medians", "rho, draws"]
    return "\n".join(table(["system", "scheme", *titles], rows, left=2, markdown=True))


def decided(findings: Findings) -> str:
    """Who has the best mean place over the scenarios, and which single scenario decides it."""
    rows = [
        [decision.system, decision.scheme, decision.quantity, decision.first, ", ".join(decision.deciding) or "none"]
        for decision in findings.decided
    ]
    titles = ["system", "scheme", "quantity", "best mean place", "decided by"]
    return "\n".join(table(titles, rows, left=5, markdown=True))


def medians(findings: Findings, system: str, link: str) -> str:
    """Median improvement of the indices over LLC-tuned, %, with intervals: those that also ran behind the link."""
    spreads = [spread for spread in findings.spreads if spread.system == system and spread.quantity in THESIS_INDICES]
    whos = [who for who in dict.fromkeys(spread.who for spread in spreads if spread.link == LINK) if who != name(TUNED)]
    scenarios = dict.fromkeys(spread.scenario for spread in spreads)
    at = {
        (spread.scenario, spread.who, spread.quantity): spread.over_tuned for spread in spreads if spread.link == link
    }
    columns = [(scenario, index) for scenario in scenarios for index in THESIS_INDICES]
    rows = [[who, *(_interval(at[scenario, who, index]) for scenario, index in columns)] for who in whos]
    return "\n".join(table(["controller", *(" ".join(place) for place in columns)], rows, markdown=True))


def _interval(value: Interval) -> str:
    ends = f" ({value.low:.1f} to {value.high:.1f})" if np.isfinite(value.high - value.low) else ""  # few draws: none
    return f"{value.median:.1f}{ends}"


def beaten(findings: Findings, system: str, link: str, who: str) -> str:
    """Where the median of a controller is not below that of LLC-tuned, and of how many: `none of 12`."""
    spreads = [
        spread
        for spread in findings.spreads
        if (spread.system, spread.link) == (system, link) and spread.quantity in THESIS_INDICES
    ]
    middle = {(spread.scenario, spread.quantity, spread.who): spread.figure.median for spread in spreads}
    places = [(scenario, index) for scenario, index, whose in middle if whose == who]
    lost = [
        f"{scenario} {index}"
        for scenario, index in places
        if not middle[scenario, index, who] < middle[scenario, index, name(TUNED)]
    ]
    return f"{', '.join(lost) or 'none'} of {len(places)}"


def reached(findings: Findings, system: str) -> str:
    """How much of the way from LLC to the bound every controller comes, %, in the scenarios as they are."""
    ways = [way for way in findings.reached if way.system == system and way.quantity in JUDGED]
    columns = list(dict.fromkeys((way.scenario, way.quantity) for way in ways))
    at = {(way.who, way.scenario, way.quantity): way.fraction for way in ways}
    rows = []
    for who in dict.fromkeys(way.who for way in ways):
        fractions = [at[who, scenario, quantity] for scenario, quantity in columns]
        rows.append([who, *("-" if percentage is None else f"{percentage:.0f}" for percentage in fractions)])
    return "\n".join(table(["controller", *(" ".join(place) for place in columns)], rows, markdown=True))


def better(agreement: Agreement, first: str, second: str) -> str:
    """How often the networks of one kind (`MISO indirect`) have lower indices than the same ones of another.

    Theirs and ours: `168 of 176, ours 90`. Theirs by the improvements over LLC.
    """
    theirs, ours, of = _better(agreement, first, second)
    return f"{theirs} of {of}, ours {ours}"


def _better(agreement: Agreement, first: str, second: str) -> tuple[int, int, int]:
    over_llc = [c for c in agreement.compared if c.cell.against == LLC and c.cell.scheme]
    at = {
        (f"{c.cell.architecture} {c.cell.scheme}", c.cell[1:3], c.cell.controller, c.cell.quantity): c for c in over_llc
    }
    pairs = [(c, at[first, a, b, q]) for (kind, a, b, q), c in at.items() if kind == second and (first, a, b, q) in at]
    theirs = sum(other.cell.corrected > c.cell.corrected for c, other in pairs)
    ours = sum((other.figure or np.inf) < (c.figure or np.inf) for c, other in pairs)
    return theirs, ours, len(pairs)


def smoother(agreement: Agreement, what: str) -> str:
    """In how many cases a statement about roughness holds here, whatever the thesis says: `44 of 77`."""
    return "{} of {}".format(*_smoother(agreement, what))


def _smoother(agreement: Agreement, what: str) -> tuple[int, int]:
    stated = [statement for statement in agreement.statements if statement.what == what]
    return sum((statement.ours or 0.0) > 0.0 for statement in stated), len(stated)


def over_tuned(findings: Findings) -> str:
    """In how many cases the networks of the tables are better than LLC-tuned by medians of the improvement."""
    return "{} of {}".format(*_over_tuned(findings))


def _over_tuned(findings: Findings) -> tuple[int, int]:
    runs = {(c.cell.system, c.cell.scenario, name(c.cell.who)) for c in findings.plain.compared if c.cell.scheme}
    spreads = [
        spread
        for spread in findings.spreads
        if spread.link == "ideal"
        and spread.quantity in THESIS_INDICES
        and (spread.system, spread.scenario, spread.who) in runs
    ]
    return sum(spread.over_tuned.median > 0.0 for spread in spreads), len(spreads)


def extremes(results: Results) -> str:
    """The lowest and the highest mean rank correlation with the thesis among the set-ups, and where."""
    known = sorted((row.rho, row.variant, row.table) for row in results.told if row.rho is not None)
    low, high = (f"{extreme[0]:.2f} ({extreme[1]}, table {extreme[2]})" for extreme in (known[0], known[-1]))
    return f"{low} to {high}"


def setups(results: Results) -> str:
    """Every set-up: agreement with the thesis by table, signs and mean rank correlation; and with our own orders."""
    tables = list(dict.fromkeys(row.table for row in results.told))
    at = {(row.variant, row.table): row for row in results.told}
    rows = []
    for variant in TABLE:
        variant_rows = [at.get((variant.name, table)) for table in tables]
        if any(variant_rows):
            cells = [
                "" if row is None else f"{100 * row.signs:.0f}; {_two(row.rho)}; {_two(row.rho_own)}"
                for row in variant_rows
            ]
            rows.append([variant.name, variant.what, *cells])
    titles = ["set-up", "what is changed", *(f"table {number}" for number in tables)]
    return "\n".join(table(titles, rows, left=2, markdown=True))


def _two(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


ALL: tuple[Callable[..., str], ...] = (
    fraction,
    rho,
    firm,
    decided,
    medians,
    beaten,
    reached,
    better,
    smoother,
    over_tuned,
    extremes,
    setups,
)
