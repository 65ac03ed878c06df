"""YAML that is nearly right, drawn by a seeded generator: what is made of it is a result, or one line and status 2.

More of it: YAML_FILES=20000 python -m pytest tests/cli/test_mutations.py
"""

from __future__ import annotations

import os
import random
import re
from typing import TYPE_CHECKING, Any

from facts_damping.cli.main import BAD_INPUT, DEGRADED, DONE, main
from facts_damping.errors import InputError
from facts_damping.parameters.files import shipped
from facts_damping.studies import campaign, sweep

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    import pytest

YAML_FILES = int(os.environ.get("YAML_FILES", "150"))
ODD = (
    *("", "~", "yes", "[]", "{}", "-1", "0", "1e400", ".nan", "-.inf", "1e-300", "99999999999999999999", "'x'", "*a"),
    *(
        "&a [*a]",
        "!!python/none",
        "\t",
        "ü",
        "\x00",
        "[[[[[[[[",
        "{a: {a: {a: 1}}}",
        "1" * 5000,
        "- - -",
        "? x",
        "<<: 1",
    ),
)
SHORT = ["--set", "duration=0.2"]
# What is done with a file of each kind: quick, and all of it is read.
COMMANDS: dict[str, Callable[[str], list[str]]] = {
    "systems": lambda file: ["modes", file, "--devices", "none"],
    "scenarios": lambda file: ["simulate", "--set", f"scenario={file}", *SHORT],
    "links": lambda file: ["simulate", "--set", f"link={file}", *SHORT],
    "runs": lambda file: ["simulate", file, *SHORT],
    "supervision": lambda file: ["simulate", "--supervised", file, *SHORT],
}
PLANS: dict[str, Callable[[str], Any]] = {"studies": lambda file: sweep.plan(file, []), "campaigns": campaign.plan}
KINDS = (*COMMANDS, *PLANS)


def mutated(text: str, dice: random.Random) -> bytes:
    """A text with a few changes: of lines, words, numbers, bytes."""
    lines = text.split("\n")
    for _ in range(dice.randint(1, 3)):
        at = dice.randrange(len(lines))
        line = lines[at]
        words = re.findall(r"[^\s,:{}\[\]]+", line)
        change = dice.randrange(7)
        if change == 0:
            del lines[at : at + dice.randint(1, 3)]
            lines = lines or [""]
        elif change == 1:
            lines.insert(at, dice.choice(lines))
        elif change == 2:
            lines[at] = " " * dice.randint(0, 6) + line.lstrip()
        elif change == 3 and words:
            lines[at] = line.replace(dice.choice(words), dice.choice(ODD), 1)
        elif change == 4 and (numbers := re.findall(r"-?\d+\.?\d*", line)):
            lines[at] = line.replace(dice.choice(numbers), str(dice.uniform(-1, 1) * 10 ** dice.randint(-6, 9)), 1)
        elif change == 5:
            lines[at] = line[: dice.randint(0, len(line))]
        elif line:
            place = dice.randrange(len(line))
            lines[at] = line[:place] + dice.choice("{}[]:#&*!|>'\"%@`,-? \n") + line[place + dice.randint(0, 1) :]
    data = bytearray("\n".join(lines).encode(errors="surrogatepass"))
    if data and dice.random() < 0.1:
        data[dice.randrange(len(data))] ^= 1 << dice.randrange(8)
    return bytes(data)


def said(capsys: Any, kind: str, file: Path) -> tuple[int, str]:
    """Exit status and errors of a command; runs of a study or a campaign are planned and not made."""
    if kind in COMMANDS:
        status = main(COMMANDS[kind](str(file)))
        return status, capsys.readouterr().err
    try:
        PLANS[kind](str(file))
    except InputError as error:
        return BAD_INPUT, f"{error}\n"
    return DONE, ""


def test_mutated_yaml(tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    dice = random.Random(1)
    texts = {kind: [path.read_text() for path in shipped(kind).values()] for kind in KINDS}
    statuses, wrong = set(), []
    for number in range(YAML_FILES):
        kind = dice.choice(KINDS)
        file = tmp_path / f"{kind}_{number}.yaml"
        file.write_bytes(mutated(dice.choice(texts[kind]), dice))
        try:
            status, errors = said(capsys, kind, file)
        except Exception as error:  # noqa: BLE001 (it is told below)
            status, errors = -1, repr(error)
        statuses.add(status)
        if status in (DONE, BAD_INPUT, DEGRADED) and errors.count("\n") == (status != DONE):
            file.unlink()
        else:
            wrong.append((str(file), status, errors))  # the file stays, to be looked at
    assert wrong == []
    assert statuses >= {DONE, BAD_INPUT}
