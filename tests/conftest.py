"""Shared by all tests: the same examples every time, what may run side by side, a ROS domain for every graph."""

from __future__ import annotations

import gc
import itertools
import os
import socket
from contextlib import ExitStack, contextmanager, suppress
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

from tests.budgets import recorded

if TYPE_CHECKING:
    from collections.abc import Iterator

# Before NumPy is loaded: as in the Makefile, on matrices as small as these threads wait longer than they work.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Of what is loaded nothing is garbage: looking for it takes a quarter of the time until the first test.
gc.disable()

# No test hangs on chance or on how long an example takes; `make explore` looks for other examples.
settings.register_profile("same", derandomize=True, deadline=None, database=None)
settings.register_profile("explore", deadline=None, database=None, print_blob=True)
settings.load_profile("same")

os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"  # before anything loads messages, also what nodes are copies of

# Each of the processes of `pytest -n` tries its own; what one had before is long gone when it comes again.
_PROCESS, _PROCESSES = (
    os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:],
    os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"),
)
_DOMAINS = itertools.cycle(range(1 + int(_PROCESS), 102, int(_PROCESSES)))


@pytest.hookimpl(tryfirst=True)  # before xdist reads the groups
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Groups for `pytest -n`: files run side by side, those first that take longest, as far as is on record."""
    dear = {name: -cost.seconds for name, cost in recorded().items()}
    items.sort(key=lambda item: dear.get(item.path.relative_to(item.config.rootpath).as_posix(), 0.0))
    for item in items:
        if item.get_closest_marker("xdist_group") is None:
            item.add_marker(pytest.mark.xdist_group(item.path.name))


def pytest_collection_finish() -> None:
    """From here on garbage is looked for, but not among what was loaded."""
    gc.freeze()
    gc.enable()


@pytest.fixture
def domain() -> Iterator[int]:
    """A ROS_DOMAIN_ID that no other graph uses, in the environment."""
    with _new_domain() as number:
        yield number


@pytest.fixture(scope="module")
def module_domain() -> Iterator[int]:
    """One for all tests of a module, which share what a graph has left."""
    with _new_domain() as number:
        yield number


@contextmanager
def _new_domain() -> Iterator[int]:
    """Taken by a socket without a file: other runs of the tests on this machine take other domains."""
    with socket.socket(socket.AF_UNIX) as held, pytest.MonkeyPatch.context() as patched:
        for number in _DOMAINS:
            with suppress(OSError):
                held.bind(f"\0facts_damping_domain_{number}")
                break
        patched.setenv("ROS_DOMAIN_ID", str(number))
        patched.setenv("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")  # for the tests' own nodes, and the commands of ROS 2
        yield number


_BASES = itertools.cycle(range(20000 + 10 * int(_PROCESS), 30000, 10 * int(_PROCESSES)))  # not by chance


@pytest.fixture
def port() -> int:
    """A port of this computer that is free, as are the nine after it."""
    for base in _BASES:
        with ExitStack() as held, suppress(OSError):
            for number in range(base, base + 10):
                held.enter_context(socket.socket()).bind(("127.0.0.1", number))
            break
    return base
