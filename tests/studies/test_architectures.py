"""The study of architectures: what it runs, what docs/controllers.md says of it, and its page of tables."""

from __future__ import annotations

import re
from pathlib import Path
from statistics import median
from typing import Any

import pytest

from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.output.terminal import Progress
from facts_damping.simulation import loop
from facts_damping_studies.sweeps import sweep
from tests.commands import assert_one_line

PAGE = Path(__file__).parents[2] / "docs" / "controllers.md"
ARCHITECTURES = ("centralised", "decentralised", "single SSSC", "single STATCOM")
SCENARIOS = ("small", "large", "multiple")
# Where the networks are run, too: each architecture, each scenario.
RUN = {("centralised", "large"), ("decentralised", "small"), ("single SSSC", "small"), ("single STATCOM", "multiple")}

Rows = list[dict[str, Any]]


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> Rows:
    plan = sweep.plan("architectures", [])
    asked = [p for p in plan.points if p.columns["kind"] == "LLC-tuned" or place(p.columns) in RUN]
    plan = plan._replace(points=asked, base=plan.base._replace(modes=False))
    return [
        row.cells
        for row in sweep.rows(sweep.run(plan, tmp_path_factory.mktemp("rows"), 1, None, Progress("architectures")))
    ]


def place(row: dict[str, Any]) -> tuple[str, str]:
    return row["architecture"], row["scenario"]


def of(rows: Rows, architecture: str, scenario: str) -> Rows:
    return [row for row in rows if place(row) == (architecture, scenario)]


def test_study_of_architectures_has_all_controllers_on_all_scenarios() -> None:
    points = sweep.plan("architectures", []).points
    assert len(points) == 3 * 4 * (1 + 2 * 11)
    assert len({(*place(point.columns), point.columns["kind"]) for point in points}) == len(points)


def test_page_has_the_medians_and_counts_of_the_networks(rows: Rows) -> None:
    """The table of docs/controllers.md, to the digits that it has: of the networks that are converged."""
    assert not [row["error"] for row in rows if row["error"]]
    lines = [
        line.split("|")[1:-1]
        for line in PAGE.read_text(encoding="utf-8").splitlines()
        if line.startswith(("| `", "| lead-lags"))
    ]
    written = {cells[0].strip(): [cell.strip() for cell in cells[1:]] for cells in lines}
    for a, architecture in enumerate(ARCHITECTURES):
        lead_lag = [row["ITAE"] for scenario in SCENARIOS for row in of(rows, architecture, scenario)[:1]]
        written_cell = written["lead-lags, tuned, in `small`, `large`, `multiple`"][a]
        assert lead_lag == pytest.approx([float(value) for value in written_cell.split(",")], rel=0.03)
    for architecture, scenario in RUN:
        network_rows = of(rows, architecture, scenario)[1:]
        assert len(network_rows) == 2 * 11
        written_cell = written[f"`{scenario}`, median"][ARCHITECTURES.index(architecture)]
        converged = [row["ITAE"] for row in network_rows if row["stable"] and row["converged"]]
        assert median(converged) == pytest.approx(float(written_cell), rel=0.03)


def test_networks_that_are_damped_are_as_many_as_the_page_says(rows: Rows) -> None:
    (line,) = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| [damped]")]
    cells = dict(zip(ARCHITECTURES, line.split("|")[2:-1], strict=True))
    for architecture, scenario in RUN:
        counts = re.findall(r"\d+", cells[architecture].split(";")[0])
        assert len(counts) == len(SCENARIOS)
        assert sum(row["damped"] for row in of(rows, architecture, scenario)[1:]) == int(
            counts[SCENARIOS.index(scenario)]
        )


def test_lead_lags_side_by_side_are_the_centralised_one() -> None:
    """Appendix B's two lead-lags take one signal: centralised or not, they are the same."""
    centralised = "controllers=[{name: LLC, signals: [speed], devices: [sssc, statcom]}]"
    each = (
        "controllers=[{name: LLC, signals: [speed], devices: [sssc]}, "
        "{name: LLC, signals: [speed], devices: [statcom], parameters: {gain: 5}}]"
    )
    both = [
        loop.run(load_case(None, ["devices=[sssc, statcom]", controllers, "duration=5"]))
        for controllers in (centralised, each)
    ]
    assert both[0].frames.tobytes() == both[1].frames.tobytes()


def test_study_that_asks_for_tables_leaves_a_page_and_a_picture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study = tmp_path / "own.yaml"
    study.write_text(
        "description: two of them\n"
        "sweep:\n"
        "  - {field: scenario, values: [small, large]}\n"
        "  - name: kind\n"
        "    rows: [{controllers.*.name: LLC}, {controllers.*.name: ANFTSC, controllers.*.scheme: direct}]\n"
        "  - {field: frame_rate, values: [30, 60]}\n"
        "set: {duration: 1, controllers: [{name: LLC}]}\n"
        "tables: {rows: [kind], across: frame_rate, figures: [ITAE, ISE]}\n"
    )
    out = tmp_path / "out"
    assert main(["sweep", str(study), "--out", str(out), "--jobs", "1"]) == 0
    page = (out / "tables.md").read_text(encoding="utf-8")
    assert page.startswith("# own\n\ntwo of them\n\n### two_area, small\n\nITAE:\n\n| kind | 30 | 60 |\n")
    assert page.count("| ANFTSC direct |") == 4
    assert (out / "figures.png").is_file()
    assert page.partition("###")[2].splitlines()[2] in capsys.readouterr().out


@pytest.mark.parametrize(
    ("tables", "said"),
    [
        ("{figures: [ITEA]}", "tables.figures: 'ITEA' given (did you mean ITAE?); allowed: "),
        ("{rows: [who], figures: [ITAE]}", "tables: 'who' given; allowed: system, scenario"),
        ("{figures: []}", "tables.figures: [] given"),
    ],
)
def test_tables_of_columns_that_are_not_there_are_refused_before_any_run(
    tmp_path: Path, tables: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    study = tmp_path / "own.yaml"
    study.write_text(f"sweep: [{{field: seed, values: [1]}}]\ntables: {tables}\n")
    assert_one_line(2, ["sweep", str(study), "--out", str(tmp_path / "out")], said, capsys)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("text", ["controllers.*.name=HBsWC", "controllers.*.parameters.gain=12"])
def test_star_is_every_entry_of_a_list(text: str) -> None:
    controllers = "controllers=[{name: LLC, devices: [sssc]}, {name: LLC, devices: [statcom]}]"
    case = load_case(None, ["devices=[sssc, statcom]", controllers, text, "scenario=[]"])
    field, value = text.split(".", 2)[2].split("=")
    for row in case.run.controllers:
        assert (row.name if field == "name" else f"{row.parameters['gain']:g}") == value


@pytest.mark.parametrize(
    "sets",
    [
        ["link=delay_100ms", "link.up.*.delay=0.07"],
        ["link=delay_100ms", "controllers.0.link.up.*.delay=0.07"],
        ["link=delay_100ms", "controllers.*.link.up.*.delay=0.07"],
        ["link=delay_100ms", "controllers.*.name=HBsWC", "controllers.*.link.up.*.delay=0.07"],
    ],
)
def test_star_below_a_name_is_every_entry_of_what_it_names(sets: list[str]) -> None:
    case = load_case(None, sets)
    assert [stage.model_dump()["delay"] for stage in case.links[case.used_links[0]].up] == [0.07, 0.07]


def test_star_where_nothing_is_a_list_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert_one_line(
        2,
        ["simulate", "--set", "controllers=[]", "--set", "controllers.*.name=LLC"],
        "controllers.*.name: '*' given; allowed: where controllers is a list",
        capsys,
    )
