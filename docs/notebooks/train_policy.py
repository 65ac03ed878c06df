# %% [markdown]
# # Train a policy
#
# The closed loop is also a [Gymnasium](https://gymnasium.farama.org) environment. This notebook trains a small policy
# in it by random search, and compares the result with the lead-lag controller. Any library for reinforcement learning
# that takes Gymnasium environments can be used instead.

# %%
# %matplotlib inline
import gymnasium
import numpy as np

from facts_damping.environment import NAME

# %% [markdown]
# ## The environment
#
# An observation holds the newest signals that the link has delivered; an action is the setpoint of the device, as
# a fraction of its limit. The reward is minus a measure of how far the machines' speeds differ, with a small price on
# effort.

# %%
env = gymnasium.make(NAME, run="two_area_large", link="pdci", duration=8, window=8)
env.observation_space, env.action_space


# %% [markdown]
# ## A policy
#
# A linear policy: the action is a weighted sum of the signal's last eight values.


# %%
def episode(weights):
    seen, _ = env.reset(seed=1)
    total, over = 0.0, False
    while not over:
        seen, reward, terminated, truncated, _ = env.step(np.clip([weights @ seen[:, 0, 0]], -1, 1))
        total, over = total + reward, terminated or truncated
    return total


idle = episode(np.zeros(8))
idle

# %% [markdown]
# ## Random search
#
# A random step is kept when it improves the reward. Ten steps are enough to see that it learns; a useful policy takes
# a few hundred, and several seeds.

# %%
random = np.random.default_rng(0)
best, weights = idle, np.zeros(8)
for _ in range(10):
    tried = weights + random.normal(0.0, 1.0, 8)
    if (reward := episode(tried)) > best:
        best, weights = reward, tried
print(f"reward without control {idle:.3f}, with the best policy {best:.3f}")

# %% [markdown]
# [Gymnasium](../gymnasium.md) explains how a trained policy becomes a controller of a run, and a ROS 2 node.
