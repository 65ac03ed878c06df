"""Stores the digest of a new recording in its `metadata.yaml`, so that readers can detect later changes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from facts_damping.digest import digest
from facts_damping.recording.bagfile import CUSTOM, DIGEST, FILE_NAME, INFORMATION, dump
from facts_damping.recording.reader import load
from facts_damping.recording.scan import metadata
from facts_damping.terminal import write_whole

if TYPE_CHECKING:
    from facts_damping.signals import Record


def seal(folder: Path | str) -> Record:
    """Record of a new recording; stores its digest if the recording is complete.

    Raises RecordingError as `load` does.
    """
    record, file = load(folder), Path(folder) / FILE_NAME
    told = metadata(file)
    if told:
        told[CUSTOM] = {**told.get(CUSTOM, {}), DIGEST: json.dumps(digest(record))}
        write_whole(file, dump({INFORMATION: told}))
    return record
