"""Train a small policy in the Gymnasium environment by CMA-ES: a weight for each of the window's signals.

    python examples/train_damper.py damper.npz
    facts-damping simulate examples/trained_damper.yaml
    facts-damping run examples/trained_damper.yaml

Episodes are drawn from the training cases of two_area behind the Pacific DC Intertie's link, all episodes of a
generation from the same draws. docs/own_controllers.md says what came out.
"""

import sys

import gymnasium
import numpy as np
from cmaes import CMA
from trained_damper import WINDOW, action

from facts_damping.environment import NAME  # with it Gymnasium knows the environment

SETTING = {"study": "ensemble_two_area_training", "link": "pdci", "window": WINDOW, "duration": 12}
GENERATIONS, SEED = 40, 1


def scores(env, candidates, seed):
    """Mean return of each candidate, (candidates,), over as many episodes as there are environments for each."""
    each = env.num_envs // len(candidates)
    weights = np.repeat(candidates, each, axis=0)
    seeds = [seed + i for i in range(each)] * len(candidates)
    seen, _ = env.reset(seed=seeds)
    returns, goes = np.zeros(env.num_envs), np.ones(env.num_envs, bool)
    while goes.any():
        seen, reward, lost, over, _ = env.step(action(weights, seen))
        returns += reward * goes
        goes &= ~(lost | over)
    return returns.reshape(len(candidates), each).mean(axis=1)


def train(generations=GENERATIONS, seed=SEED, episodes=4):
    """The weights that CMA-ES arrives at, and the mean return of each generation's best."""
    search = CMA(mean=np.zeros(WINDOW), sigma=0.2, seed=seed)
    env = gymnasium.make_vec(NAME, search.population_size * episodes, "vector_entry_point", **SETTING)
    told = []
    for generation in range(generations):
        candidates = [search.ask() for _ in range(search.population_size)]
        found = scores(env, np.array(candidates), seed + 1000 * generation)
        search.tell([(one, -score) for one, score in zip(candidates, found, strict=True)])
        told.append(found.max())
        print(f"generation {generation + 1}: best {found.max():.3f}, mean {found.mean():.3f}", flush=True)
    env.close()
    return search.mean, told


def main(target, generations=GENERATIONS):
    """Train, and write the weights."""
    weights, _ = train(int(generations))
    np.savez(target, weights=weights)
    print(f"{target}: {np.array2string(weights, precision=3)}")


if __name__ == "__main__":
    main(*sys.argv[1:])
