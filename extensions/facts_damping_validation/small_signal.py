"""Eigenvalues, residues and damping against other programs, books, and runs with a ringdown or with noise."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.analysis.measures import columns, speed_differences
from facts_damping.analysis.modes.ambient import fit_ambient
from facts_damping.analysis.modes.ringdown import COVERED, ringdown_modes
from facts_damping.case.loading import load_case, load_system, read_system
from facts_damping.parameters.plant.placement import place
from facts_damping.parameters.plant.system import System
from facts_damping.plant.build import build
from facts_damping.simulation import loop
from facts_damping.small_signal.linearisation import linearise
from facts_damping.small_signal.modal_tables import analyse
from facts_damping_validation.table import Row, ValidationTable, compare, figures, furthest, within

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.small_signal.eigenmodes import Eigenmode

CLOSE = 0.01  # 1/s
SAME_EQUATIONS = 1e-5  # 1/s, what differences of the derivatives leave of the eigenvalues
THREE_DECIMALS = 5.1e-4
INTERAREA = 4  # of the modes that the report of nets_nyps prints, the first
MACHINES = ("G1", "G2", "G3", "G4")
CURRENT = {"P_fractions": {"current": 1.0}}
POWER = {"P_fractions": {"power": 1.0}, "Q_fractions": {"power": 1.0}}
SATURATION = {"S10": 0.0392, "S12": 0.2227}
STATIC = [{"machine": g, "model": "static", "KA": 200, "TR": 0.01} for g in MACHINES]
STABILISERS = [{"machine": g} for g in MACHINES]  # the defaults are the book's
TURBINE = {"r": 0.5, "Tr": 2.0, "rate_max": 10.0, "Dt": 0.5}
# Options of kundur_12_6: case of the reference, what it is, fields of every row of a table (or new rows).
OPTIONS: dict[str, tuple[str, dict[str, Any]]] = {
    "saturation": ("magnetic saturation (S10 0.0392, S12 0.2227)", {"machines": SATURATION}),
    "damping": ("damping torque (D 2)", {"machines": {"D": 2.0}}),
    "current": ("loads: P of constant current, Q an impedance", {"loads": CURRENT}),
    "power": ("loads of constant power", {"loads": POWER}),
    "static": ("static exciters (KA 200, TR 0.01)", {"exciters": STATIC}),
    "stabiliser": ("the same with stabilisers", {"exciters": STATIC, "stabilisers": STABILISERS}),
    "governor": ("hydraulic turbines and governors", {"governors": [{"machine": g, **TURBINE} for g in MACHINES]}),
}
# Example 12.6 with its four excitation systems: case in ANDES as shipped, with the book's loads and saturation.
EXCITATION = {
    "kundur_12_6_dc": ("dc", "book_dc"),
    "kundur_12_6_thyristor": ("static", "book_thyristor"),
    "kundur_12_6_thyristor_tgr": ("reduction", "book_thyristor_reduction"),
    "kundur_12_6_thyristor_pss": ("stabiliser", "book_thyristor_stabiliser"),
}
SWINGS = ("interarea", "local to area 1", "local to area 2")
SAME_MODEL = (0.005, (0.004, 0.004, 0.004))  # fraction of a frequency; damping ratios of the three
OTHER_SATURATION = (0.015, (0.005, 0.022, 0.022))
# Of kundur_12_6_thyristor, as the book has it, read off a figure to 0.002 and 0.02 1/s: config/references/README.md.
PRINTED = (0.031 + 3.85j, -0.491 + 7.16j, -0.497 + 7.35j)
RESIDUES = {  # device, signal: angle of the residue at the interarea mode of two_area, degrees
    ("sssc", "w13"): 177.0,
    ("statcom", "w13"): 156.0,
}
# A pulse of 0.1 s, after which the plant is as it was linearised: system, devices, kind of event, element.
RINGDOWN = (
    ("two_area", ["sssc"], {"kind": "load_step", "load": "load_2"}),
    ("two_area", ["sssc", "statcom"], {"kind": "load_step", "load": "load_2"}),
    ("smib", ["sssc"], {"kind": "mechanical_power_step", "machine": "G1"}),
)
TABLE_8_2 = [
    *(-0.7209 + 12.7486j, -0.1908 + 8.3672j, -5.4875 + 7.9487j, -5.3236 + 7.9220j, -5.2218 + 7.8161j),
    *(-0.4445 + 1.2104j, -0.4394 + 0.7392j, -0.4260 + 0.4960j),
]
TABLE_8_2_REAL = [-5.1761, -3.3995, -3.2258]


# Of the runs with noise.
NOISY_SYSTEMS = ("kundur_12_6_dc", "wscc_9", "smib")


def eigenvalues(system: System) -> NDArray[np.complex128]:
    """Eigenvalues at the start without devices, 1/s."""
    return np.asarray(np.linalg.eigvals(linearise(build(system, [], []))[0]), np.complex128)


def varied(system: System, fields: dict[str, Any]) -> System:
    """A system with fields of all rows of a table changed, or with the rows of a table given anew."""
    content = system.model_dump(by_alias=True)
    for table, change in fields.items():
        content[table] = change if isinstance(change, list) else [{**row, **change} for row in content[table]]
    return System.model_validate(content)


def _all(
    what: str, ours: NDArray[np.complex128], theirs: NDArray[np.complex128], tolerance: float = SAME_EQUATIONS
) -> Row:
    """All eigenvalues, without those near zero.

    Where no angle is a reference and nothing holds the speed, zero is a double eigenvalue of one eigenvector, so
    that round-off e moves it by sqrt(e).
    """
    far = [values[np.abs(values) > CLOSE] for values in (ours, theirs)]
    return within(what, "1/s", furthest(*far), tolerance)


def _read(name: str, case: str | None = None) -> NDArray[np.complex128]:
    rows = figures(name)
    if case is not None:
        rows = rows[rows["case"] == case]
    return np.asarray(rows["re"] + 1j * rows["im"])


def kundur() -> ValidationTable:
    """kundur_12_6 and its options against ANDES."""
    system = load_system("kundur_12_6")
    ours = eigenvalues(system)
    theirs = _read("kundur_12_6_eigenvalues_andes")
    rows = [_all("as it is: all eigenvalues", ours, theirs)]
    for mode in _swings(theirs):
        nearest = complex(ours[np.argmin(np.abs(ours - mode))])
        rows.append(compare("as shipped: electromechanical mode", "1/s", nearest, mode, SAME_EQUATIONS, ".5f"))
    for case, (what, fields) in OPTIONS.items():
        theirs = _read("kundur_12_6_options_eigenvalues_andes", case)
        rows.append(_all(f"{what}: all eigenvalues", eigenvalues(varied(system, fields)), theirs))
    title = "Eigenvalues of kundur_12_6 and its options"
    return ValidationTable(title, "ANDES", "facts-damping modes kundur_12_6", rows)


def _swings(values: NDArray[np.complex128]) -> list[complex]:
    """Eigenvalues of the electromechanical modes, by rising frequency."""
    return sorted((complex(v) for v in values if 2 < v.imag < 20 and -v.real < 0.3 * abs(v)), key=lambda v: v.imag)


def _apart(
    what: str, ours: Sequence[complex], theirs: Sequence[complex], allowed: tuple[float, Sequence[float]]
) -> list[Row]:
    """Frequencies and damping ratios of the swings; `allowed`: relative and absolute difference."""
    rows = []
    for name, a, b, damping in zip(SWINGS, ours, theirs, allowed[1], strict=True):
        hertz = b.imag / (2 * np.pi)
        rows.append(compare(f"{what}, {name}: frequency", "Hz", a.imag / (2 * np.pi), hertz, allowed[0] * hertz))
        rows.append(compare(f"{what}, {name}: damping ratio", "-", -a.real / abs(a), -b.real / abs(b), damping))
    return rows


def excitation() -> ValidationTable:
    """Example 12.6 with its four excitation systems, as shipped, against ANDES."""
    rows = []
    for name, (case, _) in EXCITATION.items():
        ours, theirs = eigenvalues(load_system(name)), _read("kundur_12_6_options_eigenvalues_andes", case)
        rows += [_all(f"{name}: all eigenvalues", ours, theirs)]
        rows += _apart(name, _swings(ours), _swings(theirs), SAME_MODEL)
    title = "Example 12.6 with its four excitation systems"
    return ValidationTable(title, "ANDES", "facts-damping modes kundur_12_6_thyristor_tgr", rows)


def book() -> ValidationTable:
    """The same with the loads of the book, and its saturation as GENROU has it, against ANDES and the book."""
    rows = []
    equations = figures("kundur_12_6_excitation_book")
    for name, (_, case) in EXCITATION.items():
        ours = eigenvalues(varied(load_system(name), {"loads": CURRENT, "machines": SATURATION}))
        theirs = _read("kundur_12_6_options_eigenvalues_andes", case)
        rows += [_all(f"{name}: all eigenvalues, ANDES", ours, theirs)]
        of_book = [complex(row["re"], row["im"]) for row in equations if row["system"] == name]
        rows += _apart(name, _swings(ours), of_book, OTHER_SATURATION)
        if name == "kundur_12_6_thyristor":
            rows += _apart(f"{name}, as printed", _swings(ours), PRINTED, OTHER_SATURATION)
    # He saturates both mutual inductances, GENROU the transient circuits alone.
    source = "the equations of Kundur 1994; as printed: his figures, read off a plot; ANDES"
    command = "facts-damping modes kundur_12_6_thyristor_tgr --set 'loads.*.P_fractions={current: 1}'"
    command += " --set 'machines.*.S10=0.0392' --set 'machines.*.S12=0.2227'"
    return ValidationTable("Example 12.6 with the book's loads and saturation", source, command, rows)


def others() -> ValidationTable:
    """wscc_9, new_england_39 and nets_nyps."""
    published = np.array([*TABLE_8_2, *np.conj(TABLE_8_2), *TABLE_8_2_REAL])
    constant_power = eigenvalues(load_system("wscc_9_constant_power"))
    rows = [_all("wscc_9, loads of constant power: Sauer and Pai, table 8.2", constant_power, published, 4e-3)]
    for name, tolerance in (("wscc_9", 1e-5), ("new_england_39", 1e-4), ("nets_nyps", 1e-4)):
        grid = place(read_system(name).model_copy(update={"devices": []}))
        rows.append(_all(f"{name}: ANDES", eigenvalues(grid), _read(f"{name}_eigenvalues_andes"), tolerance))
    title = "Eigenvalues of wscc_9, new_england_39 and nets_nyps"
    return ValidationTable(title, "Sauer and Pai; ANDES", "facts-damping modes wscc_9", rows)


def nets_nyps() -> ValidationTable:
    """The electromechanical modes of nets_nyps as its authors print them."""
    printed = figures("nets_nyps_modes_report")
    theirs = np.array([printed["frequency"], printed["damping"]]).T
    values = eigenvalues(place(read_system("nets_nyps").model_copy(update={"devices": []})))
    values = values[values.imag > CLOSE]
    ours = np.array([values.imag / (2.0 * np.pi), -100.0 * values.real / np.abs(values)]).T
    nearest = np.array([ours[np.argmin(np.abs(ours - mode) @ [20.0, 1.0])] for mode in theirs])  # 0.05 Hz as 1 %
    rows = []
    for (frequency, damping), mode in zip(nearest[:INTERAREA], theirs[:INTERAREA], strict=True):
        rows.append(compare(f"interarea mode of {mode[0]:.3f} Hz", "Hz", frequency, mode[0], THREE_DECIMALS))
        rows.append(compare("its damping ratio", "%", damping, mode[1], THREE_DECIMALS))
    rows.append(within("all fifteen modes: frequency", "Hz", nearest[:, 0] - theirs[:, 0], THREE_DECIMALS))
    rows.append(within("all fifteen modes: damping ratio", "%", nearest[:, 1] - theirs[:, 1], THREE_DECIMALS))
    source = "Singh and Pal, 2013, version 3.3, table 4: three decimals"
    return ValidationTable("Modes of nets_nyps without its devices", source, "facts-damping modes nets_nyps", rows)


def two_area() -> ValidationTable:
    """The interarea mode of two_area and its residues, with SSSC and STATCOM."""
    rows = []
    for devices in (["sssc"], ["sssc", "statcom"]):
        modal = analyse(load_system("two_area"), devices)
        mode = next(mode for mode in modal.swings if mode.label == "interarea")
        if devices == ["sssc"]:
            rows.append(compare("frequency of the interarea mode", "Hz", mode.frequency_hz, 0.63, 0.005))
            rows.append(compare("its damping ratio", "-", mode.damping_ratio, -0.015, 0.002))
        angle = {(r.device, r.signal): r.angle_deg for r in mode.residues}
        rows += [
            compare(f"residue from {pair[0]} to {pair[1]}", "deg", angle[pair], expected, 1.0, ".1f")
            for pair, expected in RESIDUES.items()
            if pair[0] == devices[-1]
        ]
    source = "an independent calculation; signs as in (2.42)"
    command = "facts-damping modes two_area --devices sssc,statcom"
    return ValidationTable("Interarea mode of two_area", source, command, rows)


def ringdown() -> ValidationTable:
    """The linear model against the ringdown of the time domain after a small pulse."""
    rows: list[Row] = []
    for system, devices, event in RINGDOWN:
        sets = [f"system={system}", f"devices={json.dumps(devices)}", "controllers=[]", "duration=20"]
        pulse = [{**event, "time": 1.0, "change": 0.02}, {**event, "time": 1.1, "change": 0.0}]
        record = loop.run(load_case(None, [*sets, f"scenario={json.dumps(pulse)}"]))
        mode_of_ringdown = ringdown_modes(record.time_s, columns(speed_differences(record)), 1.1)[0]
        mode = _nearest(load_system(system), devices, mode_of_ringdown.frequency_hz)
        name = f"{system} with {', '.join(devices)}"
        tolerance = 0.01 * mode.frequency_hz
        rows.append(compare(f"{name}: frequency", "Hz", mode_of_ringdown.frequency_hz, mode.frequency_hz, tolerance))
        rows.append(compare(f"{name}: damping ratio", "-", mode_of_ringdown.damping_ratio, mode.damping_ratio, 0.003))
    return ValidationTable("Ringdown against the linear model", "the linearised plant", "", rows)


def ambient() -> ValidationTable:
    """The strongest mode in ten minutes of noise: the linear one within the intervals of 95 %."""
    rows: list[Row] = []
    for system in NOISY_SYSTEMS:
        case = load_case("two_area_ambient", [f"system={system}", "devices=[]", "controllers=[]"])
        record = loop.run(case)
        fit = fit_ambient(record.time_s, columns(speed_differences(record)))
        if fit is None or not fit.modes:
            rows.append(within(f"{system}: a mode", "-", np.nan, 0.0))
            continue
        strongest = fit.modes[0]
        mode = _nearest(case.system, [], strongest.frequency_hz)
        frequency_tolerance, ratio_tolerance = (
            COVERED * strongest.frequency_error_hz,
            COVERED * strongest.damping_ratio_error,
        )
        rows += [
            compare(f"{system}: frequency", "Hz", strongest.frequency_hz, mode.frequency_hz, frequency_tolerance),
            compare(f"{system}: damping ratio", "-", strongest.damping_ratio, mode.damping_ratio, ratio_tolerance),
        ]
    source = "the linearised plant; the tolerance is half the 95 % interval of the fit"
    command = "facts-damping simulate two_area_ambient --set system=wscc_9 --set devices=[] --set controllers=[]"
    return ValidationTable("Modes from ten minutes of load noise", source, command, rows)


def _nearest(system: System, devices: list[str], frequency_hz: float) -> Eigenmode:
    """The electromechanical mode of the linear plant that is nearest to a frequency."""
    return min(analyse(system, devices).swings, key=lambda mode: abs(mode.frequency_hz - frequency_hz))
