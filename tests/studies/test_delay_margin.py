"""The delay margin: against the Nyquist crossing, Pade terms, brute force, earlier figures and the time domain."""

from __future__ import annotations

import json
from functools import cache
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.simulation import loop
from facts_damping.small_signal.linearisation import LinearModel
from facts_damping_studies.margins import delay_margin_runs
from facts_damping_studies.margins.criteria import CRITERIA
from facts_damping_studies.margins.delay_margin import Margin, first_limit, intervals, margin
from facts_damping_studies.margins.delay_margin_pages import document, margin_text, plot
from facts_damping_studies.margins.delay_margin_runs import HORIZONS, bears, beside, holding, pulse_margin, pulsed
from facts_damping_studies.margins.halved_steps import halvings
from facts_damping_studies.margins.linear_closed_loop import (
    DelayedLoop,
    Discrete,
    approximate,
    delayed_loop,
    eigen,
    sampled,
)
from tests.appendix_b import bilinear, lead_lag

if TYPE_CHECKING:
    from collections.abc import Callable

FRAME = 1.0 / 60.0
LONGEST = 0.4
# Computed before by a separate program: damping ratios without delay, at 100 and 200 ms in continuous time; margin, s.
EARLIER = {"w13": ((0.036, 0.022, 0.002), 0.21), "speed": ((0.038, 0.019, -0.005), 0.177)}
HELD = 0.168  # s, of `speed` with the hold of 60 frames/s


def table(columns: int) -> list[list[str]]:
    """Rows of so many cells of the page's tables."""
    page = (Path(__file__).parents[2] / "docs" / "delay.md").read_text(encoding="utf-8").splitlines()
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in page if line.startswith("|")]
    return [row for row in cells if len(row) == columns]


def nothing(_done: int, _of: int) -> None:
    pass


@cache
def margin_of(signal: str) -> Margin:
    return margin(load_case(None, [f"controllers.0.signals=[{signal}]"]), LONGEST, 6, nothing)


def limit(loop_margin: Margin) -> float:
    assert loop_margin.margin is not None
    return loop_margin.margin


@cache
def crossing(signal: str, gain: float = 10.0, system: str = "two_area") -> float:
    """Smallest delay at which K(iw) exp(-iw tau) G(iw) is 1, s: the Nyquist curve of the continuous loop at 1."""
    sets = [f"system={system}", "scenario=[]", "duration=1", f"controllers.0.signals=[{signal}]"]
    model = delayed_loop(load_case(None, sets)).model
    at = list(load_case(None, sets).system.signals).index(signal)

    def opened(w: float) -> complex:
        return complex(lead_lag(1j * w, gain) * model.response(1j * w)[at, 0])

    w = np.linspace(0.5, 60, 4_000)
    size = np.array([abs(opened(frequency)) for frequency in w]) - 1
    delays = []
    for i in np.flatnonzero(size[1:] * size[:-1] < 0):
        w0 = w[i] + (w[i + 1] - w[i]) * size[i] / (size[i] - size[i + 1])
        delays.append(np.angle(opened(w0)) % (2 * np.pi) / w0)
    return float(min(delays))


@pytest.mark.parametrize("signal", EARLIER)
def test_margin_in_continuous_time_is_the_nyquist_crossing(signal: str) -> None:
    """Pade terms of order 6 without a hold: to 0.1 ms."""
    assert margin_of(signal).pade["continuous"] == pytest.approx(crossing(signal), abs=1e-4)


@pytest.mark.parametrize("signal", EARLIER)
def test_sampled_margin_is_half_a_frame_shorter(signal: str) -> None:
    """Of the exact one in continuous time, and by Pade terms: to 0.2 ms."""
    assert limit(margin_of(signal)) == pytest.approx(crossing(signal) - FRAME / 2, abs=2e-4)
    assert limit(margin_of(signal)) == pytest.approx(margin_of(signal).pade["held"], abs=2e-4)


@pytest.mark.parametrize("rate", [25, 120])
def test_half_a_frame_at_other_rates(rate: int) -> None:
    loop_margin = margin(load_case(None, [f"frame_rate={rate}"]), 0.25, None, nothing)
    assert limit(loop_margin) == pytest.approx(crossing("speed") - 0.5 / rate, abs=1e-3)


def test_smib_against_the_crossing() -> None:
    loop_margin = margin(load_case(None, ["system=smib", "scenario=nominal"]), LONGEST, 6, nothing)
    assert limit(loop_margin) == pytest.approx(crossing("speed", system="smib") - FRAME / 2, abs=2e-4)


@pytest.mark.parametrize("signal", EARLIER)
def test_figures_computed_before(signal: str) -> None:
    """Damping ratios and margin of the continuous loop, to a unit in the last digit given."""
    ratios, longest = EARLIER[signal]
    loop = delayed_loop(load_case(None, [f"controllers.0.signals=[{signal}]"]))
    for delay, ratio in zip((0.0, 0.1, 0.2), ratios, strict=True):
        values = eigen(loop, approximate(loop, delay, 6, 0.0), discrete=False).values
        (swing,) = values[(values.imag > 3.8) & (values.imag < 4.5) & (values.real > -1)]
        assert -swing.real / abs(swing) == pytest.approx(ratio, abs=1e-3)
    assert margin_of(signal).pade["continuous"] == pytest.approx(longest, abs=5e-3 if signal == "w13" else 1e-3)
    if signal == "speed":
        assert limit(margin_of(signal)) == pytest.approx(HELD, abs=1e-3)


def test_tracks_begin_with_the_electromechanical_modes_and_one_crosses_at_the_margin() -> None:
    loop_margin = margin_of("speed")
    assert [track.label for track in loop_margin.tracks[:3]] == ["interarea", "local", "local"]
    for track in loop_margin.tracks[:3]:
        values = np.array([mode.eigenvalue for mode in track.modes if mode is not None])
        assert len(values) == len(loop_margin.delays)
        assert np.abs(np.diff(values)).max() < 0.1  # no jump to another mode
    assert loop_margin.critical is not None
    assert abs(loop_margin.critical.eigenvalue.real) < 1e-4
    crossing_ = [
        t.label
        for t in loop_margin.tracks
        if (r := [m.eigenvalue.real for m in t.modes if m is not None])[0] < 0 < max(r)
    ]
    assert crossing_ == ["interarea"]


def oscillator(w: float, ratio: float, gain: float, rate: int = 60) -> DelayedLoop:
    """A mass on a spring, u = -gain times its speed."""
    model = LinearModel(
        np.array([[0.0, 1.0], [-(w**2), -2 * ratio * w]]),
        np.array([[0.0], [1.0]]),
        np.array([[0.0, 1.0]]),
        np.zeros((1, 1)),
        np.zeros(1),
    )
    proportional = Discrete(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[-gain]]), [0], [0])
    return DelayedLoop(model, [proportional], rate, ["x", "v"], np.zeros((2, 0)), halvings(model.A, model.B, 1 / rate))


def spans(loop: DelayedLoop, longest: float) -> list[tuple[float, float]]:
    delays = np.linspace(0, longest, round(longest / 0.005) + 1)

    def growth(delay: float) -> float:
        return eigen(loop, sampled(loop, delay)).growth

    return intervals(growth, delays, np.array([growth(float(delay)) for delay in delays]))


def test_stability_that_comes_back_is_told() -> None:
    """A damped oscillator with delayed damping: limits where -g i w exp(-i w tau) = w0^2 - w^2 + 2 i r w0 w."""
    w0, ratio, gain, rate = 6.0, 0.02, 0.6, 30
    loop = oscillator(w0, ratio, gain, rate)
    grid = np.linspace(3, 12, 200_001)
    opened = -gain * 1j * grid / (w0**2 - grid**2 + 2j * ratio * w0 * grid)
    at = np.flatnonzero(np.diff(np.abs(opened) > 1))
    assert len(at) == 2
    turns = [np.angle(opened[i]) % (2 * np.pi) / grid[i] + 2 * np.pi * np.arange(3) / grid[i] for i in at]
    limits = np.sort(np.concatenate(turns)) - 0.5 / rate
    expected = [t for t in limits if 0 < t < 1.5]
    assert len(expected) >= 3
    given_ = [end for span in spans(loop, 1.5) for end in span if 0 < end < 1.5]
    np.testing.assert_allclose(given_, expected, rtol=0, atol=2e-3)


@settings(deadline=None, max_examples=8)
@given(w=st.floats(3, 8), ratio=st.floats(-0.03, 0.03), gain=st.floats(0.5, 3))
def test_margin_is_where_a_simulation_begins_to_grow(w: float, ratio: float, gain: float) -> None:
    """Frame by frame by hand with the oscillator's closed form, a little below the margin and a little above."""
    loop = oscillator(w, ratio, gain)
    found_ = first_limit(spans(loop, 0.6), 0.6)
    assume(found_ is not None and found_ > 0.01)
    assert found_ is not None
    below, above = (simulated_growth(w, ratio, gain, found_ + step) for step in (-0.004, 0.004))
    assert below < 0 < above


def simulated_growth(w: float, ratio: float, gain: float, delay: float) -> float:
    """Growth of the energy over the second half of 60 s, 1/s; setpoints take effect at their own instants."""
    wd = w * np.sqrt(1 - ratio**2)

    def move(state: tuple[float, float], u: float, t: float) -> tuple[float, float]:
        x, v = state[0] - u / w**2, state[1]
        c, s, fade = np.cos(wd * t), np.sin(wd * t), np.exp(-ratio * w * t)
        slope = (v + ratio * w * x) / wd
        moved = fade * (x * c + slope * s)
        speed = fade * (slope * wd * c - x * wd * s) - ratio * w * moved
        return moved + u / w**2, speed

    state, u, frames, rest = (1.0, 0.0), 0.0, *divmod(delay, FRAME)
    sent: list[float] = []
    energy = []
    for k in range(3600):
        sent.append(-gain * state[1])
        new = sent[k - int(frames)] if k >= frames else 0.0
        state = move(move(state, u, rest), new, FRAME - rest)
        u = new
        energy.append(state[1] ** 2 + w**2 * state[0] ** 2)
    late = [np.log(np.mean(energy[i : i + 600])) for i in (1800, 3000)]
    return float((late[1] - late[0]) / 20)


def test_limits_of_a_curve() -> None:
    delays = np.linspace(0, 1, 101)

    def wave(t: float) -> float:
        return float(np.sin(2 * np.pi * (t - 0.3) / 0.5))

    ends = intervals(wave, delays, np.array([wave(t) for t in delays]))
    np.testing.assert_allclose(ends, [(0.05, 0.3), (0.55, 0.8)], atol=1e-5)
    assert first_limit(ends, 1.0) == 0.0
    assert first_limit([(0.0, 0.3), (0.5, 1.0)], 1.0) == 0.3
    assert first_limit([(0.0, 1.0)], 1.0) is None
    assert first_limit([], 1.0) == 0.0


def test_small_pulse_of_the_nonlinear_loop_has_the_linear_margin() -> None:
    """0.01 % of a load for half a second; the envelope of 40 s grows or dies: within 3 ms, where 10 are allowed."""
    loop_margin = margin_of("speed")
    assert pulse_margin(loop_margin.case, limit(loop_margin)) == pytest.approx(limit(loop_margin), abs=3e-3)


def in_scenarios() -> list[tuple[str, str, float, float]]:
    """Scenario, criterion, horizon, s, and delay, s, of the page's table."""
    heads, *rows = [row for row in table(6) if row[0].strip("`") in ("scenario", "small", "large", "multiple")]
    columns = [head.removesuffix(" s").rpartition(", ")[::2] for head in heads[1:]]
    return [
        (row[0].strip("`"), criterion, float(horizon), float(delay) / 1e3)
        for row in rows
        for (criterion, horizon), delay in zip(columns, row[1:], strict=True)
    ]


@pytest.mark.parametrize(("scenario", "holds", "horizon", "delay"), in_scenarios())
def test_margins_of_scenarios_are_those_of_the_page(scenario: str, holds: str, horizon: float, delay: float) -> None:
    """Each by its criterion and horizon: 3 ms below the run meets it, 3 ms above it does not."""
    (criterion,) = [name for name, row in CRITERIA.items() if row.holds == holds]
    case = load_case(None, [f"scenario={scenario}"])
    assert bears(case, delay - 0.003)[criterion, horizon]
    assert not bears(case, delay + 0.003)[criterion, horizon]


def test_linear_figures_are_those_of_the_page() -> None:
    rows = [row for row in table(6) if row[1].startswith(("continuous", "sampled"))]
    assert len(rows) == 4
    for signal, (continuous, sampled_) in zip(("w13", "speed"), (rows[:2], rows[2:]), strict=True):
        loop_margin = margin_of(signal)
        assert f"{1e3 * (loop_margin.pade['continuous'] or 0.0):.1f} ms" == continuous[-1]
        assert f"{1e3 * limit(loop_margin):.1f} ms" == sampled_[-1]
        for delay, ratio in zip((0.0, 0.1, 0.2), sampled_[2:5], strict=True):
            mode = loop_margin.tracks[0].modes[int(np.argmin(np.abs(loop_margin.delays - delay)))]
            assert mode is not None
            assert f"{mode.damping_ratio:.4f}" == ratio


def test_edges_of_a_scenario_lie_between_two_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(delay_margin_runs, "CLOSE", 5e-3)
    case = load_case(None, ["scenario=large"])
    found_ = holding(case, 0.22, lambda: None)
    assert [(holding_row.criterion, holding_row.horizon) for holding_row in found_] == list(
        product(CRITERIA, HORIZONS)
    )[:6]
    for holding_row in found_:
        (first, *_) = holding_row.holds
        assert first[0] == 0.0
        assert bears(case, first[1] - 4e-3)[holding_row.criterion, holding_row.horizon]
        assert not bears(case, first[1] + 4e-3)[holding_row.criterion, holding_row.horizon]
    in_synchronism = [other_row for other_row in holding(case, 0.04, lambda: None) if other_row.criterion == "unstable"]
    assert all(interval.holds == [[0.0, 0.04]] for interval in in_synchronism)


def test_ringdown_of_runs_is_that_of_the_linear_modes() -> None:
    """At each delay looked at: frequency to 0.2 %, damping ratio to 1e-3 of the interarea mode."""
    case = load_case(None, ["scenario=[]", "duration=20"])
    loop_margin = margin(case, 0.2, None, nothing)
    said = beside(loop_margin, nothing)
    assert said.scenario == []
    assert len(said.ringdown) >= 5
    for delay, modes in said.ringdown:
        mode = loop_margin.tracks[0].modes[int(np.argmin(np.abs(loop_margin.delays - delay)))]
        assert mode is not None
        strongest = min(modes, key=lambda m, mode=mode: abs(m.frequency_hz - mode.frequency_hz))  # type: ignore[misc]
        assert strongest.frequency_hz == pytest.approx(mode.frequency_hz, rel=2e-3)
        assert strongest.damping_ratio == pytest.approx(mode.damping_ratio, abs=1e-3)


@pytest.fixture
def inside(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    def run(*arguments: str) -> tuple[int, str, str]:
        status = main(["margin", *arguments])
        return status, *capsys.readouterr()

    return run


def test_command_gives_json_alone(inside: Callable[..., tuple[int, str, str]]) -> None:
    status, out, err = inside("two_area_small", "--max-delay", "0.25", "--pade", "4", "--json", "-")
    assert (status, err) == (0, "")
    document_read = json.loads(out)
    assert document_read["margin_s"] == pytest.approx(limit(margin_of("speed")), abs=1e-5)
    assert document_read["stable_s"] == [[0.0, document_read["margin_s"]]]
    assert set(document_read["pade_s"]) == {"held", "continuous"}
    assert document_read["run"]["scenario"] == "small"
    assert {0.0, 0.005, 0.25} <= {row["delay_s"] for row in document_read["delays"]}
    assert {m["label"] for m in document_read["delays"][0]["modes"]} == {"interarea", "local"}
    assert "time_domain" not in document_read


def test_command_gives_what_runs_say(inside: Callable[..., tuple[int, str, str]], tmp_path: Path) -> None:
    target = tmp_path / "found.json"
    status, out, err = inside("two_area_large", "--max-delay", "0.2", "--time-domain", "--json", str(target))
    assert (status, err) == (0, "")
    document_read = json.loads(target.read_text())["time_domain"]
    assert document_read["pulse_s"] == pytest.approx(limit(margin_of("speed")), abs=3e-3)
    assert {(row["criterion"], row["horizon_s"]) for row in document_read["scenario"]} == {
        (criterion, horizon) for criterion in ("unstable", "not_damped", "damping") for horizon in (20.0, 40.0)
    }
    assert [row["delay_s"] for row in document_read["ringdown"]] == [0.0, 0.04, 0.08, 0.12, 0.16, 0.2]
    assert all(row["modes"] for row in document_read["ringdown"])
    assert "a pulse of 0.01 %" in out
    assert "large, damped over 40 s" in out


def test_command_writes_a_picture_and_a_table(inside: Callable[..., tuple[int, str, str]], tmp_path: Path) -> None:
    status, out, err = inside("two_area_small", "--max-delay", "0.2", "--out", str(tmp_path / "new"))
    assert (status, err) == (0, "")
    for name in ("margin", "one_line"):
        assert (tmp_path / "new" / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    assert "delay margin" in out
    assert len([line for line in out.splitlines() if line.strip().split(" ")[0].isdecimal()]) == 11


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--set", "controllers=[]"], "controllers: none given"),
        (["--set", "controllers.0.name=HBsWC"], "controllers.0.name: 'HBsWC@two_area' given, which is not linear"),
        (["--max-delay", "0"], "--max-delay: 0 given; allowed: 0.01 to 10 s"),
        (["--pade", "99"], "--pade: 99 given; allowed: 1 to 10"),
        (["no_such_run"], "no_such_run"),
    ],
)
def test_bad_input_is_one_line(inside: Callable[..., tuple[int, str, str]], arguments: list[str], named: str) -> None:
    status, out, err = inside(*arguments)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert named in err


def test_fast_controller_swings_by_itself_with_delays_of_whole_frames() -> None:
    """LLC-tuned at 60 frames/s: without delay its setpoint alternates from frame to frame, as the nonlinear run shows.

    With 1 ms it does not.
    """
    case = load_case(None, ["controllers.0.name=LLC-tuned"])
    loop_margin = margin(case, 0.05, None, nothing)
    assert loop_margin.margin == 0.0
    assert loop_margin.critical is not None
    assert loop_margin.critical.frequency_hz == pytest.approx(30.0)
    assert loop_margin.stable[0][0] < 0.001
    assert loop_margin.stable[0][1] == pytest.approx(2 * FRAME, abs=1e-3)
    assert loop_margin.stable[0][1] < 2 * FRAME
    for delay, lasts in ((0.0, True), (0.001, False)):
        setpoints = loop.run(pulsed(case, delay, 20.0)).applied["value"][-60:]
        alternating = setpoints * (-1.0) ** np.arange(len(setpoints))
        assert (abs(alternating.mean()) > 5e-4) == lasts
        assert lasts or np.abs(setpoints).max() < 1e-4


@pytest.mark.parametrize("name", ["LLC", "LLC-tuned"])
def test_power_of_its_own_line_drives_the_setpoint_from_limit_to_limit(name: str) -> None:
    """`power_rate` jumps with the SSSC's setpoint: never stable; and a run reaches both limits from round-off alone."""
    case = load_case(None, [f"controllers.0.name={name}", "controllers.0.signals=[power_rate]"])
    loop_margin = margin(case, 0.1, None, nothing)
    assert loop_margin.stable == []
    assert loop_margin.worst[0].real > 100
    setpoints = loop.run(pulsed(case, 0.0, 1.0)).applied["value"]
    assert (setpoints.min(), setpoints.max()) == (-0.1, 0.1)
    gentle = load_case(None, ["controllers.0.signals=[power_rate]", "controllers.0.parameters.gain=0.2"])
    assert margin(gentle, 0.1, None, nothing).stable == [(0.0, 0.1)]


@pytest.mark.parametrize("gain", [0.0, 1e-3])
def test_loop_that_is_not_stable_without_delay_has_no_margin(gain: float, tmp_path: Path) -> None:
    loop_margin = margin(load_case(None, [f"controllers.0.parameters.gain={gain}"]), 0.1, None, nothing)
    assert (loop_margin.margin, loop_margin.stable) == (0.0, [])
    assert document(loop_margin, None)["margin_s"] == 0.0
    assert any("0 ms: there a mode of 0.6" in line for line in margin_text(loop_margin, None))
    assert plot(loop_margin, None, tmp_path / "margin.png").is_file()


def test_loop_that_bears_every_delay_looked_at_says_so(tmp_path: Path) -> None:
    loop_margin = margin(load_case(None, []), 0.1, 6, nothing)
    assert (loop_margin.margin, loop_margin.stable, loop_margin.critical) == (None, [(0.0, 0.1)], None)
    assert document(loop_margin, None)["margin_s"] is None
    assert any("beyond 100 ms" in line for line in margin_text(loop_margin, None))
    assert plot(loop_margin, None, tmp_path / "margin.png").is_file()


def test_linear_law_of_ones_own_has_the_margin_of_the_shipped_one() -> None:
    """The thesis's lead-lag as a discrete law, by SciPy's bilinear transform."""
    case = load_case(None, ["controllers.0=" + json.dumps({"name": "my_damper", "linear": bilinear()})])
    of_law = margin(case, LONGEST, 6, nothing)
    assert of_law.margin == pytest.approx(limit(margin_of("speed")), abs=1e-6)
