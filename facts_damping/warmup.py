"""Compiles every kernel once, so that nothing waits for the compiler later: `python -m facts_damping.warmup`."""

from __future__ import annotations

from facts_damping import loop
from facts_damping.configuration import load_case


def main() -> None:
    """Call every compiled function as the nodes and the loop do."""
    case = load_case(None, ["duration=0.1", "controllers.0.name=HBsWC", "controllers.0.scheme=indirect"])
    loop.rehearse(case)
    loop.run(case)


if __name__ == "__main__":
    main()
