"""A controller that predicts by the measured age of its frames, and tests whether its actuators do as they are told.

    policy: facts_damping_studies.laws.age_observer:AgeObserver
    parameters: {...}                        # `observer_law.to_parameters`

At a call it moves its estimate to the time of the measurement, with the setpoints that acted meanwhile, corrects it by
the signals that are new, and predicts it to the time at which each setpoint will act. Signals of different ages count
at their own times: an older one is put between those before, which are then corrected again. The estimate restarts
after a gap of RESTART_S.

With signs h of the actuators (`actuator_tests`) the estimate is z = z_0 + sum_d h_d z_d, with z_0 from the signals and
z_d from the setpoints of device d alone, through the same observer. An inverted device gets the negated setpoint, one
without effect that of one with effect, which does no harm and shows when the effect is back.
"""

from __future__ import annotations

from bisect import bisect_left
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.errors import InputError
from facts_damping_studies.laws.actuator_tests import Evidence, decided, with_innovations, without_evidence
from facts_damping_studies.laws.observer_law import (
    SAME_S,
    Sent,
    corrected,
    feedback,
    from_parameters,
    innovation,
    turned,
)

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Bool1, Complex2, Float1
    from facts_damping.simulation.programs.spec import Spec

RESTART_S = 10.0  # without frames
REACH_S = 1.0  # signals that are older than the newest by more do not count
MOST_DEVICES = 5  # as all hypotheses are compared


class Estimate(NamedTuple):
    """What is known after a frame."""

    measured_s: float
    y: Float1  # (signals,)
    fresh: Bool1  # (signals,): which of them are of this time
    z: Complex2  # (modes, 1 + devices): z_0 and each z_d
    evidence: Evidence


class AgeObserver:
    """The controller, for `facts-damping simulate`, `run`, `score` and `replay`."""

    def __init__(self, spec: Spec) -> None:
        """Read the law. Raises `InputError` if it does not fit."""
        self.law = from_parameters(spec.parameters, len(spec.signals), len(spec.devices))
        if self.law.frame_rate != spec.frame_rate:
            raise InputError(f"frame_rate: {spec.frame_rate} given; allowed: {self.law.frame_rate}, that of the law")
        if len(spec.devices) > MOST_DEVICES:
            raise InputError(f"devices: {len(spec.devices)} given; allowed: at most {MOST_DEVICES}")
        self.limits, self.rates = spec.limits, spec.rates
        self.reset()

    def reset(self) -> None:
        """At rest, with actuators that do as they are told."""
        self.estimates: list[Estimate] = []
        self.sent = Sent(np.zeros(0), np.zeros((0, len(self.limits), 1)))

    @property
    def signs(self) -> Float1:
        """What counts of each device: +1 as sent, 0 without effect, -1 inverted."""
        return self.estimates[-1].evidence.signs if self.estimates else np.ones(len(self.limits))

    def step(self, t_s: float, y: Float1, age_s: Float1, fresh: Bool1) -> Float1:
        """Setpoints, p.u."""
        measured = t_s - age_s
        if self.estimates and measured.max() - self.estimates[-1].measured_s > RESTART_S:
            self.estimates.clear()
        times = np.sort(measured[fresh])
        for at_s in times[np.diff(times, prepend=-np.inf) > SAME_S]:
            self._insert(float(at_s), y, fresh & (np.abs(measured - at_s) < SAME_S))
        if not self.estimates:  # nothing is new
            return np.zeros(len(self.limits))
        newest = self.estimates[-1]
        if np.isfinite(self.law.margin):
            newest = newest._replace(evidence=decided(newest.evidence, self.law.margin))
            self.estimates[-1] = newest
        setpoints = self._issue(t_s, newest)
        self._forget(newest.measured_s)
        return setpoints

    def _insert(self, at_s: float, y: Float1, fresh: Bool1) -> None:
        """Count signals at the time of their measurement, and all that are newer again."""
        i = bisect_left(self.estimates, at_s - SAME_S, key=lambda estimate: estimate.measured_s)
        if i < len(self.estimates) and self.estimates[i].measured_s < at_s + SAME_S:
            there = self.estimates[i]
            y, fresh = np.where(fresh, y, there.y), fresh | there.fresh
            self.estimates[i] = there._replace(y=y, fresh=fresh)
        elif i == 0 and self.estimates:  # too old
            return
        else:
            first = np.zeros((len(self.law.poles), 1 + len(self.limits)), np.complex128)
            self.estimates.insert(i, Estimate(at_s, y, fresh, first, without_evidence(len(self.limits))))
        for j in range(i, len(self.estimates)):
            self.estimates[j] = self._following(self.estimates[j - 1] if j else None, self.estimates[j])

    def _following(self, before: Estimate | None, frame: Estimate) -> Estimate:
        """The estimate after a frame, from that of the frame before; of the first one at rest."""
        law, devices = self.law, len(self.limits)
        apart = np.hstack([np.zeros((devices, 1)), np.eye(devices)])
        sent = self.sent._replace(effect=self.sent.effect * apart)
        z, evidence, since = np.zeros_like(frame.z), without_evidence(devices), 0.0
        if before is not None:
            z = turned(law, before.measured_s, frame.measured_s, before.z, sent)
            evidence, since = before.evidence, frame.measured_s - before.measured_s
        seen = np.hstack([frame.y[:, None], np.zeros((len(frame.y), devices))])
        innovations = innovation(law, frame.measured_s, z, sent, seen)
        if np.isfinite(law.margin):
            forgetting = np.exp(-since / law.memory_s)
            evidence = with_innovations(evidence, innovations, law.S, frame.fresh, forgetting)
        return frame._replace(z=corrected(law, z, innovations, frame.fresh), evidence=evidence)

    def _issue(self, t_s: float, newest: Estimate) -> Float1:
        """Setpoints within limits and rates, which join those before."""
        signs, sent_signs = newest.evidence.signs, newest.evidence.sent
        setpoints = np.zeros(len(self.limits))
        reach = self.limits
        before = np.zeros_like(reach)
        if len(self.sent.issued_s):
            before, reach = self.sent.effect[-1, :, 0], self.rates * (t_s - float(self.sent.issued_s[-1]))

        def effect(d: int, wanted: Float1) -> Float1:
            u = float(wanted[0]) * sent_signs[d]
            u = min(max(u, -self.limits[d]), self.limits[d])
            setpoints[d] = min(max(u, before[d] - reach[d]), before[d] + reach[d])
            return np.array([signs[d] * setpoints[d]])

        z = newest.z @ np.append(1.0, signs)[:, None]
        sent = self.sent._replace(effect=self.sent.effect * signs[:, None])
        feedback(self.law, newest.measured_s, z, t_s, sent, effect)
        self.sent = self.sent.after(t_s, setpoints[:, None])
        return setpoints

    def _forget(self, newest_s: float) -> None:
        """Forget frames that no signal can precede, and setpoints that others have followed by then."""
        while len(self.estimates) > 1 and self.estimates[1].measured_s < newest_s - REACH_S:
            del self.estimates[0]
        oldest_s = self.estimates[0].measured_s + min(0.0, float(self.law.offsets_s.min()))
        acted = self.sent.issued_s + float(self.law.downlink_s.max()) < oldest_s - SAME_S
        first = max(0, int(acted.sum()) - 1)
        self.sent = Sent(self.sent.issued_s[first:], self.sent.effect[first:])
