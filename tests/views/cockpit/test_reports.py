"""Reports of a cockpit: one at a time, shared by those who ask for it, and ended when they have gone."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import pytest

from facts_damping_views.cockpit import application
from tests.views.cockpit.serving import request, serving

LAYOUT: dict[str, Any] = {"type": "layout", "title": "it", "mode": "live", "panels": [], "duration": None}
# In place of the command; its arguments are -m facts_damping analyze RECORDING --report PAGE.
SCRIPT = '#!/bin/sh\necho "$4 $$ $6" >> {log}\ncase $4 in slow) exec sleep 60;; esac\necho done > "$6"\n'
PATIENCE_S = 20.0


@pytest.fixture
def log(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """The file in which each computed report has a line: recording, process, page."""
    script, file = tmp_path / "python", tmp_path / "log"
    script.write_text(SCRIPT.format(log=file))
    script.chmod(0o700)
    file.touch()
    monkeypatch.setattr(sys, "executable", str(script))
    return file


def until(condition: Any) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_report_is_shared_and_ends_with_its_last_client(log: Path) -> None:
    """Two clients ask for the same report and a third for another, which is next."""
    cockpit = application.Cockpit(application.Content(LAYOUT, recordings={"one": "slow", "two": "fast"}))
    with serving(cockpit) as (served, _):
        first, second = (request(served.address, "/report/one") for _ in range(2))
        until(log.read_text)
        with request(served.address, "/report/two") as third:
            first.close()
            time.sleep(0.2)
            ((recording, process, page),) = (line.split() for line in log.read_text().splitlines())
            assert (recording, Path(f"/proc/{process}").exists()) == ("slow", True)
            second.close()
            assert third.recv(100).startswith(b"HTTP/1.1 200 ")
        assert not Path(f"/proc/{process}").exists()
        assert not Path(page).parent.exists()
    assert log.read_text().count("slow") == 1


def test_report_ends_with_the_server(log: Path) -> None:
    with serving(application.Cockpit(application.Content(LAYOUT, recordings={"one": "slow"}))) as (served, _):
        client = request(served.address, "/report")
        until(log.read_text)
        _, process, page = log.read_text().split()
    client.close()
    assert not Path(f"/proc/{process}").exists()
    assert not Path(page).parent.exists()
