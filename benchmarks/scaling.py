"""How the cost of a run grows with machines, buses and loads that are no impedances, and how each step of set-up does.

    python benchmarks/scaling.py [--steps]

Copies of Kundur's two areas are joined by short lines into ever larger grids (machines); its lines are cut into
ever more sections (buses); its loads become loads of constant current (ports). Each runs 5 s with a load step; the
time is that of the compiled loop beside simulated time, and that of power flow and set-up. Last, or alone with
`--steps`, each step from the file to the modes of 1, 4, 8 and 16 copies of minniwecc, each in a process of its own:
seconds of processor, the largest memory during it, and the power of the buses with which its time grows. The copies are
joined by lines; inertias differ from copy to copy, since no two parts of a grid have the same modes.
"""

from __future__ import annotations

import json
import math
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from facts_damping.case.loading import load_case, load_system
from facts_damping.plant.grid.power_flow import solve
from facts_damping.simulation import assembly, loop
from facts_damping.small_signal import eigenmodes, linearisation, residues

if TYPE_CHECKING:
    from collections.abc import Callable

SECONDS = 5.0
COPIES = (1, 4, 8, 16)  # of minniwecc, 122 buses each
RUNS = 3
SHIPPED = ("smib", "wscc_9", "wscc_9_constant_power", "two_area", "new_england_39", "nets_nyps", "minniwecc")


def copies(k: int, name: str = "kundur_12_6") -> dict[str, Any]:
    """K copies of a system, joined between their buses B8: a tree in which each has up to eight others behind it."""
    system = load_system(name)
    base, power = system.model_dump(by_alias=True), solve(system, []).generation
    joined: dict[str, Any] = {**base, "signals": {}, "measures": {}, "pmus": []}
    for table in (
        "buses",
        "lines",
        "transformers",
        "loads",
        "shunts",
        "machines",
        "exciters",
        "governors",
        "stabilisers",
    ):
        joined[table] = [_renamed(row, i) for i in range(k) for row in base[table]]
    for row in joined["machines"][len(base["machines"]) :]:
        if row["slack"]:
            row |= {"slack": False, "P": float(power[row["name"].rpartition("_")[0]].real) * system.base_power}
    joined["lines"] += [
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
    joined["pmus"] = [{"name": "G1", "machine": "G1_0"}]
    return joined


def _renamed(row: dict[str, Any], i: int) -> dict[str, Any]:
    """A row of copy i."""
    names = ("name", "bus", "from", "to", "machine")
    renamed = {key: f"{value}_{i}" if key in names and value is not None else value for key, value in row.items()}
    return {**renamed, "branches": [f"{name}_{i}" for name in row["branches"]]} if "branches" in row else renamed


def many_areas(k: int) -> dict[str, Any]:
    """K copies of minniwecc with all PMUs, its HVDC link and a signal in the first."""
    base = load_system("minniwecc").model_dump(mode="json", by_alias=True)
    content = copies(k, "minniwecc")
    for row in content["machines"]:
        row["H"] *= 1.0 + 0.5 * int(row["name"].rpartition("_")[2]) / k
    content["pmus"] = [_renamed(row, i) for i in range(k) for row in base["pmus"]]
    content["devices"] = [_renamed(row, 0) for row in base["devices"]]
    content["signals"] = {"frequency": {"channel": "frequency", "weights": {"NORTH_0": 1.0, "SOUTH_0": -1.0}}}
    return content


def steps(path: str) -> dict[str, tuple[float, float]]:
    """Processor time (s) and largest memory (MB) of each step from a file of `many_areas`; `size`: states and buses."""
    used: dict[str, tuple[float, float]] = {}

    def step(name: str, function: Callable[[], Any]) -> Any:
        Path("/proc/self/clear_refs").write_text("5", "ascii")  # the largest memory so far is forgotten
        began = time.process_time()
        result = function()
        took = time.process_time() - began
        status = Path("/proc/self/status").read_text("ascii").split()
        used[name] = took, int(status[status.index("VmHWM:") + 1]) / 1024
        return result

    event = [{"time": 0.05, "kind": "load_step", "load": "load_8_0", "change": 0.02}]
    sets = [f"scenario={json.dumps(event)}", "devices=[pdci_0]", "controllers=[]", "duration=1"]
    system = step("file and its checks", lambda: load_system(path))
    devices, pmus = [device.name for device in system.devices], [pmu.name for pmu in system.pmus]
    case = step("run and its checks", lambda: load_case(None, [f"system={path}", *sets]))
    step("power flow", lambda: solve(system, devices))
    built = step("plant: power flow, start, network of 2 intervals", lambda: assembly.build_plant(case))
    step("PMUs", lambda: assembly.build_pmus(case))
    whole = step("loop: plant, PMUs, links", lambda: loop.build_loop(case))
    step("run of 1 s", lambda: loop.run_loop(whole))
    model = step("linear plant", lambda: linearisation.linear_model(built, system.signals, pmus))
    arguments = built.state_names, system, model, devices
    step("modes and residues", lambda: eigenmodes.modes(model.matrix, *arguments))
    step("design: linear plant, modes, target", lambda: residues.residues(built, system, devices, 60))
    used["size"] = float(len(built.state.x)), float(len(system.buses))
    return used


def compared() -> None:
    """The table of all steps."""
    columns = []
    with tempfile.TemporaryDirectory() as folder:
        for k in COPIES:
            path = Path(folder) / f"{k}.yaml"
            path.write_text(yaml.safe_dump(many_areas(k), sort_keys=False))
            command = [sys.executable, __file__, "--of", str(Path(folder) / f"{COPIES[0]}.yaml"), str(path)]
            columns.append(json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout))
    sizes = [column.pop("size") for column in columns]
    heads = (f"{buses:.0f} buses, {states:.0f} states" for states, buses in sizes)
    print(f"\n{'s (MB)':<50}" + "".join(f"{head:>24}" for head in heads) + "   power")
    for name in columns[0]:
        times = [column[name] for column in columns]
        power = math.log(times[-1][0] / times[1][0]) / math.log(sizes[-1][1] / sizes[1][1])
        print(f"{name:<50}" + "".join(f"{took:16.3f} ({mb:5.0f})" for took, mb in times) + f"{power:8.2f}")


def sections(n: int) -> dict[str, Any]:
    """kundur_12_6 with each line cut into n sections."""
    content = copies(1)
    lines = []
    for line in content["lines"]:
        inner = [f"{line['name']}.{j}" for j in range(1, n)]
        content["buses"] += [{"name": name, "nominal_voltage": 230.0} for name in inner]
        ends = [line["from"], *inner, line["to"]]
        lines += [
            {**line, "name": f"{line['name']}-{j}", "from": ends[j], "to": ends[j + 1], "length": line["length"] / n}
            for j in range(n)
        ]
    return {**content, "lines": lines}


def with_ports(k: int) -> dict[str, Any]:
    """K copies with loads of constant current: two ports a copy."""
    content = copies(k)
    content["loads"] = [{**load, "P_fractions": {"current": 1.0}} for load in content["loads"]]
    return content


def measured(name: str, system: dict[str, Any] | str, load: str) -> None:
    """Print one row."""
    step = [{"time": 1.0, "kind": "load_step", "load": load, "change": 0.02}]
    sets = [f"scenario={json.dumps(step)}", "devices=[]", "controllers=[]", f"duration={SECONDS}"]
    case = load_case(None, [f"system={system if isinstance(system, str) else json.dumps(system)}", *sets])
    began = time.perf_counter()
    built = assembly.build_plant(case)
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
    if "--of" in sys.argv:
        steps(sys.argv[-2])  # loads and compiles what the next one uses
        print(json.dumps(steps(sys.argv[-1])))
        return
    if "--steps" not in sys.argv:
        runs()
    compared()


def runs() -> None:
    """The rows of runs."""
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
