"""The parser of `facts-damping`, made from tables of commands: commands.yaml here, and those of other packages."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Protocol

from facts_damping.cli import options
from facts_damping.errors import InputError
from facts_damping.extensions import given as entry_points
from facts_damping.input_files import read_text
from facts_damping.parameters.yaml_text import parse
from facts_damping.version import __version__

if TYPE_CHECKING:
    import argparse
    from collections.abc import Mapping, Sequence

    from facts_damping.cli.options import Arguments


NEEDED = {"place", "function", "text", "examples", "arguments"}  # of a command in a table
TABLE = Path(__file__).with_name("commands.yaml")


class Add(Protocol):
    """Adds a command to the parser."""

    def __call__(self, name: str, function: str, text: str, *examples: str) -> argparse.ArgumentParser:
        """`function`: the function that carries it out; `text`: what it does."""


def parser() -> argparse.ArgumentParser:
    """The parser of the command line."""
    top = options.Parser(
        prog="facts-damping",
        description="Wide-area damping control with FACTS devices: closed loops in process and as ROS 2 graphs.",
    )
    top.add_argument("--version", action="version", version=__version__)
    verbs = top.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=options.Parser)

    def add(name: str, function: str, text: str, *examples: str) -> argparse.ArgumentParser:
        command = verbs.add_parser(name, help=text, description=text, epilog=options.examples_text(examples))
        command.add_argument("--verbose", action="store_true", help="with an error, also its place in the code")
        command.set_defaults(function=function, known=command.options)
        return command

    added = [row.load() for row in entry_points("commands").values()]
    tables = [TABLE, *(Path(str(mod.__file__)).with_name(TABLE.name) for mod in added if isinstance(mod, ModuleType))]
    rows: dict[str, Any] = {}
    for path in tables:
        for name, row in parse(read_text(path)).items():
            if name in rows or not (path == TABLE or row.keys() >= NEEDED):
                problem = "the name is taken" if name in rows else f"{', '.join(row) or 'nothing'} given"
                raise InputError(f"{path}: {name}: {problem}; allowed: a new command with {', '.join(sorted(NEEDED))}")
            rows[name] = row
    shared = rows.pop("shared arguments")
    for name, row in sorted(rows.items(), key=lambda item: float(item[1]["place"])):
        command = add(name, row["function"], row["text"], *row["examples"])
        command.set_defaults(**row.get("defaults", {}))
        _add_arguments(command, row["arguments"], shared)
    for add_to in added:
        if not isinstance(add_to, ModuleType):
            add_to(add)
    return top


def _add_arguments(command: Arguments, rows: Sequence[Any], shared: Mapping[str, Sequence[Any]]) -> None:
    """Add arguments of a table; `shared`: those of several commands, by the word that stands for them."""
    for row in rows:
        ((name, content),) = row.items() if isinstance(row, dict) else ((row, {}),)
        if name in shared:
            _add_arguments(command, shared[name], shared)
        elif name == "one of":
            _add_arguments(command.add_mutually_exclusive_group(), content, shared)
        elif name in options.GROUPS:
            options.GROUPS[name](command, **content)
        else:
            options.add_argument(command, name, content)
