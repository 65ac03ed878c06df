"""Controllers that cheat at a score gain nothing, or are disqualified with a sentence that says what they did."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from facts_damping.analysis import indices
from facts_damping.case.loading import load_case
from facts_damping.errors import FactsDampingError
from facts_damping.input_files import share_folder
from facts_damping.simulation import loop
from facts_damping_studies.score.cases.sets import case_of, read_set
from facts_damping_studies.score.isolation import isolated as isolation
from facts_damping_studies.score.isolation.isolated import Child, Limits, breach_of, confinement, isolated

if TYPE_CHECKING:
    from facts_damping.case.model import Case
    from facts_damping.record import Record

LAWS = Path(__file__).parent / "bad_laws"
CASE_SET = str(share_folder() / "config" / "case_sets" / "two_area_2.0.yaml")


def holds(means: str) -> bool:
    """Whether this platform confines controllers by a means."""
    return any(name.startswith(means) for name in confinement())


def case_with(law: str, *sets: str, run: str = "two_area_large", **parameters: str) -> Case:
    """A case of 1 s with a law of a file in `bad_laws`, `file:Class`."""
    file, name = law.split(":")
    row = {"name": "mine", "policy": f"{LAWS / file}.py:{name}", "parameters": parameters}
    return load_case(run, ["duration=1", f"controllers={json.dumps([row])}", *sets])


def outcome(case: Case, seed: int = 5) -> tuple[Record | None, FactsDampingError | None, Child]:
    """The record of an isolated run or its error, and what the controller's process has done."""
    record, failure = None, None
    children: list[Child] = []
    try:
        with isolated(case, seed) as (case_isolated, children):
            record = loop.run(case_isolated)
    except FactsDampingError as error:
        failure = error
    (child,) = children
    return record, failure, child


def seen_in(case: Case, seed: int = 5) -> Any:
    """What a spy has seen, which it says in its error."""
    _, failure, child = outcome(case, seed)
    text = str(failure)
    assert "ValueError: saw " in text
    assert child.breach == ""
    return json.JSONDecoder().raw_decode(text.partition("ValueError: saw ")[2])[0]


def breach_in(case: Case) -> str:
    """What a controller is disqualified for: in its error, and in what its process has done."""
    record, failure, child = outcome(case)
    assert record is None
    assert failure is not None
    assert breach_of(failure) == child.breach
    assert child.breach in str(failure)
    return child.breach


# 1. Recognising the case, by what it gets: seed, plant, parameters, limits; and 2. by the time.


def test_all_that_a_controller_knows_is_the_same_in_cases_of_one_set() -> None:
    """Of another seed, scenario and noise, on an altered plant: of the plant it knows the model alone."""
    usual = case_with("spies:Spec", "model=two_area", "seed=1", run="two_area_small", gain="a")
    altered = case_with(
        "spies:Spec",
        *("model=two_area", "seed=2", "load_noise.std=0.01", "system.machines.0.H=9", "system.loads.0.P=1000"),
        *("system.devices.0.setpoint_max=0.2", "scenario=[{time: 0.7, kind: line_out, line: line_1}]"),
        gain="a",
    )
    assert usual.system != altered.system
    seen = seen_in(usual)
    assert seen["seed"] != 0
    assert seen["t_s"] == 0.0
    assert seen["parameters"] == {"gain": "a"}
    assert seen_in(altered) == seen
    without_model = seen_in(case_with("spies:Spec", "system.machines.0.H=9", gain="a"))
    assert without_model["plant"] != seen["plant"]  # that spies can tell plants apart


def test_seed_of_a_controller_is_no_mark_of_the_case() -> None:
    """In cases of a shipped set, each of which has its own seed; it is that from outside alone."""
    case_set = read_set("two_area_2.0")
    rows = [{"name": "mine", "policy": f"{LAWS}/spies.py:Spec"}]
    cases = [case_of(case_set, rows, i) for i in (0, 30, 60)]
    assert len({case.run.seed for case in cases}) == 3
    assert len({seen_in(case, 5)["seed"] for case in cases}) == 1
    assert len({seen_in(cases[0], seed)["seed"] for seed in range(3)}) == 3


def test_process_is_the_same_in_each_run() -> None:
    """Counters of the interpreter would tell the first run from the second; its addresses are at random."""
    case = case_with("spies:Process")
    first = seen_in(case)
    assert [seen_in(case) for _ in range(3)] == [first] * 3


# 3. Reading files of the package, the case set, cards, and what others have.


@pytest.mark.parametrize("law", ["cheats:Reads", "cheats:ReadsEarly"])
@pytest.mark.parametrize(
    "place",
    [
        CASE_SET,
        str(share_folder() / "config" / "systems" / "two_area.yaml"),
        __file__,
        "/etc/passwd",
        "/proc/1/environ",
    ],
)
def test_reading_a_file_is_a_breach(law: str, place: str) -> None:
    """Also where the class hides the error, and before the first step."""
    when = "as it was built" if law.endswith("Early") else "in step of mine at 0 s"
    assert breach_in(case_with(law, place=place)) == f"mine opened {place} ({when})"


def test_file_beside_a_class_is_read_as_it_is_built_or_not_at_all() -> None:
    place = str(LAWS / "lawful.py")
    assert (
        breach_in(case_with("cheats:Reads", place=place))
        == f"mine opened {place} after it was built (in step of mine at 0 s)"
    )
    _, failure, child = outcome(case_with("cheats:ReadsEarly", place=place))
    assert failure is None
    assert place in child.read


def test_link_beside_a_class_leads_to_no_case_set(tmp_path: Path) -> None:
    (tmp_path / "law.py").write_text((LAWS / "cheats.py").read_text())
    (tmp_path / "data.yaml").symlink_to(CASE_SET)
    row = {"name": "mine", "policy": f"{tmp_path}/law.py:Reads", "parameters": {"place": str(tmp_path / "data.yaml")}}
    case = load_case("two_area_large", ["duration=1", f"controllers={json.dumps([row])}"])
    assert "mine opened" in breach_in(case)


# 4. Slow thinking.


@pytest.mark.parametrize("law", ["Sleeps", "Spins", "SpinsEarly"])
def test_slow_thinking_is_a_breach(law: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(isolation, "LIMITS", Limits(build_s=1.0, step_s=0.5))
    assert "slow thinking" in breach_in(case_with(f"cheats:{law}"))


def test_steps_that_are_slow_together_are_a_breach(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each of 60 steps takes 4 ms."""
    monkeypatch.setattr(isolation, "LIMITS", Limits(run_s=0.1))
    assert "slow thinking" in breach_in(case_with("cheats:Busy"))


def test_thinking_between_steps_is_a_breach() -> None:
    assert "a thread" in breach_in(case_with("cheats:Threads"))  # by the hook or, in older Pythons, the kernel


def test_answer_before_the_question_is_a_breach() -> None:
    """Its process would go on while the run does: what it answers next is what it was not asked."""
    breach = outcome(case_with("cheats:Answers"))[2].breach
    assert breach.startswith("mine answered what it was not asked")
    assert "answered a message of 4294967295 bytes" in breach_in(case_with("cheats:Shouts"))


def test_memory_is_limited() -> None:
    _, failure, child = outcome(case_with("cheats:Hoards"))
    assert "MemoryError" in str(failure)
    assert child.breach == ""


# 5. State that lasts from one run to the next.


def test_nothing_that_a_run_leaves_is_there_in_the_next() -> None:
    case = case_with("spies:Memory")
    assert [seen_in(case) for _ in range(3)] == [[0] * 6] * 3


@pytest.mark.parametrize("law", ["Writes", "Makes"])
def test_file_left_for_later_is_a_breach(law: str, tmp_path: Path) -> None:
    for place in (tmp_path / "left", LAWS / "left"):
        breach = breach_in(case_with(f"cheats:{law}", place=str(place)))
        assert "to write" in breach or "changed files: os.mkdir" in breach
        assert not place.exists()


def test_memory_is_not_shared() -> None:
    record, failure, _ = outcome(case_with("cheats:Shares"))
    assert record is None
    assert failure is not None
    assert not Path("/dev/shm/facts_damping_left").exists()


# 6. and 7. Global state, and the package's functions.


def test_patching_the_package_changes_nothing_outside() -> None:
    before = indices.performance_indices, loop.run, open
    record, failure, child = outcome(case_with("cheats:Patches"))
    assert failure is None
    assert child.breach == ""
    assert (indices.performance_indices, loop.run, open) == before
    honest, _, _ = outcome(case_with("cheats:Cheat"))
    assert record is not None
    assert honest is not None
    assert record.machines.tobytes() == honest.machines.tobytes()


# 8. Reading the recorder and the plant.


def test_nothing_of_the_run_is_in_its_process() -> None:
    """No object of the case, in memory or in frames; no open file but its own; no other process; no system."""
    objects, files, processes, system = seen_in(case_with("spies:Objects"))
    assert objects == []
    assert files == [0, 1, 2, 3]
    assert processes == []
    assert not system


def test_memory_of_the_run_is_not_read() -> None:
    assert "opened /proc/" in breach_in(case_with("cheats:Traces"))


# 9. Network and programs; 10. native code.


@pytest.mark.parametrize(
    ("law", "sentence"),
    [
        ("Calls", "opened a socket: socket."),
        ("Starts", "started a program: subprocess.Popen"),
        ("Forks", "started a process: os.fork"),
        ("Kills", "sent a signal: os.kill"),
        ("Native", "called native code: ctypes.dlopen"),
    ],
)
def test_way_out_of_the_process_is_a_breach(law: str, sentence: str) -> None:
    assert f"mine {sentence}" in breach_in(case_with(f"cheats:{law}"))


@pytest.mark.parametrize("call", ["fork", "kill", "ptrace", "process_vm_readv", "shmget"])
@pytest.mark.skipif(not holds("seccomp"), reason="no filter of system calls here")
def test_kernel_ends_a_process_that_fools_the_audit_hook(call: str) -> None:
    assert "asked the kernel" in breach_in(case_with("cheats:Fools", call=call))


@pytest.mark.skipif(not holds("Landlock"), reason="no Landlock here")
def test_kernel_keeps_case_sets_from_a_process_that_fools_the_audit_hook() -> None:
    _, failure, _ = outcome(case_with("cheats:Fools", call="open", place=CASE_SET))
    assert "came back with -1" in str(failure)
    _, failure, _ = outcome(case_with("cheats:Fools", call="open", place=str(LAWS / "cheats.py")))
    assert "came back with 4" in str(failure)  # that it would have been opened


@pytest.mark.parametrize("call", ["creat", "mkdir", "unlink", "socket"])
@pytest.mark.skipif(not holds("seccomp"), reason="no filter of system calls here")
def test_kernel_refuses_what_fools_the_audit_hook(call: str, tmp_path: Path) -> None:
    _, failure, _ = outcome(case_with("cheats:Fools", call=call, place=str(tmp_path / "left")))
    assert "came back with -1" in str(failure)
    assert not (tmp_path / "left").exists()
    assert (LAWS / "cheats.py").exists()


def test_process_that_ends_itself_ends_the_run() -> None:
    _, failure, _ = outcome(case_with("cheats:Exits"))
    assert "the process of mine has ended by status 7, in step of mine at 0 s" in str(failure)


def test_platform_says_how_controllers_are_confined() -> None:
    means = confinement()
    assert means[0] == "memory 4 GB"
    assert means[-1] == "audit hook"
    assert set(means) <= {
        "memory 4 GB",
        "read-only mounts",
        "seccomp",
        "audit hook",
        *(f"Landlock {i}" for i in range(20)),
    }


# What laws do openly, such as an open-loop signal or action in calm only, is judged by the statistics of a set.
