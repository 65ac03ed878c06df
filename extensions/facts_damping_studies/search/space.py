"""The search space of parameters, and the mapping between its points and controller parameters."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.control.parameter_tables import Range, four_digits
from facts_damping.control.table import kind
from facts_damping.errors import InputError
from facts_damping.neurofuzzy.table import has_dilation
from facts_damping.parameters.field_errors import short
from facts_damping.simulation.programs.user_code import find

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.control.parameter_tables import Value
    from facts_damping.control.table import ControllerKind
    from facts_damping.small_signal.residues import Residues


# Scales of further signals, relative to their swing beside the first signal.
FRACTION = Range(0.1, 10.0, logarithmic=True)
HORIZON = Range(1.0, 24.0)  # frames, if there are several signals or devices
RATES = ("fixed", "lyapunov")  # searched as well: below and above one half
GUARDS = {  # of `search`, in addition to the profile's
    "dead_zone": Range(1e-4, 0.1, logarithmic=True),
    "clip": Range(0.02, 2.0, logarithmic=True),
}


class Space(NamedTuple):
    """The search space of a controller kind and scheme, for given signals and devices."""

    row: ControllerKind
    scheme: str | None
    signals: Sequence[str]
    devices: Sequence[str]

    @property
    def ranges(self) -> dict[str, Range]:
        """A coordinate for each parameter, `name.i` for that of device or signal i; for networks the last is the rate.

        Parameters that may be a list are searched for each device. Scales are searched for the first signal, with a
        ratio for each of the others.
        """
        ranges = {
            name: parameter.search for name, parameter in self.row.parameters.items() if parameter.search is not None
        }
        if self.row.network is None:
            return self._each(ranges)
        of_identifier = {name: ranges.pop(name) for name in list(ranges) if name.startswith("identifier_")}
        dilation = ranges.pop("dilation")
        wavelets = {"dilation": dilation} if has_dilation(self.row.network.consequent) else {}
        coordinates = {**self._each(ranges), **wavelets, **(of_identifier if self.scheme == "indirect" else {})}
        if self.scheme == "indirect" and len(self.signals) * len(self.devices) > 1:
            coordinates["identifier_horizon"] = HORIZON
            del coordinates["identifier_weight"]
        coordinates |= {f"fraction.{i}": FRACTION for i in range(1, len(self.signals))}
        return {**coordinates, "rate": Range(0.0, 1.0)}

    def _each(self, ranges: dict[str, Range]) -> dict[str, Range]:
        """Repeat the ranges of list parameters for each device; without a network also for each signal."""
        counts = {"device": len(self.devices), "signal": len(self.signals) if self.row.network is None else 1}
        repeated: dict[str, Range] = {}
        for name, coordinate_range in ranges.items():
            several = counts.get(self.row.parameters[name].each, 1)
            repeated |= (
                {f"{name}.{i}": coordinate_range for i in range(several)} if several > 1 else {name: coordinate_range}
            )
        return repeated

    def parameters(self, at: NDArray[np.float64], plant: Residues, limit: float) -> dict[str, Value]:
        """Parameters at a point, coordinates from 0 to 1; `limit`: of the first device, p.u."""
        lists: dict[str, list[float]] = {}
        for (place, coordinate), v in zip(self.ranges.items(), at, strict=True):
            lists.setdefault(place.partition(".")[0], []).append(coordinate.value(float(v)))
        for name, by in self._units(plant).items():
            lists[name] = [four_digits(value * by) for value in lists[name]] if by != 1.0 else lists[name]
        if self.row.network is None:
            return _numbers_of_lists(lists)
        rate = RATES[int(lists.pop("rate")[0] >= 0.5)]
        for fraction, signal in zip(lists.pop("fraction", []), self.signals[1:], strict=True):
            beside = fraction * abs(plant.ratio(signal, self.signals[0]))
            for name in ("scale", "change_scale"):
                lists[name].append(four_digits(lists[name][0] * beside))
        if self.scheme == "indirect":
            if "identifier_horizon" in lists:
                lists["identifier_horizon"] = [float(round(lists["identifier_horizon"][0]))]
            for name, by in self._multiples(lists, plant, limit, rate).items():
                lists[name] = [four_digits(number * by) for number in lists[name]]
        return {**_numbers_of_lists(lists), "rate": rate}

    def place(self, values: Mapping[str, Value], plant: Residues, limit: float) -> NDArray[np.float64]:
        """The point of these parameters, the inverse of `parameters`; missing ones are in the middle of their range."""
        numbers = {name: some for name, some in values.items() if not isinstance(some, str)}
        lists = {name: [float(number) for number in np.atleast_1d(some)] for name, some in numbers.items()}
        rate = str(values.get("rate", RATES[0]))
        if self.row.network is not None:
            if self.scheme == "indirect":
                for name, by in self._multiples(lists, plant, limit, rate).items():
                    lists[name] = [number / by for number in lists[name]]
            beside = [abs(plant.ratio(signal, self.signals[0])) for signal in self.signals[1:]]
            lists["fraction"] = [b / lists["scale"][0] / a for a, b in zip(beside, lists["scale"][1:], strict=True)]
            lists["rate"] = [(RATES.index(rate) + 0.5) / len(RATES)]
        units, at = self._units(plant), []
        for place, coordinate in self.ranges.items():
            name, _, i = place.partition(".")
            some = lists.get(name, [])[max(0, int(i or 0) - (name == "fraction")) :]
            at.append(coordinate.place(some[0] / units.get(name, 1.0)) if some else 0.5)
        return np.array(at)

    def _units(self, plant: Residues) -> dict[str, float]:
        """Factors that convert ranges given for `speed` to the first signal's unit, by its swing beside the speed.

        The factor of a gain also has the sign that damps: opposite to the residue of the first signal and device.
        """
        by = abs(plant.ratio(self.signals[0], "speed")) if "speed" in plant.signals else 1.0
        if self.row.network is not None:
            return {"scale": by, "change_scale": by}
        if "gain" not in self.row.parameters:
            return {}
        return {"gain": (1.0 if abs(plant.angle_deg(self.signals[0], self.devices[0])) >= 90.0 else -1.0) / by}

    def _multiples(
        self, numbers: Mapping[str, list[float]], plant: Residues, limit: float, rate: str
    ) -> dict[str, float]:
        """Factors of learning rate and penalties in the indirect scheme, relative to a Jacobian of 1.

        The Jacobian is the effect of the first device's limit on the first signal over the identifier's horizon.
        """
        horizon = int(numbers.get("identifier_horizon", [1.0])[0])
        answer = plant.jacobian(self.signals[:1], self.devices[:1], horizon)[0, 0]
        jacobian = abs(float(answer)) * limit / numbers["scale"][0]
        return {"hbar": jacobian**2} if rate == "lyapunov" else {"hbar": jacobian, "eta": 1.0 / jacobian}


def _numbers_of_lists(numbers: dict[str, list[float]]) -> dict[str, Value]:
    return {name: values[0] if len(values) == 1 else values for name, values in numbers.items()}


class StatedSpace(NamedTuple):
    """The search space of a user's own class, which states it: `search = {"gain": (1.0, 200.0)}`."""

    ranges: dict[str, Range]

    def parameters(self, at: NDArray[np.float64], _plant: Residues, _limit: float) -> dict[str, Value]:
        """Parameters at a point, coordinates from 0 to 1."""
        return {name: each.value(float(v)) for (name, each), v in zip(self.ranges.items(), at, strict=True)}


def space_of(controller: Mapping[str, Any]) -> Space | StatedSpace:
    """The search space of a row of a run's controllers. Raises `InputError` for a class that states a wrong one."""
    if controller.get("policy") is not None:
        return StatedSpace(_stated(str(controller["policy"])))
    row = kind(controller["name"])
    return Space(row, controller.get("scheme"), controller["signals"][: row.signals], controller["devices"])


def _stated(policy: str) -> dict[str, Range]:
    """The ranges in `search` of a class; a range of positive numbers over a decade or more has a logarithmic scale."""
    stated, ranges = getattr(find(policy, "CONTROLLER"), "search", None) or {}, {}
    allowed = 'allowed: a range of each parameter, {"gain": (1.0, 200.0)}'
    if not isinstance(stated, dict):
        raise InputError(f"{policy}: search = {short(stated)} given; {allowed}")
    for name, ends in stated.items():
        try:
            low, high = map(float, ends)
        except (TypeError, ValueError):
            low = high = math.nan
        if not low < high or math.isinf(high - low):
            raise InputError(f"{policy}: search: {name}: {short(ends)} given; {allowed}")
        ranges[str(name)] = Range(low, high, logarithmic=low > 0.0 and high >= 10.0 * low)
    return ranges
