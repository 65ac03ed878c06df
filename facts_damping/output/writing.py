"""Files that are written whole or not at all."""

from __future__ import annotations

import json
import os
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from facts_damping.escaping import escaped
from facts_damping.interruption import interruptions_held, written
from facts_damping.output.terminal import put

if TYPE_CHECKING:
    from collections.abc import Iterator


@contextmanager
def naming(target: str) -> Iterator[None]:
    """Add the file's name to errors of writing, which a full disk's error lacks."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, target) from error


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary file beside `path` that replaces it if complete; otherwise nothing is left. Delays interruptions."""
    place = path.resolve()  # target of a link
    beside = place.with_name(place.name + ".new")
    with interruptions_held():
        try:
            with naming(str(path)):
                yield beside
                beside.replace(place)
            written(str(path))
        except BaseException:
            beside.unlink(missing_ok=True)
            raise


def write_whole(path: Path, text: str) -> None:
    """Write a file whole or not at all; devices are written directly."""
    if path.exists() and not path.is_file():
        with naming(str(path)):
            path.write_text(text, encoding="utf-8")
        return
    with replacing(path) as beside:
        beside.write_text(text, encoding="utf-8")


def write_json(target: str | None, content: Any) -> None:
    """Write JSON to a file, or to standard output for `-`."""
    if target is not None:
        write_text(target, json.dumps(finite(content), indent=2, allow_nan=False) + "\n")


def write_text(target: str, text: str) -> None:
    """Write text to a file, or to standard output for `-`; unprintable characters are escaped on a terminal."""
    if target != "-":
        write_whole(Path(target), text)
    else:
        put(escaped(text) if os.isatty(1) else text)


def finite(content: Any) -> Any:
    """Content for JSON: objects of dataclasses and named tuples, None in place of numbers that JSON lacks."""
    if is_dataclass(content):
        content = {field.name: getattr(content, field.name) for field in fields(content)}
    elif isinstance(content, tuple) and hasattr(content, "_asdict"):
        content = content._asdict()
    if isinstance(content, dict):
        return {key: finite(value) for key, value in content.items()}
    if isinstance(content, (list, tuple)):
        return [finite(value) for value in content]
    if isinstance(content, float) and content - content != 0.0:
        return None
    return content
