"""What `pmu-listen` shows of a server: a line, a table, JSON."""

from __future__ import annotations

from facts_damping.c37118 import stations
from facts_damping.parameters.streams import server as address
from facts_damping.streaming.client import Lost
from facts_damping.streaming.heard import Heard
from tests.streaming.test_server import GRID, instant, served

SERVER = "tcp://pdc:4712/11"


def test_what_is_not_there_is_said() -> None:
    one = Heard(address(SERVER))
    assert str(one) == f"{SERVER}: no configuration: no answer; is the IDCODE right?"
    one.take(Lost("refused"))
    assert str(one) == f"{SERVER}: no configuration: refused"
    assert list(one.rows()) == []
    assert one.result() == {"server": SERVER, "rate": None, "frames": 0, "refused": {}, "lost": "refused", "pmus": []}


def test_a_configuration_and_the_newest_values() -> None:
    one = Heard(address(SERVER))
    one.take(served().configuration)
    assert {row[-1] for row in one.rows()} == {"-"}
    one.take(instant(0))
    one.take(instant(1))
    one.refused, one.why = {"CHK": 2}, "CHK: 0x0000 given"
    assert str(one) == f"{SERVER}: 2 PMUs, 60 frames/s; 2 frames have come, 2 refused (CHK: 0x0000 given)"
    rows = list(one.rows())
    assert [row[0] for row in rows if row[0]] == [station.name for station in GRID]
    assert [row[3] for row in rows[:5]] == ["STAT", "FREQ", "DFREQ", "V1", "V1 angle"]
    result = one.result()
    assert result["refused"] == {"CHK": 2}
    told = {row["name"]: row for row in result["pmus"][1]["channels"]}
    assert told["V1"] == {"name": "V1", "value": instant(1).data.phasors[2, 0], "unit": "V"}
    assert set(told) == {"STAT", "FREQ", "DFREQ", "V1", "V1 angle", "I1", "I1 angle", *stations.ANALOGS}
