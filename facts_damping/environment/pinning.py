"""Tuples of arrays at addresses, so that a compiled function can go through many loops, each of some hundred arrays.

A tuple is a list of numbers to compiled code: of each array the address and the shape. They are written down once, in a
buffer, and read again where they are needed. The arrays must be kept as long.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from facts_damping.compiling import compiled, specialised

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray


def _leaves(kind: Any, before: tuple[int, ...] = ()) -> Iterator[tuple[int, ...]]:
    """Places of all numbers in a struct of structs."""
    elements = getattr(kind, "elements", None)
    if elements is None or hasattr(kind, "count"):
        yield before
        return
    for i, one in enumerate(elements):
        yield from _leaves(one, (*before, i))


def _put(_typing: Any, _address: Any, value: Any) -> Any:
    def generate(_context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        address, tuple_ = given
        place = builder.inttoptr(address, tuple_.type.as_pointer())
        whole = [builder.gep(place, [_index(0)])]
        for path in _leaves(tuple_.type):
            at = builder.gep(whole[0], [_index(0), *map(_index, path)])
            builder.store(builder.extract_value(tuple_, path), at)
        return _context.get_dummy_value()

    return types.void(types.int64, value), generate


def _get(_typing: Any, _address: Any, like: Any) -> Any:
    def generate(context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        kind = context.get_value_type(like)
        place, made = builder.inttoptr(given[0], kind.as_pointer()), kind(None)
        for path in _leaves(kind):
            part = builder.load(builder.gep(place, [_index(0), *map(_index, path)]))
            made = builder.insert_value(made, part, path)
        return made

    return like(types.int64, like), generate


def _size(_typing: Any, like: Any) -> Any:
    def generate(context: Any, _builder: Any, _signature: Any, _given: Any) -> Any:
        size = context.get_abi_sizeof(context.get_value_type(like))
        return context.get_constant(types.int64, size)

    return types.int64(like), generate


def _index(i: int) -> Any:
    return ir.Constant(ir.IntType(32), i)


put_at: Any = intrinsic(_put)
get_at: Any = intrinsic(_get)
size_of: Any = intrinsic(_size)


@compiled
def _measure(value: Any) -> int:
    return size_of(value)  # type: ignore[no-any-return]


@compiled
def _write(address: int, value: Any) -> None:
    put_at(address, value)


def pin(value: Any) -> NDArray[np.uint8]:
    """A tuple of arrays in a buffer, whose address (`.ctypes.data`) `get_at` takes."""
    buffer = np.zeros(specialised(_measure, value)(value) + 64, np.uint8)
    specialised(_write, 0, value)(buffer.ctypes.data, value)
    return buffer
