"""An imported system as the text of its file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.escaping import escaped
from facts_damping.parameters.yaml_text import dump

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence


def document(content: Mapping[str, Any], typical: Sequence[str], origin: str, remarks: Iterable[str] = ()) -> str:
    """The content as the text of a YAML file, one row per line; `typical`: machines with typical data.

    `remarks`: lines of comment at its head.
    """
    head = f"# Imported from {origin}. Per-unit data of the network are on {content['base_power']:g} MVA.\n"
    head += "".join(f"# {escaped(line)}".rstrip() + "\n" for line in remarks)
    which = "all" if len(typical) == len(content.get("machines", ())) else ", ".join(typical)
    remark = f"# Typical data, not from the case (Kundur 1994, tables 3.2 and 4.2): {which}"
    return head + rows_text(content, {"machines": remark} if typical else {})


def rows_text(content: Mapping[str, Any], remarks: Mapping[str, str] | None = None) -> str:
    """The content of a system's file as YAML, one row per line; `remarks`: comment lines above some of its tables."""
    text = []
    for key, value in content.items():
        if isinstance(value, (list, dict)):
            text.append("")
        if remarks is not None and key in remarks:
            text.append(remarks[key])
        if isinstance(value, list):
            text += [f"{key}:", *(f"  - {_flow(row)}" for row in value)]
        elif isinstance(value, dict):
            text += [f"{key}:", *(f"  {_flow(k)}: {_flow(v)}" for k, v in value.items())]
        else:
            text.append(f"{key}: {_flow(value)}")
    return "\n".join(text) + "\n"


def _flow(value: Any) -> str:
    """A value on one line of YAML; integral numbers have no fraction."""
    return dump(_plain(value), flow=True).strip()


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_plain(inner) for inner in value]
    return int(value) if isinstance(value, float) and value.is_integer() and abs(value) < 1e15 else value
