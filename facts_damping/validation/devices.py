"""Converters against analytic solutions, and the balance of energy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.integrate import simpson

from facts_damping.case.loading import load_system
from facts_damping.parameters.plant.placement import place
from facts_damping.parameters.plant.system import System
from facts_damping.plant.build import build
from facts_damping.plant.integration import advance
from facts_damping.plant.measurement import measure
from facts_damping.plant.model import copy, workspace
from facts_damping.signals import CHANNELS, DEVICE_TRUTH, MACHINE_TRUTH, SETPOINT, to_ns
from facts_damping.validation.table import Row, ValidationTable, compare, within

if TYPE_CHECKING:
    from numpy.typing import NDArray

X, ANGLE = 0.5, 30.0  # p.u. and degrees, of the line whose transmission characteristic is compared
INJECTED = (-0.1, -0.05, 0.05, 0.1)  # p.u.
SETTLED = 10.0  # s
FINE = 4800  # instants/s of the balance of energy
SECONDS = 0.5
UNCHARGED = 0.95  # p.u., DC voltages at the start of the balance
LOSSES = 0.02  # p.u., conductance of DC links with losses
SETPOINTS = {"sssc": 0.05, "statcom": -0.03}  # p.u., from the start of the balance


def _line() -> System:
    """Two infinite buses with a lossless line and an SSSC between, and a machine elsewhere, which a system needs."""
    return System.model_validate(
        {
            "name": "line",
            "buses": [{"name": name, "nominal_voltage": 230.0} for name in "ABM"],
            "lines": [
                {"name": "line", "from": "A", "to": "B", "r": 0.0, "x": X},
                {"name": "aside", "from": "A", "to": "M", "r": 0.0, "x": 0.1},
            ],
            "infinite_buses": [{"name": "A", "bus": "A", "angle": ANGLE}, {"name": "B", "bus": "B"}],
            "machines": [
                {"name": "M", "bus": "M", "model": "classical", "rating": 1.0, "P": 0.0, "V": 1.0, "H": 5.0, "Xd1": 0.3}
            ],
            "devices": [{"name": "sssc", "kind": "sssc", "line": "line", "rs": 1e-6, "xs": 1e-6, "Ki": 5.0}],
            "pmus": [{"name": "A", "bus": "A", "branches": ["line"]}],
        }
    )


def _follow(
    system: System, installed: list[str], setpoints: dict[str, float], times: NDArray[np.float64], vdc: float = 1.0
) -> tuple[Any, Any]:
    """DEVICE_TRUTH (instants, devices) and PMU frames at instants (s), with setpoints and DC voltages at the start."""
    built = build(place(system), installed, [])
    state = copy(built.state)
    state.x[[name.endswith(".vdc") for name in built.state_names]] = vdc
    work = workspace(built.plant, state)
    asked = np.zeros(len(setpoints), SETPOINT)
    asked["device"], asked["value"] = [installed.index(name) for name in setpoints], list(setpoints.values())
    machines = np.zeros(len(system.machines), MACHINE_TRUTH)
    devices = np.zeros((len(times), len(installed)), DEVICE_TRUTH)
    frames = np.zeros((len(times), len(system.pmus), len(CHANNELS)))
    now = 0
    for k, time in enumerate(times):
        advance(built.plant, state, now, to_ns(time), asked, len(asked) if now == 0 else 0, work)
        now = to_ns(time)
        measure(built.plant, state, now, frames[k], machines, devices[k], work)
    return devices, frames


def converters() -> ValidationTable:
    """Active power over the SSSC's voltage: P = V^2 / X sin(delta) + V v_q / X cos(delta / 2), (2.42)."""
    rows: list[Row] = []
    delta = np.deg2rad(ANGLE)
    active = list(CHANNELS).index("active_power")
    for v_q in INJECTED:
        devices, frames = _follow(_line(), ["sssc"], {"sssc": v_q}, np.array([SETTLED]))
        expected = (np.sin(delta) + v_q * np.cos(delta / 2)) / X
        rows.append(compare(f"power with v_q = {v_q:+.2f} p.u.", "p.u.", frames[0, 0, active], expected, 1e-5, ".6f"))
        phase = np.rad2deg(np.arctan2(devices["active_voltage"][0, 0], abs(devices["injected_voltage"][0, 0])))
        rows.append(within(f"voltage with v_q = {v_q:+.2f} p.u., from quadrature to the current", "deg", phase, 0.01))
    return ValidationTable("Transmission characteristic of the SSSC", "the analytic solution (2.42)", "", rows)


def _with_losses(system: System, g: float) -> System:
    """The system with a loss conductance (p.u.) in the DC link of every converter."""
    devices = [device.model_copy(update={"g": g}) for device in system.devices]
    return system.model_copy(update={"devices": devices})


def balance() -> ValidationTable:
    """What a converter draws charges its DC link and its transformer's reactance, or is lost in either."""
    times = np.arange(round(SECONDS * FINE) + 1) / FINE
    rows = []
    for g in (0.0, LOSSES):
        system = _with_losses(load_system("two_area"), g)
        found, _ = _follow(system, list(SETPOINTS), SETPOINTS, times, UNCHARGED)
        for d, name in enumerate(SETPOINTS):
            device = next(row.model_dump() for row in system.devices if row.name == name)
            R, L, tau = device.get("rs", device.get("R")), device.get("L", 0.0), device["tau"]
            truth = found[:, d]
            lost = R * truth["current"] ** 2 + g * truth["dc_voltage"] ** 2
            drawn = simpson(-truth["active_power"] - lost, x=times)
            stored = tau * truth["dc_voltage"] ** 2 / 2 + L / (4 * np.pi * system.frequency) * truth["current"] ** 2
            what = f"{name}: energy balance error, with {np.ptp(stored):.1e} p.u. s stored"
            what += f", DC losses g = {g:g} p.u." if g else ""
            rows.append(within(what, "p.u. s", drawn - (stored[-1] - stored[0]), 1e-7))
    title = "Energy of the converters of two_area over 0.5 s, from an uncharged DC link and a step of both setpoints"
    return ValidationTable(title, "conservation", "", rows)
