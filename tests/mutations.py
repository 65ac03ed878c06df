"""What the fuzzers share: texts and files that are nearly right, drawn by dice."""

from __future__ import annotations

import math
import re
from copy import deepcopy
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import random
    from collections.abc import Iterator

ODD = (
    *("", "~", "yes", "[]", "{}", "-1", "0", "1e400", ".nan", "-.inf", "1e-300", "99999999999999999999", "'x'", "*a"),
    *("&a [*a]", "!!python/none", "\t", "ü", "\x00", "\x1b[2J", "\u202e", "[[[[[[[[", "{a: {a: {a: 1}}}"),
    *("1" * 5000, "- - -", "? x", "<<: 1", "/etc/hostname", "/dev/zero", "../x.yaml", "1e308", "9D", "<", "&lt;", '"'),
)


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


def damaged(whole: bytes, dice: random.Random) -> bytes:
    """A file with a few changes: bits, blocks, length."""
    data = bytearray(whole)
    for _ in range(dice.randint(1, 4)):
        at, length, change = dice.randrange(len(data)), dice.choice([1, 8, 100, 5000]), dice.randrange(7)
        if change < 3:
            data[at] ^= 1 << dice.randrange(8)
        elif change == 3:
            data[at : at + length] = dice.randbytes(len(data[at : at + length]))
        elif change == 4:
            del data[at : at + length]
        elif change == 5:
            data[at:at] = data[at : at + length]
        else:
            del data[at:]
        data = data or bytearray(1)
    return bytes(data)


DEEP: Any = 1
for _ in range(15):
    DEEP = [DEEP]
VALUES: tuple[Any, ...] = (
    *(None, True, -1, 0, 1, 3.5, 1e308, math.inf, math.nan, 10**30, -(10**30), "", "x", "9D", "\x1b[2J"),
    *("/etc/hostname", "../x.yaml", "two_area", [], {}, [None], ["x"], {"a": 1}, [0.0] * 5, DEEP),
)


def _places(content: Any) -> Iterator[tuple[Any, Any]]:
    """Each table or list within a content, with each of its keys or indices."""
    for key in list(content) if isinstance(content, dict) else range(len(content)):
        yield content, key
        if isinstance(content[key], (dict, list)):
            yield from _places(content[key])


def changed(content: Any, dice: random.Random) -> Any:
    """A copy of a content with one or two changes: of a value, its type or key; of a list's length."""
    copy = deepcopy(content)
    for _ in range(dice.choice([1, 1, 2])):
        places = list(_places(copy))
        upper = [(table, key) for table, key in places if table is copy]
        table, key = dice.choice(dice.choice([places, upper or places]))
        change = dice.randrange(8)
        if change == 0:
            del table[key]
        elif change == 1 and isinstance(table, dict):
            table["weather"] = "rain"
        elif change == 2 and isinstance(table, dict):
            table[f"{key}s"] = table.pop(key)
        elif change == 3 and isinstance(table, list):
            table.append(table[key])
        elif change == 4 and isinstance(table[key], (dict, list)):
            table[key].clear()
        else:
            table[key] = dice.choice(VALUES)
        if not copy:
            return copy
    return copy
