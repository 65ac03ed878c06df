"""What tests of pages share: a table in the docs against one made anew."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Sequence

NUMBER = re.compile(r" -?[\d.e+-]*\d ")


def assert_same_lines(written: Sequence[str], made: Sequence[str], rel: float = 0.02) -> None:
    """Numbers may differ by what another machine's rounding makes of a limit cycle."""
    assert len(written) == len(made)
    for old, new in zip(written, made, strict=True):
        ours, theirs = new.split("|"), old.split("|")
        assert len(ours) == len(theirs)
        for a, b in zip(ours, theirs, strict=True):
            if NUMBER.fullmatch(a) and NUMBER.fullmatch(b):
                assert float(a) == pytest.approx(float(b), rel=rel, abs=1e-9), (old, new)
            else:
                assert a == b, (old, new)
