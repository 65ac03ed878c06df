"""Structs: named numbers and arrays of fixed types, which compiled code reads through one pointer.

    class Plant(Struct):
        omega_0: float
        x: Float1
        machines: Annotated[NDArray[Any], Array(MACHINE, 1)]
        links: Links      # another struct
        nets: Table[Net]  # several

    class Nets(Net, each=Net):  # the same arrays with a leading axis; `nets.each[i]` is the i-th

An object owns its values and a memory block that describes them: eight bytes for a number or the address of a struct;
for an array its size, address, shape and strides. Setting a field updates the block at once, so the block never has
dangling pointers. Kernels read fields like those of any object: `plant.x`.
"""

from __future__ import annotations

import ctypes
import hashlib
import inspect
import struct
import typing
import weakref
from collections.abc import Iterator, Sequence  # noqa: TC003
from functools import cache
from typing import Annotated, Any, ClassVar, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self, dataclass_transform


class Array(NamedTuple):
    """Type of an array: element type and number of axes; it is contiguous, with the last axis the fastest."""

    dtype: Any
    ndim: int

    @property
    def words(self) -> int:
        """Words that describe an array in Numba: owner, parent, elements, bytes of one, address, shape, strides."""
        return 5 + 2 * self.ndim


Float1 = Annotated[NDArray[np.float64], Array(np.float64, 1)]
Float2 = Annotated[NDArray[np.float64], Array(np.float64, 2)]
Float3 = Annotated[NDArray[np.float64], Array(np.float64, 3)]
Float4 = Annotated[NDArray[np.float64], Array(np.float64, 4)]
Complex1 = Annotated[NDArray[np.complex128], Array(np.complex128, 1)]
Complex2 = Annotated[NDArray[np.complex128], Array(np.complex128, 2)]
Complex3 = Annotated[NDArray[np.complex128], Array(np.complex128, 3)]
Int1 = Annotated[NDArray[np.int64], Array(np.int64, 1)]
Int2 = Annotated[NDArray[np.int64], Array(np.int64, 2)]
Int3 = Annotated[NDArray[np.int64], Array(np.int64, 3)]
Int4 = Annotated[NDArray[np.int64], Array(np.int64, 4)]
Bool1 = Annotated[NDArray[np.bool_], Array(np.bool_, 1)]
Bool2 = Annotated[NDArray[np.bool_], Array(np.bool_, 2)]

HOST = "host"  # marks a field that compiled code does not use
WORD_TYPES = {float: "f8", int: "i8", bool: "i8"}


def kind_of(hint: Any) -> Any:
    """The kind of a field or argument from its annotation: float, int, bool, an `Array`, a struct, a `Table`."""
    if typing.get_origin(hint) is Annotated:
        return next(kind for kind in hint.__metadata__ if isinstance(kind, Array) or kind == HOST)
    if is_numbers(hint):
        return hint
    if hint in WORD_TYPES or typing.get_origin(hint) is Table or (isinstance(hint, type) and issubclass(hint, Struct)):
        return hint
    raise TypeError(f"{hint}: allowed: float, int, bool, an array with its type, a struct, a table of structs")


@cache
def is_numbers(kind: Any) -> bool:
    """Whether a kind is a named tuple of numbers, which are passed one by one."""
    return (
        isinstance(kind, type)
        and issubclass(kind, tuple)
        and set(typing.get_type_hints(kind).values()) <= set(WORD_TYPES)
    )


def words_of(kind: Any) -> list[Any]:
    """Types of the words that describe a field or an argument."""
    if isinstance(kind, Array):
        return [int] * kind.words
    return list(typing.get_type_hints(kind).values()) if is_numbers(kind) else [kind if kind in WORD_TYPES else int]


def address_of(array: NDArray[Any]) -> int:
    """Address of a contiguous array; `array.ctypes` takes several times as long."""
    if array.size and array.flags.writeable:
        return ctypes.addressof(ctypes.c_char.from_buffer(array))  # type: ignore[arg-type]
    return int(array.ctypes.data)  # for empty and read-only ones


def array_words(array: Any, kind: Array, where: str) -> tuple[int, ...]:
    """Words that describe an array. Raises `TypeError` if it has a wrong type."""
    if not isinstance(array, np.ndarray) or array.dtype != kind.dtype or array.ndim != kind.ndim:
        array_type = f"{array.dtype}, {array.ndim} axes" if isinstance(array, np.ndarray) else type(array).__name__
        raise TypeError(f"{where}: {array_type} given; allowed: an array of {np.dtype(kind.dtype)}, {kind.ndim} axes")
    if not array.flags.c_contiguous:
        raise TypeError(f"{where}: an array with gaps given; allowed: contiguous")
    return (0, 0, array.size, array.itemsize, address_of(array), *array.shape, *array.strides)


@dataclass_transform(eq_default=False)
class Struct:
    """Base of structs, see the module. Arguments are the fields in their order, or by name."""

    _fields: ClassVar[tuple[str, ...]] = ()
    _each: ClassVar[type[Struct] | None] = None  # struct of the rows
    each: ClassVar[Any]  # the rows, a `Table`
    block: ClassVar[Any]  # memory block that describes the fields
    pointer: ClassVar[int]  # address of the block
    owners: ClassVar[list[Any]]  # structs whose rows are views of its arrays

    def __init_subclass__(cls, *, each: type[Struct] | None = None) -> None:
        """Take the fields from the annotations; a derived class has its base's fields first, with its own types."""
        cls._fields = tuple(dict.fromkeys((*cls._fields, *inspect.get_annotations(cls))))
        if each is not None:
            cls._each = each

    def __init__(self, *values: Any, **named: Any) -> None:
        cls: Any = type(self)
        named_values = dict(zip(cls._fields, values, strict=False)) | named
        if len(values) + len(named) != len(cls._fields) or set(named_values) != set(cls._fields):
            raise TypeError(f"{cls.__name__}: {', '.join(named_values)} given; allowed: {', '.join(cls._fields)}")
        words: list[int] = []
        for name in cls._fields:
            words += self._words(name, named_values[name])
        block = np.array([*words, 0], np.int64)  # the last word: of `each`
        self.__dict__.update(block=block, pointer=address_of(block), owners=[])
        self._split()

    def _words(self, name: str, value: Any) -> Sequence[int]:
        """Keep a field's value; returns the words that describe it. Raises `TypeError` if it has a wrong type."""
        cls: Any = type(self)
        kind, _ = layout(cls)[name]
        words: Sequence[int] = (0,)
        if isinstance(kind, Array):
            words = array_words(value, kind, f"{cls.__name__}.{name}")
        elif kind in WORD_TYPES:
            value = kind(value)
            words = struct.unpack("q", struct.pack("d", value)) if kind is float else (value,)
        elif kind != HOST:
            if type(value) is not (typing.get_origin(kind) or kind):
                raise TypeError(f"{cls.__name__}.{name}: {type(value).__name__} given; allowed: {kind}")
            words = (value.pointer,)
            if self._each is not None:
                value.owners.append(weakref.ref(self))  # for rows that are views of its arrays
        self.__dict__[name] = value
        return words

    def _split(self) -> None:
        """Make the rows `each`: views of every field along the first axis."""
        if self._each is not None:
            many = next(len(value) for value in self if isinstance(value, np.ndarray))
            self.__dict__["each"] = rows = Table([self._row(i) for i in range(many)])
            cls: Any = type(self)
            self.block[layout(cls)["each"][1]] = rows.pointer
        for owner in self.owners:
            if (parent := owner()) is not None:
                parent._split()  # noqa: SLF001 (another of its kind)

    def _row(self, i: int) -> Struct:
        row_class: Any = self._each
        parts = ((value[i] if isinstance(value, np.ndarray) else value.each[i]) for value in self)
        return row_class(*parts)  # type: ignore[no-any-return]

    def __setattr__(self, name: str, value: Any) -> None:
        """Set a field, also in the block. Raises `TypeError` if it has a wrong type."""
        cls: Any = type(self)
        words, at = self._words(name, value), layout(cls)[name][1]
        self.block[at : at + len(words)] = words
        self._split()

    def __iter__(self) -> Iterator[Any]:
        """Iterate over the fields' values in their order."""
        return (self.__dict__[name] for name in self._fields)

    def _replace(self, **changes: Any) -> Self:
        """A copy with some fields changed."""
        if self._each is not None:
            return type(self)(**{name: self.__dict__[name] for name in self._fields} | changes)
        copy, block = object.__new__(type(self)), self.block.copy()
        copy.__dict__.update(self.__dict__, block=block, pointer=address_of(block), owners=[])
        for name, value in changes.items():
            setattr(copy, name, value)
        return copy

    def __reduce__(self) -> tuple[Any, ...]:
        """A copy has a block of its own."""
        return type(self), tuple(self)

    def __repr__(self) -> str:
        """Class name and field names, without the long arrays."""
        return f"{type(self).__name__}({', '.join(self._fields)})"


S = TypeVar("S", bound=Struct)


class Table(Generic[S]):
    """Several structs of a class; compiled code has their number, and each by its index."""

    def __init__(self, rows: Sequence[S]) -> None:
        self.rows = tuple(rows)
        self._block = np.array([len(self.rows), *(row.pointer for row in self.rows)], np.int64)
        self.pointer: int = address_of(self._block)

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, i: int) -> S:
        return self.rows[i]

    def __iter__(self) -> Iterator[S]:
        return iter(self.rows)

    def __reduce__(self) -> tuple[Any, ...]:
        """A copy has a block of its own."""
        return type(self), (self.rows,)


@cache
def layout(cls: Any) -> dict[str, tuple[Any, int]]:
    """Kind of each field, and its position in the block, in words."""
    fields, at, hints = {}, 0, typing.get_type_hints(cls, include_extras=True)
    for name in cls._fields:
        kind = kind_of(hints[name])
        origin: Any = next(base_class for base_class in cls.__mro__ if name in inspect.get_annotations(base_class))
        of_row = cls._each is not None and origin._each is None  # noqa: SLF001 (another of its kind)
        if of_row and isinstance(kind, Array):
            kind = kind._replace(ndim=kind.ndim + 1)
        fields[name] = kind, at
        at += kind.words if isinstance(kind, Array) else 1
    return fields | ({} if cls._each is None else {"each": (Table[cls._each], at)})


@cache
def fingerprint(cls: Any) -> str:
    """A short hash of a struct's layout, with those of the structs in it: what is compiled for it depends on this."""
    lines = []
    for name, (kind, at) in layout(cls).items():
        inside: list[Any] = [
            part for part in (kind, *typing.get_args(kind)) if isinstance(part, type) and issubclass(part, Struct)
        ]
        lines.append(f"{name} {at} {described(kind)} {[fingerprint(struct) for struct in inside]}")
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:20]


def described(kind: Any) -> Any:
    """A kind as text with everything that compiled code depends on."""
    if isinstance(kind, Array):
        return f"{np.dtype(kind.dtype).descr}{kind.ndim}"
    if kind in WORD_TYPES:
        return kind.__name__
    if is_numbers(kind):
        return f"{kind.__qualname__}{typing.get_type_hints(kind)}"
    type_arguments = typing.get_args(kind)
    return f"{typing.get_origin(kind) or kind}{type_arguments}"
