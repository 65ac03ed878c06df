"""Modes of a linear model: frequency, damping, shape, participation, residues."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.small_signal import descriptor
from facts_damping.small_signal.descriptor import Descriptor
from facts_damping.small_signal.zero_order_hold import ANGLES, SLIPS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Float2
    from facts_damping.parameters.plant.system import System
    from facts_damping.small_signal.linearisation import LinearModel

NEGLIGIBLE = 0.02  # participation of a state in a mode below which it is not listed, or a quarter of the largest

SWING_FRACTION = 0.5  # least participation of rotor angles and speeds in an electromechanical mode

COMMON_FRACTION = 0.2  # the same for a mode with all machines in phase, in which governors participate
VIRTUAL_H = 4.0  # s, inertia with which a grid-forming inverter counts in a mode's label, that of a usual machine
# States by which a grid-forming inverter swings: a virtual machine's, or the angle and the power of a droop.
VIRTUAL, DROOPING = (*SLIPS, ".angle_IT"), (*ANGLES, ".P_seen")


class Residue(NamedTuple):
    """Residue (1/s) of a mode from a device's input to a signal, and the phase needed from a controller u = K y.

    A gain K of the given sign and with a phase lead (deg) at the mode's frequency shifts the eigenvalue by R K to
    the left.
    """

    device: str
    signal: str
    magnitude: float
    angle_deg: float
    sign: int
    lead_deg: float


class Eigenmode(NamedTuple):
    """A mode: eigenvalue (1/s), frequency (Hz), damping ratio, participation of each state, mode shape.

    `label` is interarea, local, electromechanical (no areas are given), common (all together) or control; `shape` is
    the speed of each machine and grid-forming inverter relative to the fastest, complex.
    """

    eigenvalue: complex
    frequency_hz: float
    damping_ratio: float
    participation: dict[str, float]
    label: str
    shape: dict[str, complex]
    residues: list[Residue]

    @property
    def swings(self) -> bool:
        """Whether machines and grid-forming inverters swing against each other in this mode."""
        return self.label not in ("common", "control")


def eigenvectors(matrix: Float2 | Descriptor) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Eigenvalues of a matrix, left eigenvectors, as in w A = lambda w, and right ones, in columns.

    With more than `descriptor.ALL_MODES` states of a large grid only those of `descriptor.eigenvectors`.
    """
    from scipy.linalg import eig  # noqa: PLC0415 (runs do without it)

    if isinstance(matrix, Descriptor):
        if descriptor.is_partial(matrix):
            return descriptor.eigenvectors(matrix)
        matrix = descriptor.dense(matrix)
    values, left, right = eig(matrix, left=True, right=True)  # no inverse: drifts have no full set of eigenvectors
    return values, left.conj(), right


def modes(
    matrix: Float2 | Descriptor,
    names: Sequence[str],
    system: System | None = None,
    model: LinearModel | None = None,
    devices: Sequence[str] = (),
) -> list[Eigenmode]:
    """Modes of a state matrix, one per conjugate pair, sorted by falling real part.

    Frequency |Im| / (2 pi), damping ratio -Re / |lambda|; participation |w_k v_k| of state k, left times right
    eigenvector, scaled to sum one (Kundur 1994, 12.2). With a linear model of the system's signals, the
    electromechanical modes have residues F (C v)(w B) exp(-lambda Td), w scaled to w v = 1 (12.3.4), F the signals'
    washouts, Td the devices' dead times.
    """
    values, left, right = eigenvectors(matrix)
    eigenmodes = []
    for i in np.argsort(-values.real):
        if values[i].imag < 0:
            continue
        v, w = right[:, i], left[:, i]
        eigenmode = mode(complex(values[i]), v, w, names, system)
        if model is not None and system is not None and eigenmode.swings:
            seen = model.gain(values[i]) * (model.seen[0] @ v)
            matrix_of_residues = np.outer(seen, w @ model.B) / (w @ v) * model.late(values[i])
            eigenmode = eigenmode._replace(residues=_residues(matrix_of_residues, list(system.signals), devices))
        eigenmodes.append(eigenmode)
    return eigenmodes


def mode(
    eigenvalue: complex, right: NDArray[Any], left: NDArray[Any], names: Sequence[str], system: System | None = None
) -> Eigenmode:
    """A mode, without residues, from its eigenvalue (1/s) and eigenvectors; `names`: of the states.

    `left` as in w A = lambda w. The speeds of the system's machines are among the states.
    """
    fraction = np.abs(left * right)
    fraction /= fraction.sum()
    count = int((fraction >= min(NEGLIGIBLE, fraction.max() / 4.0)).sum())
    listed = {names[k]: float(fraction[k]) for k in np.argsort(-fraction)[:count]}
    size = abs(eigenvalue)
    ratio = float(-eigenvalue.real / size) if size > 0 else 0.0
    angles, turning = _rotors(tuple(names))
    values = speeds(eigenvalue, right, names, system)
    maximum = max(values.values(), key=abs, default=0j)
    shape = {name: value / maximum if maximum else value for name, value in values.items()}  # the largest is one
    forming = [k for places in _forming(tuple(names), system).values() for k in places if eigenvalue.imag != 0.0]
    label = _label(float(fraction[[*angles.values(), *turning.values(), *forming]].sum()), shape, system)
    return Eigenmode(eigenvalue, float(eigenvalue.imag / (2 * np.pi)), ratio, listed, label, shape, [])


@cache
def _rotors(names: tuple[str, ...]) -> tuple[dict[str, int], dict[str, int]]:
    """Places of rotor angles and speeds among the states, by machine."""
    ends = (".delta", ".omega")
    angles, speeds = ({name.removesuffix(end): k for k, name in enumerate(names) if name.endswith(end)} for end in ends)
    return angles, speeds


def speeds(eigenvalue: complex, right: NDArray[Any], names: Sequence[str], system: System | None) -> dict[str, complex]:
    """Speed of each machine in an eigenvector, p.u., and of each grid-forming inverter: d(angle)/dt / omega_0."""
    values = {name: complex(right[k]) for name, k in _rotors(tuple(names))[1].items()}
    for name, places in _forming(tuple(names), system).items():
        k, omega_0 = places[0], 2.0 * np.pi * (system.frequency if system else np.nan)
        values[name] = complex(right[k]) * (1.0 if names[k].endswith(SLIPS) else eigenvalue / omega_0)
    return values


def _forming(names: tuple[str, ...], system: System | None) -> dict[str, list[int]]:
    """Places of the states by which each grid-forming inverter swings, first its speed or its angle.

    One that follows the grid has an angle of a phase-locked loop, but no speed of its own.
    """
    at = _places(names)
    ends = {
        i.name: VIRTUAL if any(i.name + end in at for end in SLIPS) else DROOPING
        for i in (system.inverters if system else ())
        if i.forming
    }
    return {name: [at[name + end] for end in of_one if name + end in at] for name, of_one in ends.items()}


@cache
def _places(names: tuple[str, ...]) -> dict[str, int]:
    return {name: k for k, name in enumerate(names)}


def inertias(system: System) -> dict[str, float]:
    """H times rating of each machine, MVA s, and for grid-forming inverters that of a usual machine."""
    of_machines = {m.name: m.H * m.rating for m in system.machines}
    return of_machines | {i.name: VIRTUAL_H * i.rating for i in system.inverters}


def unlike(some: Sequence[Eigenmode], others: Sequence[Eigenmode]) -> Float2:
    """Differences of modes, (some, others): relative change of eigenvalue plus 1 - MAC of the shapes, at most 1."""
    a, b = (np.array([list(mode.shape.values()) for mode in modes], complex) for modes in (some, others))
    if not (len(a) and len(b)):
        return np.ones((len(a), len(b)))
    values, other = (np.array([mode.eigenvalue for mode in modes]) for modes in (some, others))
    sizes = np.multiply.outer(*((np.abs(shapes) ** 2).sum(axis=1) for shapes in (a, b)))
    alike = np.abs(a.conj() @ b.T) ** 2 / np.where(sizes > 0.0, sizes, np.inf)
    return np.asarray(np.minimum(1.0, np.abs(values[:, None] - other) / np.abs(values)[:, None] + 1.0 - alike))


def _label(swing: float, shape: dict[str, complex], system: System | None) -> str:
    """The kind of a mode, by the kinetic energy of the common motion, of the areas' motion, and of the rest.

    sum_A (sum H S) |mean_A|^2 against sum H S |v|^2, means weighted by H S: interarea if the areas' means have more
    than half.
    """
    if system is None or swing < COMMON_FRACTION:
        return "control"
    inertia = {name: value for name, value in inertias(system).items() if name in shape}
    areas: dict[str, list[str]] = {}
    for unit in (unit for unit in system.units if unit.name in shape):
        areas.setdefault(unit.area or "", []).append(unit.name)

    def moving(group: Sequence[str]) -> float:
        weight = sum(inertia[name] for name in group)
        return float(abs(sum(inertia[name] * shape[name] for name in group)) ** 2 / weight)

    total = sum(inertia[name] * abs(shape[name]) ** 2 for name in inertia)
    together = moving(list(inertia))
    if not system.infinite_buses and together > 0.5 * total:
        return "common"
    if swing < SWING_FRACTION:
        return "control"
    if "" in areas:
        return "electromechanical"
    by_area = sum(moving(group) for group in areas.values())
    return "interarea" if by_area > 0.5 * total and len(areas) > 1 else "local"


def _residues(matrix: NDArray[Any], signals: Sequence[str], devices: Sequence[str]) -> list[Residue]:
    """Residues from each device to each signal, with the sign and the lead that turn R K to -180 degrees."""
    residues = []
    for d, device in enumerate(devices):
        for s, signal in enumerate(signals):
            angle = float(np.rad2deg(np.angle(matrix[s, d])))
            residues.append(Residue(device, signal, float(abs(matrix[s, d])), angle, *sign_and_lead(angle)))
    return residues


def sign_and_lead(angle_deg: float) -> tuple[int, float]:
    """Sign of a gain, and its phase lead (deg, at most 90 to either side), that turn an angle to -180 degrees."""
    lead = (180.0 - angle_deg + 180.0) % 360.0 - 180.0
    sign = 1 if abs(lead) <= 90.0 else -1
    return sign, lead if sign == 1 else (lead + 360.0) % 360.0 - 180.0
