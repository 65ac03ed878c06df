"""Digests: what enters them, and those of a table of runs; `test_processors.py` has them on other processors."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

import facts_damping as fd
from facts_damping.digest import canonical, digest
from tests.data import digests as table

ROWS = {row["name"]: row for row in table.rows()}


@pytest.mark.parametrize("name", ROWS)
def test_run_has_the_digest_of_the_table(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.chdir(table.ROOT)
    assert table.computed(ROWS[name]) == ROWS[name]["digest"]


@pytest.fixture(scope="module")
def result() -> fd.Result:
    return fd.simulate("two_area_centralised", duration=0.5)


def with_array(result: fd.Result, name: str, array: Any) -> fd.Result:
    changed: dict[str, Any] = {name: array}
    return replace(result, **changed)


ARRAYS = [field.name for field in fields(fd.Result) if str(field.type).startswith("NDArray")]


def test_digest_is_that_of_its_signals(result: fd.Result) -> None:
    assert len(result.digest) == 16
    int(result.digest, 16)
    assert result.digest == digest(replace(result, notes=["cut"], versions={}, publishers={"/a 1": "b"}))
    assert result.digest == digest(replace(result, configuration={}))
    assert len(ARRAYS) == 14


@pytest.mark.parametrize("name", ARRAYS)
def test_digest_depends_on_every_array_of_a_result(result: fd.Result, name: str) -> None:
    before = getattr(result, name)
    if before.size:
        bits = before.copy().view(np.uint8).reshape(-1)
        bits[-1] ^= 1
        assert with_array(result, name, bits.view(before.dtype).reshape(before.shape)).digest != result.digest
    assert with_array(result, name, np.zeros((7, *before.shape[1:]), before.dtype)).digest != result.digest


def test_monitor_that_came_later_enters_where_its_value_is_known() -> None:
    supervised = fd.simulate("two_area_supervised", duration=0.5)
    rows: Any = supervised.supervision.copy()
    assert np.isnan(rows["values"][:, 23:]).all()
    rows["values"][-1, 23] = 0.0
    assert with_array(supervised, "supervision", rows).digest != supervised.digest
    rows["values"][-1, 22:] = 7.0, np.nan
    assert with_array(supervised, "supervision", rows).digest != supervised.digest


def test_names_and_signs_enter_but_not_how_a_computer_writes_numbers(result: fd.Result) -> None:
    assert digest(replace(result, device_names=["statcom", "sssc"])) != result.digest
    for name in ARRAYS:
        array = getattr(result, name)
        assert with_array(result, name, array.astype(array.dtype.newbyteorder(">"))).digest == result.digest
    frames: Any = np.zeros_like(result.frames)
    assert digest(replace(result, frames=frames)) != digest(replace(result, frames=-frames))
    others = np.array([0x7FF8000000000000, 0xFFF8000000000000, 0x7FF0000000000001], np.uint64).view(np.float64)
    assert len(set(canonical(others).view(np.uint64).tolist())) == 1
    rows = np.zeros(3, [("tick", "i8"), ("value", "f8")])
    rows["value"] = others
    assert len(set(canonical(rows).tolist()[0][:1])) == 1
    assert canonical(rows)[0].tobytes() == canonical(rows)[2].tobytes()
