"""Rows of studies: what tells runs apart."""

from __future__ import annotations

from facts_damping.case.loading import load_case
from facts_damping_studies.sweeps.batch import identity


def test_fallback_is_not_what_is_studied() -> None:
    sets = ["controllers.0.name=HBsWC", "controllers.0.scheme=direct", "supervision=standard"]
    reserve = "controllers.+={name: ANFTSC, scheme: indirect, fallback_of: 0, signals: [power]}"
    alone, with_reserve = (identity(load_case("two_area_large", [*sets, *more])) for more in ([], [reserve]))
    assert alone == with_reserve == {"controller": "HBsWC@two_area", "scheme": "direct", "seed": 0}
