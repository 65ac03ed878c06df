"""Sets of cases with their cases: read, drawn again from another text, and their runs."""

from __future__ import annotations

import hashlib
import json
from copy import deepcopy
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.case.changes import as_sets, change
from facts_damping.case.loading import changed_case
from facts_damping.errors import FactsDampingError, InputError, check_known, one_line
from facts_damping.parameters.field_errors import check
from facts_damping.parameters.files import find, read_table, shipped
from facts_damping.simulation.loop import build_loop
from facts_damping_studies.score.cases.case_set import CaseSet, ScoredCase
from facts_damping_studies.score.cases.drawing import Grid
from facts_damping_studies.score.cases.kinds import KINDS, drawn
from facts_damping_studies.sweeps.pool import run_all

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    Controllers = Sequence[dict[str, Any]]

TRIES = 20  # draws of a case without a power flow, after which a grid is refused
DEFAULT = "two_area_2.0"
TAIL_S = 0.5  # of a run, after what is scored
UNCONTROLLED = {"supervision": None, "arm_at": None}  # fields of runs without controllers


class Set(NamedTuple):
    """A set of cases with its name, with its version, and the digest of its cases."""

    name: str
    content: CaseSet
    cases: list[ScoredCase]
    digest: str
    shipped: bool = False

    @property
    def controller_seed(self) -> int:
        """The seed that users' programs get: the same in all cases, so that it tells none apart."""
        return int.from_bytes(hashlib.sha256(f"{self.content.seed} controllers".encode()).digest()[:4], "big")


def read_set(name: str) -> Set:
    """A set of cases by name or path. Raises `InputError`."""
    path = find("case_sets", name)
    content = read_table(path)
    case_set = set_of(path.stem.removesuffix(f"_{content.get('version')}"), content, str(path))
    return case_set._replace(shipped=path in shipped("case_sets").values())


def set_of(name: str, content: dict[str, Any], source: str) -> Set:
    """A set of cases from the content of its file. Raises `InputError`."""
    checked = check(CaseSet, content, source)
    for field, kinds in (("kinds", checked.kinds), ("beside", checked.beside)):
        for kind in kinds:
            check_known(f"{source}: {field}", kind, list(KINDS if field == "kinds" else checked.kinds))
    return _with_cases(f"{name} {checked.version}", checked, grid_of(checked, source))


def drawn_again(case_set: Set, text: str, name: str, jobs: int, progress: Callable[[int, int], None]) -> Set:
    """A set of the same kinds drawn from another text; `name` is what it is called. Raises `InputError`."""
    content = case_set.content.model_copy(update={"seed": text, "redrawn": {}})
    grid = grid_of(content, name)
    tasks = list(_draws(content))
    tries = run_all(partial(_tries, content, grid), tasks, jobs, progress)
    redrawn = {f"{key} {i}": number for (_, key, i), number in zip(tasks, tries, strict=True) if number}
    return _with_cases(name, content.model_copy(update={"redrawn": redrawn}), grid)


def held_out(case_set: Set, text: str, jobs: int, progress: Callable[[int, int], None]) -> Set:
    """The held-out set of a version, from the text whose hash its file has. Raises `InputError` for another text."""
    if case_set.content.heldout is None:
        raise InputError(f"--heldout: given for {case_set.name}; allowed: for a set with `heldout`")
    if hashlib.sha256(text.encode()).hexdigest() != case_set.content.heldout:
        allowed = f"the text of {case_set.name}, whose SHA-256 is {case_set.content.heldout}"
        raise InputError(f"--heldout: '{text}' given; allowed: {allowed}")
    return drawn_again(case_set, text, f"{case_set.name} held out", jobs, progress)


def grid_of(content: CaseSet, source: str) -> Grid:
    """What the cases of a set are drawn for. Raises `InputError` for what the grid does not have."""
    run = run_of(content, ())
    rows = run["system"] if isinstance(run["system"], dict) else read_table(find("systems", str(run["system"])))
    system = changed_case(run, "set", UNCONTROLLED).system
    known = {"lines": [line.name for line in system.lines], "signals": list(system.signals)}
    for field, names in known.items():
        for name in getattr(content, field):
            check_known(f"{source}: {field}", name, names)
    signals = [system.signals[signal] for signal in content.signals]
    pmus = list(dict.fromkeys(pmu for signal in signals for pmu in signal.weights))
    return Grid(run, rows, system, content.lines, pmus, signals[0].channel)


def _draws(content: CaseSet) -> list[tuple[str, str, int]]:
    """Kind, what it is drawn as, and number, once for each draw."""
    listed = ((kind, KINDS[kind].drawn_as or kind, i) for kind, number in content.kinds.items() for i in range(number))
    return list({(key, i): (kind, key, i) for kind, key, i in listed}.values())


def _tries(content: CaseSet, grid: Grid, draw: tuple[str, str, int]) -> int:
    """The number of draws of a case before the first that can be built."""
    kind, _, i = draw
    problem = ""
    for number in range(TRIES):
        case = _case(content, grid, kind, i, number, 0)
        try:
            build_loop(changed_case(run_of(content, ()), "set", {**case.set, **UNCONTROLLED}))
        except FactsDampingError as error:
            problem = one_line(error)
        else:
            return number
    raise InputError(f"{grid.system.name}: {TRIES} cases drawn, none can be made, the last: {problem}")


def _with_cases(name: str, content: CaseSet, grid: Grid) -> Set:
    events = {(key, i): event for event, (_, key, i) in enumerate(_draws(content))}
    cases: list[ScoredCase] = []
    for kind, number in content.kinds.items():
        key = KINDS[kind].drawn_as or kind
        redrawn = [content.redrawn.get(f"{key} {i}", 0) for i in range(number)]
        cases += [_case(content, grid, kind, i, redrawn[i], events[key, i]) for i in range(number)]
    of_cases = content.model_dump(mode="json", include={"version", "run", "set", "after"})
    text = json.dumps([of_cases, [case.model_dump(mode="json") for case in cases]], sort_keys=True)
    return Set(name, content, cases, hashlib.sha256(text.encode()).hexdigest()[:16])


def _case(content: CaseSet, grid: Grid, kind: str, i: int, redrawn: int, event: int) -> ScoredCase:
    text = f"{content.seed}\n{KINDS[kind].drawn_as or kind}\n{i}\n{redrawn}"
    random = np.random.default_rng(list(hashlib.sha256(text.encode()).digest()))
    case = drawn(grid, kind, i, random)
    last_s = max([case.start_s, *(row["time"] for row in case.events)])
    fields: dict[str, Any] = {"scenario": case.events, "duration": round(last_s + content.after + TAIL_S, 1)}
    link = grid.run.get("link") or "ideal"
    link = link if isinstance(link, dict) else read_table(find("links", link))
    for way, stages in (("up", case.up), ("down", case.down)):
        if stages:
            fields[f"link.{way}"] = [*link.get(way, []), *stages]
    return ScoredCase(kind=kind, event=event, set={**fields, **case.fields})


def case_of(case_set: Set, rows: Controllers, i: int) -> Any:
    """A case of the set with controllers."""
    alone = {} if rows else UNCONTROLLED
    return changed_case(run_of(case_set.content, rows), case_set.name, {**case_set.cases[i].set, **alone})


def run_of(content: CaseSet, rows: Controllers) -> dict[str, Any]:
    """The run of all cases of a set with controllers, which are designed on the grid as it is in none of them."""
    usual = {"devices": content.devices, "signals": content.signals}
    run = deepcopy(content.run) | {"controllers": [{**usual, **row} for row in rows]}
    change(run, content.set, as_sets(content.set))  # before the case's, which may change what these add
    return run if run.get("model") is not None else {**run, "model": deepcopy(run["system"])}
