"""What searches found, as files of tuned laws that a run names: `LQG@what_holds.0` for seed 0."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.output.writing import write_whole
from facts_damping.parameters.run import Tuned, TunedController
from facts_damping.parameters.yaml_text import dump
from facts_damping_studies.search.tune import document

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path


def write_laws(searches: Mapping[tuple[str, int], Mapping[str, Any]], path: Path, about: str, **fields: str) -> Path:
    """Write a row for each search, by arm and seed; `about`: a line of comment, `fields`: those of the file.

    A row's name is the seed, after what distinguishes its arm from another one of the kind: `not_learning_0`.
    """
    rows = []
    for (arm, seed), search in searches.items():
        (law,) = search["rows"]
        of_arm = "" if law["policy"] else arm.partition(", ")[2].replace(" ", "_")
        fields_of_law = {name: law[name] for name in ("name", "scheme", "policy", "parameters") if law.get(name)}
        row = f"{of_arm}_{seed}" if of_arm else f"{seed}"
        rows.append(TunedController(**fields_of_law, row=row, objective=round(search["value"], 4)))
    file = Tuned.model_validate({**fields, "signals": law["signals"], "devices": law["devices"], "controllers": rows})
    write_whole(path, f"# {about}\n{dump(document(file))}")
    return path
