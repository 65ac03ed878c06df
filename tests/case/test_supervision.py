"""Supervision as users write it: what is wrong is refused in one line, with what is allowed; presets are sound."""

from __future__ import annotations

import json
import re

import pytest

from facts_damping.case.loading import load_case
from facts_damping.case.supervision import local_signals
from facts_damping.errors import InputError
from facts_damping.monitor_table import MONITORS
from facts_damping.parameters.files import shipped
from facts_damping.simulation.assembly import build_control, build_supervisors


def fallback(**more: object) -> str:
    row = {"name": "LLC", "signals": ["power_rate"], "fallback_of": 0, **more}
    return f"controllers={json.dumps([{'name': 'LLC'}, row])}"


ON, PROBED = "supervision=standard", "supervision=probed"
REFUSED: list[tuple[list[str], str]] = [
    (["supervision=nothing"], "supervision: 'nothing' given; allowed: probed, standard"),
    ([ON, "supervision.monitors.noise.limit=1"], "supervision.monitors.noise: 'noise' given; allowed: "),
    ([ON, "supervision.monitors.stale.limit=0"], "supervision.monitors.stale.limit: 0 given; allowed: 0.01 to 60 s"),
    ([ON, "supervision.monitors.stale.limit=.nan"], "monitors.stale.limit"),
    ([ON, "supervision.monitors.harm.limit=.inf"], "monitors.harm.limit"),
    ([ON, "supervision.monitors.harm.lasts=-1"], "supervision.monitors.harm.lasts: -1 given; allowed: "),
    ([ON, "supervision.monitors.harm.follows=explode"], "monitors.harm.follows: 'explode' given; allowed: "),
    ([ON, "supervision.monitors.harm=1"], "supervision.monitors.harm"),
    ([ON, "supervision.monitors=all"], "supervision.monitors"),
    ([ON, "supervision.arming.ramp=-1"], "supervision.arming.ramp: -1 given"),
    ([ON, "supervision.arming.recovery=soon"], "supervision.arming.recovery: 'soon' given"),
    ([ON, "supervision.authority.fraction=0"], "supervision.authority.fraction: 0 given"),
    ([ON, "supervision.authority.fraction=1.01"], "supervision.authority.fraction: 1.01 given"),
    ([ON, "supervision.authority.rate=0"], "supervision.authority.rate: 0 given"),
    ([ON, "supervision.authority.energy=61"], "supervision.authority.energy: 61 given"),
    ([ON, "supervision.probe.amplitude=0.6"], "supervision.probe.amplitude: 0.6 given"),
    ([ON, "supervision.probe.cycles=1"], "supervision.probe.cycles: 1 given"),
    ([ON, "supervision.probe.phase=181"], "supervision.probe.phase: 181 given"),
    ([ON, "supervision.fault.kind=tired"], "supervision.fault.kind: 'tired' given; allowed: "),
    ([ON, "supervision.nothing=1"], "supervision.nothing"),
    (["arm_at=1"], "arm_at: 1 given; allowed: with `supervision`"),
    (["arm_at=1", "supervision=off"], "arm_at: 1 given; allowed: with `supervision`"),
    ([ON, "arm_at=-1"], "arm_at: -1 given"),
    (
        [ON, "supervision.arming.probe=true", "arm_at=30"],
        "arm_at: 30 given, but supervision.arming.probe needs a probe before, and supervision.probe.start is none",
    ),
    ([PROBED, "arm_at=0.4"], "supervision.probe.start is 0.5; allowed: arm_at after a probe"),
    ([fallback()], "controllers.1.fallback_of: 0 given; allowed: with `supervision`"),
    ([ON, fallback(fallback_of=1)], "controllers.1.fallback_of: 1 given; allowed: the index of a controller, 0"),
    ([ON, fallback(fallback_of=7)], "controllers.1.fallback_of: 7 given; allowed: the index of a controller, 0"),
    ([ON, fallback(fallback_of=-1)], "controllers.1.fallback_of: -1 given"),
    (
        [ON, fallback(signals=["speed"])],
        "'speed' given, which is not measured at sssc; allowed for a fallback: power, power_rate, voltage",
    ),
    (
        [ON, "devices=[sssc, statcom]", fallback(devices=["statcom"])],
        "controllers.1.devices: statcom given; allowed: those of its controller, sssc",
    ),
    (["controllers.0.faults=[{kind: storm}]"], "controllers.0.faults.0.kind: 'storm' given; allowed: "),
    (["controllers.0.faults=[{kind: nan, size: 2}]"], "size: given for nan; allowed: for gain, weights only"),
    (["controllers.0.faults=[{kind: gain, size: 1.0e+4}]"], "controllers.0.faults.0.size: 10000.0 given"),
    (["controllers.0.faults=[{kind: hung, duration: 0}]"], "controllers.0.faults.0.duration: 0 given"),
]


@pytest.mark.parametrize(("sets", "said"), REFUSED, ids=[" ".join(sets) for sets, _ in REFUSED])
def test_invalid_supervision_is_refused_in_one_line(sets: list[str], said: str) -> None:
    with pytest.raises(InputError, match=re.escape(said)) as caught:
        load_case(None, sets)
    assert "\n" not in str(caught.value)


def test_two_fallbacks_of_one_controller_are_refused() -> None:
    row = {"name": "LLC", "signals": ["power"], "fallback_of": 0}
    with pytest.raises(InputError, match=r"controllers\.1\.fallback_of: 0 given twice; allowed: one fallback a c"):
        load_case(None, [ON, f"controllers={json.dumps([{'name': 'LLC'}, row, row])}"])


@pytest.mark.parametrize(
    ("sets", "said"),
    [
        (
            [PROBED, "arm_at=5"],
            r"^arm_at: 5 given, but the probe ends later; allowed: from 13\.\d+ on$",
        ),
        (
            [PROBED, "arm_at=20", "devices=[sssc, statcom]", "controllers.0.devices=[sssc, statcom]",
             "controllers.0.signals=[speed, power]", "controllers.0.name=LQG"],
            r"^arm_at: 20 given, but the probe of 2 devices ends later; allowed: from 25\.\d+ on$",
        ),
    ],
)  # fmt: skip
def test_probe_that_is_not_over_when_a_controller_is_to_be_armed_is_refused(sets: list[str], said: str) -> None:
    case = load_case(None, sets)
    with pytest.raises(InputError, match=said) as caught:
        build_supervisors(case)
    minimum = str(caught.value).split()[-2]
    build_supervisors(load_case(None, [*sets, f"arm_at={minimum}"]))


def test_probe_needs_a_mode(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("facts_damping.simulation.assembly.plant_residues", lambda _: None)
    with pytest.raises(InputError, match=r"^supervision\.arming\.probe: true given; allowed: no probe, as the plant"):
        build_supervisors(load_case(None, [PROBED]))
    supervisors, _ = build_supervisors(load_case(None, [ON]))
    assert supervisors.settings["omega"].tolist() == [0.0]


@pytest.mark.parametrize("name", shipped("supervision"))
def test_presets_supervise_any_controller(name: str) -> None:
    for sets in ([], ["controllers.0.name=HBsWC"], ["system=smib", "scenario=heavy"], [fallback()]):
        case = load_case(None, [f"supervision={name}", *sets])
        build_control(case)
        supervisors, _ = build_supervisors(case)
        assert supervisors.settings.size == 1
        assert load_case(None, [f"supervision={json.dumps(case.document()['supervision'])}"]).supervision


@pytest.mark.parametrize("text", ["off", "false", "null"])
def test_supervision_may_be_off(text: str) -> None:
    assert load_case(None, [f"supervision={text}"]).supervision is None


def test_monitor_may_be_off_and_others_keep_what_the_table_says() -> None:
    case = load_case(None, [ON, "supervision.monitors.harm=off", "supervision.monitors.stale.limit=1"])
    rows = dict(zip(MONITORS, build_supervisors(case)[0].thresholds[0], strict=True))
    assert rows["harm"]["follows"] == 0
    assert (rows["stale"]["limit"], rows["stale"]["lasts_ns"]) == (1.0, 50_000_000 - 1)  # ticks are rounded down
    assert rows["missing"]["limit"] == MONITORS["missing"].limit


def test_local_signals_are_those_of_stations_at_a_device() -> None:
    system = load_case(None).system
    for device in ("sssc", "statcom"):
        assert local_signals(system, [device]) == ["power", "power_rate", "voltage"]
