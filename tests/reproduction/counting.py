"""The operations of a compiled function, counted: it runs as plain Python on numbers that remember how they were made.

So the operations that an output needs can be told from those that only its derivatives need. What the code has as a
literal is no such number: what is formed of literals alone is known beforehand, and neither `+ 0` nor `* 1` counts.
Comparisons, absolute values and signs that are copied do not count either, but what is compared does.

`python -m tests.reproduction.counting` writes `config/references/operations.csv`.
"""

from __future__ import annotations

import csv
import math
from collections import Counter
from types import CellType, FunctionType, SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping import elementary
from facts_damping.neurofuzzy.network import Pass, backward, forward, network, shapes
from facts_damping.neurofuzzy.start import Start, initial
from facts_damping.neurofuzzy.table import VARIANTS
from facts_damping_reproduction.operations import OTHERS, SHAPE, file
from facts_damping_reproduction.printed import Operations

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from facts_damping.neurofuzzy.network import Network
    from facts_damping.neurofuzzy.table import Variant

# Where it is counted: every membership fires, and firing strengths lie in one half of the Legendre wavelets.
AT = (0.2, -0.1)
START = Start(weight=[0.5], spread=[0.5, 0.5], width=[3.0, 3.0], shift=[0.5, 0.5], dilation=[1.0, 1.0])

ADDITION, MULTIPLICATION, DIVISION, NEGATION = "additions", "multiplications", "divisions", "negations"
FUNCTIONS = {  # of `math` and `elementary`
    "exp": "exponentials",
    "sin": "trigonometric",
    "cos": "trigonometric",
    "tanh": "trigonometric",  # as table 3.1 has it
    "sqrt": "roots",
}


class Tape:
    """What has been computed: every operation, and the numbers that decisions were made by."""

    def __init__(self) -> None:
        self.made: list[Number] = []
        self.decided: list[Number] = []


class Number:
    """A float with the operation that made it, "" where none did, and the numbers that it was made of."""

    def __init__(self, tape: Tape, value: float, kind: str = "", of: Iterable[Any] = ()) -> None:
        self.tape, self.value, self.kind = tape, value, kind
        self.of = [x for x in of if isinstance(x, Number)]
        if kind:
            tape.made.append(self)

    def decide(self) -> float:
        """The value, for a comparison or for a place in a table."""
        self.tape.decided.append(self)
        return self.value

    def __add__(self, other: Any) -> Any:
        return _sum(self, other)

    def __radd__(self, other: Any) -> Any:
        return _sum(other, self)

    def __sub__(self, other: Any) -> Any:
        return self if _is(other, 0) else _made(ADDITION, _value(self) - _value(other), self, other)

    def __rsub__(self, other: Any) -> Any:
        return -self if _is(other, 0) else _made(ADDITION, _value(other) - _value(self), other, self)

    def __mul__(self, other: Any) -> Any:
        return _product(self, other)

    def __rmul__(self, other: Any) -> Any:
        return _product(other, self)

    def __truediv__(self, other: Any) -> Any:
        return self if _is(other, 1) else _made(DIVISION, _value(self) / _value(other), self, other)

    def __rtruediv__(self, other: Any) -> Any:
        return 0.0 if _is(other, 0) else _made(DIVISION, _value(other) / _value(self), other, self)

    def __neg__(self) -> Number:
        return _made(NEGATION, -self.value, self)

    def __abs__(self) -> Number:
        return _made("", abs(self.value), self)

    def __lt__(self, other: Any) -> bool:
        return self.decide() < _value(other, deciding=True)

    def __le__(self, other: Any) -> bool:
        return self.decide() <= _value(other, deciding=True)

    def __gt__(self, other: Any) -> bool:
        return self.decide() > _value(other, deciding=True)

    def __ge__(self, other: Any) -> bool:
        return self.decide() >= _value(other, deciding=True)

    def __eq__(self, other: object) -> bool:
        return self.decide() == _value(other, deciding=True)

    def __ceil__(self) -> int:
        return math.ceil(self.decide())

    def __int__(self) -> int:
        return int(self.decide())

    __hash__ = object.__hash__


def plain(function: Callable[..., Any]) -> Callable[..., Any]:
    """A compiled function as plain Python for numbers on a tape, with all of this package's that it calls."""
    source: Any = getattr(function, "py_func", function)
    namespace = dict(source.__globals__)
    for name in source.__code__.co_names:
        value = namespace.get(name)
        if value is math:
            namespace[name] = MATH
        elif name in FUNCTIONS and value is getattr(elementary, name, None):
            namespace[name] = getattr(MATH, name)
        elif isinstance(getattr(value, "py_func", value), FunctionType):
            namespace[name] = plain(value)  # type: ignore[arg-type]
    closure = tuple(CellType(plain(cell.cell_contents)) for cell in source.__closure__ or ())
    return FunctionType(source.__code__, namespace, source.__name__, source.__defaults__, closure or None)


def counted(numbers: Iterable[Number]) -> Counter[str]:
    """Numbers by the operation that made them."""
    return Counter(number.kind for number in numbers if number.kind)


def needed(tape: Tape, outputs: Iterable[Any]) -> list[Number]:
    """The numbers that outputs are made of, and those that any decision was made by."""
    by_id: dict[int, Number] = {}
    waiting = [*tape.decided, *(x for x in outputs if isinstance(x, Number))]
    while waiting:
        number = waiting.pop()
        if id(number) not in by_id:
            by_id[id(number)] = number
            waiting += number.of
    return list(by_id.values())


def _value(x: Any, *, deciding: bool = False) -> float:
    if isinstance(x, Number):
        return x.decide() if deciding else x.value
    return float(x)


def _is(x: Any, literal: float) -> bool:
    return not isinstance(x, Number) and x == literal


def _made(kind: str, value: float, *of: Any) -> Number:
    tape = next(x.tape for x in of if isinstance(x, Number))
    return Number(tape, value, kind, of)


def _sum(a: Any, b: Any) -> Any:
    if _is(a, 0) or _is(b, 0):
        return b if _is(a, 0) else a
    return _made(ADDITION, _value(a) + _value(b), a, b)


def _product(a: Any, b: Any) -> Any:
    if _is(a, 0) or _is(b, 0):
        return 0.0
    if _is(a, 1) or _is(b, 1):
        return b if _is(a, 1) else a
    return _made(MULTIPLICATION, _value(a) * _value(b), a, b)


def _function(name: str) -> Callable[[Any], Any]:
    """A function of `math` that counts."""
    function, kind = getattr(math, name), FUNCTIONS[name]
    return lambda x: _made(kind, function(x.value), x) if isinstance(x, Number) else function(x)


def _copysign(x: Any, sign: Any) -> Any:
    return _made("", math.copysign(_value(x), _value(sign)), x, sign)


MATH = SimpleNamespace(**{name: _function(name) for name in FUNCTIONS}, copysign=_copysign, ceil=math.ceil)


def passes(net: Network) -> Any:
    """What `network.passes` has, for numbers on a tape."""
    arrays = (np.full(shape, 0.0, object) for shape in shapes(net))
    return SimpleNamespace(**dict(zip(Pass._fields, arrays, strict=True)))


def counts(variant: Variant) -> tuple[Counter[str], Counter[str]]:
    """Operations by kind: those that the output of a network needs, and those of a whole step."""
    net, tape = network(variant.antecedent, variant.consequent, *SHAPE), Tape()
    theta, x = (
        np.array([Number(tape, float(value)) for value in values], object) for values in (initial(net, START), AT)
    )
    passed = passes(net)
    plain(forward)(net, theta, x, passed)
    output = counted(needed(tape, passed.output))
    plain(backward)(net, passed)
    return output, counted(tape.made)


def rows() -> list[dict[str, Any]]:
    """The rows of the file."""
    operation_rows = []
    for name, variant in VARIANTS.items():
        output, step = counts(variant)
        kinds = (*Operations._fields[2:], *OTHERS)
        operation_rows += [{"controller": name, "operation": o, "output": output[o], "step": step[o]} for o in kinds]
    return operation_rows


if __name__ == "__main__":
    with file().open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, ["controller", "operation", "output", "step"], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows())
