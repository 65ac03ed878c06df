"""The probe finds what stands between setpoint and signal, and arming is refused where that is not as known."""

from __future__ import annotations

import json
import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq

from facts_damping.case.loading import load_case
from facts_damping.monitor_table import STATES, cause_name
from facts_damping.simulation import loop
from facts_damping.simulation.assembly import plant_residues
from facts_damping.supervision.model import UNKNOWNS
from facts_damping.supervision.probe import fit
from facts_damping_studies.margins.linear_closed_loop import delayed_loop, eigen, sampled

QUIET = ["supervision=probed", "scenario=[]", "arm_at=13.2", "duration=13.5"]
SMIB = [*QUIET, "system=smib", "arm_at=7.5", "duration=8"]
LATEST = {"two_area": QUIET, "smib": SMIB}
FREQUENCY = ["measurement=p_class", "controllers.0.signals=[frequency]"]
BOTH = ["devices=[sssc, statcom]", "controllers.0.devices=[sssc, statcom]", "controllers.0.name=ANFTSC", "arm_at=26"]


def down(**stage: Any) -> str:
    return f"link={json.dumps({'down': [stage]})}"


@cache
def probed(*sets: str) -> tuple[Any, str, str]:
    """What the supervisor tells at the end, its state, and why it is not armed."""
    report = loop.run(load_case(None, list(sets))).supervision[-1]
    return report, STATES[report["state"]], cause_name(int(report["refused"]))


def omega(*sets: str) -> float:
    residues = plant_residues(load_case(None, list(sets)))
    assert residues is not None
    return residues.eigenvalue.imag


@pytest.mark.parametrize("system", LATEST)
@pytest.mark.parametrize("sets", [[], ["link=delay_100ms"], ["link=csg"]], ids=str)
def test_plant_that_is_as_known_answers_as_known(system: str, sets: list[str]) -> None:
    """Delays of the link are known: those of the way up by time stamps, those of the way down by its model."""
    report, state, refused = probed(*LATEST[system], *sets)
    assert report["probe_gain"] == pytest.approx(1.0, abs=0.03)
    assert math.degrees(report["probe_phase"]) == pytest.approx(0.0, abs=1.5)
    assert report["probe_coherence"] > 0.95
    assert (state, refused) == ("armed", "")


def test_filters_of_pmus_are_known() -> None:
    report, state, _ = probed(*QUIET, *FREQUENCY)
    assert report["probe_gain"] == pytest.approx(1.0, abs=0.03)
    assert math.degrees(report["probe_phase"]) == pytest.approx(0.0, abs=1.5)
    assert state == "armed"


@pytest.mark.parametrize("system", LATEST)
@pytest.mark.parametrize("factor", [0.1, 0.5, 2.0, 5.0, -1.0])
def test_probe_finds_the_gain_of_the_downlink(system: str, factor: float) -> None:
    report, state, refused = probed(*LATEST[system], down(model="scale", factor=factor))
    gain = report["probe_gain"] * np.exp(1j * report["probe_phase"])
    assert abs(gain - factor) < 0.04 * abs(factor)
    why = "probe: phase" if factor < 0.0 else "" if 1.0 / 3.0 < factor < 3.0 else "probe: gain"
    assert (state, refused) == ("shadow" if why else "armed", why)


@pytest.mark.parametrize("system", LATEST)
@pytest.mark.parametrize("delay", [0.05, 0.1, 0.25])
def test_delay_that_is_not_known_turns_the_phase(system: str, delay: float) -> None:
    """By omega tau, with a tenth for what the other modes answer; beyond the tolerance arming is refused.

    Also where the phase is within it, and control would take damping away.
    """
    report, state, refused = probed(*LATEST[system], down(delay=delay, start=0.001))
    turned = omega(*LATEST[system]) * delay
    assert report["probe_phase"] == pytest.approx(-turned, rel=0.1)
    why = "probe: phase" if turned > math.radians(60.0) else "probe: damping" if report["added_damping"] < 0.0 else ""
    assert (state, refused) == ("shadow" if why else "armed", why)
    assert (report["added_damping"] < 0.0) == (report["phase_margin"] < 0.0)


def test_noise_of_loads_lowers_the_coherence_until_arming_is_refused() -> None:
    reports = [probed(*QUIET, f"load_noise.std={std}") for std in (0.0, 0.01, 0.03)]
    coherence = [float(report["probe_coherence"]) for report, *_ in reports]
    assert coherence == sorted(coherence, reverse=True)
    assert coherence[1] > 0.5 > coherence[2]
    assert [(state, refused) for _, state, refused in reports] == [
        ("armed", ""),
        ("armed", ""),
        ("shadow", "probe: coherence"),
    ]


def test_noise_of_measurement_hardly_matters() -> None:
    report, state, _ = probed(*QUIET, *FREQUENCY, "measurement.noise.frequency=0.001")
    assert report["probe_gain"] == pytest.approx(1.0, abs=0.05)
    assert state == "armed"


def test_devices_are_probed_one_after_the_other_and_the_worst_counts() -> None:
    report, state, refused = probed(*QUIET, *BOTH, "duration=27")
    assert (state, refused) == ("armed", "")
    assert abs(math.degrees(report["probe_phase"])) < 20.0
    turned = down(model="scale", factor=-1, channels=["statcom"])
    report, state, refused = probed(*QUIET, *BOTH, "duration=27", turned)
    assert (state, refused) == ("shadow", "probe: phase")
    assert abs(math.degrees(report["probe_phase"])) > 160.0


def test_while_a_device_is_probed_the_other_rests() -> None:
    record = loop.run(load_case(None, [*QUIET, *BOTH, "duration=25"]))
    setpoints = record.supervised
    times = [setpoints["issued_ns"][(setpoints["device"] == d) & (setpoints["value"] != 0.0)] / 1e9 for d in (0, 1)]
    assert times[0].min() == pytest.approx(0.5, abs=0.05)
    assert times[0].max() < times[1].min()
    limits = [device.setpoint_max for device in load_case(None, [*QUIET, *BOTH]).system.devices]
    for d in (0, 1):
        largest = np.abs(setpoints["value"][setpoints["device"] == d]).max()
        assert 0.15 * limits[d] < largest <= 0.2 * limits[d]  # two tones of a tenth


def test_probe_is_over_when_it_is_said_to_be(monkeypatch: pytest.MonkeyPatch) -> None:
    """Armed at the time that a refusal names, and not a tick before."""
    monkeypatch.setattr("facts_damping.simulation.assembly._check_probes", lambda *_: None)
    reports = [probed(*QUIET, f"arm_at={at}") for at in (13.167, 13.15)]
    assert [(state, refused) for _, state, refused in reports] == [("armed", ""), ("shadow", "no probe")]


def test_probe_reports_the_damping_that_the_controller_adds() -> None:
    """Added damping and margin of phase: of a lead-lag controller about a tenth of 1/s; the other way round, less."""
    good, _, _ = probed(*QUIET)
    turned, _, _ = probed(*QUIET, down(model="scale", factor=-1))
    assert 0.1 < good["added_damping"] < 0.3
    assert good["added_damping"] == pytest.approx(-turned["added_damping"], rel=0.02)
    assert good["phase_margin"] > 0.0 > turned["phase_margin"]
    assert math.isnan(turned["gain_margin"])


@pytest.mark.parametrize(("sets", "gain"), [(QUIET, 5.0), (SMIB, -2.0)])
def test_margin_of_gain_is_that_of_the_linear_loop(sets: list[str], gain: float) -> None:
    """A mode that grows needs a part of the gain, one that fades bears some of the wrong sign."""
    report, *_ = probed(*sets, f"controllers.0.parameters.gain={gain}")
    turning = omega(*sets)

    def growth(factor: float) -> float:
        closed_loop = delayed_loop(load_case(None, [*sets, f"controllers.0.parameters.gain={factor * gain}"]))
        modes = eigen(closed_loop, sampled(closed_loop, 0.0)).values
        return max(float(mode.real) for mode in modes if abs(mode.imag - turning) < 1.0)

    assert report["gain_margin"] == pytest.approx(brentq(growth, 0.1, 5.0, xtol=0.01), rel=0.1)


@given(seed=st.integers(0, 2**32 - 1), first=st.sampled_from([0, 2]), alike=st.booleans())
def test_fit_is_that_of_least_squares(seed: int, first: int, alike: bool) -> None:
    """Of any columns; also where one says what another says already."""
    random = np.random.default_rng(seed)
    columns = random.standard_normal((40, UNKNOWNS)) * 10.0 ** random.uniform(-3, 3, UNKNOWNS)
    if alike:
        columns[:, -1] = 3.0 * columns[:, -2]
    y = random.standard_normal(40)
    whole = np.column_stack([columns, y])
    sums, work = np.zeros((2, UNKNOWNS + 1, UNKNOWNS + 1))
    sums[:UNKNOWNS] = np.triu(whole.T @ whole)[:UNKNOWNS]
    left = fit(sums, float(y @ y), work, first)
    solution, *_ = np.linalg.lstsq(columns[:, first:], y, rcond=None)
    assert left == pytest.approx(float(np.sum((y - columns[:, first:] @ solution) ** 2)), rel=1e-6)
    fitted = columns[:, first:] @ work[first:UNKNOWNS, UNKNOWNS]
    assert fitted == pytest.approx(columns[:, first:] @ solution, rel=1e-5, abs=1e-7)
