"""Recorded and replayed setpoints compared: table and picture."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure

from facts_damping.analysis.plotting.plots import COLOURS, DPI, MARGIN, PANEL_HEIGHT, WIDTH
from facts_damping.output import picture_files, tables

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

LINES = {
    "rms_recorded_pu": "rms recorded [p.u.]",
    "rms_replayed_pu": "rms replayed [p.u.]",
    "rms_difference_pu": "rms of the difference [p.u.]",
    "max_difference_pu": "largest difference [p.u.]",
    "correlation": "correlation",
    "saturated_recorded": "at the limit, recorded [fraction]",
    "saturated_replayed": "at the limit, replayed [fraction]",
}


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Text table of the figures of each device (`replay.beside`), one column per device."""
    cells = [[text, *("-" if row[key] is None else f"{row[key]:.4g}" for row in rows)] for key, text in LINES.items()]
    return "\n".join(tables.table(["", *(row["device"] for row in rows)], cells, rule=False))


def plot(
    time_s: NDArray[Any],
    pairs: dict[str, tuple[NDArray[Any], NDArray[Any]]],
    limits: dict[str, float],
    labels: tuple[str, str],
    path: Path,
) -> Path:
    """Setpoints of each device as recorded and as replayed, p.u., with limits and their difference; a PNG file."""
    figure = Figure(figsize=(WIDTH, MARGIN + 2 * PANEL_HEIGHT * max(len(pairs), 1)), layout="constrained")
    grid = figure.subplots(2 * len(pairs), 1, sharex=True, squeeze=False)[:, 0]
    for row, (device, (recorded, other)) in enumerate(pairs.items()):
        both, apart = grid[2 * row], grid[2 * row + 1]
        both.step(time_s, recorded, where="post", color=COLOURS[0], linewidth=1.2, label=f"recorded: {labels[0]}")
        both.step(time_s, other, where="post", color=COLOURS[1], linewidth=1.0, label=f"replayed: {labels[1]}")
        for limit in (-limits[device], limits[device]):
            both.axhline(limit, color="#B00020", linewidth=0.8, linestyle=":")
        apart.step(time_s, other - recorded, where="post", color=COLOURS[2], linewidth=1.0)
        both.set_ylabel(f"{device}\nsetpoint [p.u.]")
        apart.set_ylabel("replayed - recorded\n[p.u.]")
        for axes in (both, apart):
            axes.grid(visible=True, color="0.92")
            axes.spines[["top", "right"]].set_visible(False)
    grid[-1].set_xlabel("t [s]")
    handles, names = grid[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper right", ncols=2, fontsize="small", frameon=False)
    return picture_files.save_picture(figure, path, dpi=DPI)
