"""Every pair of PSS/E files in folders, imported as a user does it: what became of its records, by case and by model.

    python benchmarks/imports.py FOLDER... [--pool]

A DYR file belongs to a RAW file of its folder, or with `--pool` of all folders, if all buses of its records are in the
RAW file and at least half of the generators there have a record; and it belongs to those of these RAW files with the
greatest part of machines in both of machines in any. Pairs of the same texts count once, and by model each DYR file
with the first RAW file with which it is accepted. `network`: records of the RAW file that are replaced or left out; all
other numbers are of the DYR file. A record is exact if it acts as in PSS/E; one that is idle there, too, does not count
in the shares; those of a refused file are left out.
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
from facts_damping_grids.psse.report import OTHER, Records

if TYPE_CHECKING:
    from collections.abc import Iterable

OUTCOMES = ("read", "exact", "replaced", "left out", "idle")
TITLES = ("case", "buses", "machines", *OUTCOMES, "network", "s", "refused")


def pairs_of(files: Iterable[Path], *, pool: bool) -> Iterable[tuple[Path | None, Path]]:
    """DYR files, each with the RAW files to which it belongs, or with none."""
    cases, pairs = dict[Path, Any](), dict[tuple[bytes, bytes], tuple[Path | None, Path]]()
    for raw in (path for path in files if path.suffix.lower() == ".raw"):
        try:
            tables = read_raw(raw, []).tables
        except InputError as error:
            print(f"no case: {error}", file=sys.stderr)
            continue
        units = {(int(row["I"]), identifier(row["ID"])) for row in tables["generator"]}
        cases[raw] = {int(row["I"]) for row in tables["bus"]}, units
    for dyr in (path for path in files if path.suffix.lower() == ".dyr"):
        machines, text = {(r.bus, identifier(r.machine)) for r in read_dyr(dyr, []).records}, dyr.read_bytes()
        shares = {
            raw: len(units & machines) / len(units | machines)
            for raw, (buses, units) in cases.items()
            if (pool or raw.parent == dyr.parent) and {bus for bus, _ in machines} <= buses
            if len(units & machines) >= len(units) / 2
        }
        pairs |= {(r.read_bytes(), text): (r, dyr) for r, share in shares.items() if share == max(shares.values())}
        if not shares:
            pairs[b"", text] = None, dyr
    return pairs.values()


def imported(raw: Path | None, dyr: Path) -> tuple[list[Any], list[Records]]:
    """A row of the table without its case, and what became of the DYR file's records; none if the import is refused."""
    began, refused = time.perf_counter(), "belongs to no RAW file"
    try:
        case = import_case(raw, dyr) if raw else None
    except InputError as error:
        case, lines = None, str(error).replace(f"{dyr.parent}/", "").splitlines()
        refused = lines[0] + (f" (and {len(lines) - 1} lines more)" if len(lines) > 1 else "")
    seconds = f"{time.perf_counter() - began:.2f}"
    if case is None:
        return [*[""] * (len(TITLES) - 3), seconds, refused], []
    models = [row for row in case.records if row.name.isupper() or row.name == OTHER]
    network = sum(row.replaced + row.left_out for row in case.records if row not in models)
    sizes = len(case.content["buses"]), len(case.content.get("machines", ()))
    return [*sizes, *counts(models).values(), network, seconds, ""], models


def counts(rows: Iterable[Records]) -> dict[str, int]:
    """Numbers of records by outcome."""
    numbers = [(row.read, row.exact, row.replaced, row.left_out, row.idle) for row in rows]
    return {name: sum(row[i] for row in numbers) for i, name in enumerate(OUTCOMES)}


def main() -> None:
    """Both tables of the folders that are named, and the shares of exact records."""
    folders = [word for word in sys.argv[1:] if word != "--pool"]
    files = [path for folder in folders for path in sorted(Path(folder).rglob("*"))]
    pairs = list(pairs_of(files, pool="--pool" in sys.argv))
    rows, accepted, refused = list[list[Any]](), dict[bytes, list[Records]](), dict[bytes, list[Records]]()
    for raw, dyr in pairs:
        case, text = " + ".join(f"{path.parent.name}/{path.stem}" for path in (raw, dyr) if path), dyr.read_bytes()
        print(f"{len(rows) + 1} of {len(pairs)}: {case}", file=sys.stderr)
        row, models = imported(raw, dyr)
        rows.append([case, *row])
        accepted[text] = accepted.get(text) or models
        names = Counter(record.model for record in read_dyr(dyr, []).records)
        refused[text] = [Records(name, n, 0, n, 0) for name, n in names.items()]
    every = [record for text, models in accepted.items() for record in models or refused[text]]
    by_name = {name: counts(r for r in every if r.name == name) for name in {record.name for record in every}}
    order = sorted(by_name, key=lambda name: (-by_name[name]["read"], name))
    lines = [*table(TITLES, rows), "", *table(("model", *OUTCOMES), [(n, *by_name[n].values()) for n in order])]
    for kind, inverters in (("all", True), ("without inverters", False)):
        total = counts(record for record in every if inverters or family(record.name) != "inverter")
        acting = total["read"] - total["idle"]
        lines.append(f"{kind}: {total['exact']} of {acting} records are exact, {total['exact'] / max(acting, 1):.2%}")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
