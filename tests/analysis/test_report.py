"""The report of recordings: what it says, and how a real browser shows it."""

from __future__ import annotations

import dataclasses
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from facts_damping.analysis import summarise
from facts_damping.cli.main import BAD_INPUT, main
from facts_damping.digest import digest
from facts_damping.errors import InputError
from facts_damping.signals import DEVICE_TRUTH
from facts_damping_views import report
from facts_damping_views.analysis import details
from facts_damping_views.report.charts import detailed, envelope, steps
from facts_damping_views.report.contents import Chart, Maps, ReportedRun, ReportTable
from facts_damping_views.report.sections import build
from facts_damping_views.report.tables import ranked
from tests.analysis.conftest import make_record
from tests.chromium import CHROMIUM, START, needs_browser
from tests.passed import inputs

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from facts_damping.record import Record
    from facts_damping_views.report.contents import Report

pytestmark = inputs(
    contents=["facts_damping/**/*", "extensions/**/*", "config/**/*", "tests/analysis/conftest.py", "tests/chromium.py"]
)

DESK = {"viewport": {"width": 1200, "height": 900}}
PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
IDLE = "Bokeh.documents.length > 0 && Bokeh.documents.every((one) => one.is_idle)"
TIME = "(() => { const t = Bokeh.documents[0].get_model_by_name('time'); return [t.start, t.end]; })()"


def runs(named: Sequence[tuple[str, Record]]) -> list[ReportedRun]:
    summaries = [summarise(record) for _, record in named]
    rows = zip(named, summaries, details.improvements(summaries, 0), strict=True)
    return [ReportedRun(name, record, summary, "-", percent) for (name, record), summary, percent in rows]


def said(*named: tuple[str, Record]) -> Report:
    """What the report says of records."""
    return build(runs(named))


def written(folder: Path, *named: tuple[str, Record]) -> Path:
    """The report of records, as `analyze` writes it."""
    report.write(folder / "report.html", named)
    return folder / "report.html"


class Tags(HTMLParser):
    """Names of all tags of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append(tag)


def items(shown_report: Report) -> dict[str, Any]:
    return {item.key: item for section in shown_report.sections for item in section.items}


def unstable(record: Record) -> Record:
    """The first ten seconds of a record, at whose end synchronism is lost."""
    n = 600
    ends = np.ones(n, np.bool_)
    ends[-1] = False
    cut = {name: getattr(record, name)[:n] for name in ("time_ns", "frames", "machines", "devices", "applied")}
    return dataclasses.replace(record, **cut, in_synchronism=ends)


# What it says.


@given(arrays(np.float64, st.integers(0, 4000), elements=st.floats(-1e6, 1e6, allow_nan=False)), st.integers(10, 500))
def test_envelope_has_all_extremes_in_order_and_few_points(values: Any, maximum: int) -> None:
    x = np.arange(len(values), dtype=float)
    at, shown = envelope(x, values, maximum)
    assert len(at) == len(shown) <= max(maximum, min(len(x), maximum)) + 2
    assert np.all(np.diff(at) >= 0)
    if len(values):
        assert (shown.max(), shown.min()) == (values.max(), values.min())
        assert np.isin(shown, values).all()
        assert np.isin(at, x).all()
        size = -(-2 * len(x) // maximum) if len(x) > maximum else 1
        for time, value in zip(at, shown, strict=True):  # each value is from the block that it is drawn in
            block = int(time) // size * size
            assert value in values[block : block + size]


def test_envelope_keeps_gaps_and_ignores_single_missing_values() -> None:
    values = np.sin(np.arange(10_000.0))
    values[3000:5000] = np.nan
    values[7001] = np.nan
    at, shown = envelope(np.arange(10_000.0), values, 500)
    missing = at[np.isnan(shown)]
    assert 3000 <= missing.min() <= 3080
    assert 4920 <= missing.max() <= 5000


def test_long_trace_has_the_first_minute_after_the_event_in_full() -> None:
    t = np.arange(216_000) / 60
    y = np.sin(2 * np.pi * 0.65 * t)
    at, shown = detailed(t, y, 1800.0)
    assert len(at) < 18_000
    assert np.all(np.diff(at) >= 0)
    fine = (t >= 1798.5) & (t < 1857.5)
    assert np.isin(t[fine], at).all()
    np.testing.assert_array_equal(shown[np.searchsorted(at, t[fine])], y[fine])
    assert (at[0], at[-1] > t[-1] - 1) == (0.0, True)


def test_steps_are_the_distribution_and_few() -> None:
    values = np.sort(np.random.default_rng(1).gamma(2.0, 20.0, 50_000))
    fractions = np.arange(1, len(values) + 1) / len(values)
    x, y = steps(np.append(values[0], values), np.append(0.0, fractions), 600)
    assert len(x) <= 600
    assert (y[0], y[-1], x[-1]) == (0.0, 1.0, values[-1])
    asked = np.quantile(values, [0.1, 0.5, 0.9])
    np.testing.assert_allclose(np.interp(asked, x, y), [0.1, 0.5, 0.9], atol=0.005)
    x, y = steps(np.full(4, 100.0), np.array([0.0, 0.25, 0.5, 1.0]))
    assert (x.tolist(), y.tolist()) == ([100.0, 100.0], [0.0, 1.0])


@pytest.mark.parametrize(
    ("values", "largest", "marks"),
    [
        ([1.0, 3.0, 2.0], False, ["best", "worst", ""]),
        ([1.0, 3.0, 2.0], True, ["worst", "best", ""]),
        ([True, False, True], True, ["best", "worst", "best"]),
        ([None, 3.0, 2.0], False, ["worst", "", "best"]),
        ([None, None], False, ["", ""]),
        ([2.0, 2.0], False, ["", ""]),
        ([2.0], False, [""]),
    ],
)
def test_best_and_worst(values: Any, largest: bool, marks: list[str]) -> None:
    assert ranked(values, largest) == marks


def test_summary_marks_the_better_damped_run(swing_record: Callable[..., Record]) -> None:
    shown_report = said(("slow", swing_record(damping=0.1)), ("quick", swing_record(damping=0.5)))
    assert shown_report.remarks == []
    rows = {row[0].text: row[1:] for row in items(shown_report)["summary"].rows}
    for name in ("ITAE", "IAE", "ITSE", "ISE", "its damping ratio", "settling time [s]"):
        assert [cell.mark for cell in rows[name]] == ["worst", "best"], name
    assert {cell.mark for name in ("latency, mean [ms]", "roughness [p.u./s²]") for cell in rows[name]} == {""}
    improved = {row[0].text: [cell.text for cell in row[1:]] for row in items(shown_report)["improvement"].rows}
    assert improved["ITAE"][0] == "0.0"
    assert 50 < float(improved["ITAE"][1]) < 100


def test_report_items_have_a_sentence_and_axes_with_units(swing_record: Callable[..., Record]) -> None:
    shown_report = said(("a", swing_record()), ("b", swing_record(damping=0.1)))
    named = items(shown_report)
    assert set(named) >= {
        "summary", "differences", "tie_power", "speeds", "injected_voltage", "indices", "mode_table", "modes", "spwvd",
        "effort", "links", "latency", "conditions",
    }  # fmt: skip
    rows = {row[0].text: [cell.text for cell in row[1:]] for row in named["conditions"].rows}
    assert rows["digest"] == [digest(swing_record()), digest(swing_record(damping=0.1))]
    assert rows["versions"] == ["-", "-"]
    for item in named.values():
        assert re.fullmatch(r"[A-Z].*\.", item.sentence)
        if isinstance(item, Chart):
            assert "[" in item.x_label
            assert all("[" in (item.y_label or panel.title) or item.y_label == "CDF" for panel in item.panels)
            assert all({curve.run for curve in panel.curves} == {0, 1} for panel in item.panels)
        if isinstance(item, Maps):
            assert [spectrogram.run for spectrogram in item.maps] == [0, 1]


def test_map_is_where_the_mode_is(swing_record: Callable[..., Record]) -> None:
    (spectrogram,) = items(said(("a", swing_record(damping=0.05))))["spwvd"].maps
    first, last, low, high = spectrogram.extent
    row, column = np.unravel_index(np.argmax(spectrogram.values), spectrogram.values.shape)
    frequency = low + (row + 0.5) * (high - low) / spectrogram.values.shape[0]
    time = first + (column + 0.5) * (last - first) / spectrogram.values.shape[1]
    assert frequency == pytest.approx(0.5, abs=0.03)
    assert 1.0 < time < 10.0
    assert spectrogram.values.size <= 300 * 150


def test_unstable_run_is_worst_and_has_no_curve_of_indices(swing_record: Callable[..., Record]) -> None:
    shown_report = said(("sound", swing_record()), ("lost", unstable(swing_record())))
    assert shown_report.remarks == ["lost is not stable: loss of synchronism at 9.98 s. It has no indices."]
    rows = {row[0].text: row[1:] for row in items(shown_report)["summary"].rows}
    assert rows["ITAE"][1] == ("-", "worst")
    assert rows["in synchronism"][1] == ("no", "worst")
    assert {curve.run for panel in items(shown_report)["indices"].panels for curve in panel.curves} == {0}
    assert "improvement" not in items(shown_report)
    assert "lost" in items(shown_report)["mode_table"].sentence


def test_runs_that_cannot_be_compared_are_not_ranked(swing_record: Callable[..., Record]) -> None:
    other = swing_record(damping=0.1)
    other.configuration["asked"] = {"system": "another", "controllers": []}
    shown_report = said(("a", swing_record()), ("b", other))
    assert shown_report.remarks[0].startswith("The runs differ in system: their figures cannot be compared")
    assert {cell.mark for row in items(shown_report)["summary"].rows for cell in row} == {""}
    assert "improvement" not in items(shown_report)


def test_report_remarks_name_what_a_recording_lacks(swing_record: Callable[..., Record]) -> None:
    cut = swing_record(600, notes=["the end is missing: the record ends with tick 599"])
    cut.configuration["duration"] = 20
    shown_report = said(("cut", cut))
    assert shown_report.remarks[0] == "cut: the end is missing: the record ends with tick 599."
    assert "the recording ends too early" in shown_report.remarks[1]


def test_run_of_nearly_nothing(tmp_path: Path, swing_record: Callable[..., Record]) -> None:
    """Seven ticks, no device, no controller, no event: what cannot be is left out."""
    bare = swing_record(7, events=[], device_names=[], devices=np.zeros((7, 0), DEVICE_TRUTH), controller_names=[])
    bare = dataclasses.replace(bare, applied=bare.applied[:0], issued=bare.issued[:0])
    by_key = items(said(("bare", bare)))
    assert isinstance(by_key["summary"], ReportTable)
    assert "spwvd" not in by_key
    assert "injected_voltage" not in by_key
    assert written(tmp_path, ("bare", bare)).stat().st_size > 1_000_000


def test_names_are_text_not_markup(tmp_path: Path, swing_record: Callable[..., Record]) -> None:
    name = "</script><img src=x onerror=alert(1)>'\"&"
    tags: list[list[str]] = []
    for run_name in ("plain", name):
        page = written(tmp_path, (run_name, swing_record(notes=[run_name]))).read_text()
        parser = Tags()
        parser.feed(page)
        tags.append(parser.found)
    assert tags[0] == tags[1]
    assert tags[0].count("script") > 2


def test_long_record_makes_a_small_file(tmp_path: Path, swing_record: Callable[..., Record]) -> None:
    """A quarter of an hour of a swing that hardly decays, which does not shrink by itself: whole it takes 3.9 MB."""
    long = swing_record(54_000, damping=1e-4)
    assert written(tmp_path, ("long", long)).stat().st_size < 2_500_000


def test_report_page_loads_nothing_from_elsewhere(tmp_path: Path, swing_record: Callable[..., Record]) -> None:
    page = written(tmp_path, ("a", swing_record())).read_text()
    markup = re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)
    assert not re.findall(r"https?://", markup)
    assert {link.partition(":")[0] for link in re.findall(r"(?:src|href)\s*=\s*[\"']?([^\"'\s>]*)", markup)} == {"data"}
    assert not re.findall(r"@import|url\(", markup)


@pytest.mark.parametrize("place", ["no/such/folder/report.html", "", "-", "."])
def test_report_that_cannot_be_written_is_refused_first(place: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["analyze", "no_such_recording", "--report", place]) == BAD_INPUT
    assert "--report" in capsys.readouterr().err


def test_report_that_cannot_be_written_after_all(swing_record: Callable[..., Record]) -> None:
    with pytest.raises(InputError, match=r"report\.html: .*; allowed: a file in a folder that can be written"):
        written(Path("/proc"), ("a", swing_record()))


# How a browser shows it.


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A real browser with a new profile."""
    from playwright.sync_api import sync_playwright  # noqa: PLC0415 (a hundred megabytes)

    with sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=CHROMIUM, args=START)
        yield started
        started.close()


class Pages:
    """A report of three runs in the browser, each way of looking at it once, and what was said and asked for."""

    def __init__(self, browser: Any, path: Path) -> None:
        self.browser, self.path = browser, path
        self.there: dict[str, Any] = {}
        self.wrong: list[str] = []
        self.requests: list[str] = []

    def __call__(self, **options: Any) -> Any:
        if str(options) not in self.there:
            page = self.there[str(options)] = self.browser.new_context(**options).new_page()
            page.on(
                "console",
                lambda message: self.wrong.append(message.text) if message.type in ("error", "warning") else None,
            )
            page.on("pageerror", lambda error: self.wrong.append(str(error)))
            page.on("request", lambda request: self.requests.append(request.url))
            page.goto(self.path.as_uri())
            page.wait_for_function(IDLE, timeout=120_000)
        return self.there[str(options)]


def three(swing_record: Callable[..., Record]) -> list[tuple[str, Record]]:
    return [("slow", swing_record(damping=0.1)), ("quick", swing_record()), ("lost", unstable(swing_record()))]


@pytest.fixture(scope="module")
def pages(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Pages:
    return Pages(browser, written(tmp_path_factory.mktemp("report"), *three(make_record)))


@pytest.fixture
def opened(pages: Pages) -> Iterator[Pages]:
    """The report, drawn; that nothing went wrong is asserted at the end."""
    yield pages
    assert pages.wrong == []
    assert set(pages.requests) == {pages.path.as_uri()}


DRAWN = """() => [...document.querySelectorAll('figure')].map((one) => {
  const all = (root) => [...root.querySelectorAll('*')].flatMap((node) =>
    [node, ...(node.shadowRoot ? all(node.shadowRoot) : [])]);
  const box = one.getBoundingClientRect(), colours = new Set();
  for (const canvas of all(one).filter((node) => node.tagName === 'CANVAS' && node.width && node.height)) {
    const data = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
    for (let i = 0; i < data.length; i += 4) if (data[i + 3] > 200)
      colours.add((data[i] >> 5) + ',' + (data[i + 1] >> 5) + ',' + (data[i + 2] >> 5));
  }
  return [box.width, box.height, colours.size];
})"""


@needs_browser
@pytest.mark.parametrize("options", [DESK, PHONE], ids=["desk", "phone"])
def test_report_figures_are_drawn_and_fit_the_screen(
    opened: Pages, options: dict[str, Any], swing_record: Callable[..., Record]
) -> None:
    page = opened(**options)
    width = options["viewport"]["width"]
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    figures = page.evaluate(DRAWN)
    shown = items(said(*three(swing_record))).values()
    expected = [len(item.panels) for item in shown if isinstance(item, Chart)]
    expected += [len(item.maps) for item in shown if isinstance(item, Maps)]
    assert len(figures) == sum(expected) > 10
    for wide, high, colours in figures:
        assert 0.35 * width < wide <= width
        assert high > 200
        assert colours > 3  # axes, grid, at least one run
    assert page.locator("table").count() == sum(isinstance(item, ReportTable) for item in shown)
    assert all(box["width"] <= width for box in (box.bounding_box() for box in page.locator(".scroll").all()))
    too_wide = "[...document.querySelectorAll('.scroll')].filter((e) => e.scrollWidth > e.clientWidth).length"
    assert options is PHONE or page.evaluate(too_wide) == 0


@needs_browser
def test_dragging_zooms_all_charts_over_time_and_runs_can_be_hidden(opened: Pages) -> None:
    page = opened(**DESK)
    whole = page.evaluate(TIME)
    assert whole == [0.0, pytest.approx(20.0, abs=0.1)]
    figure = page.locator("#differences figure").first
    figure.scroll_into_view_if_needed()
    box = figure.bounding_box()
    middle = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + 0.4 * box["width"], middle)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.6 * box["width"], middle, steps=8)
    page.mouse.up()
    page.wait_for_function(f"{TIME}[0] > 1")
    start, end = page.evaluate(TIME)
    assert 3 < end - start < 6
    visible = (
        "[...Bokeh.documents[0].all_models].filter((one) => one.tags.includes('run-1'))"
        ".map((one) => one.visible).filter((one) => one !== undefined)"
    )
    assert set(page.evaluate(visible)) == {True}
    page.get_by_label("quick").uncheck()
    assert set(page.evaluate(visible)) == {False}
    figure.dblclick(position={"x": box["width"] / 2, "y": box["height"] / 2})
    page.wait_for_function(f"{TIME}[0] === 0")


@needs_browser
def test_finger_on_a_chart_scrolls_the_page(opened: Pages) -> None:
    page = opened(**PHONE)
    page.wait_for_function(
        "[...Bokeh.documents[0].all_models].every((one) => (one.attributes.active_drag ?? null) === null)"
    )
    page.locator("#differences figure").first.scroll_into_view_if_needed()
    before, box = page.evaluate("scrollY"), page.locator("#differences figure").first.bounding_box()
    client = page.context.new_cdp_session(page)
    x, y = box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]
    client.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": [{"x": x, "y": y}]})
    for k in range(10):
        client.send("Input.dispatchTouchEvent", {"type": "touchMove", "touchPoints": [{"x": x, "y": y - 15 * k}]})
    client.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    page.wait_for_function(f"scrollY > {before} + 50")
    assert page.evaluate(TIME)[0] == 0.0


@needs_browser
def test_dark_where_the_reader_has_it_dark(opened: Pages) -> None:
    page = opened(color_scheme="dark")
    lightness = "(name) => getComputedStyle(document.body)[name].match(/\\d+/g).slice(0, 3).reduce((a, b) => a + +b, 0)"
    assert page.evaluate(lightness, "backgroundColor") < 150
    assert page.evaluate(lightness, "color") > 600
