"""What a cockpit shows of a case, and what its controls become: texts that the run's own checks accept."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.case import names
from facts_damping.case.controllers import check_parameter, sizes
from facts_damping.case.loading import load_case
from facts_damping.control.table import kind_of
from facts_damping.errors import InputError
from facts_damping.simulation import loop
from facts_damping.simulation.changes import with_event, with_link
from facts_damping_views.cockpit import controls, layout, samples
from tests.two_plants import path

if TYPE_CHECKING:
    from facts_damping.case.model import Case
    from facts_damping_views.cockpit.controls import Control

RUNS = ("two_area_deployment", "minniwecc", "two_area_decentralised", "best_smib_pdci")


@pytest.fixture(scope="module", params=RUNS)
def case(request: pytest.FixtureRequest) -> Case:
    return load_case(request.param, ["scenario=[]"])


def indices(shown: dict[str, Any]) -> list[int]:
    """All indices of curves in a panel."""
    drawn = shown["diagram"]
    curves = [bus["frequency"] for bus in drawn["buses"]] + [link["latency"] for link in drawn["links"]]
    curves += [m[key] for m in drawn["machines"] for key in ("angle", "power") if m[key] is not None]
    curves += [d["setpoint"] for d in drawn["devices"] if d["setpoint"] is not None]
    curves += [monitor["curve"] for monitor in shown["monitors"]]
    return [*curves, *(i for chart in shown["charts"] for i in chart["curves"])]


def test_cockpit_layout_shows_all_parts_of_the_grid_with_their_curves(case: Case) -> None:
    panel = layout.panel(case, "it")
    shown, drawn, system = panel.shown, panel.shown["diagram"], case.system
    json.dumps(shown, allow_nan=False)
    assert [bus["name"] for bus in drawn["buses"]] == [bus.name for bus in system.buses]
    assert len({(bus["x"], bus["y"]) for bus in drawn["buses"]}) == len(system.buses)
    assert {m["name"] for m in drawn["machines"]} == {unit.name for unit in system.units}
    branches = {branch["name"] for branch in drawn["branches"]}
    assert {line.name for line in system.lines} | {transformer.name for transformer in system.transformers} <= branches
    assert set(case.run.devices) <= {d["name"] for d in drawn["devices"]}
    assert sorted(set(indices(shown))) == list(range(len(shown["curves"])))
    assert {chart["unit"] for chart in shown["charts"]} >= {"Hz", "deg", "MW", "p.u.", "ms"}
    assert bool(shown["monitors"]) == (case.supervision is not None)


def test_inverters_stand_at_their_buses_with_their_power_but_no_angle() -> None:
    """A square on the page; its device beside it; no power without a PMU."""
    sets = [f"system={path('solar')}", "devices=[pod_p]", "controllers=[]", "scenario=[]"]
    panel = layout.panel(load_case(None, sets), "it")
    drawn, curves = panel.shown["diagram"], panel.curves
    by_name = {m["name"]: m for m in drawn["machines"]}
    assert by_name["SOLAR"] == {"name": "SOLAR", "bus": "B3", "angle": None, "power": by_name["SOLAR"]["power"]}
    assert curves[by_name["SOLAR"]["power"]].parts == {"pmu.SOLAR.active_power_pu": 100.0}
    assert by_name["G1"]["angle"] is not None
    (device,) = drawn["devices"]
    assert (device["name"], device["bus"]) == ("pod_p", "B3")
    powers = next(chart for chart in panel.shown["charts"] if chart["title"] == "active power")
    assert [curves[i].label for i in powers["curves"]] == ["SOLAR"]
    bare = layout.panel(load_case(None, [*sets, "system.pmus.2.bus=B3", "system.pmus.2.machine=null"]), "it")
    assert {m["name"]: m["power"] for m in bare.shown["diagram"]["machines"]}["SOLAR"] is None
    json.dumps(panel.shown, allow_nan=False)


def test_buses_without_a_pmu_have_a_mean_of_measured_frequencies(case: Case) -> None:
    """Rows of the divider sum to 1: at equal frequencies all buses have that frequency, also beside the nominal one."""
    measured = set(case.system.pmu_buses().values())
    for bus, weights in layout.frequency_weights(case.system).items():
        assert sum(weights.values()) == pytest.approx(1.0, abs=1e-4), bus
        assert (len(weights) == 1) or bus not in measured


def test_bus_without_a_pmu_lies_between_its_neighbours_by_the_susceptances() -> None:
    """B10 is between B11 (G3's, with a PMU by its machine at B3) and B9: two lines of 10 and 25 km, B4 in between."""
    weights = layout.frequency_weights(load_case("two_area_deployment").system)
    assert weights["B8W"] == {"TIE": 1.0}
    assert set(weights["B10"]) == {"G3", "G4"}  # the two of its area; the tie's PMU separates the areas
    assert all(0.0 < weight < 1.0 for weight in weights["B10"].values())


def values_of(control: Control) -> list[Any]:
    """Values at both ends of what a control allows, and as it is shown."""
    shown = control.shown
    if shown["kind"] == "slider":
        some = shown["fields"][0]["choices"]
        return [shown["high"], *({"value": shown["high"], "channel": some[i]} for i in (0, 1, -1))]
    if shown["kind"] == "toggle":
        return [True, False]
    if shown["kind"] == "button":
        return [None]
    choices = {field["name"]: field.get("choices", [field["value"]]) for field in shown["fields"]}
    return [{}, *({name: some[i % len(some)] for name, some in choices.items()} for i in range(3))]


def test_checks_of_the_run_accept_what_every_control_becomes(case: Case) -> None:
    by_id = controls.controls(case, launched=True)
    standing: controls.Values = {}
    links = [str(address) for address in names.link_addresses(case)]
    for control in by_id.values():
        json.dumps(control.shown, allow_nan=False)
        for value_of_page in values_of(control):
            channel, value = controls.checked(control, value_of_page)
            if control.keeps:
                standing[control.id, channel] = value
            request = control.request(value, standing)
            node = request.service.rpartition("/")[0]
            if request.kind == controls.APPLY and node in links:
                changed = with_link(case, links.index(node), request.content).links[links.index(node)]
                assert len(changed.up) + len(changed.down) >= len(case.links[links.index(node)].up)
            elif request.kind == controls.APPLY:
                now = case
                if "line_in" in request.content:
                    now = with_event(case, request.content.replace("line_in", "line_out"), 10**9)
                with_event(now, request.content, 2 * 10**9)
            elif request.kind == controls.LINE:
                assert request.content.split()[1] in names.replaceable(case)
            elif request.kind == controls.PRESET:
                for move in request.content:
                    controls.checked(by_id[move.control], move.value)
            elif request.kind == controls.PARAMETER:
                first = case.controllers[0]
                check_parameter("gain", "gain", request.content[1], kind_of(first).parameters, sizes(first))
    groups = {control.shown["group"] for control in by_id.values()}
    assert groups == {"preset", "link", "grid", "nodes", "run"} | ({"supervisor"} if case.supervision else set())


def test_sliders_of_a_link_add_up_and_return_to_the_run_s_own_link() -> None:
    case = load_case("two_area_deployment")
    by_id, standing = controls.controls(case), dict[tuple[str, str], Any]()

    def link(name: str, moved: Any) -> Any:
        control = by_id[f"link/wan_link/{name}"]
        channel, value = controls.checked(control, moved)
        standing[control.id, channel] = value
        return with_link(case, 0, control.request(value, standing).content).links[0]

    link_of_run = case.links[0]
    assert link("delay", 400).up[-1].delay == 0.4
    up = link("jitter", 50).up
    assert (up[-1].model, up[-1].low, up[-1].high) == ("uniform", 0.4, 0.45)
    assert link("loss", {"value": 10, "channel": "sssc"}).down[-1].loss == 0.1
    cut = link("cut", True)
    assert [stage.loss for stage in (cut.up[-1], cut.down[-1])] == [1.0, 1.0]
    for name in ("delay", "jitter"):
        link(name, 0)
    link("cut", False)
    assert link("loss", {"value": 0, "channel": "sssc"}) == link_of_run


def test_wrong_sign_is_a_parameter_where_there_is_a_gain_and_else_on_the_way_to_the_device() -> None:
    case = load_case("two_area_deployment", ["controllers.0.name=LLC", "controllers.0.parameters={gain: 12}"])
    sign = controls.controls(case)[controls.SIGN]
    node = f"{names.controller_addresses(case)[0]}/set_parameters"
    asked = [sign.request(wrong, {(controls.SIGN, ""): wrong}) for wrong in (True, False)]
    assert asked == [controls.Request(controls.PARAMETER, node, ("gain", gain)) for gain in (-12.0, 12.0)]
    assert sign.shown["label"] == "wrong sign in the controller"
    case = load_case("two_area_deployment", ["controllers.0.name=LQG"])
    sign = controls.controls(case)[controls.SIGN]
    links = [
        with_link(case, 0, sign.request(wrong, {(controls.SIGN, ""): wrong}).content).links[0]
        for wrong in (True, False)
    ]
    assert links[0].down[-1].model_dump()["factor"] == -1.0
    assert sign.shown["label"] == "wrong sign behind the supervisor"
    assert links[1] == case.links[0]


def test_jump_of_the_delay_is_explained_where_a_supervisor_waits_for_frames() -> None:
    hints = [
        controls.controls(load_case("two_area_deployment", sets, ""))["link/wan_link/delay"].shown["hint"]
        for sets in (["supervision.monitors.missing.limit=0.2"], ["supervision.monitors.missing=null"])
    ]
    assert hints == ["a jump over 200 ms leaves a gap: the supervisor trips by missing", ""]


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("link/wan_link/delay", 501, r"link/wan_link/delay: 501 given; allowed: 0 to 500"),
        ("link/wan_link/delay", True, r"True given; allowed: 0 to 500"),
        ("link/wan_link/delay", float("nan"), r"nan given; allowed: 0 to 500"),
        ("link/wan_link/delay", None, r"None given; allowed: 0 to 500"),
        ("link/wan_link/loss", {"value": 1, "channel": "G9"}, r"channel: 'G9' given.*allowed: all, G1, G2"),
        ("link/wan_link/loss", {"value": 1, "much": 1}, r"field 'much' given; allowed: value, channel"),
        ("link/wan_link/cut", 1, r"cut: 1 given; allowed: true, false"),
        ("grid/fault", [], r"grid/fault: \[\] given; allowed: \{field: value\}"),
        ("grid/fault", {"bus": "B99"}, r"grid/fault: bus: 'B99' given.*allowed: B1, B2"),
        ("grid/fault", {"duration": 1e400}, r"grid/fault: duration: inf given; allowed: 0.01 to 1"),
        ("run/step", {"ticks": 0}, r"run/step: ticks: 0 given; allowed: 1 to 6000"),
    ],
)
def test_value_that_is_not_allowed_is_named_with_what_is(name: str, value: Any, text: str) -> None:
    with pytest.raises(InputError, match=text):
        controls.checked(controls.controls(load_case("two_area_deployment"))[name], value)


def test_kill_and_restart_are_there_only_where_a_launcher_reads_them() -> None:
    case = load_case("two_area_deployment")
    asked = {launched: set(controls.controls(case, launched=launched)) for launched in (True, False)}
    assert set(controls.controls(case, launched=True, again=True)) - asked[True] == {"run/again"}
    more = asked[True] - asked[False]
    assert more == {f"nodes/{node}/{what}" for node in names.replaceable(case) for what in ("kill", "restart")}
    assert not any(
        "plant_sim" in control_id or "recorder" in control_id
        for control_id in asked[True]
        if control_id.startswith("nodes/")
    )


def test_damping_is_estimated_from_the_last_seconds_and_after_events_anew() -> None:
    time_s = np.arange(0.0, 30.0, 1 / samples.RATE)
    signal = 50.0 * np.exp(-0.05 * 2 * np.pi * 0.5 * time_s) * np.cos(2 * np.pi * 0.5 * time_s)
    mode = samples.estimate(time_s, signal, -1.0, 60.0)
    assert mode is not None
    assert mode["frequency_hz"] == pytest.approx(0.5, abs=0.005)
    assert mode["damping_ratio"] == pytest.approx(0.05, abs=0.002)
    assert samples.estimate(time_s, signal, 28.0, 60.0) is None
    assert samples.estimate(time_s, 0.0 * signal, -1.0, 60.0) is None


def test_forced_oscillation_in_the_last_minute_is_told() -> None:
    rng, time_s = np.random.default_rng(1), np.arange(0.0, 60.0, 1 / samples.RATE)
    signal, line = 2.0 * rng.normal(size=len(time_s)), 12.0 * np.sin(2 * np.pi * 0.8 * time_s)
    text = samples.forced_oscillation(np.column_stack([time_s, signal + line, np.nan * line]), -1.0, 60.0)
    assert text.startswith("0.80 Hz, 12")
    assert samples.forced_oscillation(np.column_stack([time_s, signal]), -1.0, 60.0) == ""
    assert samples.forced_oscillation(np.zeros((0, 2)), -1.0, 60.0) == ""


def test_curves_of_a_record_are_its_columns_at_twenty_a_second() -> None:
    case = load_case("two_area_deployment", ["duration=4"])
    record = loop.run(case)
    panel = layout.panel(case, "it")
    curves = samples.of_record(case, panel, record)
    rows = np.searchsorted(record.time_s, curves[:, 0] - 1e-6)
    np.testing.assert_allclose(np.diff(curves[:, 0]), 0.05, atol=1e-6)
    columns = record.arrays | samples.latencies(case, record)
    checked = 0
    for i, curve in enumerate(panel.curves):
        if curve.parts:
            wanted = curve.offset + sum(weight * columns[name][rows] for name, weight in curve.parts.items())
            wanted = np.asarray(wanted, np.float32)
            np.testing.assert_allclose(curves[:, 1 + i], wanted, rtol=1e-5, atol=1e-4)
            checked += 1
    assert checked > 50
    angles = curves[:, [1 + m["angle"] for m in panel.shown["diagram"]["machines"]]]
    inertias = np.array([m.rating * m.H for m in case.system.machines])
    np.testing.assert_allclose(angles @ inertias / inertias.sum(), 0.0, atol=1e-4)


def test_of_many_machines_the_largest_of_the_largest_plants_have_curves_of_angles() -> None:
    system = load_case("minniwecc", []).system
    (chart,) = [c for c in layout.panel(load_case("minniwecc", []), "it").shown["charts"] if "angle" in c["title"]]
    assert len(chart["curves"]) == layout.ANGLES < len(system.machines)
    shown = layout.largest(system)
    buses = {machine.name: machine.bus for machine in system.machines}
    assert len({buses[name] for name in shown}) == layout.ANGLES
    assert shown[0] == max(system.machines, key=lambda machine: machine.rating).name
