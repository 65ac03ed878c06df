"""Pictures of a small-signal analysis: the one-line diagram, mode shapes, transfer functions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from facts_damping.output.picture_files import save_picture
from facts_damping.small_signal.modal_tables import MAX_MACHINES, MAX_MODES, in_parallel, shown_modes
from facts_damping_studies.modes import one_line
from facts_damping_views.crowded import thin_out

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from facts_damping.small_signal.modal_tables import Modal

SHORT, APART = 0.15, 0.35  # of the longest arrow; rad: spacing of the labels of short arrows
BODE_HZ = (0.05, 5.0)


def plot(modal: Modal, folder: Path) -> list[Path]:
    """Draw one_line.png, mode_shapes.png, and with installed devices transfer_functions.png into a folder."""
    interarea = [mode for mode in modal.swings if mode.label == "interarea"] or shown_modes(modal)
    minimum = min(interarea, key=lambda mode: mode.damping_ratio, default=None)
    paths = [one_line.plot(modal.system, modal.built.flow, modal.devices, minimum, folder / "one_line.png")]
    if modal.swings:
        paths.append(_plot_shapes(modal, folder / "mode_shapes.png"))
    if modal.devices and modal.system.signals:
        paths.append(_plot_transfer(modal, folder / "transfer_functions.png"))
    return paths


def _plot_shapes(modal: Modal, path: Path) -> Path:
    """A compass of the machines' speeds for each electromechanical mode."""
    modes = shown_modes(modal)
    columns = min(3, len(modes))
    rows = -(-len(modes) // columns)
    figure = Figure(figsize=(3.6 * columns, 3.9 * rows), layout="constrained")
    texts = []
    for i, mode in enumerate(modes):
        axes = figure.add_subplot(rows, columns, i + 1, projection="polar")
        for value in mode.shape.values():
            axes.annotate(
                "", xy=(float(np.angle(value)), abs(value)), xytext=(0, 0), arrowprops={"arrowstyle": "->", "lw": 1.5}
            )
        places = _label_places(in_parallel(mode.shape, modal.system))
        look: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 8}
        texts += [axes.text(angle, radius, name, **look) for name, (angle, radius) in places.items()]
        axes.set_ylim(0, 1.15)
        axes.set_yticklabels([])
        axes.set_title(f"{mode.frequency_hz:.3f} Hz, damping {mode.damping_ratio:.3f}\n{mode.label}", fontsize=9)
    figure.suptitle(f"{modal.system.name}: mode shapes (speeds, relative to the fastest)", fontsize=10)
    if len(modal.swings) > MAX_MODES:  # the largest first
        for text in texts:
            text.set(va="bottom", bbox={"fc": "white", "ec": "none", "alpha": 0.7, "pad": 0.5})
        thin_out(figure, texts)
    return save_picture(figure, path, dpi=150)


def _label_places(shape: Mapping[str, complex]) -> dict[str, tuple[float, float]]:
    """Angle (rad) and radius of each label: at the tip of a long arrow; spread around the origin for short ones.

    If there are many machines, only those with the largest swing are labelled.
    """
    if len(shape) > MAX_MODES:
        far = [name for name in shape if abs(shape[name]) > APART]
        maximum = sorted(far, key=lambda name: -abs(shape[name]))[:MAX_MACHINES]
        return {name: (float(np.angle(shape[name])), 1.08 * abs(shape[name])) for name in maximum}
    places = {name: (float(np.angle(v)), 1.08 * abs(v)) for name, v in shape.items() if abs(v) > SHORT}
    before = -np.inf
    for angle, name in sorted((float(np.angle(v)), name) for name, v in shape.items() if abs(v) <= SHORT):
        before = max(angle, before + APART)
        places[name] = (before, 2 * SHORT)
    return places


def _plot_transfer(modal: Modal, path: Path) -> Path:
    """Magnitude and phase from each device's input to each signal."""
    frequency = np.geomspace(*BODE_HZ, 600)
    response = np.array([modal.model.response(2j * np.pi * f) for f in frequency])
    signals = list(modal.system.signals)
    figure = Figure(figsize=(4.5 * len(modal.devices), 6.5), layout="constrained")
    axes = figure.subplots(2, len(modal.devices), sharex=True, squeeze=False)
    for d, device in enumerate(modal.devices):
        for s in _clearest(modal, d):
            signal = signals[s]
            axes[0, d].loglog(frequency, np.abs(response[:, s, d]), label=signal)
            axes[1, d].semilogx(frequency, np.rad2deg(np.unwrap(np.angle(response[:, s, d]))))
        axes[0, d].set_title(f"from the setpoint of {device}", fontsize=9)
        axes[0, d].legend(fontsize=8)
        axes[1, d].set_xlabel("frequency [Hz]")
        for axis in axes[:, d]:
            axis.grid(visible=True, which="both", alpha=0.3)
    axes[0, 0].set_ylabel("magnitude [p.u./p.u.]")
    axes[1, 0].set_ylabel("phase [deg]")
    figure.suptitle(f"{modal.system.name}: transfer functions to the signals", fontsize=10)
    return save_picture(figure, path, dpi=150)


def _clearest(modal: Modal, device: int) -> list[int]:
    """The signals drawn for a device: all, or if there are many, those with the largest residues in any mode."""
    signals = list(modal.system.signals)
    if len(signals) <= MAX_MACHINES:
        return list(range(len(signals)))
    size = dict.fromkeys(signals, 0.0)
    for residue in (r for mode in shown_modes(modal) for r in mode.residues if r.device == modal.devices[device]):
        size[residue.signal] = max(size[residue.signal], residue.magnitude)
    return sorted(signals.index(name) for name in sorted(signals, key=lambda name: -size[name])[:MAX_MACHINES])
