"""The lead-lag controller LLC as a class of one's own, with the setpoints of the shipped one, bit for bit.

facts-damping simulate examples/lead_lag.yaml
facts-damping run examples/lead_lag.yaml
"""

DEFAULTS = {"gain": 10.0, "Tw": 10.0, "T1": 0.0761, "T2": 0.3, "T3": 0.4272, "T4": 0.3}


class LeadLag:
    """kG s Tw / (1 + s Tw) (1 + s T1) / (1 + s T2) (1 + s T3) / (1 + s T4), by the bilinear transform."""

    def __init__(self, spec):
        self.measured_ns = None
        p = DEFAULTS | spec.parameters
        self.sections = (
            (p["gain"] * p["Tw"], 0.0, p["Tw"]),
            (p["T1"], 1.0, p["T2"]),
            (p["T3"], 1.0, p["T4"]),
        )

    def reset(self):
        """Begin at rest, as every run does."""
        self.measured_ns = None

    def step(self, t_s, y, age_s, fresh):
        """Setpoint, p.u., for the newest signal: from the time between two measurements, not between two arrivals."""
        u, measured_ns = float(y[0]), round((t_s - age_s[0]) * 1e9)
        before, self.measured_ns = self.measured_ns, measured_ns
        if before is None:
            self.memory = [[u, 0.0], [0.0, 0.0], [0.0, 0.0]]  # the washout begins with the first signal
            return 0.0
        c = 2.0 / ((measured_ns - before) * 1e-9)
        for (n1, n0, d1), kept in zip(self.sections, self.memory, strict=True):
            out = ((n0 + n1 * c) * u + (n0 - n1 * c) * kept[0] - (1.0 - d1 * c) * kept[1]) / (1.0 + d1 * c)
            kept[:] = u, out
            u = out
        return u
