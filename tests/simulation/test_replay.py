"""Replay in process: the same controllers give the same bits; others what they would have commanded."""

from __future__ import annotations

import dataclasses
import itertools
import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.analysis import releases
from facts_damping.case.loading import load_case
from facts_damping.errors import InputError
from facts_damping.neurofuzzy.table import VARIANTS
from facts_damping.record import RunChange
from facts_damping.simulation import loop
from facts_damping.simulation.changes import rerun
from facts_damping.simulation.replaying import replay
from tests.two_devices import centralised, decentralised

if TYPE_CHECKING:
    from facts_damping.record import Record
    from facts_damping.simulation.replaying.replayed_nodes import Played

NETWORKS = list(zip([*VARIANTS, "gaussian+fourier"], itertools.cycle(("direct", "indirect")), strict=False))
OWN_LINKS = ["scenario=large", "duration=3", "controllers.0.link=plc", "controllers.1.link.up.0.delay=0.05"]
RUNS: dict[str, tuple[str | None, list[str]]] = {
    "LLC": (None, []),
    "LLC-tuned": (None, ["controllers.0.name=LLC-tuned"]),
    **{f"{n}-{s}": (None, [f"controllers.0.name={n}", f"controllers.0.scheme={s}"]) for n, s in NETWORKS},
    "centralised": (None, [*centralised("ANFTSC", "indirect")]),
    "own links": ("two_area_decentralised", OWN_LINKS),
    "two networks": (None, [*decentralised("HBsWC", "indirect")]),
    "compensation": (None, ["controllers.0.compensation=phasor"]),
    "prediction": (None, ["controllers.0.name=ANFTSC", "controllers.0.compensation=prediction", "link=delay_100ms"]),
    "satellite": (None, ["link=satellite", "controllers.0.name=ANFTSC"]),
    "smib": (None, ["system=smib", "scenario=heavy", "controllers.0.name=ANFFsC"]),
}


def recorded(run: str | None, sets: list[str]) -> Record:
    common = (
        [] if run else [f"{key}={value}" for key, value in (("scenario", "large"), ("link", "plc"), ("duration", 4))]
    )
    fields = {text.split("=")[0] for text in sets}
    return loop.run(load_case(run, [*(text for text in common if text.split("=")[0] not in fields), *sets]))


def played(record: Record, *sets: str) -> tuple[Record, Any, Any, Played]:
    case = replay.case_of(record, "recording", None, list(sets))
    part = replay.fitted(record, case)
    said = replay.play(case, part)
    return part, said.issued, said.estimates, said


@pytest.mark.parametrize("name", RUNS)
def test_same_controllers_give_the_same_bits(name: str) -> None:
    record = recorded(*RUNS[name])
    part, issued, estimates, said = played(record)
    assert np.count_nonzero(record.issued["value"]) > 30
    assert (len(record.estimates) > 0) == ("indirect" in str(record.configuration["controllers"]))
    assert issued.tobytes() == record.issued.tobytes()
    assert estimates.tobytes() == record.estimates.tobytes()
    assert replay.first_difference(part, issued) is None
    assert replay.first_estimate(part, estimates) is None
    assert replay.first_learning(part, said.learning) is None
    assert said.learning.tobytes() == record.learning.tobytes()
    if len(record.learning):
        half = record.learning[: len(record.learning) // 2]  # the topic was not recorded to the end
        assert replay.first_learning(dataclasses.replace(part, learning=half), said.learning) is None
        other = said.learning.copy()
        other["rate"][-1] = -1.0
        assert replay.first_learning(part, other) == other["tick"][-1]


def test_entry_that_is_changed_by_one_bit_shows_where() -> None:
    record = recorded(None, ["link=delay_100ms", "controllers.0.name=HBsWC"])
    changed = record.delivered.copy()
    pmu, row = record.pmus.index("G1"), 0
    row = int(np.flatnonzero((changed["tick"] == 150) & (changed["pmu"] == pmu))[0])
    changed["values"][row, 2] = np.nextafter(changed["values"][row, 2], 1.0)
    part, issued, estimates, _ = played(dataclasses.replace(record, delivered=changed))
    difference = replay.first_difference(part, issued)
    assert difference is not None
    assert difference.tick in range(150, 170)  # a difference of the last bit may vanish in sums for a while
    assert difference.recorded != difference.replayed
    assert "controller_0_HBsWC to sssc" in str(difference)
    assert replay.first_estimate(part, estimates) in range(150, 170)


def test_setpoints_that_lack_or_are_too_many_are_a_difference() -> None:
    record = recorded(None, ["duration=1"])
    part, issued, *_ = played(record)
    tick = int(part.issued["tick"][20])
    shorter = dataclasses.replace(part, issued=np.delete(part.issued, 20))
    assert replay.first_difference(shorter, issued) is not None
    first = replay.first_difference(part, issued[:-1])
    assert first is not None
    assert (first.tick, np.isnan(first.replayed)) == (int(issued["tick"][-1]), True)
    assert replay.first_difference(shorter, issued).tick == tick  # type: ignore[union-attr]


def test_shadow_with_twice_the_gain_commands_twice_as_much() -> None:
    """A lead-lag is linear, and a factor of two exact: where it is not limited, to the bit."""
    record = recorded(None, ["scenario=small", "controllers.0.parameters.gain=4"])
    part, issued, *_ = played(record, "controllers.0.parameters.gain=8")
    assert np.abs(issued["value"]).max() < 0.1
    assert np.array_equal(issued["value"], 2.0 * record.issued["value"])
    case = replay.case_of(record, "recording", None, [])
    (row,) = replay.beside(case, part, issued)
    assert row["correlation"] == pytest.approx(1.0)
    assert row["rms_replayed_pu"] == 2.0 * row["rms_recorded_pu"]
    assert row["rms_difference_pu"] == row["rms_recorded_pu"]
    assert row["saturated_recorded"] == row["saturated_replayed"] == 0.0


def test_shadow_hears_what_the_plant_answered_to_the_recorded_setpoints() -> None:
    """Its identifier, given the recorded setpoints, estimates what it does beside them: here of the same controller."""
    record = recorded(None, ["controllers.0.name=ANFTSC"])
    _, issued, estimates, _ = played(record, "controllers.0.parameters.eta=0.02")
    assert issued.tobytes() != record.issued.tobytes()
    assert estimates.tobytes() == record.estimates.tobytes()


def test_another_controller_starts_from_its_own_parameters() -> None:
    record = recorded(None, ["duration=2", "controllers.0.parameters.gain=5"])
    wanted = load_case(None, ["link=plc", "controllers.0.name=HBsWC", "scenario=large"])
    for place in ("0", "*"):
        case = replay.case_of(record, "recording", None, [f"controllers.{place}.name=HBsWC"])
        assert case.controllers == wanted.controllers
    same = replay.case_of(record, "recording", None, ["controllers.0.parameters.T2=0.1"])
    assert same.controllers[0].parameters == case_parameters(record) | {"T2": 0.1}


def case_parameters(record: Record) -> dict[str, Any]:
    return dict(record.configuration["controllers"][0]["parameters"])


def test_saturation_duty_counts_ticks_at_the_limit() -> None:
    record = recorded(None, ["duration=3"])
    part, issued, *_ = played(record, "controllers.0.parameters.gain=1000")
    (row,) = replay.beside(replay.case_of(record, "recording", None, []), part, issued)
    grid = record.arrays["issued.controller_0_LLC.sssc_pu"]
    limit = record.configuration["system"]["devices"][0]["setpoint_max"]
    assert row["saturated_recorded"] == np.mean(np.abs(np.nan_to_num(grid)) == limit)
    assert row["saturated_replayed"] > 0.5


def test_uncontrolled_run_has_shadows_too() -> None:
    record = recorded(None, ["controllers=[]", "duration=2"])
    with pytest.raises(InputError, match="controllers: none given"):
        played(record)
    part, issued, *_ = played(record, "controllers.0.name=LLC")
    assert len(issued) > 30
    (row,) = replay.beside(replay.case_of(record, "", None, ["controllers.0.name=LLC"]), part, issued)
    assert row["correlation"] is None
    assert row["rms_replayed_pu"] == row["rms_difference_pu"] > 0.0


def test_gap_ends_the_replay_and_is_said() -> None:
    record = dataclasses.replace(recorded(None, ["controllers.0.name=ANFTSC"]), gap_tick=101)
    part, issued, estimates, _ = played(record)
    assert part.ticks.tolist() == list(range(101))
    assert issued.tobytes() == record.issued[record.issued["tick"] < 101].tobytes()
    assert estimates.tobytes() == record.estimates[record.estimates["tick"] < 101].tobytes()
    assert replay.notes_on(record, part)[-1].startswith("replayed up to tick 100 at 1.667 s: tick 101 is incomplete")


def test_devices_in_another_order_are_told_by_name() -> None:
    record = recorded(None, [*centralised("LLC", None), "duration=2"])
    turned = json.dumps(record.configuration["controllers"][0] | {"weights": None})
    part, issued, *_ = played(record, "devices=[statcom, sssc]", f"controllers=[{turned}]")
    for name in ("sssc", "statcom"):
        grids = [replay.on_grid(part, rows, part.device_names.index(name)) for rows in (part.issued, issued)]
        assert np.ptp(grids[0]) > 0.0
        assert np.array_equal(grids[0], grids[1])


@pytest.mark.parametrize(
    ("sets", "said"),
    [
        (["controllers.0.name=nothing"], "controllers.0.name"),
        (["controllers.0.link=plc", "controllers.1.devices=[statcom]", "devices=[sssc, statcom]",
          "controllers.1.parameters.gain=5"], "controllers: 2 links given; allowed: 1, as recorded"),
    ],
)  # fmt: skip
def test_replay_with_an_unknown_controller_or_more_links_is_refused(sets: list[str], said: str) -> None:
    with pytest.raises(InputError, match=said):
        played(recorded(None, ["duration=1"]), *sets)


def test_links_count_that_have_not_delivered_yet() -> None:
    """As in the first ticks of every run: the links are those that were recorded, not those that were quick."""
    delays = [f"controllers.{i}.link={link}" for i, link in enumerate(("pdci_100ms", "delay_100ms"))]
    record = recorded("two_area_decentralised", ["scenario=large", "duration=0.05", *delays])
    assert (len(record.delivered), record.links) == (0, 2)
    part, issued, *_ = played(record)
    assert len(part.ticks) == 3
    assert replay.first_difference(part, issued) is None


def test_refused_replay_names_what_the_recording_lacks() -> None:
    record = dataclasses.replace(recorded(None, ["duration=1"]), notes=["run_0.mcap: cut"])
    with pytest.raises(InputError, match=r"^tick 0: its frames, .* nothing can be replayed; run_0.mcap: cut$"):
        played(dataclasses.replace(record, gap_tick=0))
    with pytest.raises(InputError, match=r"^controllers: 1 links given; allowed: 0, as recorded; run_0.mcap: cut$"):
        played(dataclasses.replace(record, links=0))


def test_station_that_was_not_recorded_is_refused() -> None:
    record = recorded(None, ["duration=1"])
    other = dataclasses.replace(record, pmus=["X1", *record.pmus[1:]])
    with pytest.raises(InputError, match="pmus: 'G1' was not recorded; there are X1, G2"):
        played(other)


def test_recording_without_its_run_asks_for_it() -> None:
    record = recorded(None, ["duration=1"])
    bare = dataclasses.replace(record, configuration={})
    with pytest.raises(InputError, match="holds no run; allowed: --run"):
        replay.case_of(bare, "bag", None, [])
    case = replay.case_of(bare, "bag", "two_area_small", ["link=plc", "scenario=large"])
    part = replay.fitted(bare, case)
    assert replay.first_difference(part, replay.play(case, part)[0]) is None


LOSS = '{"model": "bernoulli", "loss": 1.0, "start": 1.0, "duration": 0.5}'
CUTS = f'link={{"up": [{LOSS}], "down": [{{"model": "uniform", "low": 0.01, "high": 0.06}}]}}'


@pytest.mark.parametrize("more", [[], ["watchdog.good=20"], ["watchdog.max_age=0.05", "watchdog.good=3"]])
def test_watchdogs_do_the_same_with_what_was_applied(more: list[str]) -> None:
    record = loop.run(load_case(None, ["scenario=large", "duration=4", CUTS, *more]))
    case = replay.case_of(record, "recording", None, [])
    again = replay.watched(case, replay.fitted(record, case))
    assert again.devices.tobytes() == record.devices.tobytes()
    assert record.devices["released"].any()
    assert releases.releases(again) == releases.releases(record)


def test_another_watchdog_is_judged_on_what_was_applied() -> None:
    record = loop.run(load_case(None, ["scenario=large", "duration=4", CUTS]))
    times = []
    for sets in ([], ["watchdog.timeout=0.4"], ["watchdog.timeout=0.7"], ["watchdog=null"]):
        case = replay.case_of(record, "recording", None, sets)
        times.append(
            [release.time_s for release in releases.releases(replay.watched(case, replay.fitted(record, case)))]
        )
    assert times[1][0] == pytest.approx(times[0][0] + 0.2, abs=1 / 60)
    assert times[2:] == [[], []]


@pytest.mark.parametrize(
    "odd",
    [
        {"name": "no such parameter", "value": 1.0},
        {"name": "eta", "value": "fast"},
        {"name": "eta", "value": None},
        {"name": "eta", "value": 1e300},
        {"name": "eta", "value": 0.1, "index": 7},
        {"name": "", "value": None, "kind": "storm"},
        {"name": "", "value": None, "kind": "start", "role": "identifier"},
    ],
)
def test_changes_that_nobody_can_have_made_are_passed_over(odd: dict[str, Any]) -> None:
    """Anybody may speak on a topic that a bag holds."""
    record = recorded(None, ["controllers.0.name=ANFTSC", "controllers.0.scheme=direct", "duration=3"])
    fields: dict[str, Any] = {"tick": 60, "node": "/n", "role": "controller", "index": 0, "kind": "parameter"} | odd
    change = RunChange(**fields)
    case = replay.case_of(record, "it", None, [])
    part = replay.fitted(dataclasses.replace(record, changes=[change]), case)
    assert replay.first_difference(part, replay.play(case, part)[0]) is None


def test_parameter_changed_under_way_is_changed_in_the_replay() -> None:
    case = load_case(None, ["duration=3", "scenario=large"])
    change = RunChange(90, "/n", "controller", 0, "parameter", "gain", 3.0)
    record = rerun(case, [change])
    part = replay.fitted(record, case)
    assert replay.first_difference(part, replay.play(case, part)[0]) is None
    without = dataclasses.replace(part, changes=[])
    difference = replay.first_difference(without, replay.play(case, without)[0])
    assert difference is not None
    assert difference.tick >= 90
