"""Files of compiled functions: whole, of this user, and told in a line where they cannot be written."""

from __future__ import annotations

import os
import re
import resource
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from facts_damping.compiling import store
from facts_damping.errors import InputError
from facts_damping.simulation.tick import run_half_ticks

if TYPE_CHECKING:
    from collections.abc import Callable

ROOT = Path(__file__).parents[2]
OTHER = 12345  # user
MAY_CHOWN = pytest.mark.skipif(os.geteuid() != 0, reason="only the administrator may give files to other users")


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache, for code that is not loaded yet."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    for name in ("_addresses", "_code"):
        monkeypatch.setattr(store, name, {})
    (tmp_path / "cache").mkdir()
    return tmp_path / "cache"


def test_old_files_of_a_function_go_and_those_of_others_stay(cache: Path) -> None:
    for i in range(6):
        for name in (run_half_ticks.symbol, "facts_damping.link.chain.other"):
            (cache / f"{name}-{i}.o").write_bytes(b"")
            os.utime(cache / f"{name}-{i}.o", (i, i))
    store._write(run_half_ticks, b"code")
    left = {path.name for path in cache.glob(f"{run_half_ticks.symbol}-*")}
    assert left == {store.file_name(run_half_ticks), *(f"{run_half_ticks.symbol}-{i}.o" for i in (3, 4, 5))}
    assert len(list(cache.glob("facts_damping.link.chain.other-*"))) == 6


def flip_a_bit(path: Path) -> None:
    code = bytearray(path.read_bytes())
    code[1] ^= 4
    path.write_bytes(code)


def link_to_a_copy(path: Path) -> None:
    path.rename(path.with_suffix(".copy"))
    path.symlink_to(path.with_suffix(".copy"))


@pytest.mark.parametrize(
    "harm",
    [
        flip_a_bit,
        link_to_a_copy,
        lambda path: path.write_bytes(path.read_bytes()[:-1]),
        lambda path: path.write_bytes(b""),
        lambda path: path.chmod(0o666),
        pytest.param(lambda path: os.chown(path, OTHER, OTHER), marks=MAY_CHOWN),
    ],
    ids=["a bit", "a link", "cut", "empty", "writable by others", "of another user"],
)
def test_file_that_is_harmed_is_compiled_again(cache: Path, harm: Callable[[Path], None]) -> None:
    store._write(run_half_ticks, b"code")
    assert store._is_there(run_half_ticks)
    store._code.clear()
    harm(cache / store.file_name(run_half_ticks))
    assert not store._is_there(run_half_ticks)


@pytest.mark.parametrize(
    ("harm", "said"),
    [
        (lambda path: path.chmod(0o777), "that others can write"),
        pytest.param(lambda path: os.chown(path, OTHER, OTHER), f"of user {OTHER}", marks=MAY_CHOWN),
    ],
)
def test_cache_that_others_can_write_is_refused(cache: Path, harm: Callable[[Path], None], said: str) -> None:
    harm(cache)
    with pytest.raises(InputError, match=f"^{cache}: a cache of compiled functions {said} given; allowed: a folder of"):
        store.prepare([run_half_ticks])


def test_lock_that_is_a_link_leaves_its_target_alone(cache: Path, tmp_path: Path) -> None:
    (tmp_path / "target").write_text("precious", encoding="utf-8")
    (cache / f"{run_half_ticks.symbol}.lock").symlink_to(tmp_path / "target")
    with pytest.raises(InputError, match=f"^{cache}: cannot be written"), store._claimed(run_half_ticks, wait=True):
        pass
    assert (tmp_path / "target").read_text(encoding="utf-8") == "precious"


def fill_the_disk() -> None:
    """No file of this process and its children may have more than a byte."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (1, 1))


LAW = """
from facts_damping.compiling import entry_point
@entry_point
def law(x: float) -> float:
    return {body}
"""
CALL = """
import sys
from facts_damping.errors import FactsDampingError
from laws import law
try:
    print(law(1.0))
except FactsDampingError as error:
    sys.exit(f"{type(error).__name__}: {error}")
"""


@pytest.mark.parametrize(
    ("body", "limit", "said"),
    [
        ("x + 1.0", None, ""),
        ("x + 1.0", fill_the_disk, r"InputError: /.*/cache: cannot be written: File too large; allowed: .*"),
        ("x + absent", None, r"RunError: laws\.law: cannot be compiled: .*'absent' is not defined.*"),
    ],
)
def test_function_that_cannot_be_compiled_is_told_in_a_line(
    body: str, limit: Callable[[], None] | None, said: str, tmp_path: Path
) -> None:
    (tmp_path / "laws.py").write_text(LAW.format(body=body), encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}:{ROOT}", "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    done = subprocess.run(
        [sys.executable, "-c", CALL], env=environment, capture_output=True, text=True, check=False, preexec_fn=limit
    )
    first, *lines = done.stderr.splitlines()
    assert re.fullmatch(r"compiling \d+ numerical kernels, once on this machine: seconds", first)
    assert done.stdout == ("" if said else "2.0\n")
    assert re.fullmatch(said, "\n".join(lines)), done.stderr
