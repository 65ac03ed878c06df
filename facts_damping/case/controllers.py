"""Completes a run's controllers: scheme, all parameters (default, tuned, given), weights, law."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from facts_damping.case.linear_laws import with_law
from facts_damping.case.links import mean_delays
from facts_damping.case.tuned import law, tuned
from facts_damping.control import bank, identifier_model
from facts_damping.control.compensation import COMPENSATIONS, OF_IDENTIFIERS
from facts_damping.control.parameter_tables import RENAMED, Parameter, Value
from facts_damping.control.table import defaults, kind_name, kind_of
from facts_damping.input_files import is_file
from facts_damping.parameters import files
from facts_damping.parameters.field_errors import FieldError, check, check_known, of_field, worded
from facts_damping.parameters.profile import DEFAULT_PROFILE
from facts_damping.parameters.run import Controller, Weights

if TYPE_CHECKING:
    from facts_damping.parameters.link import Link
    from facts_damping.parameters.plant.system import System

DEFAULTS_FOR = ("smib", "two_area", "two_area_governed")  # the thesis's systems, which the defaults are for
USUAL = Controller()
SPAN = 6.0  # default `identifier_span`, frames, of a predicting identifier: one value cannot show an oscillation


def filled(
    controller: Controller,
    here: str,
    system: System,
    link: Link,
    frame_rate: int,
    latency: float = 0.0,
    measurement: str = "ideal",
    tuning: str = DEFAULT_PROFILE,
) -> Controller:
    """A controller with scheme, all parameters, weights and law; given parameters override tuned, tuned the defaults.

    Its name becomes that of its tuned law, `KIND@FILE`, if nothing of this law is changed.
    `latency`: s, of the PMUs' filter; `measurement`: its name; `tuning`: the profile of the tuned parameters.
    """
    name, laws = kind_name(controller.name), law(controller, system.name, f"{here}.name")
    if len(laws) == 1:
        (only,) = laws.values()
        controller = controller.model_copy(update={"scheme": only.scheme, "policy": only.policy or controller.policy})
    with of_field(f"{here}.name"):
        row = kind_of(controller, f"{here}.name")
    controller = with_law(controller, f"{here}.linear", frame_rate)
    if row.network is None and controller.scheme is not None:
        raise FieldError(f"{here}.scheme", f"'{controller.scheme}' given; allowed: none for {name}")
    scheme = None if row.network is None else controller.scheme or "indirect"
    _check_compensation(controller, scheme, f"{here}.compensation")
    counts = sizes(controller)
    for parameter, value in () if row.program or row.node else controller.parameters.items():
        check_parameter(f"{here}.parameters.{parameter}", parameter, value, row.parameters, counts)
    laws = laws or tuned(
        system.name, controller.signals, controller.devices, measurement, tuning, controller.compensation
    )
    if name == "LLC-tuned" and (name, None) not in laws and not controller.parameters:
        problem = f"'LLC-tuned' given, which is not tuned for {system.name} with these signals and devices"
        allowed = f"LLC, or `facts-damping tune {system.name}` first (tuning: {tuning})"
        raise FieldError(f"{here}.name", f"{problem}; allowed: {allowed}")
    tuned_row = laws.get((name, scheme))
    whole, down = mean_delays(controller, system, link)
    usual = {**defaults(row, controller.profile, *counts.values()), **(tuned_row.parameters if tuned_row else {})}
    completed = partial(_completed, usual, controller.compensation, {"loop_delay": latency + whole, "down_delay": down})
    values = completed(controller.parameters)
    order = identifier_model.past_values(values.get("identifier_span"))
    if values.get("identifier") == "ANFGuMoI" and max(*counts.values(), order) > 1:
        allowed = "ANFTSI with several signals or devices, or an identifier_span"
        raise FieldError(f"{here}.parameters.identifier", f"'ANFGuMoI' given; allowed: {allowed}")
    chosen_before = system.name in DEFAULTS_FOR or tuned_row is not None or controller.parameters
    untuned = controller.untuned or (not chosen_before and any(p.search for p in row.parameters.values()))
    weights = _weights(controller, scheme, values, f"{here}.weights")
    plain = controller.profile == USUAL.profile and weights is None and values == completed({})
    as_tuned = tuned_row if tuned_row and plain and tuned_row.compensation == controller.compensation else None
    whole_name = controller.name if row.own else as_tuned.name if as_tuned else name
    update = {"name": whole_name, "scheme": scheme, "parameters": values, "weights": weights, "untuned": untuned}
    return controller.model_copy(update=update)


def _check_compensation(controller: Controller, scheme: str | None, field: str) -> None:
    """Raise `FieldError` for a compensation that the controller's kind has not."""
    name, compensation, row = kind_name(controller.name), controller.compensation, kind_of(controller)
    if not row.compensates and compensation != "none":
        reason = "is designed for its delay already" if row.design else "has no parameters for it"
        raise FieldError(field, f"'{compensation}' given; allowed: none for {name}, which {reason}")
    if compensation in OF_IDENTIFIERS and scheme != "indirect":
        compensations = f"{', '.join(COMPENSATIONS)} for {name}{f' {scheme}' if scheme else ''}"
        allowed = f"{compensations}, or an indirect controller, whose identifier predicts"
        raise FieldError(field, f"'{compensation}' given; allowed: {allowed}")


def _completed(
    usual: dict[str, Value], compensation: str, delays: dict[str, float], parameters: dict[str, Value]
) -> dict[str, Value]:
    """All parameters: the usual ones with those that a run gives, and what follows from these; -1 is a link's delay."""
    values = {**usual, **parameters}
    if compensation in OF_IDENTIFIERS and "identifier_span" not in parameters:
        values["identifier_span"] = SPAN
    if identifier_model.past_values(values.get("identifier_span")) > 1 and "identifier" not in parameters:
        values["identifier"] = "ANFTSI"  # its consequents are affine then
    return values | {delay: value for delay, value in delays.items() if values.get(delay) == -1.0}


def sizes(controller: Controller) -> dict[str, int]:
    """Numbers of signals and devices of a controller: the lengths that a list parameter may need."""
    return {"signal": len(controller.signals), "device": len(controller.devices)}


def check_parameter(field: str, name: str, value: Value, table: dict[str, Parameter], counts: dict[str, int]) -> None:
    """Raise `InputError` for a parameter that the kind's table lacks, or a value that is not allowed.

    `counts`: numbers of signals and devices of the controller.
    """
    if RENAMED.get(name) in table:
        raise FieldError(field, f"'{name}' given; allowed: '{RENAMED[name]}', its new name")
    check_known(field, name, list(table))
    p = table[name]
    if isinstance(value, list) and (not p.each or len(value) != counts[p.each]):
        allowed = f"a number, or {counts[p.each]}, one a {p.each}" if p.each else "one value"
        raise FieldError(field, f"{len(value)} numbers given; allowed: {allowed}")
    for number in value if isinstance(value, list) else [value]:
        if p.choices:
            check_known(field, str(number), p.choices)
        elif isinstance(number, str) or not p.low <= number <= p.high or (p.whole and number != round(number)):
            shown, whole = number if isinstance(number, str) else f"{number:g}", "whole numbers, " if p.whole else ""
            raise FieldError(field, f"{shown} given; allowed: {whole}{p.low:g} to {p.high:g} {p.unit}")


def with_weights(controller: Controller, weights: Path | Weights) -> Controller:
    """A completed controller with other initial weights, given or read from a file.

    Raises `InputError` if they do not fit.
    """
    source = str(weights) if isinstance(weights, Path) else "weights"
    weighted = controller.model_copy(update={"weights": source if isinstance(weights, Path) else weights})
    with worded(source):
        checked_weights = _weights(weighted, weighted.scheme, weighted.parameters, "weights")
    return controller.model_copy(update={"weights": checked_weights})


def _weights(controller: Controller, scheme: str | None, values: dict[str, Value], field: str) -> Weights | None:
    if controller.weights is None:
        return None
    weights = controller.weights
    if isinstance(weights, str):
        path = Path(weights)
        if not is_file(path):
            raise FieldError(field, f"{path}: no such file; allowed: weights that a run has saved")
        weights = check(Weights, files.read_table(path), str(path))
    if (kind_name(weights.name), weights.scheme) != (kind_name(controller.name), scheme):
        allowed = f"those of {controller.name} ({scheme})"
        raise FieldError(field, f"weights of {weights.name} ({weights.scheme}) given; allowed: {allowed}")
    wanted = {"controller": bank.controller_network(controller).size, "identifier": 0}
    if scheme == "indirect":
        kind_of_identifier = str(values["identifier"])
        counts = len(controller.signals), len(controller.devices)
        order = identifier_model.past_values(values["identifier_span"])
        wanted["identifier"] = identifier_model.predictor_network(kind_of_identifier, *counts, order).size
    for part, size in wanted.items():
        numbers = getattr(weights, part)
        if numbers is not None and len(numbers) != size:
            raise FieldError(field, f"{part}: {len(numbers)} numbers given; allowed: {size}")
    return weights
