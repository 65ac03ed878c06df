"""The process of which nodes are copies."""

from __future__ import annotations

import subprocess
import sys
from multiprocessing import util
from pathlib import Path

from facts_damping.nodes.launching import forked


def test_another_process_that_loads_the_same_leaves_the_folder_of_this_one() -> None:
    """As a test of a user's own does, with the loopback, beside graphs."""
    forked.load()
    subprocess.run([sys.executable, "-c", "import facts_damping.nodes.launching.preload"], check=True)
    assert Path(util.get_temp_dir()).is_dir()
