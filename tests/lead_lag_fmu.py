"""The lead-lag of the example as FMUs, of FMI 2 by pythonfmu and of FMI 3 by pythonfmu3."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

SLAVE = """
import sys
sys.path.insert(0, {examples!r})
from types import SimpleNamespace
from lead_lag import LeadLag
from {package} import {Slave}, {Causality}, {Variability}, {Real}

class {name}({Slave}):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.{signal}, self.{device}, self.gain, self.t, self.time = 0.0, 0.0, 10.0, 0.0, 0.0
        {more}
        self.register_variable({Real}("{signal}", causality={Causality}.input))
        self.register_variable({Real}("{device}", causality={Causality}.output))
        self.register_variable({Real}("gain", causality={Causality}.parameter, variability={Variability}.tunable))

    def exit_initialization_mode(self):
        self.law = LeadLag(SimpleNamespace(parameters={{"gain": self.gain}}))
        self.law.reset()
        self.{device} = self.law.step(0.0, [self.{signal}], [0.0], [True])

    def do_step(self, current_time, step_size):
        if self.{signal} > 1.0:
            raise ValueError("more than one")
        self.t += step_size
        self.{device} = self.law.step(self.t, [self.{signal}], [0.0], [True])
        return True
"""
NAMES = {
    2: {"package": "pythonfmu", "Slave": "Fmi2Slave", "Real": "Real", "more": ""},
    3: {"package": "pythonfmu3", "Slave": "Fmi3Slave", "Real": "Float64", "more": ""},
}


def build(folder: Path, examples: Path, version: int, signal: str = "speed", device: str = "sssc") -> Path:
    """Build the FMU in a folder, of a version of FMI; its variables' names."""
    names = {**NAMES[version], "Causality": f"Fmi{version}Causality", "Variability": f"Fmi{version}Variability"}
    if version == 3:
        names["more"] = (
            'self.register_variable(Float64("time", causality=Fmi3Causality.independent, '
            "variability=Fmi3Variability.continuous))"
        )
    name = f"LeadLag{version}"
    source = folder / f"{name.lower()}.py"
    source.write_text(SLAVE.format(name=name, examples=str(examples), signal=signal, device=device, **names))
    program = Path(sys.executable).with_name(names["package"])
    subprocess.run([program, "build", "-f", str(source), "-d", str(folder)], check=True, capture_output=True)
    return folder / f"{name}.fmu"
