"""Linear controllers of a user's own: forms and files, the law itself, lost frames, replay, bad input."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.io import savemat
from scipy.signal import cont2discrete, dlsim, tf2ss, tf2zpk

from facts_damping.case.loading import load_case, make_case
from facts_damping.control.linear_law import matrices
from facts_damping.parameters.linear_law import LinearLaw
from facts_damping.parameters.yaml_text import dump
from facts_damping.signals import CHANNELS
from facts_damping.simulation import loop
from tests.appendix_b import DEN, NUM, bilinear
from tests.commands import assert_one_line

if TYPE_CHECKING:
    from pathlib import Path

    from facts_damping.case.model import Case
    from facts_damping.record import Record

SPEED = list(CHANNELS).index("speed_deviation")


def weights(case: Case) -> dict[int, float]:
    """Of the signal `speed`, by the index of the PMU."""
    pmus = [pmu.name for pmu in case.system.pmus]
    return {pmus.index(name): weight for name, weight in case.system.signals["speed"].weights.items()}


def with_law(law: dict[str, Any] | str, *sets: str, name: str = "my_damper", **fields: Any) -> Record:
    controller = json.dumps({"name": name, "linear": law, **fields})
    return loop.run(load_case("two_area_large", ["duration=5", *sets, f"controllers.0={controller}"]))


def test_lead_lag_by_the_bilinear_transform_is_the_shipped_one() -> None:
    shipped = loop.run(load_case("two_area_large", ["duration=5"]))
    linear = with_law(bilinear())
    assert len(linear.issued) == len(shipped.issued) > 0
    assert linear.controller_names == ["controller_0_my_damper"]
    assert np.abs(linear.issued["value"] - shipped.issued["value"]).max() < 1e-9


def test_continuous_one_is_discretised_exactly() -> None:
    """Against SciPy: its setpoints, of the signal as it was delivered, up to the limits."""
    record = with_law({"num": (5.0 * np.array(NUM)).tolist(), "den": DEN}, "link=delay_100ms")
    case = load_case("two_area_large", [])
    signal = sum(
        weight * record.delivered[record.delivered["pmu"] == pmu]["values"][:, SPEED]
        for pmu, weight in weights(case).items()
    )
    A, B, C, D, dt = cont2discrete(tf2ss(5.0 * np.array(NUM), DEN), 1.0 / 60.0, method="zoh")
    _, wanted, _ = dlsim((A, B, C, D, dt), signal)
    limit = case.system.device("sssc").setpoint_max
    values = record.issued["value"]
    assert len(values) == len(wanted)
    assert np.abs(values - np.clip(wanted[:, 0], -limit, limit)).max() < 1e-10 * limit + 1e-9
    assert np.abs(values).max() == limit


def test_linear_law_is_the_same_in_all_forms_and_files(tmp_path: Path) -> None:
    A, B, C, D = tf2ss(NUM, DEN)
    zeros, poles, gain = tf2zpk(NUM, DEN)
    arrays = {"A": A, "B": B, "C": C, "D": D}
    np.savez(tmp_path / "law.npz", **arrays)
    savemat(tmp_path / "law.mat", arrays)
    savemat(tmp_path / "tf.mat", {"num": np.array(NUM), "den": np.array(DEN)})
    np.savez(tmp_path / "zpk.npz", zeros=zeros.astype(complex), poles=poles.astype(complex), gain=gain)
    (tmp_path / "law.yaml").write_text(dump({"num": NUM, "den": DEN}))
    wanted = with_law({"num": NUM, "den": DEN}).issued["value"]
    laws: list[dict[str, Any] | str] = [{name: values.tolist() for name, values in arrays.items()}]
    for law in laws + list(map(str, tmp_path.iterdir())):
        assert np.abs(with_law(law).issued["value"] - wanted).max() < 1e-9, law


def test_complex_zeros_and_poles_are_text() -> None:
    law = LinearLaw(zeros=[-0.5], poles=["-1+2j", "-1-2j"], gain=4.0)
    A, B, C, D = matrices(law, 1, 1)
    for s in (0.3j, 2.0 + 1.0j):
        value = (C @ np.linalg.solve(s * np.eye(2) - A, B) + D).item()
        assert value == pytest.approx(4.0 * (s + 0.5) / ((s + 1) ** 2 + 4))


def test_table_of_transfer_functions_has_a_row_a_device_and_a_column_a_signal() -> None:
    law = LinearLaw(num=[[[1.0], [2.0]], [[3.0, 0.0], [0.0]]], den=[[[1.0, 1.0], [1.0, 2.0]], [[1.0, 3.0], [1.0]]])
    A, B, C, D = matrices(law, 2, 2)
    s = 0.7j
    value = C @ np.linalg.solve(s * np.eye(len(A)) - A, B) + D
    assert value == pytest.approx(np.array([[1 / (s + 1), 2 / (s + 2)], [3 * s / (s + 3), 0.0]]))


def test_lost_frame_leaves_the_signal_as_it_was() -> None:
    """An integrator counts the frames that did not come with the newest signal before."""
    record = with_law(
        {"A": [[0.0]], "B": [[1.0]], "C": [[1.0]]}, "link={up: [{model: bernoulli, loss: 0.5}]}", "seed=3"
    )
    state, before, last = 0.0, 0.0, None
    of_signal = weights(load_case("two_area_large", []))
    held: dict[int, float] = {}
    wanted = []
    for tick in np.unique(record.delivered["tick"]):
        rows = record.delivered[record.delivered["tick"] == tick]
        rows = rows[np.isin(rows["pmu"], list(of_signal))]
        held |= {int(row["pmu"]): float(row["values"][SPEED]) for row in rows}
        if len(held) < len(of_signal) or not len(rows):
            continue
        value = sum(weight * held[pmu] for pmu, weight in of_signal.items())
        if last is not None:
            state += (tick - last) / 60.0 * before
        wanted.append(state)
        before, last = value, tick
    assert np.abs(record.issued["value"] - wanted).max() < 1e-12
    assert len(wanted) < len(record.ticks)


def test_recorded_run_holds_its_linear_law_without_the_file(tmp_path: Path) -> None:
    law = tmp_path / "law.npz"
    np.savez(law, num=np.array(NUM), den=np.array(DEN))
    first = with_law(str(law), "link=delay_100ms", compensation="lead")
    law.unlink()
    again = loop.run(make_case(json.loads(json.dumps(first.configuration)), "recording"))
    assert again.issued.tobytes() == first.issued.tobytes()
    assert again.frames.tobytes() == first.frames.tobytes()


@pytest.mark.parametrize(
    ("law", "message"),
    [
        (__file__, f"linear: {__file__} given; allowed: a law in a .yaml, .npz or .mat file"),
        ("nowhere.npz", "linear: nowhere.npz: no such file; allowed: a law in a .yaml, .npz or .mat file"),
        ({"num": [1], "den": [1, -1]}, "linear: a pole at 1 1/s given: unstable; allowed: stable controllers"),
        ({"num": [1, 0, 0], "den": [1, 1]}, "linear: num of degree 2 over den of degree 1 given: improper"),
        ({"num": [1]}, "num given; allowed: A, B, C (and D), or D alone; or num, den; or zeros, poles, gain"),
        ({}, "nothing given; allowed: A, B, C"),
        ({"num": [1], "den": [0]}, "linear: den: 0 given"),
        ({"num": [1], "den": [1], "zeros": []}, "num, den, zeros given; allowed:"),
        ({"A": [[-1]], "B": [[1, 2]], "C": [[1]]}, "linear: B: 1 x 2 given; allowed: 1 x 1, with 1 states"),
        ({"A": [[-1, 0], [0]], "B": [[1]], "C": [[1]]}, "linear: A: rows of 2, 1 numbers given"),
        ({"D": [[1], [2]]}, "linear: D: 2 x 1 given; allowed: 1 x 1"),
        ({"num": [[[1], [1]]], "den": [[[1], [1]]]}, "linear: 1 outputs and 2 inputs given; allowed: 1 and 1"),
        ({"num": [1], "den": [1, 1], "dt": 0.1}, "linear.dt: 0.1 s given; allowed: the frames' 0.0166666667 s"),
        ({"zeros": ["1+j2"], "poles": [-1], "gain": 1}, "linear: zeros: ['1+j2'] given; allowed: numbers"),
        ({"zeros": ["-1+2j"], "poles": [-1, -2], "gain": 1}, "allowed: complex ones in conjugate pairs"),
    ],
)
def test_bad_laws_are_one_line(law: Any, message: str, capsys: pytest.CaptureFixture[str]) -> None:
    controller = json.dumps({"name": "my_damper", "linear": law})
    assert_one_line(2, ["simulate", "--set", f"controllers.0={controller}"], message, capsys)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"name": "LLC"}, "controllers.0.name: 'LLC' given with `linear`; allowed: a name that is not taken"),
        ({"scheme": "direct"}, "controllers.0.scheme: 'direct' given; allowed: none for my_damper"),
        ({"compensation": "prediction"}, "controllers.0.compensation: 'prediction' given; allowed: none, lead, phasor"),
        ({"parameters": {"gain": 2}}, "gain"),
        ({"signals": ["speed", "power"]}, "linear: 1 outputs and 1 inputs given; allowed: 1 and 2"),
    ],
)
def test_options_that_do_not_fit_a_linear_law_are_refused_in_one_line(
    fields: dict[str, Any], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    controller = json.dumps({"name": "my_damper", "linear": {"num": [1], "den": [1, 1]}, **fields})
    assert_one_line(2, ["simulate", "--set", f"controllers.0={controller}"], message, capsys)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 no archive", b"MATLAB 5.0 MAT-file, cut"])
@pytest.mark.parametrize("suffix", [".npz", ".mat"])
def test_files_that_are_none_are_one_line(
    tmp_path: Path, content: bytes, suffix: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / f"law{suffix}"
    path.write_bytes(content)
    controller = json.dumps({"name": "my_damper", "linear": str(path)})
    assert_one_line(2, ["simulate", "--set", f"controllers.0={controller}"], f"{path}: cannot be read: ", capsys)


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"num": [1.0], "gian": [1.0]}, "'gian' given; allowed: arrays A, B, C, D"),
        ({"num": ["1"], "den": [1.0]}, "num: no numbers given; allowed: real matrices, and complex zeros and poles"),
        ({"zeros": [1.0], "poles": [1.0], "gain": [1.0, 2.0]}, "gain: 2 numbers given; allowed: one"),
        ({"A": [[1j]], "B": [[1.0]], "C": [[1.0]]}, "A: complex numbers given; allowed: real ones"),
    ],
)
def test_arrays_that_are_no_law_are_one_line(
    tmp_path: Path, arrays: dict[str, Any], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    np.savez(tmp_path / "law.npz", **arrays)
    controller = json.dumps({"name": "my_damper", "linear": str(tmp_path / "law.npz")})
    assert_one_line(2, ["simulate", "--set", f"controllers.0={controller}"], f"law.npz: {message}", capsys)
