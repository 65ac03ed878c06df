"""YAML 1.2: plain words are what its core schema says, and what is written is read back."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facts_damping.parameters.yaml_text import UNREADABLE, dump, parse

SCALARS = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text()
CONTENT = st.recursive(SCALARS, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner))


@pytest.mark.parametrize(
    ("text", "value"),
    [
        *(("no", "no"), ("on", "on"), ("12:30", "12:30"), ("1_000", "1_000"), ("2026-01-01", "2026-01-01")),
        *(("1e-3", 0.001), ("+.5", 0.5), ("1.", 1.0), ("-.inf", -math.inf), ("0o17", 15), ("0x1F", 31), ("017", 17)),
        *(("true", True), ("FALSE", False), ("~", None), ("", None), ("null", None), ("'1'", "1")),
        ("{<<: {a: 1, b: 2}, a: 3}", {"a": 3, "b": 2}),
        ("[&x {a: 1}, *x]", [{"a": 1}, {"a": 1}]),
    ],
)
def test_plain_words_are_those_of_the_core_schema(text: str, value: Any) -> None:
    parsed = parse(text)
    assert (parsed, type(parsed)) == (value, type(value))


@pytest.mark.parametrize(
    "text",
    ["{a: 1, a: 2}", "a: 1\nb: 2\na: 3", "[1, 2", "!!python/object:os.system x", "{[1]: 2}", "1: 2", "a: {~: 1}"],
)
def test_malformed_or_unsupported_yaml_is_refused(text: str) -> None:
    with pytest.raises(UNREADABLE):
        parse(text)


@settings(max_examples=40)
@given(CONTENT)
def test_dumped_yaml_is_parsed_to_the_same_content(content: Any) -> None:
    assert parse(dump(content)) == content
    assert parse(dump(content, flow=True)) == content


BOMB = "a0: &a0 [x]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 12))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (BOMB, "more than 1000000 values, aliases written out"),
        ("[" * 100_000 + "]" * 100_000, "more than 50 levels|maximum nesting depth"),  # newer libyaml has a limit, too
        ("{a: " * 5000 + "1" + "}" * 5000, "more than 50 levels"),
        ("- " * 60 + "1", "more than 50 levels"),
    ],
    ids=["aliases", "lists", "mappings", "blocks"],
)
def test_yaml_too_large_or_too_deep_is_refused_before_it_is_built(text: str, said: str) -> None:
    with pytest.raises(UNREADABLE, match=said):
        parse(text)


def test_some_aliases_and_levels_are_allowed() -> None:
    assert parse("a: &a [1, 2]\nb: [*a, *a]\n<<: {c: *a}") == {"a": [1, 2], "b": [[1, 2]] * 2, "c": [1, 2]}
    assert parse("[" * 49 + "]" * 49) is not None
