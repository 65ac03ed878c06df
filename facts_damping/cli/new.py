"""The command `new`: creates a folder for a controller of the user's own, or a key."""

from __future__ import annotations

import re
from importlib.resources import files as resources
from pathlib import Path
from typing import TYPE_CHECKING

from facts_damping.cli.reporting import say
from facts_damping.errors import InputError
from facts_damping.output.writing import write_whole
from facts_damping.parameters.files import new_folder
from facts_damping.parameters.security import add_key

if TYPE_CHECKING:
    import argparse

# Files of the folder and their templates.
FILES = {
    "controller.py.txt": "{name}.py",
    "run.yaml.txt": "run.yaml",
    "study.yaml.txt": "study.yaml",
    "test.py.txt": "test_{name}.py",
}


def new(arguments: argparse.Namespace) -> None:
    """Create a controller's folder or a key."""
    if arguments.kind == "controller":
        _controller(arguments)
        return
    if arguments.out is not None:
        raise InputError(f"--out {arguments.out}: given with a key; allowed: new key FILE.yaml")
    number, before = add_key(Path(arguments.name))
    also = f"; key {before[0]} is accepted, too" if before else ""
    say(arguments, f"{arguments.name}: key {number} signs{also}; for the nodes of the graph alone")


def _controller(arguments: argparse.Namespace) -> None:
    """Create a folder with a class, a run, a study, and a test that runs it in process and as a node."""
    name = arguments.name
    if not re.fullmatch(r"[a-z][a-z0-9_]{0,40}", name):
        raise InputError(f"NAME: '{name}' given; allowed: small letters, digits and _, such as my_damper")
    folder = Path(arguments.out or name)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder}: exists already; allowed: a new folder, --out DIR")
    new_folder(folder)
    words = {"name": name, "Name": "".join(part.capitalize() for part in name.split("_"))}
    place = resources("facts_damping") / "templates" / arguments.kind
    for template, file in FILES.items():
        text = (place / template).read_text(encoding="utf-8")
        write_whole(folder / file.format(**words), text.format(**words))
    say(arguments, f"{folder}: {', '.join(file.format(**words) for file in FILES.values())}")
    say(arguments, f"next: cd {folder} && facts-damping simulate run.yaml")
