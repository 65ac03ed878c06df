"""The command `facts-damping`: simulate, run, analyze, modes, list."""

from __future__ import annotations

import argparse
import json
import signal
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from facts_damping import __version__, configuration, files, loop
from facts_damping.errors import FactsDampingError, InputError, RecordingError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from facts_damping.signals import Record

DONE, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        raise InputError(f"{self.prog}: {message}")


def _out(arguments: argparse.Namespace, name: str) -> Path:
    """Folder for results: `--out`, or a new one under `results`, named by date and run."""
    if arguments.out is not None:
        return Path(arguments.out)
    return Path("results") / f"{time.strftime('%Y%m%d-%H%M%S')}-{name}"


def _write_json(target: str | None, content: Any) -> None:
    """Write JSON to a file, or to standard output for `-`."""
    if target is None:
        return
    text = json.dumps(_finite(content), indent=2, allow_nan=False) + "\n"
    if target == "-":
        sys.stdout.write(text)
        return
    try:
        Path(target).write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"--json {target}: cannot be written: {error.strerror}") from error


def _finite(content: Any) -> Any:
    """Content with None for numbers that JSON does not know."""
    if isinstance(content, dict):
        return {key: _finite(value) for key, value in content.items()}
    if isinstance(content, (list, tuple)):
        return [_finite(value) for value in content]
    if isinstance(content, float) and content - content != 0.0:
        return None
    return content


def _say(arguments: argparse.Namespace, text: str) -> None:
    """Tell the user, unless standard output belongs to JSON."""
    if arguments.json != "-":
        sys.stdout.write(text + "\n")


class Progress:
    """A line of progress on standard error, where that is a terminal."""

    def __init__(self, label: str) -> None:
        self._label, self._shown = label, sys.stderr.isatty()
        self._began = time.monotonic()

    def __call__(self, done: int, of: int) -> None:
        """Show how far it is."""
        if self._shown:
            took = time.monotonic() - self._began
            width = 30
            bar = "#" * (width * done // of)
            sys.stderr.write(f"\r{self._label} [{bar:<{width}}] {done}/{of} ticks, {took:.0f} s")
            sys.stderr.flush()

    def close(self) -> None:
        """End the line."""
        if self._shown:
            sys.stderr.write("\n")


def summarise(record: Record, wall_s: float | None, recording: str | None) -> dict[str, Any]:
    """The JSON of a run (docs/commands.md)."""
    from facts_damping.analysis import summary

    return {**summary.summarise(record), "wall_s": wall_s, "recording": recording}


def plot(records: Sequence[tuple[str, Record]], folder: Path) -> list[Path]:
    """Plots of speeds, tie flow and injected voltage as PNG."""
    from facts_damping.analysis.plots import plot_comparison

    return plot_comparison(records, folder)


def _report(
    arguments: argparse.Namespace,
    named: list[tuple[str, Record]],
    summaries: list[dict[str, Any]],
    folder: Path,
) -> None:
    """Table on the terminal, plots in the folder."""
    from facts_damping.analysis.summary import table

    for name, record in named:
        for note in record.notes:
            sys.stderr.write(f"{name}: {note}\n")
    _say(arguments, table([(name, s) for (name, _), s in zip(named, summaries, strict=True)]))
    folder.mkdir(parents=True, exist_ok=True)
    for path in plot(named, folder):
        _say(arguments, f"plot: {path}")


def label(run: dict[str, Any]) -> str:
    """A short name of a run: system, scenario, controllers, link."""
    parts = [
        run["system"],
        run["scenario"],
        "+".join(c["name"] for c in run["controllers"]) or "none",
        run["link"],
    ]
    return "-".join(part if isinstance(part, str) else "custom" for part in parts).replace("/", "_")


def simulate(arguments: argparse.Namespace) -> None:
    """One closed loop in process."""
    case = configuration.load_case(arguments.run, arguments.set)
    began = time.perf_counter()
    record = loop.run(case)
    result = summarise(record, time.perf_counter() - began, None)
    if arguments.out is not None:
        folder = Path(arguments.out)
        _report(arguments, [(label(case.summary()), record)], [result], folder)
        _write_json(str(folder / "result.json"), result)
    else:
        from facts_damping.analysis.summary import table

        _say(arguments, table([(label(case.summary()), result)]))
    _write_json(arguments.json, result)


def run(arguments: argparse.Namespace) -> None:
    """The same loop as a ROS 2 graph."""
    from facts_damping import graph
    from facts_damping.recording.reader import load

    case = configuration.load_case(arguments.run, arguments.set)
    loop.build_loop(case)  # bad input is refused before anything starts
    name = label(case.summary())
    folder = _out(arguments, name)
    progress = Progress(name)
    try:
        outcome = graph.run(case, arguments.mode, folder, progress, arguments.timeout)
    finally:
        progress.close()
    record = load(outcome.recording)
    result = summarise(record, outcome.wall_s, str(outcome.recording))
    result |= {"deadline_misses": outcome.deadline_misses, "messages_lost": outcome.messages_lost}
    _report(arguments, [(name, record)], [result], folder)
    _say(arguments, f"deadline misses: {outcome.deadline_misses}; messages lost: {outcome.messages_lost}")
    _say(arguments, f"recording: {outcome.recording}")
    _write_json(str(folder / "result.json"), result)
    _write_json(arguments.json, result)


def analyze(arguments: argparse.Namespace) -> None:
    """Figures and plots of recordings."""
    from facts_damping.recording.reader import load

    named = []
    for path in arguments.recordings:
        record = load(path)
        named.append((label(record.configuration.get("asked") or record.configuration), record))
    if len({name for name, _ in named}) < len(named):
        named = [(f"{i + 1} {name}", record) for i, (name, record) in enumerate(named)]
    results = [
        summarise(record, None, str(path)) for (_, record), path in zip(named, arguments.recordings, strict=True)
    ]
    folder = Path(arguments.out) if arguments.out is not None else Path(arguments.recordings[0]).parent / "analysis"
    _report(arguments, named, results, folder)
    _write_json(arguments.json, results)


def modes(arguments: argparse.Namespace) -> None:
    """Power flow, eigenvalues and participation of a system at its start, devices installed."""
    from facts_damping.plant import linear
    from facts_damping.plant.build import build

    system = configuration.load_system(arguments.system, arguments.set)
    built = build(system, [d.name for d in system.devices], [])
    matrix, _ = linear.linearise(built)
    found = linear.modes(matrix, built.state_names)
    buses = built.flow.buses(system.base_power)
    _say(
        arguments,
        f"{system.name}: {system.description}\n\nbus          V p.u.  angle deg       P MW     Q Mvar",
    )
    for bus in buses:
        _say(arguments, "{name:<10} {v_pu:8.4f} {angle_deg:10.3f} {p_mw:10.2f} {q_mvar:10.2f}".format(**bus))
    _say(arguments, "\n     real 1/s   imag rad/s         Hz  damping ratio  participation")
    rows = []
    for mode in found:
        rows.append(
            {
                "real": mode.eigenvalue.real,
                "imag": mode.eigenvalue.imag,
                "frequency_hz": mode.frequency_hz,
                "damping_ratio": mode.damping_ratio,
                "participation": mode.participation,
            }
        )
        most = ", ".join(f"{state} {share:.2f}" for state, share in list(mode.participation.items())[:4])
        _say(
            arguments,
            f"{mode.eigenvalue.real:13.5f} {mode.eigenvalue.imag:12.5f} {mode.frequency_hz:10.4f} "
            f"{mode.damping_ratio:14.4f}  {most}",
        )
    _write_json(arguments.json, {"power_flow": {"buses": buses}, "modes": rows})


def list_(arguments: argparse.Namespace) -> None:
    """What there is: systems, scenarios, controllers, links."""
    if arguments.kind == "controllers":
        from facts_damping.control.table import CONTROLLERS

        rows = [
            {
                "name": name,
                "description": kind.description,
                "parameters": {p: row.default for p, row in kind.parameters.items()},
            }
            for name, kind in CONTROLLERS.items()
        ]
    else:
        rows = []
        for name, path in files.shipped(arguments.kind).items():
            content = files.read_table(path)
            rows.append({"name": name, "description": str(content.get("description", ""))})
    width = max(len(str(row["name"])) for row in rows)
    for row in rows:
        _say(arguments, f"{row['name']!s:<{width}}  {row['description']}")
    _write_json(arguments.json, rows)


def _common(parser: argparse.ArgumentParser, *, sets: bool = True, out: bool = True) -> None:
    if sets:
        parser.add_argument(
            "--set", action="append", default=[], metavar="KEY.PATH=VALUE", help="change a field; repeatable"
        )
    if out:
        parser.add_argument("--out", metavar="DIR", help="folder for results")
    parser.add_argument("--json", metavar="FILE", help="write the results as JSON; - for standard output")


def parser() -> argparse.ArgumentParser:
    """The command line."""
    top = _Parser(
        prog="facts-damping",
        description="Wide-area damping with FACTS devices: closed loops and ROS 2 graphs.",
    )
    top.add_argument("--version", action="version", version=__version__)
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=_Parser)

    def add(name: str, function: Callable[[argparse.Namespace], None]) -> argparse.ArgumentParser:
        text = (function.__doc__ or "").strip()
        made = commands.add_parser(name, help=text, description=text)
        made.set_defaults(function=function)
        return made

    command = add("simulate", simulate)
    command.add_argument("run", nargs="?", metavar="RUN", help="name under config/runs, or a YAML file; none: defaults")
    _common(command)
    command = add("run", run)
    command.add_argument("run", nargs="?", metavar="RUN", help="name under config/runs, or a YAML file; none: defaults")
    command.add_argument("--mode", choices=["lockstep", "realtime"], default="lockstep", help="default: lockstep")
    command.add_argument("--timeout", type=_seconds, default=5.0, metavar="S", help="longest wait for a silent node")
    _common(command)
    command = add("analyze", analyze)
    command.add_argument("recordings", nargs="+", metavar="RECORDING", help="folder or .mcap file")
    _common(command, sets=False)
    command = add("modes", modes)
    command.add_argument("system", metavar="SYSTEM", help="name under config/systems, or a YAML file")
    _common(command, out=False)
    command = add("list", list_)
    command.add_argument("kind", choices=["systems", "scenarios", "controllers", "links", "runs"])
    _common(command, sets=False, out=False)
    return top


def _seconds(text: str) -> float:
    """A time-out, s."""
    value = float(text)
    if not 0.05 <= value <= 3600.0:
        raise argparse.ArgumentTypeError(f"{text} given; allowed: 0.05 to 3600 s")
    return value


def main(argv: list[str] | None = None) -> int:
    """Entry point: exit status 0 done, 1 the run failed, 2 bad input, 130 interrupted."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # a polite kill is an interruption too
    try:
        arguments = parser().parse_args(argv)
        arguments.function(arguments)
    except (InputError, RecordingError) as error:
        return _fail(error, BAD_INPUT)
    except FactsDampingError as error:
        return _fail(error, FAILED)
    except KeyboardInterrupt:
        return _fail("interrupted; what was recorded by then is readable", INTERRUPTED)
    except BrokenPipeError:
        sys.stderr.close()
        return DONE
    return DONE


def _fail(reason: object, status: int) -> int:
    sys.stderr.write(f"facts-damping: {' '.join(str(reason).split())}\n")
    return status


if __name__ == "__main__":
    sys.exit(main())
