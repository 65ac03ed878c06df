"""Controllers in processes of their own: the same setpoints bit for bit, the same errors, and what they cost."""

from __future__ import annotations

import errno
import json
import os
import shutil
import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.analysis.response import MIRROR
from facts_damping.case.loading import load_case
from facts_damping.errors import FactsDampingError
from facts_damping.simulation import loop
from facts_damping.simulation.twins import twin
from facts_damping_studies.score import measure as scoring
from facts_damping_studies.score.cases.sets import case_of, read_set
from facts_damping_studies.score.isolation import isolated as isolation
from facts_damping_studies.score.isolation.isolated import isolated
from facts_damping_studies.score.isolation.processes import Template, template
from facts_damping_studies.score.isolation.readable import imported
from facts_damping_studies.score.isolation.system_calls import (
    ALLOW,
    ALLOWED,
    ANY_BIT,
    AT_LEAST,
    EQUAL,
    FAIL,
    FATAL,
    KILL,
    LOAD,
    MACHINES,
    RETURN,
    Step,
    steps_of,
)
from tests.lead_lag_fmu import build

if TYPE_CHECKING:
    from facts_damping.case.model import Case
    from facts_damping.record import Record

ROOT = Path(__file__).parents[2]
LAWS = Path(__file__).parent / "bad_laws"


def case_with(rows: list[dict[str, Any]], *sets: str) -> Case:
    return load_case("two_area_large", ["duration=2", "link=pdci", f"controllers={json.dumps(rows)}", *sets])


def runs_of(case: Case) -> list[Record]:
    """The run, and its twin with noise of the opposite sign."""
    record = loop.run(case)
    mirror = twin(case, record, MIRROR)
    return [record] if mirror is None else [record, mirror.record]


def assert_same(case: Case) -> list[isolation.Child]:
    """Setpoints and speeds of the run and of its twin are those in process; returns what the controllers did."""
    with isolated(case, case.run.seed) as (case_isolated, children):
        others = runs_of(case_isolated)
    for record, other in zip(runs_of(case), others, strict=True):
        assert len(record.issued) > 50
        assert record.issued["value"].std() > 0.0
        assert other.issued.tobytes() == record.issued.tobytes()
        assert other.machines.tobytes() == record.machines.tobytes()
    return children


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a law, a module and data that it reads."""
    shutil.copy(LAWS / "lawful.py", tmp_path)
    (tmp_path / "helper.py").write_text("def gain_of(parameters):\n    return parameters['gain']\n")
    np.savez(tmp_path / "weights.npz", weights=np.array([1.5]))
    np.savez(tmp_path / "damper.npz", weights=np.linspace(0.5, 2.0, 8))
    shutil.copy(ROOT / "examples" / "trained_damper.py", tmp_path)
    return tmp_path


LEAD_LAG = {"name": "mine", "policy": f"{ROOT / 'examples' / 'lead_lag.py'}:LeadLag", "parameters": {"gain": 12}}


def test_shipped_lead_lag_is_the_same_bit_for_bit_in_a_process_of_its_own() -> None:
    (child,) = assert_same(case_with([LEAD_LAG]))
    assert child.name == "mine"
    assert child.breach == ""
    assert 0.0 < child.computing < 0.5
    assert 0.0 < child.slowest_s < 1.0


def test_class_that_uses_all_that_it_may_is_the_same_in_run_and_twin(folder: Path) -> None:
    """Random numbers of its seed, the plant, a module and data beside it; two of them; noise; once a tick."""
    row = {"policy": f"{folder}/lawful.py:Lawful", "parameters": {"gain": 2.0}}
    rows = [{"name": "a", "devices": ["sssc"], **row}, {"name": "b", "devices": ["statcom"], **row}]
    children = assert_same(case_with(rows, "devices=[sssc, statcom]", "load_noise.std=0.01", "seed=3"))
    assert [child.name for child in children] == ["a", "b", "a", "b"]  # of the run, and of its twin


def test_trained_policy_is_the_same_once_a_tick(folder: Path) -> None:
    row = {"name": "trained", "policy": f"{folder}/trained_damper.py:TrainedDamper"}
    assert_same(case_with([{**row, "parameters": {"weights": str(folder / "damper.npz")}}]))


@pytest.mark.parametrize("version", [2, 3])
def test_fmu_is_the_same(tmp_path: Path, version: int) -> None:
    shutil.copy(ROOT / "examples" / "lead_lag.py", tmp_path)  # which the FMU's code imports
    fmu = build(tmp_path, tmp_path, version)
    assert_same(case_with([{"name": "mine", "fmu": str(fmu), "parameters": {"gain": 12}}]))


def test_measure_of_a_case_is_the_same() -> None:
    """With its twin, in a case of a set."""
    case = case_of(read_set(str(ROOT / "tests" / "data" / "case_set.yaml")), [LEAD_LAG], 0)
    measured, seen = scoring.measure(case, 8.0, case.run.seed)
    assert measured._replace(computing=0.0) == scoring.as_on_card(scoring._measured(case, 8.0))
    assert measured.effort > 0.0
    assert 0.0 < measured.computing < 1.0
    assert seen == scoring.Seen(frozenset([str(ROOT / "examples" / "lead_lag.py")]), plant=False)


def test_libraries_of_a_file_are_loaded_before_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "law.py").write_text(
        "import os, scipy.signal, entrant\nfrom numpy import random, f2py\nfrom numpy.f2py import __main__\n"
        "from . import beside\nfrom entrant import law\n"
    )
    names = imported(f"{tmp_path}/law.py:Law")
    assert names == ["scipy.signal", "numpy", "numpy.random", "numpy.f2py"]
    assert imported("law:Law") == imported(None) == imported(f"{tmp_path}/none.py:Law") == []


def test_case_without_programs_runs_as_it_is() -> None:
    case = case_with([{"name": "LLC"}])
    with isolated(case, 1) as (same, children):
        assert same.controllers == case.controllers
        assert loop.run(same).issued.tobytes() == loop.run(case).issued.tobytes()
    assert children == []


ERRORS = {
    "raises": "class Mine:\n def __init__(self, spec): pass\n def step(self, t_s, y, age_s, fresh): return 1 / 0",
    "shape": "class Mine:\n def __init__(self, spec): pass\n def step(self, t_s, y, age_s, fresh): return [1, 2]",
    "none": "class Mine:\n def __init__(self, spec): pass\n def step(self, t_s, y, age_s, fresh): return None",
    "text": "class Mine:\n def __init__(self, spec): pass\n def step(self, t_s, y, age_s, fresh): return 'a'",
    "nan": "class Mine:\n def __init__(self, spec): pass\n def step(self, t_s, y, age_s, fresh): return float('nan')",
    "signature": "class Mine:\n def __init__(self, spec): pass\n def step(self, y): return y",
    "no step": "class Mine:\n def __init__(self, spec): pass",
    "built": "class Mine:\n def __init__(self, spec): spec.parameters['gain']",
    "syntax": "class Mine(:",
    "no class": "class Other:\n def step(self): pass",
    "exit": "import os\nclass Mine:\n def __init__(self, spec): os._exit(0)",
}


@pytest.mark.parametrize("text", ERRORS.values(), ids=ERRORS)
def test_errors_are_those_in_process(tmp_path: Path, text: str) -> None:
    (tmp_path / "mine.py").write_text(text)
    case = case_with([{"name": "mine", "policy": f"{tmp_path}/mine.py:Mine"}])
    with pytest.raises(FactsDampingError) as here:
        loop.run(case)
    with pytest.raises(FactsDampingError) as there, isolated(case, case.run.seed) as (case_isolated, _):
        loop.run(case_isolated)
    assert str(there.value) == str(here.value)
    assert type(there.value) is type(here.value)


def test_class_of_a_module_is_looked_for_where_the_run_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "laws_of_mine"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "helper.py").write_text("GAIN = 2.0\n")
    (package / "law.py").write_text(
        "from laws_of_mine.helper import GAIN\nclass Law:\n def __init__(self, spec): pass\n"
        " def step(self, t_s, y, age_s, fresh): return GAIN * y\n"
    )
    monkeypatch.chdir(tmp_path)
    assert_same(case_with([{"name": "mine", "policy": "laws_of_mine.law:Law"}]))


def test_file_that_comes_after_the_first_run_is_not_read(tmp_path: Path) -> None:
    """As a card or a recording would, where one writes them beside the class."""
    (tmp_path / "mine.py").write_text(
        "from pathlib import Path\nclass Mine:\n path = Path(__file__).with_name('late')\n"
        " def __init__(self, spec):\n  if self.path.exists(): self.path.read_bytes()\n"
        " def step(self, t_s, y, age_s, fresh): return 0.0\n"
    )
    case = case_with([{"name": "mine", "policy": f"{tmp_path}/mine.py:Mine"}])
    with isolated(case, 1) as (case_isolated, _):
        loop.run(case_isolated)
    (tmp_path / "late").write_text("1")
    with pytest.raises(isolation.BreachError, match=r"mine opened .*late"), isolated(case, 1) as (case_isolated, _):
        loop.run(case_isolated)
    os.utime(tmp_path / "mine.py", ns=(0, 1))  # the user goes on with the class
    with isolated(case, 1) as (case_isolated, _):
        loop.run(case_isolated)


def test_computing_and_waiting_are_measured_from_outside() -> None:
    """At 60 steps/s, 2 ms of computing and 2 ms of sleep each; longer on a loaded machine."""
    row = {"name": "mine", "policy": f"{LAWS}/cheats.py:Busy", "devices": ["sssc"]}
    case = case_with([row], "link=ideal")
    with isolated(case, 1) as (case_isolated, children):
        loop.run(case_isolated)
    (child,) = children
    assert child.computing > 0.05
    assert child.slowest_s > 0.0015
    assert child.waiting > 0.2
    assert child.waiting > child.computing


def test_template_that_ends_ends_its_processes() -> None:
    other = Template()
    connection = other.fork([], None)
    os.kill(connection.process, 0)
    other.close()
    with pytest.raises(ProcessLookupError):
        os.kill(connection.process, 0)
    connection.close()


def test_processes_end_with_their_runs() -> None:
    case = case_with([LEAD_LAG])
    with isolated(case, 1) as (case_isolated, _):
        loop.run(case_isolated)
        assert len(children_of(template().process)) == 1
        loop.run(case_isolated)
    assert children_of(template().process) == []


def children_of(process: int) -> list[str]:
    """Process numbers of what a process has started and not yet waited for."""
    return Path(f"/proc/{process}/task/{process}/children").read_text().split()


@pytest.mark.parametrize("machine", MACHINES)
def test_filter_decides_on_each_call_of_its_tables(machine: str) -> None:
    """By a machine as the kernel has it (Documentation/networking/filter.rst), for both processors."""
    column, interface = MACHINES[machine]
    steps = steps_of(machine, threads=False)
    assert len(steps) < 4096  # the kernel's limit
    for action, table in ((ALLOW, ALLOWED), (KILL, FATAL)):
        for row in table.split(","):
            number = int(row.split()[1 + column])
            assert number < 0 or decide(steps, number, interface) == action, row
    openat, fcntl, prlimit, ioctl = ((257, 72, 302, 16), (56, 25, 261, 29))[column]
    readonly = os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK | os.O_DIRECTORY
    assert decide(steps, openat, interface, (0, 0, readonly)) == ALLOW
    for flag in (os.O_WRONLY, os.O_RDWR, os.O_CREAT, os.O_TRUNC, os.O_TMPFILE | os.O_RDWR):
        assert decide(steps, openat, interface, (0, 0, flag)) == FAIL | errno.EACCES
    assert [decide(steps, fcntl, interface, (0, command)) == ALLOW for command in (0, 4, 1030, 5, 6, 1024, 8)] == [
        *[True] * 3,
        *[False] * 4,
    ]
    assert decide(steps, prlimit, interface, (0, 7, 0)) == ALLOW
    assert decide(steps, prlimit, interface, (0, 7, 1 << 40)) == FAIL | errno.EACCES
    assert decide(steps, ioctl, interface) == FAIL | errno.ENOTTY
    assert decide(steps, 999, interface) == FAIL | errno.ENOSYS
    assert decide(steps, 1, 0x40000003) == KILL  # of another interface
    clone, clone3 = ((56, 435), (220, 435))[column]
    native = steps_of(machine, threads=True)
    assert [decide(native, clone, interface, (flags,)) for flags in (0x3D0F00, 0x11)] == [ALLOW, KILL]  # thread, fork
    assert decide(native, clone3, interface) == FAIL | errno.ENOSYS
    if machine == "x86_64":
        assert decide(steps, 0x40000000 + 41, interface) == KILL


def decide(steps: list[Step], number: int, interface: int, arguments: tuple[int, ...] = ()) -> int:
    """What a filter returns for a call."""
    data = struct.pack("=IIQ6Q", number, interface, 0, *arguments, *[0] * (6 - len(arguments)))
    value, at = 0, 0
    while True:
        operation, operand, if_true, if_false = steps[at]
        at += 1
        if operation == LOAD:
            value = struct.unpack_from("=I", data, operand)[0]
        elif operation == RETURN:
            return operand
        else:
            holds = {EQUAL: value == operand, AT_LEAST: value >= operand, ANY_BIT: bool(value & operand)}[operation]
            at += if_true if holds else if_false
