# %% [markdown]
# # Supervision
#
# A controller with a wrong sign excites the oscillation that it should damp. This notebook makes that mistake on
# purpose, without and with a supervisor: a node between the controller and the devices that watches the grid, and
# trips a harmful controller.

# %%
# %matplotlib inline
import facts_damping as fd

# %% [markdown]
# ## The fault, without a supervisor
#
# `faults` makes a controller fail: from 2 s on its setpoints have the wrong sign.

# %%
wrong = [{"name": "LLC", "faults": [{"kind": "wrong_sign", "start": 2}]}]
alone = fd.simulate("two_area_small", controllers=wrong)
alone.summary["verdict"]

# %% [markdown]
# ## With a supervisor
#
# `standard` is a preset of `config/supervision`. Each controller begins in *shadow*: it computes, but its setpoints
# do not act. At `arm_at` it is *armed*.

# %%
guarded = fd.simulate("two_area_small", controllers=wrong, supervision="standard", arm_at=0.5)
guarded.plot("tie_power", beside={"wrong sign, no supervisor": alone})

# %% [markdown]
# When and why it was tripped:

# %%
[(one["state"], round(one["time_s"], 2), one.get("cause")) for one in guarded.summary["supervision"][0]["changes"]]

# %% [markdown]
# `facts-damping list monitors` shows all monitors with their limits. [Supervision](../supervision.md) explains how they
# work, how a fallback takes over, and how an operator arms again. [Do no harm](../do_no_harm.md) shows what the
# supervisor achieves over ten thousand random cases.
