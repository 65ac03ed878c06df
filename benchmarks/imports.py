"""Every pair of PSS/E files in folders, imported as a user does it: what became of its records, by case and by model.

    python benchmarks/imports.py FOLDER... [--pool]

A DYR file belongs to a RAW file of its folder (`--pool`: of all folders) that has all buses of its records, if half of
the generators there have a record; of several, to those with which it shares most machines. Pairs of the same texts
count once, and by model each DYR file with the RAW file with which most records are exact. Records of a refused file
are left out. `network`: records of the RAW file that are replaced or left out.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from facts_damping.errors import InputError
from facts_damping.output.tables import table
from facts_damping_grids.psse.conversion import import_case
from facts_damping_grids.psse.effects import family
from facts_damping_grids.psse.generators import identifier
from facts_damping_grids.psse.reading import read_dyr, read_raw
from facts_damping_grids.psse.report import OTHER, TITLES, Records

if TYPE_CHECKING:
    from collections.abc import Iterable

COLUMNS = ("case", "buses", "machines", *TITLES[1:], "network", "s", "refused")


def pairs_of(files: Iterable[Path], *, pool: bool) -> list[tuple[Path | None, Path]]:
    """DYR files, each with the RAW files to which it belongs, or with none."""
    cases, pairs = dict[Path, Any](), dict[tuple[bytes, bytes], tuple[Path | None, Path]]()
    raws, dyrs = ([path for path in files if path.suffix.lower() == kind] for kind in (".raw", ".dyr"))
    for raw in raws:
        try:
            tables = read_raw(raw, []).tables
        except InputError as error:
            print(f"no case: {error}", file=sys.stderr)
            continue
        units = {(int(row["I"]), identifier(row["ID"])) for row in tables["generator"]}
        cases[raw] = {int(row["I"]) for row in tables["bus"]}, units
    for dyr in dyrs:
        machines, text = {(r.bus, identifier(r.machine)) for r in read_dyr(dyr, []).records}, dyr.read_bytes()
        shares = {
            raw: len(units & machines) / len(units | machines)
            for raw, (buses, units) in cases.items()
            if (pool or raw.parent == dyr.parent) and {bus for bus, _ in machines} <= buses
            if len(units & machines) >= len(units) / 2
        }
        pairs |= {(r.read_bytes(), text): (r, dyr) for r, share in shares.items() if share == max(shares.values())}
        pairs |= {} if shares else {(b"", text): (None, dyr)}
    return [*pairs.values()]


def imported(raw: Path | None, dyr: Path) -> tuple[list[Any], list[Records]]:
    """A row of the table without its case, and what became of the DYR file's records."""
    case, began, refused = None, time.perf_counter(), "belongs to no RAW file"
    try:
        case = import_case(raw, dyr) if raw else None
    except InputError as error:
        refused = str(error).replace(f"{dyr.parent}/", "").replace("\n", "; ")
    seconds = f"{time.perf_counter() - began:.2f}"
    if case is None:
        models = [Records(name, n, 0, n, 0) for name, n in Counter(r.model for r in read_dyr(dyr, []).records).items()]
        return ["", "", *numbers(models), "", seconds, refused], models
    models = [row for row in case.records if row.name.isupper() or row.name == OTHER]
    network = sum(row.replaced + row.left_out for row in case.records if row not in models)
    sizes = (len(case.content.get(name, ())) for name in ("buses", "machines"))
    return [*sizes, *numbers(models), network, seconds, ""], models


def numbers(rows: Iterable[Records]) -> list[int]:
    """Records read, exact, replaced, left out and idle."""
    return [sum(column) for column in zip([0] * 5, *((r.read, r.exact, *r[2:5]) for r in rows), strict=True)]


def main() -> None:
    """Both tables of the folders that are named, and the shares of exact records."""
    files = [path for word in sys.argv[1:] if word != "--pool" for path in sorted(Path(word).rglob("*"))]
    pairs, rows, best = pairs_of(files, pool="--pool" in sys.argv), list[list[Any]](), dict[bytes, list[Records]]()
    for raw, dyr in pairs:
        case, text = " + ".join(f"{path.parent.name}/{path.stem}" for path in (raw, dyr) if path), dyr.read_bytes()
        print(f"{len(rows) + 1} of {len(pairs)}: {case}", file=sys.stderr)
        row, models = imported(raw, dyr)
        rows.append([case, *row])
        best[text] = max(best.get(text, models), models, key=lambda listed: numbers(listed)[1])
    every = [record for models in best.values() for record in models]
    by_name = [(name, *numbers(r for r in every if r.name == name)) for name in {record.name for record in every}]
    print("\n".join([*table(COLUMNS, rows), "", *table(("model", *TITLES[1:]), sorted(by_name, key=lambda r: -r[1]))]))
    for kind, inverters in (("all", True), ("without inverters", False)):
        read, exact, *_, idle = numbers(row for row in every if inverters or family(row.name) != "inverter")
        print(f"{kind}: {exact} of {read - idle} records are exact, {exact / max(read - idle, 1):.2%}")


if __name__ == "__main__":
    main()
