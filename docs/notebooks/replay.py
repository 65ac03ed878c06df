# %% [markdown]
# # Recordings and replay
#
# Every run of the ROS 2 graph is recorded in one MCAP file with everything in it: measurements, setpoints, the run
# itself, and the message definitions. This notebook records a run, reads the recording, and feeds its
# measurements to another controller.

# %%
# %matplotlib inline
import subprocess
import sys
import tempfile
from pathlib import Path

import facts_damping as fd

folder = Path(tempfile.mkdtemp())

# %% [markdown]
# ## Record
#
# The same command works in a terminal: `facts-damping run two_area_large --out results/large`. It starts a plant, a
# link, a controller and a recorder as ROS 2 nodes. In lockstep, the default, they wait for each other.

# %%
program = [sys.executable, "-m", "facts_damping"]
subprocess.run([*program, "run", "two_area_large", "--set", "duration=8", "--out", folder / "large"], check=True)

# %% [markdown]
# ## Read

# %%
recorded = fd.load_recording(folder / "large" / "recording")
recorded.plot("tie_power")

# %% [markdown]
# A lockstep recording has the same bits as the simulation in process:

# %%
simulated = fd.simulate("two_area_large", duration=8)
bool((recorded.frames.tobytes() == simulated.frames.tobytes()) and (recorded.issued == simulated.issued).all())

# %% [markdown]
# ## Replay
#
# `replay` feeds the recorded measurements to the same controller again, and compares its answers with the recorded
# ones. With `--set` another controller gets them, and the command shows what it would have commanded. That is a
# *shadow* evaluation, since its commands do not act.

# %%
asked = [*program, "replay", folder / "large" / "recording"]
print(subprocess.run(asked, check=True, capture_output=True, text=True).stdout)

# %%
other = [*asked, "--set", "controllers.0.name=LLC-tuned"]
print(subprocess.run(other, check=True, capture_output=True, text=True).stdout)

# %% [markdown]
# More about recordings, other tools that read them, and damaged files: [recordings](../recordings.md).
