"""The core's public face for scripts and notebooks: `import facts_damping as fd`.

What is exported here stays; all else is private. Errors are those of the commands, one line; nothing is printed.
"""

from facts_damping.api.results import Result, load_recording, simulate, summarise
from facts_damping.api.stepping import Simulation
from facts_damping.api.systems import linear_plant, modes
from facts_damping.errors import FactsDampingError, InputError, RecordingError, RunError
from facts_damping.simulation.programs.spec import Spec

__all__ = [
    "FactsDampingError",
    "InputError",
    "RecordingError",
    "Result",
    "RunError",
    "Simulation",
    "Spec",
    "linear_plant",
    "load_recording",
    "modes",
    "simulate",
    "summarise",
]
