"""Where the one-line diagram has its buses: at their positions, if they have one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from facts_damping.parameters.plant.placement import place
from facts_damping.small_signal.modal_tables import analyse
from facts_damping_studies.modes import one_line
from facts_damping_views.bus_places import places
from facts_damping_views.crowded import thin_out
from tests.plant.running import changed, shipped
from tests.two_plants import path

if TYPE_CHECKING:
    from pathlib import Path


def test_buses_stand_at_their_positions_within_a_unit_square() -> None:
    system = shipped("wscc_9")
    positions = {bus.name: [7.0 + 3.0 * i, -2.0 * i] for i, bus in enumerate(system.buses)}
    placed = places(changed(system, buses=[{**b.model_dump(), "position": positions[b.name]} for b in system.buses]))
    assert placed["B1"] == pytest.approx([-1.0, 2.0 / 3.0])
    assert placed["B9"] == pytest.approx([1.0, -2.0 / 3.0])
    assert np.diff(np.array(list(placed.values())), axis=0) == pytest.approx(np.tile([0.25, -1.0 / 6.0], (8, 1)))


def test_bus_of_a_device_in_a_line_stands_in_that_line() -> None:
    system = shipped("wscc_9")
    rows = [{**b.model_dump(), "position": [float(i), 2.0]} for i, b in enumerate(system.buses)]
    line = system.lines[0]
    device = {"name": "sssc", "kind": "sssc", "line": line.name, "end": "to"}
    placed = place(changed(system, buses=rows, devices=[device]))
    at = {bus.name: bus.position for bus in placed.buses}
    near, far, made_at = at[line.to_bus], at[line.from_bus], at[f"{line.name}.sssc"]
    assert near
    assert far
    assert made_at == pytest.approx([near[0] + 0.15 * (far[0] - near[0]), 2.0])


def test_without_all_positions_they_follow_from_reactances() -> None:
    system = shipped("wscc_9")
    rows = [{**b.model_dump(), "position": [0.0, 0.0] if b.name == "B1" else None} for b in system.buses]
    plain, partly = places(system), places(changed(system, buses=rows))
    assert all((plain[name] == partly[name]).all() for name in plain)


@pytest.mark.parametrize(("name", "arrows"), [("solar", 2), ("battery", 3)])
def test_inverters_are_drawn_with_what_acts_on_them(
    name: str, arrows: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A square and a name at the bus; a star for the input; an arrow where it forms the grid."""
    figures: list[Any] = []
    monkeypatch.setattr(one_line, "save_picture", lambda figure, *_, **__: figures.append(figure))
    modal = analyse(shipped(path(name)), ["pod_p"])
    one_line.plot(modal.system, modal.built.flow, ["pod_p"], modal.swings[0], tmp_path / "one_line.png")
    (axes,) = figures[0].axes
    at = places(modal.system)["B3"]
    markers = {str(line.get_marker()) for line in axes.lines if np.allclose(line.get_xydata(), [at])}
    assert {"s", "*"} <= markers
    texts = [text for text in axes.texts if text.get_text() == modal.system.inverters[0].name]
    assert len(texts) == 1
    assert np.allclose(texts[0].xy, at)
    drawn = [text for text in axes.texts if text.arrow_patch is not None and text.arrow_patch.get_linewidth() == 1.4]
    assert len(drawn) == arrows
    assert "inverters" in [text.get_text() for text in figures[0].legends[0].texts]


def test_of_labels_that_cover_each_other_the_first_stays() -> None:
    figure = Figure(figsize=(4.0, 4.0))
    axes = figure.add_subplot()
    texts = [axes.text(x, 0.5, "a long label") for x in (0.1, 0.15, 0.7)]
    thin_out(figure, texts)
    assert [text.get_visible() for text in texts] == [True, False, True]
