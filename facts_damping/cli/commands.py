"""Arguments of each command of `facts-damping`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from facts_damping.cli import options
from facts_damping.cli.options import (
    between,
    check_step,
    common,
    digested,
    jobs,
    named,
    pair,
    pictures,
    profile,
    scheduler,
    supervised,
    timeout,
    whole,
)
from facts_damping.extensions import given
from facts_damping.version import __version__

if TYPE_CHECKING:
    import argparse


class Add(Protocol):
    """Adds a command to the parser."""

    def __call__(self, name: str, function: str, text: str, *examples: str) -> argparse.ArgumentParser:
        """`function`: the function that carries it out; `text`: what it does."""


def parser() -> argparse.ArgumentParser:
    """The parser of the command line."""
    top = options.Parser(
        prog="facts-damping",
        description="Wide-area damping control with FACTS devices: closed loops in process and as ROS 2 graphs.",
    )
    top.add_argument("--version", action="version", version=__version__)
    verbs = top.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=options.Parser)

    def add(name: str, function: str, text: str, *examples: str) -> argparse.ArgumentParser:
        made = verbs.add_parser(name, help=text, description=text, epilog=options.told(examples))
        made.add_argument("--verbose", action="store_true", help="with an error, also where in the code it is from")
        made.set_defaults(function=function if ":" in function else f"facts_damping.cli.{function}", known=made.options)
        return made

    _runs(add)
    _recordings(add)
    _systems(add)
    _studies(add)
    _choices(add)
    _others(add)
    for command in given("commands").values():
        command.load()(add)
    return top


def _runs(add: Add) -> None:
    command = add(
        "simulate",
        "runs.simulate",
        "Simulate one closed loop in this process.",
        "simulate two_area_small",
        "simulate two_area_large --set link=delay_100ms --out results/large",
        "simulate two_area_large --set controllers=[] --json -",
        "simulate two_area_large --set controllers.0.name=HBsWC --set controllers.0.scheme=indirect",
        "simulate two_area_large --supervised",
        "simulate two_area_large --digest",
    )
    named(command, "run", "runs", "; none: the defaults", nargs="?")
    supervised(command)
    common(command)
    pictures(command)
    check_step(command)
    digested(command)
    command = add(
        "run",
        "runs.run",
        "Run the same closed loop as a graph of ROS 2 nodes, and record it.",
        "run two_area_small --out results/first",
        "run two_area_small --mode realtime --supervised",
    )
    named(command, "run", "runs", "; none: the defaults", nargs="?")
    text = "lockstep: nodes wait for each other, the result is exact; realtime: paced by the clock; default: lockstep"
    command.add_argument("--mode", choices=["lockstep", "realtime"], default="lockstep", help=text)
    command.set_defaults(nodes=True)
    timeout(command)
    text = "serve a live view to Foxglove; default: port 8765"
    command.add_argument("--foxglove", nargs="?", const=8765, type=whole(1, 65535), metavar="PORT", help=text)
    supervised(command)
    common(command)
    pictures(command)
    digested(command)


def _recordings(add: Add) -> None:
    command = add(
        "analyze",
        "runs.analyze",
        "Compute indices, modes and latencies of recordings, and draw them.",
        "run two_area_small --out results/analyzed",
        "analyze results/analyzed/recording",
        "analyze results/analyzed/recording --report results/analyzed/report.html",
    )
    command.add_argument("recordings", nargs="+", metavar="RECORDING", help="folder, or .mcap file")
    command.add_argument("--modes-method", choices=MODES, default=MODES[0], help="how modes are found; default: auto")
    text = "the one that the others are compared with; default: the first; no_control: the first one's run without it"
    command.add_argument("--baseline", metavar="RECORDING", help=text)
    command.add_argument("--run", metavar="RUN", help="the run that was recorded, if the recording does not hold it")
    command.add_argument("--spwvd", metavar="SIGNAL,...", help="also time-frequency distributions of these signals")
    command.add_argument("--windows", type=pair, metavar="LAG,TIME", help="windows of --spwvd, s; default: 10,4")
    command.add_argument(
        "--band", type=pair, metavar="LOW,HIGH", help="frequency band of --spwvd, Hz; default: 0.1,2.5"
    )
    command.add_argument("--report", metavar="FILE.html", help="also write one page with everything, for a browser")
    common(command, sets=False)
    pictures(command)
    digested(command)
    command = add(
        "views",
        "runs.views",
        "Write layouts for Foxglove and PlotJuggler that fit a run or a recording.",
        "views two_area_small --out results/views",
    )
    command.add_argument(
        "what", nargs="?", metavar="RUN|RECORDING", help="a run, or a recording's folder or .mcap file"
    )
    common(command, json=False)
    command = add(
        "replay",
        "recordings.replay",
        "Feed the recorded frames to the same controllers again, which must answer alike, or to others.",
        "run two_area_large --out results/replayed",
        "replay results/replayed/recording",
        "replay results/replayed/recording --set controllers.0.name=HBsWC --out results/shadow",
    )
    command.add_argument("recording", metavar="RECORDING", help="folder, or .mcap file")
    command.add_argument("--run", metavar="RUN", help="the run that was recorded, if the recording does not hold it")
    command.add_argument("--nodes", action="store_true", help="with ROS 2 nodes in lockstep, recorded")
    text = "run the controller code that the recording names; only for recordings that you trust"
    command.add_argument("--policy", action="store_true", help=text)
    timeout(command)
    common(command)
    pictures(command)
    command = add(
        "export",
        "recordings.export",
        "Write all signals of a recording as one table, a row per frame; or a system as a MATPOWER case.",
        "run two_area_small --out results/exported",
        "export results/exported/recording --out results/exported.csv",
        "export results/exported/recording --out results/exported.lst",
        "export two_area --out results/two_area.m",
    )
    text = "a recording: folder, or .mcap file; for FILE.m a system: name, or YAML file"
    command.add_argument("what", metavar="RECORDING|SYSTEM", help=text)
    text = "FILE.parquet, FILE.csv, or FILE.lst (with FILE.npz, for ANDES's plots); FILE.m: a MATPOWER case"
    command.add_argument("--out", required=True, metavar="FILE", help=text)
    common(command, sets=False, out=False, json=False)

    command = add(
        "pmu-serve",
        "streams.pmu_serve",
        "Serve the PMUs of a recording as a stream of IEEE C37.118.2, at its own pace.",
        "pmu-serve results/exported/recording --port 4712",
    )
    command.add_argument("recording", metavar="RECORDING", help="folder, or .mcap file")
    command.add_argument("--each", action="store_true", help="each PMU as a PMU of its own, at ports from --port on")
    text = "as the recording's link N has delivered it, time-aligned; default: as PMUs report it"
    command.add_argument("--behind", type=whole(0, 15), metavar="N", help=text)
    text = "address of this computer at which clients connect; default: 127.0.0.1"
    command.add_argument("--host", default="127.0.0.1", metavar="ADDRESS", help=text)
    text = "TCP and UDP port, 1 to 60000, or 0: a free one; default: 4712"
    command.add_argument("--port", type=whole(0, 60000), default=4712, metavar="N", help=text)
    text = "also send by UDP to this address, which may be a multicast group; repeatable"
    command.add_argument("--to", action="append", default=[], metavar="HOST:PORT", help=text)
    text = "number of the stream, 1 to 65534; default: 1"
    command.add_argument("--idcode", type=whole(1, 65534), default=1, metavar="N", help=text)
    text = "what is polar, what are floats: polar, float_phasors, float_analogs, float_frequency, or none; default: all"
    command.add_argument("--format", metavar="NAME,...", help=text)
    text = "time of the recording's begin, s since 1970; default: now"
    command.add_argument("--epoch", type=whole(0, (1 << 32) - 1), metavar="S", help=text)
    common(command, sets=False, out=False)
    command = add(
        "pmu-listen",
        "streams.pmu_listen",
        "Show what servers of IEEE C37.118.2 send; or run controllers on their streams, in shadow, and record it.",
        "pmu-listen tcp://127.0.0.1:4712/1",
        "pmu-listen tcp://127.0.0.1:4712/1 --run two_area_large --out results/shadow",
    )
    command.add_argument("streams", metavar="STREAMS", help="tcp://HOST:PORT/IDCODE, or a YAML file of streams")
    text = "the run whose controllers, links and supervisors hear the streams; none: show what is sent"
    command.add_argument("--run", metavar="RUN", help=text)
    text = "how long to listen without --run; default: 3 s"
    command.add_argument("--seconds", type=between(0.1, 3600.0, " s"), default=3.0, metavar="S", help=text)
    timeout(command)
    supervised(command)
    common(command)


def _systems(add: Add) -> None:
    command = add(
        "modes",
        "runs.modes",
        "Compute the power flow, eigenvalues, mode shapes and residues of a system.",
        "modes two_area",
        "modes kundur_12_6 --devices none",
    )
    named(command, "system", "systems")
    text = "devices that are installed, or none; default: sssc, if there is one"
    command.add_argument("--devices", metavar="NAME,...", help=text)
    command.add_argument("--scenario", metavar="NAME", help="scenario with the dispatch to start from")
    command.add_argument("--linear", metavar="FILE", help="FILE.npz for the linear plant: A, B, C, D and names")
    common(command, of="system")
    pictures(command)
    command = add(
        "margin",
        "studies.margin",
        "Compute the delay margin of a loop with linear controllers, and its modes over the delay.",
        "margin two_area_small",
        "margin two_area_small --time-domain --max-delay 0.3",
    )
    named(command, "run", "runs", "; none: the defaults", nargs="?")
    takes, text = between(0.01, 10.0, " s"), "longest delay, 0.01 to 10 s; default: 1 s"
    command.add_argument("--max-delay", type=takes, default=1.0, metavar="S", help=text)
    text = "also with the delay as a Pade approximation of order N, 1 to 10"
    command.add_argument("--pade", type=whole(1, 10), metavar="N", help=text)
    command.add_argument("--time-domain", action="store_true", help="also by simulations of the nonlinear loop")
    common(command)
    pictures(command)
    command = add(
        "import",
        "runs.import_",
        "Make a system's file from a MATPOWER or a PSS/E case.",
        "import tests/data/nine_bus.m --out results/nine_bus.yaml",
        "import tests/data/three_machines.raw tests/data/three_machines.dyr --out results/three_machines.yaml",
    )
    command.add_argument(
        "case", metavar="CASE", help="CASE.m: MATPOWER case, version 2; CASE.raw: PSS/E, version 32 to 35"
    )
    command.add_argument(
        "dyr", nargs="?", metavar="CASE.dyr", help="machines and controls of a PSS/E case; none: typical data"
    )
    text = "machine and control data of a MATPOWER case; none: typical data"
    command.add_argument("--dynamics", metavar="FILE.yaml", help=text)
    command.add_argument("--out", metavar="FILE.yaml", help="the system's file; none: standard output")
    common(command, sets=False, out=False, json=False)


def _studies(add: Add) -> None:
    command = add(
        "sweep",
        "studies.sweep",
        "Make all runs of a study in parallel: tables, delay margins, pictures. An interrupted study is continued.",
        "sweep example",
        "sweep comparison --only scenario=small --only kind=none,LLC* --out results/comparison",
        "sweep comparison --only scenario=small --only kind=LLC* --out results/llc --report results/llc/report.html",
        "sweep comparison --set system=smib --only scenario=light --only kind=none,LLC* --out results/comparison_smib",
    )
    named(command, "study", "studies")
    text = "only the points of a column's values or patterns, for example kind=LLC*,HBsWC*; repeatable"
    command.add_argument("--only", action="append", default=[], metavar="COLUMN=VALUE,...", help=text)
    text = "also write one page with all runs side by side, for a browser; for at most 7 runs"
    command.add_argument("--report", metavar="FILE.html", help=text)
    profile(command)
    jobs(command)
    check_step(command)
    scheduler(command)
    common(command)
    pictures(command)
    command = add(
        "campaign",
        "campaigns.campaign",
        "Draw faults of a deployment, check what must hold in each, and keep a run file of each violation.",
        "campaign do_no_harm --draws 10 --graphs 0 --out results/some_faults",
    )
    named(command, "campaign", "campaigns")
    command.add_argument("--draws", type=whole(1, 1_000_000), metavar="N", help="how many; default: as its file says")
    text = "how many are also made as real graphs with real kills; default: as its file says"
    command.add_argument("--graphs", type=whole(0, 10_000), metavar="N", help=text)
    jobs(command)
    scheduler(command)
    common(command)
    text = "Check the plant against published results, other programs, analytic solutions and finer steps."
    command = add("validate", "runs.validate", text, "validate")
    command.add_argument("tables", nargs="*", metavar="TABLE", help="which tables; none: all")
    command.add_argument("--out", metavar="FILE", help="write the tables as a Markdown page")
    common(command, sets=False, out=False)


def _choices(add: Add) -> None:
    command = add(
        "design",
        "studies.design",
        "Rank places of devices and signals by residue for each mode; design a lead-lag controller, and write its run.",
        "design two_area --damping 0.1 --delay 0.1 --out results/design",
        "simulate results/design/run.yaml",
        "design two_area --place statcom --signal w13",
    )
    named(command, "system", "systems")
    takes = between(0.001, 0.7)
    text = "wanted damping ratio of the mode, 0.001 to 0.7; default: 0.1"
    command.add_argument("--damping", type=takes, default=0.1, metavar="RATIO", help=text)
    text = "delay of the loop, from measurement to device, 0 to 1 s; default: 0.1"
    command.add_argument("--delay", type=between(0.0, 1.0, " s"), default=0.1, metavar="S", help=text)
    text = "frequency of the mode, 0.1 to 2 Hz; default: the least damped interarea mode, or of all"
    command.add_argument("--mode", type=between(0.1, 2.0, " Hz"), metavar="HZ", help=text)
    text = "a line (for an SSSC), a bus (for a STATCOM), or a device of the system; default: the best"
    command.add_argument("--place", metavar="NAME", help=text)
    text = "input of the controller: a signal of the system, or one that the command ranks; default: the best"
    command.add_argument("--signal", metavar="NAME", help=text)
    jobs(command)
    common(command, of="system")
    command = add(
        "tune",
        "studies.tune",
        "Tune the parameters of controllers on a system's scenario `training`, each by the same search and budget.",
        "tune two_area LLC-tuned --budget 30",
    )
    named(command, "system", "systems")
    command.add_argument("controllers", nargs="*", metavar="CONTROLLER", help="which; none: all of the table")
    command.add_argument("--devices", default="sssc", metavar="NAME,...", help="commanded devices; default: sssc")
    command.add_argument("--signals", default="speed", metavar="NAME,...", help="input signals; default: speed")
    profile(command, "thesis")
    text = "a scenario of the system, or a YAML file; default: training"
    command.add_argument("--scenario", default="training", metavar="NAME", help=text)
    text = "how signals are measured, a name under config/measurement; default: the profile's"
    command.add_argument("--measurement", metavar="NAME", help=text)
    command.add_argument("--budget", type=options.COUNT, default=600, metavar="N", help="runs for each; default: 600")
    command.add_argument("--seed", type=options.SEED, default=1, metavar="N", help="seed of the search; default: 1")
    jobs(command)
    command.add_argument("--out", metavar="FILE.yaml", help="the file of parameters; none: standard output")
    common(command, sets=False, out=False)
    command = add(
        "search",
        "studies.search",
        "Choose a controller and its parameters on training cases: all pairs, schemes, devices, compensations.",
        "search two_area gaussian+affine --devices sssc --budget 10 --jobs 1",
    )
    text = "a system with a study search_SYSTEM, its training cases; or any, with --study"
    command.add_argument("system", metavar="SYSTEM", help=text)
    command.add_argument(
        "controllers", nargs="*", metavar="CONTROLLER", help="which besides LLC-tuned; none: all pairs"
    )
    command.add_argument("--link", metavar="NAME", help="name under config/links, or a YAML file; default: no delay")
    command.add_argument("--devices", metavar="NAME,...", help="commanded devices; none: each set that is known")
    command.add_argument(
        "--signals", metavar="NAME,...", help="input signals, with --devices; default: speed, and power"
    )
    profile(command, "thesis")
    text = "what scores are relative to: LLC-tuned, the default, or none: no control"
    command.add_argument("--against", choices=("LLC-tuned", "none"), default="LLC-tuned", help=text)
    text = "delay compensation: free, the default: whichever is best; none; some: one of those that compensate"
    command.add_argument("--compensation", choices=("free", "none", "some"), default="free", help=text)
    text = "drop no structure on the way: search all to the end, with the same budget"
    command.add_argument("--keep-all", action="store_true", help=text)
    text = "study with the training cases; default: search_SYSTEM, or search_SYSTEM_PROFILE"
    command.add_argument("--study", metavar="STUDY", help=text)
    text = "training cases of the first rung; default: 1"
    command.add_argument("--cases", type=whole(1, 1000), default=1, metavar="N", help=text)
    text = "first points: hypercube, the default; tuned: with those that `tune` chose; or a run's: name or YAML file"
    command.add_argument("--start", default="hypercube", metavar="START", help=text)
    text = "standard deviation of the other first points about --start, of a range of 1; default: a hypercube"
    command.add_argument("--deviation", type=between(0.001, 0.5), metavar="D", help=text)
    methods = ("differential-evolution", "cma-es")
    command.add_argument("--scheme", choices=("direct", "indirect"), help="networks in this one only; default: in both")
    command.add_argument("--method", choices=methods, default=methods[0], help="default: differential-evolution")
    text = "percentage of the cases that count, the worst of each index; default: 100"
    counted = command.add_mutually_exclusive_group()
    counted.add_argument("--worst", type=whole(1, 100), default=100, metavar="PERCENT", help=text)
    text = "score by medians, the largest of any group of cases; groups: by the axes that are not drawn"
    counted.add_argument("--medians", action="store_true", help=text)
    text = "closed loops; default: 10000"
    command.add_argument("--budget", type=options.COUNT, default=10000, metavar="N", help=text)
    command.add_argument("--seed", type=options.SEED, default=1, metavar="N", help="seed of the search; default: 1")
    jobs(command)
    command.add_argument("--out", metavar="RUN.yaml", help="the run of the best network; none: standard output")
    command.add_argument("--lead-lag", metavar="RUN.yaml", help="also the run of LLC-tuned as the search tuned it")
    text = "also the parameters of all that were searched to the end, as under config/controllers; with --devices"
    command.add_argument("--tuned", metavar="FILE.yaml", help=text)
    common(command, sets=False, out=False)


def _others(add: Add) -> None:
    command = add("list", "runs.list_", "List what is shipped, with descriptions.", "list runs", "list controllers")
    command.add_argument("kind", choices=KINDS)
    common(command, sets=False, out=False)
    command = add(
        "new",
        "new.new",
        "Start something: the folder of a controller (class, run, study, test), or a key to sign messages with.",
        "new controller my_damper",
        "new key keys.yaml",
    )
    command.add_argument("kind", choices=("controller", "key"))
    text = "of the controller: small letters, digits and _; of a key: its FILE.yaml, which keeps the key before it"
    command.add_argument("name", metavar="NAME", help=text)
    command.add_argument("--out", metavar="DIR", help="folder of the controller; default: NAME")
    common(command, sets=False, out=False, json=False)


KINDS = (
    "systems",
    "scenarios",
    "profiles",
    "controllers",
    "links",
    "measurement",
    "supervision",
    "monitors",
    "runs",
    "studies",
    "campaigns",
)
# facts_damping.analysis.modes.poles.METHODS, which take long to load.
MODES = ("auto", "matrix_pencil", "prony", "era", "ssi")
