"""Time of plants with inverters beside machines, for each state; and of runs without inverters beside another version.

    python benchmarks/inverters.py [--beside FOLDER]

Units stand at lines of their own to a bus behind a line to an infinite bus: machines with exciter and governor as
tables of blocks, or inverters with their controls. Each grid runs 5 s with a load step. With `--beside` shipped runs
without inverters take turns with the same of another version of this repository, in FOLDER. Times are of the processor,
the least of several runs.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from facts_damping.case.loading import load_case
from facts_damping.simulation import assembly, loop

SECONDS = 5.0
ROUNDS = 5
COUNTS = (4, 16, 64, 150)  # units of a grid
SHIPPED = {"two_area": "load_1", "new_england_39": "load_3", "nets_nyps": "load_17", "minniwecc": "load_8"}
MACHINE: dict[str, Any] = {
    "rating": 100.0,
    "V": 1.0,
    "P": 50.0,
    "H": 5.0,
    "Xd": 1.8,
    "Xq": 1.7,
    "Xd1": 0.3,
    "Xq1": 0.55,
}
MACHINE |= {"Xd2": 0.25, "Xq2": 0.25, "Xl": 0.2, "Td01": 8.0, "Tq01": 0.4, "Td02": 0.03, "Tq02": 0.05}
EXCITER = {"model": "EXST1", "TR": 0.02, "VIMAX": 9.0, "VIMIN": -9.0, "TC": 1.0, "TB": 10.0, "KA": 100.0, "TA": 0.02}
EXCITER |= {"VRMAX": 9.0, "VRMIN": -9.0, "KC": 0.0, "KF": 0.01, "TF": 1.0}
GOVERNOR = {"model": "TGOV1", "R": 0.05, "T1": 0.5, "VMAX": 1.0, "VMIN": 0.0, "T2": 1.0, "T3": 2.0, "DT": 0.0}
SORTS: dict[str, tuple[str, ...]] = {
    "machines": (),
    "REGCA1, REECB1, REPCA1": ("REGCA1", "REECB1", "REPCA1"),
    "REGCA1, REECA1": ("REGCA1", "REECA1"),
    "REGCC1, REECB1": ("REGCC1", "REECB1"),
    "REGFMA1": ("REGFMA1",),
    "REGFMB1": ("REGFMB1",),
}


def grid(count: int, models: tuple[str, ...]) -> dict[str, Any]:
    """A grid of so many units: machines, or inverters of these models."""
    names = [f"U{i + 1}" for i in range(count)]
    lines = [{"name": f"line_{name}", "from": "P", "to": name, "r": 0.002, "x": 0.05, "b": 0.01} for name in names]
    lines.append({"name": "grid", "from": "A", "to": "P", "r": 0.01 / count, "x": 0.1 / count, "b": 0.0})
    system: dict[str, Any] = {
        "name": "units",
        "ranges": "physical",
        "buses": [{"name": name, "nominal_voltage": 100.0} for name in ("A", "P", *names)],
        "lines": lines,
        "infinite_buses": [{"name": "infinite", "bus": "A", "V": 1.0}],
        "loads": [{"name": "load", "bus": "P", "P": 20.0 * count}],
        "pmus": [{"name": "P", "bus": "P"}],
    }
    if not models:
        machines = [{"name": name, "bus": name, **MACHINE} for name in names]
        exciters, governors = ([{"machine": name, **row} for name in names] for row in (EXCITER, GOVERNOR))
        return {**system, "machines": machines, "exciters": exciters, "governors": governors}
    from facts_damping_reproduction.inverter_faults.cases import units  # noqa: PLC0415 (another version may lack it)

    values = {**units()["inverters"], **units()["electrical"], **units()["plant"]}
    unit = {"rating": 100.0, "P": 50.0, "V": 1.0, "model": models[0], **values[models[0]]}
    inverters = [{"name": name, "bus": name, **unit} for name in names]
    controls = [{"inverter": name, "model": model, **values[model]} for name in names for model in models[1:]]
    return {**system, "inverters": inverters, "inverter_controls": controls}


def run(system: dict[str, Any] | str, load: str) -> tuple[float, int, int, int]:
    """Seconds of processor of the loop of a run; its states, ports and evaluations of the integrator."""
    step = [{"time": 1.0, "kind": "load_step", "load": load, "change": 0.1}]
    sets = [f"scenario={json.dumps(step)}", "devices=[]", "controllers=[]", f"duration={SECONDS}"]
    case = load_case(None, [f"system={system if isinstance(system, str) else json.dumps(system)}", *sets])
    built = assembly.build_plant(case)
    whole = loop.build_loop(case)
    began = time.process_time()
    loop.run_loop(whole)
    took = time.process_time() - began
    return took, len(built.state.x), len(built.plant.ports), 4 * round(SECONDS * 1e9 / built.plant.step_ns)


def by_state() -> None:
    """The table of units: time of an evaluation for each unit and for each state, and the last beside machines'."""
    print(f"{'units':<26}{'':>5}{'states':>8}{'ports':>7}{'ms per s':>10}{'ns/unit':>9}{'ns/state':>9}{'by state':>10}")
    for count in COUNTS:
        grids = {sort: grid(count, models) for sort, models in SORTS.items()}
        runs = [{sort: run(system, "load") for sort, system in grids.items()} for _ in range(ROUNDS)]
        least = {sort: min(results[sort] for results in runs) for sort in grids}
        of_machines = least["machines"][0] / least["machines"][1]
        for sort, (took, states, ports, evaluations) in least.items():
            figures = 1e9 * took / evaluations / count, 1e9 * took / evaluations / states
            print(f"{sort:<26}{count:>5}{states:>8}{ports:>7}{1e3 * took / SECONDS:>10.2f}", end="")
            print(f"{figures[0]:>9.0f}{figures[1]:>9.1f}{took / states / of_machines:>10.2f}", flush=True)


def beside(folder: str) -> None:
    """Times of shipped runs here and in another version, in turn, and the ratio of the least."""
    places = [str(Path(__file__).resolve().parents[1]), str(Path(folder).resolve())]
    times: list[list[list[float]]] = [[], []]
    for _ in range(ROUNDS):
        for seen, place in zip(times, places, strict=True):
            path = os.pathsep.join(str(Path(place) / part) for part in ("", "extensions", "reproduction"))
            command = [sys.executable, str(Path(__file__).resolve()), "--shipped"]
            surroundings = {**os.environ, "PYTHONPATH": path}
            done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, cwd=place, env=surroundings)
            seen.append(json.loads(done.stdout))
    for name, ours, other in zip(SHIPPED, *(map(min, zip(*seen, strict=True)) for seen in times), strict=True):
        print(
            f"{name:<20}{1e3 * ours / SECONDS:>9.3f} ms per s,{1e3 * other / SECONDS:>9.3f} there: {ours / other:.3f}"
        )


def main() -> None:
    """The table that is asked for."""
    if "--shipped" in sys.argv:
        print(json.dumps([min(run(name, load)[0] for _ in range(4)) for name, load in SHIPPED.items()]))
    elif "--beside" in sys.argv:
        beside(sys.argv[-1])
    else:
        by_state()


if __name__ == "__main__":
    main()
