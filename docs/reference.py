"""Writes docs/api.md from docstrings: python docs/reference.py."""

from __future__ import annotations

import dataclasses
import inspect
from pathlib import Path
from typing import TYPE_CHECKING, Any

from facts_damping import api
from facts_damping.environment import reward, single, vector, window
from facts_damping.signals import Record

if TYPE_CHECKING:
    from collections.abc import Iterator

PAGE = Path(__file__).with_name("api.md")
HEAD = """# The public API

Written by `python docs/reference.py` from docstrings; [scripts](scripts.md) has examples. `import facts_damping as fd`
loads what is asked for when it is asked for. What is not here is private.
"""
ENVIRONMENT = (single.WideAreaDamping, vector.WideAreaDampingVector, reward.IndexReward, window.Window)


def text(thing: Any) -> str:
    """A docstring without its indentation."""
    return inspect.cleandoc(thing.__doc__ or "")


def signature(name: str, thing: Any) -> str:
    """How it is called."""
    own = inspect.signature(thing)
    taken = [one.replace(annotation=inspect.Parameter.empty) for one in own.parameters.values() if one.name != "self"]
    return f"```\n{name}{own.replace(parameters=taken, return_annotation=inspect.Signature.empty)}\n```\n"


def members(kind: type[Any]) -> Iterator[str]:
    """Its methods and properties, those of a record beside."""
    for name, own in vars(kind).items():
        if name.startswith("_"):
            continue
        if inspect.isfunction(own):
            yield f"#### {kind.__name__}.{name}\n\n{signature(name, own)}\n{text(own)}\n"
        elif isinstance(own, property) or hasattr(own, "func"):
            yield f"#### {kind.__name__}.{name}\n\n{text(own if isinstance(own, property) else own.func)}\n"


def entry(name: str, thing: Any) -> Iterator[str]:
    """A function or a class."""
    yield f"### {name}\n"
    plain = dataclasses.is_dataclass(thing) or (inspect.isclass(thing) and issubclass(thing, Exception))
    if not plain:
        yield signature(name, thing)
    yield f"{text(thing)}\n"
    if name == "Result":
        yield f"{text(Record)}\n"
    if dataclasses.is_dataclass(thing) and name != "Result":
        fields = [f for f in dataclasses.fields(thing) if f.repr]
        yield "".join(f"- `{one.name}: {one.type}`\n" for one in fields)
    if inspect.isclass(thing):
        yield from members(thing)


def page() -> str:
    """The page."""
    parts = [HEAD, "## Runs, systems, studies: `facts_damping`\n"]
    for name in api.__all__:
        parts += entry(name, getattr(api, name))
    parts.append("## The environment: `facts_damping.environment`\n")
    for thing in ENVIRONMENT:
        parts += entry(f"{thing.__module__.removeprefix('facts_damping.environment.')}.{thing.__name__}", thing)
    return "\n".join(parts)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
