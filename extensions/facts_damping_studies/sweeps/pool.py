"""Parallel runs in local processes or on a Dask cluster; results are yielded as they finish."""

from __future__ import annotations

import os
import signal
import warnings
from contextlib import contextmanager, nullcontext
from functools import partial
from itertools import islice
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING, Any

from joblib import Parallel, delayed, parallel_config
from joblib.externals.loky.backend import resource_tracker as loky_tracker
from joblib.externals.loky.process_executor import TerminatedWorkerError
from threadpoolctl import threadpool_limits

from facts_damping.errors import InputError, RunError
from facts_damping.extras import library
from facts_damping.interruption import (
    INTERRUPTIONS,
    blocked,
    clean_up_first,
    ensure_tracker,
    script_apart,
    tie_to_parent,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    Each = Callable[[Callable[[Any], Any], Sequence[Any]], Iterator[Any]]

CONNECT_S = 10  # s, time-out for connecting to a scheduler
MAX_AT_ONCE = 16  # largest batch per process: larger batches wait less, but a kill loses the current batch
TASKS_AHEAD = 4  # per thread of a cluster: keeps all threads busy and the scheduler small

# Joblib's warnings about an interrupted sweep, and about a replaced worker (memory growth or long idle time).
_JOBLIB_WARNINGS = r"\d+ tasks (have been successfully|which were still being)|A worker stopped while some jobs"

_state = {"worker": False}  # whether this process is a worker


def _worker(parent: int) -> None:
    """Ignore interrupts, which the parent handles; end when the parent ends."""
    _state["worker"] = True
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, INTERRUPTIONS)
    tie_to_parent(parent=parent)


def refuse_within() -> None:
    """Raise `RunError` in a worker, where a user's script is loaded only for a class in it."""
    if _state["worker"]:
        raise RunError('a sweep within a sweep given; allowed: in a script, below if __name__ == "__main__":')


@contextmanager
def workers(jobs: int, scheduler: str | None = None) -> Iterator[Each]:
    """Yield a function that maps a function over inputs and gives the results in order of completion.

    It uses `jobs` processes, or the cluster of the Dask scheduler at an address. Raises `InputError` if no scheduler
    answers, `RunError` if a process dies.
    """
    clean_up_first()
    if scheduler is None:
        yield partial(_in_processes, jobs)
        return
    distributed = library("distributed", "dask", where="--scheduler")
    try:
        client = distributed.Client(scheduler, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"--scheduler {scheduler}: no scheduler answers; allowed: a scheduler's address") from error
    with client:
        yield partial(_on_cluster, client)


def _in_processes(jobs: int, function: Callable[[Any], Any], todo: Sequence[Any]) -> Iterator[Any]:
    """Map in local processes with one BLAS thread each: for such small matrices more threads only slow it down."""
    warnings.filterwarnings("ignore", _JOBLIB_WARNINGS, UserWarning)
    many = min(jobs, max(1, len(todo)))
    batch = max(1, min(MAX_AT_ONCE, len(todo) // (8 * many)))
    begun = {"initializer": _worker, "initargs": (os.getpid(),)}
    with parallel_config("loky", inner_max_num_threads=1):
        pool = Parallel(n_jobs=many, return_as="generator_unordered", batch_size=batch, **begun)
    if many > 1:
        for tracker in (resource_tracker, loky_tracker):  # first: they unblock signals when they start
            ensure_tracker(tracker)
    try:
        with script_apart(), threadpool_limits(1) if many == 1 else nullcontext():
            with blocked():
                results = pool(delayed(function)(task) for task in todo)
            yield from results
    except TerminatedWorkerError as error:
        raise RunError("a process of the sweep was killed, perhaps out of memory: try fewer --jobs") from error


def _on_cluster(client: Any, function: Callable[[Any], Any], todo: Iterable[Any]) -> Iterator[Any]:
    from distributed import as_completed  # noqa: PLC0415 (an optional extra)

    ahead = max(1, TASKS_AHEAD * sum(client.nthreads().values()))
    left = iter(todo)
    running = as_completed(
        [client.submit(function, task, pure=False) for task in islice(left, ahead)], loop=client.loop
    )
    for future in running:
        try:
            result = future.result()
        except Exception as error:
            raise RunError(f"--scheduler: {type(error).__name__}: {error}") from error
        yield result
        for task in left:
            running.add(client.submit(function, task, pure=False))
            break


def _numbered(function: Callable[[Any], Any], numbered: tuple[int, Any]) -> tuple[int, Any]:
    return numbered[0], function(numbered[1])


def run_all(
    function: Callable[[Any], Any], todo: Sequence[Any], jobs: int, progress: Callable[[int, int], None]
) -> list[Any]:
    """Results of `function` for all inputs in their order, with `jobs` processes."""
    results: dict[int, Any] = {}
    progress(0, len(todo))
    with workers(jobs) as each:
        for i, result in each(partial(_numbered, function), list(enumerate(todo))):
            results[i] = result
            progress(len(results), len(todo))
    return [results[i] for i in range(len(todo))]
