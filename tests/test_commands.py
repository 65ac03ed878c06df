"""Every command block of README and docs, in its order, as a user types it; long ones cut short by options.

Then the Python of the page, which prints what stands below it. All is run in this process, graphs on the loopback.

A page has a folder of its own, in which `config`, `examples` and `tests` of the checkout are. Other programs are not
run: `make`, `git`, `pip` and others change what these tests run in, nodes by themselves are in tests/nodes, those of
ROS 2 are not among the wheels. A command that an earlier page has, too, is only parsed, unless the page goes on with
what it leaves.
"""

from __future__ import annotations

import os
import re
import runpy
import shlex
import sys
from contextlib import nullcontext
from itertools import pairwise, takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest

from facts_damping.cli.main import DEGRADED, main
from facts_damping.cli.parser import parser
from facts_damping.parameters.yaml_text import dump, parse
from facts_damping_studies.score.cases import own_grid
from facts_damping_studies.search import search, tune
from facts_damping_studies.sweeps import sweep
from facts_damping_testing.loopback.opening import opened
from tests.andes_cases import WHEEL

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).parents[1]
LAST = ("commands", "fields")  # which repeat what others have
PAGES = {page.stem: page for page in sorted((ROOT / "docs").glob("*.md"), key=lambda path: (path.stem in LAST, path))}
PAGES = {"README": ROOT / "README.md", **PAGES}
PROGRAM = "facts-damping"
PYTHON = re.compile(r"^```python\n(.*?)^```$(?:\n\n^```text\n(.*?)^```$)?", re.DOTALL | re.MULTILINE)
END = "\f\n"  # after what a block prints
# First words of what is parsed only, and options: who runs it.
PARSED = {
    "bench": "other programs",
    "validate": "tests/validation",
    "reproduce": "tests/reproduction",
    "locate": "needs a record of many seconds: tests/recording/test_locate.py",
    "cockpit": "serves a page until it is ended: tests/views/cockpit",
    "pmu-serve": "waits for a client: tests/streams/streaming",
    "pmu-listen": "needs a server: tests/nodes/test_streams.py",
    "--time-domain": "tests/studies/test_linear_margin.py",
    "--hunt": "tests/studies/test_hunt.py",
}
SHORT = {
    "simulate": ["--set", "duration=1"],
    "run": ["--set", "duration=1"],
    "margin": ["--max-delay", "0.1"],
    "tune": ["--budget", "1"],
    "search": ["--budget", "1"],
    "score": ["--cases", "few_cases.yaml"],
    "compare": ["--seeds", "3", "--budget", "0"],
    "campaign": ["--draws", "2", "--graphs", "0"],
    "design": ["--outages", "1"],
}
ONE_LAW = ["--law", "lead-lag"]  # of a design that names none, in place of all: tests/studies/test_robust_design.py
GRAPHS = ("run", "replay")
LONGER = {"modes": ["--set", "duration=2"]}  # its distributions need 1.6 s
ON_DDS = {"README": "as users have it", "extensions": "a node that is a process of its own"}


def blocks(text: str) -> Iterator[tuple[str, bool]]:
    """The commands of a page in order, each with whether it is to fail: an error is shown below it."""
    outside = re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
    lines = [line[4:] if line.startswith("    ") else "" for line in outside.splitlines()]
    joined = re.sub(r"\\\n\s*", " ", "\n".join(lines)).splitlines()
    for i, line in enumerate(joined):
        below = joined[i + 1 :]
        command = line.removeprefix("$ ")
        if command.split(" ", 1)[0] in (PROGRAM, "cd"):
            yield command, any(below_line.startswith(f"{PROGRAM}: ") for below_line in takewhile(str.strip, below))


def files(page: str) -> dict[str, str]:
    """The YAML of a page by the names of its files; blocks of the tutorial that have none go on with the first."""
    texts: dict[str, str] = {}
    for block in re.findall(r"^```yaml\n(.*?)^```$", text_of(page), re.MULTILINE | re.DOTALL):
        named = re.match(r"# ([\w/]+\.yaml)\b", block)
        if named or (page == "tutorial_grid" and texts):
            name = named[1] if named else next(iter(texts))
            texts[name] = texts.get(name, "") + block
    return texts


def status_of(arguments: list[str]) -> int:
    """The exit status of a command; help and version end it in their own way."""
    try:
        return main(arguments)
    except SystemExit as end:
        return int(end.code or 0)


def few_cases() -> dict[str, Any]:
    """A case of each kind for scores, and two controllers to rank."""
    case_set: dict[str, Any] = parse((ROOT / "tests" / "data" / "case_set.yaml").read_text(encoding="utf-8"))
    return case_set | {"kinds": dict.fromkeys(case_set["kinds"], 1)}


def text_of(page: str) -> str:
    return PAGES[page].read_text(encoding="utf-8")


def python(page: str) -> list[tuple[str, str]]:
    """All Python of a page, and what it prints, where that is shown."""
    return re.findall(PYTHON, text_of(page))


def shortened(arguments: list[str], page: str) -> list[str]:
    """The same command with less to do."""
    name = arguments[0]
    if name == "sweep":
        namespace = parser().parse_args(arguments)
        sets = [*([f"profile={namespace.profile}"] if namespace.profile else []), *namespace.set]
        first = sweep.plan(namespace.study, sets, namespace.only).points[0].columns
        only = [part for column, value in first.items() for part in ("--only", f"{column}={value}")]
        return [*arguments, *only, "--set", "duration=1"]
    if name == "score" and "--system" in arguments:  # a set of its own, which `folder` makes short
        return arguments
    law = ONE_LAW if name == "design" and "--law" not in arguments else []
    return [*arguments, *SHORT.get(name, []), *law, *(LONGER.get(page, []) if name == "run" else [])]


WRITES = ("--out", "--json", "--linear", "--report")  # options that name files


class Step(NamedTuple):
    """A command of a page, and whether it runs here."""

    arguments: list[str]
    fails: bool
    runs: bool


def steps(page: str, before: set[str]) -> list[Step]:
    """The commands of a page; `before`: what those of earlier pages do, to which theirs is added."""
    origins, folder, found_steps = files(page), "", []
    for command, fails in blocks(text_of(page)):
        word, *arguments = shlex.split(command, comments=True)
        if word == "cd":
            folder, arguments = arguments[0], ["cd", *arguments]
        elif not arguments or arguments[0] == "COMMAND":
            continue
        written = {value for option, value in pairwise(arguments) if option in WRITES} - {"-"}
        written |= set(arguments[2:3]) if arguments[0] == "new" else set()
        does = " ".join([folder, *(argument for argument in arguments if argument not in written)])
        read = {name for name in origins if name in does}
        for name, origin in origins.items():  # the same name may be another file on another page
            does = does.replace(name, origin)
        origins |= dict.fromkeys(written, does)
        found_steps.append((Step(arguments, fails, does not in before), written, read))
        before.add(does)
    wanted, chosen = {name for name in origins if any(name in code for code, _ in python(page))}, []
    for step, written, read in reversed(found_steps):
        runs = step.runs or step.arguments[0] in ("cd", "new") or not written.isdisjoint(wanted)
        runs &= PARSED.keys().isdisjoint(step.arguments)
        wanted |= read if runs else set()
        chosen.append(step._replace(runs=runs))
    return chosen[::-1]


_BEFORE: set[str] = set()
STEPS = {page: steps(page, _BEFORE) for page in PAGES}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in ("config", "examples", "tests"):
        (tmp_path / name).symlink_to(ROOT / name)
    (tmp_path / "andes_wheel").symlink_to(WHEEL)  # which tutorial_psse fetches
    (tmp_path / "few_cases.yaml").write_text(dump(few_cases()), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")  # as the environment does
    monkeypatch.setattr(os, "cpu_count", lambda: 1)  # all runs in this process
    monkeypatch.setattr(own_grid, "KINDS_OF_A_SET", {"nominal": 1})
    monkeypatch.setattr(own_grid, "BESIDE", ())
    for study in (search, tune):
        monkeypatch.setattr(study, "POPULATION", 5)
    return tmp_path


@pytest.mark.parametrize(
    "page", [pytest.param(page, marks=pytest.mark.xdist_group(f"commands {page}")) for page in STEPS]
)
def test_commands_of_a_page_run_in_their_order(
    page: str, folder: Path, request: pytest.FixtureRequest, capsys: pytest.CaptureFixture[str]
) -> None:
    if page in ON_DDS:
        request.getfixturevalue("domain")
    for name, content in files(page).items():
        (folder / name).write_text(content, encoding="utf-8")
    for arguments, fails, runs in STEPS[page]:
        if arguments[0] == "cd":
            if Path(arguments[1]).is_dir():
                os.chdir(arguments[1])
        elif runs:
            with nullcontext() if page in ON_DDS or arguments[0] not in GRAPHS else opened():
                status = status_of(arguments if fails else shortened(arguments, page))
            captured = capsys.readouterr()
            assert status != 0 if fails else status in (0, DEGRADED), (arguments, captured.err)
        else:
            parser().parse_args(arguments)
    os.chdir(folder)
    script = folder / "page.py"
    script.write_text(f"\n\nprint({END[0]!r})\n".join([*(code for code, _ in python(page)), ""]), encoding="utf-8")
    runpy.run_path(str(script), run_name="__main__")
    printed = capsys.readouterr().out.split(END)
    assert all(shown in ("", said) for (_, shown), said in zip(python(page), printed, strict=False)), printed


def test_blocks_are_found() -> None:
    assert sum(step.runs for each in STEPS.values() for step in each) > 150
