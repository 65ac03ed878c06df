"""Controllers that are user's classes: found, instantiated, and called by the compiled step.

    class Damper:
        def __init__(self, spec): ...              # `Spec`
        def reset(self): ...                       # at the start of a run; may be left out
        def step(self, t_s, y, age_s, fresh): ...  # -> u

`step` is called at every arrival at which a shipped controller would act; with `once_a_tick = True` in the class, only
at the last one of each tick. t_s: time of arrival, s; y: signals, (signals,), p.u.; age_s: age of the newest frame of
each signal, s; fresh: whether a signal has a new frame. It returns the setpoints u, (devices,), p.u., before limits.
An exception or an invalid setpoint ends the run.
"""

from __future__ import annotations

import ctypes
import inspect
import time
from array import array
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.case.names import controller_names
from facts_damping.control.table import kind_of
from facts_damping.errors import InputError, RunError
from facts_damping.signals import NANOSECONDS
from facts_damping.simulation.programs.fmus import FmuController
from facts_damping.simulation.programs.spec import spec_of
from facts_damping.simulation.programs.user_code import described, file_of, find, running, users

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.control.bank import BankState
    from facts_damping.parameters.run import Controller
    from facts_damping.simulation.programs.spec import Spec

STEP = ("t_s", "y", "age_s", "fresh")
_C_FUNCTION = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64, ctypes.c_int64)  # as `control.called` calls it


class StepTimes(NamedTuple):
    """Durations of a program's steps, s of wall time."""

    steps: int
    mean_s: float
    p99_s: float
    max_s: float

    def __str__(self) -> str:
        """One line of text."""
        texts = (f"{1e6 * value:.0f} us" if value < 1e-3 else f"{1e3 * value:.3g} ms" for value in self[1:])
        return "{} steps of {}, 99 % within {}, longest {}".format(self.steps, *texts)


class Program:
    """A controller's program, connected to its row of the bank."""

    def __init__(self, case: Case, c: int, state: BankState) -> None:
        """Create the program. Raises `InputError` if that fails."""
        controller = case.controllers[c]
        self.name, self.node, self.devices = controller.name, controller_names(case)[c], controller.devices
        self.error: BaseException | None = None
        self.now_ns = 0
        self.elapsed_ns, self.late = array("q"), 0  # duration of each step; number of steps longer than a frame
        self._period_ns = NANOSECONDS // case.run.frame_rate
        signals, devices = len(controller.signals), len(controller.devices)
        self._y, self._u = state.compensated.signal[c, :signals], state.unlimited[c, :devices]
        self._age, self._fresh = state.calls.sensed.age[c, :signals], state.calls.sensed.fresh[c, :signals]
        self._where = f"controllers.{c}.{kind_of(controller).own}"
        self._file, self._step, state.calls.once[c] = instance(controller, spec_of(case, c), self._where)
        self._function = _C_FUNCTION(self._call)  # a reference keeps it alive while it may be called
        state.calls.address[c] = ctypes.cast(self._function, ctypes.c_void_p).value or 0

    def _call(self, _controller: int, now_ns: int) -> int:
        """Run a step for the compiled code; returns 1 if it has failed, else 0."""
        try:
            self.now_ns = now_ns
            arguments = now_ns / 1e9, self._y.copy(), self._age.copy(), self._fresh.copy()
            began = time.perf_counter_ns()
            with running:
                u = self._step(*arguments)
            self.elapsed_ns.append(time.perf_counter_ns() - began)
            self.late += self.elapsed_ns[-1] > self._period_ns
            self._u[:] = checked(u, self.devices)
        except BaseException as error:  # noqa: BLE001 (between compiled functions none can pass; `check` raises it)
            self.error = error
            return 1
        return 0

    def check(self) -> None:
        """Raise `RunError`, with the line of code, if a step has failed."""
        if self.error is None:
            return
        if isinstance(self.error, KeyboardInterrupt):
            raise self.error
        what = described(self.error, self._file)
        raise RunError(f"{self._where}: {what}, in step of {self.name} at {self.now_ns / 1e9:.6g} s") from self.error

    def times(self) -> StepTimes | None:
        """Durations of the steps so far; None before the first step."""
        if not self.elapsed_ns:
            return None
        took = np.array(self.elapsed_ns) * 1e-9  # a copy, because the array grows
        return StepTimes(len(took), *map(float, (took.mean(), np.percentile(took, 99), took.max())))


def connect(case: Case, state: BankState, only: int | None = None, *, outside: bool = False) -> list[Program]:
    """Create the programs of a case and connect them to their controllers' state; `only`: of this controller alone.

    Keep the programs as long as the state is used. Raises `InputError` if one cannot be created, or if a controller is
    a user's own node and setpoints do not come from `outside`.
    """
    mine = range(len(case.controllers)) if only is None else (only,)
    for c in mine:
        row = kind_of(case.controllers[c])
        if row.node and not outside:
            allowed = "in a graph (facts-damping run)"
            raise InputError(f"controllers.{c}.{row.own}: a separate node given; allowed: {allowed}")
    return [Program(case, c, state) for c in mine if kind_of(case.controllers[c]).program]


def check(programs: list[Program]) -> None:
    """Raise `RunError` if a program has failed."""
    for program in programs:
        program.check()


def step_times(programs: list[Program]) -> dict[str, StepTimes]:
    """Durations of the steps of each program, by node name."""
    return {program.node: times for program in programs if (times := program.times()) is not None}


def instance(controller: Controller, spec: Spec, where: str) -> tuple[str, Callable[..., Any], bool]:
    """File of a controller's class (none for an FMU), `step` of an instance, and whether to call it once a tick.

    Raises `InputError` if it cannot be created.
    """
    if controller.fmu is not None:
        return "", FmuController(spec, controller.fmu, where).step, False
    policy_class = find(str(controller.policy), where)
    file = file_of(policy_class)
    with users(where, file, f"as {policy_class.__name__} was made"):
        policy = policy_class(spec)
        if callable(getattr(policy, "reset", None)):
            policy.reset()
        return file, _step_of(policy, policy_class.__name__, where), bool(getattr(policy, "once_a_tick", False))


def _step_of(controller: Any, name: str, where: str) -> Callable[..., Any]:
    step: Callable[..., Any] | None = getattr(controller, "step", None)
    allowed = f"step(self, {', '.join(STEP)})"
    if not callable(step):
        raise InputError(f"{where}: {name} has no step; allowed: a class with {allowed}")
    signature = inspect.signature(step)
    try:
        signature.bind(*STEP)
    except TypeError as error:
        arguments = str(signature).replace("(", "(self, ", 1)
        raise InputError(f"{where}: {name}: step{arguments} given; allowed: {allowed}") from error
    return step


def checked(u: Any, devices: list[str]) -> NDArray[np.float64]:
    """Setpoints that a step has returned, one a device or a single number. Raises `ValueError` for others."""
    if u is None:
        raise ValueError(f"None returned; allowed: u of shape ({len(devices)},), one a device")
    setpoints = np.asarray(u, np.float64)
    if setpoints.shape != (len(devices),) and not (setpoints.ndim == 0 and len(devices) == 1):
        raise ValueError(f"u of shape {setpoints.shape} given; allowed: ({len(devices)},), one a device")
    if not np.isfinite(setpoints).all():
        at = devices[int(np.argmin(np.isfinite(np.atleast_1d(setpoints))))]
        raise ValueError(f"{np.atleast_1d(setpoints).tolist()} p.u. given, no number for {at}; allowed: finite ones")
    return setpoints
