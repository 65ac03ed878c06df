"""Files of every kind that are nearly right: what is made of each is a result, or one line and status 2.

What reads recordings, frames of streams and messages has such tests beside its own. `make explore` draws others.
"""

from __future__ import annotations

import contextlib
import io
import json
import random
import sqlite3
import zipfile
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from facts_damping.case.loading import load_case
from facts_damping.cli.main import BAD_INPUT, DEGRADED, DONE, FAILED, main
from facts_damping.errors import InputError
from facts_damping.escaping import SCREEN
from facts_damping.parameters.files import shipped
from facts_damping_studies.campaigns import campaign
from facts_damping_studies.sweeps import sweep
from tests.mutations import damaged, mutated

if TYPE_CHECKING:
    from collections.abc import Callable

DATA = Path(__file__).parent / "data"
SHORT = ["--set", "duration=0.2"]
LAW = "A: [[-1.0, 0.1], [0.0, -2.0]]\nB: [[1.0], [0.5]]\nC: [[1.0, 2.0]]\nD: [[0.1]]\n"
MATRICES = {"A": -np.eye(2), "B": np.ones((2, 1)), "C": np.ones((1, 2)), "D": np.zeros((1, 1))}
TRACE = "delay_s,G1,G2\n0.1,0.2,0.1\n0.05,,0.15\n,,\n0.08,0.1,0.1\n"
XML = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="law" guid="{1}">
<CoSimulation modelIdentifier="law" canHandleVariableCommunicationStepSize="true"/>
<ModelVariables>
<ScalarVariable name="speed" valueReference="0" causality="input"><Real start="0"/></ScalarVariable>
<ScalarVariable name="sssc" valueReference="1" causality="output"><Real/></ScalarVariable>
</ModelVariables>
<ModelStructure><Outputs><Unknown index="2"/></Outputs></ModelStructure>
</fmiModelDescription>
"""


class Kind(NamedTuple):
    """Sound files of a kind (text, or bytes), how their names end, and the command that reads one; or a function."""

    sound: Callable[[], list[str] | list[bytes]]
    suffix: str
    read: Callable[[str], list[str] | None]


def files(kind: str, within: str = "") -> Callable[[], list[str]]:
    """Those that are shipped, but for files that others extend."""

    def texts() -> list[str]:
        texts_of_kind = (
            path.read_text(encoding="utf-8") for name, path in shipped(kind).items() if name.startswith(within)
        )
        return [text for text in texts_of_kind if "extends:" not in text]

    return texts


def simulate(*change: str) -> Callable[[str], list[str]]:
    return lambda file: ["simulate", *(part.replace("FILE", file) for part in change), *SHORT]


def law_field(field: str) -> Callable[[str], list[str]]:
    return simulate("--set", f"controllers=[{{name: mine, {field}: 'FILE'}}]")


def plan(of: Callable[[str], Any]) -> Callable[[str], None]:
    def planned(file: str) -> None:
        of(file)

    return planned


def npz() -> list[bytes]:
    stored, packed = io.BytesIO(), io.BytesIO()
    np.savez(stored, allow_pickle=False, **MATRICES)
    np.savez_compressed(packed, allow_pickle=False, **MATRICES)
    return [stored.getvalue(), packed.getvalue()]


def mat() -> list[bytes]:
    stored, packed, older = io.BytesIO(), io.BytesIO(), io.BytesIO()
    savemat(stored, MATRICES)
    savemat(packed, MATRICES, do_compression=True)
    savemat(older, MATRICES, format="4")
    return [stored.getvalue(), packed.getvalue(), older.getvalue()]


def fmu() -> list[bytes]:
    archive_bytes = io.BytesIO()
    with zipfile.ZipFile(archive_bytes, "w") as archive:
        archive.writestr("modelDescription.xml", XML)
        archive.writestr("binaries/linux64/law.so", b"\x7fELF")
    return [archive_bytes.getvalue()]


def database() -> list[bytes]:
    """A bag as rosbag2 lays it out (version 4 of its tables), with a message that is none of ours."""
    base = sqlite3.connect(":memory:")
    base.executescript(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT,"
        " offered_qos_profiles TEXT NOT NULL, type_description_hash TEXT);"
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);"
        "CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT);"
        "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT, encoding TEXT,"
        " encoded_message_definition TEXT, type_description_hash TEXT);"
        "INSERT INTO schema VALUES(4, 'kilted');"
        "INSERT INTO topics VALUES(1, '/plant/state', 'facts_damping_msgs/msg/PlantState', 'cdr', '', '');"
    )
    rows = [(1, time, bytes([0, 1, 0, 0, time % 250, *bytes(40)])) for time in range(100)]
    base.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)", rows)
    return [base.serialize()] if hasattr(base, "serialize") else []


def weights() -> list[str]:
    scheme = load_case(None, ["controllers.0.name=ANFTSC"]).controllers[0].scheme
    return [json.dumps({"name": "ANFTSC", "scheme": scheme, "controller": [0.5] * 10})]


KINDS = {
    "systems": Kind(files("systems"), "yaml", lambda file: ["modes", file, "--devices", "none"]),
    "scenarios": Kind(files("scenarios", "two_area/"), "yaml", simulate("--set", "scenario=FILE")),
    "links": Kind(files("links"), "yaml", simulate("--set", "link=FILE")),
    "measurement": Kind(files("measurement"), "yaml", simulate("--set", "measurement=FILE", "--set", "controllers=[]")),
    "runs": Kind(files("runs"), "yaml", simulate("FILE")),
    "profiles": Kind(files("profiles"), "yaml", simulate("two_area_small", "--set", "profile=FILE")),
    "supervision": Kind(files("supervision"), "yaml", simulate("--supervised", "FILE")),
    "studies": Kind(files("studies"), "yaml", plan(lambda file: sweep.plan(file, []))),
    "campaigns": Kind(files("campaigns"), "yaml", plan(campaign.plan)),
    "weights": Kind(weights, "yaml", simulate("--set", "controllers=[{name: ANFTSC, weights: FILE}]")),
    "laws": Kind(lambda: [LAW], "yaml", law_field("linear")),
    "laws of NumPy": Kind(npz, "npz", law_field("linear")),
    "laws of MATLAB": Kind(mat, "mat", law_field("linear")),
    "traces": Kind(lambda: [TRACE], "csv", simulate("--set", "link={up: [{model: trace, file: FILE}]}")),
    "FMUs": Kind(fmu, "fmu", law_field("fmu")),
    "descriptions of FMUs": Kind(lambda: [XML], "fmu", law_field("fmu")),
    "keys": Kind(lambda: [f"keys: [{{id: 1, key: {'ab' * 32}}}]\n"], "yaml", lambda file: ["new", "key", file]),
    "bags": Kind(database, "db3", lambda file: ["analyze", file]),
    "MATPOWER": Kind(lambda: [(DATA / "nine_bus.m").read_text()], "m", lambda file: ["import", file]),
    "PSS/E": Kind(lambda: [(DATA / "three_machines.raw").read_text()], "raw", lambda file: ["import", file]),
}


@cache
def sound(kind: str) -> list[Any]:
    """Sound files of a kind, made once."""
    return list(KINDS[kind].sound())


def written(kind: str, content: bytes, folder: Path) -> Path:
    """A file with a content; of an FMU's description the archive that it is in."""
    file = folder / f"it.{KINDS[kind].suffix}"
    if kind != "descriptions of FMUs":
        file.write_bytes(content)
        file.chmod(0o600)
        return file
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("modelDescription.xml", content)
    return file


def said(kind: str, file: Path) -> tuple[int, str]:
    """Exit status and errors of what reads a file; runs of a study or a campaign are planned and not made."""
    out, errors = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
        try:
            command = KINDS[kind].read(str(file))
        except InputError as error:
            return BAD_INPUT, f"{error}\n"
        status = DONE if command is None else main(command)
    assert out.getvalue().replace("\n", "").replace("\t", "").isprintable() or status == DONE
    return status, errors.getvalue()


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=8, deadline=None, suppress_health_check=list(HealthCheck))
@given(seed=st.integers(0, 2**32))
def test_mutated_file_is_read_or_refused_in_one_line(
    kind: str, seed: int, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    dice, folder = random.Random(seed), tmp_path_factory.mktemp("mutated")
    monkeypatch.chdir(folder)
    whole = dice.choice(sound(kind))
    content = mutated(whole, dice) if isinstance(whole, str) else damaged(whole, dice)
    status, errors = said(kind, written(kind, content, folder))
    assert status in (DONE, BAD_INPUT, DEGRADED, FAILED)
    notes = errors.splitlines()
    assert all(line.isprintable() and len(line) <= SCREEN + 20 for line in notes)
    assert "Traceback" not in errors
    if status in (BAD_INPUT, FAILED):
        assert notes[-1].startswith(("facts-damping: ", str(folder))) or status == BAD_INPUT
        assert len(notes) == 1 or kind in ("MATPOWER", "PSS/E")
    assert not list(folder.glob("*.new"))


@pytest.mark.parametrize("kind", KINDS)
def test_valid_file_is_read(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Else all its changes would be refused for the same reason."""
    monkeypatch.chdir(tmp_path)
    unread = {"FMUs": "cannot be loaded", "descriptions of FMUs": "cannot be loaded", "bags": "no topic"}
    for whole in sound(kind)[:1]:
        status, errors = said(kind, written(kind, whole.encode() if isinstance(whole, str) else whole, tmp_path))
        if kind in unread:
            assert unread[kind] in errors
        else:
            assert (status, errors) == (DONE, "") or kind in ("MATPOWER", "PSS/E")
