"""What pages write out, carried out: blocks of code in files, and packages where Python finds them."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

FENCED = re.compile(r"^```(?:py|python)\n# ([\w/.]+\.py)(?:, ([^\n]+))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
AT_THE_END = "at the end"


class Block(NamedTuple):
    """Code of a page: its file, where in it (nothing: the file is new), and the text."""

    file: str
    where: str
    text: str


def blocks(page: str) -> list[Block]:
    """The blocks of a page that name their file."""
    return [Block(*match) for match in FENCED.findall(page)]


def carry_out(folder: Path, fenced: Iterable[Block]) -> None:
    """Write the blocks into their files, as CONTRIBUTING.md says. Raises `ValueError` if one does not fit."""
    for block in fenced:
        path = folder / block.file
        if path.exists() is not bool(block.where):
            raise ValueError(f"{block.file}: {'no such file' if block.where else 'it is there'}")
        text = path.read_text(encoding="utf-8") if block.where else ""
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(_with(text, block), encoding="utf-8")


def _with(text: str, block: Block) -> str:
    """The text of a file with a block in it."""
    if block.where in ("", AT_THE_END):
        return text + block.text
    how, _, line = block.where.partition(": ")
    lines = text.splitlines(keepends=True)
    places = [i for i, text_line in enumerate(lines) if text_line.strip() == line]
    if how not in ("before", "after", "instead of") or len(places) != 1:
        raise ValueError(f"{block.file}: {block.where}: {len(places)} such lines")
    first = places[0] + (how == "after")
    return "".join([*lines[:first], block.text, *lines[first + (how == "instead of") :]])


def install(
    folder: Path, files: dict[str, str], groups: dict[str, dict[str, str]], package: str = "my_extension"
) -> None:
    """Put a package where Python finds it, with the entry points that an installation writes."""
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    metadata = folder / f"{package}-1.0.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n", encoding="utf-8")
    lines = [
        line
        for group, points in groups.items()
        for line in (f"[{group}]", *(f"{name} = {value}" for name, value in points.items()))
    ]
    (metadata / "entry_points.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
