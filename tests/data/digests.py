"""Digests of the runs in `digests.yaml`: computed anew and written there, or with `--print` told, a line each."""

from __future__ import annotations

import argparse
import json
import os
import sys
from contextlib import redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import scipy.linalg  # noqa: F401 (with it, its BLAS)
from threadpoolctl import threadpool_info

from facts_damping.case.loading import load_case
from facts_damping.cli.main import main as command
from facts_damping.digest import digest
from facts_damping.output.writing import write_whole
from facts_damping.parameters.yaml_text import dump, parse
from facts_damping.simulation import loop

ROOT, TABLE = Path(__file__).parents[2], Path(__file__).with_suffix(".yaml")
NPCC = Path(sys.prefix) / "andes/andes/cases/npcc"  # unpacked, as tests/andes_cases.py has it
FAULT = "scenario=[{time: 0.5, kind: fault, bus: B7, duration: 0.05}]"


def rows() -> list[dict[str, Any]]:
    """The table."""
    table: list[dict[str, Any]] = parse(TABLE.read_text(encoding="utf-8"))
    return table


def computed(row: dict[str, Any]) -> str:
    """The digest of a row's run."""
    sets = [f"{path}={json.dumps(value)}" for path, value in row["set"].items()]
    if row["run"] == "npcc":
        with TemporaryDirectory() as folder:
            path = f"{folder}/npcc.yaml"
            with redirect_stdout(sys.stderr):
                missing = command(["import", str(NPCC / "npcc.raw"), str(NPCC / "npcc_full.dyr"), "--out", path])
            if missing:
                raise SystemExit("the case of 140 buses is missing: make test unpacks it")
            sets_of_row = [f"system={path}", "devices=[]", "controllers=[]", FAULT]
            return digest(loop.run(load_case(None, [*sets_of_row, *sets])))
    return digest(loop.run(load_case(row["run"], sets)))


def kernels() -> str:
    """What kernels of OpenBLAS are in use."""
    return ", ".join(
        sorted({library["architecture"] for library in threadpool_info() if library["internal_api"] == "openblas"})
    )


def main() -> None:
    """Print, or write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--print", action="store_true", dest="printed")
    arguments = parser.parse_args()
    os.chdir(ROOT)
    table = rows()
    print(f"kernels of OpenBLAS: {kernels()}")
    for row in table:
        row["digest"] = computed(row)
        print(f"{row['digest']} {row['name']}", flush=True)
    if not arguments.printed:
        head = "".join(line for line in TABLE.read_text(encoding="utf-8").splitlines(True) if line.startswith("#"))
        write_whole(TABLE, head + dump(table))


if __name__ == "__main__":
    main()
