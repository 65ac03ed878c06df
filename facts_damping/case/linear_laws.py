"""Reads and checks the user's own linear controllers from YAML, NPZ or MAT."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.case.mat_file import as_npz
from facts_damping.control.linear_law import matrices
from facts_damping.errors import InputError, one_line
from facts_damping.input_files import MATRICES, check_unpacked, is_file, read_bytes
from facts_damping.parameters.field_errors import FieldError, check, check_field, of_field
from facts_damping.parameters.files import read_table
from facts_damping.parameters.linear_law import FORMS, LinearLaw

if TYPE_CHECKING:
    from facts_damping.parameters.run import Controller

NAMES = (*(name for form in FORMS for name in form), "dt")
NEAR = 1e-6  # relative tolerance of a period, which files round


def with_law(controller: Controller, field: str, frame_rate: int) -> Controller:
    """A controller with its `linear` law inline. Raises `InputError` if it is invalid or does not fit."""
    source = controller.linear
    if source is None:
        return controller
    if isinstance(source, str):
        law = check(LinearLaw, _read(Path(source), field), source)
    else:
        law = check_field(LinearLaw, source, field)
    if law.dt is not None and abs(law.dt * frame_rate - 1.0) > NEAR:
        allowed = f"the frames' {1.0 / frame_rate:.9g} s, or none: continuous"
        raise FieldError(field, f"{law.dt:g} s given; allowed: {allowed}", ".dt")
    with of_field(field):
        matrices(law, len(controller.signals), len(controller.devices))
    return controller.model_copy(update={"linear": law.model_dump(exclude_none=True)})


def _read(path: Path, field: str) -> dict[str, Any]:
    if not is_file(path):
        raise FieldError(field, f"{path}: no such file; allowed: a law in a .yaml, .npz or .mat file")
    if path.suffix in (".yaml", ".yml"):
        return read_table(path)
    if path.suffix not in (".npz", ".mat"):
        raise FieldError(field, f"{path} given; allowed: a law in a .yaml, .npz or .mat file")
    try:
        arrays = _arrays(path)
    except InputError:
        raise
    except Exception as error:  # the readers raise many kinds
        reason = one_line(error) or type(error).__name__
        raise InputError(f"{path}: cannot be read: {reason}; allowed: arrays {', '.join(NAMES)}") from error
    unknown = [name for name in arrays if name not in NAMES]
    if unknown:
        raise InputError(f"{path}: '{unknown[0]}' given; allowed: arrays {', '.join(NAMES)}")
    return {name: _plain(name, values, path) for name, values in arrays.items()}


def _arrays(path: Path) -> dict[str, Any]:
    content = read_bytes(path)
    if path.suffix == ".mat":
        content = as_npz(content)
    check_unpacked(path, content, MATRICES)
    return dict(np.load(BytesIO(content), allow_pickle=False).items())


def _plain(name: str, values: Any, path: Path) -> Any:
    """An array as lists of numbers: matrix, list or number; complex values as text."""
    array = np.asarray(values)
    if array.dtype.kind not in "fiuc" or array.ndim > 2:
        raise InputError(f"{path}: {name}: no numbers given; allowed: real matrices, and complex zeros and poles")
    if name in ("gain", "dt"):
        if array.size != 1:
            raise InputError(f"{path}: {name}: {array.size} numbers given; allowed: one")
        return float(array.real.item())
    if name in ("A", "B", "C", "D"):
        if array.dtype.kind == "c":
            raise InputError(f"{path}: {name}: complex numbers given; allowed: real ones")
        return np.atleast_2d(array).astype(float).tolist()
    flat = array.ravel().tolist()
    return [str(number) if isinstance(number, complex) else float(number) for number in flat]
