"""The data of an observer with state feedback in modal form, and its exact motion over any time.

    dz/dt = Lambda z + B u,  y(t) = sum_j g_j (Re(C_s z) + D u at t + offset_j),  u = -Re(K z)

with one complex z for each pair of complex modes (that of positive imaginary part, of which C and K have twice the
value), and a real one for each real mode. With setpoints that are held,

    z(t) = exp(Lambda t) z(0) + phi(t) B u,  phi(t) = (exp(Lambda t) - 1) / Lambda,

so no step is too long (K. J. Astrom, B. Wittenmark, Computer-Controlled Systems, 3rd ed. 1997, 2.3). A setpoint acts
from its issue plus `downlink_s` of its device. PMUs with a filter weight samples before and after the instant of a
frame; without one there is the sample itself. C has the signals' part of free motion, Re(C z(t)), so setpoints that
change within a filter's window add what they do between t and each sample. All functions take several columns, for
which the same holds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from facts_damping.compiling.structs import Bool1, Complex1, Complex2, Float1, Float2, Float3

SAME_S = 1e-9  # times this close are the same: a measurement at a change of setpoints is of before
MODAL, REAL = ("poles", "B", "C", "C_s", "M", "K"), ("D", "taps", "offsets_s", "S", "downlink_s")


class ObserverLaw(NamedTuple):
    """Plant, filter and feedback; p.u."""

    poles: Complex1  # Lambda, (modes,), 1/s, imaginary parts at least 0
    B: Complex2  # (modes, devices)
    C: Complex2  # (signals, modes)
    C_s: Complex2  # (signals, modes), of a sample
    D: Float2  # (signals, devices), of a sample
    taps: Float2  # (signals, samples), g
    offsets_s: Float1  # (samples,), of the samples from the instant of a frame
    M: Complex2  # (modes, signals): z <- z + M (y - what is expected)
    K: Complex2  # (devices, modes)
    S: Float2  # (signals, signals), least covariance of the innovations, as of noise
    downlink_s: Float1  # (devices,), from the issue of a setpoint to its effect, with the dead time
    frame_rate: int  # frames/s, for which M and K are
    memory_s: float = 5.0  # time constant with which innovations are forgotten in tests of the actuators
    margin: float = np.inf  # log of the likelihood ratio from which another hypothesis counts; infinite: no tests


class Sent(NamedTuple):
    """Setpoints by time of issue."""

    issued_s: Float1  # (setpoints,), rising
    effect: Float3  # (setpoints, devices, columns), what acts at the plant

    def after(self, issued_s: float, effect: Float2) -> Sent:
        """With one more."""
        return Sent(np.append(self.issued_s, issued_s), np.concatenate([self.effect, effect[None]]))


def turned(law: ObserverLaw, start_s: float, end_s: float, z: Complex2, sent: Sent) -> Complex2:
    """The z (modes, columns) at `end_s` from that at `start_s`."""
    after = np.asarray(np.exp(law.poles * (end_s - start_s))[:, None] * z, np.complex128)
    for d, late in enumerate(law.downlink_s):
        acts = sent.issued_s + late
        first = max(0, int(np.searchsorted(acts, start_s, "right")) - 1)
        last = int(np.searchsorted(acts, end_s))
        if last > first:
            effect = held(law.poles, end_s - np.maximum(acts[first:last], start_s))
            effect[:, :-1] -= effect[:, 1:].copy()
            after += law.B[:, d, None] * (effect @ sent.effect[first:last, d])
    return after


def held(poles: Complex1, seconds: Float1) -> Complex2:
    """Function phi of each pole at each time, (modes, times)."""
    exponents = poles[:, None] * seconds
    still = np.abs(exponents) < 1e-300
    ratio = np.where(still, 1.0, np.expm1(exponents) / np.where(still, 1.0, exponents))
    return np.asarray(ratio * seconds, np.complex128)


def in_force(law: ObserverLaw, at_s: float, sent: Sent) -> Float2:
    """Setpoints that act just before a time, (devices, columns); 0 before the first."""
    acting = np.zeros(sent.effect.shape[1:])
    for d, late in enumerate(law.downlink_s):
        last = int(np.searchsorted(sent.issued_s + late, at_s - SAME_S)) - 1
        if last >= 0:
            acting[d] = sent.effect[last, d]
    return acting


def innovation(law: ObserverLaw, at_s: float, z: Complex2, sent: Sent, y: Float2) -> Float2:
    """Signals y (signals, columns) of an instant less what is expected."""
    everything = np.ones(len(law.offsets_s))
    acting = in_force(law, at_s, sent)
    expected: Float2 = (law.C @ z).real
    for d, late in enumerate(law.downlink_s):
        expected = expected + _weighted(law, d, 0.0, everything)[:, None] * acting[d]
        changes = sent.issued_s + late - at_s
        first, last = np.searchsorted(changes, [law.offsets_s.min() - SAME_S, law.offsets_s.max() - SAME_S])
        for i in range(first, last):
            change = sent.effect[i, d] - (sent.effect[i - 1, d] if i else 0.0)
            past = law.offsets_s > changes[i] + SAME_S
            counted = -1.0 * ~past if changes[i] < -SAME_S else 1.0 * past
            expected = expected + _weighted(law, d, float(changes[i]), counted)[:, None] * change
    return y - expected


def _weighted(law: ObserverLaw, d: int, since_s: float, counted: Float1) -> Float1:
    """What a step of device d's setpoint at a time from the instant adds to the samples that count, (signals,)."""
    which = counted != 0.0
    samples = (law.C_s @ (law.B[:, d, None] * held(law.poles, law.offsets_s[which] - since_s))).real
    weighted: Float1 = (law.taps[:, which] * (samples + law.D[:, d, None]) * counted[which]).sum(axis=1)
    return weighted


def corrected(law: ObserverLaw, z: Complex2, innovations: Float2, fresh: Bool1) -> Complex2:
    """The z after the innovations of the signals that are fresh."""
    after: Complex2 = z + law.M[:, fresh] @ innovations[fresh]
    return after


def feedback(
    law: ObserverLaw, at_s: float, z: Complex2, issue_s: float, sent: Sent, effect: Callable[[int, Float1], Float1]
) -> Sent:
    """The setpoints with those that are issued at a time, from z at another one, each by z at which it will act.

    `effect`: what acts at the plant, of a device's index and the setpoint that the law wants, (columns,).
    """
    new = np.zeros((len(law.K), z.shape[1]))
    after = sent.after(issue_s, new)
    for d in np.argsort(law.downlink_s, kind="stable"):
        acts_s = issue_s + float(law.downlink_s[d])
        z, at_s = turned(law, at_s, acts_s, z, after), acts_s
        after.effect[-1, d] = effect(int(d), -(law.K[d] @ z).real)
    return after


def sampled_law(law: ObserverLaw, age_s: float) -> tuple[Float2, Float2, Float2, Float2]:
    """A, B, C, D of x(k+1) = A x(k) + B y(k), u(k) = C x(k) + D y(k): the law for frames of one age, without limits.

    x: real and imaginary parts of z after the frame before (of real modes the real ones alone), then the setpoints of
    the frames before, the newest first. The setpoint of a frame is issued `age_s` after its measurement, when all of a
    filter's samples have been there.
    """
    period, (devices, modes) = 1.0 / law.frame_rate, law.K.shape
    turning = law.poles.imag > 0.0
    reach = max(period, -float(law.offsets_s.min()))
    past = int((age_s + float(law.downlink_s.max()) + reach) / period + SAME_S) + 2
    n = modes + int(turning.sum()) + past * devices
    rows = np.eye(n + len(law.C))
    z: Complex2 = rows[:modes].astype(np.complex128)
    z[turning] += 1j * rows[modes : n - past * devices]
    before = rows[n - past * devices : n].reshape(past, devices, -1)
    sent = Sent(age_s - period * np.arange(past, 0.0, -1.0), before[::-1])
    z = turned(law, -period, 0.0, z, sent)
    z = corrected(law, z, innovation(law, 0.0, z, sent, rows[n:]), np.ones(len(law.C), np.bool_))
    u = feedback(law, 0.0, z, age_s, sent, lambda _, wanted: wanted).effect[-1]
    x = np.vstack([z.real, z[turning].imag, u, before[:-1].reshape(-1, len(rows))])
    return x[:, :n], x[:, n:], u[:, :n], u[:, n:]


def to_parameters(law: ObserverLaw) -> dict[str, float | list[float]]:
    """`parameters` of a run's controller: each array row by row, complex ones as `.re` and `.im`."""
    parameters: dict[str, float | list[float]] = {}
    for name in MODAL:
        values = np.ravel(getattr(law, name))
        parameters |= {f"{name}.re": values.real.tolist(), f"{name}.im": values.imag.tolist()}
    parameters |= {name: np.ravel(getattr(law, name)).tolist() for name in REAL}
    scalars = {"frame_rate": float(law.frame_rate), "memory_s": law.memory_s, "margin": law.margin}
    return parameters | {name: value for name, value in scalars.items() if np.isfinite(value)}


def from_parameters(parameters: Mapping[str, Any], signals: int, devices: int) -> ObserverLaw:
    """The law of `to_parameters`. Raises `InputError` for missing names and other lengths."""
    modes = np.size(parameters.get("poles.re", ()))
    samples = np.size(parameters.get("offsets_s", ()))
    shapes = {"poles": (modes,), "B": (modes, devices), "C": (signals, modes), "C_s": (signals, modes)}
    shapes |= {"D": (signals, devices), "taps": (signals, samples), "offsets_s": (samples,)}
    shapes |= {"M": (modes, signals), "K": (devices, modes), "S": (signals, signals), "downlink_s": (devices,)}
    lists = [f"{name}.{part}" for name in MODAL for part in ("re", "im")] + list(REAL)
    known = [*lists, "frame_rate", "memory_s", "margin"]
    for name in {**dict.fromkeys(lists), "frame_rate": None, **parameters}:
        if name not in parameters:
            raise InputError(f"parameters.{name}: none given; allowed: those of an observer's law")
        if name not in known:
            raise InputError(f"parameters: '{name}' given; allowed: {', '.join(known)}")
        length = int(np.prod(shapes[name.partition(".")[0]])) if name in lists else 1
        if np.size(parameters[name]) != length:
            text = f"parameters.{name}: {np.size(parameters[name])} numbers given; allowed: {length}"
            raise InputError(f"{text}, for {signals} signals, {devices} devices and {modes} modes")

    arrays: dict[str, Any] = {name: np.asarray(parameters[name], np.float64) for name in lists}
    for name in MODAL:
        arrays[name] = arrays.pop(f"{name}.re") + 1j * arrays.pop(f"{name}.im")
    fields: dict[str, Any] = {name: values.reshape(shapes[name]) for name, values in arrays.items()}
    fields |= {name: float(parameters[name]) for name in ("memory_s", "margin") if name in parameters}
    return ObserverLaw(**fields, frame_rate=round(float(parameters["frame_rate"])))
