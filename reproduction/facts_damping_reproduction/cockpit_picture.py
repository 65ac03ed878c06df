"""The picture of the cockpit in README: `python -m facts_damping_reproduction.cockpit_picture PATH.png`.

A graph runs in real time. By the page's own controls its link gets 250 ms more delay, and a load step follows. The
picture is taken some seconds later. It needs Debian's chromium and the extra `test`.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile

RUN = ("cockpit", "two_area_deployment", "--supervised", "--port", "0")
DELAY_S, LATER_S = 8.0, 12.0  # when the delay changes, and how long after that the picture is taken


def plot(path: str) -> None:
    """Run the graph, work the page, and write the picture."""
    from playwright.sync_api import sync_playwright  # noqa: PLC0415 (of the extra `test`)

    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "facts_damping", *RUN, "--out", f"{folder}/out"]
        run = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        try:
            address = next(match[0] for line in run.stdout or () if (match := re.search(r"http://\S+", line)))
            with sync_playwright() as driver:
                browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
                page = browser.new_page(viewport={"width": 1440, "height": 900})
                page.goto(address)
                page.wait_for_timeout(1e3 * DELAY_S)
                page.locator("[data-control='link/wan_link/delay'] input[type=number]").fill("250")
                page.keyboard.press("Enter")
                page.locator("[data-control='grid/load'] button").click()
                page.wait_for_timeout(1e3 * LATER_S)
                page.evaluate("document.activeElement.blur()")
                page.screenshot(path=path)
                browser.close()
        finally:
            run.terminate()
            run.communicate(timeout=60.0)


if __name__ == "__main__":
    plot(sys.argv[1])
