"""The kinds of cases: a row says what happens in it."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.analysis.grid_state import islands
from facts_damping_studies.score.cases.drawing import (
    EVENTS,
    FAULT,
    START_S,
    STEP,
    TRIP,
    Case,
    Grid,
    dispatch,
    event,
    noise,
    number,
    scaled,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np

    Random = np.random.Generator
    Change = Callable[[Grid, Random, int, Case], Case]

OFF = 10.0  # p.u. per km, reactance of a line that is out of service: the largest allowed
NOISE_S = 40.0  # duration of a case without an event
GAINS = ("KA", "KP", "K")  # of exciters
BAD = (
    {"model": "freeze"},
    {"model": "bias", "bias": 2e-3},
    {"model": "noise", "std": 2e-3},
    {"model": "scale", "factor": 3.0},
)  # of a PMU; p.u. of frequency
WORSE = 50.0  # times as much of a signal that is no frequency


class Kind(NamedTuple):
    """A kind of cases."""

    text: str
    events: tuple[str, ...] = EVENTS  # in turn
    change: Change | None = None
    drawn_as: str = ""  # cases of the kinds with the same name have the same events and grids
    links: bool = True  # delay and loss of the link vary


def _drift(grid: Grid, random: Random, _: int, case: Case) -> Case:
    return case._replace(fields={**case.fields, **dispatch(grid, random, 0.08, 0.15)})


def _wrong_model(grid: Grid, random: Random, i: int, case: Case) -> Case:
    """Other data than those that controllers are designed on."""
    fields, rows = dict(case.fields), grid.rows
    inertias = {area: number(random, 0.7, 1.3) for area in dict.fromkeys(m.get("area") for m in rows["machines"])}
    for j, machine in enumerate(rows["machines"]):
        fields[f"system.machines.{j}.H"] = scaled(machine["H"], inertias[machine.get("area")])
    regulators, governors, loads = (number(random, 0.7, 1.3) for _ in range(3))
    for j, exciter in enumerate(rows.get("exciters", [])):
        gain = next((name for name in GAINS if exciter.get(name)), None)
        if gain is not None:
            fields[f"system.exciters.{j}.{gain}"] = scaled(exciter[gain], regulators)
    for table, name, factor in (("governors", "Tg", governors), ("loads", "kpf", loads)):
        for j, row in enumerate(rows.get(table, [])):
            if row.get(name):
                fields[f"system.{table}.{j}.{name}"] = scaled(row[name], factor)
    for j, line in enumerate(rows["lines"]):
        if line["name"] in grid.lines:
            fields[f"system.lines.{j}.x"] = scaled(line["x"], number(random, 0.7, 1.3))
    return case._replace(fields=fields) if i % 3 else _without_a_line(grid, random, case._replace(fields=fields))


def _without_a_line(grid: Grid, random: Random, case: Case) -> Case:
    """Out of service is a line whose absence beside the event's splits nothing: its reactance is the largest."""
    hit, system = {row["line"] for row in case.events if "line" in row}, grid.system.model_dump(by_alias=True)
    whole = len(islands(system, frozenset()))
    spare = [name for name in grid.lines if name not in hit and len(islands(system, {name, *hit})) == whole]
    if not spare:
        return case
    name = str(random.choice(spare))
    j = next(j for j, line in enumerate(grid.rows["lines"]) if line["name"] == name)
    return case._replace(fields={**case.fields, f"system.lines.{j}.x": OFF, f"system.lines.{j}.b": 0.0})


def _delayed(delay_s: float, _grid: Grid, _random: Random, _i: int, case: Case) -> Case:
    return case._replace(up=[*case.up, {"stage": "network", "model": "constant", "delay": delay_s}])


def _lossy(_grid: Grid, random: Random, i: int, case: Case) -> Case:
    if i % 2:
        lost: dict[str, Any] = {"model": "bernoulli", "loss": number(random, 0.1, 0.4)}
    else:
        bursts = {"p_GB": 0.02, "p_BG": number(random, 0.05, 0.2)}
        lost = {"model": "gilbert_elliott", **bursts, "loss_G": 0.0, "loss_B": 1.0}
    return case._replace(up=[*case.up, {"stage": "network", **lost}])


def _bad_pmu(grid: Grid, random: Random, i: int, case: Case) -> Case:
    bad: dict[str, Any] = {"stage": "pmu", **BAD[i % len(BAD)], "start": case.start_s}
    bad["channels"] = [str(random.choice(list(grid.pmus)))]
    if bad["model"] != "freeze":
        bad["measurement"] = grid.channel
        for size in {"bias", "std"} & set(bad):
            bad[size] *= 1.0 if grid.channel in ("frequency", "speed_deviation") else WORSE
    return case._replace(up=[*case.up, bad])


def _actuator(stage: dict[str, Any], _grid: Grid, _random: Random, _i: int, case: Case) -> Case:
    return case._replace(down=[*case.down, {"stage": "actuator", **stage, "start": case.start_s}])


def _calm(_grid: Grid, _random: Random, _i: int, case: Case) -> Case:
    return case._replace(events=[], fields={**case.fields, "duration": NOISE_S})


KINDS = {
    "nominal": Kind("the grid as it was designed for"),
    "drift": Kind("loads moved by up to 8 %, each unit by up to 15 % more", change=_drift),
    "wrong model": Kind(
        "inertias, reactances, regulators, governors and loads off by up to 30 %; in a third a line is out",
        change=_wrong_model,
    ),
    **{
        f"delay {delay_ms} ms": Kind(
            f"{delay_ms} ms more delay", change=partial(_delayed, delay_ms / 1000.0), drawn_as="delay"
        )
        for delay_ms in (100, 200, 300, 400)
    },
    "loss": Kind("10 to 40 % of the frames lost, alone or in bursts", change=_lossy),
    "bad PMU": Kind("from the event on the values of one PMU are frozen, biased, noisy or scaled", change=_bad_pmu),
    "device lost": Kind(
        "from the event on no setpoint reaches the device",
        change=partial(_actuator, {"model": "bernoulli", "loss": 1.0}),
    ),
    "wrong sign behind the supervisor": Kind(
        "from the event on all setpoints have the wrong sign",
        change=partial(_actuator, {"model": "scale", "factor": -1.0}),
    ),
    "noise": Kind("no event; the index is the rms of the speed differences", change=_calm),
    FAULT: Kind("a fault on a line, for 50 to 100 ms", (FAULT,), links=False),
    TRIP: Kind("a fault on a line, for 50 to 100 ms, cleared by its trip for good", (TRIP,), links=False),
    STEP: Kind(
        "a step of 5 to 15 % of a load or of a mechanical power, or the trip of an inverter as large",
        (STEP,),
        links=False,
    ),
}


def drawn(grid: Grid, kind: str, i: int, random: Random) -> Case:
    """The i-th case of a kind."""
    row, start_s = KINDS[kind], number(random, *START_S)
    events = event(grid, random, row.events[i % len(row.events)], start_s)
    fields = {**dispatch(grid, random, 0.03, 0.05), **noise(grid, random)}
    up = _usual_link(random) if row.links else []
    case = Case(fields, start_s, events, up, [])
    return case if row.change is None else row.change(grid, random, i, case)


def _usual_link(random: Random) -> list[dict[str, Any]]:
    """Up to 60 ms more delay, and a loss of 0.1 to 2 % of the frames."""
    late = {"stage": "network", "model": "constant", "delay": number(random, 0.0, 0.06)}
    return [late, {"stage": "network", "model": "bernoulli", "loss": number(random, 1e-3, 0.02, logarithmic=True)}]
