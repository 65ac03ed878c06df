"""Distributions of tftb, the Python port of the Time-Frequency Toolbox: writes tftb.npz beside this.

In an environment of its own, for tftb is older than NumPy 2, from the root of the repository:

    pip install tftb==0.2.0 "numpy<2"
    python tests/data/make_tftb.py

Of the signal z: `wvd`, `pwvd` (window h) and `spwvd` (windows h over lag, g over time), each (frequencies, samples),
with as many frequencies as samples, from 0 to half a cycle a sample.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from tftb.processing.cohen import (
    PseudoWignerVilleDistribution,
    WignerVilleDistribution,
    smoothed_pseudo_wigner_ville,
)

SAMPLES = 32


def main() -> None:
    """Two chirps and noise."""
    n = np.arange(SAMPLES)
    noise = np.random.default_rng(1).standard_normal((2, SAMPLES))
    z = np.exp(2j * np.pi * (0.05 + 0.003 * n) * n) + 0.5 * np.exp(2j * np.pi * (0.35 - 0.002 * n) * n)
    z += 0.1 * (noise[0] + 1j * noise[1])
    h, g = np.hamming(13), np.hamming(5)
    np.savez_compressed(
        Path(__file__).with_name("tftb.npz"),
        z=z,
        h=h,
        g=g,
        wvd=WignerVilleDistribution(z).run()[0],
        pwvd=PseudoWignerVilleDistribution(z, fwindow=h).run()[0],
        spwvd=smoothed_pseudo_wigner_ville(z, freq_bins=SAMPLES, twindow=g, fwindow=h),
    )


if __name__ == "__main__":
    main()
