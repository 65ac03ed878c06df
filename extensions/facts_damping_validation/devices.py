"""Converters, HVDC links and other actuators against closed forms.

Power over a voltage in series, the balance of energy, power at both ends of an HVDC link, and what its modulation does
to two machines.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.integrate import simpson

from facts_damping.case.loading import load_system
from facts_damping.parameters.plant.placement import place
from facts_damping.parameters.plant.system import System
from facts_damping.signals import CHANNELS
from facts_damping.small_signal.modal_tables import analyse
from facts_damping_validation.table import Row, ValidationTable, compare, within
from facts_damping_validation.time_domain import follow

X, ANGLE = 0.5, 30.0  # p.u. and degrees, of the line whose transmission characteristic is compared
INJECTED = (-0.1, -0.05, 0.05, 0.1)  # p.u.
SETTLED = 10.0  # s
FINE = 4800  # instants/s of the balance of energy
SECONDS = 0.5
UNCHARGED = 0.95  # p.u., DC voltages at the start of the balance
LOSSES = 0.02  # p.u., conductance of DC links with losses
SETPOINTS = {"sssc": 0.05, "statcom": -0.03}  # p.u., from the start of the balance

# HVDC links
BASE = 100.0  # MVA
LINK = {"name": "hvdc", "kind": "hvdc", "P_max": 1000.0, "setpoint_max": 0.5, "rate_max": 10.0}
BUS: dict[str, float] = {"nominal_voltage": 230.0}

# What the link of the first table is: order (MW), fraction lost, resistance (p.u.), power factor of both ends.
LINKS = ((200.0, 0.0, 0.0, 0.99), (200.0, 0.015, 0.01, 0.9), (400.0, 0.03, 0.005, 0.95))
SPUR = 0.05  # p.u., reactance between an infinite bus and the rectifier's

# Other actuators
POWER = {"setpoint_max": 5.0, "rate_max": 1e4}
DRAWN = (4.0, 1.5, -3.0)  # p.u.

# H (s), ratings (MVA) of two machines, power of the link between them (MW).
SWINGS = (((4.0, 6.0), (500.0, 900.0), 50.0), ((3.0, 3.0), (900.0, 300.0), 80.0))
BEHIND, ACROSS, TIE = 1e-5, 0.3, 2.0  # p.u.: reactances of machines and tie, power over the tie


def _beside_infinite_buses(
    name: str, buses: str, lines: Any, angles: dict[str, float], device: dict[str, Any], pmu: dict[str, Any]
) -> System:
    """Infinite buses at angles (degrees), lossless lines (name, ends, reactance), and a machine: a system needs one."""
    machine = {"name": "M", "bus": "M", "model": "classical", "rating": 1.0, "P": 0.0, "V": 1.0, "H": 5.0, "Xd1": 0.3}
    return System.model_validate(
        {
            "name": name,
            "buses": [{"name": bus, **BUS} for bus in buses],
            "lines": [{"name": line, "from": start, "to": end, "r": 0.0, "x": x} for line, start, end, x in lines],
            "infinite_buses": [{"name": bus, "bus": bus, "angle": angle} for bus, angle in angles.items()],
            "machines": [machine],
            "devices": [device],
            "pmus": [pmu],
        }
    )


def converters() -> ValidationTable:
    """Active power over the SSSC's voltage: P = V^2 / X sin(delta) + V v_q / X cos(delta / 2), (2.42)."""
    rows: list[Row] = []
    lines = ("line", "A", "B", X), ("aside", "A", "M", 0.1)
    device = {"name": "sssc", "kind": "sssc", "line": "line", "rs": 1e-6, "xs": 1e-6, "Ki": 5.0}
    pmu = {"name": "A", "bus": "A", "branches": ["line"]}
    system = place(_beside_infinite_buses("line", "ABM", lines, {"A": ANGLE, "B": 0.0}, device, pmu))
    delta, active = np.deg2rad(ANGLE), list(CHANNELS).index("active_power")
    for v_q in INJECTED:
        _, devices, frames = follow(system, ["sssc"], [SETTLED], setpoints={"sssc": v_q}, dc_voltage=1.0)
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
        truths = follow(system, list(SETPOINTS), times, setpoints=SETPOINTS, dc_voltage=UNCHARGED).devices
        for d, name in enumerate(SETPOINTS):
            device = next(row.model_dump() for row in system.devices if row.name == name)
            R, L, tau = device.get("rs", device.get("R")), device.get("L", 0.0), device["tau"]
            truth = truths[:, d]
            lost = R * truth["current"] ** 2 + g * truth["dc_voltage"] ** 2
            received = simpson(-truth["active_power"] - lost, x=times)
            stored = tau * truth["dc_voltage"] ** 2 / 2 + L / (4 * np.pi * system.frequency) * truth["current"] ** 2
            what = f"{name}: energy balance error, with {np.ptp(stored):.1e} p.u. s stored"
            what += f", DC losses g = {g:g} p.u." if g else ""
            rows.append(within(what, "p.u. s", received - (stored[-1] - stored[0]), 1e-7))
    title = "Energy of the converters of two_area over 0.5 s"
    return ValidationTable(title, "conservation", "", rows)


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
    """A link from a bus S behind a reactance to an infinite bus B."""
    lines = ("spur", "A", "S", SPUR), ("aside", "A", "M", 0.1), ("back", "A", "B", 0.1)
    device = {**LINK, "from": "S", "to": "B", "P": P, "loss": loss, "R": R, "pf_from": pf, "pf_to": pf}
    pmu = {"name": "S", "bus": "S", "branches": ["spur"]}
    return _beside_infinite_buses("reactance", "ABMS", lines, {"A": 0.0, "B": 0.0}, device, pmu)


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


def actuators() -> ValidationTable:
    """Load modulation and TCSC over reactances, the end of a battery's power, and the field voltage that is asked for.

    V^2 = 1/2 - X Q + sqrt(1/4 - X Q - (X P)^2); P = sin(delta) / (X - x); in the last charge the power falls as
    exp(-S t / (taper E eta)); a static exciter's field voltage rises by KA u.
    """
    rows: list[Row] = []
    spur = ("spur", "A", "S", SPUR), ("aside", "A", "M", 0.1)
    at_s = {"name": "S", "bus": "S", "branches": ["spur"]}
    load = {"name": "load", "kind": "load_modulation", "bus": "S", "pf": 0.9, **POWER}
    for p in DRAWN:
        system = _beside_infinite_buses("reactance", "AMS", spur, {"A": 0.0}, load, at_s)
        frames = follow(system, ["load"], [0.01], setpoints={"load": p}).frames
        q = p * np.sqrt(1.0 / 0.9**2 - 1.0)
        expected = np.sqrt(0.5 - SPUR * q + np.sqrt(0.25 - SPUR * q - (SPUR * p) ** 2))
        ours = float(frames[0, 0, list(CHANNELS).index("voltage_magnitude")])
        rows.append(compare(f"load modulation, {p:+g} p.u.: voltage", "p.u.", ours, float(expected), 1e-9, ".6f"))
    battery = {"name": "bess", "kind": "bess", "bus": "S", "S_rated": 200.0, "E_rated": 0.1, **POWER}
    times = np.linspace(0.1, 3.0, 30)
    for u, charge, eta in ((2.0, 0.15, 0.95), (-2.0, 0.85, 1.0 / 0.95)):
        system = _beside_infinite_buses("b", "AMS", spur, {"A": 0.0}, {**battery, "taper": 0.1, "charge": charge}, at_s)
        power = follow(system, ["bess"], times, setpoints={"bess": u}).devices["active_power"][:, 0]
        lag = 0.1 * 3.6 * eta / 2.0
        what = f"battery, {'discharging' if u > 0 else 'charging'} to its end: power"
        rows.append(within(what, "p.u.", power - 0.5 * u * np.exp(-times / lag), 2e-4))
    line = ("line", "A", "B", X), ("aside", "A", "M", 0.1)
    bank = {"name": "tcsc", "kind": "tcsc", "line": "line", "X": 0.1, "X_min": -0.2, "X_max": 0.4}
    bank |= {"setpoint_max": 0.2, "rate_max": 1000.0}
    for u in (0.0, 0.2, -0.15):
        pmu = {"name": "A", "bus": "A", "branches": ["line"]}
        system = place(_beside_infinite_buses("line", "ABM", line, {"A": ANGLE, "B": 0.0}, bank, pmu))
        frames = follow(system, ["tcsc"], [1.0], setpoints={"tcsc": u}).frames
        ours = float(frames[0, 0, list(CHANNELS).index("active_power")])
        expected = np.sin(np.deg2rad(ANGLE)) / (X - 0.1 - u)
        rows.append(compare(f"TCSC, {u:+g} p.u.: power of its line", "p.u.", ours, float(expected), 1e-4, ".5f"))
    base = load_system("kundur_12_6_thyristor")
    added = {"name": "input", "kind": "exciter_input", "machine": "G1", "rate_max": 1000.0}
    system = System.model_validate({**base.model_dump(by_alias=True), "devices": [added]})
    efd = follow(system, ["input"], [0.0, 1e-4], setpoints={"input": 0.01}).machines["field_voltage"][:, 0]
    gain = next(e.KA for e in system.exciters if e.machine == "G1")
    rows.append(
        compare("exciter input of 0.01 p.u.: rise of the field voltage", "p.u.", efd[1] - efd[0], gain * 0.01, 0.01)
    )
    return ValidationTable("Load modulation, battery, TCSC and exciter input", "analytic solutions", "", rows)
