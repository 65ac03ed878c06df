"""What analyze tells beyond the summary: regions, hops, improvement, and their text."""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.analysis import summarise
from facts_damping.analysis.modes import ambient
from facts_damping.analysis.modes.poles import METHODS
from facts_damping.analysis.summary import AUTO
from facts_damping.cli.parser import parser
from facts_damping.output.writing import finite
from facts_damping_views.analysis.details import details, improvements, lines

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.record import Record


def test_details_of_a_damped_run(swing_record: Callable[..., Record]) -> None:
    figures = details(swing_record())
    json.dumps(finite(figures), allow_nan=False)
    assert set(figures.regions) == {"ITAE", "IAE", "ITSE", "ISE"}
    for region in figures.regions.values():
        assert region is not None
        assert 1.0 < region.cliff_from_s < region.cliff_to_s < 20.0  # the load steps at 1 s
    assert figures.latency_hops_ms["whole"]["sssc"].max == 120.0


def test_of_a_run_that_is_lost_there_is_no_improvement(swing_record: Callable[..., Record]) -> None:
    lost = np.ones(1200, np.bool_)
    lost[-1] = False
    records = [swing_record(), swing_record(in_synchronism=lost)]
    summaries = [summarise(record) for record in records]
    calm, apart = improvements(summaries, 0)
    assert calm == dict.fromkeys(("ITAE", "IAE", "ITSE", "ISE", "roughness"), 0.0)
    assert apart is None
    rows = [details(record) for record in records]
    assert rows[1].regions == {}
    beside = [rows[0]._replace(improvement_percent=calm), rows[1]]
    assert "ITAE" in "\n".join(lines(["a", "b"], summaries, beside, 0))
    assert improvements(summaries, 1) == [None, None]
    *_, last = lines(["a", "b"], summaries, rows, 1)
    assert last.startswith("\nno improvement on b: ")


@pytest.mark.parametrize("baseline", [0, 1])
def test_improvement_counts_from_the_baseline(swing_record: Callable[..., Record], baseline: int) -> None:
    records = [swing_record(damping=damping) for damping in (0.1, 0.5)]
    summaries: list[Any] = [summarise(record) for record in records]
    percents: list[Any] = improvements(summaries, baseline)
    first, other = summaries[baseline].indices["ISE"], summaries[1 - baseline].indices["ISE"]
    assert percents[1 - baseline]["ISE"] == pytest.approx(100 * (first - other) / first)
    assert (percents[1 - baseline]["ISE"] > 0) == (baseline == 0)
    assert percents[baseline]["ISE"] == 0.0
    rows = [details(record)._replace(improvement_percent=part) for record, part in zip(records, percents, strict=True)]
    assert f"improvement on {'ab'[baseline]} [%]" in "\n".join(lines(["a", "b"], summaries, rows, baseline))


def test_text(swing_record: Callable[..., Record]) -> None:
    record = swing_record()
    record.delivered["arrival_ns"] = record.delivered["measured_ns"] + 80_000_000
    text = "\n".join(lines(["run"], [summarise(record)], [details(record)], 0))
    assert "frequency 0.5000 Hz ± " in text
    assert re.search(r"up, measured to arrived, G1 and 2 more +80\.00 +80\.00 +80\.00 +80\.00", text)
    assert "sssc 0.0 % of the frames" in text
    assert "improvement" not in text


def test_command_line_offers_every_method() -> None:
    for method in (AUTO, *METHODS, ambient.METHOD):
        assert parser().parse_args(["analyze", "recording", "--modes-method", method]).modes_method == method
