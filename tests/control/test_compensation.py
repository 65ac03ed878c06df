"""Delay compensation: what each kind makes of signals whose answer is known, a plant with a known delay, bad input."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.analysis.measures import columns, event_times, speed_differences
from facts_damping.analysis.verdict import DAMPED, judge
from facts_damping.case.loading import load_case
from facts_damping.control.compensation import MAX_LEAD, compensate, compensators, lead, phasor
from facts_damping.control.parameter_tables import COMPENSATION_PARAMETERS
from facts_damping.control.table import SETTINGS
from facts_damping.errors import InputError
from facts_damping.simulation import loop
from facts_damping_studies.margins.linear_closed_loop import delayed_loop

if TYPE_CHECKING:
    from numpy.typing import NDArray

FRAMES = 60
OMEGA = 2.0 * math.pi * 0.63  # rad/s
TIME = np.arange(0.0, 40.0, 1.0 / FRAMES)
LATE = TIME > 30.0
ANGLES = [15.0, 40.0, 56.0, 90.0, 119.0]  # degrees of w tau


def fitted(values: NDArray[np.float64], omega: float = OMEGA) -> tuple[complex, float]:
    """Phasor and mean of the last 10 s by least squares."""
    columns = np.column_stack([np.cos(omega * TIME), -np.sin(omega * TIME), np.ones(len(TIME))])[LATE]
    real, imaginary, mean = np.linalg.lstsq(columns, values[LATE], rcond=None)[0]
    return complex(real, imaginary), float(mean)


def led(phase: float, omega: float = OMEGA, mean: float = 0.0, of: float = OMEGA) -> NDArray[np.float64]:
    """Lead sections for `phase` at `of`, of a sinusoid of `omega`."""
    state, signal = np.zeros(4), mean + np.cos(omega * TIME)
    return np.array([lead(of, phase, state, y, 1.0 / FRAMES if k else 0.0) for k, y in enumerate(signal)])


def turned(phase: float, rate: float, mean: float = 0.0) -> NDArray[np.float64]:
    """The phasor's way with a sinusoid about a mean."""
    state, signal = np.zeros(3), mean + 0.01 * np.cos(OMEGA * TIME)
    return np.array([phasor(OMEGA, phase, rate, state, y, 1.0 / FRAMES if k else 0.0) for k, y in enumerate(signal)])


@pytest.mark.parametrize("degrees", [0.0, *ANGLES])
def test_lead_turns_by_the_phase_and_keeps_the_size_at_the_mode(degrees: float) -> None:
    gain, _ = fitted(led(math.radians(degrees)))
    assert abs(gain) == pytest.approx(1.0, abs=1e-3)
    assert math.degrees(np.angle(gain)) == pytest.approx(degrees, abs=0.05)


@pytest.mark.parametrize("omega", [0.5 * OMEGA, 2.0 * OMEGA])
def test_lead_off_the_mode_is_what_its_transfer_function_says(omega: float) -> None:
    p = math.radians(25.0)
    a = math.sqrt((1.0 + math.sin(p)) / (1.0 - math.sin(p))) / OMEGA
    s = 1j * omega
    wanted = ((1.0 + s * a) / (1.0 + s / (a * OMEGA**2)) / (a * OMEGA)) ** 2
    gain, _ = fitted(led(2.0 * p, omega), omega)
    assert gain == pytest.approx(wanted, rel=2e-3)


def test_lead_stays_at_what_two_sections_reach() -> None:
    assert led(3.0).tobytes() == led(2.0 * MAX_LEAD).tobytes()
    assert not np.array_equal(led(2.0 * MAX_LEAD), led(1.9 * MAX_LEAD))


def test_lead_starts_at_rest() -> None:
    state = np.zeros(4)
    values = [lead(OMEGA, 1.0, state, 0.7, 1.0 / FRAMES if k else 0.0) for k in range(100)]
    assert values == pytest.approx([values[0]] * 100, rel=1e-12)


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0])
@pytest.mark.parametrize("degrees", [0.0, *ANGLES, 170.0])
def test_phasor_is_the_signal_ahead_without_its_mean(degrees: float, rate: float) -> None:
    """To 1e-4 of its size, once 30 s are over, at any distance ahead."""
    ahead = 0.01 * np.cos(OMEGA * TIME + math.radians(degrees))
    assert turned(math.radians(degrees), rate, mean=0.3)[LATE] == pytest.approx(ahead[LATE], abs=1e-6)


def test_phasor_settles_as_fast_as_it_forgets() -> None:
    def errors(rate: float) -> NDArray[np.float64]:
        return np.abs(turned(0.0, rate) - 0.01 * np.cos(OMEGA * TIME))

    assert errors(1.0)[(TIME > 5.0) & (TIME < 8.0)].max() < 0.05 * 0.01
    assert errors(0.2)[(TIME > 5.0) & (TIME < 8.0)].max() > 0.1 * 0.01


def step(name: str, ages: list[float], **settings: float) -> tuple[list[float], Any]:
    """Signals of one controller whose frames come with `ages` (s), of a sinusoid; and the state at the end."""
    constants, state = compensators([name], [OMEGA], 1)
    row = np.zeros(1, SETTINGS)
    for key, parameter in COMPENSATION_PARAMETERS.items():
        row[key] = settings.get(key, max(float(parameter.default), 0.0))  # type: ignore[arg-type]
    values = []
    for k, age in enumerate(ages):
        signal = np.array([math.cos(OMEGA * k / FRAMES)])
        compensate(constants, state, 0, row[0], signal, k, age, 1.0 / FRAMES if k else 0.0)
        values.append(float(state.signal[0, 0]))
    return values, state


@pytest.mark.parametrize("name", ["lead", "phasor"])
def test_stamps_and_the_way_down_say_how_far_ahead(name: str) -> None:
    values, state = step(name, [0.1] * len(TIME), down_delay=0.15)
    assert state.latency[0] == pytest.approx(0.1)
    gain, _ = fitted(np.array(values))
    assert abs(gain) == pytest.approx(1.0, abs=2e-3)
    assert np.angle(gain) == pytest.approx(OMEGA * 0.25, abs=2e-3)


def test_latency_is_filtered() -> None:
    ages = [0.1] * 60 + [0.3] * 30
    _, state = step("lead", ages, latency_filter=0.5)
    assert state.latency[0] == pytest.approx(0.3 - 0.2 * math.exp(-1.0), rel=1e-9)
    assert step("lead", ages, latency_filter=0.0)[1].latency[0] == 0.3


def test_none_hands_signals_on() -> None:
    values, _ = step("none", [0.2] * 100)
    assert values == [math.cos(OMEGA * k / FRAMES) for k in range(100)]


def damped(*sets: str) -> bool:
    record = loop.run(load_case("two_area_small", list(sets)))
    signals = columns(speed_differences(record))
    return bool(record.in_synchronism.all()) and (
        judge(record.time_s, signals, event_times(record)[-1]).verdict == DAMPED
    )


DELAYED = ("link.up=[{delay: 0.15}]", "link.down=[{delay: 0.1}]")


@pytest.mark.parametrize("name", ["lead", "phasor"])
def test_compensated_lead_lag_damps_at_a_delay_at_which_it_does_not_by_itself(name: str) -> None:
    """Its linear margin is 0.1685 s (docs/delay.md); here 0.25 s, and twice the margin."""
    assert damped("link=ideal")
    assert not damped(*DELAYED)
    assert damped(*DELAYED, f"controllers.0.compensation={name}")
    twice = ("link.up=[{delay: 0.2}]", "link.down=[{delay: 0.137}]")
    assert damped(*twice, f"controllers.0.compensation={name}")


def test_way_down_is_its_mean_and_may_be_given() -> None:
    jitter = "link.down=[{delay: 0.05}, {model: uniform, low: 0.0, high: 0.1}]"
    case = load_case(None, [jitter, "controllers.0.compensation=lead"])
    assert case.controllers[0].number("down_delay") == pytest.approx(0.1)
    case = load_case(None, [jitter, "controllers.0.parameters.down_delay=0.02"])
    assert case.controllers[0].number("down_delay") == 0.02


def test_mode_is_the_plants_or_given() -> None:
    built = loop.build_loop(load_case(None, ["controllers.0.compensation=lead"]))
    assert built.control.bank.compensators.omega[0] == pytest.approx(2.0 * math.pi * 0.6297, rel=1e-3)  # docs/design.md
    sets = ["controllers.0.compensation=lead", "controllers.0.parameters.mode_hz=0.5"]
    assert loop.build_loop(load_case(None, sets)).control.bank.compensators.omega[0] == math.pi


@pytest.mark.parametrize(
    ("system", "message"),
    [
        (["system=two_area"], r"allowed: none, lead, phasor: the plant's mode \+0.055 \+- 3.957j 1/s .* is unstable"),
        (
            ["system=smib", "scenario=nominal"],
            r"least damped mode -0.207 \+- 7.591j 1/s .* after disturbances",
        ),
    ],
)
def test_smith_predictor_is_refused_with_the_mode_that_it_leaves(system: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        loop.build_loop(load_case(None, [*system, "controllers.0.compensation=smith"]))
    assert "\n" not in str(error.value)


def test_invalid_compensation_is_refused_with_what_is_allowed() -> None:
    with pytest.raises(InputError, match=r"controllers\.0\.compensation.*magic.*none.*lead.*phasor"):
        load_case(None, ["controllers.0.compensation=magic"])
    with pytest.raises(InputError, match=r"phasor_rate: 0 given; allowed: 0.01 to 100 1/s"):
        load_case(None, ["controllers.0.parameters.phasor_rate=0"])
    with pytest.raises(InputError, match=r"controllers\.0\.compensation: 'lead' given, which changes during the run"):
        delayed_loop(load_case(None, ["controllers.0.compensation=lead"]))
