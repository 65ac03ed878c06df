"""Names of a sweep's columns in words, for pictures."""

from __future__ import annotations

from functools import cache

from facts_damping.fields import ParameterModel

SUFFIXES = {"s": "s", "ms": "ms", "hz": "Hz", "pu": "p.u.", "mw": "MW", "percent": "%", "deg": "deg"}


def axis_label(name: str) -> str:
    """A column's name in words, with its unit: `delay_s` as `delay [s]`."""
    words, unit = column_words(name)
    return f"{words} [{unit}]" if unit else words


def value_label(name: str, value: float) -> str:
    """A value of a column in words, with its unit: `delay 0.1 s`."""
    words, unit = column_words(name)
    return f"{words} {value:g} {unit}".rstrip()


@cache
def column_words(name: str) -> tuple[str, str]:
    """A column's name in words, and its unit: by its ending, or that of all parameters of the name; may be empty."""
    field = name.rpartition(".")[2]
    words, _, end = field.rpartition("_")
    if words and end in SUFFIXES:
        return words.replace("_", " "), SUFFIXES[end]
    models, units = [ParameterModel], set()
    for model in models:
        models += model.__subclasses__()
        extra = model.model_fields[field].json_schema_extra if field in model.model_fields else None
        units |= {extra.get("unit")} if isinstance(extra, dict) else set()
    unit = str(units.pop()) if len(units) == 1 else "-"
    return field.replace("_", " "), "" if unit == "-" else unit
