"""What the fuzzers share: texts and files that are nearly right, drawn by dice."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import random

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
