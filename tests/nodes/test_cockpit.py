"""The node cockpit, as `ros2 run` starts it."""

from __future__ import annotations

import re
from typing import Any

from tests.nodes.graphs import PATIENCE_S


def test_address_with_its_token_is_on_standard_output(start: Any) -> None:
    """Also for a user, who gives no parameter `progress`."""
    node = start("cockpit", port=0, progress=False)
    node.wait(lambda: node.texts()[0].endswith("\n"), PATIENCE_S)
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/\?token=\S{32}\n", node.texts()[0])
