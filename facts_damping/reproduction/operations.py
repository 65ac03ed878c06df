"""Table 3.1: parameters updated at a step and operations of a network's pass, as printed and as counted in our code.

Two inputs, two rules, one output. Ours are counted in the functions that controllers run (`counting`): those that the
output needs, as the thesis counts, and those of a whole step, with all derivatives that it computes beside.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.neurofuzzy.network import Pass, backward, counted, forward, network, shapes
from facts_damping.neurofuzzy.start import Start, initial
from facts_damping.neurofuzzy.table import VARIANTS
from facts_damping.reproduction import counting
from facts_damping.reproduction.printed import Operations, operations
from facts_damping.studies.pages import heads, line

if TYPE_CHECKING:
    from collections import Counter
    from collections.abc import Sequence

    from facts_damping.neurofuzzy.table import Variant

SHAPE = (2, 2, 1)  # inputs, rules, outputs
# Where it is counted: every membership fires, and firing strengths lie in one half of the Legendre wavelets.
AT = (0.2, -0.1)
START = Start(weight=[0.5], spread=[0.5, 0.5], width=[3.0, 3.0], shift=[0.5, 0.5], dilation=[1.0, 1.0])
OTHERS = {"roots": "roots", "sign changes": counting.NEGATION}  # table 3.1 has no column for them

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


def complexity() -> list[Count]:
    """Table 3.1 with ours. Raises `InputError` where the printed figures cannot be read."""
    rows = []
    for printed in operations():
        variant = VARIANTS[printed.controller]
        own = counted(variant.antecedent, variant.consequent, *SHAPE)
        rows.append(Count(printed.controller, "parameters", printed.parameters, own, None))
        output, step = counts(variant)
        both = zip(Operations._fields[2:], printed[2:], strict=True)
        rows += [Count(printed.controller, what, theirs, output[what], step[what]) for what, theirs in both]
        rows += [Count(printed.controller, name, None, output[kind], step[kind]) for name, kind in OTHERS.items()]
    return rows


def counts(variant: Variant) -> tuple[Counter[str], Counter[str]]:
    """Operations by kind (`counting`): those that the output of a network needs, and those of a whole step."""
    net, tape = network(variant.antecedent, variant.consequent, *SHAPE), counting.Tape()
    theta, x = (
        np.array([counting.Number(tape, float(value)) for value in values], object)
        for values in (initial(net, START), AT)
    )
    passed = Pass(*(np.full(shape, 0.0, object) for shape in shapes(net)))
    counting.plain(forward)(net, theta, x, passed)
    output = counting.counted(counting.needed(tape, passed.output))
    counting.plain(backward)(net, passed)
    return output, counting.counted(tape.made)


def markdown(rows: Sequence[Count]) -> list[str]:
    """The table in Markdown, a line a controller: printed / ours / ours with derivatives."""
    kinds = list(dict.fromkeys(row.what for row in rows))
    cells = {(row.controller, row.what): " / ".join(_text(n) for n in row[2:]) for row in rows}
    names = dict.fromkeys(row.controller for row in rows)
    return [*heads(["controller"], kinds), *(line([name, *(cells[name, kind] for kind in kinds)]) for name in names)]


def _text(number: int | None) -> str:
    return "-" if number is None else str(number)
