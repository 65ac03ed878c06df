"""The command `import`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from facts_damping.errors import InputError
from facts_damping.output.terminal import note
from facts_damping.output.writing import write_text
from facts_damping.parameters import files
from facts_damping_grids.problems import CaseError

if TYPE_CHECKING:
    import argparse


def import_(arguments: argparse.Namespace) -> None:
    """Write a system file from a MATPOWER or PSS/E case. All problems of a case are lines on standard error."""
    try:
        _import(arguments)
    except CaseError as error:
        *first, last = error.lines
        for line in first:
            note(f"facts-damping: {line}")
        raise InputError(last) from error


def _import(arguments: argparse.Namespace) -> None:
    from facts_damping_grids import matpower_reading, psse_conversion
    from facts_damping_grids.control_limits import widened
    from facts_damping_grids.text import document

    case = Path(arguments.case)
    files.check_writable(arguments.out, "--out")
    if case.suffix.lower() == ".raw":
        if arguments.dynamics is not None:
            raise InputError(f"--dynamics {arguments.dynamics}: given with a RAW file; allowed: with a MATPOWER case")
        imported = psse_conversion.import_case(case, None if arguments.dyr is None else Path(arguments.dyr))
        content, wider = widened(imported.content)
        imported = imported._replace(content=content, notes=[*imported.notes, *wider])
    elif arguments.dyr is not None:
        raise InputError(f"CASE.dyr: {arguments.dyr} given with {case.name}; allowed: with a RAW file")
    elif case.suffix != ".m":
        problem = f"a file of format '{case.suffix}' given" if case.is_file() else "no such file"
        raise InputError(f"{case}: {problem}; allowed: a MATPOWER case (.m) or a PSS/E case (.raw)")
    else:
        imported = matpower_reading.import_case(case, None if arguments.dynamics is None else Path(arguments.dynamics))
    more = arguments.dynamics or arguments.dyr
    text = document(imported, case.name if more is None else f"{case.name} with {Path(more).name}")
    for line in imported.notes:
        note(f"facts-damping: {line}")
    write_text(arguments.out or "-", text)
