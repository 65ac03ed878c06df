"""Shared by all tests: a ROS domain of its own for every test that runs a graph, and what may run side by side."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

_DOMAINS = itertools.cycle(range(1, 102))  # what one had before is long gone when it comes again


@pytest.hookimpl(tryfirst=True)  # before xdist reads the groups
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Groups for `pytest -n`: files run side by side, graphs one after the other, from the start."""
    items.sort(key=lambda item: not _has_graph(item))
    for item in items:
        item.add_marker(pytest.mark.xdist_group("graphs" if _has_graph(item) else item.path.name))


def _has_graph(item: pytest.Item) -> bool:
    return not {"domain", "module_domain"}.isdisjoint(getattr(item, "fixturenames", []))


@pytest.fixture
def domain(monkeypatch: pytest.MonkeyPatch) -> int:
    """A ROS_DOMAIN_ID that no other graph uses, in the environment."""
    return _new_domain(monkeypatch)


@pytest.fixture(scope="module")
def module_domain() -> Iterator[int]:
    """One for all tests of a module, which share what a graph has left."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        yield _new_domain(monkeypatch)


def _new_domain(monkeypatch: pytest.MonkeyPatch) -> int:
    number = next(_DOMAINS)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(number))
    monkeypatch.setenv("ROS_PYTHON_CHECK_FIELDS", "1")
    return number
