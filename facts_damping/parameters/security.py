"""What a graph's messages are signed with: the run's table, and the file of keys."""

from __future__ import annotations

import os
import re
import secrets
from typing import TYPE_CHECKING, Annotated

from pydantic import Field, StringConstraints

from facts_damping.errors import InputError
from facts_damping.fields import ParameterModel, quantity
from facts_damping.input_files import read_text
from facts_damping.output.writing import write_whole
from facts_damping.parameters.field_errors import check
from facts_damping.parameters.yaml_text import UNREADABLE, dump, parse

if TYPE_CHECKING:
    from pathlib import Path

KEY_BYTES = 32  # as many as the hash has: RFC 2104, 3
KEPT = 2  # keys in a file: the one that signs, and the one before it
MODE = 0o600
HEAD = "# Keys of a graph: the first signs, all are accepted. For its nodes alone: mode 0600.\n"


class Security(ParameterModel):
    """How the messages of a graph are protected, see [signatures](operate.md)."""

    keys: str = Field(description="file of the keys that sign PMU frames and setpoints")


class Key(ParameterModel):
    """One key and its number."""

    id: int = quantity(..., "-", "number of the key; a signature contains it", ge=1, le=2**32 - 1)
    key: Annotated[str, StringConstraints(pattern=rf"^[0-9a-f]{{{2 * KEY_BYTES}}}$")] = Field(
        description="64 hexadecimal digits"
    )


class Keys(ParameterModel):
    """A file of keys, written by `facts-damping new key`; only its owner may be able to read it (mode 0600)."""

    keys: list[Key] = Field(
        min_length=1, max_length=KEPT, description="one or two keys; the first one signs, both are accepted"
    )


def read_keys(path: Path) -> dict[int, bytes]:
    """Keys of a file by their numbers, that which signs first.

    Raises `InputError` where it is none, without a word of what it holds, and where others may read it.
    """
    text = read_text(path)
    try:
        keys = check(Keys, parse(text), str(path)).keys
    except (InputError, *UNREADABLE) as error:
        field = re.search(r"keys(\.\d)?(\.(id|key))?(?=: )", str(error))
        where = f"{path}: {field[0]}" if field else str(path)
        raise InputError(f"{where}: no keys; allowed: as `facts-damping new key` has written them") from None
    mode = path.stat().st_mode & 0o777
    if mode & 0o077:
        raise InputError(f"{path}: mode {mode:04o} given; allowed: {MODE:04o}, for its owner alone (chmod 600)")
    if len({key.id for key in keys}) < len(keys):
        raise InputError(f"{path}: keys: number {keys[0].id} given twice; allowed: each number once")
    return {key.id: bytes.fromhex(key.key) for key in keys}


def add_key(path: Path) -> tuple[int, list[int]]:
    """Put a new key first in a file, which is made where there is none; its number, and those that are kept."""
    before = read_keys(path) if path.exists() else {}
    number = max(before, default=0) + 1
    rest = list(before.items())[: KEPT - 1]
    rows = [{"id": i, "key": key.hex()} for i, key in [(number, secrets.token_bytes(KEY_BYTES)), *rest]]
    mask = os.umask(0o777 & ~MODE)
    try:
        write_whole(path, HEAD + dump({"keys": rows}))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; allowed: a file in a folder that can be written") from error
    finally:
        os.umask(mask)
    return number, [i for i, _ in rest]
