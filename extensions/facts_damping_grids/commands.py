"""The command `import`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from facts_damping.errors import InputError, ProblemsError
from facts_damping.output.terminal import note, show
from facts_damping.output.writing import write_text
from facts_damping.parameters import files

if TYPE_CHECKING:
    import argparse


def import_(arguments: argparse.Namespace) -> None:
    """Write a system file from a MATPOWER or PSS/E case, and tell what became of its records."""
    from facts_damping_grids import matpower_reading
    from facts_damping_grids.psse import conversion, loads, report
    from facts_damping_grids.text import document

    case = Path(arguments.case)
    files.check_writable(arguments.out, "--out")
    report_lines = list[str]()
    of_psse = {f"--loads {arguments.loads!r}": arguments.loads is not None}
    of_psse |= {"--strict": arguments.strict, "--zones": arguments.zones}
    if case.suffix.lower() == ".raw":
        if arguments.dynamics is not None:
            raise InputError(f"--dynamics {arguments.dynamics}: given with a RAW file; allowed: with a MATPOWER case")
        model = loads.IMPEDANCE if arguments.loads is None else loads.load_model(arguments.loads)
        dyr = None if arguments.dyr is None else Path(arguments.dyr)
        imported = conversion.import_case(case, dyr, model, zones=arguments.zones)
        if arguments.strict and imported.inexact:
            last = f"--strict: {len(imported.inexact)} replaced or left out given; allowed: none"
            raise ProblemsError([*imported.inexact, last], most=len(imported.inexact) + 1)
        content, typical, notes = imported[:3]
        report_lines = report.lines(imported.records)
    elif arguments.dyr is not None:
        raise InputError(f"CASE.dyr: {arguments.dyr} given with {case.name}; allowed: with a RAW file")
    elif any(of_psse.values()):
        option = next(name for name, is_set in of_psse.items() if is_set)
        raise InputError(f"{option}: given with {case.name}; allowed: with a RAW file")
    elif case.suffix != ".m":
        problem = f"a file of format '{case.suffix}' given" if case.is_file() else "no such file"
        raise InputError(f"{case}: {problem}; allowed: a MATPOWER case (.m) or a PSS/E case (.raw)")
    else:
        dynamics = None if arguments.dynamics is None else Path(arguments.dynamics)
        content, typical, notes = matpower_reading.import_case(case, dynamics)
    more = arguments.dynamics or arguments.dyr
    origin = case.name if more is None else f"{case.name} with {Path(more).name}"
    tell = note if (arguments.out or "-") == "-" else show
    for line in report_lines:
        tell(line)
    for line in notes:
        note(f"facts-damping: {line}")
    write_text(
        arguments.out or "-", document(content, typical, origin, [*report_lines, *(notes if report_lines else [])])
    )
