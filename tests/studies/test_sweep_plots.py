"""Pictures of sweeps: lost runs count as the worst, a curve is one setting, axes are in words."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from facts_damping_studies.sweeps.column_names import axis_label, value_label
from facts_damping_studies.sweeps.sweep_plots import LOST_RUNS, plot_curves, settings
from facts_damping_studies.sweeps.sweep_rows import SweepRow, figure_names


def row(delay: float, jitter: float, seed: int, itae: float | None) -> SweepRow:
    """A row of a sweep; without ITAE synchronism is lost."""
    columns: dict[str, Any] = {
        "system": "two_area",
        "scenario": "large",
        "controller": "LLC",
        "scheme": None,
        "link": "custom",
    }
    columns |= {"delay_s": delay, "jitter_s": jitter, "seed": seed}
    cells = {**columns, "horizon_s": 30.0, **dict.fromkeys(figure_names(modes=False)), "error": None}
    return SweepRow.read(cells | {"stable": itae is not None, "ITAE": itae})


ROWS = [row(delay, jitter, seed, None if delay * seed > 0.5 else 1.0 + delay + jitter)
        for delay in (0.0, 0.1, 0.2, 0.3) for jitter in (0.0, 0.05, 0.1) for seed in (1, 2, 3)]  # fmt: skip


def test_curve_is_one_setting_and_lost_runs_are_the_worst() -> None:
    """At 0.2 s one of three runs is lost, at 0.3 s two: an open circle, then a gap; survivors alone have no median."""
    figure = plot_curves(ROWS, "delay_s", ["delay_s", "jitter_s", "seed"], ["delay_s", "jitter_s"])
    assert figure is not None
    panels = figure.axes
    assert [panel.get_title() for panel in panels] == [
        "large, jitter 0 s",
        "large, jitter 0.05 s",
        "large, jitter 0.1 s",
    ]
    for panel, jitter in zip(panels, (0.0, 0.05, 0.1), strict=True):
        median: Any = panel.lines[0].get_ydata()
        np.testing.assert_allclose(median, np.array([1.0, 1.1, 1.2, np.nan]) + jitter)
        assert [text.get_text() for text in panel.texts] == ["1/3"]
        assert panel.get_xlabel() == "delay [s]"
    assert figure.get_suptitle() == LOST_RUNS


def test_of_an_axis_with_many_values_a_few_are_shown() -> None:
    rows = [row(0.0, jitter / 100, 1, 1.0) for jitter in range(20)]
    by_setting = settings(rows, ["delay_s", "jitter_s"], "delay_s")
    assert len(by_setting) == 5
    assert [next(iter(by_setting)), list(by_setting)[-1]] == ["large, jitter 0 s", "large, jitter 0.19 s"]
    assert settings(rows, ["jitter_s"], "jitter_s") == {"large": rows}


@pytest.mark.parametrize(
    ("name", "label", "value"),
    [
        ("delay_s", "delay [s]", "delay 2 s"),
        ("link.up.0.delay", "delay [s]", "delay 2 s"),
        ("controllers.0.parameters.gain", "gain", "gain 2"),
        ("tie_mw", "tie [MW]", "tie 2 MW"),
        ("response_time", "response time [s]", "response time 2 s"),
    ],
)
def test_columns_are_named_in_words_with_their_unit(name: str, label: str, value: str) -> None:
    assert (axis_label(name), value_label(name, 2)) == (label, value)
