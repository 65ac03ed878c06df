"""Laws that are tuned: lead-lags by residue, LQG and H-infinity of few states, from the scenarios' linear plants."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from facts_damping_studies.design.lead_lag import lead_lag
from facts_damping_studies.robust import synthesis
from facts_damping_studies.robust.loops import loop
from facts_damping_studies.robust.objective import FAST_HZ, SENSED_HZ, Problem, objective
from facts_damping_studies.robust.structures import Channel, free, lead_lags
from facts_damping_studies.robust.tuning import Tuned, stabilised, tuned, weakest_kept

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping_studies.robust.scenarios import Scenario
    from facts_damping_studies.robust.structures import Structure

    Array = NDArray[np.float64]

EFFORT = 1e-7  # p.u.^2, weight of a setpoint at its limit: as a speed difference of 0.0003
OTHER_EFFORTS = 1e-6, 1e-8  # with which the best law is tuned again
EFFORTS = 1e-7, 1e-6, 1e-5  # of LQG laws from which tuning starts
TORQUE = 0.01  # p.u., rms of the steps of torques in a second for which the filter of an LQG is optimal
GAINS = 0.3, 1.0, 3.0  # of H-infinity laws from which tuning starts, limits per size of a signal
ORDERS = 6, 10
SIZE = 1e-3  # p.u., of speed differences, in which signals are scaled to each other
TYPICAL = 8  # scenarios that count from the start
PUSHED = 0.05  # damping ratio that the lead-lags of a start add
LAWS = "lead-lag", "LQG", "Hinf"


class Setting(NamedTuple):
    """What a law acts by: limits, delays, noise and rates of a run."""

    limits: Array  # (devices,), p.u.
    latency: Array  # (devices,), s, beside the link's delay: PMUs, dead times, a frame of holds
    noise: Array  # (signals,), rms, p.u.
    frame_rate: int


def sizes(scenario: Scenario) -> Array:
    """Size of each signal where speed differences have SIZE, rms over steps of torques, (signals,), p.u."""
    plant = scenario.plant
    shift = max(0.0, float(np.linalg.eigvals(plant.A).real.max()) + 0.05)
    P = solve_continuous_lyapunov(plant.A - shift * np.eye(len(plant.A)), -plant.R @ plant.R.T)
    swings = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", plant.C, P, plant.C), 0.0))
    differences = np.sqrt(np.einsum("ij,jk,ik->", plant.Z, P, plant.Z) / len(plant.Z))
    relative: Array = SIZE * swings / differences
    return relative


def problem(scenarios: Sequence[Scenario], setting: Setting, delays: Sequence[float], size: Array) -> Problem:
    """All scenarios at all delays (s, of the link), and the intact grid with each signal and each device lost."""
    signals, devices = len(size), len(setting.limits)
    masks = [(scenario, scenario.name, np.ones(signals), np.ones(devices)) for scenario in scenarios]
    for many, which in ((signals, 0), (devices, 1)):
        for i in range(many if many > 1 else 0):
            left, right = np.ones(signals), np.ones(devices)
            (left, right)[which][i] = 0.0
            masks.append((scenarios[0], f"{('signal', 'device')[which]} {i + 1} lost", left, right))
    names, loops, responses = [], [], []
    at = 2j * np.pi * np.r_[SENSED_HZ, FAST_HZ]
    for scenario, name, of_signals, of_devices in masks:
        plain = np.array([scenario.modal.response(s) for s in at]) / size[:, None] * setting.limits
        plain = plain * of_signals[:, None] * of_devices
        for delay in delays:
            total = delay + setting.latency
            names.append(name)
            scaled = of_signals / size, of_devices
            loops.append(loop(scenario.plant, setting.limits, total.tolist(), scaled, EFFORT))
            responses.append(plain * np.exp(-at[:, None, None] * total))
    many = len(scenarios) * len(delays)
    step = max(1, len(scenarios) // TYPICAL)
    first = [*range(len(delays)), *range(step * len(delays), many, step * len(delays))]
    lost = frozenset(name for _, name, *_ in masks[len(scenarios) :])
    return Problem(names, loops, np.array(responses), setting.noise / size, float(setting.frame_rate), first, lost)


def starts(
    of: Problem, scenario: Scenario, setting: Setting, delay: float, size: Array, laws: Sequence[str]
) -> list[Structure]:
    """The structures that are tuned, each from where it starts."""
    makers = {
        "lead-lag": lambda: _lead_lags(scenario, setting, delay, size),
        "LQG": lambda: _lqg(of, setting),
        "Hinf": lambda: _h_infinity(of),
    }
    return [structure for law in laws for structure in makers[law]()]


def _lead_lags(scenario: Scenario, setting: Setting, delay: float, size: Array) -> list[Structure]:
    """Decentralised: each device has the signal and the mode that it moves most; and all pairs, from the same."""
    plant = scenario.modal
    ratios = -plant.values.real / np.abs(plant.values)
    modes = np.flatnonzero(plant.swings & (ratios < 0.2))
    total = delay + setting.latency
    channels = []
    for d in range(len(setting.limits)):
        residues = plant.C[:, modes] / size[:, None] * plant.B[modes, d] * setting.limits[d]
        s, m = np.unravel_index(int(np.argmax(np.abs(residues) / np.abs(plant.values[modes]))), residues.shape)
        at, residue = complex(plant.values[modes[m]]), complex(residues[s, m])
        law = lead_lag(residue, at, float(total[d]) - 0.5 / setting.frame_rate, setting.frame_rate)
        gain = PUSHED * abs(at) / abs(residue * law.response(at))
        channels.append(Channel(d, int(s), law.sign * float(gain), law.T1, law.T2))
    structures = [lead_lags(channels, len(setting.limits), len(size))]
    if len(size) > 1:
        there = {(c.device, c.signal) for c in channels}
        more = [
            Channel(c.device, s, 0.01 * c.gain, c.T1, c.T2)
            for c in channels
            for s in range(len(size))
            if (c.device, s) not in there
        ]
        structures.append(
            lead_lags([*channels, *more], len(setting.limits), len(size))._replace(name="coordinated lead-lags")
        )
    return structures


def _lqg(of: Problem, setting: Setting) -> list[Structure]:
    """LQG laws of the intact grid in ORDERS; of the EFFORTS the one with the least objective."""
    density = of.noise / np.sqrt(setting.frame_rate)
    laws = [synthesis.lqg(of.loops[0], effort, density, TORQUE) for effort in EFFORTS]
    return _best_of_orders(of, "LQG", laws)


def _h_infinity(of: Problem) -> list[Structure]:
    """H-infinity laws of the intact grid, likewise."""
    return _best_of_orders(of, "Hinf", [synthesis.h_infinity(of.loops[0], gain) for gain in GAINS])


def _best_of_orders(of: Problem, name: str, laws: Sequence[synthesis.Compensator]) -> list[Structure]:
    part, best = of.of(of.first), []
    for order in ORDERS:
        structures = []
        for law in laws:
            small = synthesis.of_order(law, order)
            if small is not None:
                structure = free(f"{name} of {small.states} states", small.K, small.states)
                structures.append(structure._replace(start=stabilised(part, structure, structure.start)))
        if structures:
            best.append(min(structures, key=lambda structure: objective(part, structure, structure.start)[0]))
    return best


class TuningTask(NamedTuple):
    """A structure to be tuned."""

    problem: Problem
    structure: Structure
    evaluations: int
    seed: int


def tune(task: TuningTask) -> Tuned:
    """A structure tuned, and made as weak as its demands ask for."""
    result = tuned(task.problem, task.structure, task.evaluations, task.seed, _quiet)
    return weakest_kept(task.problem.inverted(result.inverted), result)


def again(of: Problem, result: Tuned, evaluations: int, seed: int) -> list[TuningTask]:
    """A tuned structure, to be tuned from where it is with OTHER_EFFORTS."""
    tasks = []
    for effort in OTHER_EFFORTS:
        name = f"{result.structure.name}, weight {effort / EFFORT:g}"
        structure = result.structure._replace(name=name, start=result.parameters)
        tasks.append(TuningTask(of.with_effort(effort), structure, evaluations, seed))
    return tasks


def _quiet(_done: int, _of: int) -> None:
    pass
