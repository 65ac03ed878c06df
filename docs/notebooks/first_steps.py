# %% [markdown]
# # First steps
#
# This notebook simulates a power system that oscillates, lets a wide-area controller damp it, and delays the
# controller's signals. It needs nothing but the installed package, and takes a few seconds.
#
# The grid is Kundur's: two areas with two machines each, and two long lines between them, the tie. After a fault the
# areas swing against each other at 0.6 Hz, the *interarea mode*. An SSSC, a voltage source in series with the tie,
# can damp this mode if its controller knows how the machines' speeds differ. Phasor measurement units (PMUs) send the
# measurements over a network.

# %%
# %matplotlib inline
import facts_damping as fd

# %% [markdown]
# ## Without control
#
# `two_area_deployment` is a run file that is shipped: PMUs with noise, a link with delay and jitter, governors. A line
# of the tie is short-circuited at 2 s and trips 0.1 s later. With an empty list of controllers there is no control.

# %%
without = fd.simulate("two_area_deployment", controllers=[], supervision="off")
without

# %% [markdown]
# `ITAE`, `IAE`, `ITSE` and `ISE` measure how far the machines' speeds differ: smaller is better.

# %% [markdown]
# ## With a lead-lag controller
#
# The run file has `LLC-tuned`, a lead-lag controller (LLC) with tuned parameters. It gets a weighted
# difference of the frequencies that PMUs report (2 G1 - G2 - G4), and commands the voltage that the SSSC injects.

# %%
damped = fd.simulate("two_area_deployment")
damped.plot("tie_power", beside={"no control": without})

# %%
{name: f"{damped.indices[name] / without.indices[name] - 1:+.0%}" for name in damped.indices}

# %% [markdown]
# ## With more delay
#
# Any field of the run can be changed, here the whole link: 0.3 s on the way to the controller, none on the way back.

# %%
link = [{"stage": "network", "model": "constant", "delay": 0.3}]
late = fd.simulate("two_area_deployment", link={"up": link, "down": []})
late.plot("tie_power", beside={"LLC-tuned, link pdci": damped, "no control": without})

# %% [markdown]
# All signals are arrays with names and units:

# %%
late.time_s.shape, late.arrays["pmu.G1.frequency_hz"][:3], late.units["pmu.G1.frequency_hz"]

# %% [markdown]
# Next: [how much delay a controller tolerates](../tutorial_trace.md), or
# [a controller of your own](../tutorial_controller.md).
