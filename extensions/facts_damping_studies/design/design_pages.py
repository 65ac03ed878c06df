"""Output of a design: lines for the terminal, JSON, a picture, and the files of a run."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from facts_damping.output.picture_files import save_picture
from facts_damping.output.tables import table
from facts_damping.output.writing import write_whole
from facts_damping.parameters.yaml_text import dump
from facts_damping.small_signal.modal_tables import figures
from facts_damping_grids.text import rows_text
from facts_damping_studies.design.design import LONGEST_S, PLACES, SIGNALS, maximum
from facts_damping_studies.design.places import FLOW, FREQUENCY, SPEED
from facts_damping_studies.margins.delay_margin import DRIFT

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from facts_damping.small_signal.eigenmodes import Eigenmode
    from facts_damping_studies.design.design import Design, Pair, Ranking
    from facts_damping_studies.margins.delay_margin import Around

SHOWN_MACHINES = 4
NAMES = {SPEED: "speeds", FREQUENCY: "frequencies"}
LOAD_LEVEL = {"distribution": "uniform", "low": 0.98, "high": 1.02}
FILES = ("system", "fault", "line_out", "run", "training_cases")
MOVED = 0.05  # relative change of damping ratio below which a mode is not listed
TRAINING = "fault"  # the scenario of `scenario_generation` that `search` trains on


def mode_name(mode: Eigenmode) -> str:
    """Readable name of a mode."""
    return f"{mode.frequency_hz:.3f} Hz"


def strongest(design: Ranking, mode: int) -> list[tuple[str, float]]:
    """Places sorted by how far their device moves a mode with its full setpoint, 1/s, the strongest first."""
    strengths = [
        (attempt.place.label, float(attempt.strength[mode]))
        for attempt in design.tried
        if np.isfinite(attempt.strength[mode])
    ]
    return sorted(strengths, key=lambda pair: -pair[1])[:PLACES]


def clearest(design: Ranking, mode: int, channel: str) -> list[tuple[str, float]]:
    """Signals of a channel sorted by their amplitude in a mode, the largest first."""
    names, values = list(design.system.signals), np.abs(design.observability[mode])
    by_name = dict(zip(names, values.tolist(), strict=True))
    return [(name, by_name[name]) for name in maximum(names, values, channel, design.system)[:SIGNALS]]


def text(design: Design) -> Iterator[str]:
    """Lines for the terminal."""
    yield from ranking_text(design)
    yield from design_text(design)


def ranking_text(design: Ranking) -> Iterator[str]:
    """Lines of a ranking for the terminal."""
    yield f"{design.system.name}: electromechanical modes without damping control, the least damped first"
    rows = [
        [f"{m.frequency_hz:.3f}", f"{m.damping_ratio:.4f}", m.label, _machines(m, 1.0), _machines(m, -1.0)]
        for m in design.modes
    ]
    yield from _indented(table(["Hz", "damping ratio", "kind", "machines", "against"], rows, rule=False))
    for title, rows in _rankings(design):
        yield f"\n{title}"
        yield from _indented(table([mode_name(m) for m in design.modes], rows, left=len(design.modes), rule=False))
    left_out: dict[str, list[str]] = {}
    for attempt in design.tried:
        if attempt.why_not:
            left_out.setdefault(attempt.why_not, []).append(attempt.place.label)
    yield from (f"  left out: {', '.join(labels)} ({reason})" for reason, labels in left_out.items())
    target = design.modes[design.target]
    yield f"\nfor the mode of {mode_name(target)}, {_target(design)}, with {1e3 * design.task.delay:.0f} ms of delay"
    others = [f"at {mode_name(m)}" for i, m in enumerate(design.modes) if i != design.target]
    titles = ["device", "signal", "residue 1/s", "x limit", "angle deg", "u = K y: sign", "lead deg", *others]
    yield from _indented(table(titles, [_pair(design, pair) for pair in design.pairs], left=2, rule=False))
    if others:
        yield "  last columns: what other modes gain or lose in damping ratio, of what this one gains"


def _target(design: Ranking) -> str:
    """Why the mode was chosen, and which are less damped."""
    target, task = design.modes[design.target], design.task
    less = [f"{mode_name(mode)} ({mode.label})" for mode in design.modes if mode.damping_ratio < target.damping_ratio]
    why = "as asked" if task.mode_hz is not None else "the least damped"
    if task.mode_hz is None and target.label == "interarea":
        why = "the least damped interarea mode" + (f" below {task.damping:g}" if less else "")
    return f"{why}; less damped: {', '.join(less)}, by --mode" if less and task.mode_hz is None else why


def _rankings(design: Ranking) -> Iterator[tuple[str, list[list[str]]]]:
    modes = range(len(design.modes))
    places = _side([strongest(design, m) for m in modes], ".4f")
    yield "places: controllability times the setpoint's limit, 1/s", places
    unit = "swing in the mode (observability), p.u. per p.u. of the fastest machine's speed"
    for channel, what in ((design.channel, NAMES[design.channel]), (FLOW, "flows")):
        columns = [clearest(design, m, channel) for m in modes]
        if any(columns):
            yield f"signals, {what}: {unit}", _side(columns, ".3g")


def _side(columns: list[list[tuple[str, float]]], form: str) -> list[list[str]]:
    """Columns of names with values side by side, as rows."""
    deep = max(map(len, columns), default=0)
    filled = [[*(f"{name} {value:{form}}" for name, value in column), *[""] * deep][:deep] for column in columns]
    return [list(row) for row in zip(*filled, strict=True)]


def _indented(lines: list[str]) -> Iterator[str]:
    yield from ("  " + line for line in lines)


def _machines(mode: Eigenmode, side: float) -> str:
    """The machines that swing most in phase (1) or in antiphase (-1) with the machine of largest amplitude."""
    first = max(mode.shape.values(), key=abs)
    same_side = {name: side * (value / first).real for name, value in mode.shape.items()}
    ranked = sorted((name for name in same_side if same_side[name] > 0.0), key=lambda name: -same_side[name])
    return ", ".join(f"{name} {same_side[name]:.2f}" for name in ranked[:SHOWN_MACHINES])


def _pair(design: Ranking, pair: Pair) -> list[str]:
    angle = float(np.rad2deg(np.angle(pair.residue)))
    others = [f"{100 * value:+.0f} %" if np.isfinite(value) else "-" for value in pair.others]
    del others[design.target]
    sign = "+" if pair.law.sign > 0.0 else "-"
    place, size = design.tried[pair.tried].place, abs(pair.residue)
    cells = f"{size:.4g}", f"{size * place.device.setpoint_max:.3g}", f"{angle:.1f}", sign, f"{pair.law.lead_deg:.1f}"
    return [place.label, pair.signal, *cells, *others]


def design_text(design: Design) -> Iterator[str]:
    """Lines of what was designed, after the ranking, for the terminal."""
    chosen, tuned, task = design.chosen, design.tuned, design.task
    where = design.tried[chosen.tried].place.label
    yield f"\ntaken: {where}, {chosen.signal}{_why(design)}"
    yield f"lead-lag: {', '.join(f'{name} {value:g}' for name, value in chosen.law.parameters(tuned.gain).items())}"
    ratio = tuned.after[tuned.target]
    ratio_text = "lost" if ratio is None else f"{ratio.damping_ratio:.4f}"
    if tuned.reached:
        alone = " with the device alone" if tuned.gain == 0.0 else ""
        yield f"damping ratio: {ratio_text}{alone}, wanted {task.damping:g}"
    else:
        why = "does not help" if tuned.limit is None else f"would make a mode of {mode_name(tuned.limit)} worse"
        yield f"damping ratio: {ratio_text} at most, wanted {task.damping:g}; more gain {why}"
    rows = [
        [
            f"{a.frequency_hz:.3f}",
            f"{a.damping_ratio:.4f}",
            "-" if b is None else f"{b.frequency_hz:.3f}",
            "-" if b is None else f"{b.damping_ratio:.4f}",
        ]
        for i, (a, b) in enumerate(zip(tuned.before, tuned.after, strict=True))
        if i == tuned.target or b is None or abs(b.damping_ratio - a.damping_ratio) > MOVED * abs(a.damping_ratio)
    ]
    yield "electromechanical modes that change, with the device without control, and with it:"
    yield from _indented(table(["Hz", "damping ratio", "Hz", "damping ratio"], rows, left=0, rule=False))
    yield f"stable, linear, sampled and held: {_stable(design.stable)}"
    if tuned.growing is not None:
        yield f"without control {grows(tuned.growing)}"
    for name, scenario in design.scenarios.items():
        yield f"scenario {name}: {scenario['description']}"


def grows(mode: Eigenmode) -> str:
    """What an unstable mode of the grid does: a swing grows, or with a real eigenvalue the frequency drifts."""
    rate = f"{mode.eigenvalue.real:.4f} 1/s"
    if mode.frequency_hz < DRIFT:
        return f"the grid drifts ({rate}, a real eigenvalue): no swing grows"
    return f"a mode of {mode_name(mode)} grows ({rate}): the grid itself is unstable"


def _stable(around: Around | None) -> str:
    if around is None:
        return "not with this delay"
    low = f"delays from {1e3 * around.low:.4g} ms"
    if around.high is None:
        return f"{low} to above {1e3 * LONGEST_S:.0f} ms"
    return f"{low} to {1e3 * around.high:.1f} ms, where a mode of {mode_name(around.critical)} grows"


def _why(design: Design) -> str:
    if design.chosen.conflicts():
        return ", though it takes damping from another mode, as every pair of the table does"
    passed = design.pairs.index(design.chosen)
    return f"; {passed} before it would take damping from another mode" if passed else ""


def document(design: Design) -> dict[str, Any]:
    """The JSON of `design` (docs/results_json.md)."""
    tuned = design.tuned
    return {
        "modes": [
            {
                **figures(mode),
                "places": [{"place": name, "controllability": value} for name, value in strongest(design, i)],
                "signals": [
                    {"signal": name, "observability": value}
                    for channel in (design.channel, FLOW)
                    for name, value in clearest(design, i, channel)
                ],
            }
            for i, mode in enumerate(design.modes)
        ],
        "target": design.target,
        "pairs": [
            {
                "place": design.tried[pair.tried].place.label,
                "signal": pair.signal,
                "residue": [pair.residue.real, pair.residue.imag],
                "lead_deg": pair.law.lead_deg,
                "others": pair.others,
            }
            for pair in design.pairs
        ],
        "taken": design.pairs.index(design.chosen),
        "parameters": design.chosen.law.parameters(tuned.gain),
        "reached": tuned.reached,
        "swings": [
            {"before": figures(a), "after": None if b is None else figures(b)}
            for a, b in zip(tuned.before, tuned.after, strict=True)
        ],
        "stable_s": None if design.stable is None else [design.stable.low, design.stable.high],
        "scenarios": list(design.scenarios),
    }


def plot(design: Design, path: Path) -> Path:
    """A picture with a column per mode: the strongest places and the clearest speed signals."""
    modes = len(design.modes)
    figure = Figure(figsize=(1.0 + 3.2 * modes, 5.0), layout="constrained")
    axes: Any = figure.subplots(2, modes, squeeze=False)
    for m, mode in enumerate(design.modes):
        for axis, ranked in (
            (axes[0, m], strongest(design, m)),
            (axes[1, m], clearest(design, m, design.channel)),
        ):
            names, values = [name for name, _ in ranked][::-1], [value for _, value in ranked][::-1]
            axis.barh(range(len(names)), values, color="C0" if m == design.target else "0.6")
            axis.set_yticks(range(len(names)), names, fontsize=8)
            axis.tick_params(axis="x", labelsize=8)
        axes[0, m].set_title(
            f"{mode.frequency_hz:.3f} Hz, {mode.label}\ndamping ratio {mode.damping_ratio:.3f}", fontsize=9
        )
        for axis in axes[:, m]:
            axis.locator_params(axis="x", nbins=3)
        axes[0, m].set_xlabel("controllability [1/s]", fontsize=8)
        axes[1, m].set_xlabel("observability [-]", fontsize=8)
    figure.suptitle(f"{design.system.name}: places of devices, and speeds, by mode", fontsize=10)
    return save_picture(figure, path, dpi=130)


def write(design: Design, folder: Path) -> list[Path]:
    """Write the files of system, scenarios, run and training cases; delete scenario files left by an earlier design."""
    where = {name: folder / f"{name}.yaml" for name in ("system", *design.scenarios, "run", "training_cases")}
    head = f"# {design.system.name} with {design.tried[design.chosen.tried].place.label}, by facts-damping design\n"
    first = next(iter(design.scenarios), None)
    run = {"system": where["system"].name, "scenario": where[first].name if first else [], **design.run}
    texts = {
        "system": head + rows_text(design.content),
        **{name: dump(scenario) for name, scenario in design.scenarios.items()},
    }
    texts["run"] = dump({"description": run.pop("description"), **run})
    if first == TRAINING:
        texts["training_cases"] = dump(_training_cases(design, run))
    for name in FILES:
        if name not in texts:
            (folder / f"{name}.yaml").unlink(missing_ok=True)  # left by an earlier design
    for name, content in texts.items():
        write_whole(where[name], content)
    return [where[name] for name in texts]


def _training_cases(design: Design, run: dict[str, Any]) -> dict[str, Any]:
    """A study that `search` trains on: the fault, starting half a cycle late or later, at other loads."""
    rows = enumerate(design.content.get("loads", []))
    loads = {f"system.loads.{i}.{part}": load[part] for i, load in rows for part in ("P", "Q") if load.get(part)}
    events, frequency = design.scenarios[TRAINING]["events"], design.content.get("frequency", 60.0)
    cycles = {"name": "cycles", "fields": {"scenario.0.duration": 1.0 / frequency}, "distribution": "loguniform"}
    variables = [{**cycles, "low": 0.5, "high": events[0]["duration"] * frequency}]
    variables += [{"name": "load_level", "fields": loads, **LOAD_LEVEL}] if loads else []
    return {
        "description": f"training cases of `facts-damping search {run['system']}`",
        "run": {"system": run["system"], "scenario": events, "devices": run["devices"], "controllers": []},
        "set": {"duration": design.scenarios[TRAINING]["duration"]},
        "seed": 3,
        "modes": False,
        "sweep": [{"draws": {"number": 40, "method": "latin_hypercube", "variables": variables}}],
    }
