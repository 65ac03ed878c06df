"""The package of docs/extensions.md, installed as its text says, and sent through every command that meets its rows.

One process gives the commands after each other.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from facts_damping import extensions
from facts_damping.analysis.indices import INDICES, Index
from facts_damping.control.table import ControllerKind
from facts_damping.errors import InputError
from facts_damping.parameters.plant.devices import DeviceModel
from facts_damping.recording import load

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "extensions.md").read_text(encoding="utf-8")
FILES = dict(re.findall(r"```python\n# ([\w/.]+)\n(.*?)```", PAGE, re.DOTALL))
PROJECT = tomllib.loads("".join(re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)))["project"]

LINK = "{up: [{model: exponential, delay: 0.02, mean: 0.03}], down: [{delay: 0.05}]}"
EVENT = "{time: 0.1, kind: load_step, load: load_2, change: -0.1}"
RUN = f"""
system: my_grid.yaml
scenario: step.yaml
devices: [sssc, source]
controllers:
  - {{name: proportional, devices: [source], signals: [speed], parameters: {{K: 3}}}}
  - {{name: sech+parabolic, scheme: indirect, devices: [sssc], signals: [speed]}}
link: {LINK}
duration: 1
"""
LINEAR = "{name: proportional, devices: [sssc], signals: [speed], parameters: {K: 5}}"
STUDY = f"""
run: own.yaml
sweep:
  - rows: [{{controllers: [{LINEAR}]}}, {{controllers: [{{name: LLC}}]}}]
  - {{name: mean_s, field: link.up.0.mean, values: [0, 0.1]}}
tables: {{figures: [ITAE, IT2AE]}}
"""
GIVEN = f"""
list controllers: list controllers
simulate: simulate own.yaml --out simulated --json simulate.json
run: run own.yaml --out ran --json run.json
analyze: analyze ran/recording --report report.html --json analyze.json
replay: replay ran/recording --json replay.json
modes: modes my_grid.yaml --devices sssc,source --json modes.json
margin: margin own.yaml --set "controllers=[{LINEAR}]" --set link=delay_100ms --max-delay 0.2 --json margin.json
tune: tune my_grid.yaml proportional --scenario step.yaml --devices source --budget 24 --jobs 1 --out tuned.yaml \
--json tune.json
search: search two_area proportional sech+parabolic --devices sssc --link own_link.yaml --budget 10 --json search.json
sweep: sweep own_study.yaml --out swept --jobs 1 --json sweep.json
compare: sweep comparison --set system=my_grid.yaml --set scenario=step.yaml --set link=own_link.yaml \
--only kind=none,LLC,proportional,ANFShMoC* --jobs 1 --out compared --json compare.json
LQG: simulate own.yaml --set "controllers=[{{name: LQG}}]" --json lqg.json
LQG for 0.1 s: simulate own.yaml --set "controllers=[{{name: LQG, parameters: {{loop_delay: 0.1}}}}]" --json lqg_1.json
LQG for none: simulate own.yaml --set "controllers=[{{name: LQG, parameters: {{loop_delay: 0}}}}]" --json lqg_0.json
"""
SMALL_BUDGET = r"--budget 10: of 4 structures only the 16 first points are tried: 64 closed loops; .*\n"
COMMANDS = {name: shlex.split(text) for name, text in (line.split(": ", 1) for line in GIVEN.strip().splitlines())}
SCRIPT = """
import contextlib, io, json, traceback
from facts_damping.cli.main import main
told = {}
for name, command in json.load(open("commands.json")).items():
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            status = main(command)
        except Exception:
            status = -1
            err.write(traceback.format_exc()[-1000:])
    told[name] = [status, out.getvalue(), err.getvalue()]
    json.dump(told, open("told.json", "w"))
"""


class Told(NamedTuple):
    """What a command said."""

    status: int
    out: str
    errors: str


class Carried(NamedTuple):
    """The folder in which the commands were given, and what each said."""

    folder: Path
    told: dict[str, Told]

    def json(self, name: str) -> Any:
        """What a command wrote."""
        return json.loads((self.folder / name).read_text(encoding="utf-8"))


def install(
    folder: Path, files: dict[str, str], groups: dict[str, dict[str, str]], package: str = "my_extension"
) -> None:
    """Put a package where Python finds it, with the entry points that an installation writes."""
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    metadata = folder / f"{package}-1.0.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n", encoding="utf-8")
    lines = [
        line
        for group, points in groups.items()
        for line in (f"[{group}]", *(f"{name} = {value}" for name, value in points.items()))
    ]
    (metadata / "entry_points.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


@pytest.fixture(scope="module")
def carried(tmp_path_factory: pytest.TempPathFactory, module_domain: int) -> Carried:
    root, folder = tmp_path_factory.mktemp("installed"), tmp_path_factory.mktemp("commands")
    install(root, FILES, PROJECT["entry-points"])
    grid = (ROOT / "config" / "systems" / "two_area.yaml").read_text(encoding="utf-8")
    device = "  - {name: source, kind: current_source, bus: B8W, setpoint_max: 0.5, rate_max: 5}\n"
    own = re.sub(r"(\ndevices:.*\n)", rf"\1{device}", grid.replace("name: two_area", "name: my_grid", 1), count=1)
    assert own.count("my_grid") == own.count("current_source") == 1
    step = f"name: step\nduration: 1\nevents: [{EVENT}]\n"
    texts = {"my_grid.yaml": own, "step.yaml": step, "own.yaml": RUN, "own_study.yaml": STUDY, "own_link.yaml": LINK}
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    (folder / "commands.json").write_text(json.dumps(COMMANDS), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": f"{root}:{ROOT}", "ROS_DOMAIN_ID": str(module_domain)},
        capture_output=True,
        text=True,
        check=False,
        timeout=1000,
    )
    assert done.returncode == 0, done.stderr[-1000:]
    return Carried(folder, {name: Told(*said) for name, said in json.loads((folder / "told.json").read_text()).items()})


def test_the_page_has_a_row_for_every_group_and_a_file_for_every_row() -> None:
    assert set(PROJECT["entry-points"]) | {"facts_damping.policies", "facts_damping.commands"} == {
        f"facts_damping.{g}" for g in extensions.GROUPS
    }
    named = {value.partition(":")[0] for points in PROJECT["entry-points"].values() for value in points.values()}
    assert {name.removesuffix(".py").replace("/", ".") for name in FILES} == named
    assert len(FILES) == PAGE.count("```python\n")


POINTS = {"proportional": "one:ROW"}
TABLES: dict[str, Any] = {
    "controlers": ("controllers", ControllerKind),
    "controllers": ("controllers", ControllerKind),
    "indices": ("indices", Index, INDICES),
    "devices": ("devices", DeviceModel),
}


@pytest.mark.parametrize(
    ("text", "groups", "said"),
    [
        (
            "",
            {"controlers": POINTS},
            r"proportional = one:ROW of facts_damping.controlers \(my_extension\): no such group; .*",
        ),
        ("", {"controllers": POINTS}, r".*: AttributeError: .*no attribute 'ROW'; allowed: module:row, .*"),
        ("ROW = 1", {"controllers": POINTS}, r".*: int given; allowed: ControllerKind"),
        ("ROW = 1", {"indices": {"IAE": "one:ROW"}}, r"IAE .*: the name is taken; allowed: another than .*"),
        ("ROW = 1", {"devices": POINTS}, r".*: stands alone; allowed: with proportional of facts_damping.device_kinds"),
    ],
)
def test_what_is_no_row_is_told_in_one_line(
    text: str, groups: dict[str, dict[str, str]], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, {"one.py": text}, {f"facts_damping.{name}": points for name, points in groups.items()})
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "one", raising=False)
    caches = (extensions.given, extensions.every)
    try:
        for cache in caches:
            cache.cache_clear()
        with pytest.raises(InputError) as told:
            extensions.rows(*TABLES[next(iter(groups))])
    finally:
        for cache in caches:
            cache.cache_clear()
    assert re.fullmatch(f"entry point {said}", str(told.value))


def test_two_packages_with_the_same_row_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for package in ("my_extension", "another"):
        install(tmp_path, {}, {"facts_damping.indices": POINTS}, package)
    monkeypatch.syspath_prepend(str(tmp_path))
    extensions.every.cache_clear()
    with pytest.raises(InputError, match=r"the name is taken; .* that of entry point proportional = one:ROW .*\("):
        extensions.every()


def test_a_command_ends_with_that_line(tmp_path: Path) -> None:
    install(tmp_path, {"one.py": ""}, {"facts_damping.controllers": POINTS})
    command = [sys.executable, "-m", "facts_damping", "simulate", "two_area_small"]
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}:{ROOT}"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert re.fullmatch(r"facts-damping: entry point proportional = one:ROW .*\n", done.stderr)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_takes_them(carried: Carried, name: str) -> None:
    told = carried.told[name]
    assert told.status == 0
    compiles = r"(compiling \d+ numerical kernels, once on this machine: seconds\n)*"  # those that the blocks change
    assert re.fullmatch(compiles + (SMALL_BUDGET if name == "search" else ""), told.errors)


def test_they_are_listed(carried: Carried) -> None:
    assert {"proportional", "ANFShMoC"} <= {
        line.split()[0] for line in carried.told["list controllers"].out.splitlines()
    }


def test_a_graph_of_nodes_gives_the_figures_of_the_run_in_process(carried: Carried) -> None:
    """And its recording those of the graph."""
    computed, ran, (analysed,) = carried.json("simulate.json"), carried.json("run.json"), carried.json("analyze.json")
    assert computed["indices"] == ran["indices"] == analysed["indices"]
    assert computed["indices"]["IT2AE"] > 0.0
    assert "IT2AE" in carried.told["simulate"].out
    assert "IT2AE" in (carried.folder / "report.html").read_text(encoding="utf-8")


def test_the_device_moves_and_has_a_state(carried: Carried) -> None:
    found = carried.json("modes.json")
    assert any("source.iq" in mode["participation"] for mode in found["modes"])
    record = load(carried.folder / "ran" / "recording")
    assert np.ptp(record.devices["setpoint"][:, record.device_names.index("source")]) > 0.0
    assert np.ptp(record.devices["reactive_power"][:, record.device_names.index("source")]) > 0.0


def test_a_linear_law_moves_the_modes_and_delay_moves_them_back(carried: Carried) -> None:
    """Without delay it damps the interarea mode, which grows without control; with 0.2 s it damps it less."""
    free = next(mode["real"] for mode in carried.json("modes.json")["modes"] if mode["label"] == "interarea")
    without, *_, late = (row["modes"][0]["real"] for row in carried.json("margin.json")["delays"])
    assert without < late < 0.0
    assert free > 0.0


def test_tuning_and_search_choose_its_gain_within_its_range(carried: Carried) -> None:
    (tuned,) = carried.json("tune.json")["controllers"]
    assert 1.0 <= tuned["parameters"]["K"] <= 200.0
    names = {row["controller"] for row in carried.json("search.json")["ranking"]}
    assert names == {"LLC-tuned", "proportional", "sech+parabolic"}


def test_studies_have_the_index_and_the_controllers(carried: Carried) -> None:
    rows = carried.json("sweep.json")["rows"]
    assert [row["controller"] for row in rows] == ["proportional", "proportional", "LLC", "LLC"]
    assert all(row["IT2AE"] > 0.0 and row["error"] is None for row in rows)
    compared = {row["controller"] for row in carried.json("compare.json")["rows"]}
    assert compared == {"none", "LLC", "proportional", "ANFShMoC"}
    assert "| controller | scheme | ITAE | IT2AE |" in carried.told["sweep"].out


def test_an_lqg_is_designed_for_the_mean_of_its_links_delay(carried: Carried) -> None:
    """0.02 s and 0.03 s up, 0.05 s down."""
    found, told, without = (carried.json(f"{name}.json")["indices"] for name in ("lqg", "lqg_1", "lqg_0"))
    assert found == pytest.approx(told, rel=1e-9)
    assert found["ITAE"] != pytest.approx(without["ITAE"], rel=1e-3)
