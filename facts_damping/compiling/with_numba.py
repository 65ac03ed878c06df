"""Code that uses Numba's internals: entry points and generation of object code; numba_types has the types of structs.

Numba optimises each function when it is compiled, and again inside each caller, and so on. Here functions are linked
unoptimised first, and the whole is optimised once.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numba
from llvmlite import ir
from numba.core import cgutils, codegen, compiler, dispatcher, registry, typed_passes, types, untyped_passes
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import PassManager
from numba.core.typing.templates import make_intrinsic_template, signature
from numba.extending import register_model
from numba.np import arrayobj

from facts_damping.compiling import keys
from facts_damping.compiling.numba_types import POINTER, WHOLE, StructType, TableType, _Pointer, type_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.compiling.functions import EntryFunction, PartFunction

_compiling: list[EntryFunction] = []  # entry points being compiled, in a process that only compiles
_dispatchers: list[Any] = []  # kept alive, as types only have weak references
# Kernels allocate nothing and keep no array, so reference counts of arrays are not needed (`_nrt`).
OPTIONS = {"error_model": "numpy", "_nrt": False, "no_cfunc_wrapper": True, "boundscheck": keys.checks_bounds()}


def _from_the_start(context: Any, builder: Any, kind: Any, index: Any, _size: Any) -> Any:
    """Return an index unchanged: kernels do not use negative indices, so no check is needed."""
    return context.cast(builder, index, kind, types.intp)


arrayobj.fix_integer_index = _from_the_start


class _Passes(compiler.CompilerBase):
    """The Numba passes that kernels need: no closures, no whole-array expressions, no branches by type."""

    def define_pipelines(self) -> list[Any]:
        manager = PassManager("kernels")
        for compiler_pass in (
            untyped_passes.TranslateByteCode,
            untyped_passes.FixupArgs,
            untyped_passes.IRProcessing,
            untyped_passes.GenericRewrites,
            untyped_passes.ReconstructSSA,
            typed_passes.NopythonTypeInference,
            typed_passes.PreLowerStripPhis,
            typed_passes.IRLegalization,
            typed_passes.NativeLowering,
            typed_passes.NoPythonBackend,
        ):
            manager.add_pass(compiler_pass, compiler_pass.__doc__ or "")
        manager.finalize()
        return [manager]


register_model(StructType)(_Pointer)
register_model(TableType)(_Pointer)


def _without_literals(compile_: Callable[[Any], Any], argument_types: Any) -> Any:
    """Compile a function for integers once, not again for each literal in a call such as `f(x, 0)`."""
    plain: Any = types.unliteral
    return compile_(tuple(map(plain, argument_types)) if isinstance(argument_types, tuple) else argument_types)


def _dispatcher(kernel: PartFunction, **options: Any) -> Any:
    compiled: Any = numba.njit(**{**OPTIONS, "forceinline": kernel.inline, **options})(kernel.py_func)
    compiled.compile = partial(_without_literals, compiled.compile)
    return compiled


def part(kernel: PartFunction) -> Any:
    """The type of a part: a function compiled by its callers and never called from Python."""
    compiled = _dispatcher(kernel, no_cpython_wrapper=True, pipeline_class=_Passes)
    compiled._insert = lambda *_, **__: None  # noqa: SLF001 (there is nothing that Python could call)
    _dispatchers.append(compiled)
    return types.Dispatcher(compiled)


def alone(kernel: PartFunction) -> Any:
    """A part as a separate function, compiled in each process; tests call such."""
    return _dispatcher(kernel)


def _signature_of(entry: EntryFunction) -> Any:
    result = type_of(entry.result) if entry.result is not type(None) else types.void
    return signature(result, *map(type_of, entry.kinds))


def _c_type(context: Any, entry: EntryFunction) -> Any:
    """The C function's type: numbers, pointers and array descriptions side by side; a bool is a byte."""
    typed = _signature_of(entry)
    flat = context.get_arg_packer(typed.args).argument_types
    result = {types.void: ir.VoidType(), types.boolean: ir.IntType(8)}.get(typed.return_type)
    result = result or context.get_value_type(typed.return_type)
    return ir.FunctionType(result, [ir.IntType(8) if llvm_type == ir.IntType(1) else llvm_type for llvm_type in flat])


def _typed_intrinsic(name: str, define: Any) -> Any:
    """The type of an intrinsic function defined here, for any object that represents it."""
    return types.Function(make_intrinsic_template(name, define, name))


def callee(entry: EntryFunction, address: Callable[[EntryFunction], int]) -> Any:
    """The type of an entry point for compiled callers: by its name, which the linker resolves after `address`."""
    typed = _signature_of(entry)
    if len(typed.args) == 0:
        raise TypeError(f"{entry.symbol}: no arguments; allowed: one or more")

    def generate(context: Any, builder: Any, sig: Any, operands: Any) -> Any:
        if not _compiling:
            address(entry)
        flat = list(context.get_arg_packer(sig.args).as_arguments(builder, operands))
        c_type = _c_type(context, entry)
        flat = [
            builder.zext(operand, to) if operand.type == ir.IntType(1) else operand
            for operand, to in zip(flat, c_type.args, strict=True)
        ]
        function = cgutils.get_or_insert_function(builder.module, c_type, entry.symbol)
        returned = builder.call(function, flat)
        if sig.return_type == types.boolean:
            return builder.trunc(returned, ir.IntType(1))
        return context.get_dummy_value() if sig.return_type == types.void else returned

    names = ", ".join(f"a{i}" for i in range(len(typed.args)))
    space: dict[str, Any] = {"made": (typed, generate)}
    exec(f"def define(context, {names}):\n    return made\n", space)  # noqa: S102 (Numba asks for the arguments' names)
    return _typed_intrinsic(entry.symbol, space["define"])


def _call_address(_context: Any, _address: Any, _controller: Any, _now_ns: Any) -> Any:
    function = ir.FunctionType(WHOLE, [WHOLE, WHOLE])

    def generate(_context: Any, builder: Any, _signature: Any, operands: Any) -> Any:
        address, *others = operands
        return builder.call(builder.inttoptr(address, function.as_pointer()), others)

    return types.int64(types.int64, types.int64, types.int64), generate


def _reinterpreted(context: Any, builder: Any, call_signature: Any, operands: Any) -> Any:
    """The same 64 bits as a value of another type."""
    return builder.bitcast(operands[0], context.get_value_type(call_signature.return_type))


def _bits_of(_context: Any, _number: Any) -> Any:
    return types.int64(types.float64), _reinterpreted


def _number_of(_context: Any, _bits: Any) -> Any:
    return types.float64(types.int64), _reinterpreted


def primitive(name: str) -> Any:
    """The type of a `kernels.Primitive`."""
    known = {"call_address": _call_address, "bits_of": _bits_of, "number_of": _number_of}
    return _typed_intrinsic(name, known[name])


class _Unoptimised(codegen.JITCodeLibrary):
    """Functions without optimisation, linked into their callers."""

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout  # noqa: SLF001

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalized = True


def _add_overload(self: Any, compiled: Any) -> None:
    """Record compiled functions in a dispatcher, without the Python wrapper."""
    self.overloads[tuple(compiled.signature.args)] = compiled


def _no_address(_builder: Any, _address: int, info: str) -> Any:
    """Stand in for an object of this process, whose address means nothing in another that loads the code."""
    if info != "Kernel" and not info.endswith("Dispatcher"):  # functions are called by their names
        raise TypeError(f"{info} given; allowed in compiled functions: what has no address")
    return ir.Constant(POINTER, None)


@global_compiler_lock
def object_code(entry: EntryFunction) -> bytes:
    """Object code of an entry point, for the target of this process (NUMBA_CPU_NAME)."""
    _compiling.append(entry)
    target = registry.cpu_target
    typing_context, context = target.typing_context, target.target_context
    generator = context.codegen()
    generator._library_class = _Unoptimised  # noqa: SLF001
    context.allow_dynamic_globals, context.add_dynamic_addr = False, _no_address
    context.get_executable = lambda *_: object()  # nothing runs here; each is one of its own
    dispatcher._DispatcherBase.add_overload = _add_overload  # noqa: SLF001
    typed = _signature_of(entry)
    flags = compiler.Flags()
    flags.nrt, flags.no_compile, flags.no_cpython_wrapper, flags.no_cfunc_wrapper = False, True, True, True
    flags.error_model, flags.boundscheck = "numpy", keys.checks_bounds()
    flags.enable_pyobject = flags.force_pyobject = False
    compiled = compiler.compile_extra(
        typing_context, context, entry.py_func, typed.args, typed.return_type, flags, {}, pipeline_class=_Passes
    )
    library = compiled.library
    module = library.create_ir_module(entry.symbol)
    _write_c_function(context, module, compiled.fndesc, entry)
    library.add_ir_module(module)
    library.finalize()
    final = library._final_module  # noqa: SLF001
    for function in final.functions:
        if not function.is_declaration and function.name != entry.symbol:
            function.linkage = "internal"
    manager, builder = generator._module_pass_manager()  # noqa: SLF001
    manager.run(final, builder)
    final.verify()
    return bytes(generator._tm.emit_object(final))  # noqa: SLF001


def _write_c_function(context: Any, module: Any, description: Any, entry: EntryFunction) -> None:
    typed, c_type = _signature_of(entry), _c_type(context, entry)
    function = ir.Function(module, c_type, entry.symbol)
    builder = ir.IRBuilder(function.append_basic_block())
    packer = context.get_arg_packer(description.argtypes)
    operands = [
        builder.trunc(operand, to) if to == ir.IntType(1) else operand
        for operand, to in zip(function.args, packer.argument_types, strict=True)
    ]
    inner = context.declare_function(module, description)
    status, returned = context.call_conv.call_function(
        builder, inner, description.restype, description.argtypes, packer.from_arguments(builder, operands)
    )
    if keys.checks_bounds():
        with builder.if_then(status.is_error):
            builder.call(ir.Function(module, ir.FunctionType(ir.VoidType(), []), "llvm.trap"), [])
    if typed.return_type == types.void:
        builder.ret_void()
    else:
        builder.ret(builder.zext(returned, ir.IntType(8)) if typed.return_type == types.boolean else returned)
