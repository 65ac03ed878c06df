"""Every path of every layout exists in a recording of a real graph, and shows what its label says."""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING, Any, NamedTuple
from xml.etree import ElementTree as ET

import pytest

from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.input_files import share_folder
from facts_damping.monitor_table import MONITORS
from facts_damping.nodes.launching import graph
from facts_damping.recording import RecordingWriter, load
from facts_damping.recording.scan import scan
from facts_damping_testing.loopback.opening import opened
from facts_damping_views.layouts import layouts
from tests.nodes.graphs import LOADED_S, assert_same, quiet
from tests.two_plants import path as path_of
from tests.views.bags import (
    Bag,
    Found,
    follow,
    foxglove_faults,
    foxglove_paths,
    plotjuggler_curves,
    plotjuggler_faults,
    read,
    series,
)

if TYPE_CHECKING:
    from pathlib import Path

SHIPPED = sorted((share_folder() / "config" / "views").iterdir())
FILES = {"foxglove.json", "plotjuggler.xml"}
RUNS = {
    "two_area_small": [],
    "two_area_decentralised": [],
    "two_area_centralised": ["controllers.0.scheme=direct", "controllers.0.name=gaussian+fourier"],
    "two_area_large": [
        "supervision.monitors.powers=off",
        "arm_at=0.5",
        "controllers.0.namespace=area_1",
        "controllers.+={fallback_of: 0, signals: [power]}",
    ],
}


class Recorded(NamedTuple):
    """A recording of two seconds, the first event among them, and the layouts of its run."""

    folder: Path
    bag: Bag
    foxglove: str
    plotjuggler: str


@pytest.fixture(scope="module", params=RUNS)
def recorded(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    name = request.param
    case = load_case(name, ["duration=2", *RUNS[name]])
    with opened():
        folder = graph.run(case, "lockstep", tmp_path_factory.mktemp(name), quiet, LOADED_S).recording
    texts = layouts(case)
    return Recorded(folder, read(folder), texts["foxglove.json"], texts["plotjuggler.xml"])


def test_foxglove_paths_lead_to_what_their_panels_can_show(recorded: Recorded) -> None:
    assert len(list(foxglove_paths(recorded.foxglove))) > 40
    assert foxglove_faults(recorded.foxglove, recorded.bag) == []


def test_every_curve_of_plotjuggler_exists(recorded: Recorded) -> None:
    curves = plotjuggler_curves(recorded.plotjuggler)
    assert len(curves) > 40
    assert plotjuggler_faults(recorded.plotjuggler, series(recorded.bag)) == []


def test_inverters_are_shown_by_their_pmus() -> None:
    """Its power and voltage, and its frequency where frequencies are delivered; no speed."""
    sets = [f"system={path_of('solar')}", "devices=[pod_p]", "scenario=[]"]
    sets += ["system.signals.f={channel: frequency, weights: {G1: 1, SOLAR: -1}}"]
    sets += ["controllers=[{name: LLC, signals: [f], devices: [pod_p]}]"]
    cases = (load_case(None, [*sets, f"measurement={name}"]) for name in ("ideal", "p_class"))
    ideal, filtered = (layouts(case)["foxglove.json"] for case in cases)
    assert "frames[2].active_power_pu" in ideal
    assert 'pmu==\\"SOLAR\\"' not in ideal
    assert 'pmu==\\"SOLAR\\"}.frequency_hz' in filtered
    assert "machines[2]" not in ideal


MUTATIONS = [
    ("/plant/state", "/plant/states"),
    ("machines[0]", "machines[4]"),
    (".speed_deviation_pu", ".speed_pu"),
    ("/setpoint_pu", "/setpoint"),
    ("outputs[0]", "outputs"),
    ('pmu==\\"G1\\"', 'pmu==\\"G9\\"'),
    ('pmu==\\"G1\\"', 'name==\\"G1\\"'),
    ('key==\\"deadline_misses\\"', 'key==\\"mode\\"'),
    ("plant_sim/deadline_misses", "plant_sim/mode"),
    ('statistics.up"', 'statistics.tick"'),
    ('topicToRender": "/diagnostics"', 'topicToRender": "/plant/events"'),
    ("/plant/events.kind", "/plant/events.header"),
]


@pytest.mark.parametrize(("good", "bad"), MUTATIONS)
@pytest.mark.parametrize("recorded", ["two_area_small"], indirect=True, scope="module")
def test_wrong_path_is_found(recorded: Recorded, good: str, bad: str) -> None:
    texts = {"foxglove": recorded.foxglove, "plotjuggler": recorded.plotjuggler}
    changed = {tool: text.replace(good, bad) for tool, text in texts.items() if good in text}
    assert changed
    for tool, text in changed.items():
        faults = foxglove_faults(text, recorded.bag) if tool == "foxglove" else []
        faults += plotjuggler_faults(text, series(recorded.bag)) if tool == "plotjuggler" else []
        assert faults, tool


# Names of entries, in the entry itself or in an array beside it.
OWN_NAMES = {"machines": "machine", "devices": "device", "frames": "pmu", "up": "channel", "down": "channel"}
BESIDE = {
    "inputs": "input_names",
    "outputs": "output_names",
    "unlimited_outputs": "output_names",
    "saturated": "output_names",
    "adaptation_errors": "output_names",
    "parameter_norms": "parameter_groups",
    "prediction": "output_names",
    "error": "output_names",
    "values": "monitors",
    "limits": "monitors",
}


def names_at(bag: Bag, topic: str, field: str, place: str) -> set[str]:
    """What messages call the entry at a place of an array."""
    path = f"{topic}.{field}[{place}].{OWN_NAMES[field]}" if field in OWN_NAMES else f"{topic}.{BESIDE[field]}[{place}]"
    followed = follow(bag, path)
    assert isinstance(followed, Found), path
    return set(followed.values)


def test_labels_are_the_names_in_the_messages(recorded: Recorded) -> None:
    titles = {
        curve["value"]: panel["foxglovePanelTitle"]
        for panel in json.loads(recorded.foxglove)["configById"].values()
        for curve in panel.get("paths", ())
    }
    checked = set()
    for _, path, label in foxglove_paths(recorded.foxglove):
        indexed = re.match(r"(/[\w/]+)\.(\w+)\[(\d+)\]", path)
        if indexed and indexed[2] in {**OWN_NAMES, **BESIDE}:
            (name,) = names_at(recorded.bag, *indexed.groups())
            assert name in re.split("[ :,]+", f"{label} {titles[path]}"), path
            checked.add(indexed[2])
        matched = re.search(r'\{pmu=="(\w+)"\}', path)
        assert not matched or matched[1] == label
    assert {"machines", "frames", "up", "down", "inputs", "outputs"} <= checked


def test_labels_of_tables_row_by_row(recorded: Recorded) -> None:
    """Learning rates and derivatives: outputs by groups, signals by devices."""
    labels: dict[tuple[str, str], list[str]] = {}
    for _, path, label in foxglove_paths(recorded.foxglove):
        indexed = re.fullmatch(r"(/[\w/]+)\.(learning_rates|jacobian)\[(\d+)\]", path)
        if indexed:
            labels.setdefault((indexed[1], indexed[2]), []).append(label)
    for (topic, field), texts in labels.items():
        message = recorded.bag.messages[topic][-1]
        columns, word = (message.input_names, " by ") if field == "jacobian" else (message.parameter_groups, ", ")
        assert texts == [f"{row}{word}{column}" for row in message.output_names for column in columns]
        assert len(texts) == len(getattr(message, field))


def test_foxglove_layout_shows_all_topics_but_setpoints(recorded: Recorded) -> None:
    """What was asked for and what is in force are in the states: setpoints as such beside a supervisor's alone.

    Nor is shown what is told in words.
    """
    shown = {re.split(r"[.\[]", path)[0] for _, path, _ in foxglove_paths(recorded.foxglove)}
    shown = {topic for topic in shown if not topic.endswith("/setpoints")}
    assert {t for t in recorded.bag.types if not re.search("/setpoints(/delivered)?$|/refused$|^/run/", t)} == shown


def leaves(node: Any) -> list[str]:
    if isinstance(node, str):
        return [node]
    assert 0 < node["splitPercentage"] < 100
    assert node["direction"] in ("row", "column")
    return leaves(node["first"]) + leaves(node["second"])


def test_foxglove_shows_every_panel_once(recorded: Recorded) -> None:
    layout = json.loads(recorded.foxglove)
    assert set(layout) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    panels = layout["configById"]
    tabs = panels[layout["layout"]]["tabs"]
    shown = [name for tab in tabs for name in leaves(tab["layout"])]
    assert sorted([*shown, layout["layout"]]) == sorted(panels)
    assert len({tab["title"] for tab in tabs}) == len(tabs)


def test_plotjuggler_divides_places_as_it_says(recorded: Recorded) -> None:
    root = ET.fromstring(recorded.plotjuggler)
    splitters = list(root.iter("DockSplitter"))
    assert splitters
    for splitter in splitters:
        assert int(splitter.attrib["count"]) == len(splitter) == len(splitter.attrib["sizes"].split(";"))
        assert sum(map(float, splitter.attrib["sizes"].split(";"))) == pytest.approx(1.0, abs=1e-5)
    assert all(list(plot.iter("curve")) for plot in root.iter("plot"))


@pytest.mark.parametrize("folder", SHIPPED, ids=lambda folder: folder.name)
def test_shipped_files_are_what_the_command_makes(folder: Path, tmp_path: Path) -> None:
    assert main(["views", folder.name, "--out", str(tmp_path)]) == 0
    assert {file.name for file in folder.iterdir()} == FILES
    for name in FILES:
        again = f"facts-damping views {folder.name} --out config/views/{folder.name}"
        assert (folder / name).read_text() == (tmp_path / name).read_text(), again


def test_views_of_the_demo_are_shipped() -> None:
    assert "two_area_deployment" in {folder.name for folder in SHIPPED}


def test_command_makes_layouts_of_a_recording_and_a_copy_by_simulated_time(recorded: Recorded, tmp_path: Path) -> None:
    assert main(["views", str(recorded.folder), "--out", str(tmp_path)]) == 0
    assert (tmp_path / "foxglove.json").read_text() == recorded.foxglove
    assert (tmp_path / "plotjuggler.xml").read_text() == recorded.plotjuggler
    assert_same(load(tmp_path / "simulated_time"), load(recorded.folder))
    assert foxglove_faults(recorded.foxglove, read(tmp_path / "simulated_time")) == []


@pytest.mark.parametrize("recorded", ["two_area_large"], indirect=True, scope="module")
def test_supervisor_has_its_state_its_setpoints_and_all_that_it_watches(recorded: Recorded) -> None:
    here, place = "/area_1/supervisor_0_LLC/state", '/setpoints[:]{device=="sssc"}.value_pu'
    paths = {path: label for _, path, label in foxglove_paths(recorded.foxglove)}
    assert {f"{here}.{field}" for field in ("state", "cause", "refused", "fraction")} <= set(paths)
    watched = [name for name in MONITORS if name != "powers"]
    assert [label for path, label in paths.items() if path.startswith(f"{here}.values")] == watched
    assert [label for path, label in paths.items() if path.startswith(f"{here}.limits")] == [
        f"{name}: limit" for name in watched
    ]
    said = {label: path for path, label in paths.items() if ".value_pu" in path}
    assert said == {
        "supervised": f"/area_1/supervisor_0_LLC/supervised.{place[1:]}",
        "issued": f"/area_1/controller_0_LLC/setpoints.{place[1:]}",
        "of the fallback": f"/controller_1_LLC/setpoints.{place[1:]}",
    }
    tabs = [tab["title"] for tab in json.loads(recorded.foxglove)["configById"]["Tab!tabs"]["tabs"]]
    assert [f"supervisor_0_LLC{group}" for group in ("", ": data", ": controller", ": grid")] == [
        title for title in tabs if title.startswith("supervisor")
    ]


@pytest.mark.parametrize("recorded", ["two_area_small"], indirect=True, scope="module")
def test_layouts_of_a_graph_in_a_namespace(recorded: Recorded, tmp_path: Path) -> None:
    content = scan(recorded.folder)
    moved = {name: name if name == "/diagnostics" else f"/grid{name}" for name in content.topics}
    with RecordingWriter(tmp_path / "moved", content.configuration) as writer:
        for topic in content.topics.values():
            writer.copy_topic(topic._replace(name=moved[topic.name]))
        for message in content.messages:
            writer.write(moved[message.topic], message.data, message.log_ns, message.publish_ns, message.sequence)
    assert main(["views", str(tmp_path / "moved")]) == 0
    bag = read(tmp_path / "moved")
    assert foxglove_faults((tmp_path / "views" / "foxglove.json").read_text(), bag) == []
    # What is copied was said by a plant without a namespace; in the diagnostics of all it has its full name.
    faults = plotjuggler_faults((tmp_path / "views" / "plotjuggler.xml").read_text(), series(bag))
    assert faults == ["/diagnostics/grid/plant_sim/deadline_misses"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["no_such_run"], "allowed: .*two_area_small"),
        ([".", "--set", "seed=1"], "--set seed=1: given with a recording; allowed: with a run"),
        (["no_such.mcap"], "no_such.mcap"),
    ],
)
def test_bad_input_is_refused(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["views", *arguments]) == 2
    error = capsys.readouterr().err
    assert re.search(said, error), error
    assert error.count("\n") == 1
