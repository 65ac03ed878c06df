"""From content to models: the first error as one line that names source, field, value and what is allowed."""

from __future__ import annotations

import re
from contextlib import contextmanager
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import ValidationError

from facts_damping import errors
from facts_damping.errors import InputError, meant
from facts_damping.escaping import escaped
from facts_damping.fields import ParameterModel

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

M = TypeVar("M", bound=ParameterModel)


class FieldError(InputError):
    """An error in a field, given by its path; `worded` adds where the field's value comes from.

    `part`: what follows the path of the field in the message. `above`: a field below it may have made it.
    """

    def __init__(self, field: str, text: str, part: str = "", *, above: bool = False) -> None:
        super().__init__(f"{field}{part}: {text}")
        self.field, self.text, self.part, self.above = field, text, part, above


@contextmanager
def worded(source: str, sets: dict[str, str] | None = None) -> Iterator[None]:
    """Raise a `FieldError` as an `InputError` that begins with what gave the field's value, as `sets` has it by paths.

    Where none of them did, it is the source.
    """
    try:
        yield
    except FieldError as error:
        origins, field = sets or {}, error.field
        paths = [path for path in origins if fnmatchcase(f"{field}.", f"{path}.*")]
        below = [path for path in origins if error.above and path.startswith(f"{field}.")]
        origin = origins[max(paths, key=len)] if paths else origins[below[0]] if below else source
        where = f"{origin}: {field}" if field else origin
        raise InputError(f"{where}{error.part}: {error.text}") from error.__cause__


@contextmanager
def of_field(field: str) -> Iterator[None]:
    """Raise an `InputError` as a `FieldError` of this field, whose path may begin the message."""
    try:
        yield
    except FieldError:
        raise
    except InputError as error:
        raise FieldError(field, str(error).removeprefix(f"{field}: ")) from error.__cause__


def check_known(field: str, name: str, allowed: Iterable[str]) -> None:
    """Raise `FieldError` if a name is not among the allowed ones."""
    with of_field(field):
        errors.check_known(field, name, allowed)


def short(value: Any) -> str:
    """A value as text of at most 60 characters."""
    text = escaped(" ".join(repr(value).split()))
    return text if len(text) <= 60 else text[:57] + "..."


def _place(error_location: tuple[int | str, ...], content: Any, *, absent: bool) -> list[str]:
    """An error's location as keys of the content: without pydantic's own tags; `absent`: the last is not in it."""
    keys: list[str] = []
    part: Any
    for i, part in enumerate(error_location):
        last = i == len(error_location) - 1
        if (isinstance(content, dict) and part in content) or (
            isinstance(content, list) and isinstance(part, int) and part < len(content)
        ):
            content = content[part]
        elif not (last and absent and isinstance(content, dict)):
            continue
        keys.append(str(part))
    return keys


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
        tag = next((part for part in location if part in values), None)
        if tag is not None:
            return f"{name} {tag}"
    return None


def _unknown(model: type[ParameterModel], location: tuple[int | str, ...], value: Any) -> str:
    """What is wrong with a key that its model does not have; a member of a union may be the wrong one."""
    here = _model_at(model, location)
    fields = here.model_fields.items() if here is not None else ()
    names = [field.alias or name for name, field in fields if name != "asked"]
    allowed, close = ", ".join(names) or "none", meant(str(location[-1]), names)
    tag = _tag(here, location) if here is not None else None
    if tag:
        return f"{short(value)} given{close}; allowed for {tag}: {allowed}"
    return f"unknown key{close}; allowed: {allowed}"


def _field(model: type[ParameterModel], location: tuple[int | str, ...]) -> Any:
    """The field whose key the last name of a location is; None: there is none."""
    names = [i for i, part in enumerate(location) if isinstance(part, str)]
    here = _model_at(model, location[: names[-1] + 1]) if names else None
    fields = here.model_fields.items() if here is not None else ()
    return next((field for name, field in fields if (field.alias or name) == location[names[-1]]), None)


def _extra(model: type[ParameterModel], location: tuple[int | str, ...]) -> dict[str, Any]:
    extra = getattr(_field(model, location), "json_schema_extra", None)
    return extra if isinstance(extra, dict) else {}


def _wanted(model: type[ParameterModel], location: tuple[int | str, ...]) -> str:
    """What a field that is missing may be: unit, range, a usual value, as far as it has them."""
    limits = getattr(_field(model, location), "metadata", [])
    words = {"gt": "more than", "ge": "at least", "lt": "less than", "le": "at most"}
    limits_text = [f"{word} {getattr(m, key):g}" for m in limits for key, word in words.items() if hasattr(m, key)]
    extra = _extra(model, location)
    unit = "" if extra.get("unit", "-") == "-" else str(extra["unit"])
    usual = [f"usual {extra['usual']:g}"] if "usual" in extra else []
    return ", ".join([*([f"in {unit}"] if unit else []), *limits_text, *usual]) or "a value of this field"


def _kind_wanted(model: type[ParameterModel], error: Any) -> str:
    """A list, such as of the text that was given; or the keys of a table, with an example of those that it needs."""
    value, here = error["input"], _model_at(model, (*error["loc"], ""))
    if error["type"] == "list_type":
        of_texts = getattr(_field(model, error["loc"]), "annotation", None) == list[str]
        return f"a list, such as [{value}]" if of_texts and isinstance(value, str) else "a list"
    if here is None or error["type"] == "dict_type":
        return "a table, key: value"
    fields = {field.alias or name: field for name, field in here.model_fields.items() if name != "asked"}
    needed = ", ".join(f"{name}: {field.examples[0]}" for name, field in fields.items() if field.examples)
    return f"a table with {', '.join(fields)}" + (f", such as {{{needed}}}" if needed else "")


def check(model: type[M], content: Any, source: str, sets: dict[str, str] | None = None, under: str = "") -> M:
    """Content as a model; the first error as one line: source, field, value, what is allowed."""
    with worded(source, sets):
        return check_field(model, content, under)


def check_field(model: type[M], content: Any, under: str) -> M:
    """Content of a field as a model; the first error as a `FieldError`."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        errors = error.errors(include_url=False)
    raise _field_error(model, content, under, errors[0], errors)


def field_errors(model: type[M], content: Any) -> list[FieldError]:
    """All errors of a content, in the order of its fields; those of fields that are missing in a row are one."""
    try:
        model.model_validate(content)
    except ValidationError as error:
        errors = error.errors(include_url=False)
        return list({str(e): e for e in (_field_error(model, content, "", row, errors) for row in errors)}.values())
    return []


def _field_error(model: type[M], content: Any, under: str, error: Any, errors: list[Any]) -> FieldError:
    """An error of pydantic as one of ours; `errors`: with those beside it."""
    location, value, kind = error["loc"], error["input"], error["type"]
    keys = _place(location, content, absent=kind in ("missing", "extra_forbidden"))
    if under == "scenario" and keys[:1] == ["events"]:
        keys = keys[1:]  # a run's scenario is the list of events itself
    path = [under, *keys] if under else keys
    field, message = ".".join(path), re.sub(r"^Value error, ", "", error["msg"])
    if kind == "extra_forbidden":
        return FieldError(field, _unknown(model, location, value), above=True)
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        tag, context = error["ctx"]["discriminator"].strip("'"), error["ctx"]
        text = "missing; allowed: one of its kinds"
        if kind == "union_tag_invalid":
            text = f"{short(context['tag'])} given; allowed: {context['expected_tags']}"
        return FieldError(field, text, f".{tag}")
    if kind == "missing":
        beside = [row["loc"] for row in errors if row["type"] == "missing" and row["loc"][:-1] == location[:-1]]
        if len(beside) == 1:
            return FieldError(field, f"missing; allowed: {_wanted(model, location)}")
        wanted = "; ".join(f"{place[-1]}: {_wanted(model, place)}" for place in beside)
        names = ", ".join(str(place[-1]) for place in beside)
        return FieldError(".".join(path[:-1]), f"{names}: missing; allowed: {wanted}")
    if kind == "value_error":
        return FieldError(field, message)
    if kind in ("list_type", "dict_type", "model_type", "model_attributes_type"):
        return FieldError(field, f"{short(value)} given; allowed: {_kind_wanted(model, error)}")
    allowed = re.sub(r"^(Input should be|Input should have|.* should have|.* should match) ", "", message)
    unit = _extra(model, location).get("unit", "-")
    return FieldError(field, f"{short(value)} given; allowed: {allowed}{'' if unit == '-' else f', in {unit}'}")
