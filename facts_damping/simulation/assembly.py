"""Builds the parts of a case: plant, PMUs, links, controllers, identifiers, supervisors; lists its events."""

from __future__ import annotations

import importlib
import math
from typing import TYPE_CHECKING

import numpy as np

from facts_damping.caching import shared
from facts_damping.case.supervision import ends, reserves
from facts_damping.control import identifier_model
from facts_damping.control.bank import Bank, BankState, Known, build_bank, controller_network
from facts_damping.control.compensation import COMPENSATIONS, OF_IDENTIFIERS
from facts_damping.control.identifier import identifiers
from facts_damping.control.identifier_model import Identified, Identifiers, IdentifierState
from facts_damping.control.inputs import TURN, UNSET, Wiring
from facts_damping.control.neuro_fuzzy import PlantPrior
from facts_damping.control.table import kind_of
from facts_damping.elementary import exp_complex
from facts_damping.errors import InputError
from facts_damping.link.chain import DirectionSpec
from facts_damping.link.stages import mean_delay
from facts_damping.link.transfer import Links, links
from facts_damping.measurement.build import make_pmus
from facts_damping.neurofuzzy.start import groups
from facts_damping.numerics.phasors import times
from facts_damping.parameters.events import ELEMENTS
from facts_damping.parameters.run import Weights
from facts_damping.parameters.supervision import Supervision
from facts_damping.plant.build import Built, build, with_noise
from facts_damping.plant.events import timeline
from facts_damping.plant.load_noise import draw as draw_noise
from facts_damping.plant.load_noise import noisy_loads
from facts_damping.plant.model import copy
from facts_damping.plant.watchdog import settings as watchdog_settings
from facts_damping.record import GridEvent
from facts_damping.signals import CHANNELS
from facts_damping.small_signal import own_linear
from facts_damping.small_signal.residues import Residues, residues
from facts_damping.supervision.model import Supervisors, SupervisorState, Watched, supervisors

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.case.model import Case
    from facts_damping.control.state_space import StateSpace
    from facts_damping.measurement.pmu_model import Pmus, PmuState
    from facts_damping.neurofuzzy.network import Network
    from facts_damping.parameters.run import Controller

_plants: dict[str, Built] = {}
_residues: dict[str, Residues | None] = {}
STILL = 1e-6  # p.u. or rad per p.u.: least mode shape, relative to the first signal, of a signal that swings


def commands(case: Case) -> int:
    """Number of setpoints that all controllers of a case issue at one arrival."""
    return sum(len(controller.devices) for controller in case.controllers)


def supervised(case: Case) -> int:
    """Number of supervisors of a case."""
    return 0 if case.supervision is None else sum(c.fallback_of is None for c in case.controllers)


def derivatives(case: Case) -> int:
    """Number of derivatives that all identifiers of a case estimate."""
    return sum(len(c.devices) * len(c.signals) for c in case.controllers if c.scheme == "indirect")


def learning_rates(case: Case) -> int:
    """Number of learning rates of all networks of a case: one per output and group of parameters."""
    nets = [controller_network(c) for c in case.controllers if c.scheme is not None]
    nets += [identifier_network(c) for c in case.controllers if c.scheme == "indirect"]
    return sum(net.outputs * len(groups(net)) for net in nets)


def identifier_network(controller: Controller) -> Network:
    """The network of a controller's identifier."""
    kind = str(controller.parameters["identifier"])
    order = identifier_model.past_values(controller.number("identifier_span"))
    return identifier_model.predictor_network(kind, len(controller.signals), len(controller.devices), order)


def build_plant(case: Case) -> Built:
    """Build the plant of a case, at its equilibrium.

    Runs that differ only in seed, duration, PMUs, links and control share all of it but noise and state.
    """
    system, run = case.system, case.run
    watchdog, noisy = watchdog_settings(run.watchdog, run.frame_rate), noisy_loads(run.load_noise, system.loads)
    # Keyed by content instead of name: a file may change during the life of a cluster's worker.
    events = [event.model_dump_json() for event in case.scenario.events]
    key = f"{system.model_dump_json()} {run.devices} {events} {watchdog.tolist()} {noisy}"
    built = shared(_plants, key, lambda: build(system, run.devices, case.scenario.events, watchdog, noisy))
    noise = draw_noise(run.load_noise, system.loads, case.duration, run.seed)
    return with_noise(built._replace(state=copy(built.state)), system, noise)


def build_pmus(case: Case, draws: int = 0, before: Pmus | None = None) -> tuple[Pmus, PmuState]:
    """Build the PMUs of a case; `draws`: frames after which random numbers repeat, at least those of the case.

    `before`: the same PMUs with other settings, whose random numbers are reused.
    """
    pmus, run = [pmu.name for pmu in case.system.pmus], case.run
    nominal, often = case.system.frequency, (run.frame_rate, max(case.ticks, draws), run.seed)
    return make_pmus(case.measurement, pmus, nominal, *often, before)


def build_links(case: Case) -> Links:
    """Build the links of a case, with no entries under way."""
    return links(case.links, case.used_links, *ways(case).values())


def ways(case: Case) -> dict[str, DirectionSpec]:
    """Both directions of the links of a case."""
    pmus = [pmu.name for pmu in case.system.pmus]
    signals = {name: list(signal.weights) for name, signal in case.system.signals.items()}
    often, seed = (case.run.frame_rate, case.ticks), case.run.seed
    return {
        "up": DirectionSpec(pmus, signals, len(CHANNELS), len(pmus), *often, (seed, 0)),
        "down": DirectionSpec(case.run.devices, {}, 1, 2 * commands(case), *often, (seed, 1)),
    }


def needs_residues(case: Case) -> bool:
    """Whether a controller or supervisor of a case needs the linearised plant."""
    linear = (c.scheme or c.compensation != "none" or kind_of(c).design for c in case.controllers)
    return case.supervision is not None or any(linear)


def _designed(case: Case, i: int, plant: Residues | None) -> StateSpace | None:
    """Matrices of controller i: designed for the plant or given by a user's linear law; None for other kinds."""
    controller = case.controllers[i]
    module, _, name = kind_of(controller).design.partition(":")
    if module:
        design: Callable[..., StateSpace] = getattr(importlib.import_module(module), name)
        return design(plant, case.designed_on, controller, f"controllers.{i}")
    return own_linear.design(controller, case.run.frame_rate) if controller.linear is not None else None


def plant_residues(case: Case) -> Residues | None:
    """Residues of the plant without events, for the design of controllers; None without an electromechanical mode."""
    system, devices, rate = case.designed_on, case.run.devices, case.run.frame_rate
    key = f"{system.model_dump_json()} {devices} {rate} {case.measurement.filter}"
    make = lambda: residues(build(system, devices, []), system, devices, rate, case.filter)  # noqa: E731
    return shared(_residues, key, make)


def build_control(case: Case, plant: Residues | None = None) -> tuple[Bank, BankState, Identifiers, IdentifierState]:
    """Build controllers and identifiers of a case; `plant`: its residues, if already computed.

    Raises `InputError` if a neuro-fuzzy controller's sensitivity has the wrong sign for the plant, or if an LQG design
    for the plant fails.
    """
    if plant is None and needs_residues(case):
        plant = plant_residues(case)
    known = [
        Known(_known(case, i, plant), _compensated(case, i, plant), _designed(case, i, plant))
        for i in range(len(case.controllers))
    ]
    wiring = wired(case)
    controls, state = build_bank(case.controllers, wiring, known, case.run.seed)
    rows = [
        _identified(case, i, controls, prior.prior)
        for i, prior in enumerate(known)
        if prior.prior is not None and case.controllers[i].scheme == "indirect"
    ]
    return controls, state, *identifiers(rows, wiring)


def wired(case: Case) -> Wiring:
    """What the controllers of a case are connected to."""
    devices = [case.system.device(name) for name in case.run.devices]
    limits = {device.name: (device.setpoint_max, device.rate_max) for device in devices}
    pmus = [pmu.name for pmu in case.system.pmus]
    return Wiring(case.system.signals, pmus, limits, case.run.frame_rate, case.system.frequency)


def build_supervisors(case: Case, plant: Residues | None = None) -> tuple[Supervisors, SupervisorState]:
    """Build the supervisors of a case; `plant`: its residues, if already computed.

    Raises `InputError` for a probe if the plant has no mode, or if it does not end before arming.
    """
    if plant is None and case.supervision is not None:
        plant = plant_residues(case)
    reserve = reserves(case.run)
    watched = [
        _watched(case, c, reserve.get(c, UNSET), plant)
        for c, controller in enumerate(case.controllers)
        if controller.fallback_of is None and case.supervision is not None
    ]
    supervision = case.supervision or Supervision()
    built, state = supervisors(watched, case.controllers, supervision, wired(case), ends(case.system))
    _check_probes(case, supervision, built, plant)
    return built, state


def _check_probes(case: Case, supervision: Supervision, built: Supervisors, plant: Residues | None) -> None:
    """Raise `InputError` for a probe without a mode, or one that ends after the scheduled arming."""
    start = supervision.probe.start
    if plant is None and built.settings.size and (supervision.arming.probe or start is not None):
        field = "arming.probe: true" if supervision.arming.probe else f"probe.start: {start:g}"
        raise InputError(f"supervision.{field} given; allowed: no probe, as the plant has no electromechanical mode")
    if start is None or not supervision.arming.probe or case.run.arm_at is None:
        return
    for row in built.settings:
        devices, rate = len(case.controllers[row["controller"]].devices), case.run.frame_rate
        over = math.ceil(start * rate) + devices * math.ceil(row["probe_s"] * rate - 1e-6)
        if math.ceil(case.run.arm_at * rate) < over:
            many = f" of {devices} devices" if devices > 1 else ""
            minimum = math.ceil(over / rate * 1000.0) / 1000.0
            early = f"{case.run.arm_at:g} given, but the probe{many} ends later"
            raise InputError(f"arm_at: {early}; allowed: from {minimum:g} on")


def _watched(case: Case, c: int, reserve: int, plant: Residues | None) -> Watched:
    """Controller, fallback, link, mode and residues for the supervisor of controller c.

    Residues hold from the issue of a setpoint to the time stamp of a measurement: they include the downlink's mean
    delay, but not the delay of a PMU's filter.
    """
    controller, used = case.controllers[c], case.used_links[c]
    mode = 0j if plant is None else plant.eigenvalue
    residue = [0j for _ in controller.devices]
    if plant is not None:
        row, filtered = plant.signals.index(controller.signals[0]), plant.model.filtered
        ahead = 0.0 if filtered is None else filtered.delay
        for d, device in enumerate(controller.devices):
            down = mean_delay(case.links[used].down, [device])
            moved = plant.residue[row, plant.devices.index(device)]
            residue[d] = complex(times(moved, exp_complex(mode * (ahead - down))))
    return Watched(c, reserve, used, case.run.arm_at, mode, residue)


def _known(case: Case, i: int, plant: Residues | None) -> PlantPrior | None:
    """Plant prior of a neuro-fuzzy controller: signs of the residues, or of the Jacobian if it has an identifier.

    The first signal needs a sign for every device; a given sign must agree with the plant's.
    """
    c = case.controllers[i]
    if c.scheme is None:
        return None
    here = f"controllers.{i}.parameters.sensitivity"
    if plant is None:
        raise InputError(f"{here}: the plant has no electromechanical mode; allowed: a controller without adaptation")
    sign, wanted = np.zeros((len(c.signals), len(c.devices))), c.number("sensitivity")
    for s, signal in enumerate(c.signals):
        for d, device in enumerate(c.devices):
            sign[s, d] = plant.sign(signal, device)
            why = (
                f"the residue from {device} to {signal} at the least damped mode ({plant.frequency_hz:.2f} Hz) "
                f"has an angle of {plant.angle_deg(signal, device):.0f} degrees"
            )
            if s == 0 and sign[s, d] == 0.0:
                raise InputError(f"{here}: no sign fits; {why}, near neither 0 nor 180; allowed: another first signal")
            if wanted and sign[s, d] and wanted != sign[s, d]:
                raise InputError(f"{here}: {wanted:g} given; allowed: {sign[s, d]:g} (or 0: automatic): {why}")
    jacobian = plant.jacobian(c.signals, c.devices, int(c.number("identifier_horizon")))
    mode_shape = np.array([plant.ratio(signal, c.signals[0]) for signal in c.signals])
    for signal, ratio in zip(c.signals, np.abs(mode_shape), strict=True):
        if not ratio > STILL:
            why = f"which does not swing at the least damped mode ({plant.frequency_hz:.2f} Hz)"
            raise InputError(f"controllers.{i}.signals: '{signal}' given, {why}; allowed: signals that do")
    z_pole = exp_complex(plant.eigenvalue / case.run.frame_rate)
    return PlantPrior(np.sign(jacobian) if c.scheme == "indirect" else sign, jacobian, mode_shape, z_pole)


def _compensated(case: Case, i: int, plant: Residues | None) -> float:
    """Frequency that a controller's compensation is tuned to, rad/s; 0 without compensation.

    A Smith predictor is refused: the plant's poles remain in its loop's response to disturbances, and an unstable pole
    gives a hidden growing output (Z. J. Palmor, Time-Delay Compensation, in: W. S. Levine (ed.), The
    Control Handbook, CRC 1996).
    """
    c = case.controllers[i]
    if c.compensation in ("none", *OF_IDENTIFIERS):
        return 0.0
    here, mode = f"controllers.{i}.compensation", None if plant is None else plant.eigenvalue
    if c.compensation == "smith":
        allowed = [*COMPENSATIONS, *(OF_IDENTIFIERS if c.scheme == "indirect" else [])]
        raise InputError(f"{here}: 'smith' given; allowed: {', '.join(allowed)}: {_no_smith(mode)}")
    if mode is None and c.number("mode_hz") == 0.0:
        problem = f"'{c.compensation}' given, but the plant has no electromechanical mode"
        raise InputError(f"{here}: {problem}; allowed: none")
    return TURN * c.number("mode_hz") or float(mode.imag if mode is not None else 0.0)


def _no_smith(mode: complex | None) -> str:
    if mode is None:
        return "the plant has no electromechanical mode"
    of = f"{mode.real:+.3f} +- {mode.imag:.3f}j 1/s ({mode.imag / TURN:.2f} Hz) without controllers"
    if mode.real > 0.0:
        return f"the plant's mode {of} is unstable, and a Smith predictor does not stabilise it"
    return f"a Smith predictor does not damp the plant's least damped mode {of} after disturbances"


def _identified(case: Case, i: int, bank: Bank, known: PlantPrior) -> Identified:
    c = case.controllers[i]
    places = [case.run.devices.index(device) for device in c.devices]
    return Identified(
        controller=i,
        settings=bank.settings[i],
        kind=str(c.parameters["identifier"]),
        signals=c.signals,
        devices=places,
        limits=bank.actuators.limit[i, : len(places)].tolist(),
        known=known,
        weights=np.array(c.weights.identifier) if isinstance(c.weights, Weights) and c.weights.identifier else None,
        predicts=c.compensation == "prediction",
    )


def grid_events(case: Case) -> list[GridEvent]:
    """All grid events in order of time, as published."""
    published = []
    for change in timeline(case.scenario.events):
        row = change.event.model_dump()
        element = next(row[key] for key in ELEMENTS if row.get(key) is not None)
        on_line = row["kind"] == "fault" and row.get("line") is not None
        location = row["location"] if on_line else math.nan
        value = next((row[key] for key in ("change", "power", "amplitude") if row.get(key) is not None), math.nan)
        published.append(GridEvent(change.time_ns, row["kind"], element, value, location))
    return published
