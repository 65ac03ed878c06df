"""The page of all models, from their rows: fields with units, and a diagram in characters, a line for each block."""

from __future__ import annotations

import ast
import importlib
import inspect
from functools import cache
from typing import TYPE_CHECKING, Any

from facts_damping_library import MODELS

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import CodeType

    from facts_damping.machine_controls.blocks import Block, Constant, Model

HEAD = """# Models of the PSS/E library

Controls of machines, and inverters with theirs, with their fields in the order of a DYR record, and their blocks. The
page is made from the files beside it (`python docs/generated.py`); [Machines and controls](../../docs/machines.md)
tells how they are used and how a model is added. Time constants (`T...`) are in s, all else is in p.u. or a code.

A line of a diagram is a block: what goes in, its transfer function, what it gives. `[low .. high]` are limits. Signals
from the machine, in p.u. of its rating: `Vt` terminal voltage, `omega` speed deviation, `Pe` electrical power, `Pa`
accelerating power, `Ifd` field current, `Vt0` terminal voltage at the start; `Vref`,
`Pref` references, `Vs` a stabiliser's output.

The blocks of an inverter and of its controls stand together. Their signals, in p.u. of its rating and out of it:
`Vt`, `Pe`, `Qe` at its terminals, `Vd`, `Vq`, `Id`, `Iq` in the frame of its source's angle; `Vbus`, `theta_bus` of the
bus that a plant control regulates, `Vcomp` compensated along the branch that it sees, with `Pbranch`, `Qbranch`; with a
0 what they are at the start; `Pext`, `Qext` references, for which a plant control's output stands; `Pref` that of the
power, behind a turbine's control; `speed` of a turbine, 1 without one; `Paux`, `Qaux`, `Vaux`, `Pplant`, `Qplant`,
`Vplant` setpoints of wide-area control. Behind a semicolon stands for which fields there is a block, and the signal
that holds its state while it is 1. Of a source the parts along and ahead of its angle are told: a current ahead of the
voltage takes reactive power.
"""
# Transfer functions by kind, with the constants of the block.
FORMS = {
    "lag": "{0} / (1 + s {1})",
    "lead_lag": "{0} (1 + s {1}) / (1 + s {2})",
    "washout": "{0} s {1} / (1 + s {1})",
    "rate": "s {0} / (1 + s {1})",
    "integral": "{0} / s",
    "servo": "1 / (1 + s {0}), rate {1} .. {2}",
    "field": "1 / ({0} + SE + s {1})",
    "exponential": "1 / ({0} + SE + s {1}), SE exponential",
    "second_order": "(1 + s {0} + s² {1}) / (1 + s {2} + s² {3})",
    "ramp_tracking": "((1 + s {0}) / (1 + s {1})^{2})^{3}",
    "product": "product",
    "source": "|{0} V + j ({2} + {0} {3}) I|",
    "rectifier": "rectifier, {0}",
    "sum": "sum",
    "limiter": "limiter",
    "pi": "{0} + {1} / s",
    "window": "second input from {0} to {1} of the first, else third",
    "relay": "1 from {1} on, 0 below {0}; lag {2}",
    "saturation": "({0} + SE) u",
    "quotient": "quotient",
    "curve": "curve of points",
    "dead_time": "exp(-s {0})",
    "regulator": "{0} + {1} / s",
    "dead_band": "dead band {0} .. {1}",
    "room": "sqrt({0}² - u²)",
    "after": "1, {0} s longer",
    "angle_lag": "1 / (1 + s {0}), of an angle",
    "stop": "{0} / s, at rest at a limit",
    "magnitude": "magnitude of two",
    "sine": "sine",
    "cosine": "cosine",
}
TITLES = {"inverter_control": "Controls of inverters"}
NONLINEAR = ("product", "rectifier", "quotient", "window", "magnitude")


def page() -> str:
    """The page as Markdown."""
    lines = [HEAD]
    for role in ("exciter", "governor", "stabiliser", "inverter", "inverter_control"):
        names = sorted(name for name, model in MODELS.items() if model.role == role)
        lines += [f"## {TITLES.get(role, f'{role.capitalize()}s')}", ""]
        for name in names:
            lines += [f"### {name}", "", *_about(name, MODELS[name]), ""]
    return "\n".join(lines)


def _about(name: str, model: Model) -> Iterator[str]:
    module = importlib.import_module(f"{__package__}.{model.role.removesuffix('_control')}s.{name.lower()}")
    text = inspect.cleandoc(module.__doc__ or "").partition("\n\n")[2]
    yield f"{model.text[0].upper()}{model.text[1:]}{'' if model.record else '; not in the PSS/E library'}."
    if text:
        yield f"\n{text}"
    ignored = f" Without effect here: {model.ignored.replace(' ', ', ')}." if model.ignored else ""
    yield f"\nFields: {' '.join(f'`{field}`' for field in model.fields.split())}.{ignored}"
    if model.approximations:
        yield f"\nOtherwise than in the library where fields ask for it: {'; '.join(model.approximations)}."
    if model.source:
        signals = (
            f"`{model.source.real}`, `{model.source.imag}`{f', `{model.source.angle}`' if model.source.angle else ''}"
        )
        yield f"\nIts source is a {model.source.kind}: {signals}."
    yield f"\n```text\n{chr(10).join(diagram(model))}\n```"


def diagram(model: Model) -> list[str]:
    """A line for each block: inputs, transfer function and limits, the signal that it gives."""
    inputs = [_inputs(block) for block in model.blocks]
    functions = [_function(block) for block in model.blocks]
    wide, function_wide = max(map(len, inputs)), max(map(len, functions))
    rows = zip(inputs, functions, model.blocks, strict=True)
    return [
        f"{signals:>{wide}} -->[ {function:^{function_wide}} ]--> {block.name}{_conditions(block)}"
        for signals, function, block in rows
    ]


def _conditions(block: Block) -> str:
    """For which fields there is a block, and what holds its states."""
    asked = _text(block.when).strip("()") if block.when else ""
    held = "" if block.hold == "none" else f"held by {block.hold}"
    texts = [text.replace(".0", "") for text in (asked, held) if text]
    return f"; {', '.join(texts)}" if texts else ""


def _inputs(block: Block) -> str:
    """The signals of a block; those of a nonlinear one stand beside each other."""
    if block.kind == "source":
        return "V, I"
    return block.inputs.replace(" + ", ", ") if block.kind in NONLINEAR else block.inputs.replace(" * ", " ")


def _function(block: Block) -> str:
    function = FORMS[block.kind].format(*map(_text, block.constants))
    function = function.removeprefix("1 ") if block.kind in ("lead_lag", "washout") else function
    low, high = (_limit(*side) for side in ((block.low, block.low_of), (block.high, block.high_of)))
    limits = f"[{low} .. {high}]" if low or high else ""
    return " ".join(part for part in (function, limits) if part)


def _limit(limit: Constant | None, of: str) -> str:
    text = "" if limit is None else _text(limit)
    return text if of == "one" else of if text == "1" else f"{text} {of}"


def _text(constant: Constant) -> str:
    """A constant as it is written in its file: a field, a number, or what follows from fields."""
    if isinstance(constant, str):
        return constant
    if not callable(constant):
        return f"{constant:g}"
    if constant.__doc__ and constant.__closure__:
        return constant.__doc__.rstrip(".").lower()
    if constant.__closure__:
        return " ".join(str(cell.cell_contents) for cell in constant.__closure__)
    text = _lambdas(constant.__module__).get(_does(constant.__code__), constant.__name__)
    return f"({text})" if " " in text else text


@cache
def _lambdas(module: str) -> dict[tuple[Any, ...], str]:
    """How the lambdas of a module are written, without their argument, by what they do."""
    texts = {}
    for node in ast.walk(ast.parse(inspect.getsource(importlib.import_module(module)))):
        if isinstance(node, ast.Lambda):
            (code, *_) = compile(ast.Expression(node), module, "eval").co_consts
            text = ast.unparse(node.body).replace(f"{node.args.args[0].arg}.", "").replace(" * ", " ")
            texts[_does(code)] = text
    return texts


def _does(code: CodeType) -> tuple[Any, ...]:
    """What a compiled function does, wherever it stands."""
    return code.co_code, code.co_consts, code.co_names
