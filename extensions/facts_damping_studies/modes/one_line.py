"""One-line diagram of a system: flows, machines and inverters by area, a mode, devices, PMUs, control loops."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from facts_damping.devices.base import Series, Transmission
from facts_damping.devices.table import KINDS
from facts_damping.output.picture_files import save_picture
from facts_damping.plant.converters.dispatch import losses_of
from facts_damping.plant.grid.network import Topology, at_rest, branches, device_section
from facts_damping.small_signal.modal_tables import together
from facts_damping_views.bus_places import places
from facts_damping_views.crowded import thin_out

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from matplotlib.axes import Axes

    from facts_damping.compiling.structs import Float1
    from facts_damping.parameters.plant.system import Device, System
    from facts_damping.plant.grid.power_flow import PowerFlow
    from facts_damping.small_signal.eigenmodes import Eigenmode
    from facts_damping_views.bus_places import Places

NAMED = 40  # buses, up to which all are labelled
LABELS = 12  # number of labelled flows, the largest
WIDEST, THINNEST = 5.0, 0.6  # points, widths of branches
ARROW = 0.16  # length of the fastest machine's arrow, relative to the picture
SMALL = 0.1  # of the fastest machine's speed: below it no arrow is drawn
APART = 0.06  # least distance of a flow's label from others and from machines, relative to the picture
LINK: dict[str, Any] = {"color": "#CC79A7", "ls": "--", "lw": 1.5}
LOOPS = (":", "--", "-.", (0, (1, 4)))  # dashes of loops; colours show areas
AREAS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#8C564B", "#000000")


class Loop(NamedTuple):
    """The path of a control loop: from the PMUs of its signals to its devices, by name."""

    name: str  # for the legend
    pmus: list[str]
    devices: list[str]


def flows(system: System, flow: PowerFlow, installed: Sequence[str] = ()) -> list[tuple[str, str, float]]:
    """Each branch with its buses in the direction of its active power, and the power at the sending end, MW."""
    voltage = dict(zip(flow.names, flow.voltage, strict=True))
    devices = [d for d in system.devices if isinstance(d, Series)]
    lost = {d.name: losses_of(d, flow.currents[d.name]) if d.name in installed else 0.0 for d in devices}
    series = [device_section(d, complex(at_rest(d, lost[d.name]))) for d in devices]
    powers = []
    for branch in [*branches(system, Topology()), *series]:
        ends = np.array([voltage[branch.from_bus], voltage[branch.to_bus]])
        entering = (ends * np.conj(branch.admittance @ ends)).real * system.base_power
        forward = entering[0] >= entering[1]
        buses = (branch.from_bus, branch.to_bus) if forward else (branch.to_bus, branch.from_bus)
        powers.append((*buses, float(entering.max())))
    return powers


def plot(
    system: System,
    flow: PowerFlow,
    installed: Sequence[str],
    mode: Eigenmode | None,
    path: Path,
    loops: Sequence[Loop] = (),
) -> Path:
    """Draw the diagram; `mode`: the mode shown by arrows at the machines and grid-forming inverters."""
    at = places(system)
    where = {name: at[bus] for name, bus in system.pmu_buses().items()}  # of the PMUs
    width, height = np.ptp(np.array(list(at.values())), axis=0)
    figure = Figure(figsize=(10.0, 11.0) if height > 1.3 * width else (12.0, 9.0), layout="constrained")
    axes = figure.add_subplot()
    _branches(axes, at, flows(system, flow, installed), [at[unit.bus] for unit in system.units])
    _buses(axes, system, at)
    named, labels = _units(axes, system, at)
    if mode is not None:
        _arrows(axes, system, at, mode)
    marks = [
        *named,
        *_devices(axes, system, installed, at),
    ]
    for place in where.values():
        axes.annotate("▲", tuple(place), (-9, 4), textcoords="offset points", fontsize=6, color="#D55E00", zorder=6)
    marks += [_mark("^", "#D55E00", "PMU")] if where else []
    marks += _loops(axes, system, loops, where, at)
    figure.legend(handles=marks, loc="outside right center", fontsize=9, frameon=False)
    axes.set_aspect("equal")
    axes.margins(0.08)
    axes.set_axis_off()
    title = "flows [MW]"
    if mode is not None:
        ratio = round(mode.damping_ratio, 3) + 0.0  # no -0.000
        title += f"; arrows: speeds in the mode of {mode.frequency_hz:.3f} Hz, damping ratio {ratio:.3f}"
    figure.suptitle(f"{system.name}: {title}", fontsize=11)
    if len(system.buses) > NAMED:  # labels of the largest first
        ratings = {unit.bus: unit.rating for unit in sorted(system.units, key=lambda unit: unit.rating)}
        thin_out(figure, [label for _, label in sorted(labels, key=lambda pair: -ratings[pair[0]])])
    return save_picture(figure, path, dpi=130)


def _branches(axes: Axes, at: Places, power_flows: list[tuple[str, str, float]], occupied: list[Float1]) -> None:
    """Draw branches with a width by power and an arrow in its direction; the largest are labelled where there is room.

    `occupied`: places of machines and inverters.
    """
    maximum = max((power for *_, power in power_flows), default=1.0) or 1.0
    room, crowded = LABELS, len(at) > NAMED
    near = APART * np.ptp(np.array(list(at.values())), axis=0).max()
    for a, b, power in sorted(power_flows, key=lambda flow: -flow[2]):
        start, end = at[a], at[b]
        width = THINNEST + (WIDEST - THINNEST) * power / maximum
        axes.plot(*np.transpose([start, end]), color="0.75", lw=width, zorder=1, solid_capstyle="round")
        middle, onward = start + 0.5 * (end - start), start + 0.54 * (end - start)
        tip = {"arrowstyle": "-|>", "color": "0.4", "mutation_scale": 6.0 + width}
        axes.annotate("", xy=tuple(onward), xytext=tuple(middle), arrowprops=tip, zorder=2)
        free = not crowded or all(np.hypot(*(middle - other)) > near for other in occupied)
        if room and power > 0.0 and free:
            room, occupied = room - 1, [*occupied, middle]
            axes.annotate(f"{power:.0f}", tuple(middle), fontsize=7, ha="center", va="bottom", zorder=6)


def _buses(axes: Axes, system: System, at: Places) -> None:
    """Draw dots, with names of all buses in a small system, else only of those with machines."""
    axes.plot(*np.transpose([at[bus.name] for bus in system.buses]), "o", color="0.35", ms=3, zorder=3)
    if len(system.buses) <= NAMED:
        for bus in system.buses:
            axes.annotate(bus.name, tuple(at[bus.name]), (3, 4), textcoords="offset points", fontsize=7, color="0.35")


def _units(axes: Axes, system: System, at: Places) -> tuple[list[Any], list[tuple[str, Any]]]:
    """Draw machines as circles, inverters as squares in the colour of the area; return legend handles, names by bus."""
    labels: list[tuple[str, Any]] = []
    areas = list(dict.fromkeys(unit.area or "" for unit in system.units))
    many = colormaps["turbo"](np.linspace(0.0, 1.0, len(areas))).tolist()
    colours = dict(zip(areas, AREAS if len(areas) <= len(AREAS) else many, strict=False))
    for units, marker, below in ((system.machines, "o", -9), (system.inverters, "s", -18)):
        for bus in dict.fromkeys(unit.bus for unit in units):
            here = [unit for unit in units if unit.bus == bus]
            size = 9 if marker == "o" else 13  # around the circle of a machine at the same bus
            look: dict[str, Any] = {"ms": size, "mec": colours[here[0].area or ""], "mew": 2.0, "zorder": 4}
            axes.plot(*at[bus], marker, mfc="white" if marker == "o" else "none", **look)
            label = together([unit.name for unit in here])
            look = {"textcoords": "offset points", "fontsize": 7, "zorder": 6}
            labels.append((bus, axes.annotate(label, tuple(at[bus]), (6, below), **look)))
    for row in system.infinite_buses:
        axes.plot(*at[row.bus], "o", ms=11, color="black", zorder=4)
    of_machines = {m.area or "" for m in system.machines}
    marks = [_mark("o", colours[a], a or "machines", mfc="white", mew=2.0) for a in areas if a in of_machines]
    if system.inverters:
        marks.append(_mark("s", "0.35", "inverters", mfc="white", mew=2.0))
    return [*marks, *([_mark("o", "black", "infinite bus")] if system.infinite_buses else [])], labels


def _arrows(axes: Axes, system: System, at: Places, mode: Eigenmode) -> None:
    """Draw speeds of machines and grid-forming inverters in a mode as arrows, as in the compass plot."""
    extent = np.ptp(np.array(list(at.values())), axis=0).max()
    for unit in system.units:
        value = mode.shape.get(unit.name, 0j)
        if abs(value) < SMALL:
            continue
        tip = at[unit.bus] + ARROW * extent * np.array([value.real, value.imag])
        look = {"arrowstyle": "->", "color": "black", "lw": 1.4}
        axes.annotate("", xy=tuple(tip), xytext=tuple(at[unit.bus]), arrowprops=look, zorder=5, annotation_clip=False)
        axes.plot(*tip, alpha=0.0)  # extends the axes to include the arrow


def _place(system: System, device: Device, at: Places) -> Float1:
    """Position of a device: between its buses, or at its single bus."""
    return np.asarray(np.mean([at[bus] for bus in system.buses_of(device)], axis=0))


def _devices(axes: Axes, system: System, installed: Sequence[str], at: Places) -> list[Any]:
    """Draw series devices between their buses, links as lines, others at their bus; installed ones are filled."""
    marks = []
    for d in system.devices:
        there = d.permanent or d.name in installed
        label = f"{d.name} ({d.kind}{'' if there else ', not installed'})"
        if isinstance(d, Transmission):
            axes.plot(*np.transpose([at[bus] for bus in d.buses]), **LINK, zorder=2)
            marks.append(Line2D([], [], label=label, **LINK))
            continue
        marker = KINDS[d.kind].shown.marker
        look: dict[str, Any] = {"mfc": "#F0E442" if there else "white", "ms": 12 if marker == "*" else 10}
        axes.plot(*_place(system, d, at), marker, mec="black", zorder=5, **look)
        marks.append(_mark(marker, "black", label, **look))
    return marks


def _loops(axes: Axes, system: System, loops: Sequence[Loop], where: Places, at: Places) -> list[Any]:
    """Draw each loop as dashed lines from its PMUs to its devices."""
    marks = []
    for i, loop in enumerate(loops):
        look: dict[str, Any] = {"color": "black", "ls": LOOPS[i % len(LOOPS)], "lw": 0.9}
        for device in loop.devices:
            end = _place(system, system.device(device), at)
            for pmu in loop.pmus:
                axes.plot(*np.transpose([where[pmu], end]), alpha=0.6, zorder=2, **look)
        marks.append(Line2D([], [], label=loop.name, **look))
    return marks


def _mark(shape: str, colour: str, name: str, **more: Any) -> Line2D:
    return Line2D([], [], ls="", marker=shape, mec=colour, label=name, **{"mfc": colour, "ms": 8, **more})
