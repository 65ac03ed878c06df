"""From content to models: the first error as one line that names source, field, value and what is allowed."""

from __future__ import annotations

import re
from fnmatch import fnmatchcase
from typing import Any, TypeVar

from pydantic import ValidationError

from facts_damping.errors import InputError, meant
from facts_damping.escaping import escaped
from facts_damping.parameters.base import ParameterModel

M = TypeVar("M", bound=ParameterModel)


def short(value: Any) -> str:
    """A value as text of at most 60 characters."""
    text = escaped(" ".join(repr(value).split()))
    return text if len(text) <= 60 else text[:57] + "..."


def _place(error_location: tuple[int | str, ...], content: Any, *, absent: bool) -> list[str]:
    """An error's location as keys of the content: without pydantic's own tags; `absent`: the last is not in it."""
    found: list[str] = []
    part: Any
    for i, part in enumerate(error_location):
        last = i == len(error_location) - 1
        if (isinstance(content, dict) and part in content) or (
            isinstance(content, list) and isinstance(part, int) and part < len(content)
        ):
            content = content[part]
        elif not (last and absent and isinstance(content, dict)):
            continue
        found.append(str(part))
    return found


def _model_at(model: type[ParameterModel], location: tuple[int | str, ...]) -> type[ParameterModel] | None:
    """The model whose key the last part of a location is."""
    here: Any = model
    for part in location[:-1]:
        schema = here.model_fields if isinstance(here, type) and issubclass(here, ParameterModel) else {}
        by_key = {field.alias or name: field for name, field in schema.items()}
        if part in by_key:
            here = by_key[part].annotation
        while not (isinstance(here, type) and issubclass(here, ParameterModel)):
            inside = [a for a in getattr(here, "__args__", ()) if a is not type(None)]
            tagged = [a for a in inside if isinstance(a, type) and issubclass(a, ParameterModel) and _tag(a, location)]
            if not inside:
                break
            here = (tagged or inside)[-1]
    return here if isinstance(here, type) and issubclass(here, ParameterModel) else None


def _tag(model: type[ParameterModel], location: tuple[int | str, ...]) -> str | None:
    """The `kind` or `model` by which a location names a member of a union, if it is this one."""
    for name in ("kind", "model"):
        values = getattr(model.model_fields[name].annotation, "__args__", ()) if name in model.model_fields else ()
        found = next((part for part in location if part in values), None)
        if found is not None:
            return f"{name} {found}"
    return None


def _unknown(model: type[ParameterModel], location: tuple[int | str, ...], given: Any) -> str:
    """What is wrong with a key that its model does not have; a member of a union may be the wrong one."""
    here = _model_at(model, location)
    fields = here.model_fields.items() if here is not None else ()
    names = [field.alias or name for name, field in fields if name != "asked"]
    allowed, close = ", ".join(names) or "none", meant(str(location[-1]), names)
    tag = _tag(here, location) if here is not None else None
    if tag:
        return f"{short(given)} given{close}; allowed for {tag}: {allowed}"
    return f"unknown key{close}; allowed: {allowed}"


def _field(model: type[ParameterModel], location: tuple[int | str, ...]) -> Any:
    """The field whose key the last name of a location is; None: there is none."""
    names = [i for i, part in enumerate(location) if isinstance(part, str)]
    here = _model_at(model, location[: names[-1] + 1]) if names else None
    fields = here.model_fields.items() if here is not None else ()
    return next((field for name, field in fields if (field.alias or name) == location[names[-1]]), None)


def _extra(model: type[ParameterModel], location: tuple[int | str, ...]) -> dict[str, Any]:
    """Unit and usual value of a field, as far as it has them."""
    extra = getattr(_field(model, location), "json_schema_extra", None)
    return extra if isinstance(extra, dict) else {}


def _wanted(model: type[ParameterModel], location: tuple[int | str, ...]) -> str:
    """What a field that is missing may be: unit, range, a usual value, as far as it has them."""
    limits = getattr(_field(model, location), "metadata", [])
    words = {"gt": "more than", "ge": "at least", "lt": "less than", "le": "at most"}
    found = [f"{word} {getattr(m, key):g}" for m in limits for key, word in words.items() if hasattr(m, key)]
    extra = _extra(model, location)
    unit = "" if extra.get("unit", "-") == "-" else str(extra["unit"])
    told = [*([f"in {unit}"] if unit else []), *found, *([f"usual {extra['usual']:g}"] if "usual" in extra else [])]
    return ", ".join(told) or "a value of this field"


def origin(field: str, source: str, sets: dict[str, str] | None) -> str:
    """Where a field's value comes from, and its path: what gave it, as `sets` has it by paths, or the source."""
    found = [path for path in sets or {} if fnmatchcase(f"{field}.", f"{path}.*")]
    changed = (sets or {})[max(found, key=len)] if found else source
    return f"{changed}: {field}" if field else changed


def check(model: type[M], content: Any, source: str, sets: dict[str, str] | None = None, under: str = "") -> M:
    """Content as a model; the first error as one line: source, field, value, what is allowed."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        errors = error.errors(include_url=False)
    first = errors[0]
    location, given = first["loc"], first["input"]
    keys = _place(location, content, absent=first["type"] in ("missing", "extra_forbidden"))
    if under == "scenario" and keys[:1] == ["events"]:
        keys = keys[1:]  # a run's scenario is the list of events itself
    field = ".".join([under, *keys] if under else keys)
    where = origin(field, source, sets)
    message = re.sub(r"^Value error, ", "", first["msg"])
    if first["type"] == "extra_forbidden":
        below = [text for path, text in (sets or {}).items() if path.startswith(f"{field}.")]
        where = f"{below[0]}: {field}" if below and where == f"{source}: {field}" else where
        raise InputError(f"{where}: {_unknown(model, location, given)}")
    if first["type"] == "union_tag_invalid":
        tag = first["ctx"]["discriminator"].strip("'")
        raise InputError(f"{where}.{tag}: {short(first['ctx']['tag'])} given; allowed: {first['ctx']['expected_tags']}")
    if first["type"] == "union_tag_not_found":
        raise InputError(f"{where}.{first['ctx']['discriminator'].strip(chr(39))}: missing; allowed: one of its kinds")
    if first["type"] == "missing":
        beside = [one["loc"] for one in errors if one["type"] == "missing" and one["loc"][:-1] == location[:-1]]
        if len(beside) == 1:
            raise InputError(f"{where}: missing; allowed: {_wanted(model, location)}")
        above = origin(".".join([*([under] if under else []), *keys[:-1]]), source, sets)
        wanted = "; ".join(f"{one[-1]}: {_wanted(model, one)}" for one in beside)
        raise InputError(f"{above}: {', '.join(str(one[-1]) for one in beside)}: missing; allowed: {wanted}")
    if first["type"] == "value_error":
        raise InputError(f"{where}: {message}")
    allowed = re.sub(r"^(Input should be|Input should have|.* should have|.* should match) ", "", message)
    unit = _extra(model, location).get("unit", "-")
    raise InputError(f"{where}: {short(given)} given; allowed: {allowed}{'' if unit == '-' else f', in {unit}'}")
