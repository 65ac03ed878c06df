# %% [markdown]
# # Supervision
#
# A controller with a wrong sign excites the oscillation that it should damp. This notebook makes that mistake on
# purpose, without and with a supervisor: a node between the controller and the devices that watches the grid, and
# takes a harmful controller off.

# %%
# %matplotlib inline
import facts_damping as fd

# %% [markdown]
# ## The fault, without a supervisor
#
# `faults` lets a controller go wrong: from 2 s on its setpoints have the wrong sign.

# %%
wrong = [{"name": "LLC", "faults": [{"kind": "wrong_sign", "start": 2}]}]
alone = fd.simulate("two_area_small", controllers=wrong)
alone.summary["verdict"]

# %% [markdown]
# ## With a supervisor
#
# `standard` is a preset of `config/supervision`. Each controller begins in *shadow*: it is heard, but does not act. At
# `arm_at` it is *armed*.

# %%
guarded = fd.simulate("two_area_small", controllers=wrong, supervision="standard", arm_at=0.5)
guarded.plot("tie_power", beside={"wrong sign, no supervisor": alone})

# %% [markdown]
# When and why it was tripped:

# %%
[(one["state"], round(one["time_s"], 2), one.get("cause")) for one in guarded.summary["supervision"][0]["changes"]]

# %% [markdown]
# Which monitors there are, and their limits: `facts-damping list monitors`. How they work, how a fallback takes over,
# and how an operator arms again: [supervision](../supervision.md). What the supervisor achieves over
# ten thousand random faults: [do no harm](../do_no_harm.md).
