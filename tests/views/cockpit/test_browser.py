"""A browser on the cockpit of a real graph in lockstep, by keyboard alone, and what the recording has of it."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.case.loading import load_case
from facts_damping.monitor_table import STATES
from facts_damping.recording.reader import load
from facts_damping_views.cockpit import application, layout, words
from facts_damping_views.cockpit.controls import controls
from tests.chromium import CHROMIUM, START, needs_browser
from tests.passed import inputs
from tests.views.cockpit.serving import serving

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = inputs(
    contents=[
        "facts_damping/**/*",
        "extensions/**/*",
        "config/**/*",
        "tests/chromium.py",
        "tests/views/cockpit/serving.py",
    ]
)

PROGRAM, RUN = [sys.executable, "-m", "facts_damping"], ["two_area_deployment", "--supervised"]
CALM = ("scenario=[]", "load_noise=null", "watchdog=null")
PATIENCE_MS = 90_000
NODE = "controller_0_LLC_tuned"
PARTS = "xpath=self::button | .//input | .//select | .//button"  # of a control, those that take keys
WIDTHS = ((1440, "light"), (1024, "dark"), (400, "light"))
# Largest less smallest value of a curve between two simulated times, from the rows that the page holds.
RANGE = """([label, group, from, to]) => { const panel = globalThis.cockpit.panels[0];
  const k = 2 + panel.curves.findIndex((one) => one.label === label && one.group === group);
  const own = panel.rows.filter((row) => row[0] >= from && row[0] <= to).map((row) => row[k]).filter(Number.isFinite);
  return Math.max(...own) - Math.min(...own); }"""


class Browser:
    """A page of a graph, and what went wrong in it."""

    def __init__(self, page: Any, address: str) -> None:
        self.page, self.origin, self.wrong = page, address.partition("?")[0], list[str]()
        self.status, self.output = 0, ""  # of the command, once it has ended
        page.on("pageerror", lambda error: self.wrong.append(str(error)))
        page.on("console", lambda message: self.wrong.append(message.text) if message.type == "error" else None)
        page.on("request", lambda request: self.asked(request.url))
        page.goto(address)
        page.wait_for_selector("#run:has-text('running')", timeout=PATIENCE_MS)

    def asked(self, url: str) -> None:
        """Note a request to anywhere else."""
        if not url.startswith((self.origin, self.origin.replace("http", "ws"), "data:")):
            self.wrong.append(url)

    def until(self, condition: str) -> None:
        """Wait until an expression of the page's state is true."""
        self.page.wait_for_function(
            f"(({{status, time, panels}}) => {condition})(globalThis.cockpit)", timeout=PATIENCE_MS
        )

    @property
    def time(self) -> float:
        """Simulated time that is shown, s."""
        return float(self.page.evaluate("globalThis.cockpit.time"))

    def passes(self, seconds: float) -> tuple[float, float]:
        """Wait for some simulated time. Returns its begin and end."""
        begin = self.time
        self.until(f"time > {begin + seconds}")
        return begin, begin + seconds

    def press(self, control: str, *keys: str) -> None:
        """Focus a control, and press keys."""
        parts = self.page.locator(f"[data-control='{control}']").locator(PARTS)
        parts.first.focus()
        for key in keys:
            self.page.keyboard.press(key) if len(key) > 1 else self.page.keyboard.type(key)


@contextmanager
def browser(folder: Path, command: list[str], sets: tuple[str, ...]) -> Iterator[Browser]:
    """A page that a command serves, whose recording is in the folder; nothing may go wrong in it."""
    from playwright.sync_api import sync_playwright  # noqa: PLC0415 (a hundred megabytes)

    options = [*(part for setting in sets for part in ("--set", setting)), "--out", str(folder)]
    with subprocess.Popen([*PROGRAM, *command, *options], stdout=subprocess.PIPE, text=True) as run:
        try:
            assert run.stdout is not None
            address = next(match[0] for line in run.stdout if (match := re.search(r"http://\S+", line)))
            with sync_playwright() as driver:
                started = driver.chromium.launch(executable_path=CHROMIUM, args=START)
                page_of_run = Browser(started.new_page(bypass_csp=True), address)
                yield page_of_run
                started.close()
            assert page_of_run.wrong == []
        finally:
            run.terminate()  # SIGINT is ignored where a script has started all of this by `&`
            killer = threading.Timer(PATIENCE_MS / 1e3, run.kill)
            killer.start()
            rest, _ = run.communicate()
            killer.cancel()
            print(rest)  # shown if the test fails
        page_of_run.status, page_of_run.output = run.returncode, rest


def plant_of(folder: Path) -> int:
    """Process number of the plant of a graph, by its folder."""
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):  # it may have ended
            command = path.read_text()
            if command.startswith("facts_damping.nodes.plant_sim") and f"{folder}/run.yaml" in command:
                return int(path.parent.name)
    raise AssertionError(f"no plant of {folder}")


@needs_browser
def test_delay_makes_the_swing_grow_until_the_supervisor_trips(domain: int, tmp_path: Path) -> None:
    """By keyboard alone, in lockstep; the link is cut and mended, too. The recording has all of it."""
    swings = []
    with browser(tmp_path, ["run", *RUN, "--cockpit", "0"], ("duration=3600", *CALM)) as page:
        for width, scheme in WIDTHS:
            page.page.set_viewport_size({"width": width, "height": 900})
            page.page.emulate_media(color_scheme=scheme)
            assert page.page.evaluate("document.documentElement.scrollWidth") <= width
        page.page.set_viewport_size({"width": 1440, "height": 900})
        page.until(f"status.states['{NODE}'] === 'armed'")
        for delay in (0, 270):  # 263 ms is the margin; with 300 ms, synchronism is lost before the end
            page.press("link/wan_link/delay", "Tab", "Control+a", *str(delay), "Enter")
            page.press("grid/fault", "Tab", "Tab", "Enter")
            page.passes(4.0)
            swings.append(page.page.evaluate(RANGE, ["w13", "difference", *page.passes(3.0)]))
        page.press("link/wan_link/delay", "Tab", "Control+a", *"400", "Enter")
        page.until(f"status.states['{NODE}'] === 'tripped'")
        page.press("link/wan_link/cut", "Space")
        page.until("status.cut.length === 1")
        page.press("link/wan_link/cut", "Space")
        page.until("status.cut.length === 0")
        page.press("run/reset", "Enter")  # without control the swing would end the run, where time passes quickly
        page.press("grid/line", *"line_3", "Tab", "Tab", "Enter")
        page.page.wait_for_selector(".branch.out", state="attached", timeout=PATIENCE_MS)
        log = page.page.locator("[data-part='log']").inner_text()
        assert "tripped" in log
        assert log.count("added delay 270 ms") == 1
        assert "added delay 400 ms, cut" not in log
        assert "wan_link: cut, added delay 400 ms" in log
        page.press(f"supervisor/{NODE}/reset", "Enter")
        page.until(f"status.states['{NODE}'] === 'shadow'")
        out = "[...document.querySelectorAll('.branch.out')].map((node) => node.textContent)"
        wanted = page.page.evaluate(out)
        assert wanted == ["line_3"]  # a supervisor's reset puts no line into service
        page.page.reload()
        page.page.wait_for_selector(".branch.out", state="attached", timeout=PATIENCE_MS)
        assert page.page.evaluate(out) == wanted
        page.press("run/reset", "Enter")
        page.page.wait_for_selector(".branch.out", state="detached", timeout=PATIENCE_MS)
    assert 0.0 < 2.0 * swings[0] < swings[1]
    record = load(tmp_path / "recording")
    delays = [change.value["up"][-1].get("delay") for change in record.changes if change.kind == "link"]
    assert delays[-4:] == [0.27, 0.4, None, 0.4]
    assert STATES.index("tripped") in record.supervision["state"]
    assert sum(event.kind == "fault" for event in record.events) == 2


@needs_browser
def test_link_on_another_site_opens_the_page() -> None:
    """For a browser localhost is another site than 127.0.0.1; there it gets a text, as it has no cookie."""
    from playwright.sync_api import sync_playwright  # noqa: PLC0415

    layout: dict[str, Any] = {
        "type": "layout",
        "title": "it",
        "mode": "live",
        "panels": [],
        "controls": [],
        "duration": None,
    }
    with serving(application.Cockpit(application.Content(layout))) as (served, _), sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=CHROMIUM, args=START)
        page, origin = started.new_page(), served.address.partition("?")[0]
        page.goto(origin.replace("127.0.0.1", "localhost"))
        page.evaluate("(address) => { document.body.innerHTML = `<a href=${address}>it</a>`; }", served.address)
        page.click("a")
        for _ in range(2):
            page.wait_for_selector("#title:has-text('it')")
            assert page.url == origin
            page.reload()
        started.close()


@needs_browser
def test_page_shows_what_is_not_well_and_forgets_answers_of_another_state() -> None:
    """A page without a graph: a released device, a slider that is drawn, a refusal, and all again after a reload."""
    from playwright.sync_api import sync_playwright  # noqa: PLC0415

    case = load_case("two_area_deployment", [])
    shown = layout.panel(case, "it").shown
    content = {"type": "layout", "title": "it", "mode": "live", "panels": [shown], "duration": None}
    refusal = "not armed: 1 device blocked or released; allowed: none"
    cockpit = application.Cockpit(
        application.Content(content), controls(case), lambda _, answer: answer(False, refusal)
    )
    story, frame = words.Story(case), np.full(len(shown["curves"]) + 2, 1.0, "<f4").tobytes()

    def tell(events: list[dict[str, Any]], wait: str) -> None:
        for event in events:
            thread.soon(cockpit.event, event | story.shown())
        state = {"run": "running", "nodes": {}, "states": {}, "wrong": story.wrong(), "modes": [], "counts": {}}
        thread.soon(cockpit.status, state | story.shown())
        drawn(wait)

    def drawn(wait: str) -> None:
        """Send frames, as a graph does, until the page has drawn something."""
        for _ in range(300):
            thread.soon(cockpit.frame, frame)
            page.wait_for_timeout(100)
            if page.locator(wait).count():
                return
        pytest.fail(f"the page has no {wait}")

    with serving(cockpit) as (served, thread), sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=CHROMIUM, args=START)
        page = started.new_page(viewport={"width": 400, "height": 900})
        page.goto(served.address)
        page.wait_for_selector("#title:has-text('it')")
        tell([words.event(1.0 + i / 10, f"added delay {i} ms", of="link") for i in range(9)], "#run.running")
        tell(story.on_devices(2.0, ["sssc"]), ".device.released")
        for _ in range(2):
            page.wait_for_selector("#run.unwell:has-text('running, sssc released')")
            drawn(".label.released:has-text('sssc released')")
            log = page.locator("[data-part='log']").inner_text()
            assert ("added delay 7 ms" not in log, "added delay 8 ms" in log) == (True, True)
            assert page.evaluate("document.documentElement.scrollWidth") <= 400
            page.reload()
            page.wait_for_selector("#run:has-text('running')")
        button = page.locator("[data-control$='/arm']").first
        button.evaluate("node => node.click()")
        page.wait_for_selector(f"output:has-text('{refusal}')", state="attached")
        tell(story.on_devices(3.0, []), "#run.running")
        page.wait_for_selector(f"output:has-text('{refusal}')", state="detached")
        drawn("svg:not(:has(.device.released)) .device")
        started.close()


@needs_browser
def test_page_stays_after_the_end_of_its_run_and_starts_it_again(domain: int, tmp_path: Path) -> None:
    """A node is killed and restarted, a long fault ends the run; `again` starts another, whose plant is killed."""
    with browser(tmp_path, ["cockpit", *RUN, "--port", "0"], CALM) as page:
        page.until("time > 1")
        page.page.reload()
        page.page.wait_for_selector("#run:has-text('running')")
        page.until("panels[0].rows.length > 20 && panels[0].rows[0][0] < 0.5")  # from the start
        page.press("preset/sign", "Space")
        page.page.wait_for_selector(".group.preset output:has-text('done')", timeout=PATIENCE_MS)
        page.page.locator("summary", has_text="Nodes").press("Enter")
        page.press(f"nodes/{NODE}/kill", "Enter")
        page.until(f"status.nodes['{NODE}'] === 'dead'")
        page.press(f"nodes/{NODE}/restart", "Enter")
        page.until(f"status.nodes['{NODE}'] === 'alive'")
        again = page.page.locator("[data-control='run/again']")
        assert again.is_disabled()
        page.press("grid/fault", "Tab", "Control+a", "1", "Enter")
        page.until("status.run === 'ended'")
        assert page.page.locator("#over").inner_text().startswith("The run has ended: synchronism lost at")
        assert page.page.locator("[data-control='preset/delay']").is_disabled()
        assert page.page.locator("[data-control='run/report']").is_enabled()
        page.press("run/again", "Enter")
        page.until("status.run === 'running' && time > 0 && status.values['preset/sign'] === undefined")
        assert page.page.locator("#over").inner_text() == ""
        os.kill(plant_of(tmp_path / "run_2"), signal.SIGKILL)
        page.until("status.run === 'ended'")
        assert "its nodes no longer answer" in page.page.locator("#over").inner_text()
    first, second = (load(folder / "recording") for folder in (tmp_path, tmp_path / "run_2"))
    assert [joined.node for joined in first.joined] == [NODE]
    assert [(change.name, change.kind) for change in first.changes if change.name == "gain"] == [("gain", "parameter")]
    assert not first.in_synchronism[-1]
    assert second.in_synchronism.all()
    assert page.status == 128 + signal.SIGTERM
    assert "the run has ended: synchronism lost" in page.output
    assert page.output.splitlines()[-2:] == [
        f"recording: {tmp_path}/run_2/recording",
        f"report: facts-damping analyze {tmp_path}/run_2/recording --report report.html",
    ]
