"""The templates of the pages beside this file, filled in."""

from __future__ import annotations

import re
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined


def render(name: str, **values: Any) -> str:
    """A page in Markdown: a template with values; whatever it leaves out, one empty line."""
    templates = Environment(
        loader=PackageLoader("facts_damping_reproduction", "."),
        autoescape=False,  # noqa: S701 (Markdown)
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return re.sub(r"\n{3,}", "\n\n", templates.get_template(name).render(**values)).rstrip() + "\n"
