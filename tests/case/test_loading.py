"""Bad input of any kind gives one line with source, field, value and what is allowed; good input round-trips."""

from __future__ import annotations

import copy
import itertools
import pickle
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facts_damping.case import names
from facts_damping.case.loading import changed_case, load_case, load_system, make_case, read_run
from facts_damping.case.tuned import tuned
from facts_damping.errors import InputError
from facts_damping.input_files import share_folder
from facts_damping.link.stages import mean_delay
from facts_damping.parameters.files import read_table, shipped
from facts_damping.parameters.stages import Noise
from facts_damping.parameters.yaml_text import dump
from facts_damping.plant.build import build as build_grid
from facts_damping.plant.grid.network import series_devices
from facts_damping.simulation import assembly, loop
from facts_damping_studies.sweeps import sweep

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

JUNK = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(10**6), 10**6),
    st.floats(allow_nan=True, allow_infinity=True),
    st.text(max_size=8),
    st.lists(st.integers(), max_size=3),
    st.dictionaries(st.text(max_size=4), st.integers(), max_size=2),
)


def leaves(content: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Paths of everything in a content."""
    if path:
        yield path
    pairs = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    for key, value in pairs:
        yield from leaves(value, (*path, key))


def at(content: Any, path: tuple[Any, ...]) -> Any:
    for key in path:
        content = content[key]
    return content


def mutate(content: Any, path: tuple[Any, ...], how: str, junk: Any) -> Any:
    mutated = copy.deepcopy(content)
    here = at(mutated, path[:-1])
    if how == "replace":
        here[path[-1]] = junk
    elif how == "remove":
        del here[path[-1]]
    elif isinstance(here, dict):
        here[f"{path[-1]}_x"] = here.pop(path[-1])
    else:
        here.append(junk)
    return mutated


def assert_one_line(error: InputError) -> None:
    text = str(error)
    assert "\n" not in text
    assert len(text) < 2000
    assert "allowed" in text or "must" in text or "needs" in text


def assert_refused_in_one_line_or_built(content: Any) -> None:
    try:
        case = make_case(content, "mutated")
        assembly.build_plant(case)
        assembly.build_links(case)
        assembly.build_control(case)
        assembly.build_supervisors(case)
    except InputError as error:
        assert_one_line(error)


INLINE = load_case("two_area_multiple").document()
NEURO = load_case(None, ["system=smib", "scenario=nominal", "controllers.0.name=ANFTSC"]).document()
NEURO["controllers"][0]["weights"] = {"name": "ANFTSC", "scheme": "indirect", "controller": [0.5] * 10}
GUARDED = load_case("smib_supervised", ["supervision=probed", "arm_at=20", "supervision.authority.rate=1"]).document()
GUARDED["supervision"] |= {
    "monitors": {"stale": {"limit": 0.5, "lasts": 0.1, "follows": "trip"}, "harm": None},
    "fault": {"kind": "dead", "start": 1.0, "duration": 1.0},
}
OF_RUN = [(INLINE, path) for path in leaves(INLINE)]
OF_NETWORK = [(NEURO, ("controllers", *path)) for path in leaves(NEURO["controllers"])]
OF_SUPERVISION = [(GUARDED, path) for path in leaves(GUARDED) if path[0] in ("supervision", "arm_at")]
BASES = OF_RUN + 4 * OF_NETWORK + 4 * OF_SUPERVISION


@settings(deadline=None, max_examples=100)
@given(
    base=st.sampled_from(BASES),
    how=st.sampled_from(["replace", "remove", "rename"]),
    junk=JUNK,
)
def test_random_mutation_is_refused_in_one_line_or_runs(base: Any, how: str, junk: Any) -> None:
    """A mutated run, with everything it names inline, is either a run that can be built or a clear error."""
    assert_refused_in_one_line_or_built(mutate(base[0], base[1], how, junk))


def numbers() -> Iterator[list[tuple[Any, tuple[Any, ...]]]]:
    """Each number of the runs with its path: those of a field in rows of a list that are of one kind together."""
    by_field: dict[Any, list[tuple[Any, tuple[Any, ...]]]] = {}
    for name, bases in (("run", OF_RUN), ("network", OF_NETWORK), ("supervision", OF_SUPERVISION)):
        for base, path in bases:
            if type(at(base, path)) in (int, float):
                rows = [at(base, path[: i + 1]) for i in range(len(path))]
                kinds = [row.get("kind") if isinstance(row, dict) else None for row in rows]
                field = [(k, kind) if isinstance(k, str) else ("", kind) for k, kind in zip(path, kinds, strict=True)]
                by_field.setdefault((name, *field), []).append((base, path))
    return iter(by_field.values())


@pytest.mark.parametrize(("extreme", "row"), [(5e-324, 0), (1e-160, -1), (1e160, 0), (-1e-160, -1)], ids=str)
def test_case_with_an_extreme_number_is_refused_in_one_line_or_built(extreme: float, row: int) -> None:
    """Squares and quotients of what is let in do not overflow; of several rows of a kind the first or the last one."""
    chosen = [alike[row] for alike in numbers()]
    assert len(chosen) > 200
    for base, path in chosen:
        assert_refused_in_one_line_or_built(mutate(base, path, "replace", extreme))


@pytest.mark.parametrize("name", shipped("runs"))
def test_document_of_a_run_is_a_run_by_itself(name: str, tmp_path: Path) -> None:
    case = load_case(name)
    path = tmp_path / "again.yaml"
    path.write_text(dump(case.document()))
    again = load_case(str(path))
    assert again.document() == case.document()
    assert again.summary() == case.summary()
    assert (again.system, again.scenario.events, again.link) == (case.system, case.scenario.events, case.link)


@pytest.mark.parametrize("name", ["two_area_ibr", "minniwecc", "wecc_240"])
def test_systems_pass_to_other_processes(name: str) -> None:
    """Models of block controls are made from tables, but pickle finds them by name."""
    system = load_system(name)
    assert pickle.loads(pickle.dumps(system)) == system


@pytest.mark.parametrize("name", shipped("systems"))
def test_shipped_systems_build(name: str) -> None:
    system = load_system(name)
    built = build_grid(system, [d.name for d in series_devices(system)], [])
    assert len(built.state_names) == len(built.state.x)


@pytest.mark.parametrize("name", shipped("scenarios"))
def test_shipped_scenarios_build(name: str) -> None:
    system, scenario = name.split("/")
    devices = [d.name for d in load_system(system).devices]
    case = load_case(None, [f"system={system}", f"scenario={scenario}", f"devices={devices}", "controllers=[]"])
    plant = assembly.build_plant(case).plant
    assert len(plant.interval_start_ns) + len(plant.oscillations) >= 2


REFUSED = [
    (["frame_rat=60"], "frame_rat: unknown key (did you mean frame_rate?); allowed: description, system"),
    (["frame_rate=0"], "frame_rate: 0 given; allowed: greater than or equal to 1"),
    (["frame_rate=sixty"], "frame_rate: 'sixty' given; allowed: a valid integer"),
    (["duration=-1"], "duration: -1 given"),
    (["duration=.inf"], "duration: inf given"),
    (["duration=99999", "frame_rate=1000"], "99999000 frames; allowed: at most 2000000 frames"),
    (["system=nowhere"], "systems: 'nowhere' given; allowed: iberia, "),
    (["system=/no/such/file.yaml"], "/no/such/file.yaml: no such file"),
    (["scenario=huge"], "scenarios: 'huge' given; allowed: large, multiple, small"),
    (["link=wet_string"], "links: 'wet_string' given; allowed: csg, delay_100ms, fibre, ideal"),
    (["link.up.0.delay=-0.1"], "link.up.0.delay: -0.1 given; allowed: greater than or equal to 0"),
    (["link.up.0.model=chaos"], "link.up.0.model: 'chaos' given; allowed: 'constant'"),
    (["link.up.7.delay=0.1"], "link.up.7: '7' given; allowed: an index from 0 to 1"),
    (["link={up: [], down: []}", "link.up.-1.delay=0.1"], "link.up.-1: '-1' given; allowed: an index from 0 to 0"),
    (["controllers.0.link=wet_string"], "links: 'wet_string' given; allowed: csg, delay_100ms, fibre, ideal"),
    (["controllers.0.link=7"], "controllers.0.link: 7 given; allowed: "),
    (["controllers.0.link={up: [{delay: -1}]}"], "controllers.0.link.up.0.delay: -1 given; allowed: greater than"),
    (["controllers.0.link={sideways: []}"], "controllers.0.link.sideways: unknown key; allowed: description, up, down"),
    (["controllers.0.link.up.0.delay=61"], "controllers.0.link.up.0.delay: 61 given; allowed: less than or equal"),
    (["controllers.0.link.up.3.delay=0.1"], "link.up.3: '3' given; allowed: an index from 0 to 1"),
    (["controllers.0.link=nothing", "controllers.0.link.up.0.delay=0.1"], "links: 'nothing' given; allowed: csg"),
    (["controllers.7.link.up.0.delay=0.1"], "controllers.7: '7' given; allowed: an index from 0 to 1"),
    *(
        ([f"controllers.0.namespace={name}"], f"controllers.0.namespace: '{name}' given; allowed: ")
        for name in (
            "/area",
            "area/",
            "1st",
            "a-b",
            "a//b",
            "a b",
            "controller_0_LLC",
            "area/controller_1",
        )
    ),
    ([f"controllers.0.namespace={'n' * 65}"], "... given; allowed: at most 64 characters"),
    (["devices=[tcsc]"], "devices.0: 'tcsc' given; allowed: sssc"),
    (["devices=[]"], "controllers.0.devices: 'sssc' given; allowed: none"),
    (["controllers.0.name=PID"], "controllers.0.name: 'PID' given; allowed: LLC"),
    (["controllers.0.signals=[noise]"], "controllers.0.signals: 'noise' given; allowed: w12"),
    (["controllers.0.signals=[w12, w34]"], "controllers.0.signals: 2 given; allowed: 1 for LLC"),
    (["controllers.0.parameters.gain=1e9"], "parameters.gain: 1e+09 given; allowed: -1000 to 1000"),
    (["controllers.0.parameters.Kp=1"], "parameters.Kp: 'Kp' given; allowed: gain, Tw, T1"),
    (["controllers.0.scheme=direct"], "controllers.0.scheme: 'direct' given; allowed: none for LLC"),
    (
        ["controllers.0.name=HBsWC", "controllers.0.scheme=both"],
        "scheme: 'both' given; allowed: 'direct'",
    ),
    (["controllers.0.name=round+fourier"], "name: antecedent: 'round' given; allowed: gaussian, triangular"),
    (["controllers.0.name=gaussian+cubic"], "name: consequent: 'cubic' given; allowed: singleton, affine"),
    (["controllers.0.name=HBsWC", "controllers.0.parameters.rate=fast"], "'fast' given; allowed: fixed, lyapunov"),
    (["controllers.0.name=HBsWC", "controllers.0.parameters.eta=much"], "parameters.eta: much given; allowed: 0 to"),
    (["controllers.0.name=HBsWC", "controllers.0.profile=wild"], "profile: 'wild' given; allowed: 'deployed'"),
    (["controllers.0.name=HBsWC", "controllers.0.weights=no.yaml"], "weights: no.yaml: no such file; allowed: weights"),
    (
        ["controllers.0.name=HBsWC", "controllers.0.weights={name: ANFTSC, scheme: indirect}"],
        "weights of ANFTSC (indirect) given; allowed: those of HBsWC (indirect)",
    ),
    (
        ["controllers.0.name=ANFTSC", "controllers.0.weights={name: ANFTSC, scheme: indirect, controller: [1.0]}"],
        "controllers.0.weights: controller: 1 numbers given; allowed: 10",
    ),
    (
        ["system=kundur_12_6", "scenario=bus8_fault", "devices=[]", "controllers.0.name=LLC-tuned"],
        "is not tuned for kundur_12_6",
    ),
    (["controllers.1.name=LLC"], "controllers.1.devices: 'sssc' given, which has a controller already"),
    (["scenario.0.kind=earthquake"], "scenario.0.kind: 'earthquake' given; allowed: 'fault', 'clear'"),
    (["system.machines.0.H=-6.5"], "system.machines.0.H: -6.5 given; allowed: greater than 0"),
    (["system.machines.0.Xd=0.1"], "Xl < Xd2 < Xd1 < Xd must hold"),
    (["system.lines.0.from=B77"], "line_5_6.from: 'B77' given; allowed: B1"),
    (["system.machines.1.slack=false", "system.machines.1.P=700"], "0 slack machines given"),
    (["system.devices.0.vp_max=0.5"], "vp_max must be below vc_max"),
    (["no equals"], "allowed: key.path=value"),
]


@pytest.mark.parametrize(("sets", "said"), REFUSED, ids=[" ".join(sets) for sets, _ in REFUSED])
def test_bad_setting_is_refused_by_name(sets: list[str], said: str) -> None:
    with pytest.raises(InputError) as caught:
        load_case(None, sets)
    assert said in str(caught.value)
    assert_one_line(caught.value)


def test_grid_whose_power_flow_does_not_converge_is_refused() -> None:
    case = load_case(None, ["system.loads.1.P=90000", "system.loads.1.at=solved"])
    with pytest.raises(InputError, match=r"power flow does not converge: mismatch .* allowed"):
        assembly.build_plant(case)


def test_island_without_a_machine_is_refused() -> None:
    with pytest.raises(InputError, match="island without a source: buses LONELY; allowed: a machine"):
        load_case(None, ["system.buses.12.name=LONELY", "system.buses.12.nominal_voltage=230"])


def test_event_on_a_line_that_is_not_there_is_refused() -> None:
    with pytest.raises(InputError, match=r"scenario.0.line: 'line_99' given; allowed: line_5_6, line_6_7"):
        load_case(None, ["scenario=multiple", "scenario.0.line=line_99"])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("system: [unclosed", "line 1: unreadable YAML"),
        ("system: a\nsystem: b", "unreadable YAML"),
        ("- just\n- a list", "allowed: a mapping"),
        ("\x00\x01", "unreadable YAML"),
        ("extends: nothing_there", "extends: 'nothing_there' given"),
    ],
)
def test_unreadable_file_is_named(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "run.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_table(path)
    assert str(caught.value).startswith(str(path))
    assert said in str(caught.value)
    assert_one_line(caught.value)


def test_set_below_a_name_changes_the_named_files_content() -> None:
    case = load_case("two_area_small", ["link=delay_100ms", "link.up.1.delay=0.0734", "scenario.0.change=-0.2"])
    assert [mean_delay([stage]) for stage in case.link.up] == [0.02, 0.0734]
    assert case.scenario.events[0].change == -0.2  # type: ignore[union-attr]
    assert case.duration == 20.0


@pytest.mark.parametrize("link", ["ideal", "delay_100ms", "pdci"])
def test_row_is_put_behind_a_list_of_any_length_and_reached_there(link: str) -> None:
    noise = "link.up.+={model: noise, std: 0}"
    before = load_case(None, [f"link={link}"]).link
    after = load_case(None, ["link.up.-1.std=0.5", noise, f"link={link}"]).link
    assert after.up[:-1] == before.up
    assert (after.up[-1], after.down) == (Noise(std=0.5), before.down)


def test_extends_takes_what_it_does_not_say_from_the_other_file() -> None:
    base, dc = load_system("kundur_12_6"), load_system("kundur_12_6_dc")
    assert base.exciters == []
    assert len(dc.exciters) == 4
    assert dc.machines == base.machines


SENSITIVITY = [
    (["controllers.0.parameters.sensitivity=1.0"], "sensitivity: 1 given; allowed: -1 (or 0: automatic)"),
    (
        ["controllers.0.signals=[power]"],
        "has an angle of 90 degrees, near neither 0 nor 180; allowed: another first signal",
    ),
]


@pytest.mark.parametrize("scheme", ["direct", "indirect"])
@pytest.mark.parametrize(("sets", "said"), SENSITIVITY, ids=["wrong sign", "no sign"])
def test_sensitivity_that_is_not_the_plants_is_refused_with_the_reason(scheme: str, sets: list[str], said: str) -> None:
    run_sets = ["scenario=large", "controllers.0.name=ANFTSC", f"controllers.0.scheme={scheme}"]
    with pytest.raises(InputError) as caught:
        loop.build_loop(load_case(None, [*run_sets, *sets]))
    assert said in str(caught.value)
    assert "the residue from sssc to" in str(caught.value)
    assert_one_line(caught.value)


def test_parameters_come_from_the_table_the_tuning_and_the_run_in_this_order() -> None:
    run_sets = ["controllers.0.name=ANFTSC", "controllers.0.scheme=direct"]
    (row,) = load_case(None, [*run_sets, "controllers.0.parameters.eta=0.5"]).controllers
    chosen = tuned("two_area")["ANFTSC", "direct"].parameters
    assert row.parameters["eta"] == 0.5
    assert row.parameters["scale"] == chosen["scale"]
    assert row.parameters["projection"] == "on"
    (raw,) = load_case(None, [*run_sets, "controllers.0.profile=thesis"]).controllers
    assert raw.parameters["projection"] == "off"
    assert raw.parameters["scale"] == chosen["scale"]


BOTH = [
    "devices=[sssc, statcom]",
    "controllers.0.name=LLC",
    "controllers.1.name=LLC",
    "controllers.1.devices=[statcom]",
]
LINKS = [
    ([], [0.0], [0, 0]),
    (["controllers.1.link=delay_100ms"], [0.0, 0.1], [0, 1]),
    (["controllers.0.link=delay_100ms"], [0.0, 0.1], [1, 0]),
    (["controllers.0.link=delay_100ms", "controllers.1.link=delay_100ms"], [0.1, 0.1], [0, 1]),
    (["link=delay_100ms", "controllers.1.link.down.0.delay=0.2"], [0.1, 0.27], [0, 1]),
    (["controllers.1.link.up.0.delay=0.2", "link.up.0.delay=0.3"], [0.3, 0.2], [0, 1]),
    (["controllers.1.link.up.1.delay=0.2", "controllers.1.link=delay_100ms"], [0.0, 0.25], [0, 1]),
]


@pytest.mark.parametrize(("sets", "delays", "used"), LINKS, ids=[" ".join(sets) or "none" for sets, _, _ in LINKS])
def test_controller_uses_its_own_link_or_that_of_the_run(sets: list[str], delays: list[float], used: list[int]) -> None:
    case = load_case(None, [*BOTH, *sets])
    delays_found = [mean_delay([*link.up, *link.down]) for link in case.links]
    assert delays_found == pytest.approx(delays)
    assert case.used_links == used
    assert all(isinstance(c["link"], dict) or c["link"] is None for c in case.document()["controllers"])
    again = make_case(case.document(), "again")
    assert (again.links, again.used_links, again.document()) == (case.links, case.used_links, case.document())
    assert again.summary() == case.summary()


def test_without_controllers_the_runs_link_is_there() -> None:
    case = load_case(None, ["controllers=[]", "link=delay_100ms"])
    assert (case.links, case.used_links) == ([case.link], [])


def test_lag_of_an_identifier_is_that_of_its_controllers_own_link() -> None:
    run_sets = ["controllers.0.name=HBsWC", "controllers.0.scheme=indirect", "link.up.0.delay=0.3"]
    assert load_case(None, run_sets).controllers[0].parameters["loop_delay"] == 0.3
    assert load_case(None, [*run_sets, "controllers.0.link=delay_100ms"]).controllers[0].parameters["loop_delay"] == 0.1


def test_nodes_and_links_have_distinct_addresses() -> None:
    """Whatever has a link or a namespace of its own, also one that is shared, or below another."""
    options = [(link, space) for link in (None, "ideal") for space in (None, "a", "a/b", "b")]
    for first, second in itertools.product(options, options):
        rows: list[dict[str, Any]] = [{"link": link, "namespace": space} for link, space in (first, second)]
        rows[1] |= {"devices": ["statcom"], "name": "HBsWC", "scheme": "indirect"}
        case = make_case({"devices": ["sssc", "statcom"], "controllers": rows}, "here")
        links, controllers = names.link_addresses(case), names.controller_addresses(case)
        identifiers = names.identifier_addresses(case)
        everything = [str(address) for address in (*links, *controllers, *identifiers.values())]
        assert len(set(everything)) == len(everything) == len(case.links) + 3
        assert [address.namespace for address in controllers] == [first[1] or "", second[1] or ""]
        assert identifiers[1].namespace == controllers[1].namespace
        for c, (link, space) in enumerate((first, second)):
            place = links[case.used_links[c]].namespace
            if link is None:
                assert place == ""
            else:
                assert place == (space if space and first[1] != second[1] else str(controllers[c]))


def test_paths_in_a_file_begin_in_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a run, of a study and its axes, at any depth; wherever the command is typed."""
    folder = tmp_path / "mine" / "runs"
    folder.mkdir(parents=True)
    system = (share_folder() / "config" / "systems" / "two_area.yaml").read_text(encoding="utf-8")
    (tmp_path / "mine" / "grid.yaml").write_text(system.replace("name: two_area", "name: my_grid", 1))
    (folder / "slow.yaml").write_text("{up: [{delay: 0.2}], down: []}")
    (folder / "law.yaml").write_text("{num: [1], den: [1, 1]}")
    controller = "{name: mine, linear: law.yaml, link: slow.yaml}"
    (folder / "run.yaml").write_text(f"{{system: ../grid.yaml, scenario: [], controllers: [{controller}]}}")
    (folder / "study.yaml").write_text("{run: run.yaml, sweep: [{field: link, values: [ideal, slow.yaml]}]}")
    monkeypatch.chdir(tmp_path)
    for path in ("mine/runs/run.yaml", str(folder / "run.yaml")):
        case = load_case(path)
        assert (case.system.name, case.links[0].up[0].delay) == ("my_grid", 0.2)  # type: ignore[attr-defined]
    points = sweep.plan("mine/runs/study.yaml", []).points
    assert [point.changes["link"] for point in points] == ["ideal", "mine/runs/slow.yaml"]
    monkeypatch.chdir(folder)
    assert load_case("run.yaml").system.name == "my_grid"


@pytest.mark.parametrize("field", ["link", "controllers.0.link"])
def test_delay_that_the_filter_of_the_run_s_pmus_takes_the_place_of_is_refused(field: str) -> None:
    """The stage `pmu` of a link stands for PMUs without a model of their own."""
    with pytest.raises(InputError, match=rf"^--set {field}.up.0.delay=0.05: the stage models PMUs.* \(p_class\)"):
        load_case("two_area_deployment", [f"{field}.up.0.delay=0.05"])
    exact = load_case("two_area_deployment", [f"{field}.up.0.delay=0.05", "measurement=ideal"])
    assert mean_delay(exact.links[exact.used_links[0]].up[:1]) == 0.05


def test_tuned_controller_files_are_named_by_system_and_profile() -> None:
    """Those of a study have rows by seed, and are only taken by name."""
    for name, path in shipped("controllers").items():
        content = read_table(path)
        profile = content.get("profile", "thesis")
        of_a_study = all(row.get("row") for row in content["controllers"])
        assert of_a_study != name.startswith(
            content["system"] if profile == "thesis" else f"{content['system']}_{profile}"
        )


def test_changed_case_leaves_the_content_that_it_is_made_from() -> None:
    content, source = read_run("two_area_deployment")
    before = repr(content)
    case = changed_case(content, source, {"seed": 7, "system.loads.0.P": 960.0, "controllers.0.parameters.gain": 3.0})
    assert (case.run.seed, case.system.loads[0].P, repr(content)) == (7, 960.0, before)
