"""The public face: what ten lines of a notebook do, with the bits of the commands; nothing is said unless asked for."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from matplotlib.figure import Figure

import facts_damping as fd
from facts_damping import api
from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.digest import digest
from facts_damping.simulation import loop
from facts_damping_testing.loopback.opening import opened

if TYPE_CHECKING:
    from numpy.typing import NDArray

ROOT = Path(__file__).parents[1]


class Gain:
    """A class of a script's own."""

    def __init__(self, spec: fd.Spec) -> None:
        self.gain = spec.parameters.get("gain", 10.0)

    def step(self, t_s: float, y: NDArray[Any], age_s: NDArray[Any], fresh: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(self.gain * y)


def test_simulate_is_the_run_of_the_commands_bit_for_bit(capfd: pytest.CaptureFixture[str]) -> None:
    ours = fd.simulate("two_area_large", link="delay_100ms", duration=2, **{"controllers.0.parameters.gain": 12})
    sets = ["link=delay_100ms", "duration=2", "controllers.0.parameters.gain=12"]
    theirs = loop.run(load_case("two_area_large", sets))
    assert ours.frames.tobytes() == theirs.frames.tobytes()
    assert ours.digest == digest(theirs)
    assert ours.indices == fd.summarise(theirs)["indices"] == ours.summary["indices"]
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("gain", [12, 12.0, np.float64(12.0), np.int32(12), np.array(12.0)])
def test_fields_may_be_nested_and_numpys(gain: Any) -> None:
    controllers = ({"name": "LLC", "signals": np.array(["speed"]), "parameters": {"gain": gain}},)
    ours = fd.simulate(scenario="large", duration=np.float64(1.0), controllers=controllers, watchdog=False)
    theirs = loop.run(load_case("two_area_large", ["duration=1", "controllers.0.parameters.gain=12"]))
    assert ours.issued.tobytes() == theirs.issued.tobytes()


def test_class_is_given_as_it_is() -> None:
    rows = [{"name": "mine", "policy": Gain, "parameters": {"gain": 5.0}}]
    ours = fd.simulate("two_area_large", duration=1, controllers=rows)
    assert ours.controller_names == ["controller_0_mine"]
    limit = load_case("two_area_large", []).system.device("sssc").setpoint_max
    weights = load_case("two_area_large", []).system.signals["speed"].weights
    y = sum(w * ours.frames[:, ours.pmus.index(name), 2] for name, w in weights.items())
    assert np.abs(ours.issued["value"] - np.clip(5.0 * np.asarray(y), -limit, limit)).max() < 1e-15
    assert ours.configuration["controllers"][0]["policy"] == f"{Gain.__module__}:Gain"


def test_errors_are_those_of_the_commands() -> None:
    with pytest.raises(fd.InputError, match="'nowhere' given; allowed: "):
        fd.simulate(link="nowhere")
    with pytest.raises(fd.InputError, match="runs: 'nowhere' given; allowed: "):
        fd.simulate("nowhere")
    with pytest.raises(fd.RunError, match="boolean index did not match"):
        fd.simulate(controllers=[{"name": "bad", "policy": Failing}], duration=1)


class Failing(Gain):
    def step(self, t_s: float, y: NDArray[Any], age_s: NDArray[Any], fresh: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(y[np.array([True, False])])


def test_result_has_tables_and_pictures(tmp_path: Path) -> None:
    result = fd.simulate("two_area_large", duration=2)
    table = result.to_pandas()
    assert list(table.index) == result.time_s.tolist()
    assert np.array_equal(table["pmu.G1.speed_deviation_pu"], result.arrays["pmu.G1.speed_deviation_pu"])
    assert table.attrs["units"] == result.units
    other = fd.simulate("two_area_large", duration=2, controllers=[])
    for figure in (result.plot(), result.plot("speeds", beside={"without": other})):
        assert isinstance(figure, Figure)
    columns = result.plot("pmu.G1.speed_deviation_pu", "issued.controller_0_LLC.sssc_pu")
    drawn = columns.axes[0].lines[0].get_ydata()
    assert np.array_equal(drawn, result.arrays["pmu.G1.speed_deviation_pu"])
    assert len(columns.axes) == 2
    with pytest.raises(fd.InputError, match="plot: 'nothing' given; allowed: speeds, differences, "):
        result.plot("nothing")


def test_everything_says_what_it_is_in_a_line(tmp_path: Path) -> None:
    result = fd.simulate("two_area_large", duration=2)
    assert repr(result) == "<Result two_area-large-LLC-ideal: 120 ticks, 1.983 s>"
    assert "ITAE" in result._repr_html_()
    lost = fd.simulate("two_area_large", controllers=[])
    assert repr(lost).endswith(", out of synchronism>")
    assert lost.indices is None
    assert repr(fd.modes("two_area")).startswith("<Modal two_area with sssc: 0.63 Hz -1.4 %, ")
    assert "<pre>" in fd.modes("two_area")._repr_html_()
    simulation = fd.Simulation("two_area_large", duration=2)
    assert repr(simulation) == "<Simulation two_area-large-LLC-ideal: tick 0 of 120, 0.000 s>"


def test_recordings_are_results(tmp_path: Path) -> None:
    with opened():
        assert main(["run", "two_area_large", "--set", "duration=1", "--out", str(tmp_path)]) == 0
    recording = fd.load_recording(tmp_path / "recording")
    assert recording.issued.tobytes() == fd.simulate("two_area_large", duration=1).issued.tobytes()
    assert repr(recording) == "<Result two_area-large-LLC-ideal: 60 ticks, 0.983 s>"


def test_stepped_by_hand_it_is_the_same_run_bit_for_bit() -> None:
    simulation = fd.Simulation("two_area_large", link="pdci", duration=2)
    ticks = 0
    while simulation.step():
        ticks += 1
        assert simulation.tick == ticks
    whole = fd.simulate("two_area_large", link="pdci", duration=2)
    assert ticks == 119
    assert not simulation.step()
    for name in ("frames", "delivered", "issued", "applied", "machines"):
        assert getattr(simulation.record(), name).tobytes() == getattr(whole, name).tobytes(), name
    last = {name: values[-1] for name, values in whole.arrays.items() if name.startswith(("machine", "pmu", "device"))}
    state = simulation.state
    assert all(np.array_equal(state[name], value, equal_nan=True) for name, value in last.items())


def test_setpoints_of_ones_own_stand_in_for_the_controllers() -> None:
    simulation = fd.Simulation("two_area_large", link="delay_100ms", duration=3, controllers=[{"signals": ["w13"]}])
    assert simulation.devices == ["sssc"]
    assert np.isnan(simulation.signals["w13"])
    while simulation.step(10.0 * np.nan_to_num(simulation.signals["w13"])):
        pass
    rows = [{"name": "mine", "policy": Gain, "signals": ["w13"]}]
    whole = fd.simulate("two_area_large", link="delay_100ms", duration=3, controllers=rows)
    assert simulation.record().issued.tobytes() == whole.issued.tobytes()
    assert simulation.ages_s["w13"] == pytest.approx(0.07)
    with pytest.raises(fd.InputError, match=r"u: shape \(2,\) given; allowed: \(1,\): sssc"):
        simulation.step([0.0, 0.0])


def test_fallback_speaks_for_itself_beside_setpoints_of_ones_own() -> None:
    """Frames that stop at 1 s: the supervisor takes the fallback's setpoints, which nobody has set."""
    link = {"up": [{"model": "bernoulli", "loss": 1.0, "start": 1.0}]}
    rows = [{"link": link}, {"fallback_of": 0, "signals": ["power"]}]
    fields = {"duration": 2, "supervision": "standard", "arm_at": 0.1, "controllers": rows}
    simulation = fd.Simulation("two_area_large", **fields)
    assert simulation.devices == ["sssc"]
    while simulation.step(0.001):
        assert "supervision.controller_0_LLC.state" in simulation.state
    record = simulation.record()
    assert set(record.issued["value"][record.issued["controller"] == 0]) == {0.001}
    reserve = record.issued["value"][record.issued["controller"] == 1]
    assert len(set(reserve)) > 10
    assert [row["state"] for row in record.summary["supervision"][0]["changes"]] == ["armed", "fallback"]
    assert record.supervised["value"][-1] == reserve[-1]


def test_controllers_and_setpoints_by_turns() -> None:
    simulation = fd.Simulation("two_area_large", duration=2)
    for tick in range(119):
        simulation.step(0.0 if 30 <= tick < 60 else None)
    issued = simulation.record().arrays["issued.controller_0_LLC.sssc_pu"]
    assert (issued[30:60] == 0.0).all()
    assert (np.delete(issued[6:], range(24, 54)) != 0.0).any()


STUDY = {
    "run": "two_area_small",
    "set": {"duration": 4, "link": "pdci"},
    "sweep": [{"field": "controllers.0.name", "values": ["LLC", "ANFTSC"]}, {"field": "seed", "values": [1, 2]}],
    "modes": False,
}


def test_sweep_is_a_table(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    swept = fd.sweep(STUDY, jobs=1)
    table = swept.to_pandas()
    assert capfd.readouterr() == ("", "")
    assert repr(swept) == "<Sweep study: 4 runs>"
    assert "ITAE" in swept._repr_html_()
    row = table[(table["controller"] == "LLC") & (table["seed"] == 2)].iloc[0]
    assert row["ITAE"] == (fd.simulate("two_area_small", duration=4, link="pdci", seed=2).indices or {})["ITAE"]
    assert all(path.stat().st_size > 1000 for path in swept.plot(tmp_path / "pictures"))


def test_margins_are_a_table_too(tmp_path: Path) -> None:
    margin = {"name": "delay_s", "fields": {"link.up.0.delay": 1}, "low": 0, "high": 1, "coarse": 2, "tolerance": 0.1}
    rows = [{"controllers.0.name": "LLC"}, {"controllers.0.name": "mine", "controllers.0.policy": Gain}]
    study = {"run": "two_area_large", "set": {"duration": 20}, "sweep": [{"rows": rows}], "modes": False}
    swept = fd.sweep({**study, "margin": {**margin, "criteria": ["unstable"]}}, jobs=1, out=tmp_path)
    table = swept.margins_to_pandas()
    assert table["controller"].tolist() == ["LLC", "mine"]
    assert (table["margin_s"] > 0.1).all()
    assert (tmp_path / "rows.jsonl").is_file()


SCRIPT = """
import facts_damping as fd

class Gain:
    def __init__(self, spec): pass
    def step(self, t_s, y, age_s, fresh): return 10.0 * y

{begin}
    rows = [{{"controllers.0.name": "mine", "controllers.0.policy": Gain, "duration": d}} for d in (1, 2)]
    found = fd.sweep({{"run": "two_area_small", "sweep": [{{"rows": rows}}], "modes": False}}, jobs=2)
    print(found, found.rows[0]["error"])
"""
AS_PROGRAM = "import runpy, sys; runpy.run_path(sys.argv[1], run_name='__main__')"
WITHIN = "controllers.0.policy: bare.py:10: RunError: a sweep within a sweep given; allowed: in a script, below if"


def test_script_with_a_sweep_is_run_once(tmp_path: Path) -> None:
    """Or, where its processes look for its class in it and find the sweep, it is said what to do, before any run."""
    scripts, completed = {"bare.py": "if True:", "guarded.py": 'if __name__ == "__main__":'}, []
    for name, begin in scripts.items():
        (tmp_path / name).write_text(SCRIPT.format(begin=begin))
        command = [sys.executable, "-c", AS_PROGRAM, name]
        completed.append(subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path))
    bare, guarded = completed
    assert (bare.returncode, bare.stdout) == (1, "")
    assert "InputError: study: 2 of 2 different runs cannot be made" in bare.stderr
    assert WITHIN in bare.stderr
    assert (guarded.stdout, guarded.stderr) == ("<Sweep study: 2 runs> None\n", "")


def test_modes_of_a_system() -> None:
    modal = fd.modes("two_area", ["sssc"])
    assert f"{modal.swings[0].frequency_hz:.4f}" == "0.6297"
    assert fd.modes("two_area", []).devices == []
    assert fd.linear_plant("two_area", ["sssc"]).ninputs == 1


def test_public_names_of_the_api_exist() -> None:
    assert sorted(fd.CORE) == sorted(api.__all__)
    assert all(callable(getattr(fd, name)) for name in fd._public())
    assert {*fd.CORE, "Score", "Sweep", "score", "sweep"} == set(fd._public()) <= set(dir(fd))


def test_without_pandas_it_is_said_how_it_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(fd.InputError, match="pandas is not installed; allowed: pip install"):
        fd.simulate(duration=0.1).to_pandas()


def test_import_of_the_package_loads_neither_numpy_nor_numba() -> None:
    script = "import sys, facts_damping; print(len([m for m in sys.modules if m.startswith(('numpy', 'numba'))]))"
    completed = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert completed.stdout == "0\n"
    with pytest.raises(AttributeError, match="it has FactsDampingError, InputError"):
        _ = fd.nothing
