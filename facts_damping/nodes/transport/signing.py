"""Signatures of messages: HMAC-SHA-256 (RFC 2104) with a key shared by the nodes of a graph, as in IEC 61850-90-5.

A signature consists of the key's number, the signer's session, and the code over both, the topic and the message
before the signature: header, tick, entries. Ticks only increase, so no message can be replayed within its run. The
session is the start time of the signer's node; it exposes messages of an earlier run or of a replaced node.
"""

from __future__ import annotations

import hmac
import struct
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from facts_damping.nodes import clock
from facts_damping.nodes.transport.cdr import Refused
from facts_damping.parameters.security import read_keys
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from facts_damping.case.model import Case

HEAD = struct.Struct("<IQ")  # number of the key, session in ns of wall time
LENGTH = HEAD.size + 32  # bytes
STARTS = 3  # windows: one to wait for peers, one for first answers, one for a machine slower than the clock


class Signing(NamedTuple):
    """Keys by number (the first one signs), session of the node, and allowed distance of other sessions."""

    keys: Mapping[int, bytes]
    session_ns: int
    window_ns: int


def signing(case: Case, start_timeout_s: float) -> Signing | None:
    """Keys and session of a node of a case; None: messages are not signed.

    Nodes of a graph start within the time that they wait for each other; their sessions may differ by that much.
    """
    if case.run.security is None:
        return None
    keys = read_keys(Path(case.run.security.keys))
    return Signing(keys, clock.time_ns(), int(start_timeout_s * NANOSECONDS))


class Seal:
    """Signs or checks the messages of a topic; keeps the session of the signer."""

    def __init__(self, by: Signing, topic: str) -> None:
        """`topic`: name relative to the namespace of the graph."""
        self._by, self._topic = by, topic.encode() + b"\0"
        self._session: int | None = None

    def sign(self, body: bytes) -> bytes:
        """Signature of a message; `body`: all bytes before the signature."""
        number, key = next(iter(self._by.keys.items()))
        head = HEAD.pack(number, self._by.session_ns)
        return head + hmac.digest(key, self._topic + head + body, "sha256")

    def check(self, body: bytes, signature: bytes, start_ns: int) -> None:
        """Raise `Refused` if a message is not signed with one of the keys or belongs to a wrong session.

        `start_ns`: start of its tick. A newer session, of a node that has joined, may replace the known one. A session
        must not be older than this node's by more than the simulated time plus `STARTS` windows, nor begin more than
        one window in the future.
        """
        head, code = signature[: HEAD.size], signature[HEAD.size :]
        number, session = HEAD.unpack(head)
        key = self._by.keys.get(number)
        if key is None or not hmac.compare_digest(code, hmac.digest(key, self._topic + head + body, "sha256")):
            raise Refused("signature")
        if self._session is None or session > self._session:
            before, ahead = self._by.session_ns - session, session - clock.time_ns()
            if before > start_ns + STARTS * self._by.window_ns or ahead > self._by.window_ns:
                raise Refused("session")
            self._session = session
        if session != self._session:
            raise Refused("session")


def seal(by: Signing | None, topic: str) -> Seal | None:
    """The seal of a topic; None if messages are not signed."""
    return None if by is None else Seal(by, topic)
