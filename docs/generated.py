"""What follows from the code: `python docs/generated.py` writes commands.md, fields.md and images/architecture.svg.

And the table of devices in facts_devices.md, and the rankings of cards/README.md.

And a hook of mkdocs, for pages that lie beside docs/.
"""

from __future__ import annotations

import argparse
import inspect
import re
import runpy
import types
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union, get_args, get_origin

from mkdocs.plugins import event_priority
from mkdocs.structure.files import File, Files
from pydantic_core import PydanticUndefined

from facts_damping.cli.parser import parser
from facts_damping.control.table import CONTROLLERS
from facts_damping.devices.base import DeviceModel
from facts_damping.devices.table import KINDS
from facts_damping.fields import ParameterModel
from facts_damping.machine_controls.block_models import MODELS
from facts_damping.parameters import measurement
from facts_damping.parameters.events import Scenario
from facts_damping.parameters.linear_law import LinearLaw
from facts_damping.parameters.link import Link
from facts_damping.parameters.measurement import Measurement
from facts_damping.parameters.plant.system import System
from facts_damping.parameters.profile import Profile
from facts_damping.parameters.run import Run, Tuned, Weights
from facts_damping.parameters.security import Keys
from facts_damping.parameters.stages import Disturbance, StageModel
from facts_damping.parameters.supervision import Supervision
from facts_damping_library.page import page
from facts_damping_streams.parameters import Streams
from facts_damping_studies.campaigns.parameters import Campaign
from facts_damping_studies.parameters import Study, Target
from facts_damping_studies.score.card import cards_of
from facts_damping_studies.score.card import ranking as ranked
from facts_damping_studies.score.cases.sets import read_set
from facts_damping_studies.score.entries import stored_entries
from facts_damping_studies.score.pages import ranking_table

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mkdocs.config.defaults import MkDocsConfig

ROOT = Path(__file__).parents[1]
FILES: dict[str, type[ParameterModel]] = {
    "Run": Run,
    "Scenario": Scenario,
    "Link": Link,
    "Measurement": Measurement,
    "Supervision": Supervision,
    "Profile": Profile,
    "System": System,
    "Study": Study,
    "Campaign": Campaign,
    "Tuned parameters": Tuned,
    "Weights": Weights,
    "Keys": Keys,
    "Streams": Streams,
    "Linear law": LinearLaw,
}
FAMILIES: dict[type[ParameterModel], str] = {  # whose fields are told once for all their kinds
    Target: "Target",
    StageModel: "Stage",
    Disturbance: "Disturbance",
    DeviceModel: "Device",
}
TWICE: dict[type[ParameterModel], str] = {measurement.Noise: "Noise of PMUs"}  # models of the same name as another
BESIDE = {
    "index.md": "README.md",
    "contributing.md": "CONTRIBUTING.md",
    "security.md": "SECURITY.md",
    "changelog.md": "CHANGELOG.md",
    "library.md": "extensions/facts_damping_library/README.md",
    "storms.md": "extensions/facts_damping_testing/README.md",
    "ranking.md": "cards/README.md",
}  # at the top
RANKING = "../cards/README.md"
LIBRARY = "../extensions/facts_damping_library/README.md"
CONTROLS = "Block controls"
COMMANDS = """# Commands

All commands of the program `facts-damping` and their options; `facts-damping --help` lists them in brief. After
`make demo` it is in `.venv/bin`; activate the environment first with `. .venv/bin/activate`. `python -m facts_damping`
is the same program, and so is `ros2 run facts_damping facts-damping` in a colcon workspace. `bench` and `reproduce`
come with a checkout. [Running](running.md) explains what the commands write.

Shells complete commands, options and names after `eval "$(register-python-argcomplete facts-damping)"`.
"""
COMMON = "What the usage of a command names and its table lacks."
SEVERAL = 3  # commands of an option that is told once
FIELDS = """# Fields

Every field of the YAML files, with its type (for numbers the unit), default and range. [Running](running.md) explains
how files are named and found, and how `--set` changes a field. A file with an unknown field or a value out of range is
refused with one line that names the field and what is allowed.

The `description` of a file is a text that `facts-damping list` shows, and of a system `modes`, too. Any file may begin
with `extends: NAME`, another file in its folder: it then has that file's fields, apart from those it gives itself.
"""
BOUNDS = {"gt": "> {:.10g}", "ge": "≥ {:.10g}", "lt": "< {:.10g}", "le": "≤ {:.10g}"}
WORDS = {str: "text", int: "integer", float: "number", bool: "boolean", type(None): "none", Any: "any"}


@event_priority(50)  # before the plugin redirects
def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages to those that are there."""
    for name, file in BESIDE.items():
        files.append(File.generated(config, name, content=_moved((ROOT / file).read_text(encoding="utf-8"))))
    return files


@event_priority(50)
def on_page_markdown(markdown: str, **_: Any) -> str:
    """A page in docs/ as one of the site, where what is beside docs/ is in it, too."""
    for name, file in BESIDE.items():
        markdown = markdown.replace(f"](../{file}", f"]({name}")
    return markdown


def _moved(text: str) -> str:
    """A page from beside docs/: its links are those of a page in it; what is no page is named only."""
    text = re.sub(r"\]\((?:\.\./\.\./)?(?:docs/)?", "](", text)
    for name, file in BESIDE.items():
        text = text.replace(f"]({file}", f"]({name}")
    return re.sub(r"\[([^\]]+)\]\((?:docs|LICENSE|CITATION\.cff)\)", r"\1", text)


def commands() -> str:
    """Every command with its options, from the parser."""
    top = parser()
    (verbs,) = (action.choices for action in top._actions if isinstance(action, argparse._SubParsersAction))  # noqa: SLF001
    lines = [
        COMMANDS,
    ]
    options = {name: list(_options(verb)) for name, verb in verbs.items()}
    many = Counter(row for rows in options.values() for row in rows)
    common = [row for row, number in many.items() if number >= SEVERAL and row.startswith("| `")]
    lines += ["## Common options", "", COMMON, "", *_argument_table(common)]
    for name, verb in verbs.items():
        usage = " ".join(verb.format_usage().removeprefix("usage: ").split())
        lines += [f"## {name}", "", verb.description or "", "", "```text", usage, "```", ""]
        lines += _argument_table([row for row in options[name] if row not in common])
        if verb.epilog:
            lines += [*(f"    {line.strip()}" for line in verb.epilog.splitlines()[1:]), ""]
    return "\n".join(lines)


def _argument_table(rows: list[str]) -> list[str]:
    return ["| argument | meaning |", "|---|---|", *rows, ""] if rows else []


def _options(command: argparse.ArgumentParser) -> Iterator[str]:
    for action in command._actions:  # noqa: SLF001
        if action.dest != "help" and action.help:  # what the usage says needs no row
            names = ", ".join(f"`{name}`" for name in action.option_strings)
            value = str(action.metavar or "") or (
                "" if action.choices is None else " or ".join(map(str, action.choices))
            )
            metavar = f" `{value}`" if value and action.nargs != 0 else ""
            yield f"| {names}{metavar} | {_cell(action.help or '')} |"


def fields() -> str:
    """Every field of every kind of file, from the models that check them."""
    lines = [FIELDS]
    described: set[type[ParameterModel]] = set()
    for title, model in FILES.items():
        lines += [f"## {title}", ""]
        inside = [model]
        while inside:
            nested = inside.pop(0)
            if nested in described:
                continue
            described.add(nested)
            if nested.__name__ not in MODELS:
                lines += [f"### {_title(nested)}", ""] if nested is not model else []
                lines += [f"{_sentences(nested)}", "", *_table(nested), ""]
            inside = [other for field in nested.model_fields.values() for other in _models(field.annotation)] + inside
        lines += _controls() if model is System else []
    return "\n".join([*lines, *_parameters()])


def _controls() -> Iterator[str]:
    """Controls of machines that have the fields of the PSS/E library."""
    yield f"### {CONTROLS}\n"
    yield "Controls of machines from the PSS/E library, whose fields and blocks are on [a page of their own]"
    yield f"({LIBRARY}). Each also has `machine`, `model` and `enabled` (default: `true`). Exciters also have"
    yield "`RC`, `XC` (default 0): they control |V + (RC + j XC) I| with the current I out of the machine, as IEEEVC.\n"


# Controllers whose parameters are told, by their title; the other networks differ in defaults alone.
PARAMETERS = {"Lead-lag": "LLC", "LQG": "LQG", "H-infinity": "Hinf", "Neuro-fuzzy": "ANFTSC"}


def _parameters() -> Iterator[str]:
    """What `parameters` of a controller may be, from the table of controllers."""
    yield "## Parameters of controllers\n"
    yield "What `parameters` of a [controller](#controller) takes. *live*: may be changed while a node runs."
    yield "*list by*: a list may have one value for each.\n"
    for title, name in PARAMETERS.items():
        yield f"### {title} parameters\n"
        yield "| parameter | unit | default | range | live | list by | meaning |"
        yield "|---|---|---|---|---|---|---|"
        for key, parameter in CONTROLLERS[name].parameters.items():
            default = (
                f"{parameter.default} (`thesis`), {parameter.deployed} (`deployed`)"
                if parameter.deployed is not None
                else parameter.default
            )
            span = ", ".join(parameter.choices) or f"{parameter.low:g} to {parameter.high:g}"
            cells = (
                f"`{key}`",
                parameter.unit,
                str(default),
                span,
                "yes" if parameter.live else "",
                parameter.each or "",
                parameter.description,
            )
            yield f"| {' | '.join(map(_cell, cells))} |"
        yield ""


def _sentences(model: type[ParameterModel]) -> str:
    links = " and ".join(f"[{FAMILIES[base]}](#{FAMILIES[base].lower()})" for base in _families(model))
    kind = [f"`{name}: {value}`" for name, value in _constants(model).items()]
    sentence = ", ".join([*kind, f"with the fields of {links}"] if links else kind)
    return inspect.cleandoc(model.__doc__ or "") + (f"\n\n{sentence[0].upper()}{sentence[1:]}." if sentence else "")


def _constants(model: type[ParameterModel]) -> dict[str, Any]:
    """Fields that have one value only, which says of what kind a row is."""
    literals = {
        name: get_args(field.annotation)
        for name, field in model.model_fields.items()
        if get_origin(field.annotation) is Literal and ";" not in (field.description or "")
    }
    return {name: values[0] for name, values in literals.items() if len(values) == 1}


def _families(model: type[ParameterModel]) -> list[type[ParameterModel]]:
    """The families to which a kind belongs."""
    return [base for base in FAMILIES if issubclass(model, base) and base is not model]


def _told(model: type[ParameterModel], name: str) -> bool:
    """Whether a field is told with a family of the model."""
    owner = next(base for base in model.__mro__ if name in inspect.get_annotations(base))
    return owner in _families(model)


def _table(model: type[ParameterModel]) -> list[str]:
    rows = list(_rows(model))
    return ["| field | type or unit | default | range | meaning |", "|---|---|---|---|---|", *rows] if rows else []


def _rows(model: type[ParameterModel]) -> Iterator[str]:
    for name, field in model.model_fields.items():
        # `asked` is in stored runs alone; what has no meaning yet is told with each kind; the rest is told above.
        if name in ("asked", "description") or not field.description or _told(model, name) or name in _constants(model):
            continue
        extra = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
        limits = [
            text.format(value) for key, text in BOUNDS.items() if (value := _bound(field.metadata, key)) is not None
        ]
        cells = (
            f"`{field.alias or name}`",
            _unit_or_kind(str(extra.get("unit", "")), _kind(field.annotation), none=field.default is None),
            _default(field.default, field.default_factory),
            ", ".join(limits),
            field.description or "",
        )
        yield f"| {' | '.join(map(_cell, cells))} |"


def _unit_or_kind(unit: str, kind: str, *, none: bool) -> str:
    """The unit of a number, else the type; `none`: that it may be none is told by its default."""
    kind = kind.removesuffix(" or none") if none else kind
    return unit if kind == "number" and unit not in ("", "-") else f"{kind}, {unit}" if unit not in ("", "-") else kind


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def _bound(metadata: list[Any], key: str) -> float | None:
    return next((getattr(limit, key) for limit in metadata if getattr(limit, key, None) is not None), None)


def _default(value: Any, factory: Any) -> str:
    if value is PydanticUndefined:
        return "" if factory else "required"
    if isinstance(value, ParameterModel):
        return "its defaults"
    if value is None or value in ("", [], {}):
        return {None: "none", "": ""}.get(value, "empty") if not isinstance(value, (list, dict)) else "empty"
    if isinstance(value, list) and isinstance(value[0], ParameterModel):
        return "one with its defaults"
    shown = str(value).lower() if isinstance(value, bool) else f"{value:g}" if isinstance(value, float) else str(value)
    return f"`{shown.replace(chr(39), '')}`"


def _kind(annotation: Any) -> str:
    """A type in words."""
    origin, inside = get_origin(annotation), get_args(annotation)
    if annotation in WORDS:
        return WORDS[annotation]
    if origin is Annotated:
        return _kind(inside[0])
    if origin is Literal:
        return ", ".join(f"`{value}`" for value in inside)
    union = origin in (Union, types.UnionType)
    family = next((base for base in FAMILIES if union and all(_is_kind(part, base) for part in inside)), None)
    if family is not None:
        return f"[{FAMILIES[family]}](#{FAMILIES[family].lower()})"
    if union:
        return " or ".join(dict.fromkeys(map(_kind, inside)))
    if origin is list:
        return "list" if inside[0] is Any else f"list of {_kind(inside[0])}"
    if origin is tuple:
        return f"{len(inside)} times {_kind(inside[0])}"
    if origin is dict:
        return "mapping" if inside[1] is Any else f"mapping to {_kind(inside[1])}"
    if isinstance(annotation, type) and issubclass(annotation, ParameterModel):
        title = CONTROLS if annotation.__name__ in MODELS else _title(annotation)
        return f"[{title}](#{title.lower().replace(' ', '-')})"
    return getattr(annotation, "__name__", str(annotation))


def _is_kind(annotation: Any, base: type[ParameterModel]) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, base)


def _title(model: type[ParameterModel]) -> str:
    """What a model is called: the kind of file that it is, or its own name."""
    return next(
        (title for title, described_model in FILES.items() if described_model is model),
        (TWICE | FAMILIES).get(model, model.__name__),
    )


def _models(annotation: Any) -> Iterator[type[ParameterModel]]:
    """The models in a type."""
    if isinstance(annotation, type) and issubclass(annotation, ParameterModel):
        if annotation not in FILES.values():
            yield from (*_families(annotation), annotation)
        return
    for argument in get_args(annotation):
        yield from _models(argument)


DEVICES = "| device | setpoint | a positive setpoint |\n|---|---|---|\n"


def devices() -> str:
    """The page of devices with their table, which has a row for each kind."""
    text = (ROOT / "docs" / "facts_devices.md").read_text(encoding="utf-8")
    rows = [
        f"| {shown.name} | {shown.setpoint} | {shown.positive} |\n" for shown in (kind.shown for kind in KINDS.values())
    ]
    before, _, after = text.partition(DEVICES)
    return before + DEVICES + "".join(rows) + after[after.index("\n\n") + 1 :]


def ranking() -> str:
    """The page of cards with the ranking of each set, from the cards."""
    text = (ROOT / "docs" / RANKING).read_text(encoding="utf-8")
    parts = [text.partition("\n## ")[0].rstrip("\n")]
    for folder in sorted(path for path in (ROOT / "cards").iterdir() if path.is_dir()):
        case_set = read_set(folder.name)
        cards = ranked(cards_of(case_set, stored_entries(case_set)))
        about = f"{case_set.content.description}; {len(case_set.cases)} cases, digest {case_set.digest}"
        parts.append("\n".join(["", f"## {case_set.name}", "", about, "", *ranking_table(cards, markdown=True)]))
    return "\n".join(parts)


def pages() -> dict[str, str]:
    """The pages and the drawing by their names."""
    drawing: str = runpy.run_path(str(ROOT / "docs" / "drawing.py"))["drawing"]()
    names = ("commands.md", "fields.md", "facts_devices.md", LIBRARY, RANKING, "images/architecture.svg")
    return dict(zip(names, (commands(), fields(), devices(), page(), ranking(), drawing), strict=True))


if __name__ == "__main__":
    for name, text in pages().items():
        (ROOT / "docs" / name).write_text(f"{text.rstrip()}\n", encoding="utf-8")
