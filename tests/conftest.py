"""Shared by all tests: a ROS domain of its own for every test that runs a graph."""

from __future__ import annotations

import itertools

import pytest

_DOMAINS = itertools.count(1)


@pytest.fixture
def domain(monkeypatch: pytest.MonkeyPatch) -> int:
    """A ROS_DOMAIN_ID that no other test of this session uses, in the environment."""
    number = next(_DOMAINS)
    assert number <= 101, "ROS domains go up to 101"
    monkeypatch.setenv("ROS_DOMAIN_ID", str(number))
    monkeypatch.setenv("ROS_PYTHON_CHECK_FIELDS", "1")
    return number
