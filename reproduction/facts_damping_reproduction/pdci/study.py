"""Damping against gain and delay, linear and after the brake; events; failures with supervision and without."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from facts_damping.analysis.summary import summarise
from facts_damping.api.cases import case_of
from facts_damping.output.terminal import Progress
from facts_damping.plant.grid.power_flow import solve
from facts_damping.simulation import loop
from facts_damping.simulation.twins import twin_of
from facts_damping.small_signal.modal_tables import analyse
from facts_damping_studies.campaigns.actions import doings
from facts_damping_studies.margins.delay_margin import oscillations
from facts_damping_studies.margins.linear_closed_loop import delayed_loop, eigen, sampled
from facts_damping_studies.margins.unsupervised import unsupervised

if TYPE_CHECKING:
    from collections.abc import Iterable

    from facts_damping.case.model import Case

Rows = list[dict[str, Any]]
PLAN = Path(__file__).with_name("pdci.yaml")
PER_MW_PER_MHZ = 10.0  # gain of the signal `hertz`, p.u. of 100 MVA per Hz
SUPERVISED = {"supervision": "standard", "arm_at": 0.5}


@cache
def plan() -> dict[str, Any]:
    """The plan."""
    content: dict[str, Any] = yaml.safe_load(PLAN.read_text(encoding="utf-8"))
    return content


def made(sets: dict[str, Any]) -> Case:
    """The run with some fields changed."""
    return case_of(plan()["run"], sets)


def constant(delay: float) -> dict[str, Any]:
    """A link with a constant delay, s."""
    return {"link": {"up": [{"model": "constant", "delay": delay}], "down": []}}


def linear() -> Rows:
    """Damping ratios of the named modes and of the least damped slow mode, by measurement, gain and delay.

    The delay (s) is from the measured instant to the converter, with the latency of the PMUs. The columns `min` and
    `max` are the interval as the delay becomes longer by up to one frame; the others belong to the delay itself.
    """
    parts = [(pmus, delays, gain) for pmus, delays in plan()["measurement"].items() for gain in plan()["gains"]]
    rows = Rows()
    with Progress("pdci", "gains") as progress:
        for done, (pmus, delays, gain) in enumerate(parts, 1):
            loops = _over_phases(pmus, gain, delays)
            rows += [
                {"measurement": pmus, "gain": gain, "delay_s": delay, **modes}
                for delay, modes in zip(delays, loops, strict=True)
            ]
            progress(done, len(parts))
    return rows


def _over_phases(pmus: str, gain: float, delays: list[float]) -> Rows:
    """At each delay the modes, and their least and largest damping ratio over the phases."""
    if gain == 0:
        return [interval([free({})])] * len(delays)
    looped, phases = Looped(pmus, gain, {}), plan()["phases"]
    return [interval([looped.modes(delay, phase) for phase in phases]) for delay in delays]


def interval(rows: Rows) -> dict[str, Any]:
    """The first of some rows, and the interval of each damping ratio over all of them."""
    ends = {
        f"{name}, {end.__name__}": end(row[name] for row in rows)
        for name in (*plan()["modes"], "least damped")
        for end in (min, max)
    }
    return {**rows[0], **ends}


def free(sets: dict[str, Any]) -> dict[str, Any]:
    """The modes without control."""
    case = made(sets)
    swings = [mode for mode in analyse(case.system, case.run.devices).modes if mode.swings]
    return _named((mode.damping_ratio, mode.frequency_hz) for mode in swings)


class Looped:
    """The linear loop of the law for PMUs of a class, linearised once for all delays."""

    def __init__(self, pmus: str, gain: float, sets: dict[str, Any]) -> None:
        """`gain`, MW/mHz; `sets`: other fields of the run."""
        law = {"controllers.0.parameters.gain": gain * PER_MW_PER_MHZ, "measurement": pmus}
        self.case = unsupervised(made({**constant(0.0), **law, **sets}))
        self.loop = delayed_loop(self.case)

    def modes(self, delay: float, phase: float = 0.0) -> dict[str, Any]:
        """The modes for a delay (s) with the PMUs' latency, and some part of a frame more."""
        late = whole_ns(delay + phase / self.loop.frame_rate - latency(self.case))
        solved = eigen(self.loop, sampled(self.loop, late))
        swings = [mode for mode in oscillations(self.loop, solved, self.case) if mode.swings]
        return _named((mode.damping_ratio, mode.frequency_hz) for mode in swings)


def latency(case: Case) -> float:
    """Latency of the PMUs' filter, s."""
    return case.filter.delay / case.run.frame_rate


def whole_ns(seconds: float) -> float:
    """The next nanosecond, s: a whole number of frames must not become less."""
    return float(np.ceil(round(seconds * 1e9, 3)) / 1e9)


def _named(modes: Iterable[tuple[float, float]]) -> dict[str, Any]:
    """The modes nearest to the named frequencies, and the least damped one of the slow modes."""
    slow = sorted((ratio, hertz) for ratio, hertz in modes if 0.1 < hertz <= plan()["below"])
    row: dict[str, Any] = {}
    for name, hertz in plan()["modes"].items():
        ratio, at = min(slow, key=lambda mode: abs(mode[1] - hertz))
        row |= {name: ratio, f"{name}, Hz": at}
    return row | {"least damped": slow[0][0], "least damped, Hz": slow[0][1]}


def outcome(sets: dict[str, Any], hertz: float | None = None) -> dict[str, Any]:
    """A run: verdict, ITAE, damping ratio and frequency of a mode of the response; when armed, when tripped.

    The mode is the one nearest to `hertz`; without it the strongest.
    """
    record = loop.run(made(sets))
    summary, did = summarise(record, twin=twin_of(record)), doings(record, 0.0)
    near = summary.modes if hertz is None else sorted(summary.modes, key=lambda mode: abs(mode.frequency_hz - hertz))
    mode = near[0] if near else None
    return {
        "verdict": summary.verdict,
        "ITAE": summary.indices and summary.indices["ITAE"],
        "damping_ratio": mode and mode.damping_ratio,
        "frequency_hz": mode and mode.frequency_hz,
        "armed_s": did.armed_s,
        "tripped_s": did.tripped_s,
        "cause": did.cause,
    }


def ringdowns() -> Rows:
    """North-south B after the brake, by gain and delay, with the first PMUs of the plan."""
    pmus, delays = next(iter(plan()["measurement"].items()))
    hertz = plan()["modes"]["north-south B"]
    return [
        {"gain": gain, "delay_s": delay, **outcome(_with(gain, linked(pmus, delay)), hertz)}
        for gain in plan()["gains"]
        for delay in delays
        if gain or delay == delays[0]
    ]


def linked(pmus: str, delay: float) -> dict[str, Any]:
    """PMUs, and a link that makes the whole delay (s) with their latency."""
    return {"measurement": pmus, **constant(whole_ns(delay - latency(made({"measurement": pmus}))))}


def _with(gain: float, sets: dict[str, Any]) -> dict[str, Any]:
    law: dict[str, Any] = {"controllers.0.parameters.gain": gain * PER_MW_PER_MHZ} if gain else {"controllers": []}
    return {**sets, **law}


def converters() -> Rows:
    """Modes, and north-south B after the brake, by what the DC lines do while voltages change."""
    rows, hertz = Rows(), plan()["modes"]["north-south B"]
    for name, kinds in plan()["converters"].items():
        sets, gain = schedule(kinds["schedule"]), plan()["gain"] * per_power(kinds["modulation"])
        for pmus, delay, now in [("none", None, 0), *((pmus, delay, gain) for pmus, delay in plan()["loops"])]:
            modes = Looped(pmus, now, sets).modes(delay) if now else free(sets)
            run = outcome(_with(now, {**sets, **(linked(pmus, delay) if now else {})}), hertz)
            after = {"after the brake": run["damping_ratio"], "after the brake, Hz": run["frequency_hz"]}
            rows.append({"converters": name, "measurement": pmus, "gain": now, "delay_s": delay, **modes, **after})
    return rows


def schedule(kind: str) -> dict[str, Any]:
    """The ends of the DC lines at constant `current` or `power`, or as `impedance`; they are the loads without Q."""
    loads = made({}).system.loads
    return {f"system.loads.{i}.P_fractions": {kind: 1} for i, load in enumerate(loads) if not load.Q}


def per_power(modulation: str) -> float:
    """Power at rest by the setpoint of the modulation: as `conductance` the mean square of both ends' voltages, p.u."""
    case = made({})
    flow, line = solve(case.system), case.run.devices[0]
    buses = [load.bus for load in case.system.loads if load.name.startswith(line)]
    squares = [abs(flow.voltage[flow.names.index(bus)]) ** 2 for bus in buses]
    return float(np.mean(squares)) if modulation == "conductance" else 1.0


def events() -> Rows:
    """Each event, with the law and without."""
    return [
        {"event": event, "gain": gain, **outcome(_with(gain, {**plan()["set"], "scenario": event}))}
        for event in plan()["events"]
        for gain in (0, plan()["gain"])
    ]


def failures() -> Rows:
    """Each failure after the brake, without a supervisor and with one."""
    changes = _with(plan()["gain"], plan()["set"])
    return [
        {"failure": name, "supervised": bool(more), **outcome({**changes, **sets, **more})}
        for name, sets in plan()["failures"].items()
        for more in ({}, SUPERVISED)
    ]
