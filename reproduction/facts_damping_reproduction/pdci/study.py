"""Damping against gain and delay, linear and after the brake; events; failures with supervision and without."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from facts_damping.analysis.summary import summarise
from facts_damping.api.cases import case_of
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


def linear() -> list[dict[str, Any]]:
    """Damping ratios of the named modes and of the least damped slow mode, by measurement, gain and delay."""
    return [row for pmus, delays in plan()["measurement"].items() for row in _linear(pmus, delays)]


def _linear(pmus: str, delays: list[float]) -> list[dict[str, Any]]:
    rows = []
    for gain in plan()["gains"]:
        if gain == 0:
            case = made({})
            swings = [mode for mode in analyse(case.system, case.run.devices).modes if mode.swings]
            by_delay = [[(mode.damping_ratio, mode.frequency_hz) for mode in swings]] * len(delays)
        else:
            law = {"controllers.0.parameters.gain": gain * PER_MW_PER_MHZ, "measurement": pmus}
            case = unsupervised(made({**constant(0.0), **law}))
            whole, by_delay = delayed_loop(case), []
            for delay in delays:
                solved = eigen(whole, sampled(whole, delay))
                swings = [mode for mode in oscillations(whole, solved, case) if mode.swings]
                by_delay.append([(mode.damping_ratio, mode.frequency_hz) for mode in swings])
        for delay, modes in zip(delays, by_delay, strict=True):
            rows.append({"measurement": pmus, "gain": gain, "delay_s": delay, **_named(modes)})
    return rows


def _named(modes: Iterable[tuple[float, float]]) -> dict[str, Any]:
    """The modes nearest to the named frequencies, and the least damped one of the slow modes."""
    slow = sorted((ratio, hertz) for ratio, hertz in modes if 0.1 < hertz <= plan()["below"])
    row: dict[str, Any] = {}
    for name, hertz in plan()["modes"].items():
        ratio, at = min(slow, key=lambda mode: abs(mode[1] - hertz))
        row |= {name: ratio, f"{name}, Hz": at}
    return row | {"least damped": slow[0][0], "least damped, Hz": slow[0][1]}


def outcome(sets: dict[str, Any]) -> dict[str, Any]:
    """A run: verdict, ITAE, damping ratio and frequency of the response's strongest mode; when armed, when tripped."""
    record = loop.run(made(sets))
    summary = summarise(record, twin=twin_of(record))
    mode, did = summary.modes[0] if summary.modes else None, doings(record, 0.0)
    return {
        "verdict": summary.verdict,
        "ITAE": summary.indices and summary.indices["ITAE"],
        "damping_ratio": mode and mode.damping_ratio,
        "frequency_hz": mode and mode.frequency_hz,
        "armed_s": did.armed_s,
        "tripped_s": did.tripped_s,
        "cause": did.cause,
    }


def ringdowns() -> list[dict[str, Any]]:
    """After the brake, by gain and delay."""
    return [
        {"gain": gain, "delay_s": delay, **outcome(_with(gain, constant(delay)))}
        for gain in plan()["gains"]
        for delay in plan()["delays"]
        if gain or not delay
    ]


def _with(gain: float, sets: dict[str, Any]) -> dict[str, Any]:
    law: dict[str, Any] = {"controllers.0.parameters.gain": gain * PER_MW_PER_MHZ} if gain else {"controllers": []}
    return {**sets, **law}


def events() -> list[dict[str, Any]]:
    """Each event, with the law and without."""
    return [
        {"event": event, "gain": gain, **outcome(_with(gain, {"scenario": event}))}
        for event in plan()["events"]
        for gain in (0, plan()["gain"])
    ]


def failures() -> list[dict[str, Any]]:
    """Each failure after the brake, without a supervisor and with one."""
    changes = _with(plan()["gain"], {})
    return [
        {"failure": name, "supervised": bool(more), **outcome({**changes, **sets, **more})}
        for name, sets in plan()["failures"].items()
        for more in ({}, SUPERVISED)
    ]
