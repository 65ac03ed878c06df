"""The linearised closed loop with delay: exact with sampling and hold, or continuous with a Pade approximation.

From frame to frame, T apart, with a delay of n frames and a rest `part` < T between measurement and device
(K. J. Astrom, B. Wittenmark, Computer-Controlled Systems, 3rd ed. 1997, 2.3):

    x(k+1) = Phi(T) x(k) + Phi(T - part) Gamma(part) u(k-n-1) + Gamma(T - part) u(k-n)

with Phi(t) = exp(A t), Gamma(t) = int_0^t exp(A s) ds B, so Phi(T - part) Gamma(part) = Gamma(T) - Gamma(T - part).
The measurement at t_k is taken with the setpoints in force before t_k. Only the sum of the delays of both ways matters,
since a controller acts at once on what arrives. The dead time of a device is part of its delay; each device has its own
n and `part`.
"""

from __future__ import annotations

from dataclasses import replace
from math import factorial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.linalg import block_diag, eig, eigvals, qr
from scipy.signal import tf2ss

from facts_damping.case.names import controller_names
from facts_damping.control.bank import act
from facts_damping.control.table import CONTROLLERS, STATE_SPACE, kind_of
from facts_damping.errors import InputError
from facts_damping.link.stages import mean_delay
from facts_damping.parameters.link import Link
from facts_damping.parameters.stages import Constant
from facts_damping.plant.build import build
from facts_damping.signals import DELIVERY, NANOSECONDS, SETPOINT, to_ns
from facts_damping.simulation.assembly import build_control
from facts_damping.small_signal import linearisation
from facts_damping.small_signal.lqg import washouts
from facts_damping.small_signal.sampled_output import remember
from facts_damping.small_signal.zero_order_hold import rigid
from facts_damping_studies.margins.halved_steps import effect, halvings, samples
from facts_damping_studies.margins.unsupervised import unsupervised

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.control.bank import Bank, BankState

    Halvings = list[tuple[NDArray[np.float64], NDArray[np.float64]]]
    Matrices = tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]

OTHERS = "(of others a sweep of runs gives the margin)"
FADED = 1e-6  # per frame: faster decay is no mode, but the memory of a difference equation


class Discrete(NamedTuple):
    """A controller as difference equations: z(k+1) = A z(k) + B y(k), u(k) = C z(k) + D y(k), p.u."""

    A: NDArray[np.float64]  # (states, states)
    B: NDArray[np.float64]  # (states, signals)
    C: NDArray[np.float64]  # (devices, states)
    D: NDArray[np.float64]  # (devices, signals)
    signals: list[int]  # indices among the plant's
    devices: list[int]  # indices among the plant's
    extra_delay: float = 0.0  # s, excess of its delay over that of the shortest link
    dead_time: tuple[float, ...] = ()  # s, of each of its devices; empty: 0

    def delays(self, delay: float) -> list[float]:
        """The delay at each of its devices for a total delay of the shortest link, s."""
        return [delay + self.extra_delay + dead for dead in self.dead_time or [0.0] * len(self.devices)]


class DelayedLoop(NamedTuple):
    """A linear plant and its controllers, in deviations from the equilibrium."""

    model: linearisation.LinearModel  # without the signals' washouts, which are part of the controllers
    controllers: list[Discrete]
    frame_rate: int  # frames/s
    names: list[str]  # of the plant's states, then of the controllers'
    rigid: NDArray[np.float64]  # (plant's states, 0 to 2), orthonormal: common rotor motions without response
    halved: Halvings  # of the plant over a frame
    onward: NDArray[np.float64] = np.zeros((0, 0))  # Phi of the plant between two samples of PMUs with a filter


class Eigen(NamedTuple):
    """Eigenvalues of a closed loop, 1/s, sorted by falling real part, without those of the rigid motions."""

    values: NDArray[np.complex128]  # (modes,)
    right: NDArray[np.complex128]  # (plant's and controllers' states, modes)
    left: NDArray[np.complex128]  # left eigenvectors, w A = lambda w, same shape

    @property
    def growth(self) -> float:
        """Largest real part, 1/s: the loop is unstable if it is positive."""
        return float(self.values[0].real)


def delayed_loop(case: Case) -> DelayedLoop:
    """The closed loop of a run about its equilibrium, without supervisors and fallbacks.

    Each link has the excess of its mean delay over the shortest link's; jitter and losses are left out. Raises
    `InputError` for controllers without a linear model and for links with delays of single channels or times.
    """
    case = unsupervised(case)
    if not case.controllers:
        raise InputError("controllers: none given; allowed: one linear controller at least")
    linear_ones = [name for name, row in CONTROLLERS.items() if row.network is None]
    for i, controller in enumerate(case.controllers):
        row = kind_of(controller)
        if row.network is not None or row.program or row.node:
            problem = f"'{controller.name}' given, which is not linear and has no linear margin"
            allowed = f"{', '.join(linear_ones)}, a `linear` law {OTHERS}"
            raise InputError(f"controllers.{i}.name: {problem}; allowed: {allowed}")
        if controller.compensation != "none":
            problem = f"'{controller.compensation}' given, which changes during the run"
            raise InputError(f"controllers.{i}.compensation: {problem}; allowed: none {OTHERS}")
    built = build(case.system, case.run.devices, [])
    pmus, rate = [s.name for s in case.system.pmus], case.run.frame_rate
    model = linearisation.linear_model(built, case.system.signals, pmus, case.filter, rate)
    delays = link_delays(case)
    bank, state, *_ = build_control(case)
    controllers, names = [], list(built.state_names)
    for c, (controller, name) in enumerate(zip(case.controllers, controller_names(case), strict=True)):
        observes = bank.code[c] == STATE_SPACE
        matrices = _observer(bank, c) if observes else _difference_equations(bank, state, c)
        names += [f"{name}.{i}" for i in range(len(matrices[0]))]
        signals = [list(case.system.signals).index(signal) for signal in controller.signals]
        devices = [case.run.devices.index(device) for device in controller.devices]
        dead_time = tuple(case.system.device(device).dead_time for device in controller.devices)
        controllers.append(Discrete(*matrices, signals, devices, delays[case.used_links[c]] - min(delays), dead_time))
    used = model.C[sorted({signal for c in controllers for signal in c.signals})]
    still = rigid(model.A, used, built.state_names)
    halved = halvings(model.A, model.B, 1.0 / rate)
    if model.filtered is None:
        return DelayedLoop(model, controllers, rate, names, still, halved)
    between = halvings(model.A, model.B, 1.0 / model.filtered.rate)
    return DelayedLoop(model, controllers, rate, names, still, halved, between[0][0])


def link_delays(case: Case) -> list[float]:
    """Mean delay of each link of a run, both ways, s. Raises `InputError` if it is not the same for all channels."""
    stages = [[*link.up, *link.down] for link in case.links]
    for stage in (stage for link in stages for stage in link):
        if (stage.channels, stage.start, stage.duration) != (None, 0.0, None):
            problem = "a stage with `channels`, `start` or `duration` given"
            raise InputError(f"link: {problem}; allowed: the same delay for all")
    return [mean_delay(link) for link in stages]


def with_delay(case: Case, delay: float) -> Case:
    """The same run with a total delay (s) of its shortest link; the excess of longer links is kept."""
    lengths = link_delays(case)
    links = [Link(up=[Constant(delay=delay + length - min(lengths))]) for length in lengths]
    return replace(case, links=links)


def _difference_equations(bank: Bank, state: BankState, c: int) -> Matrices:
    """A, B, C, D of controller c, from the bank's own step with unit states and a unit signal, before limits."""
    inputs, held = bank.inputs, state.held
    base = inputs.offset[c, 0] / inputs.weight[c, 0].sum() if inputs.offset[c, 0] else 0.0
    devices = int(np.sum(bank.device[c] >= 0))
    pmus, period = held.entry_ns.shape[1], int(bank.period_ns[c])
    washed = [held.washed[c, 0]] if inputs.washout[c, 0] > 0.0 else []
    memory = [*washed, *state.internal[c, :devices]]
    sizes = np.cumsum([part.size for part in memory])
    weight = inputs.weight[c, 0]
    frame = np.zeros(pmus, DELIVERY)
    frame["pmu"], frame["measured_ns"], frame["arrival_ns"] = range(pmus), period, period
    out = np.zeros(devices, SETPOINT)

    def follow(z: NDArray[np.float64], y: float) -> NDArray[np.float64]:
        held.entry_ns[c], held.newest_ns[c], held.baseline[c] = 0, 0, 0.0
        for part, values in zip(memory, np.split(z, sizes[:-1]), strict=True):
            part[:] = values
        frame["values"] = 0.0
        frame["values"][:, inputs.channel[c, 0]] = base + y * weight / (weight @ weight)
        act(bank, state, c, 0, frame, pmus, out, 0)
        return np.concatenate([*memory, state.unlimited[c, :devices]])

    n = int(sizes[-1])
    whole = np.array([*(follow(unit, 0.0) for unit in np.eye(n)), follow(np.zeros(n), 1.0)]).T
    together = follow(np.full(n, 0.5), 0.5)
    if not np.allclose(together, whole.sum(axis=1) / 2.0, rtol=1e-9, atol=1e-12 * np.abs(whole).max()):
        problem = "a controller whose law is not linear given"
        raise InputError(f"controllers.{c}.name: {problem}; allowed: a linear one {OTHERS}")
    return whole[:n, :n], whole[:n, n:], whole[n:, :n], whole[n:, n:]


def _observer(bank: Bank, c: int) -> Matrices:
    """A, B, C, D of an observer with state feedback, including washouts, while no setpoint is limited.

    z is the estimate x(k|k); the next prediction is A x - B K x.
    """
    signals, devices = int(bank.inputs.signals[c]), int(np.sum(bank.device[c] >= 0))
    p = bank.optimal
    C, M, K = p.C[c, :signals], p.M[c, :, :signals], p.K[c, :devices]
    onward = (np.eye(len(M)) - M @ C) @ (p.A[c] - p.B[c, :, :devices] @ K)
    through, pole, pick = washouts(bank.inputs.washout[c, :signals], bank.period_ns[c] / NANOSECONDS)
    before = pole, (np.eye(len(pole)) - pole) @ pick, -through @ pick.T, through
    return _in_series(before, (onward, M, -K @ onward, -K @ M))


def sampled(loop: DelayedLoop, delay: float) -> NDArray[np.float64]:
    """The state matrix from frame to frame with a total delay (s): states of plant and controllers, setpoints, filters.

    The setpoints of each controller are u(k-1) to u(k-n-1), with n of its latest device; delays are rounded to
    nanoseconds. The memory of the PMUs' filters comes last; their latency adds to the delay.
    """
    model, period = loop.model, 1.0 / loop.frame_rate
    ways = [[divmod(to_ns(late) * loop.frame_rate, NANOSECONDS) for late in c.delays(delay)] for c in loop.controllers]
    sizes = [len(model.A), *(len(c.A) for c in loop.controllers)]
    sizes += [(max(way)[0] + 1) * len(c.devices) for c, way in zip(loop.controllers, ways, strict=True)]
    used = sorted({signal for c in loop.controllers for signal in c.signals})
    filters = None if model.filtered is None else model.filtered.of(used)
    sizes.append(0 if filters is None else filters.frames * len(used))
    plant, *others = np.split(np.eye(sum(sizes)), np.cumsum(sizes)[:-1])  # rows that select each part
    memories, sent = others[: len(loop.controllers)], others[len(loop.controllers) :]
    sent, memory = sent[:-1], sent[-1]
    C, D = model.seen
    seen = C @ plant
    for c, way, buffer in zip(loop.controllers, ways, sent, strict=True):
        seen += D[:, c.devices] @ _of_frames(buffer, [frames for frames, _ in way])
    if filters is not None:
        seen[used] = filters.taps[:, 0, None] * seen[used] + memory[: len(used)]
    frame, held = loop.halved[0]
    moved, following = frame @ plant, []
    buffers, inputs = [], []
    for c, z, buffer, way in zip(loop.controllers, memories, sent, ways, strict=True):
        y = seen[c.signals]
        setpoints = np.vstack([c.C @ z + c.D @ y, buffer])  # u(k) to u(k-n-1)
        new = _of_frames(setpoints, [frames for frames, _ in way])
        old = _of_frames(setpoints, [frames + 1 for frames, _ in way])
        for rest in sorted({rest for _, rest in way}):
            part, channels = (
                rest / NANOSECONDS * period,
                [i for i, delay_pair in enumerate(way) if delay_pair[1] == rest],
            )
            columns = [c.devices[i] for i in channels]
            after = effect(loop.halved, model.A, model.B, period, period - part)
            moved = moved + (held - after)[:, columns] @ old[channels] + after[:, columns] @ new[channels]
            inputs.append((columns, old[channels], new[channels], part))
        following.append(c.A @ z + c.B @ y)
        buffers.append(setpoints[: -len(c.devices)])
    if filters is not None:
        sampled_rows = samples(filters, model.A, model.B, loop.halved, loop.onward, plant, inputs)
        buffers.append(remember(filters, sampled_rows, memory))
    return np.vstack([moved, *following, *buffers])


def _of_frames(setpoints: NDArray[np.float64], frames: list[int]) -> NDArray[np.float64]:
    """Setpoints of all devices, each delayed by its own number of frames; `setpoints` has the newest frame first."""
    return setpoints[[n * len(frames) + i for i, n in enumerate(frames)]]


def approximate(loop: DelayedLoop, delay: float, order: int, hold: float) -> NDArray[np.float64]:
    """The state matrix in continuous time, 1/s, with a Pade approximation of each total delay and of the hold (s).

    A hold over a frame counts as half a frame of delay, a PMU filter as its latency. The states are the plant's, then
    each controller's with those of its Pade term.
    """
    model, ways = loop.model, []
    hold += 0.0 if model.filtered is None else model.filtered.delay
    for c in loop.controllers:
        terms = [pade(late + hold, order) for late in c.delays(delay)]
        A, B, C, D = (block_diag(*parts) for parts in zip(*terms, strict=True))
        ways.append(_in_series(_continuous(c, 1.0 / loop.frame_rate), (A, B, C, D)))
    A, B, C, D = (block_diag(*parts) for parts in zip(*ways, strict=True))
    used_signals = [signal for c in loop.controllers for signal in c.signals]
    sent = [device for c in loop.controllers for device in c.devices]
    b, c_, d = model.B[:, sent], model.C[used_signals], model.D[np.ix_(used_signals, sent)]
    within = np.linalg.inv(np.eye(len(sent)) - D @ d)  # algebraic loop of setpoints and signals
    seen = d @ within
    return np.block([[model.A + b @ within @ D @ c_, b @ within @ C], [B @ (c_ + seen @ D @ c_), A + B @ seen @ C]])


def _in_series(first: Matrices, second: Matrices) -> Matrices:
    A, B, C, D = first
    a, b, c, d = second
    wide = np.block([[A, np.zeros((len(A), len(a)))], [b @ C, a]])
    return wide, np.vstack([B, b @ D]), np.hstack([d @ C, c]), d @ D


def _continuous(c: Discrete, period: float) -> Matrices:
    """A controller in continuous time, by the inverse of the bilinear transform that discretised it."""
    inverse = np.linalg.inv(np.eye(len(c.A)) + c.A)
    scale = 2.0 / np.sqrt(period)
    A = 2.0 / period * inverse @ (c.A - np.eye(len(c.A)))
    B = scale * inverse @ c.B
    return A, B, scale * c.C @ inverse, c.D - c.C @ inverse @ c.B


def pade(delay: float, order: int) -> Matrices:
    """State-space form of the diagonal Pade term of exp(-s delay).

    It is sum (-1)^k c_k (s delay)^k over sum c_k (s delay)^k with c_k = (2N - k)! / (k! (N - k)!); 1 for zero delay.
    """
    if delay <= 0.0:
        return np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1))
    powers = range(order, -1, -1)
    below = [factorial(2 * order - k) / (factorial(k) * factorial(order - k)) for k in powers]
    above = [(-1) ** k * value for k, value in zip(powers, below, strict=True)]
    A, B, C, D = tf2ss(above, below)
    return A / delay, B / delay, C, D


def growth(loop: DelayedLoop, matrix: NDArray[np.float64]) -> float:
    """As `eigen(loop, matrix).growth` of a discrete loop, without eigenvectors: beside the rigid motions."""
    return float(spectrum(loop, matrix).real.max(initial=loop.frame_rate * np.log(FADED)))


def spectrum(loop: DelayedLoop, matrix: NDArray[np.float64]) -> NDArray[np.complex128]:
    """As `eigen(loop, matrix).values` of a discrete loop, without eigenvectors."""
    motions = loop.rigid.shape[1]
    turn = qr(np.pad(loop.rigid, ((0, len(matrix) - len(loop.rigid)), (0, 0))))[0][:, motions:] if motions else None
    values = eigvals(matrix if turn is None else turn.T @ matrix @ turn).astype(np.complex128)
    logs: NDArray[np.complex128] = loop.frame_rate * np.log(values[np.abs(values) > FADED])
    return logs[np.argsort(-logs.real)]


def eigen(loop: DelayedLoop, matrix: NDArray[np.float64], *, discrete: bool = True) -> Eigen:
    """Eigenvalues and eigenvectors of a closed loop without its rigid motions; s = f ln z for a discrete loop.

    Rigid motions are the eigenvectors closest to `loop.rigid`.
    """
    values, left, right = eig(matrix, left=True, right=True)
    n, plant = len(loop.names), len(loop.rigid)
    beside = right.copy()  # normalised
    beside[:plant] -= loop.rigid @ (loop.rigid.T @ right[:plant])
    flexible = np.argsort(np.linalg.norm(beside, axis=0))[loop.rigid.shape[1] :]
    if discrete:
        flexible = flexible[np.abs(values[flexible]) > FADED]
        values = np.where(np.abs(values) > FADED, values, 1.0)
        values = loop.frame_rate * np.log(values.astype(complex))
    order = flexible[np.argsort(-values[flexible].real)]
    return Eigen(values[order], right[:n, order], left[:n, order].conj())
