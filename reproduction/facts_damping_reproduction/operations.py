"""Table 3.1: parameters updated at a step and operations of a network's pass, as printed and as counted in our code.

Two inputs, two rules, one output. Ours were counted in the functions that controllers run: those that the output needs,
as the thesis counts, and those of a whole step, with all derivatives that it computes beside. A test counts them anew
(`tests/reproduction/counting.py`, which also writes the file).
"""

from __future__ import annotations

import csv
from typing import TYPE_CHECKING, NamedTuple

from facts_damping.input_files import share_folder
from facts_damping.neurofuzzy.network import counted
from facts_damping.neurofuzzy.table import VARIANTS
from facts_damping.output.tables import table
from facts_damping_reproduction.printed import Operations, operations

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

SHAPE = (2, 2, 1)  # inputs, rules, outputs
OTHERS = ("roots", "negations")  # table 3.1 has no column for them

_GAUSSIAN = (
    "Multiplications: (3.9) as printed, (x - h)^2 s^-2, has two squares and a product, ours ((x - h) / s)^2 one square:"
    " 8 more in four memberships"
)
_WAVELETS = "the thesis leaves out x - tau and the division by nu (4 each) and has one multiplication more a wavelet"
_EXPONENTIALS = "The exponentials of the four gaussian memberships are not printed"
WHY = {  # ours differs from the printed count because
    "ANFTSC": f"{_GAUSSIAN}.",
    "ANFSC": f"{_GAUSSIAN}; ours forms F V of each rule twice, 2 more than the thesis. {_EXPONENTIALS}.",
    "ANFFsC": f"{_GAUSSIAN}; the thesis forms the 24 products of harmonics and 25 with weights for each rule, ours 16"
    " products once, 24 with weights a rule and 8 for the double angles, which need no sine of their own (4 instead of"
    " 8). Additions: 48 of the rules' sums in both, 2 of ours for the double angles; the thesis's other 9 are not"
    " explained.",
    "ANFGuMeC": f"{_GAUSSIAN}. Wavelets: {_WAVELETS}.",
    "ANFGuMoC": f"{_GAUSSIAN}. Wavelets: {_WAVELETS}.",
    "ANFTrMeC": f"Wavelets: {_WAVELETS}.",
    "ANFTrMoC": f"Wavelets: {_WAVELETS}; as in ANFGuMoC this would give 30 multiplications, printed are 28.",
    "ANFLeC": f"{_GAUSSIAN}; polynomials with their factor 1/2 outside, as printed, have 8 an input and rule, ours 6."
    " That the thesis has 10 additions less is not explained.",
    "ANFLeWC": f"{_GAUSSIAN}. Ours forms the three wavelets that are not zero. The printed 28 additions and 51"
    " multiplications of the wavelets are not explained (51 is odd, with two equal rules)."
    f" {_EXPONENTIALS}.",
    "ANFBsC": "The thesis counts the order-2 curve (3.12) between two control points (4 additions, 2 multiplications, 1"
    " division a membership), though its 6 parameters are those of the nearest control point alone, which ours takes (2"
    " additions, 2 multiplications).",
    "HBsWC": "Memberships as ANFBsC. Wavelets: the thesis leaves out the division by nu and has one multiplication more"
    " a wavelet; unlike in the other wavelet networks it has x - tau.",
}


class Count(NamedTuple):
    """A cell of table 3.1: printed, the same of our output, and what our whole step takes."""

    controller: str
    what: str
    theirs: int | None  # none: no column for it
    ours: int
    step: int | None  # none: of parameters


def file() -> Path:
    """The operations that were counted: controller, operation, for the output, for a whole step."""
    return share_folder() / "config" / "references" / "operations.csv"


def complexity() -> list[Count]:
    """Table 3.1 with ours. Raises `InputError` where the printed figures cannot be read."""
    with file().open(encoding="utf-8", newline="") as stream:
        ours = {(r["controller"], r["operation"]): (int(r["output"]), int(r["step"])) for r in csv.DictReader(stream)}
    rows = []
    for printed in operations():
        name, variant = printed.controller, VARIANTS[printed.controller]
        parameters = counted(variant.antecedent, variant.consequent, *SHAPE)
        rows.append(Count(name, "parameters", printed.parameters, parameters, None))
        both = zip(Operations._fields[2:], printed[2:], strict=True)
        rows += [Count(name, what, theirs, *ours[name, what]) for what, theirs in both]
        rows += [Count(name, what, None, *ours[name, what]) for what in OTHERS]
    return rows


def markdown(rows: Sequence[Count]) -> list[str]:
    """The table in Markdown, a line a controller: printed / ours / ours with derivatives."""
    kinds = list(dict.fromkeys(row.what for row in rows))
    cells = {(row.controller, row.what): " / ".join(_text(n) for n in row[2:]) for row in rows}
    names = dict.fromkeys(row.controller for row in rows)
    rows_of = [[name, *(cells[name, kind] for kind in kinds)] for name in names]
    return table(["controller", *kinds], rows_of, markdown=True)


def _text(number: int | None) -> str:
    return "-" if number is None else str(number)
