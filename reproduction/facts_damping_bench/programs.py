"""The programs: a row for each, with what pip installs it, its steps, and what it computes otherwise than we do."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from typing import NamedTuple

ROOM = "facts_damping_bench"
STEPS = (0.02, 0.01, 0.005, 0.0025)  # s, parts of 20 ms
FEWER = STEPS[:3]  # of those that take seconds


class Program(NamedTuple):
    """A program beside ours: its module has `prepare` and `run`."""

    title: str
    module: str
    distributions: tuple[str, ...]  # what pip installs, as in the extra `bench`; the first has the version; ours: none
    steps: tuple[float, ...]  # s, longest first
    model: str  # our machine model with the equations that it has
    more: tuple[str, ...]  # fields of our machines that it has otherwise
    note: str  # what differs, and how it is run


OURS = "facts_damping"
EXCHANGE = "helics"
PROGRAMS = {
    OURS: Program(
        "facts_damping",
        f"{ROOM}.ours",
        (),
        STEPS,
        "genrou",
        (),
        "GENROU, Runge-Kutta of fourth order; the network is reduced before the run, which counts as set-up",
    ),
    "andes": Program(
        "ANDES",
        f"{ROOM}.with_andes",
        ("andes",),
        FEWER,
        "genrou",
        (),
        "the same equations; trapezoidal rule, its steps of 0.1 ms after events, tolerance 1e-6",
    ),
    "dpsim": Program(
        "DPsim",
        f"{ROOM}.with_dpsim",
        ("dpsim",),
        STEPS,
        "cascade",
        ("Ra=0",),
        "machines of type 6b: cascade of circuits, no leakage, no stator resistance; static phasors; starts from our "
        "power flow; called step by step from Python, without its log files",
    ),
    "stepss": Program(
        "STEPSS",
        f"{ROOM}.with_stepss",
        ("stepss",),
        STEPS,
        "genrou",
        (),
        "RAMSES, trapezoidal rule, tolerance 1e-6, one thread; Park's windings, given so that they are GENROU's, but "
        "with the speed in the stator's equations; starts from our power flow; needs libopenblas0 and libgfortran5",
    ),
    "pydae": Program(
        "pydae",
        f"{ROOM}.with_pydae",
        ("pydae", "pydae-bps"),
        STEPS,
        "cascade",
        (),
        "its GENROU is a cascade of circuits without leakage; generated C, trapezoidal rule, dense matrices, tolerance "
        "1e-6; equations and C are made once and not counted; the power flow's loads are given to it as impedances",
    ),
    "tops": Program(
        "TOPS",
        f"{ROOM}.with_tops",
        ("tops",),
        FEWER,
        "cascade",
        ("Ra=0",),
        "cascade of circuits, no leakage, no stator resistance; constant mechanical power, which a damping of -P makes "
        "a constant torque; modified Euler's method of its own solver",
    ),
}
LARGE = {
    OURS: Program(
        "facts_damping",
        f"{ROOM}.large_ours",
        (),
        (0.01, 0.005, 0.0025, 0.00125),
        "",
        (),
        "imported from the files; Runge-Kutta of fourth order; the network is reduced before the run, which counts as "
        "set-up",
    ),
    "andes": Program(
        "ANDES",
        f"{ROOM}.large_andes",
        PROGRAMS["andes"].distributions,
        FEWER,
        "",
        (),
        "trapezoidal rule, its steps of 0.1 ms after events, tolerance 1e-6; two machines at bus 23 share their "
        "reactive power otherwise than ours",
    ),
}
WECC = {
    OURS: Program(
        "facts_damping",
        f"{ROOM}.wecc_ours",
        (),
        FEWER,
        "",
        (),
        "imported from the files, with ANDES's equations; Runge-Kutta of fourth order; the network is reduced before "
        "the run, which counts as set-up",
    ),
    "andes": Program(
        "ANDES",
        f"{ROOM}.wecc_andes",
        PROGRAMS["andes"].distributions,
        STEPS[1:3],
        "",
        (),
        "the files without IEEEST, whose numerator it drops; trapezoidal rule, its steps of 0.1 ms after events, "
        "tolerance 1e-6",
    ),
}
HELICS = ("helics",)  # the distribution


def missing(distributions: tuple[str, ...]) -> str:
    """What pip would have to install, for a table; empty: nothing."""
    lacking = []
    for name in distributions:
        try:
            version(name)
        except PackageNotFoundError:
            lacking.append(name)
    return f"not installed (pip install {' '.join(lacking)})" if lacking else ""
