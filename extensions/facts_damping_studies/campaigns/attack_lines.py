"""Lines on standard output by which an attacker tells what it has sent."""

from __future__ import annotations

import re

_SENT = re.compile(r"^sent (\d+) (\S+)$", re.MULTILINE)


def sent_line(count: int, topic: str) -> str:
    """How many messages an attacker has sent on a topic."""
    return f"sent {count} {topic}"


def sent(output: str) -> dict[str, int]:
    """Messages by topic in the output of an attacker."""
    return {topic: int(count) for count, topic in _SENT.findall(output)}
