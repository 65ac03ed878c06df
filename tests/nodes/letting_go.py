"""Whether devices let go in time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from facts_damping.analysis.summary import summarise
from facts_damping.signals import NANOSECONDS
from facts_damping.studies.campaigns.invariants import late_ticks

if TYPE_CHECKING:
    from facts_damping.case.model import Case
    from facts_damping.signals import Record

SLACK = 3  # ticks: a release by the wall clock is noticed once a tick, and recorded at the next


def assert_let_go(case: Case, record: Record, deadline_misses: int) -> None:
    """Each device is released to the end, and at zero within time-out and ramp after the last setpoint that acted.

    On a loaded machine that may have been later than its link said, by as many ticks as the plant had deadline misses.
    """
    watchdog = case.run.watchdog
    assert watchdog is not None
    released = record.devices["released"] == 1.0
    slack = (SLACK + late_ticks(record, deadline_misses)) * NANOSECONDS // case.run.frame_rate
    for d, name in enumerate(case.run.devices):
        assert released[-1, d]
        first = int(np.flatnonzero(~released[:, d]).max()) + 1
        acted = record.applied[(record.applied["device"] == d) & (record.applied["tick"] < first)]
        last = int(np.maximum(acted["effective_ns"], record.time_ns[acted["tick"]]).max(initial=0))
        assert record.time_ns[first] <= last + int(watchdog.timeout * NANOSECONDS) + slack
        ramp = case.system.device(name).setpoint_max / watchdog.release_rate
        rest = record.time_ns > record.time_ns[first] + int(ramp * NANOSECONDS) + slack
        assert not record.devices["reference"][rest, d].any()
    assert [row["rearmed_s"] for row in summarise(record)["releases"]] == [None] * len(case.run.devices)
