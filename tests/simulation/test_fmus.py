"""FMUs as controllers, by pythonfmu and pythonfmu3: the setpoints of the class that they hold; bad ones."""

from __future__ import annotations

import json
import re
import zipfile
from pathlib import Path
from typing import Any

import pytest

from facts_damping.case.loading import load_case
from facts_damping.errors import InputError
from facts_damping.simulation import loop
from facts_damping.simulation.replaying.replay import case_of
from facts_damping_studies.parameters import Study
from facts_damping_studies.sweeps.sweep import planned
from tests.commands import assert_one_line, changes
from tests.lead_lag_fmu import build

COSIMULATION = r"<CoSimulation.*?(/>|</CoSimulation>)"
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    """By version of FMI."""
    folder = tmp_path_factory.mktemp("fmu")
    return {version: build(folder, ROOT / "examples", version) for version in (2, 3)}


def with_fmu(fmu: Any, **fields: Any) -> str:
    return "controllers=" + json.dumps([{"name": "mine", "fmu": fmu, "parameters": {"gain": 12}, **fields}])


@pytest.mark.parametrize(("version", "link"), [(2, "plc"), (3, "ideal"), (3, "pdci")])
def test_its_setpoints_are_those_of_the_shipped_lead_lag_bit_for_bit(
    fmus: dict[int, Path], version: int, link: str
) -> None:
    sets = [f"link={link}", "duration=5"]
    shipped = loop.run(load_case("two_area_large", [*sets, "controllers.0.parameters.gain=12"]))
    with_fmu_run = loop.run(load_case("two_area_large", [*sets, with_fmu(str(fmus[version]))]))
    assert with_fmu_run.issued.tobytes() == shipped.issued.tobytes()
    assert len(with_fmu_run.issued) > 100
    assert with_fmu_run.controller_names == ["controller_0_mine"]


def test_several_side_by_side_are_apart(fmus: dict[int, Path]) -> None:
    rows = [{"name": "mine", "fmu": str(fmus[2]), "parameters": {"gain": gain}} for gain in (5, 12)]
    sets = ["duration=2", "devices=[sssc, statcom]"]
    rows[1]["devices"], rows[1]["fmu"] = ["statcom"], {"file": str(fmus[2]), "outputs": {"statcom": "sssc"}}
    shipped = [
        {"name": "LLC", "parameters": row["parameters"], "devices": [d]}
        for row, d in zip(rows, ("sssc", "statcom"), strict=True)
    ]
    both = [loop.run(load_case("two_area_large", [*sets, "controllers=" + json.dumps(c)])) for c in (rows, shipped)]
    assert both[0].issued.tobytes() == both[1].issued.tobytes()


def test_other_names_are_mapped(tmp_path: Path) -> None:
    fmu = build(tmp_path, ROOT / "examples", 2, "u1", "y1")
    sets = ["duration=1"]
    mapped = {"file": str(fmu), "inputs": {"speed": "u1"}, "outputs": {"sssc": "y1"}}
    with_fmu_run = loop.run(load_case("two_area_large", [*sets, with_fmu(mapped)]))
    shipped = loop.run(load_case("two_area_large", [*sets, "controllers.0.parameters.gain=12"]))
    assert with_fmu_run.issued.tobytes() == shipped.issued.tobytes()
    assert with_fmu_run.configuration["controllers"][0]["fmu"] == mapped


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"signals": ["w13"]}, "has no input 'w13' of type Real; allowed: speed, or `inputs: {w13: ...}`"),
        ({"devices": ["statcom"]}, "has no output 'statcom' of type Real; allowed: sssc, or `outputs: {statcom: ...}`"),
        ({"parameters": {"Tw": 1}}, "has no parameter 'Tw' of type Real; allowed: gain"),
        ({"compensation": "lead"}, "compensation: 'lead' given; allowed: none for mine"),
    ],
)
def test_fields_that_do_not_fit_an_fmu_are_refused_in_one_line(
    fmus: dict[int, Path], fields: dict[str, Any], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    refused(["devices=[sssc, statcom]", with_fmu(str(fmus[2]), **fields)], said, capsys)


def refused(sets: list[str], said: str, capsys: pytest.CaptureFixture[str], status: int = 2) -> None:
    assert_one_line(status, ["simulate", "two_area_large", *changes(["duration=1", *sets])], said, capsys)


def test_files_that_are_no_fmus_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    refused([with_fmu("nowhere.fmu")], "controllers.0.fmu: nowhere.fmu: no such file; allowed: an FMU", capsys)
    path = tmp_path / "bad.fmu"
    path.write_bytes(b"PK no archive")
    refused([with_fmu(str(path))], "cannot be read: File is not a zip file; allowed: an FMU of FMI 2 or 3", capsys)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", "<fmiModelDescription")
    refused([with_fmu(str(path))], f"controllers.0.fmu: {path}: cannot be read: ", capsys)


@pytest.mark.parametrize(
    ("old", "new", "renamed", "said"),
    [
        (
            COSIMULATION,
            r'<ModelExchange modelIdentifier="x"/>',
            "binaries/",
            "FMI 2.0 without co-simulation given; allowed: FMI 2.0 or 3.0, for co-sim",
        ),
        ("nothing", "", "other/", "bad.fmu: cannot be loaded: "),
    ],
)
def test_fmu_that_cannot_run_here_is_one_line(
    fmus: dict[int, Path],
    tmp_path: Path,
    old: str,
    new: str,
    renamed: str,
    said: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / "bad.fmu"
    with zipfile.ZipFile(fmus[2]) as whole, zipfile.ZipFile(path, "w") as archive:
        for name in whole.namelist():
            content = whole.read(name)
            if name == "modelDescription.xml":
                content = re.sub(old.encode(), new.encode(), content, flags=re.DOTALL)
            archive.writestr(name.replace("binaries/", renamed), content)
    refused([with_fmu(str(path))], said, capsys)


def test_step_that_fails_ends_the_run_by_name(fmus: dict[int, Path], capsys: pytest.CaptureFixture[str]) -> None:
    sets = ["system.signals.speed.weights={G1: 1.0e9}", with_fmu(str(fmus[2]))]
    refused(sets, "controllers.0.fmu: RuntimeError: fmi2DoStep failed with status", capsys, status=1)


@pytest.mark.parametrize("mapped", [False, True])
def test_study_is_another_one_when_its_fmu_is(fmus: dict[int, Path], tmp_path: Path, mapped: bool) -> None:
    fmu = tmp_path / "damper.fmu"
    controller = {"name": "mine", "fmu": {"file": str(fmu)} if mapped else str(fmu)}
    content = {"run": {"controllers": [controller], "duration": 1.0}, "sweep": [{"field": "seed", "values": [1]}]}
    study = Study.model_validate(content)
    fingerprints = []
    for version in (2, 2, 3):
        fmu.write_bytes(fmus[version].read_bytes())
        fingerprints.append(planned(study, "study", "study", "").fingerprint)
    assert fingerprints[0] == fingerprints[1] != fingerprints[2]


def test_without_fmpy_it_is_said_how_it_is_installed(
    fmus: dict[int, Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "fmpy", None)
    refused([with_fmu(str(fmus[2]))], "FMPy is not installed; allowed: pip install -e '.[fmi]'", capsys)


def test_recording_names_it_and_is_not_believed(fmus: dict[int, Path]) -> None:
    record = loop.run(load_case("two_area_large", ["duration=0.2", with_fmu(str(fmus[2]))]))
    with pytest.raises(InputError, match=r"controllers\.0\.fmu: .* given by the recording; allowed: --policy"):
        case_of(record, "a recording", None, [])
    assert case_of(record, "a recording", None, [], policy=True).controllers[0].fmu == str(fmus[2])
