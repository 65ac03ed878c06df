"""STAB2A."""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model

ROW = Model(
    "stabiliser",
    "stabiliser of electrical power (ASEA)",
    "K2 T2 K3 T3 K4 K5 T5 HLIM",
    (
        Block("W1", "washout", "-Pe", ("K2", "T2")),
        Block("W2", "washout", "W1", ("K2", "T2")),
        Block("W3", "washout", "W2", ("K2", "T2")),
        Block("low", "lag", "W3", ("K3", "T3")),
        Block("S1", "lag", "low + K4 * W3", ("K5", "T5")),
        Block("S2", "lag", "S1", ("K5", "T5")),
        Block("Vs", "sum", "S2", (), lambda f: -f.HLIM, "HLIM"),
    ),
)
