"""Deliberate faults in nodes, and how long storms take to find each: `python -m tests.testing.storm.faults --jobs 2`.

A fault replaces some text of a module: a check that is left out, a flag that is not reset, a wait that is too long.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import time
import types
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping_testing.storm.search import Findings, search

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


class Fault(NamedTuple):
    """A fault: what is wrong, the module below `facts_damping.nodes`, the text there, and the text in its place."""

    what: str
    module: str
    right: str
    wrong: str


FAULTS = (
    # Checks left out.
    Fault("an unknown publisher is admitted", "admission.publishers",
          "if publisher != state.publisher and publisher[:NODE] not in self._succeeding(state):", "if False:"),
    Fault("the recorder does not check signatures", "admission.message_filter", "if state.reading.check is not None:",
          "if False:"),
    Fault("signatures are not checked", "transport.signing",
          "if key is None or not hmac.compare_digest(", "if False and not hmac.compare_digest("),
    Fault("a supervisor uses messages again", "input_collector",
          "self._parts[name] = [message for message in messages if message[0] > tick]",
          "self._parts[name] = list(messages)"),
    Fault("a disarmed controller acts", "controller",
          "sent = count if self.member.joining.acts else 0", "sent = count"),
    Fault("a disarmed link delivers", "wan_link", "sent = count if self.member.joining.acts else 0", "sent = count"),
    Fault("a joining node is armed", "admission.joining", "self._began, self._wanted = False, not arms",
          "self._began, self._wanted = False, True"),
    Fault("a refused message ends the node", "admission.message_filter",
          "            return False\n        if not state.common:", "            raise\n        if not state.common:"),
    # Flags and queues that are not reset.
    Fault("the newest tick is not kept", "admission.message_filter", "        state.tick = tick\n", ""),
    Fault("a resumed run stays paused", "run_control",
          "was_paused, self._paused, self._steps = self._paused, False, 0",
          "was_paused, self._steps = self._paused, 0"),
    Fault("the plant applies setpoints again", "plant_sim", "{link: [] for link in self.waiting}",
          "self.waiting"),
    Fault("the recorder writes messages again", "recorder", "        self.received.clear()\n", ""),
    Fault("refusals are logged each time", "admission.refusals",
          "if (topic, cause, source) not in self._reported:", "if True:"),
    Fault("refusals beyond the first are not counted", "admission.refusals",
          "self._refused[topic, cause, publisher] += 1", "self._refused[topic, cause, publisher] = 1"),
    Fault("all messages are kept", "admission.message_filter", "        state.begun = True\n",
          "        state.begun = True\n        self._peers[repr(information)] = self._peers[repr(data)] = False\n"),
    # Waits and ends.
    Fault("nodes wait a thousand times longer for readers at the end", "base.discovery",
          "    deadline = clock.monotonic() + timeout\n", "    deadline = clock.monotonic() + 1000.0 * timeout\n"),
    Fault("nodes wait for their peers for ever", "base.discovery", "        if late:\n", "        if False:\n"),
    Fault("a stop signal is ignored", "base.spinner", "if running := not stop_requested():", "if running := True:"),
    Fault("why a node failed is not told", "base.run", "log.fatal(one_line(error), traced(error))", "pass"),
    Fault("a stopped plant does not publish why", "frame_source",
          "self.publish_state(RunState.ENDED, tick(), reason)", "pass"),
    Fault("the recorder does not flush", "recorder", "                self.writer.flush()\n", "                pass\n"),
    # Order.
    Fault("changes are not published", "admission.member", "            self._publish_change(kind, name, value)\n", ""),
    Fault("changes are published with a later tick", "admission.member",
          "name=name, tick=self._tick)", "name=name, tick=self._tick + 1)"),
    Fault("an estimate of the same tick is used", "input_collector",
          "due = [content for at, content in self._messages if at < tick]",
          "due = [content for at, content in self._messages if at <= tick]"),
    Fault("setpoints are in the order of their arrival", "wan_link",
          "        self.received[controller].append(rows)\n",
          "        next(iter(self.received.values())).append(rows)\n"),
)  # fmt: skip


def insert(fault: Fault) -> Callable[[], None]:
    """Insert a fault into this process: functions and methods of the module get the code of the changed text.

    Returns a function that takes it out again.
    """
    module: Any = importlib.import_module(f"facts_damping.nodes.{fault.module}")
    text = Path(module.__file__).read_text(encoding="utf-8")
    if text.count(fault.right) != 1:
        raise ValueError(f"{fault.what}: {text.count(fault.right)} places in {module.__name__}")
    changed: dict[str, Any] = {"__name__": module.__name__, "__file__": module.__file__}
    exec(compile(text.replace(fault.right, fault.wrong), module.__file__, "exec"), changed)
    replaced = list(_take_over(vars(module), changed))

    def take_out() -> None:
        for function, code in replaced:
            function.__code__ = code

    return take_out


def _take_over(functions: Any, changed: Any) -> Iterator[tuple[Any, types.CodeType]]:
    """Give functions the code of their changed namesakes; yields them with the code that they had."""
    for name, function in list(functions.items()):
        value, new = (getattr(row, "__wrapped__", row) for row in (function, changed.get(name)))  # of a context manager
        if isinstance(value, property):
            value, new = value.fget, new.fget
        if isinstance(value, types.FunctionType) and isinstance(new, types.FunctionType):
            yield value, value.__code__
            value.__code__ = new.__code__
        elif isinstance(value, type) and isinstance(new, type) and value.__module__ == new.__module__:
            yield from _take_over(vars(value), vars(new))


def found_within(fault: Fault, minutes: float, seed: int, jobs: int) -> tuple[float, Findings]:
    """Wall time in s until storms break a rule, and what they found."""
    began = time.monotonic()
    findings = search(minutes, seed, jobs, enough=lambda findings_so_far: bool(findings_so_far.broken))
    return time.monotonic() - began, findings


def main() -> None:
    """Insert one fault after another, each in a process of its own, and print a table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", type=int)
    arguments = parser.parse_args()
    chosen = range(len(FAULTS)) if arguments.only is None else [arguments.only]
    for number in chosen:
        fault = FAULTS[number]
        take_out = insert(fault)
        seconds, findings = found_within(fault, arguments.minutes, arguments.seed, arguments.jobs)
        rule = next(iter(findings.broken), "NOT FOUND")
        sys.stdout.write(f"| {number} | {fault.what} | {seconds:.0f} | {findings.storms} | {rule[:90]} |\n")
        sys.stdout.flush()
        take_out()


if __name__ == "__main__":
    main()
