"""Fewer rows for the same control: what constants and sums say is written into the rows that use them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.plant.machines import blocks as kernel

if TYPE_CHECKING:
    from collections.abc import Iterable

    from facts_damping.compiling.structs import Float1
    from facts_damping.plant.machines.block_controls import Control

# Kinds whose inputs are not summed; of the last two each input that is passed on has its weight.
APART = {kernel.PRODUCT, kernel.QUOTIENT, kernel.SOURCE, kernel.RECTIFIER, kernel.WINDOW, kernel.MAGNITUDE}
# Kinds that are more than a gain where they have no state.
BENT = {*APART, kernel.SATURATION, kernel.CURVE, *range(kernel.DEAD_BAND, len(kernel.KINDS))}


def folded(
    control: Control, values: Float1, constant: Iterable[int], gives: Iterable[int]
) -> tuple[Control, list[int]]:
    """The control without rows that are constants or unlimited sums, as far as those that use them can be sums of more.

    `values`: all signals at rest; `constant`: those sensed ones that stay so; `gives`: the signals that are asked for,
    whose numbers there are returned. Outputs are the same but for the order of additions. States keep their places.
    """
    rows, at = control.rows.copy(), len(values) - len(control.rows)
    fixed, sums = {kernel.ONE, kernel.NONE, *constant}, dict[int, dict[int, float]]()
    for signal, row in enumerate(rows, at):
        if row["state"] < 0 and set(_uses(row)) <= fixed:
            fixed.add(signal)
        _fix(row, fixed, values)
        _spread(row, sums)
        free = (row["low"], row["high"]) == (-kernel.NO_LIMIT, kernel.NO_LIMIT)
        if row["state"] < 0 and row["kind"] not in BENT and free and row["low_of"] == row["high_of"] == kernel.ONE:
            sums[signal] = {n: row["p"][0] * weight for n, weight in _terms(row).items()}
    for row in rows:  # states may follow from later signals
        _fix(row, fixed, values)
        _spread(row, sums)
    asked = [_alias(sums, signal) for signal in gives]
    needed, waiting = set[int](), [*asked, *(at + np.flatnonzero(rows["state"] >= 0)).tolist()]
    while waiting:
        signal = waiting.pop()
        if signal not in needed:
            needed.add(signal)
            waiting += _uses(rows[signal - at]) if signal >= at else []
    left = [k for k in range(len(rows)) if at + k in needed]
    places = np.arange(len(values))
    places[[at + k for k in left]] = range(at, at + len(left))
    rows = rows[left]
    for field in ("source", "low_of", "high_of", "hold"):
        rows[field] = places[rows[field]]
    names = [control.gives[k] for k in left]
    first = sum(k < control.first for k in left)
    return control._replace(rows=rows, gives=names, first=first), [int(places[signal]) for signal in asked]


def _uses(row: Any) -> list[int]:
    """The signals that a row depends on."""
    return [*map(int, row["source"][: row["inputs"]]), *(int(row[of]) for of in ("low_of", "high_of", "hold"))]


def _terms(row: Any) -> dict[int, float]:
    """The signals that a row adds, with their weights."""
    terms = dict[int, float]()
    for signal, weight in zip(row["source"][: row["inputs"]], row["weight"], strict=False):
        terms[int(signal)] = terms.get(int(signal), 0.0) + float(weight)
    return terms


def _write(row: Any, terms: dict[int, float]) -> None:
    """Write the signals that a row adds."""
    row["inputs"], row["source"], row["weight"] = len(terms), 0, 0.0
    row["source"][: len(terms)], row["weight"][: len(terms)] = list(terms), list(terms.values())


def _fix(row: Any, fixed: set[int], values: Float1) -> None:
    """Write the values of constants into a row instead of their signals."""
    for limit in ("low", "high"):
        of = int(row[f"{limit}_of"])
        if of in fixed:
            row[limit], row[f"{limit}_of"] = row[limit] * values[of], kernel.ONE
    if row["hold"] in fixed:
        row["hold"] = kernel.ONE if values[row["hold"]] > 0.5 else kernel.NONE
    a, b = map(int, row["source"][:2])
    if row["kind"] == kernel.PRODUCT and {a, b} & fixed:
        row["kind"] = kernel.SUM
        row["p"][0] = 1.0
        _write(row, {b: float(values[a])} if a in fixed else {a: float(values[b])})
    elif row["kind"] == kernel.QUOTIENT and b in fixed:
        row["kind"] = kernel.SUM
        row["p"][0] = 1.0
        _write(row, {a: float(1.0 / values[b])})
    if row["kind"] in APART:
        return
    terms, level = _terms(row), 0.0
    for signal in [signal for signal in terms if signal in fixed]:
        level += terms.pop(signal) * float(values[signal])
    terms = {signal: weight for signal, weight in terms.items() if weight != 0.0}
    _write(row, {**terms, kernel.ONE: level} if level != 0.0 else terms)


def _spread(row: Any, sums: dict[int, dict[int, float]]) -> None:
    """Write what signals are sums of into a row instead of them, as far as there is room."""
    if row["kind"] in APART:
        for i in range(row["inputs"]):
            row["source"][i] = _alias(sums, int(row["source"][i]))
        return
    for signal, factor in _terms(row).items():
        terms = _terms(row)
        if signal in sums:
            del terms[signal]
            for n, weight in sums[signal].items():
                terms[n] = terms.get(n, 0.0) + factor * weight
            if len(terms) <= kernel.MAX_INPUTS:
                _write(row, terms)


def _alias(sums: dict[int, dict[int, float]], signal: int) -> int:
    """The signal that a signal is the same as."""
    ((of, weight),) = sums[signal].items() if len(sums.get(signal, {})) == 1 else ((signal, 1.0),)
    return _alias(sums, of) if weight == 1.0 and of != signal else signal
