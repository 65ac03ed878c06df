"""What a linear law guarantees: exact sampled loops in all scenarios at all delays.

The plant is that of the modes which devices move or the index sees (`modal_plants`); frames, hold, delay, dead times
and the filters of PMUs are exact (`margins.linear_closed_loop`). Margins: the longest delay, the range of a common
factor of all setpoints, and the disc margin alpha = 1/max |(S - T)/2| at the devices, by which gain and phase of all
may be off at once: a gain from (2 - alpha)/(2 + alpha) to its inverse, a phase of 2 atan(alpha/2) (P. Seiler, A.
Packard, P. Gahinet, An Introduction to Disk Margins, IEEE Control Systems 40(5), 2020).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.small_signal.zero_order_hold import held_for
from facts_damping_studies.margins.halved_steps import halvings
from facts_damping_studies.margins.linear_closed_loop import DelayedLoop, Discrete, growth, sampled, spectrum
from facts_damping_studies.robust.modal_plants import in_band, linear_model_of
from facts_damping_studies.robust.objective import SENSED_HZ

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from facts_damping.control.linear_law import Matrices
    from facts_damping_studies.robust.modal_plants import ModalPlant
    from facts_damping_studies.robust.scenarios import Scenario

    Array = NDArray[np.float64]
    Complex = NDArray[np.complex128]

LONGEST_S, STEP_S = 1.0, 0.04  # of delays in the search for the margin
LOUDEST, QUIETEST = 16.0, 1.0 / 64.0  # of the factor in the search for the gain margin
DRIFT = 1e-3  # 1/s, of common motions of all rotors, by round-off
CHARTED = 0.3  # largest damping ratio in a chart
HALVINGS = 8  # of an interval in which a margin lies


class Law(NamedTuple):
    """A linear law, p.u., the indices of its signals and devices, and the frames in a second."""

    matrices: Matrices
    signals: list[int]
    devices: list[int]
    frame_rate: int

    def discrete(self) -> Discrete:
        """The law from frame to frame, signals held."""
        A, B, C, D = self.matrices
        onward, held = held_for(A, B, 1.0 / self.frame_rate)
        return Discrete(onward, held, C, D, self.signals, self.devices)

    def scaled(self, factor: float) -> Law:
        """The law with its setpoints times a factor."""
        return self._replace(matrices=self.matrices._replace(C=factor * self.matrices.C, D=factor * self.matrices.D))

    def without(self, signal: int | None, device: int | None) -> Law:
        """The law with a signal that stays zero, or a device that no setpoint reaches."""
        _, B, C, D = (part.copy() for part in self.matrices)
        if signal is not None:
            B[:, signal], D[:, signal] = 0.0, 0.0
        if device is not None:
            C[device], D[device] = 0.0, 0.0
        return self._replace(matrices=self.matrices._replace(B=B, C=C, D=D))

    def response(self, s: complex) -> Complex:
        """K at a complex frequency (1/s), (devices, signals)."""
        A, B, C, D = self.matrices
        return np.asarray(C @ np.linalg.solve(s * np.eye(len(A)) - A, B) + D, np.complex128)


class Row(NamedTuple):
    """The least damped mode in the band with a law and without, in a scenario with a delay."""

    scenario: str
    delay: float  # s, of the link
    damping: float
    hertz: float
    without: float
    stable: bool  # no mode grows more than without control
    modes: list[tuple[float, float]]  # Hz and damping ratio of those charted, with the law


def delayed_loop_of(plant: ModalPlant, law: Law) -> DelayedLoop:
    """The loop of a plant in its modes and a law."""
    model, discrete = linear_model_of(plant), law.discrete()
    discrete = discrete._replace(dead_time=tuple(plant.dead_time[law.devices]))
    size, period = len(model.A), 1.0 / law.frame_rate
    names = [f"x{i}" for i in range(size + len(discrete.A))]
    halved = halvings(model.A, model.B, period)
    plain = DelayedLoop(model, [discrete], law.frame_rate, names, np.zeros((size, 0)), halved)
    if model.filtered is None:
        return plain
    return plain._replace(onward=halvings(model.A, model.B, 1.0 / model.filtered.rate)[0][0])


def least_damped(values: Complex) -> tuple[float, float]:
    """The least damping ratio in the band, and the frequency of its mode, Hz."""
    inside = values[in_band(values)]
    if not len(inside):
        return 1.0, 0.0
    ratios = -inside.real / np.abs(inside)
    i = int(np.argmin(ratios))
    return float(ratios[i]), float(inside[i].imag / (2.0 * np.pi))


def edge(plant: ModalPlant) -> float:
    """The growth (1/s) from which a loop counts as unstable: above that of the plant, which may drift."""
    return max(0.0, float(plant.values.real.max())) + DRIFT


def charted(values: Complex) -> list[tuple[float, float]]:
    """Frequency (Hz) and damping ratio of the modes in the band that a chart shows."""
    pairs = [(float(v.imag / (2.0 * np.pi)), float(-v.real / abs(v))) for v in values[in_band(values)]]
    return [(hertz, ratio) for hertz, ratio in pairs if ratio < CHARTED]


def rows(scenarios: Sequence[Scenario], law: Law, delays: Sequence[float]) -> list[Row]:
    """All scenarios at all delays."""
    return [row for scenario in scenarios for row in _rows(scenario.name, scenario.modal, law, delays)]


def _rows(name: str, plant: ModalPlant, law: Law, delays: Sequence[float]) -> list[Row]:
    loop = delayed_loop_of(plant, law)
    before, _ = least_damped(plant.values)
    listed = []
    for delay in delays:
        values = spectrum(loop, sampled(loop, delay))
        ratio, hertz = least_damped(values)
        stable = bool(values.real.max() < edge(plant))
        listed.append(Row(name, delay, ratio, hertz, before, stable, charted(values)))
    return listed


def lost(plant: ModalPlant, law: Law, names: tuple[Sequence[str], Sequence[str]], delays: Sequence[float]) -> list[Row]:
    """The intact grid with each signal lost, and each device, if there are several; `names`: of signals, of devices."""
    signals, devices = names
    laws = {f"signal {name} lost": law.without(i, None) for i, name in enumerate(signals) if len(signals) > 1}
    laws |= {f"device {name} lost": law.without(None, i) for i, name in enumerate(devices) if len(devices) > 1}
    return [row for name, each in laws.items() for row in _rows(name, plant, each, delays)]


def delay_margin(plant: ModalPlant, law: Law, delay: float) -> float:
    """The longest delay, s, up to which the loop is stable from `delay` on, or LONGEST_S; 0: it is not stable there."""
    loop = delayed_loop_of(plant, law)

    def stable(at: float) -> bool:
        return growth(loop, sampled(loop, at)) < edge(plant)

    if not stable(delay):
        return 0.0
    low = delay
    while low < LONGEST_S and stable(low + STEP_S):
        low += STEP_S
    return min(_edge(stable, low, low + STEP_S), LONGEST_S)


def gain_margin(plant: ModalPlant, law: Law, delay: float) -> tuple[float, float]:
    """Factors of all setpoints between which the loop is stable; searched from QUIETEST to LOUDEST."""

    def stable(factor: float) -> bool:
        loop = delayed_loop_of(plant, law.scaled(factor))
        return growth(loop, sampled(loop, delay)) < edge(plant)

    edges = []
    for step, end in ((0.5, QUIETEST), (2.0, LOUDEST)):
        inner = 1.0
        while (inner > end if step < 1.0 else inner < end) and stable(inner * step):
            inner *= step
        edges.append(_edge(stable, inner, inner * step) if inner != end else end)
    return edges[0], edges[1]


def _edge(stable: Callable[[float], bool], inner: float, outer: float) -> float:
    """Where stability ends between a stable value and another."""
    for _ in range(HALVINGS):
        middle = 0.5 * (inner + outer)
        if stable(middle):
            inner = middle
        else:
            outer = middle
    return inner


def disc_margin(plant: ModalPlant, law: Law, delay: float) -> float:
    """Alpha of the loop at the devices, with a total delay (s) of link, PMUs, devices and half a frame."""
    latency = 0.0 if plant.filters is None else plant.filters.delay
    total = delay + latency + 0.5 / law.frame_rate + plant.dead_time[law.devices]
    largest = 0.0
    for hertz in SENSED_HZ:
        s = 2j * np.pi * hertz
        G = plant.response(s)[np.ix_(law.signals, law.devices)] * np.exp(-s * total)
        loop = law.response(s) @ G
        S = np.linalg.inv(np.eye(len(loop)) - loop)
        largest = max(largest, float(np.linalg.norm(S - 0.5 * np.eye(len(loop)), 2)))
    return 1.0 / largest
