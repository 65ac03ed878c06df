"""What became of control is told wherever a study tells results: supervisors that trip, refuse to arm, limits."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pyarrow.parquet as pq
import pytest

from facts_damping.cli.main import main
from facts_damping.output import picture_files
from facts_damping.parameters.run import Controller
from facts_damping_studies.search.scoring import Score
from facts_damping_studies.search.search import Entry
from facts_damping_studies.search.search_pages import rows, search_table
from facts_damping_studies.search.structures import Structure
from facts_damping_studies.sweeps import sweep
from facts_damping_studies.sweeps.control_outcomes import outcome_lines
from facts_damping_studies.sweeps.results import margin_table, sweep_tables
from facts_damping_studies.sweeps.sweep_rows import SweepRow
from tests.studies.test_results import margin

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

JITTERY = """
description: New England, a link whose jitter nothing aligns
run: new_england_39_fault
set:
  system.devices: [{name: damper, kind: sssc, line: line_9_39}]
  profile: deployment
  duration: 4
  devices: [damper]
  controllers: [{name: LLC, devices: [damper], signals: [frequency]}]
  link:
    up: [{model: constant, delay: 0.05}, {model: gamma, delay: 0, shape: 2, scale: 0.1}]
    down: [{model: constant, delay: 0.02}]
sweep:
  - name: kind
    labels: [none, LLC]
    rows: [{controllers: []}, {controllers.0.name: LLC}]
  - {field: seed, values: [1, 2]}
tables: {rows: [kind], figures: [ITAE]}
"""


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder with the study, and its result."""
    folder = tmp_path_factory.mktemp("jittery")
    (folder / "jittery.yaml").write_text(JITTERY, encoding="utf-8")
    return folder


def test_sweep_tells_trips_in_text_tables_pictures_and_status(
    study: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the monitor, its value and its limit, and what helps."""
    drawn: dict[str, str] = {}
    save = picture_files.save_picture

    def keep(figure: Figure, path: Path, **more: Any) -> Path:
        labels = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
        drawn[path.name] = " ".join([figure.get_suptitle(), *labels]).replace("\n", " ")
        return save(figure, path, **more)

    monkeypatch.setattr("facts_damping_studies.pages.save_picture", keep)
    out, target = study / "out", study / "result.json"
    command = ["sweep", str(study / "jittery.yaml"), "--jobs", "1", "--out", str(out), "--json", str(target)]
    assert main(command) == 3
    said = capsys.readouterr()
    line, hint = said.out.splitlines()[1:3]
    assert line.startswith("2 of 2 controlled runs were tripped, by `misaligned` (0.1")
    assert line.endswith(" s; limit 0.1)")
    assert hint.startswith("hint: a PDC aligns frames of a jittery link: a `wait` stage in `link.up`; or raise ")
    assert said.err.endswith(f"facts-damping: the study ended, but: {line}\n")
    text = (out / "tables.md").read_text(encoding="utf-8")
    assert line in text
    assert "| 2 of 2 tripped by misaligned |" in text
    assert line in drawn["figures.png"]
    assert drawn["figures.png"].endswith(" tripped")
    assert line in drawn["latency.png"]
    of_json = json.loads(target.read_text())["rows"]
    assert [row["trips"] for row in of_json] == [0, 0, 1, 1]
    assert [row.get("trip_cause") for row in of_json] == [None, None, "misaligned", "misaligned"]
    assert all(row["trip_value"] > row["trip_limit"] == 0.1 for row in of_json[2:])
    fractions = json.loads(target.read_text())["fractions"]
    assert [row.get("tripped", 0) for row in fractions] == [0, 2, 0, 2]
    assert pq.read_table(out / "rows.parquet")["trip_cause"].null_count == 2


def test_stage_that_the_hint_names_keeps_it_from_being_tripped(study: Path, capsys: pytest.CaptureFixture[str]) -> None:
    aligned = JITTERY.replace("scale: 0.1}]", "scale: 0.1}, {model: wait, wait: 0.25}]")
    (study / "aligned.yaml").write_text(aligned, encoding="utf-8")
    command = ["sweep", str(study / "aligned.yaml"), "--jobs", "1", "--out", str(study / "aligned")]
    assert main([*command, "--only", "kind=LLC", "--only", "seed=1"]) == 0
    assert "tripped" not in capsys.readouterr().out


def test_journal_of_an_earlier_version_goes_on(study: Path) -> None:
    """Whose rows do not know what tripped."""
    plan = sweep.plan(str(study / "jittery.yaml"), [])
    journal = [json.loads(line)["row"] for line in (study / "out" / sweep.JOURNAL).read_text().splitlines()[1:]]
    earlier = [SweepRow.read({k: v for k, v in row.items() if not k.startswith("trip_")}) for row in journal]
    assert [row.figures is not None and row.figures.trips for row in earlier] == [0, 0, 1, 1]
    assert outcome_lines(earlier) == ["2 of 2 controlled runs were tripped"]
    assert sweep.found_fractions(plan, [{None: row} for row in earlier])[1].tripped == 2


def test_search_tells_lost_runs_and_trips() -> None:
    structure = Structure("LLC", None, ("sssc",))
    scores = Score(0.1, dict.fromkeys(("ITAE", "IAE", "ITSE", "ISE"), 1.1), 0.5, 0.25), Score(15.0, {}, 1.0, 1.0)
    entries = [Entry(structure, controller=Controller(name="LLC"), scores=(score,)) for score in scores]
    first, second = search_table(entries)[-2:]
    assert first.endswith("| 0.100 | 50 % not damped, 25 % tripped |")
    assert second.endswith("| 15.000 | synchronism lost, 100 % tripped |")
    assert [row["tripped"] for row in rows(entries)] == [[0.25], [1.0]]
    calm = entries[0]._replace(scores=(Score(0.1, scores[0].ratios, 0.0),))
    assert "draws" not in search_table([calm])[0]


def test_margins_tell_trips_and_what_their_marks_mean() -> None:
    plain = margin("unstable", "small", "fibre", "A", 0.2)
    assert "Marks" not in "\n".join(sweep_tables([], [plain], []))
    marked = [
        margin("unstable", "small", "fibre", "A", 0.2, monotonic=False),
        margin("unstable", "small", "plc", "A", 0.0, margin_s=None, low_s=None, high_s=0.0, beyond="low"),
    ]
    text = sweep_tables([], marked, [])[-1]
    again = "`*`: holds again at larger values, at so many % of the coarse grid in all"
    assert text == f"Marks: {again}; `<`: fails at the first value."
    tripped = replace(plain, tripped=7)
    assert "0.200 [0.19, 0.21] (7 tripped) |" in margin_table([tripped], "scenario")[-2]
