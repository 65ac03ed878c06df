"""A browser on the cockpit of a real graph in lockstep, by keyboard alone, and what the recording has of it."""

from __future__ import annotations

import re
import shutil
import signal
import subprocess
import sys
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.monitor_table import STATES
from facts_damping.recording.reader import load
from tests.passed import inputs

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

pytestmark = inputs(contents=["facts_damping/**/*", "config/**/*"])

CHROMIUM = shutil.which("chromium")
RUN = [sys.executable, "-m", "facts_damping", "run", "two_area_deployment", "--supervised", "--cockpit", "0"]
LONG = ["--set", "duration=3600", "--set", "scenario=[]", "--set", "load_noise=null", "--set", "watchdog=null"]
PATIENCE_MS = 60_000
SWING = "Difference of frequencies"  # the chart that shows it
WIDTHS = ((1440, "light"), (1024, "dark"), (400, "light"))


@pytest.fixture
def page(domain: int, tmp_path: Path) -> Iterator[Any]:
    """A page of a graph that runs in lockstep; nothing was asked for outside, and nothing went wrong."""
    from playwright.sync_api import sync_playwright  # noqa: PLC0415 (a hundred megabytes)

    run = subprocess.Popen([*RUN, *LONG, "--out", str(tmp_path / "out")], stdout=subprocess.PIPE, text=True)
    try:
        assert run.stdout is not None
        address = next(found[0] for line in run.stdout if (found := re.search(r"http://\S+", line)))
        with sync_playwright() as driver:
            browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"])
            made, wrong, asked = browser.new_page(), list[str](), list[str]()
            made.on("pageerror", lambda one: wrong.append(str(one)))
            made.on("console", lambda one: wrong.append(one.text) if one.type == "error" else None)
            made.on("request", lambda one: asked.append(one.url))
            made.goto(address)
            made.wait_for_selector("#run:has-text('running')", timeout=PATIENCE_MS)
            yield made
            browser.close()
        assert (wrong, [url for url in asked if not url.startswith(address)]) == ([], [])
    finally:
        run.send_signal(signal.SIGINT)
        run.wait(60)


def newest(page: Any, curve: str, group: str) -> list[float]:
    """Values of a curve in the rows that the page holds, newest last."""
    found: list[float] = page.evaluate(
        """([label, group]) => { const panel = globalThis.cockpit.panels[0];
        const k = panel.panel.curves.findIndex((one) => one.label === label && one.group === group);
        return panel.rows.slice(-200).map((row) => row[k + 2]); }""",
        [curve, group],
    )
    return found


def press(page: Any, control: str, *keys: str) -> None:
    """Focus a control's input, and press keys."""
    page.locator(
        f"[data-control='{control}'] input, button[data-control='{control}'], form[data-control='{control}'] select"
    ).first.focus()
    for key in keys:
        page.keyboard.press(key)


@pytest.mark.skipif(CHROMIUM is None, reason="needs Debian's chromium: apt install chromium")
def test_delay_makes_the_swing_grow_until_the_supervisor_trips(page: Any, tmp_path: Path) -> None:
    for width, scheme in WIDTHS:
        page.set_viewport_size({"width": width, "height": 900})
        page.emulate_media(color_scheme=scheme)
        assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.set_viewport_size({"width": 1440, "height": 900})
    print(
        page.evaluate("Object.keys(globalThis.cockpit)"),
        page.evaluate("Object.keys(globalThis.cockpit.panels?.[0] ?? {})"),
    )
