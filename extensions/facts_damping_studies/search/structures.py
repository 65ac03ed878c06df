"""The controller structures that `search` chooses from, and their free parameters."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.case.changes import read_profile
from facts_damping.case.loading import changed_case, load_case
from facts_damping.case.tuned import tuned
from facts_damping.control.compensation import OF_IDENTIFIERS
from facts_damping.control.parameter_tables import OFF_ON
from facts_damping.control.table import kind, kind_name
from facts_damping.errors import InputError, check_known
from facts_damping.neurofuzzy.table import ANTECEDENTS, CONSEQUENTS
from facts_damping.parameters.profile import DEFAULT_PROFILE
from facts_damping.parameters.run import Controller
from facts_damping.simulation.assembly import plant_residues
from facts_damping_studies.search.scoring import REFERENCE
from facts_damping_studies.search.space import GUARDS, Space
from facts_damping_studies.sweeps.enumerated_axes import every_scheme

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.control.parameter_tables import Value
    from facts_damping.parameters.plant.system import System
    from facts_damping_studies.sweeps.enumerated_axes import Scheme

# Signals of a network by devices; a lead-lag takes the first.
PORTS: dict[tuple[str, ...], list[str]] = {("sssc",): ["speed"], ("sssc", "statcom"): ["speed", "power"]}


class Structure(NamedTuple):
    """A controller without its parameters."""

    name: str  # name of a row in the table of controllers, or antecedent+consequent
    scheme: Scheme
    devices: tuple[str, ...]
    profile: str = DEFAULT_PROFILE
    given: tuple[str, ...] = ()  # signals; empty: those of PORTS

    @property
    def signals(self) -> list[str]:
        """The controller's signals, replaced by their equivalents in the profile."""
        names = list(self.given) or PORTS[self.devices]
        return read_profile(self.profile).given(names[: kind(self.name).signals])

    @property
    def is_reference(self) -> bool:
        """Whether it is the reference lead-lag."""
        return self.name == REFERENCE


def structures(
    system: System,
    names: Sequence[str],
    devices: Sequence[str],
    scheme: Scheme = None,
    profile: str = DEFAULT_PROFILE,
    signals: Sequence[str] = (),
) -> list[Structure]:
    """LLC-tuned and every pair of antecedent and consequent (or those named), in both schemes, with all devices.

    `devices`: only these; empty: each row of `PORTS` that the system has. `scheme`: that of the networks; None: both.
    `profile`: sets the signals and the tuned parameters. `signals`: used with devices not in `PORTS`.
    """
    have = [device.name for device in system.devices]
    for device in devices:
        check_known("--devices", device, have)
    for signal in signals:
        check_known("--signals", signal, list(system.signals))
    if signals and not devices:
        raise InputError("--signals: given without --devices; allowed: with --devices, as signals depend on them")
    known = [row for row in PORTS if set(have).issuperset(row) and tuple(devices or row) == row]
    rows = [tuple(devices)] if signals else known
    if not rows:
        allowed = f"{', '.join(','.join(row) for row in PORTS)}, or any of {', '.join(have) or 'none'} with --signals"
        raise InputError(f"--devices: {','.join(devices) or 'none'} given for {system.name}; allowed: {allowed}")
    pairs = list(names) or [f"{first}+{second}" for first, second in product(ANTECEDENTS, CONSEQUENTS)]
    others = [name for name in pairs if name != REFERENCE]
    for name in others:
        if not kind(name, "CONTROLLER").tuned:
            raise InputError(
                f"CONTROLLER: '{name}' given; allowed: one with parameters to tune (LLC-tuned is included)"
            )
    signal_names = tuple(signals)
    every_structure = [
        Structure(name, variant_scheme, row, profile, signal_names)
        for row in rows
        for name, variant_scheme in every_scheme([REFERENCE, *others])
    ]
    return [
        structure for structure in every_structure if structure.scheme is None or scheme in (None, structure.scheme)
    ]


def started(start: str, system: str, structure: Structure) -> list[dict[str, Value]]:
    """Parameters that a structure may start from: none (`hypercube`), those from `tune`, or those of a run.

    They must match its scheme, signals and devices; a lead-lag takes only its own. Raises `InputError` if there is no
    such run, or if it is of another system.
    """
    if start == "hypercube":
        return []
    signals, devices = structure.signals, list(structure.devices)
    if start == "tuned":
        laws = tuned(system, signals, devices, profile=structure.profile)
        known_parameters = {law: row.parameters for law, row in laws.items()}
    else:
        try:
            case = load_case(start)
        except InputError as error:
            raise InputError(f"--start: {error}; or hypercube, or tuned") from None
        if case.system.name != system:
            raise InputError(f"--start: '{start}' given, a run of {case.system.name}; allowed: one of {system}")
        controllers = case.run.controllers
        known_parameters = {
            (kind_name(c.name), c.scheme): c.parameters
            for c in controllers
            if (c.signals, c.devices) == (signals, devices)
        }
    return [
        values
        for (name, scheme), values in known_parameters.items()
        if scheme == structure.scheme and (scheme is not None or name == structure.name)
    ]


class Choice:
    """The search space of a structure: a coordinate from 0 to 1 for each parameter, guard and word."""

    def __init__(self, structure: Structure, system: str, compensations: Sequence[str] = ()) -> None:
        """Linearise the plant once. `compensations`: those to choose from, if the structure can have them."""
        self.structure, self.system = structure, system
        content = {"system": system, "profile": structure.profile, "scenario": [], "devices": list(structure.devices)}
        case = changed_case({}, "search", {**content, "controllers": []})
        plant = plant_residues(case)
        if plant is None:
            raise InputError(f"SYSTEM: {system} has no electromechanical mode; allowed: a system whose machines swing")
        self.plant, self.limit = plant, case.system.device(structure.devices[0]).setpoint_max
        row = kind(structure.name)
        self.space = Space(row, structure.scheme, structure.signals, structure.devices)
        self.guards = {} if row.network is None else GUARDS
        self.words: dict[str, tuple[str, ...]] = {} if row.network is None else {"anti_windup": OFF_ON}
        fitting = [
            compensation
            for compensation in compensations
            if structure.scheme == "indirect" or compensation not in OF_IDENTIFIERS
        ]
        self.words |= {"compensation": tuple(fitting)} if fitting and row.compensates else {}

    @property
    def size(self) -> int:
        """The number of coordinates."""
        return len(self.space.ranges) + len(self.guards) + len(self.words)

    def starts(self, start: str) -> list[NDArray[np.float64]]:
        """The available starting points."""
        return [self._place(values) for values in started(start, self.system, self.structure)]

    def _place(self, values: Mapping[str, Value]) -> NDArray[np.float64]:
        """The point of these parameters; guards not named are as in `deployed`, compensation is none."""
        usual = {name: parameter.deployed for name, parameter in self.space.row.parameters.items()} | dict(values)
        guards = [guard.place(float(str(usual[name] or 0.0))) for name, guard in self.guards.items()]
        words = [(some.index(str(usual.get(name, some[0]))) + 0.5) / len(some) for name, some in self.words.items()]
        return np.array([*self.space.place(values, self.plant, self.limit), *guards, *words])

    def controller(self, at: NDArray[np.float64]) -> Controller:
        """The controller at a point."""
        coordinates, more = at[: len(self.space.ranges)], list(at[len(self.space.ranges) :])
        values = self.space.parameters(coordinates, self.plant, self.limit)
        values |= {name: guard.value(float(more.pop(0))) for name, guard in self.guards.items()}
        words = {name: some[min(int(more.pop(0) * len(some)), len(some) - 1)] for name, some in self.words.items()}
        return Controller(
            name=self.structure.name,
            scheme=self.structure.scheme,
            signals=list(self.space.signals),
            devices=list(self.structure.devices),
            compensation=words.pop("compensation", "none"),  # type: ignore[arg-type]
            parameters={**values, **words},
        )
