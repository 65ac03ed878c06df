"""Controllers that are FMUs: FMI 2 or 3, co-simulation, run by FMPy.

Simulink, OpenModelica and Dymola export them: https://fmi-standard.org. At an arrival the inputs are set to the newest
signals, the FMU steps by the time between the two newest measurements, and its outputs are the setpoints. Its time is
measurement time; it starts at the first frame, with that frame's signals.
"""

from __future__ import annotations

import importlib
import weakref
from functools import cache
from io import BytesIO
from multiprocessing import util
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any
from zipfile import ZipFile

import numpy as np

from facts_damping.errors import InputError, one_line
from facts_damping.extras import library
from facts_damping.input_files import FMU, FMU_UNPACKED, check_unpacked, is_file, read_bytes
from facts_damping.parameters.run import Fmu

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Bool1, Float1
    from facts_damping.simulation.programs.spec import Spec

REAL = {"2.0": "Real", "3.0": "Float64"}  # type of real numbers, by version of FMI
ERROR = 3  # least status of a log message that counts as an error


class FmuController:
    """An FMU as a controller, called by `policies`."""

    def __init__(self, spec: Spec, source: str | Fmu, where: str) -> None:
        """Load it. Raises `InputError` if that fails or a variable is missing."""
        fmu = Fmu(file=source) if isinstance(source, str) else source
        self._errors: list[str] = []
        folder, description = unpacked(Path(fmu.file), where)
        names = {variable.name: variable for variable in description.modelVariables}
        self._real = REAL[description.fmiVersion]
        self._inputs, self._outputs, parameters = (
            self._references(names, causality, {name: others.get(name, name) for name in wanted}, fmu.file, where)
            for causality, others, wanted in (
                ("input", fmu.inputs, spec.signals),
                ("output", fmu.outputs, spec.devices),
                ("parameter", {}, spec.parameters),
            )
        )
        try:
            make = importlib.import_module("fmpy.simulation").instantiate_fmu
            self._fmu = make(folder.name, description, "CoSimulation", logger=self._log)
            self._set(parameters, [float(value) for value in spec.parameters.values()])
        except Exception as error:  # for example a library for another machine
            reason = one_line("; ".join([str(error), *self._errors]))
            problem = f"{fmu.file}: cannot be loaded: {reason}"
            raise InputError(f"{where}: {problem}; allowed: one for this machine") from error
        # Not freed at exit, which ends it anyway: an FMU in Python would no longer have an interpreter.
        weakref.finalize(self, self._fmu.freeInstance).atexit = False
        self._measured_ns = -1

    def step(self, t_s: float, y: Float1, age_s: Float1, _fresh: Bool1) -> list[float]:
        """Setpoints for the newest signals, p.u."""
        try:
            return self._step(round((t_s - float(np.min(age_s))) * 1e9), y.tolist())
        except Exception as error:
            raise RuntimeError("; ".join([str(error), *self._errors])) from error

    def _step(self, measured_ns: int, y: list[float]) -> list[float]:
        before, self._measured_ns = self._measured_ns, measured_ns
        if before < 0:
            self._initialise(measured_ns * 1e-9, y)
        else:
            self._set(self._inputs, y)
            self._fmu.doStep(before * 1e-9, (measured_ns - before) * 1e-9)
        outputs: list[float] = getattr(self._fmu, f"get{self._real}")(self._outputs)
        return outputs

    def _initialise(self, start_s: float, y: list[float]) -> None:
        if self._real == "Real":
            self._fmu.setupExperiment(startTime=start_s)
            self._fmu.enterInitializationMode()
        else:
            self._fmu.enterInitializationMode(startTime=start_s)
        self._set(self._inputs, y)
        self._fmu.exitInitializationMode()

    def _set(self, references: list[int], values: list[float]) -> None:
        if references:
            getattr(self._fmu, f"set{self._real}")(references, values)

    def _log(self, *message: Any) -> None:
        """Store error messages of the FMU for the exception of its call; `message` ends with status, category, text."""
        status, _, text = message[-3:]
        if status >= ERROR:
            self._errors.append(one_line((text or b"").decode(errors="replace")))

    def _references(
        self, names: dict[str, Any], causality: str, wanted: dict[str, str], file: str, where: str
    ) -> list[int]:
        """References of the variables for signals, devices or parameters. Raises `InputError` if one is missing."""
        fitting = [scalar for scalar in names.values() if scalar.causality == causality and scalar.type == self._real]
        allowed = [scalar.name for scalar in fitting if not scalar.dimensions]
        for element, name in wanted.items():
            if name not in allowed:
                more = f", or `{causality}s: {{{element}: ...}}`" if causality != "parameter" else ""
                lacks = f"{file} has no {causality} '{name}' of type {self._real}"
                raise InputError(f"{where}: {lacks}; allowed: {', '.join(allowed) or 'none'}{more}")
        return [names[name].valueReference for name in wanted.values()]


def unpacked(path: Path, where: str) -> tuple[TemporaryDirectory[str], Any]:
    """Temporary folder with an FMU unpacked, and its description. Raises `InputError`."""
    library("fmpy", "fmi", "FMPy", where)
    if not is_file(path):
        raise InputError(f"{where}: {path}: no such file; allowed: an FMU")
    try:
        folder, description = _unpack(path.resolve(), path.stat().st_mtime_ns)
    except InputError:
        raise
    except Exception as error:  # any error of archive, XML or FMPy
        reason = one_line(error) or type(error).__name__
        raise InputError(f"{where}: {path}: cannot be read: {reason}; allowed: an FMU of FMI 2 or 3") from error
    if description.fmiVersion not in REAL or description.coSimulation is None:
        standard = f"FMI {description.fmiVersion}" + ("" if description.coSimulation else " without co-simulation")
        raise InputError(f"{where}: {path}: {standard} given; allowed: FMI 2.0 or 3.0, for co-simulation")
    return folder, description


@cache
def _unpack(path: Path, _written: int) -> tuple[TemporaryDirectory[str], Any]:
    """Unpack an FMU into a temporary folder of this process, once for each version of its file."""
    content = read_bytes(path, FMU)
    check_unpacked(path, content, FMU_UNPACKED)
    folder = TemporaryDirectory(prefix="facts_damping_fmu_")
    util.Finalize(None, folder.cleanup, exitpriority=0)  # also in a forked node, which skips Python's normal exit
    with ZipFile(BytesIO(content)) as archive:
        archive.extractall(folder.name)  # safe: paths that lead out of the folder are redirected into it
    return folder, importlib.import_module("fmpy").read_model_description(folder.name)
