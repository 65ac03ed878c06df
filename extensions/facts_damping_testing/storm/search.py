"""Runs many storms on all cores: new ones, and varied ones of those that reached something new."""

from __future__ import annotations

import gc
import multiprocessing
import os
import random
import shutil
import signal
import time
from collections import Counter
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from multiprocessing.connection import Connection, wait
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.case.loading import make_case
from facts_damping.errors import FactsDampingError, InputError
from facts_damping.extras import library
from facts_damping.interruption import INTERRUPTIONS, blocked, exit_now, tie_to_parent
from facts_damping.nodes.launching import preload
from facts_damping_testing.storm import drawing, running
from facts_damping_testing.storm.choices import Chance
from facts_damping_testing.storm.rules import violations
from facts_damping_testing.storm.shrinking import fingerprint, shrink

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from facts_damping_testing.storm.model import Storm
    from facts_damping_testing.storm.running import Trace

HANGS_S = 60.0  # wall time after which a storm counts as hanging
TRACED = 40  # one storm in so many is traced line by line, which makes it twice as slow
LONG = 0.03  # fraction of new storms that take minutes of simulated time
VARIED = 0.5  # fraction of storms that vary an earlier one, once there are some
RAM = Path("/dev/shm")  # noqa: S108 (a file system in memory, if there is one)


class Result(NamedTuple):
    """What a storm showed: violations of rules, what it reached, and simulated seconds of the world and the plant."""

    violations: list[tuple[str, str]]
    reached: frozenset[str]
    world_s: float
    plant_s: float


def in_memory() -> TemporaryDirectory[str]:
    """A folder for the files of storms, in memory if possible."""
    return TemporaryDirectory(prefix="storms-", dir=RAM if RAM.is_dir() else None)


def try_storm(storm: Storm, *, traced: bool = False, place: Path | None = None) -> Result:
    """Run and judge a storm; `place`: for its files. Raises `InputError` if it is none."""
    with in_memory() if place is None else TemporaryDirectory(dir=place) as folder:
        lines: list[str] = []
        coverage = _coverage() if traced else None
        if coverage is None:
            trace = running.run(storm, Path(folder))
        else:
            watch = coverage.Coverage(source=[str(Path(preload.__file__).parents[1])], data_file=None)
            with watch.collect():
                trace = running.run(storm, Path(folder))
            data = watch.get_data()
            lines = [f"{file}:{line}" for file in data.measured_files() for line in data.lines(file) or ()]
        broken = violations(trace)
    plant_s = 0.0 if trace.record is None else len(trace.record.ticks) / trace.record.frame_rate
    return Result(broken, frozenset([*lines, *_reached(trace)]), trace.world_s, plant_s)


def _coverage() -> Any:
    """The library that traces lines, if it is installed."""
    with suppress(InputError):
        return library("coverage", "test")
    return None


def _reached(trace: Trace) -> Iterator[str]:
    """Features of a trace: pairs of kinds of events with the supervisor's state, logged texts, ends."""
    rows = None if trace.record is None else trace.record.supervision
    for done in trace.timeline:
        states = set() if rows is None else set(rows["state"][rows["tick"] == done.tick].tolist())
        yield from (f"{done.kind} in {state} of {trace.mode}" for state in states or {"no state"})
    yield from (_template(text) for _, _, _, text in trace.logs)
    yield fingerprint("ends", trace.reason)


def _template(text: str) -> str:
    """What is the same in each text of a log: without numbers, names and values."""
    words = [word for word in text.split() if word.isalpha() and word.islower()]
    return " ".join(words[:8])


def vary(storm: Storm, chance: random.Random) -> Storm:
    """A storm like another one: another seed, with an event more, less or at another time."""
    case = make_case(dict(storm.run), "storm")
    events = list(storm.events)
    what = chance.choice(["more", "more", "less", "time", "seed", "mode"])
    if what == "more":
        events.append(drawing.event(Chance(chance, case, storm.mode)))
    elif what == "less" and events:
        events.pop(chance.randrange(len(events)))
    elif what == "time" and events:
        i = chance.randrange(len(events))
        at = min(max(-1.0, events[i].at + chance.gauss(0.0, 0.1)), case.ticks / case.run.frame_rate)
        events[i] = events[i].model_copy(update={"at": round(at, 4)})
    mode = chance.choice(drawing.MODES) if what == "mode" else storm.mode
    update = {"seed": chance.randrange(2**31), "mode": mode, "events": sorted(events, key=lambda event: event.at)}
    return storm.model_copy(update=update)


def next_storm(base: Storm | None, seed: int) -> Storm:
    """A storm like another one, if there is one and it can be varied; else a new one, which may be long."""
    chance = random.Random(seed)
    if base is not None:
        with suppress(FactsDampingError):
            return vary(base, chance)
    storm = drawing.draw(seed)
    return drawing.long(storm, chance) if chance.random() < LONG else storm


@dataclass
class Findings:
    """Result of many storms."""

    storms: int = 0
    world_s: float = 0.0
    plant_s: float = 0.0
    reached: set[str] = field(default_factory=set)
    kept: list[Storm] = field(default_factory=list)  # those that reached something new
    kinds: Counter[str] = field(default_factory=Counter)  # events by kind
    broken: dict[str, list[tuple[Storm, str]]] = field(default_factory=dict)  # by fingerprint: storms and texts
    complete: bool = False  # whether it came to its end

    def add(self, storm: Storm, result: Result) -> None:
        """Count a storm."""
        self.storms += 1
        self.world_s, self.plant_s = self.world_s + result.world_s, self.plant_s + result.plant_s
        self.kinds.update(event.kind for event in storm.events)
        if result.reached - self.reached:
            self.reached |= result.reached
            self.kept.append(storm)
        for rule, text in result.violations:
            self.broken.setdefault(fingerprint(rule, text), []).append((storm, text))


def _tie(parent: int, place: Path) -> None:
    """Leave interruptions to the parent, and end with it: if it was killed, also its files."""

    def end(*_: object) -> None:
        shutil.rmtree(place.parent, ignore_errors=True)
        exit_now(0)

    for number in INTERRUPTIONS:
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, end)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, INTERRUPTIONS)
    tie_to_parent(parent=parent)


def _work(pipe: Connection, core: int, parent: int, place: Path) -> None:
    """Try the storms that come, until the other end closes; of what is loaded nothing is garbage.

    All its threads are on one core: they take turns, and to wake one on another core costs four times as much. One that
    is woken lets the other finish first (SCHED_BATCH).
    """
    _tie(parent, place)
    if hasattr(os, "sched_setaffinity"):  # Linux
        os.sched_setaffinity(0, {core})
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    gc.freeze()
    gc.set_threshold(100_000, 50, 100)
    with suppress(EOFError):
        while True:
            make, traced = pipe.recv()
            storm = make()
            try:
                pipe.send((storm, try_storm(storm, traced=traced, place=place)))
            except InputError:
                pipe.send(None)
            except Exception as error:  # noqa: BLE001 (the storm's own, which is a finding, too)
                text = f"{type(error).__name__}: {error}"
                pipe.send((storm, Result([("storm", text)], frozenset(), 0.0, 0.0)))


class Worker:
    """A process that tries storms one by one; it is killed if one hangs."""

    def __init__(self, folder: str, number: int = 0) -> None:
        """`folder`: for files of storms; `number`: of the worker; others are on other cores, as far as there are."""
        self.make: Callable[[], Storm] | None = None
        cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else [0]
        self._core, self._place = cores[number % len(cores)], Path(folder) / str(number)
        self._begin()

    def _begin(self) -> None:
        context = multiprocessing.get_context("fork")
        self.pipe, other = context.Pipe()
        self._place.mkdir(exist_ok=True)
        passed = (other, self._core, os.getpid(), self._place)
        self._process = context.Process(target=_work, args=passed, daemon=True)
        with blocked():
            self._process.start()
        other.close()

    def send(self, make: Callable[[], Storm], traced: bool) -> None:
        """Give it a storm, as a function that makes it."""
        self.make, self.sent_s = make, time.monotonic()
        self.pipe.send((make, traced))

    def result(self) -> tuple[Storm, Result] | None:
        """Its storm and the result; None: the storm is none. A worker that died is started anew."""
        try:
            answer: tuple[Storm, Result] | None = self.pipe.recv()
        except EOFError:
            return self._dead("the process ended")
        self.make = None
        return answer

    def overdue(self) -> tuple[Storm, Result] | None:
        """A result if its storm hangs; the worker is then started anew."""
        if self.make is None or time.monotonic() - self.sent_s < HANGS_S:
            return None
        return self._dead(f"nothing within {HANGS_S:g} s: a node works without end")

    def _dead(self, why: str) -> tuple[Storm, Result] | None:
        self.close()
        self._begin()
        make, self.make = self.make, None
        return None if make is None else (make(), Result([("time_goes_on", why)], frozenset(), 0.0, 0.0))

    def close(self) -> None:
        """End it, and remove its files."""
        self.pipe.close()
        self._process.kill()
        self._process.join()
        shutil.rmtree(self._place, ignore_errors=True)


@contextmanager
def _workers(jobs: int) -> Iterator[list[Worker]]:
    """So many workers, with a folder for their files."""
    workers: list[Worker] = []
    with in_memory() as folder:
        try:
            for number in range(jobs):
                workers.append(Worker(folder, number))  # noqa: PERF401 (those that began end in any case)
            yield workers
        finally:
            for worker in workers:
                worker.close()


def search(
    minutes: float,
    seed: int,
    jobs: int,
    tell: Callable[[Findings], object] = lambda _: None,
    enough: Callable[[Findings], bool] = lambda _: False,
) -> Findings:
    """Try storms for some minutes, or until an interrupt; `seed`: of all of them.

    `tell`: called after each; `enough`: ends it early.
    """
    chance, findings, until = random.Random(seed), Findings(), time.monotonic() + 60.0 * minutes
    with suppress(KeyboardInterrupt), _workers(jobs) as workers:
        while time.monotonic() < until and not enough(findings):
            for worker in workers:
                if worker.make is None:
                    base = chance.choice(findings.kept) if findings.kept and chance.random() < VARIED else None
                    worker.send(partial(next_storm, base, chance.randrange(2**31)), findings.storms % TRACED == 0)
            ready = wait([busy.pipe for busy in workers], 1.0)
            for worker in workers:
                result = worker.result() if worker.pipe in ready else worker.overdue()
                if result is not None:
                    findings.add(*result)
                    tell(findings)
        findings.complete = True
    return findings


def shrunk(storm: Storm, mark: str, most: int = 200) -> Storm:
    """The mildest storm that violates the same rule in the same way; `mark`: its fingerprint."""

    def breaks(milder: Storm) -> bool:
        worker.send(milder.model_copy, False)
        late = None
        while late is None and not worker.pipe.poll(1.0):
            late = worker.overdue()
        result = worker.result() if late is None else late
        return result is not None and any(fingerprint(*violation) == mark for violation in result[1].violations)

    with _workers(1) as (worker,):
        return shrink(storm, breaks, most)
