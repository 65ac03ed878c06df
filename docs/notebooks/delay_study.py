# %% [markdown]
# # A delay study
#
# How much delay does a controller tolerate? This notebook sweeps the delay of the network for two controllers, first
# as a table, then as a search for the *delay margin*: the smallest delay at which the oscillation is no longer damped.

# %%
# %matplotlib inline
import facts_damping as fd

# %% [markdown]
# ## A sweep
#
# A study is a base run and axes. Every value of one axis is combined with every value of the others, and the runs are
# made in parallel. The field paths are those of a run file: `link.up.0.delay` is the delay of the first stage of the
# link from the PMUs to the controller.

# %%
study = {
    "run": {"system": "two_area", "scenario": "small", "link": {"up": [{"delay": 0}], "down": [{"delay": 0}]}},
    "sweep": [
        {"name": "controller_name", "field": "controllers.0.name", "values": ["LLC", "LLC-tuned"]},
        {"name": "delay_s", "field": "link.up.0.delay", "values": [0, 0.05, 0.1, 0.15, 0.2]},
    ],
}
table = fd.sweep(study).to_pandas()
table.pivot_table(index="delay_s", columns="controller_name", values="ITAE")

# %% [markdown]
# `verdict` is the outcome of each run:

# %%
table.pivot(index="delay_s", columns="controller_name", values="verdict")

# %% [markdown]
# ## A margin
#
# With `margin` the study searches the delay itself: a coarse grid, then bisection. Half of the delay is on the way up,
# half on the way down.

# %%
study["sweep"] = study["sweep"][:1]
study["margin"] = {
    "name": "delay_s",
    "fields": {"link.up.0.delay": 0.5, "link.down.0.delay": 0.5},
    "low": 0,
    "high": 0.4,
    "coarse": 9,
    "tolerance": 0.005,
    "criteria": ["not_damped"],
}
found = fd.sweep(study)
found.margins_to_pandas()[["controller_name", "margin_s", "low_s", "high_s"]]

# %% [markdown]
# Results with all controllers, several links and scenarios are in [delay studies](../delay_studies.md); how to write a
# study file is in [studies](../studies.md). For a linear controller `facts-damping margin` computes the margin
# without simulating: [delay](../delay.md).
