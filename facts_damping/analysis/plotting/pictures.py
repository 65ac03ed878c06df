"""Contents of the pictures of a record: panels and curves from its tables."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.analysis.histories import centres_of_angle, jacobian_histories, learning_rate_histories, mean_speeds
from facts_damping.analysis.indices import INDICES, index_curves, regions
from facts_damping.analysis.latency import HOPS, cdf, hops_ms
from facts_damping.analysis.measures import columns, device_limits, measure_weights, pmu_speeds, speed_differences
from facts_damping.analysis.modes.oscillation import is_stable
from facts_damping.analysis.supervision import on_ticks, strained, supervised
from facts_damping.monitor_table import STATES
from facts_damping.signals import CHANNELS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from facts_damping.analysis.indices import Regions
    from facts_damping.record import Record

SLIGHT, ROUND = 1e-6, 1e-7  # relative, absolute: smaller changes of a curve are round-off
MANY, LARGEST = 12, 7  # curves of a kind in one axes; of more, those with the largest change, or the means of areas
NEAR, MAX_SHOWN = 0.3, 3.0  # of its limit: a monitor is shown if it exceeded the first, drawn up to the second
POWER, VOLTAGE = (list(CHANNELS).index(name) for name in ("active_power", "voltage_magnitude"))


class Curve(NamedTuple):
    """A curve: abscissae (n,), None: the record's ticks; values (n,); whether drawn as steps."""

    values: NDArray[np.float64]
    x: NDArray[np.float64] | None = None
    steps: bool = False


class Panel(NamedTuple):
    """One axes, or one curve of shared axes: name and contents.

    `curves`: by name; usually a single one without a name. `dashed`: (ticks,); `limits`: horizontal lines; `regions`:
    of an index's curve.
    """

    name: str
    curves: dict[str, Curve]
    dashed: NDArray[np.float64] | None = None
    limits: tuple[float, ...] = ()
    regions: Regions | None = None


class Picture(NamedTuple):
    """A picture file: stem, title, label of the ordinate, panels of a record, whether they share axes, the abscissa.

    `words`: labels of ordinates 0, 1 and so on, if these are not numbers.
    """

    stem: str
    title: str
    label: str
    panels: Callable[[Record], list[Panel]]
    together: bool
    over: str = "t [s]"
    logarithmic: bool = False
    words: tuple[str, ...] = ()

    @property
    def over_time(self) -> bool:
        """Whether the abscissa is time."""
        return self.over == "t [s]"


def moves(picture: Picture, panel: Panel) -> bool:
    """Whether a panel shows any change beyond round-off; steps of a state, and a CDF, always count."""
    if picture.words or not picture.over_time:
        return True
    dashed = [] if panel.dashed is None else [panel.dashed]
    for values in [*(curve.values for curve in panel.curves.values()), *dashed]:
        known = values[np.isfinite(values)]
        minimum = 0.0 if picture.logarithmic else ROUND
        if len(known) and np.ptp(known) > max(SLIGHT * np.abs(known).max(), minimum):
            return True
    return False


def shown(picture: Picture, panels: Sequence[dict[str, Panel]]) -> list[str]:
    """Names of the panels of several records in which something changes in one of them.

    If a record has many curves in shared axes, only those with the largest changes in any of the records.
    """
    names = dict.fromkeys(name for by_name in panels for name in by_name)
    moving = [name for name in names if any(name in by_name and moves(picture, by_name[name]) for by_name in panels)]
    if not picture.together or len(moving) <= MANY:
        return moving

    def span(name: str) -> float:
        curves = [curve.values for by_name in panels if name in by_name for curve in by_name[name].curves.values()]
        return max(float(np.ptp(values[np.isfinite(values)])) for values in curves if np.isfinite(values).any())

    maximum = set(sorted(moving, key=lambda name: -span(name))[:LARGEST])
    return [name for name in moving if name in maximum]


def title_of(picture: Picture, panels: Sequence[dict[str, Panel]], names: Sequence[str]) -> str:
    """The title, with the number of curves if `names`, the ones shown, are not all."""
    there = {name for by_name in panels for name in by_name}
    cut = picture.together and len(names) == LARGEST and len(there) > MANY
    return f"{picture.title}: the {LARGEST} largest of {len(there)}" if cut else picture.title


def _speeds(record: Record) -> list[Panel]:
    """Speed of each machine; with many machines and several areas, the mean of each area by inertia."""
    speeds, machines = pmu_speeds(record), list(_pmus(record, machines=True))
    means = mean_speeds(record) if len(machines) > MANY else {}
    if len(means) > 1:
        return [_one(f"mean of {area}", 1e3 * values) for area, values in means.items()]
    return [_one(record.pmus[i], 1e3 * speeds[:, i]) for i in machines]


def _differences(record: Record) -> list[Panel]:
    if not measure_weights(record.configuration):
        return []
    return [_one(name, 1e3 * values) for name, values in speed_differences(record).items()]


def _at_buses(channel: int, record: Record) -> list[Panel]:
    return [_one(record.pmus[i], record.frames[:, i, channel]) for i in _pmus(record, machines=False)]


def _voltages(record: Record) -> list[Panel]:
    limits = {name: (-limit, limit) for name, limit in device_limits(record.configuration).items()}
    injected, reference = record.devices["injected_voltage"], record.devices["reference"]
    values = np.where(np.isfinite(injected), injected, reference)  # for other devices, the setpoint
    return [
        Panel(name, {"": Curve(values[:, i])}, record.devices["setpoint"][:, i], limits.get(name, ()))
        for i, name in enumerate(record.device_names)
    ]


def _device_states(record: Record) -> list[Panel]:
    values = record.devices["state"]
    return [_one(name, values[:, i]) for i, name in enumerate(record.device_names) if np.isfinite(values[:, i]).any()]


def _angles(record: Record) -> list[Panel]:
    return [_one(area, np.degrees(values)) for area, values in centres_of_angle(record).items()]


def _indices(record: Record) -> list[Panel]:
    """Curves of a run in synchronism; otherwise indices are meaningless."""
    if not measure_weights(record.configuration) or is_stable(record) is False:
        return []
    time, curves = index_curves(record.time_s, columns(speed_differences(record)))
    return [
        Panel(f"{name} [{INDICES[name].unit}]", {"": Curve(values, time)}, regions=regions(time, values))
        for name, values in curves.items()
    ]


def _jacobians(record: Record) -> list[Panel]:
    return [
        Panel(f"{controller}\nsignal {signal}, {device}", {"": Curve(history.values, history.time_s, steps=True)})
        for (controller, signal, device), history in jacobian_histories(record).items()
    ]


def _learning_rates(record: Record) -> list[Panel]:
    panels: dict[str, dict[str, Curve]] = {}
    for (controller, identifier, output, group), history in learning_rate_histories(record).items():
        name = f"{controller}{' identifier' * identifier}\noutput {output}"
        rates = np.where(history.values > 0, history.values, np.nan)  # 0 before the first step
        panels.setdefault(name, {})[f"group {group}" if group else ""] = Curve(rates, history.time_s, steps=True)
    return [Panel(name, curves) for name, curves in panels.items()]


def _latencies(record: Record) -> list[Panel]:
    panels: list[Panel] = []
    for hop, parts in hops_ms(record).items():
        curves = {}
        for name, values in parts.items():
            x, fraction = cdf(values)
            curves[name] = Curve(np.append(0.0, fraction), np.append(x[0], x), steps=True)
        delayed = any(curve.x is not None and np.any(curve.x > 0.0) for curve in curves.values())
        panels += [Panel(HOPS[hop], curves)] if delayed else []
    return panels


def _states(record: Record) -> list[Panel]:
    return [
        Panel(name, {"": Curve(on_ticks(record, rows, rows["state"]), steps=True)})
        for name, rows in supervised(record).items()
    ]


def _monitors(record: Record) -> list[Panel]:
    return [
        Panel(f"{name}\n{monitor}", {"": Curve(np.clip(values, 0.0, MAX_SHOWN))}, limits=(1.0,))
        for name, rows in supervised(record).items()
        for monitor, values in strained(record, rows, NEAR).items()
    ]


PICTURES = (
    Picture("speeds", "Speed deviation", "Δω [10⁻³ p.u.]", _speeds, together=True),
    Picture("differences", "Speed difference", "Δω [10⁻³ p.u.]", _differences, together=True),
    Picture("tie_power", "Active power", "P [p.u.]", partial(_at_buses, POWER), together=True),
    Picture("voltage", "Bus voltage", "V [p.u.]", partial(_at_buses, VOLTAGE), together=True),
    Picture("injected_voltage", "Injected voltage", "v [p.u.]", _voltages, together=False),
    Picture("device_state", "Charge, reactance or susceptance of devices", "[p.u.]", _device_states, together=False),
    Picture("centre_of_angle", "Centre of angle", "δ [°]", _angles, together=True),
    Picture("indices", "Performance indices", "", _indices, together=False),
    Picture("jacobian", "Identified Jacobian", "∂y/∂u [p.u./p.u.]", _jacobians, together=False),
    Picture("learning_rate", "Learning rate", "η", _learning_rates, together=False, logarithmic=True),
    Picture("supervision", "State of the supervisors", "state", _states, together=False, words=STATES),
    Picture("monitors", "Monitors beside their limits", "value / limit", _monitors, together=True),
    Picture("latency", "Latency by hop", "CDF", _latencies, together=False, over="latency [ms]"),
)


def _one(name: str, values: NDArray[np.float64]) -> Panel:
    return Panel(name, {"": Curve(values)})


def _pmus(record: Record, *, machines: bool) -> Iterator[int]:
    """Indices of the PMUs at machines, or of the others that measure a power and have no speed."""
    speeds = pmu_speeds(record)
    for index in range(len(record.pmus)):
        has_speed = bool(np.isfinite(speeds[:, index]).any())
        has_power = bool(np.isfinite(record.frames[:, index, POWER]).any())
        if has_speed if machines else has_power and not has_speed:
            yield index
