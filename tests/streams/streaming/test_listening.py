"""What `pmu-listen` shows of a server: a line, a table, JSON."""

from __future__ import annotations

import asyncio
import json
import sys
from typing import TYPE_CHECKING

from facts_damping.cli.main import main
from facts_damping_streams.c37118 import system_pmus
from facts_damping_streams.parameters import server as address
from facts_damping_streams.streaming.client import Lost
from facts_damping_streams.streaming.listening import ServerState
from tests.commands import assert_one_line
from tests.streams.streaming.test_server import GRID, HERE, instant, run, served, until

if TYPE_CHECKING:
    from pathlib import Path

    import pytest

    from facts_damping_streams.streaming.server import Server

SERVER = "tcp://pdc:4712/11"


def test_server_without_a_configuration_is_shown_with_the_cause() -> None:
    state = ServerState(address(SERVER))
    assert str(state) == f"{SERVER}: no configuration: no answer; is the IDCODE right?"
    state.take(Lost("refused"))
    assert str(state) == f"{SERVER}: no configuration: refused"
    assert list(state.rows()) == []
    assert state.result() == {"server": SERVER, "rate": None, "frames": 0, "refused": {}, "lost": "refused", "pmus": []}


def test_configuration_and_the_newest_values() -> None:
    state = ServerState(address(SERVER))
    state.take(served().configuration)
    assert {row[-1] for row in state.rows()} == {"-"}
    state.take(instant(0))
    state.take(instant(1))
    state.refused, state.why = {"CHK": 2}, "CHK: 0x0000 given"
    assert str(state) == f"{SERVER}: 2 PMUs, 60 frames/s; 2 frames have come, 2 refused (CHK: 0x0000 given)"
    rows = list(state.rows())
    assert [row[0] for row in rows if row[0]] == [pmu.name for pmu in GRID]
    assert [row[3] for row in rows[:5]] == ["STAT", "FREQ", "DFREQ", "V1", "V1 angle"]
    result = state.result()
    assert result["refused"] == {"CHK": 2}
    channels = {row["name"]: row for row in result["pmus"][1]["channels"]}
    assert channels["V1"] == {"name": "V1", "value": instant(1).data.phasors[2, 0], "unit": "V"}
    assert set(channels) == {"STAT", "FREQ", "DFREQ", "V1", "V1 angle", "I1", "I1 angle", *system_pmus.ANALOGS}


def test_command_shows_what_a_server_sends(tmp_path: Path) -> None:
    async def act(server: Server) -> bytes:
        where = f"tcp://{HERE}:{server.ports[0]}/11"
        options = ["--seconds", "2", "--json", str(tmp_path / "heard.json")]
        command = [sys.executable, "-m", "facts_damping", "pmu-listen", where, *options]
        listens = await asyncio.create_subprocess_exec(*command, stdout=asyncio.subprocess.PIPE)
        await until(lambda: server.listening == 1)
        server.send(instant(0))
        return (await listens.communicate())[0]

    out, _ = run(act)
    lines = out.decode().splitlines()
    assert lines[0].endswith("2 PMUs, 60 frames/s; 1 frames have come")
    assert {pmu.name for pmu in GRID} <= {line.split()[0] for line in lines}
    (row,) = json.loads((tmp_path / "heard.json").read_text())["servers"]
    assert (row["frames"], row["lost"]) == (1, None)


def test_server_that_is_silent_is_one_line(port: int, capsys: pytest.CaptureFixture[str]) -> None:
    where = f"tcp://{HERE}:{port}/11"
    assert main(["pmu-listen", where, "--seconds", "0.2"]) == 1
    assert f"{where}: no configuration: " in capsys.readouterr().err
    assert_one_line(2, ["pmu-listen", where, "--out", "x"], "--out: given without --run; allowed: with", capsys)
