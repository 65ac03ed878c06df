"""The nonlinear part of the network: what machines, loads and converters at the ports give; compiled.

The linear network sees each port as a source s and answers with a response q = q0 + H s; each port has a law
s = f(q). Newton's method on s - f(q0 + H s) = 0 solves all ports together. Without sources (s = 0) the
SSSCs are bypassed, the STATCOMs carry nothing and the loads are impedances: a start that always exists.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from facts_damping.compiling import compiled, inlined
from facts_damping.plant import load, sssc
from facts_damping.plant.model import LOAD, SALIENT, SSSC, STATCOM

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from facts_damping.plant.model import Plant, Work

TOLERANCE = 1e-12  # relative to sqrt(1 + |s|^2)
MAX_ITERATIONS = 40
SMALLEST_SHARE = 1e-3  # of a step
ATTEMPTS = 5  # starts of Newton's method
SMALL = 1e-12  # p.u., magnitude of a response below which its direction is of no account


@inlined
def _salient(plant: Plant, stage: int, g: int, voltage: complex, slope: NDArray[np.float64], work: Work) -> complex:
    """Current of a machine beyond that of its Norton admittance, by X''q != X''d; linear in the voltage."""
    m = plant.machines[g]
    if plant.online[stage, g] == 0.0:
        slope[0, 0] = slope[0, 1] = slope[1, 0] = slope[1, 1] = 0.0
        return 0j
    turn = work.rotation[g]
    across = work.emf[g] - voltage * turn.conjugate()
    n = m.saliency
    current = complex(n[0, 0] * across.real + n[0, 1] * across.imag, n[1, 0] * across.real + n[1, 1] * across.imag)
    c, s = turn.real, turn.imag
    # -R N R^T with R the rotation
    a00, a01 = n[0, 0] * c - n[0, 1] * s, n[0, 0] * s + n[0, 1] * c
    a10, a11 = n[1, 0] * c - n[1, 1] * s, n[1, 0] * s + n[1, 1] * c
    slope[0, 0], slope[0, 1] = -(c * a00 - s * a10), -(c * a01 - s * a11)
    slope[1, 0], slope[1, 1] = -(s * a00 + c * a10), -(s * a01 + c * a11)
    return current * turn  # type: ignore[no-any-return]


@inlined
def _law(
    plant: Plant, x: NDArray[np.float64], reference: NDArray[np.float64], stage: int, p: int, work: Work
) -> complex:
    """Source that port p gives at its response, p.u.; writes its derivative into `work.slope`.

    But for machines the source is f(|q|) q / |q|, with f the port's characteristic; nothing of a blocked one.
    """
    port = plant.ports[p]
    q, slope = work.response[p], work.slope[p]
    if port.kind == SALIENT:
        return _salient(plant, stage, port.row, q, slope, work)
    if work.blocked[p]:
        slope[0, 0] = slope[0, 1] = slope[1, 0] = slope[1, 1] = 0.0
        return 0j
    magnitude = abs(q)
    direction = 1.0 + 0j
    if magnitude > SMALL:
        direction = complex(q.real / magnitude, q.imag / magnitude)
    else:
        magnitude = SMALL
    if port.kind == LOAD:
        value, by_magnitude = load.characteristic(plant.loads[port.row], magnitude, work.low[p])
        value *= plant.load_scale[stage, port.row]
        by_magnitude *= plant.load_scale[stage, port.row]
    elif port.kind == SSSC:
        # A setpoint is capacitive positive, the converter's voltage a drop.
        value, by_magnitude = sssc.characteristic(plant.sssc[port.row], x, -reference[port.device], magnitude)
    else:
        o = plant.statcom[port.row].offset
        value, by_magnitude = complex(x[o], x[o + 1]), 0j
    along = by_magnitude * direction  # by the magnitude, and by the direction
    turned = value * direction
    across = complex(-turned.imag / magnitude, turned.real / magnitude)
    slope[0, 0] = along.real * direction.real - across.real * direction.imag
    slope[0, 1] = along.real * direction.imag + across.real * direction.real
    slope[1, 0] = along.imag * direction.real - across.imag * direction.imag
    slope[1, 1] = along.imag * direction.imag + across.imag * direction.real
    return turned


@compiled
def _eliminate(matrix: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    """Solve `matrix` z = b in place, z into b, by Gaussian elimination with partial pivoting; whether regular.

    The systems have a few unknowns and are solved some hundred thousand times: a library call costs more.
    """
    n = b.size
    for i in range(n):
        pivot = i
        for r in range(i + 1, n):
            if abs(matrix[r, i]) > abs(matrix[pivot, i]):
                pivot = r
        if not abs(matrix[pivot, i]) > 0.0:
            return False
        if pivot != i:
            for c in range(i, n):
                matrix[i, c], matrix[pivot, c] = matrix[pivot, c], matrix[i, c]
            b[i], b[pivot] = b[pivot], b[i]
        for r in range(i + 1, n):
            factor = matrix[r, i] / matrix[i, i]
            if factor != 0.0:
                for c in range(i + 1, n):
                    matrix[r, c] -= factor * matrix[i, c]
                b[r] -= factor * b[i]
    for i in range(n - 1, -1, -1):
        total = b[i]
        for c in range(i + 1, n):
            total -= matrix[i, c] * b[c]
        b[i] = total / matrix[i, i]
    return True


@inlined
def _mismatch(
    plant: Plant,
    x: NDArray[np.float64],
    reference: NDArray[np.float64],
    source: NDArray[np.complex128],
    stage: int,
    work: Work,
) -> tuple[bool, float]:
    """f(q) - s of all ports into `work.change`; whether it is within the tolerance, and its sum of squares."""
    first_row, first_column = plant.machines.size, plant.machines.size + plant.infinite.size
    solved, total = True, 0.0
    for p in range(source.size):
        q = work.given[p]
        for r in range(source.size):
            q += plant.network[stage, first_row + p, first_column + r] * source[r]
        work.response[p] = q
        rest = _law(plant, x, reference, stage, p, work) - source[p]
        work.change[2 * p], work.change[2 * p + 1] = rest.real, rest.imag
        square = rest.real * rest.real + rest.imag * rest.imag
        size = source[p].real * source[p].real + source[p].imag * source[p].imag
        # Written so that a value that is not finite counts as not solved.
        solved = solved and square <= TOLERANCE * TOLERANCE * (1.0 + size)
        total += square
    return solved, total


@inlined
def _newton_matrix(plant: Plant, stage: int, work: Work) -> None:
    """I - F H into `work.matrix`, F the ports' slopes, H their responses to each other; complex numbers as pairs."""
    first_row, first_column = plant.machines.size, plant.machines.size + plant.infinite.size
    for p in range(plant.ports.size):
        f = work.slope[p]
        for r in range(plant.ports.size):
            h = plant.network[stage, first_row + p, first_column + r]
            own = 1.0 if p == r else 0.0
            i, j = 2 * p, 2 * r
            work.matrix[i, j] = own - (f[0, 0] * h.real + f[0, 1] * h.imag)
            work.matrix[i, j + 1] = f[0, 0] * h.imag - f[0, 1] * h.real
            work.matrix[i + 1, j] = -(f[1, 0] * h.real + f[1, 1] * h.imag)
            work.matrix[i + 1, j + 1] = own + f[1, 0] * h.imag - f[1, 1] * h.real


@inlined
def _newton(
    plant: Plant,
    x: NDArray[np.float64],
    reference: NDArray[np.float64],
    source: NDArray[np.complex128],
    stage: int,
    work: Work,
) -> bool:
    """Newton's method from `source` on, into `source` and `work.response`; whether it converged.

    A step that does not bring the sum of squares down is halved: limits make kinks at which whole steps may
    go to and fro.
    """
    before, share = math.inf, 1.0
    for _ in range(MAX_ITERATIONS):
        solved, total = _mismatch(plant, x, reference, source, stage, work)
        if solved:
            return True
        if total < before or share < SMALLEST_SHARE:
            _newton_matrix(plant, stage, work)
            if not _eliminate(work.matrix, work.change):
                return False
            before, share = total, 1.0
            for i in range(work.step.size):
                work.step[i] = work.change[i]
            for p in range(source.size):
                source[p] += complex(work.step[2 * p], work.step[2 * p + 1])
        else:
            share *= 0.5
            for p in range(source.size):
                source[p] -= share * complex(work.step[2 * p], work.step[2 * p + 1])
    return False


@inlined
def _block(plant: Plant, work: Work) -> bool:
    """Block the converters that have too little current or voltage; whether there is one more."""
    more = False
    for p in range(plant.ports.size):
        port = plant.ports[p]
        least = 0.0
        if port.kind == SSSC:
            least = plant.sssc[port.row].I_min
        elif port.kind == STATCOM:
            least = plant.statcom[port.row].V_min
        if not work.blocked[p] and abs(work.response[p]) < least:
            work.blocked[p] = more = True
    return more


@inlined
def _release(plant: Plant, source: NDArray[np.complex128], work: Work) -> bool:
    """Let one load that was taken as below V_min be what it is, the one furthest above; whether there was one.

    It starts as an impedance again, from above: of the two voltages at which it draws its power the higher is meant.
    """
    furthest, most = -1, 1.0
    for p in range(plant.ports.size):
        if work.low[p]:
            d = plant.loads[plant.ports[p].row]
            above = abs(work.response[p]) / (d.V0 * d.V_min)
            if above > most:
                furthest, most = p, above
    if furthest >= 0:
        work.low[furthest] = False
        source[furthest] = 0.0
    return furthest >= 0


@inlined
def solve_ports(
    plant: Plant,
    x: NDArray[np.float64],
    reference: NDArray[np.float64],
    source: NDArray[np.complex128],
    stage: int,
    work: Work,
) -> None:
    """What all ports give, into `source`, p.u.; NaN where there is no solution, which ends the run.

    Newton's method has these starts, until one converges: the solution before; no sources; the loads as what they
    are below V_min, which a deep dip may leave, released one by one where that is not so. Where a converter asks for
    more than the network can carry (an SSSC for its current, a STATCOM for its bus) there is no solution: then all
    of them are blocked, and the last two starts tried again. Without a solution still the network has none.
    """
    for p in range(source.size):
        work.blocked[p] = work.low[p] = False
    attempt = 0
    while attempt < ATTEMPTS and math.isfinite(x[0]):
        if _newton(plant, x, reference, source, stage, work):
            if _release(plant, source, work):
                continue
            if not _block(plant, work):
                return
        else:
            attempt += 1
        for p in range(source.size):
            source[p] = 0.0
            converter = plant.ports[p].kind == SSSC or plant.ports[p].kind == STATCOM
            work.blocked[p] = work.blocked[p] or (attempt == 3 and converter)
            work.low[p] = attempt in (2, 4) and plant.ports[p].kind == LOAD
    for p in range(source.size):
        source[p] = complex(math.nan, math.nan)
