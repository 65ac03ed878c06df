"""How the cost of a run grows with machines, buses and loads that are no impedances.

    python benchmarks/scaling.py

Copies of Kundur's two areas are joined by short lines into ever larger grids (machines); its lines are cut into
ever more sections (buses); its loads become loads of constant current (ports). Each runs 5 s with a load step; the
time is that of the compiled loop beside simulated time, and that of power flow and set-up.
"""

from __future__ import annotations

import json
import resource
import statistics
import time
from typing import Any

from facts_damping.case.loading import load_case, load_system
from facts_damping.plant.grid.power_flow import solve
from facts_damping.simulation import build, loop

SECONDS = 5.0
RUNS = 3
SHIPPED = ("smib", "wscc_9", "wscc_9_constant_power", "two_area", "new_england_39", "nets_nyps", "minniwecc")


def copies(k: int) -> dict[str, Any]:
    """K copies of kundur_12_6, joined between their buses B8: a tree in which each has up to eight others behind it."""
    system = load_system("kundur_12_6")
    base, power = system.model_dump(by_alias=True), solve(system, []).generation
    made: dict[str, Any] = {**base, "signals": {}, "measures": {}, "pmus": []}
    for table in ("buses", "lines", "transformers", "loads", "shunts", "machines"):
        made[table] = [_renamed(row, i) for i in range(k) for row in base[table]]
    for row in made["machines"][len(base["machines"]) :]:
        if row["slack"]:
            row |= {"slack": False, "P": float(power[row["name"].rpartition("_")[0]].real) * system.base_power}
    made["lines"] += [
        {
            "name": f"joint_{i}",
            "from": f"B8_{i // 8}",
            "to": f"B8_{i + 1}",
            "length": 2,
            "r": 1e-4,
            "x": 1e-3,
            "b": 1.75e-3,
        }
        for i in range(k - 1)
    ]
    made["pmus"] = [{"name": "G1", "machine": "G1_0"}]
    return made


def _renamed(row: dict[str, Any], i: int) -> dict[str, Any]:
    """A row of copy i."""
    names = ("name", "bus", "from", "to")
    return {key: f"{value}_{i}" if key in names else value for key, value in row.items()}


def sections(n: int) -> dict[str, Any]:
    """kundur_12_6 with each line cut into n sections."""
    made = copies(1)
    lines = []
    for line in made["lines"]:
        inner = [f"{line['name']}.{j}" for j in range(1, n)]
        made["buses"] += [{"name": name, "nominal_voltage": 230.0} for name in inner]
        ends = [line["from"], *inner, line["to"]]
        lines += [
            {**line, "name": f"{line['name']}-{j}", "from": ends[j], "to": ends[j + 1], "length": line["length"] / n}
            for j in range(n)
        ]
    return {**made, "lines": lines}


def with_ports(k: int) -> dict[str, Any]:
    """K copies with loads of constant current: two ports a copy."""
    made = copies(k)
    made["loads"] = [{**load, "P_fractions": {"current": 1.0}} for load in made["loads"]]
    return made


def measured(name: str, system: dict[str, Any] | str, load: str) -> None:
    """Print one row."""
    step = [{"time": 1.0, "kind": "load_step", "load": load, "change": 0.02}]
    sets = [f"scenario={json.dumps(step)}", "devices=[]", "controllers=[]", f"duration={SECONDS}"]
    case = load_case(None, [f"system={system if isinstance(system, str) else json.dumps(system)}", *sets])
    began = time.perf_counter()
    built = build.build_plant(case)
    setup = time.perf_counter() - began
    times = []
    for _ in range(RUNS + 1):
        whole = loop.build_loop(case)
        began = time.perf_counter()
        loop.run_loop(whole)
        times.append(time.perf_counter() - began)
    took = statistics.median(times[1:]) / SECONDS
    rate = 1e9 / built.plant.step_ns
    print(
        f"{name:<34} {len(built.plant.machines):8d} {len(case.system.buses):6d} {len(built.plant.ports):6d} "
        f"{len(built.state.x):7d} {rate:6.0f} {1e3 * took:10.2f} {1 / took:14.1f} {1e3 * setup:10.1f} "
        f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:8.0f}"
    )


def main() -> None:
    """All rows."""
    print(
        f"{'system':<34} {'machines':>8} {'buses':>6} {'ports':>6} {'states':>7} {'1/step':>6} "
        f"{'ms per s':>10} {'x real time':>14} {'set-up ms':>10} {'peak MB':>8}"
    )
    for name in SHIPPED:
        measured(name, name, load_system(name).loads[0].name)
    for k in (1, 2, 4, 8):
        measured(f"kundur_12_6, {k} copies", copies(k), "load_1_0")
    for k in (1, 2, 4, 8, 16, 45, 180):
        measured(f"the same, constant current, {k}", with_ports(k), "load_1_0")
    for n in (1, 5, 20, 60):
        measured(f"kundur_12_6, lines in {n} sections", sections(n), "load_1_0")


if __name__ == "__main__":
    main()
