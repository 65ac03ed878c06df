"""What tests cost: seconds of processor of each file, beside those on record.

    make test ALL=1 RECORD=1    writes tests/data/budgets.yaml

Own seconds of a test's process count, and those of processes that it has started. Machines differ: a file has grown if
it has more than the others by half, compared with its record.
"""

from __future__ import annotations

import os
import statistics
from collections import Counter, defaultdict
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest
import yaml

if TYPE_CHECKING:
    from collections.abc import Generator

RECORD = Path(__file__).parent / "data" / "budgets.yaml"
DEAREST = 5
GROWN = 1.5
MIN_S = 2.0  # below it, chance
_TICKS = os.sysconf("SC_CLK_TCK")
_spent: dict[str, float] = defaultdict(float)
_tests: Counter[str] = Counter()


class Cost(NamedTuple):
    """What the tests of a file cost: s of processor, and how many they are."""

    seconds: float
    tests: int


def recorded() -> dict[str, Cost]:
    """What is on record, by file."""
    return {name: Cost(*cost) for name, cost in yaml.safe_load(RECORD.read_text(encoding="utf-8")).items()}


def _of_running(pid: int) -> float:
    """Seconds of processes below one that have not ended."""
    total = 0.0
    with suppress(OSError):
        for task in Path(f"/proc/{pid}/task").iterdir():
            for child in (task / "children").read_text(encoding="ascii").split():
                values = Path(f"/proc/{child}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
                total += sum(map(int, values[11:15])) / _TICKS + _of_running(int(child))
    return total


def processor_s() -> float:
    """Seconds of processor of this process and of all below it so far."""
    return sum(os.times()[:4]) + _of_running(os.getpid())


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, Any, Any]:
    """Give a test's last report what the test has cost."""
    item.stash[_BEGIN] = processor_s()
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    if call.when == "teardown":
        report.user_properties.append(("processor_s", max(0.0, processor_s() - item.stash[_BEGIN])))
    return report


_BEGIN = pytest.StashKey[float]()


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Add up by file; where tests run in several processes, in the one that tells."""
    name = report.nodeid.partition("::")[0]
    _tests[name] += report.when == "call"  # not of one that was skipped
    _spent[name] += sum(float(str(value)) for key, value in report.user_properties if key == "processor_s")


def grown(now: dict[str, float], record: dict[str, float]) -> list[str]:
    """Files that have grown by half, against the median of all, so that machines and loads matter little."""
    ratios = {name: now[name] / record[name] for name in now if record.get(name, 0) >= MIN_S and now[name] >= MIN_S}
    usual = statistics.median(ratios.values()) if ratios else 1.0
    return sorted(name for name, value in now.items() if value > GROWN * usual * max(record.get(name, 0.0), MIN_S))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """The dearest files, and those that have grown, of those of which all tests ran."""
    if hasattr(config, "workerinput") or not _spent:
        return
    known = recorded()
    record = {name: cost.seconds for name, cost in known.items()}
    whole = {name: value for name, value in _spent.items() if name not in known or _tests[name] >= known[name].tests}
    total = sum(_spent.values())
    terminalreporter.write_line(f"{total:.0f} s of processor in tests; the dearest files:")
    for name in sorted(_spent, key=_spent.__getitem__, reverse=True)[:DEAREST]:
        terminalreporter.write_line(f"{_spent[name]:6.0f} s  {name}")
    for name in grown(whole, record):
        before = record.get(name)
        text = "new" if before is None else f"{before:.1f} s on record"
        terminalreporter.write_line(f"grown by half or more: {name}, {_spent[name]:.1f} s ({text})")
    if os.environ.get("RECORD"):
        now = {name: Cost(round(_spent[name], 1), many) for name, many in _tests.items() if many}  # else all skipped
        present = {name: cost for name, cost in (recorded() | now).items() if (config.rootpath / name).exists()}
        lines = [f"{name}: [{cost.seconds}, {cost.tests}]\n" for name, cost in sorted(present.items())]
        RECORD.write_text("".join(lines), encoding="utf-8")
