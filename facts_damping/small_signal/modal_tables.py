"""Small-signal analysis of a system at its start: tables and JSON."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.output.tables import table
from facts_damping.plant.build import Built, build
from facts_damping.small_signal import eigenmodes, linearisation
from facts_damping.small_signal.descriptor import NEAREST, SHIFTS_HZ, is_partial
from facts_damping.small_signal.residues import FREQUENCIES_HZ, Interaction, interactions

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from facts_damping.parameters.plant.system import System

SHOWN_STATES = 4
# Limits for large systems: modes in a picture, machines per side and residues per mode in a table.
MAX_MODES, MAX_MACHINES, MAX_RESIDUES = 12, 8, 12
MAX_LISTED, WELL_DAMPED = 60, 0.3  # largest number of modes in a table; beyond it, only those up to this damping ratio
STILL, ALIKE = 1e-4, 0.01  # 1/s: an eigenvalue of zero; of the fastest machine's speed: machines that move alike
BAND_HZ = (0.1, 2.5)  # band of modes in the picture of a large system: electromechanical swings


class Modal(NamedTuple):
    """A system at its start with installed devices: the plant, its linear model and its modes."""

    system: System
    devices: list[str]
    built: Built
    model: linearisation.LinearModel
    modes: list[eigenmodes.Eigenmode]
    interactions: list[Interaction]

    def __repr__(self) -> str:
        """The electromechanical modes in one line."""
        shown = ", ".join(f"{mode.frequency_hz:.2f} Hz {100 * mode.damping_ratio:.1f} %" for mode in self.swings)
        return f"<Modal {self.system.name} with {', '.join(self.devices) or 'no device'}: {shown}>"

    def _repr_html_(self) -> str:
        """All modes, for a notebook."""
        return "<pre>" + "\n".join(modes_text(self)) + "</pre>"

    @property
    def swings(self) -> list[eigenmodes.Eigenmode]:
        """The electromechanical modes."""
        return [mode for mode in self.modes if mode.swings]


def analyse(system: System, devices: Sequence[str]) -> Modal:
    """Power flow, equilibrium, linear model and modes."""
    built = build(system, devices, [])
    model = linearisation.linear_model(built, system.signals, [s.name for s in system.pmus])
    modes = eigenmodes.modes(model.matrix, built.state_names, system, model, devices)
    return Modal(system, list(devices), built, model, modes, interactions(built, system, devices))


def document(modal: Modal) -> dict[str, Any]:
    """The JSON of `modes` (docs/results_json.md)."""
    return {
        "power_flow": {"buses": modal.built.flow.buses(modal.system.base_power)},
        "devices": modal.devices,
        "modes": [_mode(mode) for mode in modal.modes],
        "transfer_functions": [
            {**t._asdict(), "zeros": [_pair(z) for z in t.zeros], "poles": [_pair(p) for p in t.poles]}
            for t in linearisation.transfer_functions(modal.model, list(modal.system.signals), modal.devices)
        ],
        "relative_gains": [
            {
                "signals": list(pair.signals),
                "frequency_hz": pair.frequency_hz,
                "relative_gain": _pair(pair.relative[0, 0]),
                "condition": pair.condition,
            }
            for pair in modal.interactions
        ],
    }


def _pair(value: complex) -> list[float]:
    return [float(value.real), float(value.imag)]


def figures(mode: eigenmodes.Eigenmode) -> dict[str, Any]:
    """A mode's eigenvalue, frequency, damping ratio and kind, for JSON."""
    return {
        "real": mode.eigenvalue.real,
        "imag": mode.eigenvalue.imag,
        "frequency_hz": mode.frequency_hz,
        "damping_ratio": mode.damping_ratio,
        "label": mode.label,
    }


def _mode(mode: eigenmodes.Eigenmode) -> dict[str, Any]:
    return {
        **figures(mode),
        "participation": mode.participation,
        "shape": {
            name: {"magnitude": abs(value), "angle_deg": float(np.rad2deg(np.angle(value)))}
            for name, value in mode.shape.items()
        },
        "residues": [residue._asdict() for residue in mode.residues],
    }


def modes_text(modal: Modal) -> Iterator[str]:
    """Lines for the terminal."""
    system = modal.system
    yield f"{system.name}: {system.description}"
    there = ", ".join(device.name for device in system.devices)
    none = f"none (--devices installs them: {there})" if there else "none"
    yield f"devices installed: {', '.join(modal.devices) or none}\n"
    yield "bus            V p.u.  angle deg       P MW     Q Mvar"
    for bus in modal.built.flow.buses(system.base_power):
        yield "{name:<12} {v_pu:8.4f} {angle_deg:10.3f} {p_mw:10.2f} {q_mvar:10.2f}".format(**bus)
    if is_partial(modal.model.matrix):
        first, last = SHIFTS_HZ[[0, -1]]
        points = f"{len(SHIFTS_HZ)} points on the imaginary axis, {first} to {last} Hz"
        yield f"\nonly up to {NEAREST} modes nearest each of {points}"
    yield "\n     real 1/s   imag rad/s         Hz  damping ratio  kind               participation"
    large = len(modal.modes) > MAX_LISTED
    shown = [mode for mode in modal.modes if not large or mode.damping_ratio <= WELL_DAMPED]
    for mode in shown:
        states = ", ".join(f"{name} {value:.2f}" for name, value in _participation(mode, modal.system)[:SHOWN_STATES])
        ratio = "-" if abs(mode.eigenvalue) < STILL else f"{mode.damping_ratio:.4f}"
        yield (
            f"{mode.eigenvalue.real:13.5f} {mode.eigenvalue.imag:12.5f} {mode.frequency_hz:10.4f} "
            f"{ratio:>14}  {mode.label:<17}  {states}"
        )
    if len(shown) < len(modal.modes):
        yield f"and {len(modal.modes) - len(shown)} with a damping ratio above {WELL_DAMPED:g}, all in --json"
    units = "machines and inverters" if any(i.forming for i in system.inverters) else "machines"
    for mode in shown_modes(modal):
        yield f"\n{mode.frequency_hz:.4f} Hz, {mode.label}: {units} that swing against each other"
        ranked = sorted(in_parallel(mode.shape, modal.system).items(), key=lambda item: -abs(item[1]))
        halves = [[item for item in ranked if (item[1].real >= 0) == in_phase] for in_phase in (True, False)]
        for group in filter(None, halves):
            more = f", and {len(group) - MAX_MACHINES} that swing less" if len(group) > MAX_MACHINES else ""
            yield "  " + ", ".join(f"{name} {abs(value):.2f}" for name, value in group[:MAX_MACHINES]) + more
        if mode.residues:
            yield "  device       signal       residue 1/s  angle deg   u = K y: sign  lead deg"
        residues = mode.residues
        if len(residues) > MAX_RESIDUES:
            residues = sorted(residues, key=lambda residue: -residue.magnitude)[:MAX_RESIDUES]
        for r in residues:
            yield (
                f"  {r.device:<12} {r.signal:<10} {r.magnitude:13.5g} {r.angle_deg:10.1f} "
                f"{'+' if r.sign > 0 else '-':>15} {r.lead_deg:9.1f}"
            )
    yield from _interactions_text(modal)


def together(names: Sequence[str]) -> str:
    """A label of units at one bus: their name, or what their names begin with and their number, `G6100 x3`."""
    stem = names[0].rpartition("_")[0]
    alike = stem and all(name.startswith(f"{stem}_") for name in names)
    return names[0] if len(names) == 1 else f"{stem if alike else names[0]} x{len(names)}"


def in_parallel(shape: Mapping[str, complex], system: System) -> dict[str, complex]:
    """A mode shape in which the machines and inverters of a bus are one, by its label, if they move alike."""
    merged = dict(shape)
    at: dict[str, list[str]] = {}
    for unit in (unit for unit in system.units if unit.name in shape):
        at.setdefault(unit.bus, []).append(unit.name)
    for names in at.values():
        label, value = together(names), shape[names[0]]
        if label not in merged and all(abs(shape[name] - value) < ALIKE for name in names):
            merged = {name: merged[name] for name in merged if name not in names} | {label: value}
    return merged


def _participation(mode: eigenmodes.Eigenmode, system: System) -> list[tuple[str, float]]:
    """Participations, the largest first, in which the like states of machines, or of inverters, at one bus are one."""
    buses, groups = {unit.name: unit.bus for unit in system.units}, dict[tuple[str, str], list[str]]()
    for state in mode.participation:
        owner, _, rest = state.partition(".")
        groups.setdefault((buses.get(owner, owner), rest), []).append(owner)
    return sorted(
        (
            (f"{together(owners)}.{rest}", sum(mode.participation[f"{owner}.{rest}"] for owner in owners))
            for (_, rest), owners in groups.items()
        ),
        key=lambda item: -item[1],
    )


def shown_modes(modal: Modal) -> list[eigenmodes.Eigenmode]:
    """The modes with drawn shapes: all, or for a large system the least damped ones in the band."""
    if len(modal.swings) <= MAX_MODES:
        return modal.swings
    low, high = BAND_HZ
    in_band = [mode for mode in modal.swings if low <= mode.frequency_hz <= high] or modal.swings
    return sorted(in_band, key=lambda mode: mode.damping_ratio)[:MAX_MODES]


def _interactions_text(modal: Modal) -> Iterator[str]:
    """Relative gains for each pair of signals, and the condition of their gains at the mode."""
    if not modal.interactions:
        return
    at = modal.interactions[0].frequency_hz
    yield f"\nrelative gain from {modal.devices[0]} to the first of two signals; at {at:.4f} Hz largest gain / smallest"
    rows: dict[tuple[str, str], list[str]] = {}
    for pair in modal.interactions:
        value = pair.relative[0, 0]
        shown = f"{pair.condition:.3g}" if pair.frequency_hz == at else f"{value.real:.2f}{value.imag:+.2f}j"
        rows.setdefault(pair.signals, [", ".join(pair.signals)]).append(shown)
    titles = ["signals", f"{at:.4f} Hz", *(f"{hertz:g} Hz" for hertz in FREQUENCIES_HZ)]
    whole = [row for row in rows.values() if len(row) == len(titles)]
    yield from ("  " + line for line in table(titles, whole, rule=False))
