from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
import pytest

from facts_damping.case.loading import make_case
from facts_damping.errors import InputError
from facts_damping.parameters.events import Event
from facts_damping.plant.events import timeline, topology_intervals
from tests.plant.running import changed, events, follow, frame_times, plant, shipped, slopes

if TYPE_CHECKING:
    from numpy.typing import NDArray

SECOND = 1_000_000_000


def at(time: float, kind: str, **fields: Any) -> dict[str, Any]:
    return {"time": time, "kind": kind, **fields}


# Each kind once, with what its interval must hold.
KINDS: dict[str, list[dict[str, Any]]] = {
    "fault": [at(1.5, "fault", bus="B9")],
    "clear": [at(1.0, "fault", line="line_4"), at(1.5, "clear", line="line_4")],
    "line_out": [at(1.5, "line_out", line="line_2")],
    "line_in": [at(1.0, "line_out", line="line_2"), at(1.5, "line_in", line="line_2")],
    "load_step": [at(1.5, "load_step", load="load_2", change=-0.1)],
    "mechanical_power_step": [at(1.5, "mechanical_power_step", machine="G1", change=0.1)],
    "brake": [at(1.5, "brake", bus="B9", power=100.0)],
    "brake_out": [at(1.0, "brake", bus="B9", power=100.0), at(1.5, "brake_out", bus="B9")],
    "forced_oscillation": [at(1.5, "forced_oscillation", machine="G1", frequency=2.5, amplitude=0.1)],
    "generator_trip": [at(1.5, "generator_trip", machine="G4")],
}


def refusal(*rows: dict[str, Any]) -> str:
    """The message with which events are refused."""
    with pytest.raises(InputError) as error:
        plant("two_area", *rows)
    return str(error.value)


def test_table_of_event_kinds_is_complete() -> None:
    models = get_args(get_args(Event)[0])
    assert set(KINDS) == {kind for model in models for kind in get_args(model.model_fields["kind"].annotation)}


@pytest.mark.parametrize("kind", KINDS)
def test_event_acts_from_its_instant_on(kind: str) -> None:
    """Nothing before, something after; what is taken back leaves the start's network."""
    built = plant("two_area", *KINDS[kind])
    trace = follow(built, [0.0, KINDS[kind][0]["time"], 1.5, 1.6])
    assert np.abs(trace.x[1] - built.state.x).max() < 1e-9
    assert np.abs(trace.x[3] - built.state.x).max() > 1e-4
    if kind == "forced_oscillation":  # the network stays
        assert built.plant.interval_start_ns.tolist() == [0]
        return
    assert built.plant.interval_start_ns[-1] == 1.5 * SECOND
    assert built.plant.interval_start_ns[0] == 0
    before, after = slopes(built, interval=0), slopes(built, interval=len(built.plant.interval_start_ns) - 1)
    assert np.abs(before).max() < 1e-9
    if kind in ("clear", "brake_out", "line_in"):
        assert np.abs(slopes(built, interval=1)).max() > 1e-3
        np.testing.assert_array_equal(built.plant.network[2], built.plant.network[0])
        np.testing.assert_array_equal(after, before)
    else:
        assert np.abs(after).max() > 1e-3


def test_line_that_goes_out_and_comes_in_leaves_no_trace() -> None:
    rows = [at(1.0, "line_out", line="line_2"), at(2.0, "line_in", line="line_2")]
    intervals = topology_intervals(shipped("two_area"), events(*rows))
    assert [s.start_ns for s in intervals] == [0, SECOND, 2 * SECOND]
    assert [s.topology.lines_out for s in intervals] == [frozenset(), {"line_2"}, frozenset()]


def test_steps_are_relative_to_the_start() -> None:
    """A second step replaces the first: both are fractions of what was at the start."""
    rows = [
        at(1.0, "load_step", load="load_2", change=-0.1),
        at(2.0, "load_step", load="load_2", change=0.2),
        at(3.0, "mechanical_power_step", machine="G1", change=0.1),
        at(4.0, "mechanical_power_step", machine="G1", change=0.0),
        at(5.0, "load_step", load="load_1", change=0.3),
        at(5.0, "mechanical_power_step", machine="G2", change=-0.2),
        at(6.0, "mechanical_power_step", machine="G1", change=0.5),
    ]
    built = plant("two_area", *rows)
    intervals = topology_intervals(shipped("two_area"), events(*rows))
    assert [s.topology.load_scale.get("load_2", 1.0) for s in intervals] == pytest.approx(
        [1, 0.9, 1.2, 1.2, 1.2, 1.2, 1.2]
    )
    assert [s.topology.load_scale.get("load_1", 1.0) for s in intervals] == pytest.approx([1, 1, 1, 1, 1, 1.3, 1.3])
    power = built.plant.mechanical_power
    np.testing.assert_allclose(power[:, 0] / power[0, 0], [1, 1, 1, 1.1, 1, 1, 1.5], rtol=1e-14)
    np.testing.assert_allclose(power[:, 1] / power[0, 1], [1, 1, 1, 1, 1, 0.8, 0.8], rtol=1e-14)
    np.testing.assert_array_equal(power[:, 2:], np.tile(power[0, 2:], (7, 1)))


def test_order_in_the_list_is_of_no_account() -> None:
    rows = [at(t, "load_step", load="load_1", change=c) for t, c in ((3.0, 0.3), (1.0, 0.1), (2.0, 0.2))]
    intervals = topology_intervals(shipped("two_area"), events(*rows))
    assert [s.topology.load_scale.get("load_1", 1.0) for s in intervals] == pytest.approx([1, 1.1, 1.2, 1.3])


def test_events_at_one_instant_are_one_stage() -> None:
    rows = [
        at(1.0, "load_step", load="load_1", change=0.1),
        at(1.0, "line_out", line="line_2"),
        at(0.0, "line_out", line="line_1"),
    ]
    intervals = topology_intervals(shipped("two_area"), events(*rows[:2]))
    assert [s.start_ns for s in intervals] == [0, SECOND]
    assert dict(intervals[1].topology.load_scale) == {"load_1": 1.1}
    assert intervals[1].topology.lines_out == {"line_2"}
    (only,) = topology_intervals(shipped("two_area"), events(rows[2]))
    assert only.topology.lines_out == {"line_1"}


def test_tripped_machine_gives_nothing_and_is_no_longer_in_the_grid() -> None:
    built = plant("two_area", at(1.0, "generator_trip", machine="G4"))
    trace = follow(built, frame_times(3))
    out = trace.t >= 1.0
    assert (trace.machines["electrical_power"][out, 3] == 0).all()
    assert (trace.frames[out, 3, 3] == 0).all()
    assert (trace.frames[~out, 3, 3] > 6.9).all()
    assert np.abs(trace.speeds[out, 3]).max() < 1e-9
    assert built.plant.mechanical_power[1, 3] == 0
    assert trace.speeds[-1, :3].max() < -5e-4  # the others have its load to carry


@pytest.mark.parametrize("place", [{"bus": "B9"}, {"line": "line_4", "location": 0.3}])
@pytest.mark.parametrize("impedance", [{}, {"r": 0.01, "x": 0.02}])
def test_fault_with_a_duration_is_a_fault_and_a_clear(place: dict[str, Any], impedance: dict[str, float]) -> None:
    """Bit for bit."""
    element = {key: value for key, value in place.items() if key != "location"}
    brief = plant("two_area", at(1.0, "fault", duration=0.1, **place, **impedance))
    both = plant("two_area", at(1.1, "clear", **element), at(1.0, "fault", **place, **impedance))
    traces = [follow(built, frame_times(2)) for built in (brief, both)]
    np.testing.assert_array_equal(traces[0].x, traces[1].x)
    assert np.abs(traces[0].speeds).max() > 1e-4


def test_timeline_names_the_event_that_a_clearing_belongs_to() -> None:
    rows = [at(2.0, "load_step", load="load_1", change=0.1), at(1.0, "fault", bus="B9", duration=0.5)]
    changes = [(change.time_ns, change.where, change.event.kind) for change in timeline(events(*rows))]
    assert changes == [
        (SECOND, "events.1", "fault"),
        (3 * SECOND // 2, "events.1.duration", "clear"),
        (2 * SECOND, "events.0", "load_step"),
    ]


def during(place: dict[str, Any]) -> NDArray[np.float64]:
    """Slopes of the start's state with a fault burning, without the device, whose bus may be the faulted one."""
    return slopes(plant("two_area", at(0.0, "fault", **place), installed=[]))


@pytest.mark.parametrize(("location", "bus"), [(1e-9, "B8E"), (1 - 1e-9, "B9")])
def test_fault_at_the_end_of_a_line_is_one_at_its_bus(location: float, bus: str) -> None:
    near, there = during({"line": "line_4", "location": location}), during({"bus": bus})
    middle = during({"line": "line_4", "location": 0.5})
    np.testing.assert_allclose(near, there, rtol=1e-6, atol=1e-6)
    assert np.abs(middle - there).max() > 1e-3


def test_bolted_fault_is_the_limit_of_a_small_impedance() -> None:
    bolted, small, large = (during({"line": "line_4", "r": r}) for r in (0.0, 1e-9, 1e3))
    np.testing.assert_allclose(small, bolted, rtol=0, atol=1e-4)
    assert np.abs(large).max() < 1e-2 < np.abs(bolted).max()


def test_bolted_fault_holds_its_bus_at_zero() -> None:
    system = shipped("two_area")
    (pmu,) = [i for i, s in enumerate(system.pmus) if s.name == "TIE"]
    trace = follow(plant(system, at(1.0, "fault", bus="B8W", duration=0.1)), frame_times(2))
    burning = (trace.t >= 1.0) & (trace.t < 1.1)
    assert (trace.frames[burning, pmu, 0] == 0).all()
    assert (trace.frames[~burning, pmu, 0] > 0.5).all()


def test_line_taken_out_takes_its_fault_along() -> None:
    """The usual clearing by breakers; a fault that still burns is back with the line."""
    fault = [at(1.0, "fault", line="line_4", location=0.3, r=0.01), at(1.1, "line_out", line="line_4")]
    out = plant("two_area", at(1.1, "line_out", line="line_4")).plant.network[-1]
    burning = plant("two_area", *fault, at(2.0, "line_in", line="line_4")).plant.network
    cleared = [at(1.5, "clear", line="line_4"), at(2.0, "line_in", line="line_4")]
    healthy = plant("two_area", *fault, *cleared).plant.network
    np.testing.assert_array_equal(burning[2], out)
    np.testing.assert_array_equal(burning[3], burning[1])
    np.testing.assert_array_equal(healthy[-1], healthy[0])


def oscillation(**fields: Any) -> dict[str, Any]:
    """A forced oscillation."""
    return {**at(1.0, "forced_oscillation"), "frequency": 0.5, "amplitude": 0.1, **fields}


# Events, and what the message must name: index and field, value given, what is allowed.
REFUSED: list[tuple[list[dict[str, Any]], str, str, str]] = [
    ([at(1, "fault", bus="B99")], "events.0.bus", "'B99'", "B1, B2"),
    ([at(1, "fault", line="tie")], "events.0.line", "'tie'", "line_5_6, line_6_7"),
    ([at(1, "fault", line="T1")], "events.0.line", "'T1'", "line_5_6"),
    ([at(1, "fault", bus="B9"), at(2, "fault", bus="B9")], "events.1", "'B9'", "one fault an element"),
    ([at(1, "fault", line="line_4"), at(2, "fault", line="line_4", location=0.9)], "events.1", "'line_4'", "one fault"),
    ([at(1, "clear", bus="B9")], "events.0", "'B9'", "none"),
    ([at(1, "clear", bus="B99")], "events.0.bus", "'B99'", "B1, B2"),
    ([at(1, "fault", line="line_4"), at(2, "clear", line="line_3")], "events.1", "'line_3'", "line_4"),
    ([at(1, "fault", bus="B9", duration=0.1), at(2, "clear", bus="B9")], "events.1", "'B9'", "none"),
    ([at(1, "fault", bus="B9", duration=0.5), at(1.2, "clear", bus="B9")], "events.0.duration", "'B9'", "none"),
    ([at(2, "fault", bus="B9"), at(1, "clear", bus="B9")], "events.1", "'B9'", "none"),
    ([at(1, "line_out", line="line_9")], "events.0.line", "'line_9'", "line_1, line_2"),
    ([at(1, "line_out", line="sssc")], "events.0.line", "'sssc'", "line_1, line_2"),
    (
        [at(1, "line_out", line="line_2"), at(2, "line_out", line="line_2")],
        "events.1.line",
        "'line_2'",
        "line_1, line_3",
    ),
    ([at(1, "line_in", line="line_2")], "events.0.line", "'line_2'", "none"),
    ([at(1, "line_out", line="line_2"), at(2, "line_in", line="line_3")], "events.1.line", "'line_3'", "line_2"),
    ([at(1, "load_step", load="load_3", change=0.1)], "events.0.load", "'load_3'", "load_1, load_2"),
    ([at(1, "mechanical_power_step", machine="G5", change=0.1)], "events.0.machine", "'G5'", "G1, G2, G3, G4"),
    ([at(1, "brake", bus="B99", power=1.0)], "events.0.bus", "'B99'", "B1, B2"),
    ([at(1, "brake", bus="B9", power=1.0), at(2, "brake", bus="B9", power=2.0)], "events.1", "'B9'", "one brake a bus"),
    ([at(1, "brake_out", bus="B9")], "events.0", "'B9'", "none"),
    ([at(1, "brake", bus="B9", power=1.0), at(2, "brake_out", bus="B8W")], "events.1", "'B8W'", "B9"),
    (
        [at(1, "brake", bus="B9", power=1.0, duration=0.5), at(2, "brake_out", bus="B9")],
        "events.1",
        "'B9'",
        "none",
    ),
    ([oscillation(machine="G5")], "events.0.machine", "'G5'", "G1, G2, G3, G4"),
    ([oscillation(load="load_3", amplitude=0.0)], "events.0.load", "'load_3'", "load_1, load_2"),
    ([oscillation(load="load_1", amplitude=1.5)], "events.0.amplitude", "1.5", "at most 1, the whole load"),
    ([oscillation(machine="G1", frequency=500.0)], "events.0.frequency", "500", "at most "),
    ([at(0, "generator_trip", machine="G1"), oscillation(machine="G1")], "events.1.machine", "'G1'", "G2, G3, G4"),
    ([at(1, "generator_trip", machine="G5")], "events.0.machine", "'G5'", "G1, G2, G3, G4"),
    ([at(1, "generator_trip", machine="G1")] * 2, "events.1.machine", "'G1'", "G2, G3, G4"),
    (
        [at(1, "generator_trip", machine="G1"), at(2, "mechanical_power_step", machine="G1", change=0.1)],
        "events.1.machine",
        "'G1'",
        "G2, G3, G4",
    ),
]


@pytest.mark.parametrize(("rows", "where", "problem", "allowed"), REFUSED)
def test_impossible_event_is_refused(rows: list[dict[str, Any]], where: str, problem: str, allowed: str) -> None:
    message = refusal(*rows)
    assert re.match(rf"{re.escape(where)}: {problem} given", message), message
    assert allowed in message.partition("allowed: ")[2]
    assert problem.strip("'") not in message.partition("allowed: ")[2].split(", ")


def test_line_is_not_taken_for_the_bus_of_its_name() -> None:
    system = shipped("two_area")
    lines = [{**line.model_dump(by_alias=True)} for line in system.lines]
    lines[0]["name"] = "B9"
    with pytest.raises(InputError, match=r"events\.1"):
        plant(changed(system, lines=lines), at(1, "fault", bus="B9"), at(2, "clear", line="B9"))


def test_island_without_a_machine_is_refused() -> None:
    rows = [at(1, "line_out", line="T1"), at(2, "line_out", line="T2"), at(3, "line_out", line="line_6_7")]
    message = refusal(*rows)
    assert re.match(r"events\.2 \(line_out\): .*island without a source: buses B5, B6; allowed: a machine", message)
    trips = [at(g, "generator_trip", machine=f"G{g}") for g in (1, 2, 3, 4)]
    assert re.match(
        r"events\.3 \(generator_trip\): .*island without a source: buses B1, B2, .*allowed:", refusal(*trips)
    )


def test_two_islands_with_machines_run_apart() -> None:
    rows = [at(1.0, "line_out", line="line_1"), at(1.0, "line_out", line="line_2")]
    """Their angles drift apart; each is in synchronism by itself."""
    trace = follow(plant("two_area", *rows, installed=[]), frame_times(3))
    assert trace.speeds[-1, :2].min() > 1e-3
    assert trace.speeds[-1, 2:].max() < -1e-3
    assert np.ptp(trace.machines["rotor_angle"][-1]) > np.pi
    assert trace.sound.all()


@pytest.mark.parametrize("lines", [("line_1", "line_2"), ("line_3", "line_4")])
def test_two_islands_run_apart_with_the_device_between_them(lines: tuple[str, str]) -> None:
    """One bus of the SSSC has lost its lines: no current can flow, the converter is blocked."""
    built = plant("two_area", *(at(1.0, "line_out", line=line) for line in lines))
    trace = follow(built, frame_times(2))
    assert (trace.devices["blocked"][trace.t >= 1.0] == 1).all()
    without = follow(
        plant("two_area", *(at(1.0, "line_out", line=line) for line in lines), installed=[]), frame_times(2)
    )
    np.testing.assert_allclose(trace.speeds, without.speeds, rtol=0, atol=1e-7)


@pytest.mark.parametrize(
    ("row", "field", "allowed"),
    [
        (at(-1, "line_out", line="line_1"), "scenario.0.time", "greater than or equal to 0"),
        (at(1, "earthquake"), "scenario.0.kind", "'fault'"),
        (at(1, "fault"), r"scenario.0(\.\w+)?", "either `bus` or `line`"),
        (at(1, "clear", bus="B9", line="line_1"), r"scenario.0(\.\w+)?", "either `bus` or `line`"),
        (at(1, "fault", line="line_1", location=1.0), "scenario.0.location", "less than 1"),
        (at(1, "load_step", load="load_1", change=-1.5), "scenario.0.change", "greater than or equal to -1"),
        (at(1, "generator_trip", machine="G1", change=1.0), "scenario.0.change", "time, kind, machine"),
        (at(1, "line_out"), "scenario.0.line", "missing"),
        (at(float("nan"), "line_out", line="line_1"), "scenario.0.time", "finite"),
        (at(1, "brake", bus="B9", power=0.0), "scenario.0.power", "greater than 0"),
        (at(1, "brake", bus="B9"), r"scenario.0(\.\w+)?", "needs `power`"),
        (at(1, "brake_out", bus="B9", duration=1.0), r"scenario.0(\.\w+)?", "needs `bus` alone"),
        (at(1, "brake", bus="B9", power=1.0, duration=0.0), "scenario.0.duration", "greater than 0"),
        (oscillation(machine="G1", frequency=0.0), "scenario.0.frequency", "greater than 0"),
        (oscillation(machine="G1", duration=0.0), "scenario.0.duration", "greater than 0"),
        (oscillation(machine="G1", waveform="saw"), "scenario.0.waveform", "'sine' or 'square'"),
        (oscillation(), r"scenario.0(\.\w+)?", "one of `machine`, `load`, `exciter`"),
        (oscillation(machine="G1", load="load_1"), r"scenario.0(\.\w+)?", "one of `machine`, `load`, `exciter`"),
    ],
)
def test_rows_that_are_no_events_are_refused(row: dict[str, Any], field: str, allowed: str) -> None:
    with pytest.raises(InputError) as error:
        make_case({"scenario": [row]}, "run.yaml")
    assert re.match(rf"run\.yaml: ({field}): ", str(error.value)), error.value
    assert allowed in str(error.value)
