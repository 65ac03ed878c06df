"""The laws of the ports: sources of machines, loads and converters as functions of the network's response; compiled."""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping.compiling import compiled
from facts_damping.elementary import magnitude
from facts_damping.plant.converters import dispatch
from facts_damping.plant.converters.first_order_lag import effective_reference
from facts_damping.plant.converters.site import DEVICE, INVERTER, OTHER_END, SALIENT
from facts_damping.plant.grid import load
from facts_damping.plant.inverter_sources import law as inverter_law

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1
    from facts_damping.plant.model import Plant, Work

SMALL = 1e-12  # p.u., magnitude of a response below which its direction is undefined


@compiled
def salient(plant: Plant, interval: int, g: int, voltage: complex, p: int, work: Work) -> complex:
    """Current of a machine in addition to its Norton admittance, due to X''q != X''d; linear in the voltage."""
    m = plant.machines[g]
    if plant.online[interval, g] == 0.0:
        work.slope[p, 0, 0] = work.slope[p, 0, 1] = work.slope[p, 1, 0] = work.slope[p, 1, 1] = 0.0
        return 0j
    turn = work.rotation[g]
    across = work.emf[g] - voltage * turn.conjugate()
    current = complex(
        m.saliency[0, 0] * across.real + m.saliency[0, 1] * across.imag,
        m.saliency[1, 0] * across.real + m.saliency[1, 1] * across.imag,
    )
    c, s = turn.real, turn.imag
    # -R N R^T with R the rotation
    a00, a01 = m.saliency[0, 0] * c - m.saliency[0, 1] * s, m.saliency[0, 0] * s + m.saliency[0, 1] * c
    a10, a11 = m.saliency[1, 0] * c - m.saliency[1, 1] * s, m.saliency[1, 0] * s + m.saliency[1, 1] * c
    work.slope[p, 0, 0], work.slope[p, 0, 1] = -(c * a00 - s * a10), -(c * a01 - s * a11)
    work.slope[p, 1, 0], work.slope[p, 1, 1] = -(s * a00 + c * a10), -(s * a01 + c * a11)
    return current * turn  # type: ignore[no-any-return]


@compiled
def characteristic(
    plant: Plant, x: Float1, reference: Float1, interval: int, p: int, size: float, work: Work
) -> tuple[complex, complex]:
    """Source of a load's or device's port relative to the direction of its response, and its derivative by |q|, p.u."""
    port = plant.ports[p]
    if port.kind in (DEVICE, OTHER_END):
        device = plant.placed[port.row]
        u = effective_reference(device, x, dispatch.reference_of(reference, port.row))
        if port.kind == DEVICE:
            return dispatch.characteristic(device.kind, device, x, u, size)  # type: ignore[no-any-return]
        return dispatch.other_characteristic(device.kind, device, x, u, size)  # type: ignore[no-any-return]
    d = plant.loads[port.row]
    active, reactive = 1.0 + work.noise[port.row, 0], 1.0 + work.noise[port.row, 1]
    if d.offset >= 0:
        deviation = load.frequency(d, x, plant.omega_0)
        active, reactive = active * (1.0 + d.kpf * deviation), reactive * (1.0 + d.kqf * deviation)
    value, slope = load.characteristic(d, size, work.low[p], active, reactive)
    scale = plant.load_scale[interval, port.row]
    return value * scale, slope * scale


@compiled
def law(plant: Plant, x: Float1, reference: Float1, interval: int, p: int, work: Work) -> complex:
    """Source of port p at its response, p.u.; writes its derivative into `work.slope`.

    Except for machines, it is f(|q|) q / |q| with f the port's characteristic; zero if blocked.
    """
    port = plant.ports[p]
    q = work.response[p]
    if port.kind == SALIENT:
        return salient(plant, interval, port.row, q, p, work)
    if port.kind == INVERTER:
        return inverter_law(plant, interval, port.row, q, p, work)
    if work.blocked[p]:
        work.slope[p, 0, 0] = work.slope[p, 0, 1] = work.slope[p, 1, 0] = work.slope[p, 1, 1] = 0.0
        return 0j
    size = magnitude(q)
    direction = 1.0 + 0j
    if size > SMALL:
        direction = complex(q.real / size, q.imag / size)
    else:
        size = SMALL
    value, by_magnitude = characteristic(plant, x, reference, interval, p, size, work)
    along = by_magnitude * direction  # derivative by the magnitude, and by the direction
    turned = value * direction
    across = complex(-turned.imag / size, turned.real / size)
    work.slope[p, 0, 0] = along.real * direction.real - across.real * direction.imag
    work.slope[p, 0, 1] = along.real * direction.imag + across.real * direction.real
    work.slope[p, 1, 0] = along.imag * direction.real - across.imag * direction.imag
    work.slope[p, 1, 1] = along.imag * direction.imag + across.imag * direction.real
    return turned
