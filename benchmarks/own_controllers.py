"""What a controller of one's own costs beside the shipped one, and steps a second of the Gymnasium environment."""

from __future__ import annotations

import statistics
import tempfile
import time
from pathlib import Path

import gymnasium
import numpy as np

from facts_damping.case.loading import load_case
from facts_damping.environment import NAME
from facts_damping.simulation import loop

ROUNDS, EPISODES, STEPS = 7, 64, 600
EXAMPLE = Path(__file__).parents[1] / "examples" / "lead_lag.py"
GAIN = "class Gain:\n    def __init__(self, spec): pass\n    def step(self, t_s, y, age_s, fresh): return 10.0 * y\n"


def loops() -> dict[str, list[float]]:
    """Time of 20 s of `two_area_large` over `pdci`, compiled loop without set-up, s: by controller, in turns."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "gain.py").write_text(GAIN)
        policies = {"a class, one gain": f"{folder}/gain.py:Gain", "a class, lead-lag": f"{EXAMPLE}:LeadLag"}
        cases = {"LLC, compiled": load_case("two_area_large", ["link=pdci"])}
        for name, policy in policies.items():
            cases[name] = load_case("two_area_large", ["link=pdci", f"controllers=[{{name: own, policy: '{policy}'}}]"])
        took: dict[str, list[float]] = {name: [] for name in cases}
        for _ in range(ROUNDS + 1):
            for name, case in cases.items():
                built = loop.build_loop(case)
                began = time.perf_counter()
                loop.run_loop(built)
                took[name].append(time.perf_counter() - began)
    return {name: values[1:] for name, values in took.items()}


def single() -> float:
    """Steps a second of one environment, resets counted."""
    env, rates = gymnasium.make(NAME, link="pdci").unwrapped, []
    action = np.zeros(1, np.float32)
    for seed in range(ROUNDS + 1):
        began, steps, goes = time.perf_counter(), 0, True
        env.reset(seed=seed)
        while goes:
            _, _, lost, over, _ = env.step(action)
            steps, goes = steps + 1, not (lost or over)
        rates.append(steps / (time.perf_counter() - began))
    return statistics.median(rates[1:])


def vector(threads: int) -> float:
    """Steps a second of all environments together."""
    env = gymnasium.make_vec(NAME, EPISODES, "vector_entry_point", link="pdci", threads=threads)
    actions = np.zeros((EPISODES, 1), np.float32)
    rates = []
    for seed in range(3):
        env.reset(seed=seed)
        env.step(actions)  # compiled by then
        began = time.perf_counter()
        for _ in range(STEPS):
            env.step(actions)
        rates.append(STEPS * EPISODES / (time.perf_counter() - began))
    env.close()
    return statistics.median(rates)


def main() -> None:
    """Print what was measured."""
    durations = loops()
    base = statistics.median(durations["LLC, compiled"])
    print("20 s of two_area_large over pdci, compiled loop:")
    for name, values in durations.items():
        print(
            f"  {name:20} {1000 * statistics.median(values):6.1f} ms, {statistics.median(values) / base:.2f} of LLC's"
        )
    print(f"Gymnasium, one environment: {single():.0f} steps/s")
    for threads in (1, 2):
        print(f"Gymnasium, {EPISODES} at once, {threads} threads: {vector(threads):.0f} steps/s")


if __name__ == "__main__":
    main()
