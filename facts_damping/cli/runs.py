"""Commands for one run or system."""

from __future__ import annotations

import time
from dataclasses import replace
from itertools import count, groupby
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from facts_damping.case import loading
from facts_damping.case.names import label
from facts_damping.cli.reporting import (
    check_ended_well,
    report,
    run_result,
    say,
    step_times_report,
    tell_graph,
)
from facts_damping.output.tables import table
from facts_damping.output.terminal import Progress
from facts_damping.output.writing import write_json, write_whole
from facts_damping.parameters import files
from facts_damping.parameters.yaml_text import dump
from facts_damping.simulation import adapted_weights, loop
from facts_damping.simulation.programs.policies import step_times

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator


HOST = "127.0.0.1"  # of a cockpit
WITH_RUN = "a recording that holds its run"


def out_folder(arguments: argparse.Namespace, name: str) -> Path:
    """Folder for results: `--out`, or a new one under `results`, named by date and run."""
    if arguments.out is not None:
        return Path(arguments.out)
    begun = f"{time.strftime('%Y%m%d-%H%M%S')}-{name}"
    numbered = (Path("results") / (begun if k == 1 else f"{begun}-{k}") for k in count(1))  # for several in one second
    return next(folder for folder in numbered if not folder.exists())


def simulate(arguments: argparse.Namespace) -> None:
    """Run one closed loop in process."""
    case = loading.load_case(arguments.run, arguments.set, arguments.supervised)
    began = time.perf_counter()
    built = loop.build_loop(case)
    name = label(case.summary())
    with Progress(name) as progress:
        record = loop.finish(case, built, progress)
    result = run_result(record, time.perf_counter() - began)
    if arguments.check_step:
        from facts_damping.analysis import convergence

        half = loop.with_half_step(case)
        with Progress(f"{name}, half the step") as progress:
            finer = run_result(loop.finish(half, loop.build_loop(half), progress))
        result = replace(result, summary=convergence.compare(result.summary, finer.summary))
    folder, saved = None, []
    if arguments.out is not None:
        folder = files.new_folder(Path(arguments.out))
        for name, weights in adapted_weights.all_adapted(case, built).items():
            saved.append(f"weights: {folder / f'{name}.weights.yaml'}")
            write_whole(folder / f"{name}.weights.yaml", dump(weights.model_dump()))
    times, lines = step_times_report(step_times(built.programs), case.run.frame_rate)
    result = replace(result, more=times)
    report(arguments, [(name, record)], [result], folder, *saved, *lines)
    check_ended_well(result.summary, record)


def run(arguments: argparse.Namespace) -> None:
    """Run the same loop as a ROS 2 graph."""
    from facts_damping.analysis import summary  # noqa: F401 (while what nodes need is loaded, too)
    from facts_damping.nodes.launching import graph
    from facts_damping.nodes.launching.starting import Cockpit, Parts

    case = loading.load_case(arguments.run, arguments.set, arguments.supervised)
    loop.build_loop(case, outside=True)  # refuses bad input before anything starts
    name = label(case.summary())
    folder = out_folder(arguments, name)
    if arguments.foxglove is not None:
        say(arguments, f"live view: ws://127.0.0.1:{arguments.foxglove}")
    cockpit = None
    if arguments.cockpit is not None:
        cockpit = Cockpit(HOST, arguments.cockpit, lambda address: say(arguments, f"cockpit: {address}"))
    with Progress(name) as progress:
        parts = Parts(arguments.foxglove, cockpit)
        outcome = graph.run(case, arguments.mode, folder, progress, arguments.timeout, parts=parts)
    tell_graph(arguments, name, outcome, folder)


def list_(arguments: argparse.Namespace) -> None:
    """List systems, scenarios, controllers, links, supervision and monitors."""
    from facts_damping.monitor_table import MONITORS

    laws: list[dict[str, Any]] = []
    if arguments.kind == "controllers":
        laws = _laws()
        rows, heads = _controllers(laws), ["name", "description", "parameter_count", "identifier", "schemes"]
    elif arguments.kind == "monitors":
        rows = [{"name": name, **row._asdict()} for name, row in MONITORS.items()]
        heads = list(rows[0])
    else:
        tables = {name: files.read_table(path) for name, path in files.shipped(arguments.kind).items()}
        rows = [{"name": name, "description": str(row.get("description", ""))} for name, row in tables.items()]
        heads = ["name", "description"]
    cells = [[_cell(row[head]) for head in heads] for row in rows]
    say(arguments, *table([head.replace("_", " ") for head in heads], cells, len(heads), rule=False))
    if laws:
        say(arguments, "\nTuned laws, by the file that has them:", *_tuned_in(laws))
    write_json(arguments.json, rows)


def _cell(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(value)
    return "-" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def _laws() -> list[dict[str, Any]]:
    """Tuned laws of the shipped files: objective, and on what and by which command each was tuned."""
    from facts_damping.case import tuned

    return [
        {"name": name, "file": file, **row.model_dump(exclude={"name"}), **content.model_dump(exclude={"controllers"})}
        for file, content in ((file, tuned.read(path)) for file, path in files.shipped("controllers").items())
        for name, row in tuned.rows(file, content)
    ]


def _tuned_in(laws: list[dict[str, Any]]) -> Iterator[str]:
    """Lines for each file of tuned laws: on what it was tuned, the laws' names, the command with its seed."""
    for file, group in groupby(laws, key=itemgetter("file")):
        names = {row["name"]: row for row in group}
        *_, row = names.values()
        on = f"{row['system']} ({row['profile']}), {_cell(row['signals'])} to {_cell(row['devices'])}"
        yield f"\n{file}: {on}; {row['command']}\n  {', '.join(names)}"


def _controllers(laws: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The table of controllers, for a single signal and a single device, with their tuned laws."""
    from facts_damping.control.bank import RULES
    from facts_damping.control.table import CONTROLLERS, OWN, kind, kind_name
    from facts_damping.neurofuzzy.network import counted

    policies = dict.fromkeys(CONTROLLERS) | {kind_name(row["name"]): row["policy"] for row in laws}
    return [
        {
            "name": name,
            "description": row.description,
            "antecedent": row.network and row.network.antecedent,
            "consequent": row.network and row.network.consequent,
            "parameter_count": row.network and counted(row.network.antecedent, row.network.consequent, 2, RULES, 1),
            "identifier": row.network and row.network.identifier,
            "schemes": ["direct", "indirect"] if row.network else None,
            "parameters": {key: parameter.default for key, parameter in row.parameters.items()},
            "tuned": [a_law for a_law in laws if kind_name(a_law["name"]) == name],
        }
        for name, row in ((name, OWN["policy"] if policy else kind(name)) for name, policy in policies.items())
    ]
