"""Choosing place, signal and lead-lag for a mode, against closed loops that are worked out apart and simulated."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import facts_damping_studies
from facts_damping.analysis.summary import summarise
from facts_damping.case.loading import load_case, make_case, read_system
from facts_damping.cli.main import main
from facts_damping.errors import InputError
from facts_damping.parameters.plant.placement import place
from facts_damping.plant.build import build
from facts_damping.simulation import loop
from facts_damping.small_signal import linearisation
from facts_damping_studies.design import design, design_pages, lead_lag, places
from facts_damping_studies.margins import delay_margin
from facts_damping_studies.search import scoring
from facts_damping_studies.sweeps import enumerated_axes

SYSTEM = "two_area"


def quiet(_name: str, _what: str) -> Any:
    return lambda _done, _of: None


@pytest.fixture(scope="module")
def designed() -> design.Design:
    return design.design(design.Task(SYSTEM, [], 0.1, 0.1), 1, quiet)


@given(
    angle=st.floats(-180.0, 180.0),
    hertz=st.floats(0.15, 2.0),
    ratio=st.floats(-0.05, 0.2),
    delay=st.floats(0.0, 0.5),
)
def test_lead_lag_turns_the_residue_to_the_left(angle: float, hertz: float, ratio: float, delay: float) -> None:
    """Phase by phase: residue, two sections, washout, delay and half a frame, sign; at the eigenvalue."""
    w = 2.0 * np.pi * hertz
    s = complex(-ratio * w, w * np.sqrt(1.0 - ratio**2))
    law = lead_lag.lead_lag(np.exp(1j * np.deg2rad(angle)), s, delay, 60)
    assert abs(law.lead_deg) <= 90.0 + 1e-9
    section = np.angle(1.0 + s * law.T1) - np.angle(1.0 + s * law.T2)
    washout = np.angle(s) - np.angle(1.0 + s * lead_lag.WASHOUT)
    turned = np.deg2rad(angle) + 2.0 * section + washout - s.imag * (delay + 1 / 120) + (law.sign < 0.0) * np.pi
    assert abs(np.angle(np.exp(1j * (turned - np.pi)))) < 2e-3  # four figures of T1 and T2
    assert pytest.approx(1.0 / w**2, rel=1e-3) == law.T1 * law.T2


@pytest.mark.parametrize("at", ["statcom", "line_9_10", "B9"])
def test_residues_are_how_eigenvalues_move(at: str) -> None:
    """Of a device at its place, by the eigenvalues of the plant with a small gain from signal to setpoint."""
    system_read = read_system(SYSTEM)
    modes, _ = design.listed_modes(design.Task(SYSTEM, [], 0.1, 0.1), system_read)
    system = places.only(places.with_signals(system_read, modes), ["w13", "w12", "p_line_6_7"], system_read)
    chosen = next(p for p in places.places(system_read) if at in (p.at, p.device.name if p.own else None))
    seen = places.tried(places.Trial(system, chosen, modes))
    placed = place(places.with_place(system, chosen))
    built = build(placed, [chosen.device.name], [])
    model = linearisation.linear_model(built, placed.signals, [s.name for s in placed.pmus])

    def moved(mode: int, row: int, gain: float) -> complex:
        A = model.A + gain * np.outer(model.B[:, 0], model.C[row]) / (1.0 - gain * model.D[row, 0])
        values = np.linalg.eigvals(A)
        return complex(values[np.argmin(abs(values - modes[mode].eigenvalue))])

    for row, name in enumerate(system.signals):
        step = 1e-4 / max(1.0, float(np.abs(seen.residue[:, row]).max()))
        for mode in range(len(modes)):
            slope = (moved(mode, row, step) - moved(mode, row, -step)) / (2.0 * step)
            assert abs(slope - seen.residue[mode, row]) < 2e-4 * abs(slope) + 1e-7, name


def test_places_of_devices_have_every_line_and_bus_once() -> None:
    system = read_system(SYSTEM)
    all_places = places.places(system)
    kinds_and_places = [(p.device.kind, p.at) for p in all_places]
    assert len(set(kinds_and_places)) == len(kinds_and_places)
    machines = {m.bus for m in system.machines}
    assert not any(p.device.kind == "statcom" and p.at in machines for p in all_places if not p.own)
    lines = {line.name for line in system.lines}
    assert {p.at for p in all_places if p.device.kind == "sssc" and not p.own} == lines
    assert [p.device.name for p in all_places if p.own] == ["sssc", "statcom"]


def test_help_names_all_kinds_of_new_devices() -> None:
    table = Path(facts_damping_studies.__file__).with_name("commands.yaml").read_text(encoding="utf-8")
    assert f"new devices: {', '.join(places.NEW_DEVICES)}; default" in table


# At inverters: test_inverter_places.py.
@pytest.mark.parametrize("kind", [kind for kind in places.NEW_DEVICES if kind != "inverter_input"])
def test_new_devices_of_each_kind_have_places(kind: str) -> None:
    """In lines, at buses or at machines; each moves the interarea mode at its best place, by what the label says."""
    system = read_system(SYSTEM)
    new_places = [p for p in places.places(system, [kind]) if not p.own]
    in_lines, machines = {line.name for line in system.lines}, {m.name for m in system.machines}
    buses = {bus.name for bus in system.buses} - {m.bus for m in system.machines} - {"B8W"}  # that of the STATCOM
    assert {p.at for p in new_places} in (in_lines, machines, buses)
    assert {p.device.kind for p in new_places} == {kind}
    modes, _ = design.listed_modes(design.Task(SYSTEM, [], 0.1, 0.1), system)
    strengths = {p.label: places.tried(places.Trial(system, p, modes)).strength[0] for p in new_places}
    assert all(label.startswith((f"{kind} in ", f"{kind} at ")) for label in strengths)
    assert max(strengths.values()) > 1e-4
    assert np.isfinite(list(strengths.values())).all()


def test_design_of_exciter_inputs_alone_has_scenarios() -> None:
    """No line and no bus is a candidate: faults at the grid's own."""
    task = design.Task("kundur_12_6_thyristor", [], 0.05, 0.1, kinds=["exciter_input"])
    task_design = design.design(task, 1, quiet)
    assert set(task_design.scenarios) == {"fault", "line_out"}
    assert task_design.tried[task_design.chosen.tried].place.device.kind == "exciter_input"


def test_unknown_kind_is_refused() -> None:
    with pytest.raises(InputError, match="--kinds: 'upfc' given"):
        design.design(design.Task(SYSTEM, [], 0.1, 0.1, kinds=["upfc"]), 1, quiet)


def test_wanted_ratio_is_that_of_the_closed_loop(designed: design.Design) -> None:
    """By the margin's own study at the delay that was given, and by a simulation of a small step of a load."""
    assert designed.tuned.reached
    run = {**designed.run, "system": designed.content, "scenario": []}
    margin = delay_margin.margin(make_case(run, "test"), 0.6, None, lambda _done, _of: None)
    at = int(np.argmin(np.abs(margin.delays - 0.1)))
    track = next(t for t in margin.tracks if t.label == "interarea")
    there = track.modes[at]
    assert there is not None
    assert there.damping_ratio == pytest.approx(0.1, abs=1e-3)
    assert designed.stable is not None
    assert designed.stable.low == margin.stable[0][0]
    assert designed.stable.high == pytest.approx(margin.stable[0][1], abs=1e-5)
    run["scenario"] = [{"time": 1.0, "kind": "load_step", "load": "load_1", "change": 0.01}]
    result = summarise(loop.run(make_case({**run, "duration": 25.0}, "test")))
    slow = min((mode for mode in result.modes), key=lambda mode: abs(mode.frequency_hz - 0.64))
    assert slow.damping_ratio == pytest.approx(0.1, abs=0.015)


def test_predicted_damping_of_other_modes_agrees_with_the_closed_loop() -> None:
    """A pair that takes damping from another mode is told, and passed over where there is another one."""
    task = design.Task(SYSTEM, [], 0.1, 0.1, place="B10", signal="w13")
    task_design = design.design(task, 1, quiet)
    (pair,) = task_design.pairs
    lost = int(np.argmin(pair.others))
    assert pair.others[lost] < -design.CONFLICT
    assert pair.conflicts()
    names = [round(mode.frequency_hz, 1) for mode in task_design.modes]
    before, after = task_design.tuned.before, task_design.tuned.after
    other = min(range(len(before)), key=lambda i: abs(before[i].frequency_hz - task_design.modes[lost].frequency_hz))
    changed = [(b.damping_ratio - a.damping_ratio) for a, b in zip(before, after, strict=True) if b is not None]
    assert changed[task_design.tuned.target] > 0.0 > changed[other], names
    free = design.design(task._replace(place=None, signal=None), 1, quiet)
    assert not free.chosen.conflicts()
    assert any(free_pair.conflicts() for free_pair in free.pairs)


def test_files_run(designed: design.Design, tmp_path: Path) -> None:
    """The run as written is the loop that was designed, and its scenarios keep the grid together."""
    written = design_pages.write(designed, tmp_path)
    assert [path.name for path in written][-2:] == ["run.yaml", "training_cases.yaml"]
    assert enumerated_axes.scenarios(str(tmp_path / "system.yaml")) == [
        str(tmp_path / f"{name}.yaml") for name in designed.scenarios
    ]
    known = scoring.draws(
        str(tmp_path / "system.yaml"), None, 3, str(tmp_path / "training_cases.yaml"), reference="none"
    )
    assert len(known) == 3
    case = load_case(str(tmp_path / "run.yaml"))
    assert case.controllers[0].parameters["gain"] == designed.chosen.law.parameters(designed.tuned.gain)["gain"]
    assert case.scenario.name in designed.scenarios
    result = summarise(loop.run(case))
    assert result.verdict == "damped"
    assert design_pages.plot(designed, tmp_path / "places.png").stat().st_size > 10_000
    text = "\n".join(design_pages.text(designed))
    assert "damping ratio: 0.1" in text
    assert design_pages.document(designed)["reached"] is True


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"damping": 0.001, "mode_hz": 1.1}, "--damping 0.001: the mode of 1.1.. Hz has 0...."),
        ({"mode_hz": 1.7}, "--mode 1.7: no electromechanical mode is near; allowed: 0.630, 1.121, 1.157 Hz"),
        ({"place": "B99"}, "--place: 'B99' given .*; allowed: "),
        ({"place": "B1"}, "--place: 'B1' given .*; allowed: "),
        ({"signal": "w99"}, "--signal: 'w99' given; allowed: "),
    ],
)
def test_impossible_design_is_refused(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        design.design(design.Task(SYSTEM, [], 0.1, 0.1)._replace(**changes), 1, quiet)


def test_place_that_is_asked_for_is_taken_and_all_are_ranked(tmp_path: Path) -> None:
    """A line's own device stays in service in the scenarios; what an earlier design wrote goes."""
    (tmp_path / "line_out.yaml").write_text("of an earlier design")
    task = design.Task(SYSTEM, [], 0.05, 0.1, place="line_1", signal="w13")
    task_design = design.design(task, 1, quiet)
    assert {task_design.tried[pair.tried].place.at for pair in task_design.pairs} == {"line_1"}
    assert len(task_design.tried) == len(places.places(read_system(SYSTEM)))
    tripped = [event.get("line") for scenario in task_design.scenarios.values() for event in scenario["events"]]
    assert "line_1" not in tripped
    design_pages.write(task_design, tmp_path)
    left = (tmp_path / "line_out.yaml").exists()
    assert left == ("line_out" in task_design.scenarios)
    assert load_case(str(tmp_path / "run.yaml")).system.device("damper").place == "B7-line_1.damper"


def test_speed_of_a_machine_at_an_infinite_bus_is_a_signal() -> None:
    """Where no machine swings against it, and the system names no speed itself."""
    sets = ["signals={}", "measures={}"]
    system_read = read_system("smib", sets)
    modes, _ = design.listed_modes(design.Task("smib", sets, 0.1, 0.1), system_read)
    signals = places.with_signals(system_read, modes).signals
    assert signals["w_G1"].weights == {"G1": 1.0}


def test_signals_of_the_user_s_own_stay_as_they_are() -> None:
    """Also where a new one would have their name, and where the same flow is measured already."""
    sets = ["signals.p_line_6_7={channel: active_power, weights: {TIE: 2}}"]
    system_read = read_system(SYSTEM, sets)
    modes, _ = design.listed_modes(design.Task(SYSTEM, [], 0.1, 0.1), system_read)
    signals = places.with_signals(system_read, modes).signals
    assert {name: signals[name] for name in system_read.signals} == system_read.signals
    assert signals["p_line_6_7_"].channel == "active_power"
    again = places.with_signals(places.with_signals(system_read, modes), modes)
    assert list(again.signals) == list(signals)


def test_equal_machines_at_a_bus_are_one_with_the_same_modes() -> None:
    """The rest of the eigenvalues is of such machines against each other."""
    whole = read_system(SYSTEM)
    parts: dict[str, list[Any]] = {field: [] for field in ("machines", "exciters", "stabilisers", "governors")}
    for machine in whole.machines:
        names = [machine.name] if machine.slack else [machine.name, f"{machine.name}_2", f"{machine.name}_3"]
        shares = {"rating": machine.rating / len(names), "P": None if machine.P is None else machine.P / len(names)}
        for name in names:
            parts["machines"].append(machine.model_copy(update={"name": name, **shares}))
            for field in ("exciters", "stabilisers", "governors"):
                rows = [row for row in getattr(whole, field) if row.machine == machine.name]
                parts[field] += [row.model_copy(update={"machine": name}) for row in rows]
    split = whole.model_copy(update=parts)
    merged = places.merged(split)
    assert [machine.name for machine in merged.machines] == [machine.name for machine in whole.machines]
    assert [machine.rating for machine in merged.machines] == pytest.approx([m.rating for m in whole.machines])
    many, few = (
        design.listed_modes(design.Task(SYSTEM, [], 0.1, 0.1, mode_hz=0.63), system)[0] for system in (split, merged)
    )
    for mode in few:
        assert min(abs(other.eigenvalue - mode.eigenvalue) for other in many) < 1e-3
    unequal = split.model_copy(
        update={"machines": [m.model_copy(update={"H": 5.0 if m.name == "G1_2" else m.H}) for m in split.machines]}
    )
    assert {"G1", "G1_2"} <= {machine.name for machine in places.merged(unequal).machines}


def test_profile_gives_signals_that_its_pmus_report(tmp_path: Path) -> None:
    task = design.Task(SYSTEM, [], 0.1, 0.1, place="sssc", kinds=[], profile="deployment")
    designed = design.design(task, 1, quiet)
    assert designed.system.signals[designed.chosen.signal].channel == "frequency"
    design_pages.write(designed, tmp_path)
    case = load_case(str(tmp_path / "run.yaml"), ["duration=0.1"])
    assert (case.measurement.filter, case.run.profile) == ("p_class", "deployment")
    loop.run(case)


def test_mode_that_needs_damping_is_taken_before_interarea_modes_that_do_not() -> None:
    system_read = read_system(SYSTEM)
    modes, target = design.listed_modes(design.Task(SYSTEM, [], 0.1, 0.1), system_read)
    assert modes[target].label == "interarea"
    damped = modes[target]._replace(damping_ratio=0.11)
    others = [mode._replace(damping_ratio=0.02, label="local") for mode in modes if mode is not modes[target]]
    wanted = design._wanted(design.Task(SYSTEM, [], 0.1, 0.1), [*others, damped])
    assert wanted is others[0]


def test_ranking_is_shown_where_nothing_is_to_be_designed(capsys: pytest.CaptureFixture[str]) -> None:
    asked = ["--law", "residue", "--damping", "0.001", "--mode", "1.12", "--place", "sssc", "--jobs", "1"]
    assert main(["design", SYSTEM, *asked]) == 2
    shown = capsys.readouterr()
    assert "places: controllability" in shown.out
    assert "already; allowed: a higher ratio, or another --mode" in shown.err
