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
    plain, drawn, found = findings.plain, findings.drawn, []
    for words, where, over in (
        ("better than LLC", plain, "MISO LLC"),
        ("better than LLC, medians over random cases", drawn, "MISO LLC"),
        ("better than direct ANFTSC", plain, "MISO ANFTSC direct"),
    ):
        signs = _signs(where, over)
        found += [Agreed(words, signs.agree, signs.statements)] if signs else []
    found.append(Agreed("better than LLC-tuned, medians over random cases", *_over_tuned(findings)))
    if plain.totals:
        found.append(
            Agreed("the same controller first in an order", plain.totals[-1].same_best, plain.totals[-1].rankings)
        )
    found.append(Agreed("indirect better than direct", *_better(plain, "MISO indirect", "MISO direct")[1:]))
    found.append(Agreed("both devices better than the SSSC", *_better(plain, "MIMO indirect", "MISO indirect")[1:]))
    found.append(Agreed("indirect smoother than direct", *_smoother(plain, "smoother than direct")))
    found.append(Agreed("smoother than LLC", *_smoother(plain, "smoother than LLC")))
    return [one for one in found if one.of]


def _signs(agreement: Agreement, over: str) -> Signs | None:
    signs = [
        one for one in agreement.signs_by_reference if (one.table, one.what) == ("all", f"improvement over {over}")
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
    for key in dict.fromkeys((one.system, one.scheme) for one in findings.firmness):
        own = [one for one in findings.firmness if (one.system, one.scheme) == key]
        same = sum(one.first == one.first_of_medians for one in own)
        first = np.array([one.first_in_draws for one in own])
        known = [one.rho for one in own if one.rho is not None]
        spread = f"{100 * first.mean():.0f} ({100 * first.min():.0f} to {100 * first.max():.0f})"
        drawn = float(np.mean([one.rho_in_draws for one in own]))
        rows.append([*key, f"{same} of {len(own)}", spread, f"{np.mean(known):.2f}", f"{drawn:.2f}"])
    titles = ["first is first by medians", "fraction of draws in which it is first [%]", "rho, medians", "rho, draws"]
    return "\n".join(table(["system", "scheme", *titles], rows, left=2, markdown=True))


def decided(findings: Findings) -> str:
    """Who has the best mean place over the scenarios, and which single scenario decides it."""
    rows = [
        [one.system, one.scheme, one.quantity, one.first, ", ".join(one.deciding) or "none"] for one in findings.decided
    ]
    titles = ["system", "scheme", "quantity", "best mean place", "decided by"]
    return "\n".join(table(titles, rows, left=5, markdown=True))


def medians(findings: Findings, system: str, link: str) -> str:
    """Median improvement of the indices over LLC-tuned, %, with intervals: those that also ran behind the link."""
    kept = [one for one in findings.spreads if one.system == system and one.quantity in THESIS_INDICES]
    whos = [who for who in dict.fromkeys(one.who for one in kept if one.link == LINK) if who != name(TUNED)]
    scenarios = dict.fromkeys(one.scenario for one in kept)
    at = {(one.scenario, one.who, one.quantity): one.over_tuned for one in kept if one.link == link}
    columns = [(scenario, index) for scenario in scenarios for index in THESIS_INDICES]
    rows = [[who, *(_interval(at[scenario, who, index]) for scenario, index in columns)] for who in whos]
    return "\n".join(table(["controller", *(" ".join(one) for one in columns)], rows, markdown=True))


def _interval(value: Interval) -> str:
    ends = f" ({value.low:.1f} to {value.high:.1f})" if np.isfinite(value.high - value.low) else ""  # few draws: none
    return f"{value.median:.1f}{ends}"


def beaten(findings: Findings, system: str, link: str, who: str) -> str:
    """Where the median of a controller is not below that of LLC-tuned, and of how many: `none of 12`."""
    kept = [
        one for one in findings.spreads if (one.system, one.link) == (system, link) and one.quantity in THESIS_INDICES
    ]
    middle = {(one.scenario, one.quantity, one.who): one.figure.median for one in kept}
    own = [(scenario, index) for scenario, index, whose in middle if whose == who]
    lost = [f"{one} {index}" for one, index in own if not middle[one, index, who] < middle[one, index, name(TUNED)]]
    return f"{', '.join(lost) or 'none'} of {len(own)}"


def reached(findings: Findings, system: str) -> str:
    """How much of the way from LLC to the bound every controller comes, %, in the scenarios as they are."""
    kept = [one for one in findings.reached if one.system == system and one.quantity in JUDGED]
    columns = list(dict.fromkeys((one.scenario, one.quantity) for one in kept))
    at = {(one.who, one.scenario, one.quantity): one.fraction for one in kept}
    rows = []
    for who in dict.fromkeys(one.who for one in kept):
        fractions = [at[who, scenario, quantity] for scenario, quantity in columns]
        rows.append([who, *("-" if one is None else f"{one:.0f}" for one in fractions)])
    return "\n".join(table(["controller", *(" ".join(one) for one in columns)], rows, markdown=True))


def better(agreement: Agreement, first: str, second: str) -> str:
    """How often the networks of one kind (`MISO indirect`) have lower indices than the same ones of another.

    Theirs and ours: `168 of 176, ours 90`. Theirs by the improvements over LLC.
    """
    theirs, ours, of = _better(agreement, first, second)
    return f"{theirs} of {of}, ours {ours}"


def _better(agreement: Agreement, first: str, second: str) -> tuple[int, int, int]:
    kept = [c for c in agreement.compared if c.cell.against == LLC and c.cell.scheme]
    at = {(f"{c.cell.architecture} {c.cell.scheme}", c.cell[1:3], c.cell.controller, c.cell.quantity): c for c in kept}
    pairs = [(c, at[first, a, b, q]) for (kind, a, b, q), c in at.items() if kind == second and (first, a, b, q) in at]
    theirs = sum(other.cell.corrected > c.cell.corrected for c, other in pairs)
    ours = sum((other.figure or np.inf) < (c.figure or np.inf) for c, other in pairs)
    return theirs, ours, len(pairs)


def smoother(agreement: Agreement, what: str) -> str:
    """In how many cases a statement about roughness holds here, whatever the thesis says: `44 of 77`."""
    return "{} of {}".format(*_smoother(agreement, what))


def _smoother(agreement: Agreement, what: str) -> tuple[int, int]:
    own = [one for one in agreement.statements if one.what == what]
    return sum((one.ours or 0.0) > 0.0 for one in own), len(own)


def over_tuned(findings: Findings) -> str:
    """In how many cases the networks of the tables are better than LLC-tuned by medians of the improvement."""
    return "{} of {}".format(*_over_tuned(findings))


def _over_tuned(findings: Findings) -> tuple[int, int]:
    runs = {(c.cell.system, c.cell.scenario, name(c.cell.who)) for c in findings.plain.compared if c.cell.scheme}
    own = [
        one
        for one in findings.spreads
        if one.link == "ideal" and one.quantity in THESIS_INDICES and (one.system, one.scenario, one.who) in runs
    ]
    return sum(one.over_tuned.median > 0.0 for one in own), len(own)


def extremes(results: Results) -> str:
    """The lowest and the highest mean rank correlation with the thesis among the set-ups, and where."""
    known = sorted((one.rho, one.variant, one.table) for one in results.told if one.rho is not None)
    low, high = (f"{one[0]:.2f} ({one[1]}, table {one[2]})" for one in (known[0], known[-1]))
    return f"{low} to {high}"


def setups(results: Results) -> str:
    """Every set-up: agreement with the thesis by table, signs and mean rank correlation; and with our own orders."""
    tables = list(dict.fromkeys(one.table for one in results.told))
    at = {(one.variant, one.table): one for one in results.told}
    rows = []
    for variant in TABLE:
        own = [at.get((variant.name, table)) for table in tables]
        if any(own):
            cells = [
                "" if one is None else f"{100 * one.signs:.0f}; {_two(one.rho)}; {_two(one.rho_own)}" for one in own
            ]
            rows.append([variant.name, variant.what, *cells])
    titles = ["set-up", "what is changed", *(f"table {one}" for one in tables)]
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
