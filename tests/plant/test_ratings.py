"""Losses and ratings of converters: what they draw at rest, and what they do not exceed."""

from __future__ import annotations

import numpy as np
import pytest

from facts_damping.errors import InputError
from tests.plant.running import follow, frame_times, plant, slopes, with_device
from tests.plant.small import between_infinite_buses
from tests.plant.test_statcom import row

FAULT = {"time": 0.1, "kind": "fault", "line": "line_4", "location": 0.9, "duration": 0.1}
RATED = 6.0  # p.u.; the tie carries 4.15 at the start


def test_sssc_is_bypassed_above_its_rating_where_asked() -> None:
    """In the fault its line carries more than rated: then its transformer is all that is there."""
    free, bypassing = (
        follow(
            plant(with_device("sssc", I_rated=RATED, enforce_rating=on), FAULT), frame_times(0.5, 240), [(0.0, 0.05)]
        ).devices[:, 0]
        for on in (False, True)
    )
    assert (free["current"] > RATED).any()
    assert not free["blocked"].any()
    bypassed = bypassing["blocked"] == 1.0
    np.testing.assert_array_equal(bypassed, bypassing["current"] > RATED)
    assert 5 < bypassed.sum() < 60
    assert (bypassing["active_voltage"][bypassed] == 0.0).all()
    drop = bypassing["injected_voltage"][bypassed] + 0.0016 * bypassing["current"][bypassed]
    np.testing.assert_allclose(drop, 0.0, atol=1e-15)


def test_start_above_the_rating_is_refused() -> None:
    with pytest.raises(InputError, match=r"sssc carries 4\.1\d* p.u. at the start; allowed: .* at most I_rated, 4"):
        plant(with_device("sssc", I_rated=4.0, enforce_rating=True))
    plant(with_device("sssc", I_rated=4.0))


@pytest.mark.parametrize("on", [False, True])
def test_whole_current_of_a_statcom_is_limited_where_asked(on: bool) -> None:
    """Losses of 0.6 p.u. and all the reactive power that there is: the DC link keeps its current, the rest is left."""
    system = between_infinite_buses([row("S", g=0.6, Ki=50.0, enforce_rating=on)], step=5e-4)
    built = plant(system, installed=["statcom"])
    end = follow(built, [0.0, 3.0], [(0.0, 0.1)]).devices[-1, 0]
    if on:
        assert end["current"] == pytest.approx(1.0, abs=1e-4)
        assert end["dc_voltage"] == pytest.approx(1.0, abs=1e-3)
        assert 0.7 < end["reactive_power"] < 0.85
    else:
        assert end["current"] > 1.15


@pytest.mark.parametrize(("g", "R"), [(0.05, 0.0073), (0.3, 0.0), (0.3, 0.1)])
def test_statcom_with_losses_rests_and_the_power_flow_has_them(g: float, R: float) -> None:
    """P = V i with V i - R i^2 = g; that is missing at its bus, and no state moves."""
    built = plant(with_device("statcom", g=g, R=R), installed=["sssc", "statcom"])
    assert np.abs(slopes(built)).max() < 1e-8
    truth = follow(built, [0.0]).devices[0, 1]
    i = truth["current"]
    assert -truth["active_power"] - R * i * i == pytest.approx(g, abs=1e-9)
    assert truth["reactive_power"] == pytest.approx(0.0, abs=1e-12)
    at = built.flow.names.index("B8W")
    assert built.flow.injection[at] == pytest.approx(-(g + R * i * i), abs=1e-9)


def test_losses_beyond_the_rating_are_refused() -> None:
    with pytest.raises(InputError, match=r"statcom.g: 0.6 given, .* allowed: at most I_max, 0.5"):
        plant(between_infinite_buses([row("S", g=0.6, I_max=0.5)]), installed=["statcom"])
