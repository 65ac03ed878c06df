"""Network solution and derivatives of the whole plant; compiled.

The same functions serve the integration, the measurement and the linearisation.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from facts_damping.compiling import compiled
from facts_damping.plant import excitation, sssc
from facts_damping.plant.machine import ROTOR_STATES

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from facts_damping.plant.model import Plant, Work


@compiled
def row_times(plant: Plant, stage: int, row: int, injection: NDArray[np.complex128]) -> complex:
    """One row of the network times the injected currents, p.u."""
    total = 0j
    for column in range(injection.size):
        total += plant.network[stage, row, column] * injection[column]
    return total


@compiled
def solve_network(plant: Plant, x: NDArray[np.float64], reference: NDArray[np.float64], stage: int, work: Work) -> Any:
    """Injected currents of all machines and devices into `work.injection`, p.u.; returns the converter.

    Machines: y E'' with E'' = (E''d + j E''q) exp(j (delta - pi/2)). Without a device the converter
    returned is that of an open port.
    """
    machines = plant.machines.size
    for g in range(machines):
        m = plant.machines[g]
        o = ROTOR_STATES * g
        emf_q, emf_d = 0.0, 0.0
        for i in range(4):
            emf_q += m.C[0, i] * x[o + 2 + i]
            emf_d += m.C[1, i] * x[o + 2 + i]
        delta = x[o]
        work.emf[g] = complex(emf_d, emf_q)
        work.rotation[g] = complex(math.sin(delta), -math.cos(delta))
        work.injection[g] = m.admittance * work.emf[g] * work.rotation[g] * plant.online[stage, g]
    found = sssc.Converter(0j, 0.0, 0.0, 0.0, 0.0, 0.0, True, True, True)
    for p in range(plant.converters.size):
        port = machines + p
        work.injection[port] = 0.0
        open_circuit = row_times(plant, stage, port, work.injection)
        impedance = -plant.network[stage, port, port]
        # A setpoint is capacitive positive, the converter's voltage a drop.
        found = sssc.converter(plant.converters[p], x, -reference[p], open_circuit, impedance)
        work.injection[port] = found.current
    return found


@compiled
def stator(plant: Plant, stage: int, g: int, work: Work) -> tuple[complex, complex, float]:
    """Terminal voltage (p.u.), stator current Id + j Iq and air-gap power (p.u. of the rating) of machine g."""
    m = plant.machines[g]
    emf = work.emf[g]
    voltage = row_times(plant, stage, g, work.injection)
    seen = voltage * work.rotation[g].conjugate()  # from the rotor
    current = m.admittance * (emf - seen) * (plant.online[stage, g] / m.ratio)
    return voltage, current, emf.real * current.real + emf.imag * current.imag


@compiled
def derivatives(
    plant: Plant,
    x: NDArray[np.float64],
    reference: NDArray[np.float64],
    stage: int,
    dx: NDArray[np.float64],
    work: Work,
) -> None:
    """Write dx/dt, 1/s: swing equations (2.1)-(2.2), rotor circuits, exciters, devices.

    ddelta = omega_0 omega; 2 H domega = Pm - Pe - D omega; dz = A z + B [Id, Iq, Efd].
    """
    found = solve_network(plant, x, reference, stage, work)
    for g in range(plant.machines.size):
        m = plant.machines[g]
        e = plant.exciters[g]
        o = ROTOR_STATES * g
        voltage, current, power = stator(plant, stage, g, work)
        efd = excitation.field_voltage(e, x)
        dx[o] = plant.omega_0 * x[o + 1]
        dx[o + 1] = (plant.mechanical_power[stage, g] - power - m.D * x[o + 1]) / (2.0 * m.H)
        for i in range(4):
            slope = m.B[i, 0] * current.real + m.B[i, 1] * current.imag + m.B[i, 2] * efd
            for j in range(4):
                slope += m.A[i, j] * x[o + 2 + j]
            dx[o + 2 + i] = slope
        excitation.derivatives(e, x, abs(voltage), efd, dx)
    for p in range(plant.converters.size):
        sssc.derivatives(plant.converters[p], x, found, dx)
