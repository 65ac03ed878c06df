"""Table 3.1: the counting itself, and what is said about the differences."""

from __future__ import annotations

import csv
import math
from collections import Counter
from typing import Any

import numpy as np
import pytest

from facts_damping.compiling import compiled
from facts_damping.neurofuzzy.network import forward, network, passes
from facts_damping.neurofuzzy.start import initial
from facts_damping.neurofuzzy.table import VARIANTS, Variant
from facts_damping_reproduction.operations import SHAPE, WHY, Count, complexity, file, markdown
from facts_damping_reproduction.printed import Operations, operations
from tests.reproduction import counting
from tests.reproduction.counting import AT, START, counts

KINDS = ("additions", "multiplications", "divisions", "exponentials", "trigonometric")
# What the thesis counts, as far as it can be derived: a membership, and the rules of a network.
GAUSSIAN, TRIANGULAR, SPLINE = (1, 3, 1, 1, 0), (2, 1, 1, 0, 0), (4, 2, 1, 0, 0)
TWO_RULES = (2, 4, 1, 0, 0)
MEXICAN_HATS, MORLETS = (6, 26, 4, 4, 0), (2, 22, 0, 4, 4)  # four wavelets and their weights, without x - tau and / nu


@compiled
def _polynomial(x: float, y: float) -> float:
    unused = math.sin(x)
    value = 0.0
    for k in range(3):
        value += 1.0 * x * y + k * 0.0 * unused
    return value / 2.0 - math.exp(-x) + 2.0 * 3.0 * abs(y)


def evaluated(x: float, y: float) -> tuple[counting.Tape, Any]:
    tape = counting.Tape()
    return tape, counting.plain(_polynomial)(counting.Number(tape, x), counting.Number(tape, y))


def test_operations_of_a_function_are_those_written_without_zeros_and_ones() -> None:
    tape, result = evaluated(0.3, -0.7)
    assert result.value == pytest.approx(1.5 * 0.3 * -0.7 - math.exp(-0.3) + 6.0 * 0.7)
    everything = counting.counted(tape.made)
    assert everything == {
        "additions": 4, "multiplications": 4, "divisions": 1, "negations": 1, "exponentials": 1, "trigonometric": 1
    }  # fmt: skip
    assert counting.counted(counting.needed(tape, [result])) == everything - Counter(trigonometric=1)


def test_operations_that_enter_a_comparison_are_counted() -> None:
    tape = counting.Tape()
    x = counting.Number(tape, 2.0)
    assert x + 1.0 > 2.0
    assert min(max(x * 2.0, -1.0), 1.0) == 1.0
    assert math.ceil(x / 4.0) == 1
    assert counting.counted(counting.needed(tape, [])) == {"additions": 1, "multiplications": 1, "divisions": 1}


@pytest.mark.parametrize("name", VARIANTS)
def test_function_that_is_counted_gives_the_output_of_the_compiled_one(name: str) -> None:
    net = network(VARIANTS[name].antecedent, VARIANTS[name].consequent, *SHAPE)
    theta, p, tape = initial(net, START), passes(net), counting.Tape()
    forward(net, theta, np.array(AT), p)
    q = counting.passes(net)
    numbers = np.array([counting.Number(tape, float(v)) for v in theta], object)
    counting.plain(forward)(net, numbers, np.array([counting.Number(tape, v) for v in AT], object), q)
    assert q.output[0].value == pytest.approx(p.output[0], rel=1e-12)
    assert p.total[0] > 0


def test_file_has_what_is_counted() -> None:
    with file().open(encoding="utf-8", newline="") as stream:
        written = [{key: int(v) if v.isdigit() else v for key, v in row.items()} for row in csv.DictReader(stream)]
    assert written == counting.rows()


@pytest.mark.parametrize("row", complexity(), ids=lambda row: f"{row.controller}-{row.what}")
def test_parameters_are_theirs_and_a_step_takes_more_than_its_output(row: Count) -> None:
    if row.what == "parameters":
        assert row.ours == row.theirs
    else:
        assert row.step is not None
        assert row.step >= row.ours >= 0


def test_network_of_gaussians_and_singletons_by_hand() -> None:
    """z = (x - h) / s, exp(-(z z)) four times; two products of two, w F twice, two sums of two, a quotient."""
    output, _ = counts(VARIANTS["ANFTSC"])
    assert output == {"additions": 6, "multiplications": 8, "divisions": 5, "exponentials": 4, "negations": 4}


def printed(name: str) -> tuple[int, ...]:
    return next(tuple(row[2:]) for row in operations() if row.controller == name)


def total(membership: tuple[int, ...], *parts: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(4 * m + sum(rest) for m, *rest in zip(membership, *parts, strict=True))


def test_operation_counts_of_the_thesis_follow_its_stated_way_of_counting() -> None:
    """Of `WHY`: which of its rows follow from one way of counting, and where the table contradicts itself."""
    assert total(GAUSSIAN, TWO_RULES) == printed("ANFTSC")
    assert total(SPLINE, TWO_RULES) == printed("ANFBsC")
    assert total(GAUSSIAN, TWO_RULES, MEXICAN_HATS) == printed("ANFGuMeC")
    assert total(TRIANGULAR, TWO_RULES, MEXICAN_HATS) == printed("ANFTrMeC")
    assert total(GAUSSIAN, TWO_RULES, MORLETS) == printed("ANFGuMoC")
    assert total(TRIANGULAR, TWO_RULES, MORLETS) == tuple(np.add(printed("ANFTrMoC"), (0, 2, 0, 0, 0)))
    assert total(SPLINE, TWO_RULES, MORLETS) == tuple(np.add(printed("HBsWC"), (-4, 0, 0, 0, 0)))
    assert total(GAUSSIAN, TWO_RULES, (0, 2, 0, 0, 0)) == tuple(np.add(printed("ANFSC"), (0, 0, 0, 4, 0)))
    fourier = np.subtract(printed("ANFFsC"), total(GAUSSIAN, TWO_RULES))
    assert fourier.tolist() == [48 + 9, 2 * (24 + 25), 0, 0, 8]
    legendre = np.subtract(printed("ANFLeC"), total(GAUSSIAN, TWO_RULES))
    assert legendre.tolist() == [12, 2 * (2 * 8 + 6), 0, 0, 2]
    wavelets = np.subtract(printed("ANFLeWC"), total(GAUSSIAN, TWO_RULES))
    assert wavelets.tolist() == [28, 51, 0, -4, 0]


def ours(name: str) -> list[int]:
    output, _ = counts(VARIANTS[name])
    return [output[kind] for kind in KINDS]


@pytest.mark.parametrize(
    ("name", "more"),
    [
        ("ANFTSC", (0, 8, 0, 0, 0)),
        ("ANFSC", (0, 8 - 2, 0, -4, 0)),
        ("ANFFsC", (9 - 2, 8 + 2 * (24 + 25) - (16 + 2 * 24 + 8), 0, 0, 4)),
        ("ANFGuMeC", (-4, 8 + 4, -4, 0, 0)),
        ("ANFGuMoC", (-4, 8 + 4, -4, 0, 0)),
        ("ANFTrMeC", (-4, 4, -4, 0, 0)),
        ("ANFTrMoC", (-4, 4 - 2, -4, 0, 0)),
        ("ANFLeC", (-10, 8 + 2 * 2 * (8 - 6), 0, 0, 0)),
        ("ANFBsC", (4 * (4 - 2), 0, 4, 0, 0)),
        ("HBsWC", (4 * (4 - 2), 4, 4 - 4, 0, 0)),
    ],
)
def test_operation_counts_differ_from_the_thesis_as_stated(name: str, more: tuple[int, ...]) -> None:
    assert np.subtract(printed(name), ours(name)).tolist() == list(more)


def test_thesiss_splines_cost_what_an_interpolated_one_does_not_the_nearest_point() -> None:
    output, _ = counts(Variant("b-spline-interpolated", "singleton", "ANFTSI"))
    assert output["additions"] == next(row for row in operations() if row.controller == "ANFBsC").additions


def test_table_in_markdown_has_a_line_a_controller() -> None:
    lines = markdown(complexity())
    assert len(lines) == 2 + len(VARIANTS)
    assert lines[2].startswith("| ANFTSC | 10 / 10 / - | 6 / 6 / ")
    assert set(WHY) == set(VARIANTS)
    assert len(Operations._fields) == 7
