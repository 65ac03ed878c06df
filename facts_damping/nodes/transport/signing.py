"""Signatures of messages: HMAC-SHA-256 (RFC 2104) with a key that a graph's nodes share, as IEC 61850-90-5 has it.

A signature is the number of the key, the session of who signs, and the code over both, the topic and all of the
message before it: header, tick, entries. Ticks only go on, so nothing of a run can be said twice in it; the session,
the time at which its node was started, tells the messages of an earlier run, and of a node that has been replaced.
"""

from __future__ import annotations

import hmac
import struct
import time
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from facts_damping.nodes.transport.cdr import Refused
from facts_damping.parameters.security import read_keys
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from facts_damping.case.model import Case

HEAD = struct.Struct("<IQ")  # number of the key, session in ns of wall time
LENGTH = HEAD.size + 32  # bytes
STARTS = 3  # windows: nodes wait for their peers, then for first answers, and a machine may be slower than the clock


class Signing(NamedTuple):
    """What a node signs with and checks by: keys by number (the first signs), its session, how far others' may be."""

    keys: Mapping[int, bytes]
    session_ns: int
    window_ns: int


def signing(case: Case, start_timeout_s: float) -> Signing | None:
    """What a node of a case signs with; None: nothing is signed.

    Nodes of a graph are started within the time that they wait for each other: so far sessions may lie apart.
    """
    if case.run.security is None:
        return None
    keys = read_keys(Path(case.run.security.keys))
    return Signing(keys, time.time_ns(), int(start_timeout_s * NANOSECONDS))


class Seal:
    """Signs the messages of a topic, or checks them; it keeps the session of who signs."""

    def __init__(self, by: Signing, topic: str) -> None:
        """`topic`: its name below the namespace of the graph."""
        self._by, self._topic = by, topic.encode() + b"\0"
        self._session: int | None = None

    def sign(self, body: bytes) -> bytes:
        """Signature of a message, of which `body` is all before it."""
        number, key = next(iter(self._by.keys.items()))
        head = HEAD.pack(number, self._by.session_ns)
        return head + hmac.digest(key, self._topic + head + body, "sha256")

    def check(self, body: bytes, signature: bytes, start_ns: int) -> None:
        """Raise `Refused` where a message is not signed with one of the keys, or is of another session.

        `start_ns`: begin of its tick. A session may be followed by a newer one: that of a node that has joined. None
        may have begun longer before this node than what was simulated by then and the window allow, nor in the future.
        """
        head, code = signature[: HEAD.size], signature[HEAD.size :]
        number, session = HEAD.unpack(head)
        key = self._by.keys.get(number)
        if key is None or not hmac.compare_digest(code, hmac.digest(key, self._topic + head + body, "sha256")):
            raise Refused("signature")
        if self._session is None or session > self._session:
            before, ahead = self._by.session_ns - session, session - time.time_ns()
            if before > start_ns + STARTS * self._by.window_ns or ahead > self._by.window_ns:
                raise Refused("session")
            self._session = session
        if session != self._session:
            raise Refused("session")


def seal(by: Signing | None, topic: str) -> Seal | None:
    """The seal of a topic, if messages are signed."""
    return None if by is None else Seal(by, topic)
