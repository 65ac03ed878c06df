"""Shared by all tests: a ROS domain of its own for every test that runs a graph, and what may run side by side."""

from __future__ import annotations

import itertools

import pytest

_DOMAINS = itertools.count(1)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Groups for `pytest -n`: files run side by side, graphs one after the other, from the start."""
    items.sort(key=lambda item: "domain" not in _fixtures(item))
    for item in items:
        item.add_marker(pytest.mark.xdist_group("graphs" if "domain" in _fixtures(item) else item.path.name))


def _fixtures(item: pytest.Item) -> list[str]:
    return getattr(item, "fixturenames", [])


@pytest.fixture
def domain(monkeypatch: pytest.MonkeyPatch) -> int:
    """A ROS_DOMAIN_ID that no other test of this session uses, in the environment."""
    number = next(_DOMAINS)
    assert number <= 101, "ROS domains go up to 101"
    monkeypatch.setenv("ROS_DOMAIN_ID", str(number))
    monkeypatch.setenv("ROS_PYTHON_CHECK_FIELDS", "1")
    return number
