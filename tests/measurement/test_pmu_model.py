"""PMUs against an independent one that samples three phases, and what noise, clocks and bad data do to frames."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facts_damping.analysis.summary import summarise
from facts_damping.case.loading import load_case
from facts_damping.case.measurement import numbers, with_number
from facts_damping.errors import InputError
from facts_damping.measurement.build import make_pmus
from facts_damping.measurement.filters import M_CLASS, reference_filter
from facts_damping.measurement.pmu_model import FREQUENCY, IA, IM, ROCOF, SPEED, UNSYNCHRONISED, VA, VM, P, Q
from facts_damping.parameters.measurement import Measurement
from facts_damping.signals import NANOSECONDS, NEVER
from facts_damping.simulation import loop
from facts_damping.small_signal.linearisation import linear_model
from facts_damping_studies.margins.linear_closed_loop import delayed_loop, eigen, sampled
from facts_damping_validation.pmus import CLASSES, reported

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from facts_damping.record import Record

RATE, F0 = 60, 60.0
DATA_ERROR = 32768
# IEEE/IEC 60255-118-1, annex D, at 16 samples a cycle: weights, in the annex's own words (D.5, D.7).
SAMPLES = 960


def annex_weights(name: str) -> NDArray[np.float64]:
    if name == "p_class":
        N = (16 - 1) * 2
        k = np.arange(-N // 2, N // 2 + 1)
        return np.asarray(1.0 - 2.0 / (N + 2) * np.abs(k))
    Ffr, N = 8.19, 164
    k = np.arange(-N // 2, N // 2 + 1)
    angle = 2.0 * np.pi * 2.0 * Ffr / SAMPLES * k
    ratio = np.ones(len(k))
    ratio[k != 0] = np.sin(angle[k != 0]) / angle[k != 0]
    return np.asarray(ratio * np.hamming(N + 1))


def annex(name: str, magnitude: Any, angle: Any, seconds: float) -> tuple[Any, ...]:
    """Frames by the annex's own steps: three phases sampled, each demodulated and filtered, positive sequence."""
    t = np.arange(-SAMPLES, round(seconds * SAMPLES) + SAMPLES) / SAMPLES
    W = annex_weights(name)
    phases = []
    for phase in range(3):
        x = np.sqrt(2.0) * magnitude(t) * np.cos(2 * np.pi * F0 * t + angle(t) - phase * 2 * np.pi / 3)
        demodulated = np.sqrt(2.0) * x * np.exp(-2j * np.pi * F0 * t)
        phases.append(np.convolve(demodulated, W, "same") / W.sum())
    a = np.exp(2j * np.pi / 3)
    X = (phases[0] + a * phases[1] + a * a * phases[2]) / 3.0
    theta = np.unwrap(np.angle(X))
    deviation = (theta[2:] - theta[:-2]) * SAMPLES / (4 * np.pi)
    rocof = (theta[2:] - 2 * theta[1:-1] + theta[:-2]) * SAMPLES**2 / (2 * np.pi)
    X = X[1:-1]
    if name == "p_class":
        X = X / np.sin(np.pi * (F0 + 1.625 * deviation) / (2 * F0))
    first = SAMPLES - 1  # at t = 0
    frames = slice(first, first + round(seconds * SAMPLES), SAMPLES // RATE)
    return X[frames], F0 + deviation[frames], rocof[frames]


@pytest.mark.parametrize("name", CLASSES)
@settings(deadline=None, max_examples=15)
@given(
    f=st.floats(0.1, 3.0),
    depth=st.floats(0.0, 0.1),
    swing=st.floats(0.0, 1.0),
    off=st.floats(-1.5, 1.5),
    phase=st.floats(-3.0, 3.0),
)
def test_frames_are_those_of_a_pmu_that_samples_three_phases(
    name: str, f: float, depth: float, swing: float, off: float, phase: float
) -> None:
    """A swing of magnitude and angle at a frequency off nominal; at half the annex's rate of samples."""
    w = 2 * np.pi * f

    def magnitude(t: Any) -> Any:
        return 1.0 + depth * np.sin(w * t + phase)

    def angle(t: Any) -> Any:
        return phase + 2 * np.pi * off * t + swing * np.sin(w * t)

    reports = reported(name, lambda t: (float(magnitude(t)), float(angle(t))), 1.5)
    X, frequency, rocof = annex(name, magnitude, angle, 1.5)
    settled = slice(15, len(reports.time))  # the first windows reach back before the start, when the signal stood still
    assert np.abs(reports.phasor[settled] - X[15 : len(reports.time)]).max() < 5e-4
    assert np.abs(reports.frequency[settled] - frequency[15 : len(reports.time)]).max() < 5e-4 * (1 + swing * f)
    assert np.abs(reports.rocof[settled] - rocof[15 : len(reports.time)]).max() < 5e-3 * (1 + swing * w * w)


@pytest.mark.parametrize(("nominal", "rate"), [(f, rate) for f, rows in M_CLASS.items() for rate in rows])
def test_filters_weigh_one_and_are_there_when_all_samples_are(nominal: float, rate: int) -> None:
    for name in ("p_class", "m_class"):
        filter_used = reference_filter(Measurement(filter=name), nominal, rate)
        assert filter_used.weights[0] + 2 * filter_used.weights[1:].sum() == pytest.approx(1.0, abs=1e-12)
        assert filter_used.per_frame * rate >= 480
        samples = filter_used.delay * filter_used.per_frame
        assert filter_used.side + 1 <= samples < filter_used.side + 1 + filter_used.per_frame
        assert filter_used.delay <= (7 if name == "m_class" else max(2, 2 * rate / nominal))


def still(measurement: dict[str, Any], ticks: int = 4000, seed: int = 0) -> tuple[Any, Any, Any]:
    """Frames of two PMUs whose phasors stand: V = 1.02 at 0.5 rad, I = 4 at 0.1 rad."""
    from facts_damping.measurement.pmu_model import report  # noqa: PLC0415 (the compiled function, beside its tables)

    m, state = make_pmus(Measurement.model_validate(measurement), ["A", "B"], F0, RATE, ticks, seed)
    phasors = np.array([[1.02 * np.exp(0.5j), 4.0 * np.exp(0.1j)]] * 2)
    exact = np.array([1.02, 0.5, 0.001, 4.08 * np.cos(0.4), 4.08 * np.sin(0.4), 60.06, np.nan, 4.0, 0.1])
    frames, stamps, status = np.zeros((ticks, 2, 9)), np.zeros((ticks, 2), np.int64), np.zeros((ticks, 2), np.int64)
    for k in range(ticks):
        frames[k] = exact
        report(m, state, k, phasors, frames[k], stamps[k], status[k])
    return frames, stamps, status


def test_noise_is_normal_white_and_each_station_s_own() -> None:
    noise = {"magnitude": 0.002, "angle": 0.003, "frequency": 0.004, "rocof": 0.05}
    frames, _, _ = still({"noise": noise})
    values_seen = frames[:, :, [VM, IM, VA, IA, FREQUENCY]]
    wanted = np.array([1.02 * 0.002, 4.0 * 0.002, 0.003, 0.003, 0.004])
    n = len(values_seen)
    assert (np.abs(values_seen.std(axis=0) / wanted - 1.0) < 4.0 / np.sqrt(2 * n)).all()
    assert (np.abs(values_seen.mean(axis=0) - [1.02, 4.0, 0.5, 0.1, 60.06]) < 4.0 * wanted / np.sqrt(n)).all()
    apart = values_seen.reshape(n, -1)
    apart = (apart - apart.mean(axis=0)) / apart.std(axis=0)
    pairs = apart.T @ apart / n - np.eye(apart.shape[1])
    assert np.abs(pairs).max() < 4.5 / np.sqrt(n)
    assert np.abs((apart[1:] * apart[:-1]).mean(axis=0)).max() < 4.0 / np.sqrt(n)
    again, other = still({"noise": noise})[0], still({"noise": noise}, seed=1)[0]
    assert again.tobytes() == frames.tobytes()
    assert not (other[:, 0, VM] == frames[:, 0, VM]).any()
    assert np.allclose(frames[..., SPEED] - 0.001, (frames[..., FREQUENCY] - 60.06) / F0, atol=1e-12)


def test_longer_run_begins_as_a_shorter_one() -> None:
    measurement = {"noise": {"angle": 0.001}, "bad_data": [{"kind": "spike", "probability": 0.1}]}
    longer, shorter = still(measurement, 300)[0], still(measurement, 200)[0]
    assert longer[:200].tobytes() == shorter.tobytes()


def test_wrong_clock_moves_stamp_and_angle() -> None:
    clock = {"offset": 1e-4, "lost": 1.0, "drift": 1e-5}
    frames, stamps, status = still({"pmus": {"A": {"clock": clock}}}, 240)
    t = np.arange(240) / RATE
    error = 1e-4 + 1e-5 * np.maximum(0.0, t - 1.0)
    assert np.abs(stamps[:, 0] / NANOSECONDS - t - error).max() < 2e-9
    assert np.abs(frames[:, 0, VA] - 0.5 + 2 * np.pi * F0 * error).max() < 1e-9
    assert np.abs(frames[:, 0, IA] - 0.1 + 2 * np.pi * F0 * error).max() < 1e-9
    assert np.allclose(frames[:, 0, FREQUENCY], np.where(t >= 1.0, 60.06 / (1 + 1e-5), 60.06), rtol=1e-12)
    assert status[:, 0].tolist() == np.where(t >= 1.0, UNSYNCHRONISED, 0).tolist()
    assert (stamps[:, 1] == np.arange(240) * NANOSECONDS // RATE).all()
    assert (frames[:, 1, VA] == 0.5).all()
    assert np.abs(frames[:, 0, P] - 4.08 * np.cos(0.4)).max() < 1e-12  # both angles move alike


def test_integers_of_16_bits() -> None:
    frames, _, _ = still({"quantisation": "int16", "noise": {"angle": 0.01, "frequency": 0.1, "rocof": 1.0}}, 200)
    for column, step, origin in (
        (VA, 1e-4, 0),
        (IA, 1e-4, 0),
        (FREQUENCY, 1e-3, F0),
        (VM, 2 / 65535, 0),
        (IM, 40 / 65535, 0),
    ):
        counts = (frames[..., column] - origin) / step
        assert np.abs(counts - np.round(counts)).max() < 1e-6
    assert np.isnan(frames[..., ROCOF]).all()  # ideal PMUs have none
    size = frames[..., VM] * frames[..., IM]
    assert np.allclose(frames[..., P] ** 2 + frames[..., Q] ** 2, size**2)


def bad(kind: str, **more: Any) -> tuple[Any, Any, Any]:
    row = {"kind": kind, "pmus": ["A"], "start": 1.0, "duration": 1.0, **more}
    return still({"noise": {"angle": 1e-4}, "bad_data": [row]}, 180)


def test_bad_data_are_of_their_stations_and_times() -> None:
    whole = still({"noise": {"angle": 1e-4}}, 180)[0]
    wrong = slice(60, 120)
    for kind in ("stuck", "spike", "wrong_sign", "swapped_phases", "invalid"):
        frames, _, status = bad(kind)
        others = np.ones((180, 2), np.bool_)
        others[wrong, 0] = False
        assert frames[others].tobytes() == whole[others].tobytes(), kind
        assert status[:, 1].tolist() == [0] * 180
        assert status[wrong, 0].tolist() == [DATA_ERROR if kind == "invalid" else 0] * 60
    assert (bad("stuck")[0][wrong, 0] == whole[60, 0])[:, [VM, VA, FREQUENCY]].all()
    assert np.isnan(bad("invalid")[0][wrong, 0]).all()
    assert np.abs(bad("wrong_sign")[0][wrong, 0, P] + whole[wrong, 0, P]).max() < 1e-9
    assert (bad("swapped_phases")[0][wrong, 0, VM] == 0.0).all()
    spikes = bad("spike", probability=0.3, size=0.5)[0][wrong, 0, VM] / whole[wrong, 0, VM]
    assert set(np.round(spikes, 12).tolist()) == {1.0, 1.5}
    assert 5 <= np.sum(spikes > 1.2) <= 35


def record_of(*sets: str) -> Record:
    return loop.run(load_case(None, ["controllers.0.signals=[frequency]", *sets]))


def test_ideal_frequency_is_the_turning_of_the_voltage() -> None:
    """Between events and setpoints; by differences of a run without controllers, 480 frames/s."""
    record = loop.run(load_case(None, ["controllers=[]", "frame_rate=480", "duration=3", "scenario=large"]))
    angle = np.unwrap(record.frames[:, :, VA], axis=0)
    turning = 60.0 + (angle[2:] - angle[:-2]) * 480 / (4 * np.pi)
    quiet = (record.time_s[1:-1] < 0.99) | (record.time_s[1:-1] > 1.2)
    assert np.abs(record.frames[1:-1, :, FREQUENCY] - turning)[quiet].max() < 2e-4
    assert np.abs(record.frames[1:-1, :, FREQUENCY] - 60.0).max() > 0.05
    assert np.isnan(record.frames[..., ROCOF]).all()


@pytest.mark.parametrize(("name", "frames"), [("p_class", 1), ("m_class", 6)])
def test_frames_come_late_by_their_class_and_tell_of_the_plant_as_it_was(name: str, frames: int) -> None:
    record = record_of(f"measurement={name}", "measurement.noise={}", "duration=5")
    assert (record.measured_ns[:frames] == NEVER).all()
    assert np.isnan(record.frames[:frames]).all()
    assert (record.measured_ns[frames:] == record.time_ns[:-frames, None]).all()
    assert (record.issued["issued_ns"] - record.issued["measured_ns"]).min() >= record.time_ns[frames] - 1
    assert np.isnan(record.frames[..., SPEED]).all()
    true = record.machines["speed_deviation"][:-frames]
    # A bus near a machine turns nearly as its rotor, filtered and late.
    measured = record.frames[frames:, :4, FREQUENCY] / 60.0 - 1.0
    assert np.abs(measured - true)[120:].max() < 0.1 * np.abs(true).max()


@pytest.mark.parametrize("name", ["p_class", "m_class"])
def test_linear_loop_knows_the_filter(name: str) -> None:
    """The mode of a ringdown, and that of the closed loop from frame to frame: with a delay beside."""
    pulse = [{"time": t, "kind": "load_step", "load": "load_1", "change": by} for t, by in ((1.0, 0.001), (1.1, 0.0))]
    sets = ["controllers.0.signals=[frequency]", f"measurement={name}", "measurement.noise={}", "link.up.0.delay=0.03"]
    case = load_case(None, [*sets, f"scenario={json.dumps(pulse)}"])
    linear = eigen(delayed_loop(case), sampled(delayed_loop(case), 0.03))
    swings = [s for s in linear.values if 3.5 < s.imag < 4.6]
    (mode, *_) = summarise(loop.run(case)).modes
    assert mode.frequency_hz == pytest.approx(swings[0].imag / (2 * np.pi), abs=5e-4)
    assert mode.damping_ratio == pytest.approx(-swings[0].real / abs(swings[0]), abs=5e-4)


def test_filter_s_gain_is_its_delay_and_little_else_at_swings() -> None:
    case = load_case(None, ["measurement=m_class", "controllers=[]"])
    from facts_damping.plant.build import build  # noqa: PLC0415 (for this test alone)

    pmus = [s.name for s in case.system.pmus]
    built = build(case.system, case.run.devices, [])
    model, exact = (
        linear_model(built, case.system.signals, pmus, pmu_filter, RATE) for pmu_filter in (case.filter, None)
    )
    s = 2j * np.pi * 0.65
    for i, name in enumerate(case.system.signals):
        ratio = model.response(s)[i, 0] / exact.response(s)[i, 0] * np.exp(s * 0.1)
        if case.system.signals[name].channel == "frequency":
            continue  # the exact one leaves out what a setpoint's jump does to the angle
        assert abs(ratio - 1.0) < 2e-3, name


@pytest.mark.parametrize(
    ("sets", "message"),
    [
        (
            ["measurement=q_class"],
            "measurement: 'q_class' given (did you mean p_class?); allowed: ideal, m_class, p_class",
        ),
        (["measurement=p_class"], "'speed' given, a signal of speed_deviation, which PMUs do not report"),
        (["measurement=m_class", "frame_rate=40"], "frame_rate: 40 given at a nominal frequency of 60 Hz; allowed"),
        (["measurement.noise.angle=-1"], "measurement.noise.angle"),
        (["measurement.clock.drift=1e-6"], "drift: 1e-06 given without `lost`"),
        (["measurement.pmus={G9: {}}"], "'G9' given; allowed: G1, G2, G3, G4, TIE"),
        (["measurement.bad_data=[{kind: stuck, pmus: [X]}]"], "'X' given; allowed: G1"),
        (["measurement.bad_data=[{kind: stuck, size: 2.0}]"], "size: given for stuck; allowed: for spike only"),
        (["measurement.bad_data=[{kind: odd}]"], "'odd' given; allowed"),
    ],
)
def test_invalid_measurement_is_refused_in_one_line(sets: list[str], message: str) -> None:
    with pytest.raises(InputError) as error:
        load_case(None, sets)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_numbers_that_may_change_are_those_of_what_is_there() -> None:
    case = load_case(None, ["measurement.pmus={G1: {clock: {lost: 1.0}}}", "measurement.bad_data=[{kind: spike}]"])
    by_path = numbers(case.measurement)
    assert {"noise.angle", "clock.offset", "pmus.G1.clock.drift", "bad_data.0.size"} <= set(by_path)
    assert not any(name.endswith((".start", ".lost")) for name in by_path)
    changed = with_number(case.measurement, "pmus.G1.clock.drift", 1e-6)
    assert changed.pmus["G1"].clock is not None
    assert changed.pmus["G1"].clock.drift == 1e-6
    with pytest.raises(InputError):
        with_number(case.measurement, "noise.angle", -1.0)


@pytest.mark.parametrize("offset", [2e-5, -2e-5, 0.5, -0.5])
def test_wrong_clock_loses_no_frames(offset: float) -> None:
    """Those with stamps before the start are absent, and were never sent."""
    record = record_of(f"measurement.clock.offset={offset}", "duration=2")
    assert (record.measured_ns >= 0).all()
    assert (record.measured_ns != NEVER).sum() == len(record.delivered)
    assert summarise(record).frames_lost == 0


def test_behind_a_filter_a_fault_is_no_low_voltage_without_one() -> None:
    sets = ["controllers=[]", "duration=2", "scenario=large"]
    for more in ("measurement=p_class", "measurement=m_class", "measurement.bad_data=[{kind: swapped_phases}]"):
        warnings = summarise(loop.run(load_case(None, [*sets, more]))).warnings
        assert not any("without a fault" in line for line in warnings), warnings


def test_run_with_pmus_is_the_same_again(assert_alike: Callable[[Record, Record], None]) -> None:
    sets = ["measurement=m_class", "duration=3"]
    assert_alike(record_of(*sets), record_of(*sets))


@pytest.fixture
def assert_alike() -> Callable[[Any, Any], None]:
    def check(first: Any, second: Any) -> None:
        for name in ("frames", "measured_ns", "status", "delivered", "issued", "applied", "machines"):
            assert getattr(first, name).tobytes() == getattr(second, name).tobytes()

    return check
