"""Types of Numba for structs and their tables."""

from __future__ import annotations

import operator
import typing
from functools import cache
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.datamodel import models
from numba.core.typing.templates import AbstractTemplate, AttributeTemplate, infer_global, signature
from numba.extending import NativeValue, infer_getattr, lower_builtin, lower_getattr_generic, unbox

from facts_damping.compiling.structs import (
    HOST,
    WORD_TYPES,
    Array,
    Struct,
    Table,
    fingerprint,
    is_numbers,
    layout,
    words_of,
)

POINTER = ir.IntType(8).as_pointer()


WHOLE = ir.IntType(64)


class StructType(types.Type):
    """A struct: a pointer to its block."""

    def __init__(self, cls: Any) -> None:
        self.cls = cls
        super().__init__(name=f"Struct({cls.__module__}.{cls.__qualname__} {fingerprint(cls)})")


class TableType(types.Type):
    """Several structs: a pointer to their number and addresses."""

    def __init__(self, cls: Any) -> None:
        self.cls = cls
        super().__init__(name=f"Table({cls.__module__}.{cls.__qualname__} {fingerprint(cls)})")


class _Pointer(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, POINTER)


@cache
def type_of(kind: Any) -> Any:
    """Numba's type of a kind of field or argument."""
    if isinstance(kind, Array):
        return types.Array(numba.from_dtype(np.dtype(kind.dtype)), kind.ndim, "C")
    if kind in WORD_TYPES:
        return {float: types.float64, int: types.int64, bool: types.boolean}[kind]
    if is_numbers(kind):
        return numba.typeof(kind(*(word() for word in words_of(kind))))
    if typing.get_origin(kind) is Table:
        return TableType(*typing.get_args(kind))
    return StructType(kind)


def _word(builder: Any, block: Any, at: int, kind: Any) -> Any:
    """A word of a block, which is constant while compiled code runs."""
    place = builder.gep(builder.bitcast(block, WHOLE.as_pointer()), [WHOLE(at)])
    word = builder.load(builder.bitcast(place, kind.as_pointer()))
    word.set_metadata("invariant.load", builder.module.add_metadata([]))
    return word


def _field(context: Any, builder: Any, block: Any, kind: Any, at: int) -> Any:
    field_type = type_of(kind)
    if not isinstance(kind, Array):
        if kind is bool:
            return builder.trunc(_word(builder, block, at, ir.IntType(8)), ir.IntType(1))
        return _word(builder, block, at, context.get_value_type(field_type))
    array = context.make_array(field_type)(context, builder)
    data = context.get_data_type(field_type.dtype).as_pointer()
    array.meminfo = array.parent = ir.Constant(POINTER, None)
    array.nitems, array.itemsize = _word(builder, block, at + 2, WHOLE), _word(builder, block, at + 3, WHOLE)
    array.data = _word(builder, block, at + 4, data)
    shape = [_word(builder, block, at + 5 + i, WHOLE) for i in range(kind.ndim)]
    strides = [_word(builder, block, at + 5 + kind.ndim + i, WHOLE) for i in range(kind.ndim)]
    array.shape, array.strides = cgutils.pack_array(builder, shape), cgutils.pack_array(builder, strides)
    return array._getvalue()  # noqa: SLF001


@infer_getattr
class _Fields(AttributeTemplate):
    """Types of a struct's fields."""

    key = StructType

    def generic_resolve(self, struct: Any, name: str) -> Any:
        field = layout(struct.cls).get(name)
        return None if field is None or field[0] == HOST else type_of(field[0])


@lower_getattr_generic(StructType)
def _load(context: Any, builder: Any, struct: Any, value: Any, name: str) -> Any:
    return _field(context, builder, value, *layout(struct.cls)[name])


@infer_global(operator.getitem)
class _Getitem(AbstractTemplate):
    def generic(self, args: Any, _kws: Any) -> Any:
        if isinstance(args[0], TableType) and isinstance(args[1], types.Integer):
            return signature(StructType(args[0].cls), args[0], types.int64)
        return None


@infer_global(len)
class _Len(AbstractTemplate):
    def generic(self, args: Any, _kws: Any) -> Any:
        return signature(types.int64, args[0]) if isinstance(args[0], TableType) else None


@lower_builtin(operator.getitem, TableType, types.int64)
def _row(_context: Any, builder: Any, _signature: Any, operands: Any) -> Any:
    place = builder.gep(builder.bitcast(operands[0], POINTER.as_pointer()), [builder.add(operands[1], WHOLE(1))])
    return builder.load(place)


@lower_builtin(len, TableType)
def _many(_context: Any, builder: Any, _signature: Any, operands: Any) -> Any:
    return _word(builder, operands[0], 0, WHOLE)


@numba.extending.typeof_impl.register(Struct)
def _typeof(value: Any, _context: Any) -> Any:
    return StructType(type(value))


@unbox(StructType)
def _unbox(_type: Any, value: Any, c: Any) -> Any:
    address = c.pyapi.object_getattr_string(value, "pointer")
    pointer = c.builder.inttoptr(c.pyapi.long_as_longlong(address), POINTER)
    c.pyapi.decref(address)
    return NativeValue(pointer)
