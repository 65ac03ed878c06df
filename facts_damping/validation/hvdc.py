"""The HVDC link against closed forms: power at both ends, and what its modulation does to two machines."""

from __future__ import annotations

from typing import Any

import numpy as np

from facts_damping.parameters.plant.system import System
from facts_damping.signals import CHANNELS
from facts_damping.small_signal.modal_analysis import analyse
from facts_damping.validation.table import Row, ValidationTable, compare
from facts_damping.validation.time_domain import follow

BASE = 100.0  # MVA
LINK = {"name": "hvdc", "kind": "hvdc", "P_max": 1000.0, "setpoint_max": 0.5, "rate_max": 10.0}
BUS: dict[str, float] = {"nominal_voltage": 230.0}

# What the link of the first table is: order (MW), fraction lost, resistance (p.u.), power factor of both ends.
LINKS = ((200.0, 0.0, 0.0, 0.99), (200.0, 0.015, 0.01, 0.9), (400.0, 0.03, 0.005, 0.95))
SPUR = 0.05  # p.u., reactance between an infinite bus and the rectifier's

# H (s), ratings (MVA) of two machines, power of the link between them (MW).
SWINGS = (((4.0, 6.0), (500.0, 900.0), 50.0), ((3.0, 3.0), (900.0, 300.0), 80.0))
BEHIND, ACROSS, TIE = 1e-5, 0.3, 2.0  # p.u.: reactances of machines and tie, power over the tie


def two_machines(H: tuple[float, float], ratings: tuple[float, float], P: float) -> tuple[System, float, float]:
    """Two machines with a lossless tie and an HVDC link of P (MW) between their EMFs; what follows of them.

    H in s on the ratings (MVA). With a, b = 1 / (2 H S) (1/s, on the system base) and the tie's synchronising power Ps,
    the difference of speeds answers power u added to the link's by -(a + b) s / (s^2 + omega_0 (a + b) Ps): frequency
    of the swing (Hz), and a + b.
    """
    names = ("G1", "G2")
    machines: list[dict[str, Any]] = [
        {"name": name, "bus": name, "model": "classical", "V": 1.0, "H": h, "rating": rating}
        | {"Xd1": BEHIND * rating / BASE, "P": power, "slack": power is None}
        for name, h, rating, power in zip(names, H, ratings, (BASE * TIE + P, None), strict=True)
    ]
    system = System.model_validate(
        {
            "name": "two_machines",
            "buses": [{"name": name, **BUS} for name in names],
            "lines": [{"name": "tie", "from": "G1", "to": "G2", "r": 0.0, "x": ACROSS}],
            "machines": machines,
            "devices": [{**LINK, "from": "G1", "to": "G2", "P": P}],
            "pmus": [{"name": name, "machine": name} for name in names],
            "signals": {"w12": {"channel": "speed_deviation", "weights": {"G1": 1.0, "G2": -1.0}}},
        }
    )
    slope = sum(BASE / (2.0 * h * rating) for h, rating in zip(H, ratings, strict=True))
    synchronising = np.sqrt(1.0 / ACROSS**2 - TIE**2)  # cos(delta) / X, with sin(delta) = P X
    return system, float(np.sqrt(2.0 * np.pi * system.frequency * slope * synchronising) / (2.0 * np.pi)), slope


def _at_a_reactance(P: float, loss: float, R: float, pf: float) -> System:
    """A link from a bus S behind a reactance to an infinite bus B; and a machine, which a system needs, elsewhere."""
    machine = {"name": "M", "bus": "M", "model": "classical", "rating": 1.0, "P": 0.0, "V": 1.0, "H": 5.0, "Xd1": 0.3}
    return System.model_validate(
        {
            "name": "reactance",
            "buses": [{"name": name, **BUS} for name in "ABMS"],
            "lines": [
                {"name": "spur", "from": "A", "to": "S", "r": 0.0, "x": SPUR},
                {"name": "aside", "from": "A", "to": "M", "r": 0.0, "x": 0.1},
                {"name": "back", "from": "A", "to": "B", "r": 0.0, "x": 0.1},
            ],
            "infinite_buses": [{"name": name, "bus": name} for name in "AB"],
            "machines": [machine],
            "devices": [{**LINK, "from": "S", "to": "B", "P": P, "loss": loss, "R": R, "pf_from": pf, "pf_to": pf}],
            "pmus": [{"name": "S", "bus": "S", "branches": ["spur"]}],
        }
    )


def powers() -> ValidationTable:
    """Voltage of a rectifier behind a reactance, what it draws and what the inverter gives, at the start."""
    rows: list[Row] = []
    for P, loss, R, pf in LINKS:
        _, devices, frames = follow(_at_a_reactance(P, loss, R, pf), ["hvdc"], [0.0])
        p, q = P / BASE, P / BASE * np.sqrt(1.0 / pf**2 - 1.0)
        voltage = np.sqrt(0.5 - SPUR * q + np.sqrt(0.25 - SPUR * q - (SPUR * p) ** 2))
        delivered = p * (1.0 - loss) - R * p**2
        measured = dict(zip(CHANNELS, frames[0, 0], strict=True))
        what = f"{P:g} MW, power factor {pf:g}"
        for quantity, ours, expected in (
            ("voltage at the rectifier", measured["voltage_magnitude"], voltage),
            ("active power drawn", -measured["active_power"], p),
            ("reactive power drawn", -measured["reactive_power"], q),
            ("power delivered", devices["active_power"][0, 0], delivered),
        ):
            rows.append(compare(f"{what}: {quantity}", "p.u.", float(ours), float(expected), 1e-9, ".6f"))
    return ValidationTable("Power of an HVDC link behind a reactance", "the quadratic equation", "", rows)


def modulation() -> ValidationTable:
    """Frequency of two machines' swing, and the residue from the link's modulation to the difference of speeds."""
    rows: list[Row] = []
    for H, ratings, P in SWINGS:
        system, frequency, slope = two_machines(H, ratings, P)
        (swing,) = analyse(system, ["hvdc"]).swings
        (residue,) = swing.residues
        what = f"machines of {ratings[0]:g} and {ratings[1]:g} MVA, link of {P:g} MW"
        rows.append(compare(f"{what}: swing", "Hz", swing.frequency_hz, frequency, 1e-3, ".5f"))
        rows.append(compare(f"{what}: residue", "1/s", residue.magnitude, slope / 2.0, 1e-5, ".6f"))
        rows.append(compare(f"{what}: its angle", "deg", abs(residue.angle_deg), 180.0, 1e-2, ".3f"))
    return ValidationTable("Modulation of an HVDC link between two machines", "the swing equation", "", rows)
