"""Power flows and starts against published figures."""

from __future__ import annotations

import numpy as np

from facts_damping.case.loading import load_case, load_system
from facts_damping.parameters.files import shipped
from facts_damping.plant.build import build
from facts_damping.plant.dynamics import derivatives
from facts_damping.plant.grid.power_flow import solve
from facts_damping.plant.model import copy, workspace
from facts_damping.signals import CHANNELS
from facts_damping.simulation import loop
from facts_damping_validation.table import Row, ValidationTable, compare, figures, within

TWO_AREA = {"G1": 0.7778 + 0.1021j, "G2": 0.7777 + 0.1307j, "G3": 0.7989 + 0.0914j, "G4": 0.7778 + 0.0919j}
TWO_AREA_LOADS = {"B7": 0.9916, "B9": 1.0028}
KUNDUR_VOLTAGES = {"B5": 1.0065, "B6": 0.9781, "B7": 0.9610, "B8": 0.9486, "B9": 0.9714, "B10": 0.9835, "B11": 1.0083}
KUNDUR_REACTIVE = {"G1": 185, "G2": 235, "G3": 176, "G4": 202}
SMIB = {"nominal": (1311, 20.17), "light": (574, 11.7), "heavy": (1840, 25.0)}  # MW, degrees
WSCC = (  # p.u. and degrees of B1 to B9
    *((1.040, 0.0), (1.025, 9.3), (1.025, 4.7), (1.026, -2.2), (0.996, -4.0)),
    *((1.013, -3.7), (1.026, 3.7), (1.016, 0.7), (1.032, 2.0)),
)


def two_area() -> ValidationTable:
    """Powers of the machines and voltages of the loads, as the thesis prints them."""
    flow = solve(load_system("two_area"))
    voltage = dict(zip(flow.names, np.abs(flow.voltage), strict=True))
    rows = [
        compare(f"P + jQ of {name}", "p.u. of 900 MVA", flow.generation[name] / 9, power, 2e-4)
        for name, power in TWO_AREA.items()
    ]
    rows += [compare(f"voltage of {bus}", "p.u.", voltage[bus], v, 2e-4) for bus, v in TWO_AREA_LOADS.items()]
    source = "Badar's thesis, 4.5.2, four digits"
    return ValidationTable("Power flow of two_area", source, "facts-damping modes two_area", rows)


def kundur() -> ValidationTable:
    """Kundur's example 12.6."""
    flow = solve(load_system("kundur_12_6"))
    voltage = dict(zip(flow.names, np.abs(flow.voltage), strict=True))
    rows = [compare(f"voltage of {bus}", "p.u.", voltage[bus], v, 6e-5) for bus, v in KUNDUR_VOLTAGES.items()]
    rows += [
        compare(f"Q of {name}", "Mvar", flow.generation[name].imag * 100, q, 0.5, ".1f")
        for name, q in KUNDUR_REACTIVE.items()
    ]
    source = "Kundur 1994, example 12.6, four digits"
    return ValidationTable("Power flow of kundur_12_6", source, "facts-damping modes kundur_12_6", rows)


def smib() -> ValidationTable:
    """Flow from B3 to B4, and the rotor's angle against its terminals."""
    rows: list[Row] = []
    for scenario, (power, angle) in SMIB.items():
        record = loop.run(load_case(None, ["system=smib", f"scenario={scenario}", "duration=0.02"]))
        terminals, tie = record.frames[0]
        flow = tie[list(CHANNELS).index("active_power")] * 100
        load_angle = np.rad2deg(record.machines["rotor_angle"][0, 0] - terminals[list(CHANNELS).index("voltage_angle")])
        rows.append(compare(f"{scenario}: flow from B3 to B4", "MW", flow, power, 0.01 * power, ".0f"))
        rows.append(compare(f"{scenario}: load angle", "deg", load_angle, angle, 0.4, ".2f"))
    command = "facts-damping modes smib --scenario heavy"
    return ValidationTable("Power flow of smib", "Badar's thesis, 4.5.1 and 4.7.1", command, rows)


def wscc() -> ValidationTable:
    """The nine-bus system of two books."""
    flow = solve(load_system("wscc_9"))
    rows = []
    for name, v, (magnitude, angle) in zip(flow.names, flow.voltage, WSCC, strict=True):
        rows.append(compare(f"voltage of {name}", "p.u.", float(abs(v)), magnitude, 5.1e-4, ".3f"))
        rows.append(compare(f"angle of {name}", "deg", float(np.rad2deg(np.angle(v))), angle, 0.051, ".1f"))
    source = "Anderson and Fouad, figure 2.19; Sauer and Pai, table 7.1: three digits, tenths of a degree"
    return ValidationTable("Power flow of wscc_9", source, "facts-damping modes wscc_9", rows)


def new_england() -> ValidationTable:
    """The 39-bus system."""
    flow = solve(load_system("new_england_39"))
    voltage = dict(zip(flow.names, flow.voltage, strict=True))
    theirs = figures("new_england_39_voltages_matpower")
    ours = np.array([voltage[f"B{bus}"] for bus in theirs["bus"]])
    rows = [
        within("voltages of the 39 buses", "p.u.", np.abs(ours) - theirs["magnitude"], 1e-6),
        within("angles of the 39 buses", "deg", np.rad2deg(np.angle(ours)) - theirs["angle"], 1e-5),
    ]
    command = "facts-damping modes new_england_39"
    return ValidationTable("Power flow of new_england_39", "MATPOWER, case39 solved", command, rows)


def rest() -> ValidationTable:
    """Every shipped system at its start: how fast any state moves."""
    rows = []
    for name in shipped("systems"):
        system = load_system(name)
        built = build(system, [d.name for d in system.devices], [])
        state = copy(built.state)
        slope = np.zeros_like(state.x)
        derivatives(built.plant, state.x, state.reference, state.source, 0, slope, workspace(built.plant, state))
        rows.append(within(f"{name}, all devices installed: dx/dt", "1/s", slope, 1e-9))
        rows.append(within(f"{name}: mismatch of the power flow", "p.u.", built.flow.residual, 1e-9))
    return ValidationTable("Equilibrium of every shipped system", "zero", "", rows)
