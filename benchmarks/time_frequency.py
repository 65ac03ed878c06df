"""Time-frequency distributions: 20 s beside tftb, and an hour.

    python -m venv tftb && tftb/bin/pip install tftb==0.2.0 "numpy<2"
    python benchmarks/time_frequency.py [--tftb tftb/bin/python]

20 s at 60 samples/s of two decaying modes, the same windows, times and frequencies for both, by turns in one run; tftb
0.2.0 needs NumPy below 2, so it runs in an environment of its own. Its smoothed distribution is off by a lag
(docs/modes.md), which changes nothing of its cost. Then what `analyze --spwvd` computes and draws of 20 s and
of an hour, and the memory of the process at its most, each in a process of its own.
"""

from __future__ import annotations

import argparse
import multiprocessing
import resource
import statistics
import subprocess
import time
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from scipy.signal.windows import hamming

from facts_damping_views.analysis.time_frequency import analyse, analytic, spwvd
from facts_damping_views.analysis.time_frequency_plots import plot_distribution

if TYPE_CHECKING:
    from numpy.typing import NDArray

RATE, SECONDS, BINS = 60.0, 20, 1200
LAGS, TIMES = 301, 121  # samples: what tftb takes by default of 1200
RUNS = 5
KINDS = {"WVD": (None, None), "pseudo-WVD": (LAGS, None), "SPWVD": (LAGS, TIMES)}
TFTB = """
import sys, time, numpy
from scipy.signal.windows import hamming
from tftb.processing.cohen import PseudoWignerVilleDistribution, WignerVilleDistribution, smoothed_pseudo_wigner_ville
z = numpy.frombuffer(sys.stdin.buffer.read(), complex)
h, g = (hamming(int(length)) for length in sys.argv[1:3])
for run in (
    lambda: WignerVilleDistribution(z).run(),
    lambda: PseudoWignerVilleDistribution(z, fwindow=h).run(),
    lambda: smoothed_pseudo_wigner_ville(z, freq_bins=len(z), twindow=g, fwindow=h),
):
    began = time.perf_counter()
    run()
    print(time.perf_counter() - began)
"""


def swings(seconds: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Time (s) and a signal (p.u.): an interarea and a local mode, disturbed every 60 s, and noise."""
    t = np.arange(round(seconds * RATE)) / RATE
    since = t % 60.0
    x = np.exp(-0.1 * since) * np.cos(2 * np.pi * 0.63 * t) + 0.5 * np.exp(-0.3 * since) * np.cos(2 * np.pi * 1.15 * t)
    return t, 1e-3 * x + 1e-5 * np.random.default_rng(1).standard_normal(len(t))


def ours(z: NDArray[np.complex128]) -> list[float]:
    """Times of the three distributions, s."""
    took = []
    for lags, times in KINDS.values():
        h, g = (None if length is None else hamming(length) for length in (lags, times))
        began = time.perf_counter()
        spwvd(z, RATE, h, g, bins=BINS)
        took.append(time.perf_counter() - began)
    return took


def theirs(python: str, z: NDArray[np.complex128]) -> list[float]:
    """The same of tftb."""
    command = [python, "-c", TFTB, str(LAGS), str(TIMES)]
    done = subprocess.run(command, input=z.tobytes(), capture_output=True, check=True)
    return [float(line) for line in done.stdout.split()]


def beside(python: str | None) -> None:
    """A row a kind of distribution."""
    z = analytic(swings(SECONDS)[1])
    ours(z)
    rows, peer = [], []
    for _ in range(RUNS):
        rows.append(ours(z))
        if python is not None:
            peer.append(theirs(python, z))
    print(f"{SECONDS} s at {RATE:g} samples/s, {len(z)} times and {BINS} frequencies, median of {RUNS} runs")
    print(f"{'':<12} {'ours ms':>10} {'tftb ms':>10} {'factor':>8}")
    for i, kind in enumerate(KINDS):
        took = statistics.median(row[i] for row in rows)
        other = statistics.median(row[i] for row in peer) if peer else np.nan
        print(f"{kind:<12} {1e3 * took:10.1f} {1e3 * other:10.1f} {other / took:8.0f}")


def whole(seconds: float) -> None:
    """Print a row: what the command computes and draws."""
    t, x = swings(seconds)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    began = time.perf_counter()
    analysis = analyse(t, x)
    analysed = time.perf_counter()
    figure = Figure(figsize=(10, 7.5), layout="constrained")
    plot_distribution(figure, analysis, "p.u.")
    figure.savefig("/dev/null", format="png", dpi=150)
    drawn = time.perf_counter()
    maximum = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    shape = " x ".join(map(str, analysis.distribution.values.shape))
    print(
        f"{len(t):8d} {shape:>12} {analysed - began:10.2f} {drawn - analysed:8.2f} "
        f"{before / 1024:12.0f} {maximum / 1024:10.0f}"
    )


def main() -> None:
    """All tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tftb", metavar="PYTHON", help="an interpreter that has tftb")
    beside(parser.parse_args().tftb)
    print(
        f"\n{'samples':>8} {'values':>12} {'analyse s':>10} {'draw s':>8} {'MB before':>12} {'MB at maximum':>10}",
        flush=True,
    )
    for seconds in (SECONDS, 3600):
        process = multiprocessing.get_context("spawn").Process(target=whole, args=(seconds,))
        process.start()
        process.join()


if __name__ == "__main__":
    main()
