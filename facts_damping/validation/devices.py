"""Converters against analytic solutions, and the balance of energy."""

from __future__ import annotations

import numpy as np
from scipy.integrate import simpson

from facts_damping.case.loading import load_system
from facts_damping.parameters.plant.placement import place
from facts_damping.parameters.plant.system import System
from facts_damping.signals import CHANNELS
from facts_damping.validation.table import Row, ValidationTable, compare, within
from facts_damping.validation.time_domain import follow

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


def converters() -> ValidationTable:
    """Active power over the SSSC's voltage: P = V^2 / X sin(delta) + V v_q / X cos(delta / 2), (2.42)."""
    rows: list[Row] = []
    delta = np.deg2rad(ANGLE)
    active = list(CHANNELS).index("active_power")
    for v_q in INJECTED:
        _, devices, frames = follow(place(_line()), ["sssc"], [SETTLED], setpoints={"sssc": v_q}, dc_voltage=1.0)
        expected = (np.sin(delta) + v_q * np.cos(delta / 2)) / X
        rows.append(compare(f"power with v_q = {v_q:+.2f} p.u.", "p.u.", frames[0, 0, active], expected, 1e-5, ".6f"))
        phase = np.rad2deg(np.arctan2(devices["active_voltage"][0, 0], abs(devices["injected_voltage"][0, 0])))
        rows.append(within(f"voltage with v_q = {v_q:+.2f} p.u., from quadrature to the current", "deg", phase, 0.01))
    return ValidationTable("Transmission characteristic of the SSSC", "the analytic solution (2.42)", "", rows)


def balance() -> ValidationTable:
    """What a converter draws charges its DC link and its transformer's reactance, or is lost in either."""
    times = np.arange(round(SECONDS * FINE) + 1) / FINE
    rows = []
    for g in (0.0, LOSSES):
        system = load_system("two_area")
        lossy = [device.model_copy(update={"g": g}) for device in system.devices]  # in the DC links
        system = place(system.model_copy(update={"devices": lossy}))
        found = follow(system, list(SETPOINTS), times, setpoints=SETPOINTS, dc_voltage=UNCHARGED).devices
        for d, name in enumerate(SETPOINTS):
            device = next(row.model_dump() for row in system.devices if row.name == name)
            R, L, tau = device.get("rs", device.get("R")), device.get("L", 0.0), device["tau"]
            truth = found[:, d]
            lost = R * truth["current"] ** 2 + g * truth["dc_voltage"] ** 2
            received = simpson(-truth["active_power"] - lost, x=times)
            stored = tau * truth["dc_voltage"] ** 2 / 2 + L / (4 * np.pi * system.frequency) * truth["current"] ** 2
            what = f"{name}: energy balance error, with {np.ptp(stored):.1e} p.u. s stored"
            what += f", DC losses g = {g:g} p.u." if g else ""
            rows.append(within(what, "p.u. s", received - (stored[-1] - stored[0]), 1e-7))
    title = "Energy of the converters of two_area over 0.5 s, from an uncharged DC link and a step of both setpoints"
    return ValidationTable(title, "conservation", "", rows)
