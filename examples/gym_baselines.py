"""Returns of three policies in the Gymnasium environment, on two grids, with 95 % intervals: a baseline for agents.

    python examples/gym_baselines.py

No control; the tuned lead-lag; and a weight for each of the last eight values of the signal, found by CMA-ES in other
episodes. All policies meet the same episodes: the grid's scenarios at other loads, over a link with jitter.
"""

import tempfile
from pathlib import Path

import gymnasium
import numpy as np
from cmaes import CMA
from scipy import signal, stats
from trained_damper import WINDOW, action

from facts_damping.environment import NAME  # with it Gymnasium knows the environment

EPISODES, GENERATIONS, EACH, SEED = 32, 12, 3, 1
FRAME_RATE, SCALE, LIMIT = 60, 0.01, 0.1  # frames/s; p.u. of the observation, and of the device
STUDY = """
run: {{system: {system}, devices: [{device}], link: pdci, duration: 12,
      controllers: [{{name: LLC, devices: [{device}], signals: [{signal}]}}]}}
seed: {seed}
sweep:
  - {{field: scenario, values: [{scenarios}]}}
  - draws:
      number: 20
      variables:
        - {{name: load_0, field: system.loads.0.P, distribution: uniform, low: {low[0]}, high: {high[0]}}}
        - {{name: load_1, field: system.loads.1.P, distribution: uniform, low: {low[1]}, high: {high[1]}}}
modes: false
"""
GRIDS = {  # loads in MW; the lead-lag of `tune two_area`, and that of the run nets_nyps_two_devices for the STATCOM
    "two_area": {
        "scenarios": "large, small, multiple",
        "device": "sssc",
        "signal": "speed",
        "loads": (967, 1767),
        "lead_lag": {"gain": 54.96, "Tw": 10.0, "T1": 0.09988, "T2": 0.01087, "T3": 0.08581, "T4": 0.01025},
    },
    "nets_nyps": {
        "scenarios": "line_60_61, line_18_49, load_step",
        "device": "statcom",
        "signal": "w_nyps_nets",
        "loads": (6000, 2470),
        "lead_lag": {"gain": -4.89, "Tw": 10.0, "T1": 0.2596, "T2": 0.2771, "T3": 0.2596, "T4": 0.2771},
    },
}


def lead_lag(gain, Tw, T1, T2, T3, T4):
    """A policy: the lead-lag at the newest value of the signal, by the bilinear rule."""
    above = np.polymul([gain / LIMIT * SCALE * Tw, 0.0], np.polymul([T1, 1.0], [T3, 1.0]))
    below = np.polymul([Tw, 1.0], np.polymul([T2, 1.0], [T4, 1.0]))
    b, a = signal.bilinear(above, below, FRAME_RATE)
    state = {}

    def policy(seen):
        y = seen[:, -1, 0, :1]
        u, state["z"] = signal.lfilter(b, a, y, axis=1, zi=state.get("z", np.zeros((len(y), len(a) - 1))))
        return np.clip(u, -1.0, 1.0)

    return policy


def returns(env, policy, seeds):
    """The return of each episode, and whether it kept synchronism."""
    seen, _ = env.reset(seed=seeds)
    total, goes, kept = np.zeros(env.num_envs), np.ones(env.num_envs, bool), np.ones(env.num_envs, bool)
    while goes.any():
        seen, reward, lost, over, _ = env.step(policy(seen))
        total += reward * goes
        kept &= ~(lost & goes)
        goes &= ~(lost | over)
    return total, kept


def trained(study, generations):
    """The weights at which CMA-ES arrives, in episodes of its own."""
    search = CMA(mean=np.zeros(WINDOW), sigma=0.2, seed=SEED)
    env = gymnasium.make_vec(NAME, search.population_size * EACH, "vector_entry_point", study=study, window=WINDOW)
    for generation in range(generations):
        candidates = np.array([search.ask() for _ in range(search.population_size)])
        weights = np.repeat(candidates, EACH, axis=0)
        seeds = [1000 * generation + i for i in range(EACH)] * len(candidates)
        total, _ = returns(env, lambda seen, weights=weights: action(weights, seen), seeds)
        scores = total.reshape(len(candidates), EACH).mean(axis=1)
        search.tell([(one, -score) for one, score in zip(candidates, scores, strict=True)])
    env.close()
    return search.mean


def baseline(grid, folder, generations=GENERATIONS, episodes=EPISODES):
    """A row of the table for each policy on a grid: returns, and how many episodes kept synchronism."""
    of, studies = GRIDS[grid], {}
    for seed, what in enumerate(("training", "test")):
        path = folder / f"{grid}_{what}.yaml"
        low, high = ([side * load for load in of["loads"]] for side in (0.95, 1.05))
        words = {
            "system": grid,
            "scenarios": of["scenarios"],
            "signal": of["signal"],
            "device": of["device"],
            "low": low,
            "high": high,
        }
        path.write_text(STUDY.format(seed=seed, **words), encoding="utf-8")
        studies[what] = str(path)
    weights = trained(studies["training"], generations)
    policies = {
        "no control": lambda seen: np.zeros((len(seen), 1)),
        "tuned lead-lag": lead_lag(**of["lead_lag"]),
        f"{WINDOW} weights, CMA-ES": lambda seen: action(weights, seen),
    }
    env = gymnasium.make_vec(NAME, episodes, "vector_entry_point", study=studies["test"], window=WINDOW)
    rows = {title: returns(env, policy, [10_000 + i for i in range(episodes)]) for title, policy in policies.items()}
    env.close()
    return rows


def main():
    """Print the table; after ±, half the 95 % interval of the mean."""
    print("| grid | policy | mean return | more than without control | in synchronism |")
    with tempfile.TemporaryDirectory() as folder:
        for grid in GRIDS:
            rows = baseline(grid, Path(folder))
            without, _ = rows["no control"]
            for title, (total, kept) in rows.items():
                more = total - without  # in the same episodes
                half = stats.t.ppf(0.975, len(more) - 1) * stats.sem(more)
                cells = f"{total.mean():.3f} | {more.mean():.3f} ± {half:.3f} | {kept.sum()} of {len(kept)}"
                print(f"| {grid} | {title} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
