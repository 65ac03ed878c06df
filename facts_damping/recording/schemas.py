"""Message definitions, verbatim with comments, as MCAP schemas of encoding `ros2msg`.

Format (MCAP format registry, `ros2msg`): the definition, then each dependency after a line of 80 equal signs and a
line `MSG: package/Type`.
"""

from __future__ import annotations

import os
import re
import sys
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

from facts_damping.errors import RecordingError, one_line

if TYPE_CHECKING:
    from rosbags.interfaces.typing import Typesdict

SEPARATOR = "=" * 80
LONGEST = 100_000  # characters of a schema; those of a graph have less than 10,000
PRIMITIVES = frozenset(
    ["bool", "byte", "char", "string", "wstring", "float32", "float64"]
    + [f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)]
)
_FIELD_TYPE = re.compile(r"^\s*([A-Za-z][\w/]*)")


@lru_cache(maxsize=64)
def schema_text(message_type: str) -> str:
    """Definition of `message_type` ("package/msg/Type") followed by its dependencies.

    Raises RecordingError if a definition is not installed.
    """
    texts: dict[str, str] = {}
    _collect(message_type, texts)
    main, *rest = texts.items()
    sections = [main[1]] + [f"{SEPARATOR}\nMSG: {name.replace('/msg/', '/')}\n{text}" for name, text in rest]
    return "\n".join(text.rstrip("\n") for text in sections) + "\n"


def definition_file(message_type: str) -> Path:
    """Path of the `.msg` file of `message_type` ("package/msg/Type").

    Searches below AMENT_PREFIX_PATH, then beside the Python package of that name, then below sys.prefix: ROS 2 from pip
    wheels sets no AMENT_PREFIX_PATH. Raises RecordingError.
    """
    parts = message_type.split("/")
    if len(parts) != 3 or parts[1] != "msg":
        raise RecordingError(f"message type {message_type!r}: expected package/msg/Type")
    package, _, name = parts
    for prefix in _prefixes(package):
        file = prefix / "share" / package / "msg" / f"{name}.msg"
        if file.is_file():
            return file
    raise RecordingError(f"message type {message_type!r}: no share/{package}/msg/{name}.msg is installed")


def parse_schema(message_type: str, text: str) -> Typesdict:
    """Types that a schema text defines, in the form of rosbags. Raises RecordingError if unreadable."""
    if len(text) > LONGEST:
        raise RecordingError(f"schema of {message_type}: {len(text)} characters; allowed: at most {LONGEST}")
    try:
        return get_types_from_msg(text, message_type)
    except TypesysError as error:
        raise RecordingError(f"schema of {message_type}: {one_line(error)}") from error


@lru_cache(maxsize=64)
def type_hash(message_type: str, text: str) -> str:
    """Type description hash RIHS01 (REP-2016) of a message type, from its schema text."""
    store = get_typestore(Stores.EMPTY)
    try:
        store.register(parse_schema(message_type, text))
        return store.hash_rihs01(message_type)
    except (TypesysError, KeyError) as error:
        raise RecordingError(f"schema of {message_type}: {one_line(error)}") from error


def _collect(message_type: str, texts: dict[str, str]) -> None:
    """Add the definition of `message_type` and of the types that it uses, depth first, to `texts`."""
    text = definition_file(message_type).read_text(encoding="utf-8")
    texts[message_type] = text
    for used in _used_types(message_type, text):
        if used not in texts:
            _collect(used, texts)


def _used_types(message_type: str, text: str) -> list[str]:
    """Full names of the message types of a definition's fields."""
    matches = (_FIELD_TYPE.match(line) for line in text.splitlines())
    names = dict.fromkeys(match[1] for match in matches if match)
    return [_full_name(name, message_type) for name in names if name not in PRIMITIVES]


def _full_name(name: str, owner: str) -> str:
    """`package/msg/Type` of a type name as written in a field of the message `owner`."""
    if name == "Header":
        return "std_msgs/msg/Header"
    package, _, _ = (name if "/" in name else owner).partition("/")
    _, _, base = name.rpartition("/")
    return f"{package}/msg/{base}"


def _prefixes(package: str) -> list[Path]:
    """Installation prefixes in which a package's share folder may be, in order of precedence."""
    ament = [Path(entry) for entry in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if entry]
    try:
        spec = find_spec(package)
    except (ImportError, ValueError):  # package half installed: the last prefix may still have it
        spec = None
    places = list(spec.submodule_search_locations or []) if spec else []
    return [*ament, *(parent for place in places for parent in Path(place).parents), Path(sys.prefix)]
