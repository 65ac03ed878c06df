"""Shared by all tests: the same examples every time, what may run side by side, a ROS domain for every graph."""

from __future__ import annotations

import itertools
import os
import socket
from contextlib import ExitStack, contextmanager, suppress
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from collections.abc import Iterator

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


# A minute and more each: of those begun last, one would be waited for alone.
_LONG = (
    *(
        "test_extensions.py",
        "test_packaging.py",
        "test_habits.py",
        "test_command.py",
        "test_search.py",
        "test_sweep.py",
    ),
    *("test_what_holds.py", "test_site.py", "test_reference.py", "test_graph.py", "test_nodes.py", "test_replay.py"),
)


@pytest.hookimpl(tryfirst=True)  # before xdist reads the groups
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Groups for `pytest -n`: files run side by side, long ones and those with graphs first."""
    items.sort(key=lambda item: (item.path.name not in _LONG, not _has_graph(item)))
    for item in items:
        if item.get_closest_marker("xdist_group") is None:
            item.add_marker(pytest.mark.xdist_group(item.path.name))


def _has_graph(item: pytest.Item) -> bool:
    return not {"domain", "module_domain"}.isdisjoint(getattr(item, "fixturenames", []))


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
