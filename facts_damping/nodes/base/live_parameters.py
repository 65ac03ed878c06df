"""Parameters that can be changed during a run: of controllers, identifiers, links and PMUs."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from rcl_interfaces.msg import SetParametersResult

from facts_damping.case.controllers import check_parameter, sizes
from facts_damping.case.links import with_number
from facts_damping.case.measurement import numbers
from facts_damping.case.measurement import with_number as with_measured
from facts_damping.control.bank import put
from facts_damping.control.table import kind_of
from facts_damping.errors import InputError
from facts_damping.nodes.base.parameters import declare, descriptor, field_descriptor, plain

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray
    from rclpy.node import Node
    from rclpy.parameter import Parameter

    from facts_damping.parameters.link import Link
    from facts_damping.parameters.measurement import Measurement
    from facts_damping.parameters.run import Controller

FIXED = ("window", "start", "duration")  # fields of a link's stage that cannot be changed during a run
FREE = "numbers of its stages; another link only by the service ~/apply"


def declare_settings(
    node: Node,
    controller: Controller,
    names: list[str],
    rows: NDArray[Any],
    swing: NDArray[np.float64],
    change: Callable[..., None],
) -> None:
    """Declare parameters of a controller or its identifier; changes of live ones go into `rows` (SETTINGS).

    `swing`: mode shape of the signals (control/bank.py); `change`: queues a change for the next tick (member.py).
    Raises `InputError` for a value that is not allowed, or if a parameter that is not live differs from the run's
    value, as other nodes would not know of it.
    """
    table = kind_of(controller).parameters
    counts = sizes(controller)
    for name in names:
        p = table[name]
        text = f"{p.description}: {', '.join(p.choices)}" if p.choices else p.description
        low, high = (None, None) if p.choices else (p.low, p.high)
        wanted = controller.parameters[name]
        now = declare(node, name, wanted, descriptor(text, p.unit, low, high, not p.live))
        if now != wanted and not p.live:
            raise InputError(f"{name}: {now} given; allowed: the run's {wanted}, or set: controllers.<i>.parameters")
        check_parameter(name, name, now, table, counts)
        put(rows, name, p, now, swing)
        if now != wanted:
            change("parameter", name, now)

    def check(changed: list[tuple[str, Any]]) -> None:
        for name, value in changed:
            check_parameter(name, name, value, table, counts)

    def apply(name: str, value: Any) -> None:
        change("parameter", name, value, partial(_put, rows, name, table[name], value, swing))

    _on_set(node, names, check, apply)


def _on_set(
    node: Node, names: list[str], check: Callable[[list[tuple[str, Any]]], None], apply: Callable[[str, Any], None]
) -> None:
    """Apply changes of the parameters `names` if `check`, which gets all of them, raises no `InputError`."""

    def changed(parameters: list[Parameter[Any]]) -> SetParametersResult:
        rows = [(parameter.name, plain(parameter.value)) for parameter in parameters if parameter.name in names]
        try:
            check(rows)
        except InputError as error:
            return SetParametersResult(successful=False, reason=str(error))
        for name, value in rows:
            apply(name, value)
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(changed)


def _put(rows: NDArray[Any], name: str, parameter: Any, value: Any, swing: NDArray[np.float64], _tick: int) -> None:
    put(rows, name, parameter, value, swing)


class StageParameters:
    """Numbers of a link's stages as node parameters, such as `up.0.delay`.

    Those in `FIXED` (replay window, start time, duration) cannot be changed during a run; the others can.
    """

    def __init__(self, node: Node, link: Link, change: Callable[[str, float], None]) -> None:
        """Declare the parameters. `change(name, value)` is called for each value that differs from the link's."""
        self._node, self._change = node, change
        self._names: list[str] = []
        self._declare(link)
        _on_set(node, self._names, self._check, change)

    def replace(self, link: Link) -> None:
        """Declare the parameters of another link in place of those of the former link."""
        for name in self._names:
            self._node.undeclare_parameter(name)
        self._names.clear()
        self._declare(link, ignore_given=True)

    def _declare(self, link: Link, ignore_given: bool = False) -> None:
        self._link = link
        for way in ("up", "down"):
            for i, stage in enumerate(getattr(link, way)):
                for field, value in stage.model_dump().items():
                    if isinstance(value, float):
                        name, wanted = f"{way}.{i}.{field}", field_descriptor(type(stage).model_fields[field], False)
                        if ignore_given:
                            self._node.declare_parameter(name, value, wanted, ignore_override=True)
                        elif (declared := declare(self._node, name, value, wanted)) != value:
                            _, _, self._link = with_number(self._link, name, declared)
                            self._change(name, declared)
                        self._names.append(name)

    def _check(self, changed: list[tuple[str, Any]]) -> None:
        link = self._link
        for name, value in changed:
            if name.rpartition(".")[2] in FIXED:
                raise InputError(f"{name}: cannot be changed during the run; allowed: {FREE}")
            _, _, link = with_number(link, name, value)
        self._link = link


class MeasurementParameters:
    """Numbers of a measurement as parameters of the plant, such as `noise.angle`, `pmus.G1.clock.offset`."""

    def __init__(self, node: Node, measurement: Measurement, change: Callable[[str, float], None]) -> None:
        """Declare the parameters. `change(name, value)` is called for each value that differs from `measurement`'s."""
        self._measurement = measurement
        for name, wanted in numbers(measurement).items():
            declared = declare(node, name, wanted, field_descriptor(_field(measurement, name), False))
            if declared != wanted:
                self._measurement = with_measured(self._measurement, name, declared)
                change(name, declared)
        _on_set(node, list(numbers(measurement)), self._check, change)

    def _check(self, changed: list[tuple[str, Any]]) -> None:
        measurement = self._measurement
        for name, value in changed:
            measurement = with_measured(measurement, name, value)
        self._measurement = measurement


def _field(measurement: Any, path: str) -> Any:
    """Declaration of the field at a dotted path."""
    *above, last = path.split(".")
    for key in above:
        if isinstance(measurement, list):
            measurement = measurement[int(key)]
        else:
            measurement = measurement[key] if isinstance(measurement, dict) else getattr(measurement, key)
    return type(measurement).model_fields[last]
