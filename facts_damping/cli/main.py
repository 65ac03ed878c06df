"""The command line of `facts-damping`: what each command takes."""

from __future__ import annotations

import argparse
import importlib
import math
import os
import signal
import sys
from contextlib import suppress
from typing import TYPE_CHECKING, NoReturn

from facts_damping.errors import DegradedError, FactsDampingError, InputError, RecordingError, one_line
from facts_damping.terminal import INTERRUPTED, INTERRUPTIONS, end_at_once
from facts_damping.version import __version__

if TYPE_CHECKING:
    from collections.abc import Callable

    Add = Callable[[str, str, str], argparse.ArgumentParser]

DONE, FAILED, BAD_INPUT, DEGRADED = 0, 1, 2, 3


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        raise InputError(message)


def _common(parser: argparse.ArgumentParser, *, sets: bool = True, out: bool = True, json: bool = True) -> None:
    if sets:
        parser.add_argument(
            "--set", action="append", default=[], metavar="KEY.PATH=VALUE", help="change a field; repeatable"
        )
    if out:
        parser.add_argument("--out", metavar="DIR", help="folder for results")
    if json:
        parser.add_argument("--json", metavar="FILE", help="write the results as JSON; - for standard output")
    else:
        parser.set_defaults(json=None)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    top = _Parser(
        prog="facts-damping",
        description="Wide-area damping with FACTS devices: closed loops and ROS 2 graphs.",
    )
    top.add_argument("--version", action="version", version=__version__)
    verbs = top.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=_Parser)

    def add(name: str, function: str, text: str) -> argparse.ArgumentParser:
        made = verbs.add_parser(name, help=text, description=text)
        made.set_defaults(function=function)
        return made

    _runs(add)
    _recordings(add)
    _systems(add)
    _studies(add)
    _lists(add)
    return top


def _runs(add: Add) -> None:
    command = add("simulate", "runs.simulate", "One closed loop in process.")
    command.add_argument("run", nargs="?", metavar="RUN", help="name under config/runs, or a YAML file; none: defaults")
    _supervised(command)
    _common(command)
    _check_step(command)
    command = add("run", "runs.run", "The same loop as a ROS 2 graph.")
    command.add_argument("run", nargs="?", metavar="RUN", help="name under config/runs, or a YAML file; none: defaults")
    command.add_argument("--mode", choices=["lockstep", "realtime"], default="lockstep", help="default: lockstep")
    command.set_defaults(nodes=True)
    command.add_argument("--timeout", type=TIMEOUT, default=5.0, metavar="S", help="longest wait for a silent node")
    text = "serve a live view to Foxglove; default: port 8765"
    command.add_argument("--foxglove", nargs="?", const=8765, type=_whole(1, 65535), metavar="PORT", help=text)
    _supervised(command)
    _common(command)


def _recordings(add: Add) -> None:
    command = add("analyze", "runs.analyze", "Figures and plots of recordings.")
    command.add_argument("recordings", nargs="+", metavar="RECORDING", help="folder or .mcap file")
    command.add_argument("--modes-method", choices=MODES, default=MODES[0], help="finds modes; default: auto")
    command.add_argument("--baseline", metavar="RECORDING", help="what improvement counts from; default: the first")
    command.add_argument("--run", metavar="RUN", help="the run that they are of, where they hold none")
    command.add_argument("--spwvd", metavar="SIGNAL,...", help="also time-frequency distributions of these signals")
    command.add_argument("--windows", type=_pair, metavar="LAG,TIME", help="of --spwvd, s; default: 10,4")
    command.add_argument("--band", type=_pair, metavar="LOW,HIGH", help="of --spwvd, Hz; default: 0.1,2.5")
    command.add_argument("--report", metavar="FILE.html", help="also one page with everything, for a browser")
    _common(command, sets=False)
    text = "Layouts for Foxglove and PlotJuggler of a run or of a recording, and that one by simulated time."
    command = add("views", "runs.views", text)
    command.add_argument(
        "what", nargs="?", metavar="RUN|RECORDING", help="a run as above, a recording's folder, or .mcap"
    )
    _common(command, json=False)
    text = "A recording's delivered frames, once more into its controllers, or into others."
    command = add("replay", "recordings.replay", text)
    command.add_argument("recording", metavar="RECORDING", help="folder or file of a recording")
    command.add_argument("--run", metavar="RUN", help="the run that it is of, where it holds none")
    command.add_argument("--nodes", action="store_true", help="by ROS 2 nodes in lockstep, recorded")
    text = "run the code of its controllers, which the recording names; only of recordings that you trust"
    command.add_argument("--policy", action="store_true", help=text)
    command.add_argument("--timeout", type=TIMEOUT, default=5.0, metavar="S", help="longest wait for a silent node")
    _common(command)
    text = "All signals of a recording on the grid of its ticks, as Parquet or CSV."
    command = add("export", "recordings.export", text)
    command.add_argument("recording", metavar="RECORDING", help="folder or file of a recording")
    command.add_argument("--out", required=True, metavar="FILE", help="FILE.parquet or FILE.csv")
    _common(command, sets=False, out=False, json=False)


def _systems(add: Add) -> None:
    text = "Power flow, eigenvalues, mode shapes and residues of a system at its start."
    command = add("modes", "runs.modes", text)
    command.add_argument("system", metavar="SYSTEM", help="name under config/systems, or a YAML file")
    command.add_argument("--devices", metavar="NAME,...", help="devices installed, or none; default: sssc, where it is")
    command.add_argument("--scenario", metavar="NAME", help="scenario from whose dispatch it starts")
    command.add_argument("--linear", metavar="FILE", help="FILE.npz for the linear plant: A, B, C, D and names")
    _common(command)
    text = "How much delay a loop of lead-lags bears, and its modes against delay, linearised with sampling and hold."
    command = add("margin", "studies.margin", text)
    command.add_argument("run", nargs="?", metavar="RUN", help="name under config/runs, or a YAML file; none: defaults")
    takes, text = _between(0.01, 10.0, " s"), "longest delay; default: 1 s"
    command.add_argument("--max-delay", type=takes, default=1.0, metavar="S", help=text)
    command.add_argument("--pade", type=_whole(1, 10), metavar="N", help="also with Pade terms of order N, 1 to 10")
    command.add_argument("--time-domain", action="store_true", help="also by runs of the nonlinear loop")
    _common(command)
    text = "The plant against published figures, other programs, analytic solutions and finer steps."
    command = add("validate", "runs.validate", text)
    command.add_argument("tables", nargs="*", metavar="TABLE", help="which tables; none: all")
    command.add_argument("--out", metavar="FILE", help="write the tables as a Markdown page")
    _common(command, sets=False, out=False)


def _studies(add: Add) -> None:
    text = "Choose the controllers' parameters on a system's training scenario, all by the same search and budget."
    command = add("tune", "studies.tune", text)
    command.add_argument("system", metavar="SYSTEM", help="a system with a scenario `training`")
    command.add_argument("controllers", nargs="*", metavar="CONTROLLER", help="which; none: all of the table")
    command.add_argument("--devices", default="sssc", metavar="NAME,...", help="commanded devices; default: sssc")
    command.add_argument("--signals", default="speed", metavar="NAME,...", help="signals given; default: speed")
    _profile(command, "thesis")
    text = "how they are measured, a name under config/measurement; default: the profile's"
    command.add_argument("--measurement", metavar="NAME", help=text)
    command.add_argument("--budget", type=COUNT, default=600, metavar="N", help="runs for each; default: 600")
    command.add_argument("--seed", type=SEED, default=1, metavar="N", help="seed of the search; default: 1")
    _jobs(command)
    command.add_argument("--out", metavar="FILE.yaml", help="the file of parameters; none: standard output")
    _common(command, sets=False, out=False)
    text = (
        "Choose a controller and its parameters on draws of training alone: all pairs, schemes, devices, compensations."
    )
    command = add("search", "studies.search", text)
    command.add_argument("system", metavar="SYSTEM", help="a system with a study search_SYSTEM, draws of training")
    command.add_argument("controllers", nargs="*", metavar="CONTROLLER", help="which beside LLC-tuned; none: all pairs")
    command.add_argument("--link", metavar="NAME", help="name under config/links, or a YAML file; default: no delay")
    command.add_argument("--devices", metavar="NAME,...", help="commanded devices; none: each set that it knows")
    _profile(command, "thesis")
    text = "what scores count from: LLC-tuned, the default, or none: no control"
    command.add_argument("--against", choices=("LLC-tuned", "none"), default="LLC-tuned", help=text)
    text = "about delay: free, the default: whatever is best where there is delay; none; some: of those that can"
    command.add_argument("--compensation", choices=("free", "none", "some"), default="free", help=text)
    text = "no structure is dropped: all are searched to the end, with the same budget"
    command.add_argument("--keep-all", action="store_true", help=text)
    text = "name under config/studies, or a YAML file, with the draws; default: search_SYSTEM, or search_SYSTEM_PROFILE"
    command.add_argument("--study", metavar="STUDY", help=text)
    command.add_argument("--draws", type=_whole(1, 1000), default=1, metavar="N", help="of the first rung; default: 1")
    text = (
        "first points: hypercube, the default; tuned: those that `tune` chose among them, or a run's: name or YAML file"
    )
    command.add_argument("--start", default="hypercube", metavar="START", help=text)
    text = "of the other first points from those of --start, of a range of 1; default: they are of the hypercube"
    command.add_argument("--deviation", type=_between(0.001, 0.5), metavar="D", help=text)
    methods = ("differential-evolution", "cma-es")
    command.add_argument("--scheme", choices=("direct", "indirect"), help="networks in this one only; default: in both")
    command.add_argument("--method", choices=methods, default=methods[0], help="default: differential-evolution")
    text = "how many of the draws count: of each index the worst; default: 100, all"
    counted = command.add_mutually_exclusive_group()
    counted.add_argument("--worst", type=_whole(1, 100), default=100, metavar="PERCENT", help=text)
    text = "the score is of medians, the largest of any group of draws; groups: what the axes not drawn say"
    counted.add_argument("--medians", action="store_true", help=text)
    command.add_argument("--budget", type=COUNT, default=10000, metavar="N", help="closed loops; default: 10000")
    command.add_argument("--seed", type=SEED, default=1, metavar="N", help="seed of the search; default: 1")
    _jobs(command)
    command.add_argument("--out", metavar="RUN.yaml", help="the run of the best network; none: standard output")
    command.add_argument("--lead-lag", metavar="RUN.yaml", help="also the run of LLC-tuned as the search tuned it")
    text = "also the parameters of all that were searched to the end, as under config/controllers; with --devices"
    command.add_argument("--tuned", metavar="FILE.yaml", help=text)
    _common(command, sets=False, out=False)
    text = "Every controller, direct and indirect, on every scenario of some systems: tables of figures."
    command = add("compare", "studies.compare", text)
    command.add_argument("systems", nargs="*", metavar="SYSTEM", help="which systems; none: two_area and smib")
    command.add_argument("--controllers", nargs="+", default=[], metavar="NAME", help="which; none: all of the table")
    _profile(command)
    _jobs(command)
    _check_step(command)
    _common(command)
    text = "Many runs of a study in parallel: a table, delay margins, pictures; goes on where it was interrupted."
    command = add("sweep", "studies.sweep", text)
    command.add_argument("study", metavar="STUDY", help="name under config/studies, or a YAML file")
    _profile(command)
    _jobs(command)
    _check_step(command)
    command.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask scheduler, whose cluster makes the runs")
    _common(command)
    text = "Draws of what may fail in a deployment: what holds for each; those for which it does not are run files."
    command = add("campaign", "campaigns.campaign", text)
    command.add_argument("campaign", metavar="CAMPAIGN", help="name under config/campaigns, or a YAML file")
    command.add_argument("--draws", type=_whole(1, 1_000_000), metavar="N", help="how many; default: as its file says")
    text = "how many are also made as real graphs, with real kills; default: as its file says"
    command.add_argument("--graphs", type=_whole(0, 10_000), metavar="N", help=text)
    _jobs(command)
    command.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask scheduler, whose cluster makes the draws")
    _common(command)
    text = (
        "What identifiers estimate of the plant's Jacobian beside the true one, over runs of a centralised controller."
    )
    command = add("jacobian", "studies.jacobian", text)
    command.add_argument("controllers", nargs="*", metavar="CONTROLLER", help="which; none: the eleven")
    command.add_argument("--horizon", type=_whole(1, 60), default=10, metavar="N", help="frames, 1 to 60; default: 10")
    _jobs(command)
    _common(command)
    text = "Pictures of neuro-fuzzy controllers: memberships before and after a run, response beside the baselines."
    command = add("portray", "studies.portray", text)
    command.add_argument("system", metavar="SYSTEM", help="name under config/systems, or a YAML file")
    command.add_argument("scenario", metavar="SCENARIO", help="one of the system's scenarios")
    command.add_argument("controllers", nargs="*", metavar="CONTROLLER", help="which; none: the eleven")
    command.add_argument("--out", metavar="DIR", help="folder for the pictures")
    _common(command, sets=False, out=False, json=False)
    text = "Time and error of a run, a sweep and lockstep beside other programs, those that are installed, in one run."
    command = add("bench", "studies.bench", text)
    text = "which of those in docs/programs.md; none: all"
    command.add_argument("programs", nargs="*", metavar="PROGRAM", help=text)
    _common(command, sets=False)
    text = "The thesis's tables, ours beside them: agreement, ensembles, explanations, pictures."
    command = add("reproduce", "studies.reproduce", text)
    command.add_argument("tables", nargs="*", metavar="TABLE", help="3.1, 4.1 ... 6.2; none: all")
    text = "thesis, the default, for its tables; deployment: who helps there, on draws that no search has seen"
    command.add_argument("--profile", default="thesis", metavar="NAME", help=text)
    text = "draws of each ensemble, 2 or more; default: as its file says, 100"
    command.add_argument("--draws", type=_whole(2, 100_000), metavar="N", help=text)
    _jobs(command)
    _common(command, sets=False)


def _profile(command: argparse.ArgumentParser, default: str | None = None) -> None:
    text = f"of all runs: thesis, deployment, or a YAML file; default: {default or 'as they say'}"
    command.add_argument("--profile", default=default, metavar="NAME", help=text)


def _lists(add: Add) -> None:
    command = add("list", "runs.list_", "What there is: systems, scenarios, controllers, links, supervision, monitors.")
    command.add_argument("kind", choices=KINDS)
    _common(command, sets=False, out=False)
    text = "A small folder to start from: a controller's class, run file, study, and test."
    command = add("new", "new.new", text)
    command.add_argument("kind", choices=("controller",))
    command.add_argument("name", metavar="NAME", help="of the controller: small letters, digits and _")
    command.add_argument("--out", metavar="DIR", help="the folder; default: NAME")
    _common(command, sets=False, out=False, json=False)
    command = add("keys", "runs.keys", "A key that a graph's messages are signed with, put first in a file.")
    command.add_argument("action", choices=("new",))
    command.add_argument("file", metavar="FILE.yaml", help="made where it is not there; the key before it is kept")
    _common(command, sets=False, out=False, json=False)
    command = add("import", "runs.import_", "A system's file from a MATPOWER case.")
    command.add_argument("case", metavar="CASE.m", help="MATPOWER case, version 2")
    command.add_argument("--dynamics", metavar="FILE.yaml", help="machine rows, exciters and so on; none: typical data")
    command.add_argument("--out", metavar="FILE.yaml", help="the system's file; none: standard output")
    _common(command, sets=False, out=False, json=False)


def _whole(low: int, high: int) -> Callable[[str], int]:
    """What takes a whole number within bounds."""

    def take(text: str) -> int:
        if not text.isdecimal() or not low <= int(text) <= high:
            raise argparse.ArgumentTypeError(f"{text} given; allowed: {low} to {high}")
        return int(text)

    return take


def _pair(text: str) -> tuple[float, float]:
    """Two numbers with a comma between."""
    try:
        first, second = map(float, text.split(","))
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text} given; allowed: two numbers with a comma between") from error
    return first, second


def _between(low: float, high: float, unit: str = "") -> Callable[[str], float]:
    """What takes a number within bounds."""

    def take(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text} given; allowed: {low:g} to {high:g}{unit}")
        return value

    return take


KINDS = (
    "systems",
    "scenarios",
    "profiles",
    "controllers",
    "links",
    "supervision",
    "monitors",
    "runs",
    "studies",
)
# facts_damping.analysis.poles.METHODS and others, which take long to load.
MODES = ("auto", "matrix_pencil", "prony", "era", "ssi")
COUNT, SEED, TIMEOUT = _whole(1, 10**6), _whole(0, 2**31 - 1), _between(0.05, 3600.0, " s")


def _check_step(command: argparse.ArgumentParser) -> None:
    text = "run also with half the integration step; say which figures hold"
    command.add_argument("--check-step", action="store_true", help=text)


def _supervised(command: argparse.ArgumentParser) -> None:
    text = "a supervisor beside each controller: name under config/supervision, or a YAML file; default: standard"
    command.add_argument("--supervised", nargs="?", const="", metavar="PRESET", help=text)


def _jobs(command: argparse.ArgumentParser) -> None:
    command.add_argument("--jobs", type=COUNT, default=os.cpu_count() or 1, metavar="N", help="default: all cores")


def main(argv: list[str] | None = None) -> int:
    """Entry point: exit status 0 done, 1 the run failed, 2 bad input, 3 degraded, 130 interrupted."""
    before = {number: signal.getsignal(number) for number in INTERRUPTIONS}
    for number in INTERRUPTIONS:
        if before[number] != signal.SIG_IGN:
            signal.signal(number, end_at_once)
    try:
        return _main(argv)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _main(argv: list[str] | None) -> int:
    try:
        arguments = parser().parse_args(argv)
        _do(arguments)
        sys.stdout.flush()
    except (InputError, RecordingError) as error:
        return _fail(error, BAD_INPUT)
    except DegradedError as error:
        return _fail(error, DEGRADED)
    except FactsDampingError as error:
        return _fail(error, FAILED)
    except KeyboardInterrupt as error:
        return _fail(f"interrupted; {str(error) or 'what was recorded by then is readable'}", INTERRUPTED)
    except BrokenPipeError:
        sys.stderr.close()
        return DONE
    except OSError as error:
        return _cannot_write(error)
    return DONE


def _cannot_write(error: OSError) -> int:
    """Say that a disk is full, or gone; what standard output still holds is not tried again."""
    with suppress(OSError):
        sys.stdout.flush()
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    where = error.filename or "standard output"
    return _fail(f"{where}: cannot be written: {error.strerror}; allowed: a place with room for it", BAD_INPUT)


def _do(arguments: argparse.Namespace) -> None:
    """What the command does: loaded now, so that `--help`, `--version` and what is mistyped are answered at once."""
    from facts_damping.parameters import files

    files.check_writable(arguments.json)
    if getattr(arguments, "nodes", False):
        from facts_damping.nodes import forked

        forked.load()  # what nodes need, while this process loads what it needs itself
    module, _, name = arguments.function.partition(".")
    getattr(importlib.import_module(f"facts_damping.cli.{module}"), name)(arguments)


def _fail(reason: object, status: int) -> int:
    sys.stderr.write(f"facts-damping: {one_line(reason)}\n")
    return status


if __name__ == "__main__":
    sys.exit(main())
