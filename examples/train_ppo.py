"""Train a policy in the Gymnasium environment by Stable-Baselines3's PPO, and run it as a controller.

    pip install stable-baselines3
    python examples/train_ppo.py ppo_damper.zip
    facts-damping simulate examples/trained_damper.yaml --set 'controllers.0.policy=examples/train_ppo.py:PpoDamper' \
        --set controllers.0.parameters.weights=ppo_damper.zip

The same training cases as of train_damper.py; docs/own_controllers.md says what came out.
"""

import sys

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecNormalize
from train_damper import SETTING
from trained_damper import WINDOW

from facts_damping.environment import NAME, Window  # with NAME Gymnasium knows the environment


class PpoDamper:
    """The policy of a file, `parameters: {weights: ppo_damper.zip}`."""

    once_a_tick = True  # as the environment

    def __init__(self, spec):
        self.model = PPO.load(spec.parameters["weights"], device="cpu")
        self.window, self.limits = Window(spec, WINDOW), spec.limits

    def reset(self):
        self.window.reset()

    def step(self, t_s, y, age_s, fresh):
        action, _ = self.model.predict(self.window.push(t_s, y, age_s, fresh), deterministic=True)
        return np.clip(action.astype(float), -1.0, 1.0) * self.limits


def main(target, steps=1_500_000):
    """Train, and write the policy; say what it reaches before and after."""
    env = VecNormalize(make_vec_env(NAME, n_envs=8, seed=1, env_kwargs=SETTING), norm_obs=False)
    # At 60 actions a second white noise explores next to nothing: a swing takes 90 of them. So it is held for 45.
    smooth = {"use_sde": True, "sde_sample_freq": 45, "policy_kwargs": {"log_std_init": -2.0}}
    model = PPO("MlpPolicy", env, seed=1, n_steps=720, batch_size=720, gamma=0.995, device="cpu", **smooth)
    judged = make_vec_env(NAME, n_envs=4, seed=1_000_000, env_kwargs=SETTING)
    print(f"before: mean return {evaluate_policy(model, judged, 20)[0]:.2f}")
    model.learn(int(steps))
    print(f"after {steps} steps: mean return {evaluate_policy(model, judged, 20)[0]:.2f}")
    model.save(target)


if __name__ == "__main__":
    main(*sys.argv[1:])
