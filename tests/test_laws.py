"""Names of tuned laws: `KIND@FILE` says which parameters a controller has, in runs, recordings and on pages."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import pytest

from facts_damping.case import tuned
from facts_damping.case.loading import load_case
from facts_damping.control.table import kind_name
from facts_damping.errors import InputError
from facts_damping.output.writing import write_whole
from facts_damping.parameters import files
from facts_damping.parameters.yaml_text import dump

DOCS = Path(__file__).parents[1] / "docs"
LAWS = {
    name: (row, content)
    for file, path in files.shipped("controllers").items()
    for content in [tuned.read(path)]
    for name, row in tuned.rows(file, content)
}
FILES = {name.partition("@")[2].partition(".")[0] for name in LAWS}
KINDS = {kind_name(name) for name in LAWS}
# Pages about kinds of controllers, whatever their parameters.
OF_KINDS = {
    "adaptation",
    "commands",
    "controllers",
    "extensions",
    "glossary",
    "neuro_fuzzy",
    "replay",
    "search",
    "tutorial_grid",
}


def sets(name: str, system: str, signals: list[str], devices: list[str]) -> list[str]:
    row = f"{{name: '{name}', signals: [{', '.join(signals)}], devices: [{', '.join(devices)}]}}"
    return [f"system={system}", "scenario=[]", f"devices=[{', '.join(devices)}]", f"controllers=[{row}]"]


@pytest.mark.parametrize("file", sorted(FILES))
def test_law_has_the_parameters_of_its_row_and_keeps_its_name(file: str) -> None:
    """Given by name, and in the run that a recording stores; a change of a parameter takes the name away."""
    name, (row, content) = next((name, law) for name, law in LAWS.items() if name.partition("@")[2].startswith(file))
    signals = content.signals[:1] if row.scheme is None and kind_name(name) == "LLC-tuned" else content.signals
    asked = [*sets(name, content.system, signals, content.devices), f"controllers.0.compensation={row.compensation}"]
    case = load_case(None, [*asked, *([f"controllers.0.scheme={row.scheme}"] if row.scheme else [])])
    (controller,) = case.controllers
    assert (controller.name, controller.scheme) == (name, row.scheme)
    assert controller.parameters.items() >= row.parameters.items()


def test_law_chosen_by_the_profile_gets_its_name() -> None:
    case = load_case("two_area_deployment")
    assert [c.name for c in case.controllers] == ["LLC-tuned@two_area_deployment_sssc"]
    assert [c.name for c in case.run.controllers] == ["LLC-tuned"]
    for more, name in (([], "LLC-tuned@two_area"), (["controllers.0.parameters.gain=3"], "LLC-tuned")):
        (controller,) = load_case("two_area_small", ["controllers.0.name=LLC-tuned", *more]).controllers
        assert controller.name == name


def test_stored_law_keeps_its_name_until_a_parameter_is_changed(tmp_path: Path) -> None:
    stored = tmp_path / "run.yaml"
    write_whole(stored, dump(load_case("two_area_deployment").document()))
    assert load_case(str(stored)).controllers[0].name == "LLC-tuned@two_area_deployment_sssc"
    assert load_case(str(stored), ["controllers.0.parameters.gain=3"]).controllers[0].name == "LLC-tuned"


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("LLC-tuned@two", "controllers: 'two' given"),
        ("Hinf@two_area_frequency", "allowed: LLC-tuned@two_area_frequency, ANFTSC@two_area_frequency, "),
        ("LLC-tuned@smib", "'LLC-tuned@smib' given for two_area, speed, sssc, none; allowed: smib, speed, sssc, none"),
        ("LLC-tuned@two_area_frequency", "allowed: two_area, frequency, sssc, none, or LLC-tuned"),
    ],
)
def test_law_that_is_not_there_or_of_another_loop_is_refused(name: str, said: str) -> None:
    with pytest.raises(InputError, match=re.escape(said)):
        load_case("two_area_small", [f"controllers.0.name={name}"])


def test_no_two_laws_have_a_name() -> None:
    every = [
        (name, row.scheme, row.compensation)
        for file, path in files.shipped("controllers").items()
        for name, row in tuned.rows(file, tuned.read(path))
    ]
    assert len(set(every)) == len(every)


def names_on(section: str) -> set[str]:
    """Names of controllers with tuned laws, in code or in the first cell of a row."""
    text = re.sub(r"(?m)^    .*$|```.*?```", "", section, flags=re.DOTALL)
    cells = re.findall(r"(?m)^\| ([\w+-]+)(?:,? [\w ,]+)? \|", text)
    return {name for name in (*re.findall(r"`([\w+@.-]+)`", text), *cells) if kind_name(name) in KINDS}


@pytest.mark.parametrize("page", sorted({path.stem for path in DOCS.glob("*.md")} - OF_KINDS))
def test_page_gives_no_name_to_two_laws(page: str) -> None:
    """A name without `@` is of the file that its section names, or one before it: `Laws: @two_area`, one a system."""
    text, stated = (DOCS / f"{page}.md").read_text(encoding="utf-8"), set[str]()
    starts = [0, *(match.start() for match in re.finditer(r"(?m)^## ", text)), len(text)]
    for section in (text[a:b] for a, b in pairwise(starts)):
        stated = set(re.findall(r"`@(\w+)`", " ".join(re.findall(r"[Ll]aws:\s[^;.)]*", section)))) or stated
        assert stated <= FILES
        systems = [tuned.read(files.shipped("controllers")[file]).system for file in stated]
        assert len(set(systems)) == len(systems)
        for name in names_on(section):
            assert (name in LAWS) if "@" in name else stated, (page, name)
