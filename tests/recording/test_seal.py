"""The digest in a recording's metadata: it is stored once, found again, and never trusted over the content."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest
import yaml

from facts_damping.digest import digest
from facts_damping.recording import load, seal

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from facts_damping.record import Record


@pytest.fixture
def folder(tmp_path: Path, random_record: Callable[..., Record], write_record: Any) -> Path:
    write_record(random_record(3), tmp_path / "run")
    return tmp_path / "run"


def test_recording_keeps_its_digest(folder: Path) -> None:
    before = yaml.safe_load((folder / "metadata.yaml").read_text())
    sealed = seal(folder)
    information = yaml.safe_load((folder / "metadata.yaml").read_text())
    stored = information["rosbag2_bagfile_information"]["custom_data"].pop("digest")
    assert json.loads(stored) == digest(sealed)
    assert information == before
    assert sealed.versions == {"facts_damping": "1"}
    assert load(folder).notes == []


def test_another_digest_is_noted_in_a_line(
    folder: Path, tmp_path: Path, random_record: Callable[..., Record], write_record: Any
) -> None:
    stored = digest(seal(folder))
    write_record(random_record(4), tmp_path / "other" / "run")
    file = folder / "run_0.mcap"
    file.write_bytes((tmp_path / "other" / "run" / file.name).read_bytes())
    record = load(folder)
    was = f"not {stored} as stored in it"
    assert record.notes == [f"digest {digest(record)}, {was}: the recording was changed or is damaged"]
    assert load(file).notes == []  # there nothing is stored


@pytest.mark.parametrize("digits", ["[]", "3", "''", "'\"'", "'[1]'"])
def test_malformed_digest_in_the_metadata_is_noted(folder: Path, digits: str) -> None:
    file = folder / "metadata.yaml"
    file.write_text(file.read_text().replace("custom_data:\n", f"custom_data:\n    digest: {digits}\n"))
    assert all("digest" in note for note in load(folder).notes)


def test_cut_recording_is_not_marked_as_complete(folder: Path) -> None:
    (folder / "metadata.yaml").unlink()
    seal(folder)
    assert not (folder / "metadata.yaml").exists()
