"""The parser of `facts-damping`, made from the table of commands in commands.yaml."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from facts_damping.cli import options
from facts_damping.extensions import given
from facts_damping.input_files import read_text
from facts_damping.parameters.yaml_text import parse
from facts_damping.version import __version__

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from facts_damping.cli.options import Arguments


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
        path = function if ":" in function else f"facts_damping.cli.{function}"
        command.set_defaults(function=path, known=command.options)
        return command

    for name, row in parse(read_text(Path(__file__).with_suffix(".yaml"))).items():
        command = add(name, row["function"], row["text"], *row["examples"])
        command.set_defaults(**row.get("defaults", {}))
        _add_arguments(command, row["arguments"])
    for extension in given("commands").values():
        extension.load()(add)
    return top


def _add_arguments(command: Arguments, rows: Sequence[Any]) -> None:
    for row in rows:
        if isinstance(row, list):
            _add_arguments(command, row)
            continue
        ((name, content),) = row.items() if isinstance(row, dict) else ((row, {}),)
        if name == "one of":
            _add_arguments(command.add_mutually_exclusive_group(), content)
        elif name in options.GROUPS:
            options.GROUPS[name](command, **content)
        else:
            options.add_argument(command, name, content)
