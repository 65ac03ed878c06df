"""What turbines and engines have in common."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.machine_controls.blocks import Block

if TYPE_CHECKING:
    from collections.abc import Callable


def steam_turbine(inlet: str) -> tuple[Block, ...]:
    """IEEE type 1: four lags in series from a valve; power of each, of both shafts together if there are two."""
    return (
        Block("P4", "lag", inlet, (1.0, "T4")),
        Block("P5", "lag", "P4", (1.0, "T5")),
        Block("P6", "lag", "P5", (1.0, "T6")),
        Block("P7", "lag", "P6", (1.0, "T7")),
        Block("Pm", "sum", "K12 * P4 + K34 * P5 + K56 * P6 + K78 * P7"),
    )


# The second shaft is that of a machine at JBUS; without one its power is none.
STEAM_FACTORS: dict[str, Callable[[Any], float]] = {
    "K12": lambda f: f.K1 + f.K2 * (f.JBUS != 0.0),
    "K34": lambda f: f.K3 + f.K4 * (f.JBUS != 0.0),
    "K56": lambda f: f.K5 + f.K6 * (f.JBUS != 0.0),
    "K78": lambda f: f.K7 + f.K8 * (f.JBUS != 0.0),
}
ONE_SHAFT: dict[str, Callable[[Any], bool]] = {
    "all its power acts on this machine, none on that at JBUS": lambda f: bool(f.JBUS and f.K2 + f.K4 + f.K6 + f.K8),
}

# Power of a gate at rest, on the line through (G0, 0), (G1, P1), (G2, P2), (1, P3), which goes on straight.
GATE = Block("steady", "curve", "gate", ("G0", 0.0, "G1", "P1", "G2", "P2", 1.0, "P3"))


def diesel_engine(error: str) -> tuple[Block, ...]:
    """Woodward's electric control box and actuator, from the error of speed; torque a dead time TD after the throttle.

    (1 + s T3) / (1 + s T1 + s^2 T1 T2), then K (1 + s T4) / (s (1 + s T5) (1 + s T6)) within TMIN and TMAX.
    """
    return (
        Block("box", "second_order", error, ("T3", 0.0, "T1", lambda f: f.T1 * f.T2)),
        Block("actuator", "second_order", "box", ("T4", 0.0, lambda f: f.T5 + f.T6, lambda f: f.T5 * f.T6)),
        Block("throttle", "integral", "actuator", ("K",), "TMIN", "TMAX"),
        Block("torque", "dead_time", "throttle", ("TD",)),
        Block("speed", "sum", "one + omega"),
        Block("Pm", "product", "torque + speed"),
    )
