"""What a control of a machine is as a table of blocks: the next model is a row in `facts_damping_library`.

It is data: `plant.block_controls` knows the kinds of blocks. Models of the PSS/E library have its names and order.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable

    Constant = str | float | Callable[[Any], float]  # a field, a number, or a number that follows from fields

Role = Literal["exciter", "stabiliser", "governor", "inverter", "inverter_control"]

TABLES: dict[Role, str] = {  # of a system
    "exciter": "exciters",
    "stabiliser": "stabilisers",
    "governor": "governors",
    "inverter": "inverters",
    "inverter_control": "inverter_controls",
}

SHORTEST = 0.002  # s, of time constants; 0: a block without state


class Block(NamedTuple):
    """A block: the signal that it gives, its kind, what goes in, constants, and limits of its output or state."""

    name: str
    kind: str  # of plant.block_controls.KINDS
    inputs: str  # signals with signs: "Vref + Vs - VT"; with factors of constants: "K1 * P4 + K3 * P5"
    constants: tuple[Constant, ...] = ()
    low: Constant | None = None
    high: Constant | None = None
    low_of: str = "one"  # the signal that the limit is a multiple of
    high_of: str = "one"
    hold: str = "none"  # the signal that holds its states while it is 1
    when: Callable[[Any], bool] | None = None  # whether fields ask for it; blocks of one name are alternatives
    start: float | None = None  # of its state, where no equation of the start says otherwise


class Term(NamedTuple):
    """A signal in the inputs of a block, with its sign and its factor; no factor: 1."""

    sign: str
    factor: str
    signal: str


def terms(inputs: str) -> list[Term]:
    """The signals of an expression such as "Vref - K1 * VT"."""
    return [Term(*parts) for parts in re.findall(r"([+-]?)\s*(?:(\w+)\s*\*\s*)?(\w+)", inputs)]


def number(constant: Constant, data: Any) -> float:
    """A constant of a model: a number, a field of its parameters, or a value that follows from fields."""
    if isinstance(constant, str):
        return float(getattr(data, constant))
    return float(constant(data) if callable(constant) else constant)


class Source(NamedTuple):
    """How an inverter feeds the network: the signals of its source, in the direction of an angle.

    `current`: real + j imag is its current, reduced at low and high voltage by `constants` (Lvpnt0, Lvpnt1, Volim,
    Iolim, Khv). `voltage`: it is an EMF behind the impedance `constants` (R, X), with the current's limit, Imax. These
    signals, and the angle, follow from states alone.
    """

    kind: Literal["current", "voltage"]
    real: str
    imag: str
    constants: tuple[Constant, ...]
    angle: str = ""  # the signal that is its angle, rad; none: that of the terminal's voltage
    forming: bool = False  # whether its angle is that of the EMF, and not that of the voltage
    virtual: bool = False  # whether it forms a grid as a virtual machine, though its angle is that of a PLL

    @property
    def forms_a_grid(self) -> bool:
        """Whether it has a direction of its own, with or without a PLL."""
        return self.forming or self.virtual


class Model(NamedTuple):
    """A control: what it is for, its fields in the order of a DYR record, its blocks; the last one's output counts."""

    role: Role
    text: str
    fields: str
    blocks: tuple[Block, ...]
    ignored: str = ""  # fields of the record that have no effect here
    factors: dict[str, Callable[[Any], float]] = {}  # of inputs, that follow from fields
    record: bool = True  # whether it is one of the PSS/E library's, with fields in the order of a DYR record there
    optional: str = ""  # fields that a system file may leave out: 0
    approximations: dict[str, Callable[[Any], bool]] = {}  # what is otherwise in the library; whether fields ask for it
    source: Source | None = None  # of an inverter


class Quantity(NamedTuple):
    """Unit, what it is, least and greatest value; `time`: 0 or at least `SHORTEST`."""

    unit: str
    text: str
    minimum: float = -1e7  # a limit of 999999 stands for none
    maximum: float = 1e7
    time: bool = False


def saturation(field: Any) -> tuple[float, float]:
    """A and B of SE(E) E = B (E - A)^2 above A, through SE1 at E1 and SE2 at E2; B = 0 where one of them is 0: none."""
    (E1, SE1), (E2, SE2) = sorted([(field.E1, field.SE1), (field.E2, field.SE2)])
    if E1 <= 0.0 or SE1 <= 0.0 or SE1 * E1 >= SE2 * E2:
        return 0.0, 0.0
    root = math.sqrt(SE1 * E1 / (SE2 * E2))
    A = (E1 - root * E2) / (1.0 - root)
    return A, SE2 * E2 / ((E2 - A) * (E2 - A))


def exponential(field: Any) -> tuple[float, float]:
    """A and B of SE(E) = A exp(B E) through SE1 at E1 and SE2 at E2; A = 0 where one of them is 0: none."""
    if field.SE1 <= 0.0 or field.SE2 <= 0.0 or field.E1 == field.E2:
        return 0.0, 0.0
    B = math.log(field.SE1 / field.SE2) / (field.E1 - field.E2)
    return field.SE1 * math.exp(-B * field.E1), B
