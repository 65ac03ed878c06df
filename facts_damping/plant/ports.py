"""The nonlinear part of the network: sources of machines, loads and devices at the ports; compiled.

The linear network responds to a port's source s with q = q0 + H s; each port has a law s = f(q). Newton's method solves
s - f(q0 + H s) = 0 for all ports together; where there are many, first port by port, which is much faster. Without
sources (s = 0), which is always a possible start, series devices are bypassed, parallel devices carry no current and
loads are impedances.
"""

from __future__ import annotations

import math

from facts_damping.compiling import compiled, entry_point
from facts_damping.compiling.structs import Complex1, Float1, Float2
from facts_damping.elementary import magnitude
from facts_damping.elementary.arithmetic import divided
from facts_damping.numerics.matrices import eliminate
from facts_damping.plant.converters.site import DEVICE, INVERTER, LOAD, OTHER_END, SALIENT
from facts_damping.plant.grid.sparse_network import solve_voltages
from facts_damping.plant.inverter_sources import settled
from facts_damping.plant.laws import SMALL, characteristic, law
from facts_damping.plant.model import Plant, Work
from facts_damping.plant.network_response import own_response, respond, row_times, set_sources, several_solutions

TOLERANCE = 1e-12  # relative to sqrt(1 + |s|^2)
LARGE_TOLERANCE = 1e-7  # the same of a large grid, far below the error of a step
MAX_ITERATIONS = 40
SMALLEST_FRACTION = 1e-3  # smallest fraction of a Newton step
MANY = 4  # ports, from which on it pays to solve port by port
# Starts of Newton's method, in their order (`solve_ports`); then there are no more.
LAST_SOLUTION, NO_SOURCES, LOADS_LOW, BLOCKED, BLOCKED_LOADS_LOW, NO_MORE = range(6)
NEAR = 1e-3  # p.u., of an inverter's source; further away it is solved in closed form
LAST_CHANGE = 1e-4  # relative, of Newton's method; the remaining error is of the order of its square


@compiled
def product(row: Complex1, first: int, values: Complex1) -> complex:
    """Part of a row of the network, from a column on, times as many values, p.u.; four sums, side by side."""
    a = b = c = d = 0j
    n = values.size
    for i in range(0, n - 3, 4):
        a += row[first + i] * values[i]
        b += row[first + i + 1] * values[i + 1]
        c += row[first + i + 2] * values[i + 2]
        d += row[first + i + 3] * values[i + 3]
    for i in range(n - n % 4, n):
        a += row[first + i] * values[i]
    return (a + b) + (c + d)


@compiled
def _write_response(plant: Plant, interval: int, p: int, source: Complex1, work: Work) -> None:
    """Write the response of port p to all inputs into `work.response`, p.u."""
    if len(plant.sparse_networks) > 0:
        work.response[p] = row_times(plant, interval, plant.machines.size + p, work.inputs, work)
    elif source.size < MANY:
        total, first = work.given[p], plant.machines.size + plant.infinite.size
        for r in range(source.size):
            total += plant.network[interval, plant.machines.size + p, first + r] * source[r]
        work.response[p] = total
    else:
        row = plant.network[interval, plant.machines.size + p]
        work.response[p] = work.given[p] + product(row, plant.machines.size + plant.infinite.size, source)


@entry_point
def _mismatch(plant: Plant, x: Float1, reference: Float1, source: Complex1, interval: int, work: Work) -> float:
    """Write f(q) - s of all ports into the last column of `work.matrix`.

    Returns the sum of squares, 0 if all are within the tolerance.
    """
    solved, total, last = True, 0.0, 2 * source.size
    set_sources(plant, source, work)
    respond(plant, interval, work)
    for p in range(source.size):
        _write_response(plant, interval, p, source, work)
        rest = law(plant, x, reference, interval, p, work) - source[p]
        work.matrix[2 * p, last], work.matrix[2 * p + 1, last] = rest.real, rest.imag
        square = rest.real * rest.real + rest.imag * rest.imag
        size = source[p].real * source[p].real + source[p].imag * source[p].imag
        # Written so that a non-finite value counts as unsolved.
        solved = solved and square <= TOLERANCE * TOLERANCE * (1.0 + size)
        total += square
    return 0.0 if solved else total


@compiled
def _newton_matrix(plant: Plant, interval: int, work: Work) -> None:
    """Write I - F H into `work.matrix`, F the ports' derivatives, H their mutual responses, in real pairs.

    Of a large grid H is found here, column by column: this takes long, but only where port by port none is found.
    """
    first_row, first_column = plant.machines.size, plant.machines.size + plant.infinite.size
    for r in range(plant.ports.size):
        if len(plant.sparse_networks) > 0:
            work.unit[first_column + r] = 1.0
            solve_voltages(plant.sparse_networks[interval], work.unit, work.voltage)
        for p in range(plant.ports.size):
            if len(plant.sparse_networks) > 0:
                h = row_times(plant, interval, first_row + p, work.unit, work)
            else:
                h = plant.network[interval, first_row + p, first_column + r]
            diagonal = 1.0 if p == r else 0.0
            i, j = 2 * p, 2 * r
            work.matrix[i, j] = diagonal - (work.slope[p, 0, 0] * h.real + work.slope[p, 0, 1] * h.imag)
            work.matrix[i, j + 1] = work.slope[p, 0, 0] * h.imag - work.slope[p, 0, 1] * h.real
            work.matrix[i + 1, j] = -(work.slope[p, 1, 0] * h.real + work.slope[p, 1, 1] * h.imag)
            work.matrix[i + 1, j + 1] = diagonal + work.slope[p, 1, 0] * h.imag - work.slope[p, 1, 1] * h.real
        work.unit[first_column + r] = 0.0


@compiled
def _newton(plant: Plant, x: Float1, reference: Float1, source: Complex1, interval: int, work: Work) -> bool:
    """Newton's method from `source`, into `source` and `work.response`; returns whether it converged.

    A step that does not reduce the sum of squares is halved: limits cause kinks at which full steps may oscillate. One
    from a mismatch below `LAST_CHANGE` is the last, unless there may be several solutions.
    """
    alone = source.size >= MANY or plant.inverters.size > 0
    if alone and _port_by_port(plant, x, reference, source, interval, work):
        return True
    before, fraction, expects = math.inf, 1.0, not several_solutions(plant)
    for _ in range(MAX_ITERATIONS):
        total = _mismatch(plant, x, reference, source, interval, work)
        if total == 0.0:
            return True
        if total < before or fraction < SMALLEST_FRACTION:
            _newton_matrix(plant, interval, work)
            if not eliminate(work.matrix):
                return False
            before, fraction = total, 1.0
            for i in range(work.step.size):
                work.step[i] = work.matrix[i, work.step.size]
            for p in range(source.size):
                source[p] += complex(work.step[2 * p], work.step[2 * p + 1])
            if expects and total <= LAST_CHANGE * LAST_CHANGE:
                for p in range(source.size):
                    _write_response(plant, interval, p, source, work)
                return True
        else:
            fraction *= 0.5
            for p in range(source.size):
                source[p] -= fraction * complex(work.step[2 * p], work.step[2 * p + 1])
    return False


@entry_point
def _newton_single_port(
    plant: Plant, x: Float1, reference: Float1, source: Complex1, interval: int, work: Work
) -> bool:
    """Solve for a plant's single port, a load or device, three times as fast; returns whether it converged.

    From q = q0 + H s and s = f(|q|) q / |q| follows |q0| = | |q| - H f |: one equation,
    |q| = Re(H f) + sqrt(|q0|^2 - Im(H f)^2), for the magnitude; then q / |q| = q0 / (|q| - H f).
    """
    h = own_response(plant, interval, 0)
    q0 = work.given[0]
    square = q0.real * q0.real + q0.imag * q0.imag
    m = magnitude(q0 + h * source[0])
    minimum = max(plant.ports[0].minimum, SMALL)
    for _ in range(MAX_ITERATIONS):
        if not m > minimum:
            return False
        value, slope = characteristic(plant, x, reference, interval, 0, m, work)
        a, b = h * value, h * slope
        rest = square - a.imag * a.imag
        if not rest > 0.0:
            return False
        root = math.sqrt(rest)
        change = (a.real + root - m) / (1.0 - b.real + a.imag * b.imag / root)
        m += change
        if abs(change) <= LAST_CHANGE * m:
            value += slope * change
            a = h * value
            direction = q0 / complex(m - a.real, -a.imag)
            source[0] = value * direction
            work.response[0] = m * direction
            return bool(minimum < m <= plant.ports[0].maximum)
    return False


@entry_point
def _port_by_port(plant: Plant, x: Float1, reference: Float1, source: Complex1, interval: int, work: Work) -> bool:
    """Newton's method for one port after the other, with the other sources as they are; returns whether it converged.

    A port is coupled most to itself, so that a round reduces the error some tenfold; it costs little more than the
    mismatch. It is given up where a port has no step, or when the mismatch no longer falls to half; of a large grid
    with inverters, which are more coupled, when it no longer falls. The mismatch after the last step is expected to
    fall once more as it fell before, unless there may be several solutions. Inverters that are not `NEAR` are solved in
    closed form, and blocked if they cannot be.
    """
    before, large, expects = math.inf, len(plant.sparse_networks) > 0, not several_solutions(plant)
    tolerance, falls = LARGE_TOLERANCE if large else TOLERANCE, 1.0 if large and plant.inverters.size > 0 else 0.25
    for _ in range(MAX_ITERATIONS):
        solved, total = True, 0.0
        set_sources(plant, source, work)
        respond(plant, interval, work)
        for p in range(source.size):
            _write_response(plant, interval, p, source, work)
            h = own_response(plant, interval, p)
            rest = law(plant, x, reference, interval, p, work) - source[p]
            square = rest.real * rest.real + rest.imag * rest.imag
            size = source[p].real * source[p].real + source[p].imag * source[p].imag
            right = square <= tolerance * tolerance * (1.0 + size)
            if plant.ports[p].kind != INVERTER or work.blocked[p] or square < NEAR * NEAR:
                step = _own_step(h, work.slope[p], rest)
            else:
                step = settled(plant, interval, h, source[p], p, work) - source[p]
                before = math.inf if work.blocked[p] else before
            if math.isnan(step.real):
                return False
            solved = solved and right
            total += square
            source[p] += step
        if solved or (expects and before < math.inf and total * total <= tolerance * tolerance * before):
            return True
        if not total < falls * before:
            return False
        before = total
    return False


@compiled
def _own_step(h: complex, f: Float2, rest: complex) -> complex:
    """The change of a port's source that removes its mismatch: (I - F h)^-1 times it, with its own response h.

    NaN if none does.
    """
    a, b = 1.0 - (f[0, 0] * h.real + f[0, 1] * h.imag), f[0, 0] * h.imag - f[0, 1] * h.real
    c, d = -(f[1, 0] * h.real + f[1, 1] * h.imag), 1.0 + f[1, 0] * h.imag - f[1, 1] * h.real
    by = a * d - b * c if a * d != b * c else math.nan
    return divided(complex(d * rest.real - b * rest.imag, a * rest.imag - c * rest.real), by)


@compiled
def _block(plant: Plant, work: Work) -> bool:
    """Block devices with too little current or voltage, or too much current; returns whether any were added."""
    more = False
    for p in range(plant.ports.size):
        size = magnitude(work.response[p])
        if not work.blocked[p] and (size < plant.ports[p].minimum or size > plant.ports[p].maximum):
            work.blocked[p] = more = True
    return more


@compiled
def _can_block(plant: Plant, p: int) -> bool:
    """Whether a port is that of a device, or of an inverter that follows its voltage."""
    port = plant.ports[p]
    return port.kind in (DEVICE, OTHER_END) or (port.kind == INVERTER and plant.inverters[port.row].angle < 0)


@compiled
def _resume(plant: Plant, source: Complex1, interval: int, work: Work) -> int:
    """Release the first blocked inverter that can be solved with the others as they are; its port, or -1."""
    for p in range(source.size):
        if plant.ports[p].kind == INVERTER and work.blocked[p] and not work.given_up[p]:
            source[p] = settled(plant, interval, own_response(plant, interval, p), source[p], p, work)
            if not work.blocked[p]:
                return p
    return -1


@compiled
def _release(plant: Plant, source: Complex1, work: Work) -> bool:
    """Release the load furthest above V_min that still has its characteristic below V_min; returns whether one was.

    It starts as an impedance, from high voltage, to find the higher of the two voltages at which it draws its power.
    """
    furthest, maximum = -1, 1.0
    for p in range(plant.ports.size):
        if work.low[p]:
            d = plant.loads[plant.ports[p].row]
            above = magnitude(work.response[p]) / (d.V0 * d.V_min)
            if above > maximum:
                furthest, maximum = p, above
    if furthest >= 0:
        work.low[furthest] = False
        source[furthest] = 0.0
    return furthest >= 0


@entry_point
def solve_ports(plant: Plant, x: Float1, reference: Float1, source: Complex1, interval: int, work: Work) -> None:
    """Solve the sources of all ports into `source`, p.u.; NaN if there is no solution, which ends the run.

    Newton's method is tried from these starts until one converges: the last solution; no sources; all loads with their
    characteristic below V_min, as after a deep dip, then released one by one. If a device demands more than the network
    can carry (in series for its current, in parallel for its bus) there is no solution. Then all such devices are
    blocked, and the last two starts are tried again. If this fails too, the network has no solution. An inverter that
    follows its voltage may be the only one without solution: those blocked are released one by one, or given up.
    """
    for p in range(source.size):
        work.blocked[p] = work.low[p] = work.given_up[p] = False
    if (
        source.size == 1
        and plant.ports[0].kind not in (SALIENT, INVERTER)
        and _newton_single_port(plant, x, reference, source, interval, work)
    ):
        return
    start, released, turns = LAST_SOLUTION, -1, source.size
    while start < NO_MORE and math.isfinite(x[0]):
        if _newton(plant, x, reference, source, interval, work):
            if _release(plant, source, work):
                continue
            if released >= 0 and work.blocked[released]:
                work.given_up[released] = True
            released = _resume(plant, source, interval, work) if turns > 0 else -1
            if released >= 0:
                turns -= 1
                continue
            if not _block(plant, work):
                return
        elif released >= 0:
            work.given_up[released], released = True, -1
        else:
            start += 1
        for p in range(source.size):
            source[p] = 0.0
            stays = work.given_up[p] if plant.ports[p].kind == INVERTER else work.blocked[p]
            work.blocked[p] = stays or (start >= BLOCKED and _can_block(plant, p))
            work.low[p] = start in (LOADS_LOW, BLOCKED_LOADS_LOW) and plant.ports[p].kind == LOAD
    for p in range(source.size):
        source[p] = complex(math.nan, math.nan)
