"""Files of keys: made for their owner alone, two keys at most, and every mistake is one line."""

from __future__ import annotations

import stat
from typing import TYPE_CHECKING

import pytest

from facts_damping.cli.main import main
from facts_damping.errors import InputError
from facts_damping.parameters.security import add_key, read_keys
from tests.commands import assert_one_line

if TYPE_CHECKING:
    from pathlib import Path

GOOD = "ab" * 32


def test_new_key_comes_first_and_the_one_before_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "keys.yaml"
    assert main(["new", "key", str(path)]) == 0
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    first = read_keys(path)
    assert list(first) == [1]
    assert len(first[1]) == 32
    assert main(["new", "key", str(path)]) == 0
    second = read_keys(path)
    assert list(second) == [2, 1]
    assert second[1] == first[1]
    assert second[2] != first[1]
    assert add_key(path) == (3, [2])
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert [file.name for file in tmp_path.iterdir()] == ["keys.yaml"]
    said = capsys.readouterr().out
    assert all(key.hex() not in said for key in second.values())


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("keys: []", "keys"),
        ("{}", "keys"),
        (f"keys: [{{id: 1, key: {GOOD[:-1]}}}]", "keys.0.key"),
        (f"keys: [{{id: 0, key: {GOOD}}}]", "keys.0.id: no keys"),
        (f"keys: [{{id: 1, key: {GOOD}}}, {{id: 1, key: {GOOD}}}]", "number 1 given twice"),
        (f"keys: [{{id: 1, key: {GOOD}}}, {{id: 2, key: {GOOD}}}, {{id: 3, key: {GOOD}}}]", "keys"),
    ],
)
def test_wrong_file_is_one_line(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "keys.yaml"
    path.write_text(text)
    path.chmod(0o600)
    with pytest.raises(InputError) as raised:
        read_keys(path)
    assert said in str(raised.value)
    assert "\n" not in str(raised.value)


def test_file_that_others_may_read_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "keys.yaml"
    add_key(path)
    path.chmod(0o640)
    with pytest.raises(InputError, match="mode 0640 given; allowed: 0600"):
        read_keys(path)


def test_graph_without_its_keys_does_not_start(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    missing = tmp_path / "none.yaml"
    assert_one_line(2, ["run", "--set", f"security.keys={missing}", "--out", str(out)], str(missing), capsys)
    assert not out.exists()
