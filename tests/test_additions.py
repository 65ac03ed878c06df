"""A device, controller, stage, event, index, node and command, added as the pages write them out, then used.

The blocks of CONTRIBUTING.md go into a copy of the checkout, beside which the package of docs/extensions.md is
installed. One process gives every command that meets them, graphs on the loopback, and runs the tests among the blocks.
"""

from __future__ import annotations

import ast
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from facts_damping import extensions
from facts_damping.recording import load
from tests.additions import Block, blocks, carry_out, install

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
EXTENSIONS = (ROOT / "docs" / "extensions.md").read_text(encoding="utf-8")
CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
CORE = blocks(CONTRIBUTING)
TABLE = CONTRIBUTING.partition("\n## Where to add\n")[2].partition("\n## ")[0]
FILES = {block.file: block.text for block in blocks(EXTENSIONS)}
PROJECT = tomllib.loads("".join(re.findall(r"```toml\n(.*?)```", EXTENSIONS, re.DOTALL)))["project"]

LINK = "{up: [{model: exponential, delay: 0.02, mean: 0.03}], down: [{delay: 0.05}]}"
EVENT = "{time: 0.1, kind: load_shedding, bus: B9, fraction: 0.1}"
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
help: --help
list controllers: list controllers
simulate: simulate own.yaml --out simulated --json simulate.json
run: run own.yaml --out ran --json run.json
peaks: peaks ran/recording
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
SMALL_BUDGET = r"--budget 10: only the first 16 points of 4 structures are tried: 64 closed loops; .*\n"
COMMANDS = {name: shlex.split(text) for name, text in (line.split(": ", 1) for line in GIVEN.strip().splitlines())}
SCRIPT = """
import contextlib, io, json, sys, traceback
import pytest
from facts_damping.cli.main import main
from facts_damping_testing.loopback.opening import opened

told = {}
pytests = ["-q", "-n", "0", "-p", "no:cacheprovider", "--rootdir", *sys.argv[1:]]
for name, given in {**json.load(open("commands.json")), "tests": pytests}.items():
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            with opened() if name in ("run", "replay") else contextlib.nullcontext():
                status = (pytest.main if name == "tests" else main)(given)
        except SystemExit as end:
            status = end.code or 0
        except Exception:
            status = -1
            err.write(traceback.format_exc()[-1000:])
    told[name] = [int(status), out.getvalue(), err.getvalue()]
    json.dump(told, open("told.json", "w"))
"""
TESTS = [block.file for block in CORE if block.file.startswith("tests/")]
COPIED = ("facts_damping", "extensions", "tests", "setup.py", "pyproject.toml", "package.xml")


class Told(NamedTuple):
    """What a command said."""

    status: int
    out: str
    errors: str


class Carried(NamedTuple):
    """The folder in which the commands were given, the copy of the checkout, and what each command said."""

    folder: Path
    copy: Path
    told: dict[str, Told]

    def json(self, name: str) -> Any:
        """What a command wrote."""
        return json.loads((self.folder / name).read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def carried(tmp_path_factory: pytest.TempPathFactory) -> Carried:
    root, folder, copy = (tmp_path_factory.mktemp(name) for name in ("installed", "commands", "checkout"))
    install(root, FILES, PROJECT["entry-points"])
    for name in COPIED:  # with what is compiled of them
        (shutil.copytree if (ROOT / name).is_dir() else shutil.copy2)(ROOT / name, copy / name)
    (copy / "config").symlink_to(ROOT / "config")
    carry_out(copy, CORE)
    grid = (ROOT / "config" / "systems" / "two_area.yaml").read_text(encoding="utf-8")
    device = "  - {name: source, kind: current_source, bus: B8W, setpoint_max: 0.5, rate_max: 5}\n"
    grid_text = re.sub(r"(\ndevices:.*\n)", rf"\1{device}", grid.replace("name: two_area", "name: my_grid", 1), count=1)
    assert grid_text.count("my_grid") == grid_text.count("current_source") == 1
    step = f"name: step\nduration: 1\nevents: [{EVENT}]\n"
    texts = {
        "my_grid.yaml": grid_text,
        "step.yaml": step,
        "own.yaml": RUN,
        "own_study.yaml": STUDY,
        "own_link.yaml": LINK,
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    (folder / "commands.json").write_text(json.dumps(COMMANDS), encoding="utf-8")
    path = f"{root}:{copy}:{os.environ.get('PYTHONPATH', '')}".rstrip(":")
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(copy), *(str(copy / name) for name in TESTS)],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
        timeout=1000,
    )
    assert done.returncode == 0, done.stderr[-1000:]
    outcomes = json.loads((folder / "told.json").read_text())
    return Carried(folder, copy, {name: Told(*said) for name, said in outcomes.items()})


def test_page_has_a_row_for_every_group_and_a_file_for_every_row() -> None:
    more = set(re.findall(r"^\| `(facts_damping\.\w+)` \| ", EXTENSIONS, re.MULTILINE))
    assert set(PROJECT["entry-points"]) | more | {"facts_damping.policies"} == {
        f"facts_damping.{g}" for g in extensions.GROUPS
    }
    named = {value.partition(":")[0] for points in PROJECT["entry-points"].values() for value in points.values()}
    assert {name.removesuffix(".py").replace("/", ".") for name in FILES} == named
    assert len(FILES) == EXTENSIONS.count("```python\n")


def test_row_of_the_table_leads_to_what_is_there() -> None:
    """Its files, and the tables in them; its tests; its page."""
    rows = [[cell.strip() for cell in row.split("|")[1:-1]] for row in re.findall(r"^\| an? .*$", TABLE, re.MULTILINE)]
    assert len(rows) == 12
    for _, places, tests, page in rows:
        for tables, file in re.findall(r"((?:`\w+`, )*)`([\w/]+\.py)`", places):
            candidates = [top / file for top in (ROOT, ROOT / "facts_damping", ROOT / "extensions")]
            text = next(path for path in candidates if path.is_file()).read_text(encoding="utf-8")
            for name in re.findall(r"\w+", tables):
                assert re.search(rf"^(def )?{name}\b", text, re.MULTILINE), (file, name)
        for name, file in re.findall(r"(?:`([A-Z]\w+)`, )?`([\w/.]+)`", tests):
            path = ROOT / "tests" / file
            assert path.exists(), file
            assert not name or re.search(rf"^(class )?{name}\b", path.read_text(encoding="utf-8"), re.MULTILINE), name
        for file, anchor in re.findall(r"\]\((docs/\w+\.md)?#([\w-]+)\)", page):
            text = (ROOT / file).read_text(encoding="utf-8") if file else CONTRIBUTING
            headings = re.findall(r"^## (.*)$", text, re.MULTILINE)
            assert anchor in [re.sub(r"[^\w ]", "", heading).lower().replace(" ", "-") for heading in headings], anchor


@pytest.mark.parametrize(
    ("block", "said"),
    [
        (Block("b.py", "", "y = 1\n"), None),
        (Block("a.py", "after: y = 2", "z = 3\n"), "a.py: after: y = 2: 0 such lines"),
        (Block("a.py", "beside: x = 1", "z = 3\n"), "a.py: beside: x = 1: 1 such lines"),
        (Block("a.py", "", "z = 3\n"), "a.py: it is there"),
        (Block("b.py", "at the end", "z = 3\n"), "b.py: no such file"),
    ],
)
def test_block_that_does_not_fit_is_told(block: Block, said: str | None, tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text("x = 1\n", encoding="utf-8")
    if said is None:
        carry_out(tmp_path, [block])
        return
    with pytest.raises(ValueError, match=f"^{re.escape(said)}$"):
        carry_out(tmp_path, [block])


@pytest.mark.parametrize("name", COMMANDS)
def test_commands_take_the_added_parts(carried: Carried, name: str) -> None:
    outcome = carried.told[name]
    assert outcome.status == 0
    compiles = r"(compiling \d+ numerical kernels, once on this machine: seconds\n)*"  # those that the blocks change
    assert re.fullmatch(compiles + (SMALL_BUDGET if name == "search" else ""), outcome.errors)


def test_added_controllers_are_listed(carried: Carried) -> None:
    assert {"proportional", "ANFShMoC"} <= {
        line.partition(" ")[0] for line in carried.told["list controllers"].out.splitlines()
    }


def test_graph_of_nodes_gives_the_figures_of_the_run_in_process(carried: Carried) -> None:
    """And its recording those of the graph."""
    computed, ran, (analysed,) = carried.json("simulate.json"), carried.json("run.json"), carried.json("analyze.json")
    assert computed["indices"] == ran["indices"] == analysed["indices"]
    assert computed["indices"]["IT2AE"] > 0.0
    assert "IT2AE" in carried.told["simulate"].out
    assert "IT2AE" in (carried.folder / "report.html").read_text(encoding="utf-8")


def test_device_moves_and_has_a_state(carried: Carried) -> None:
    modes = carried.json("modes.json")
    assert any("source.iq" in mode["participation"] for mode in modes["modes"])
    record = load(carried.folder / "ran" / "recording")
    assert np.ptp(record.devices["setpoint"][:, record.device_names.index("source")]) > 0.0
    assert np.ptp(record.devices["reactive_power"][:, record.device_names.index("source")]) > 0.0


def test_linear_law_moves_the_modes_and_delay_moves_them_back(carried: Carried) -> None:
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


def test_lqg_is_designed_for_the_mean_of_its_links_delay(carried: Carried) -> None:
    """0.02 s and 0.03 s up, 0.05 s down."""
    default, single, without = (carried.json(f"{name}.json")["indices"] for name in ("lqg", "lqg_1", "lqg_0"))
    assert default == pytest.approx(single, rel=1e-9)
    assert default["ITAE"] != pytest.approx(without["ITAE"], rel=1e-3)


def test_event_acts_and_is_published(carried: Carried) -> None:
    (event,) = load(carried.folder / "ran" / "recording").events
    assert (event.kind, event.element) == ("load_shedding", "B9")


def test_stage_delays_by_chance_but_never_less_than_its_delay(carried: Carried) -> None:
    delivered = load(carried.folder / "ran" / "recording").delivered
    delays = (delivered["arrival_ns"] - delivered["measured_ns"]) * 1e-9
    assert delays.min() >= 0.02
    assert np.ptp(delays) > 0.03


def test_command_is_listed_and_prints_the_largest_setpoints(carried: Carried) -> None:
    assert re.search(r"^ +peaks +Print the largest setpoint", carried.told["help"].out, re.MULTILINE)
    record = load(carried.folder / "ran" / "recording")
    largest = np.abs(record.devices["setpoint"]).max(axis=0)
    lines = [f"{name}: {value:.4f} p.u." for name, value in zip(record.device_names, largest, strict=True)]
    assert carried.told["peaks"].out.splitlines() == lines


def test_node_is_an_executable(carried: Carried) -> None:
    tree = ast.parse((carried.copy / "setup.py").read_text(encoding="utf-8"))
    values = {
        ast.unparse(statement.targets[0]): statement.value
        for statement in tree.body
        if isinstance(statement, ast.Assign)
    }
    nodes = eval(ast.unparse(values["NODES"]))
    executables = (carried.copy / "facts_damping" / "nodes" / "executables.py").read_text(encoding="utf-8")
    functions = re.findall(r"^(?:def )?([a-z]\w+)(?:\(\) -> None:| = entry_point)", executables, re.MULTILINE)
    assert set(nodes) == set(functions)
    script = f"from facts_damping.nodes.executables import {nodes[-1]} as start; start()"
    command, path = [sys.executable, "-c", script, "--help"], f"{carried.copy}:{os.environ.get('PYTHONPATH', '')}"
    environment = {**os.environ, "PYTHONPATH": path.rstrip(":")}
    done = subprocess.run(command, cwd=carried.folder, env=environment, capture_output=True, text=True, check=False)
    assert done.stdout.startswith(f"usage: ros2 run facts_damping {nodes[-1]} ")


def test_tests_of_event_and_node_pass(carried: Carried) -> None:
    """Those that the page adds, and those of the files that it adds them to."""
    outcome = carried.told["tests"]
    assert outcome.status == 0, outcome.out[-2000:]
