"""Signals of a record by name, and pictures of their distributions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread

from facts_damping.analysis.measures import recorded
from facts_damping.errors import InputError
from facts_damping.record import GridEvent
from facts_damping.signals import NANOSECONDS
from facts_damping_views.analysis.time_frequency import analyse
from facts_damping_views.analysis.time_frequency_plots import Settings, distribution_figures, plot_distribution, save

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from facts_damping.record import Record


def test_signals_by_name(swing_record: Callable[..., Record]) -> None:
    record = swing_record()
    record.machines["rotor_angle"][:, 1] = 7.0
    speed = record.frames[:, 0, 2]
    for name, known, unit in (
        ("w12", 2 * speed, "p.u."),
        ("pmu.G2.speed_deviation_pu", -speed, "p.u."),
        ("pmu.TIE.active_power_pu", 4 + 100 * speed, "p.u."),
        ("device.sssc.injected_voltage_pu", -40 * speed, "p.u."),
        ("machine.G2.rotor_angle_rad", np.full(1200, 7.0), "rad"),
    ):
        values, its_unit = recorded(record, name)
        np.testing.assert_allclose(values, known, rtol=1e-12)
        assert its_unit == unit


def test_angles_do_not_jump(swing_record: Callable[..., Record]) -> None:
    record = swing_record()
    turning = np.linspace(0, 20, 1200)
    record.frames[:, 2, 1] = np.angle(np.exp(1j * turning))
    record.frames[5, 2, 1] = np.nan
    values, unit = recorded(record, "pmu.TIE.voltage_angle_rad")
    assert unit == "rad"
    assert np.isnan(values[5])
    np.testing.assert_allclose(np.delete(values, 5), np.delete(turning, 5), atol=1e-9)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("w99", "signal: 'w99' given; allowed: w12, pmu.G1.voltage_magnitude_pu, "),
        ("TIE.active_power", "signal: 'TIE.active_power' given; allowed: w12, .* or any other column"),
        ("device.sssc.blocked", "signal: 'device.sssc.blocked' given; allowed: w12, "),
        ("time_s", "signal: 'time_s' given; allowed: w12, "),
        (
            "pmu.TIE.speed_deviation_pu",
            "speed_deviation_pu: 0 known samples given; allowed: at least 16",
        ),
    ],
)
def test_names_that_are_not_there(swing_record: Callable[..., Record], name: str, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        distribution_figures([("run", swing_record(), [])], ["w12", name], Settings())


def test_pictures_of_one_and_of_several(tmp_path: Path, swing_record: Callable[..., Record]) -> None:
    records = [("a", swing_record(), [0.5]), ("b", swing_record(300), [])]
    single, notes = distribution_figures(records[:1], ["w12", "pmu.TIE.active_power_pu"], Settings())
    assert notes == []
    assert list(single) == ["spwvd_w12", "spwvd_pmu.TIE.active_power_pu"]
    several, _ = distribution_figures(records, ["w12"], Settings())
    assert list(several) == ["spwvd_w12_1", "spwvd_w12_2"]
    for path in save(single | several, tmp_path):
        picture = imread(path)
        assert picture.shape[1] > 1000
        assert (picture[..., :3] < 0.5).any()


def test_spwvd_picture_names_windows_units_events_and_modes(swing_record: Callable[..., Record]) -> None:
    """Hz, the physical unit on the bar, the windows, the event, the lines of modes."""
    record = swing_record()
    for settings, heading in (
        (Settings(), "SPWVD of w12, run; lag window 10 s, time window 4 s"),
        (Settings(8.0, 0.0), "pseudo-WVD of w12, run; lag window 8 s"),
        (Settings(np.inf, 0.0), "WVD of w12, run; all lags"),
    ):
        figures, _ = distribution_figures([("run", record, [0.5, 1.1])], ["w12"], settings)
        figure = figures["spwvd_w12"]
        assert figure.get_suptitle() == heading
        labels = {axes.get_ylabel(): axes for axes in figure.axes}
        assert {"f [Hz]", "x [$10^{-3}$ p.u.]", "[$10^{-6}$ p.u.²]", "W [$10^{-6}$ p.u.²/Hz]"} <= set(labels)
        assert labels["f [Hz]"].get_ylim() == (0.1, 2.5)
        lines = [np.asarray(line.get_ydata()) for line in labels["f [Hz]"].lines]
        assert [line[0] for line in lines if line[0] == line[-1]] == [0.5, 1.1]
        assert [text.get_text() for text in labels["x [$10^{-3}$ p.u.]"].texts] == ["load step"]


def test_bar_is_the_distribution(swing_record: Callable[..., Record]) -> None:
    """Colours show W in the bar's unit, and the marginals' axes theirs."""
    record = swing_record()
    analysed = analyse(record.time_s, recorded(record, "w12")[0])
    figure = Figure()
    plot_distribution(figure, analysed, "p.u.")
    (image,) = (image for axes in figure.axes for image in axes.images)
    np.testing.assert_allclose(np.asarray(image.get_array()).T * 1e-6, analysed.distribution.values, atol=1e-18)
    left, right, bottom, top = image.get_extent()
    assert (left, right, bottom, top) == pytest.approx((-0.05, 19.95, -5 / 1024, 5 - 5 / 1024))


def test_missing_ticks_are_noted(swing_record: Callable[..., Record]) -> None:
    record = swing_record()
    record.frames[400:403, 1, 2] = np.nan
    _, notes = distribution_figures([("run", record, [])], ["w12"], Settings())
    assert notes == ["run: w12: 3 ticks are missing and were filled by straight lines"]


def test_signal_at_rest(swing_record: Callable[..., Record], tmp_path: Path) -> None:
    record = swing_record(events=[GridEvent(5 * NANOSECONDS, "fault", "L", 0.0)])
    record.frames[:, 2, 3] = 4.0
    figures, _ = distribution_figures([("run", record, [])], ["pmu.TIE.active_power_pu"], Settings())
    assert len(save(figures, tmp_path)) == 1
