"""Makes `config/references/andes_inverters` from what ANDES 2.0.0 gives for its shipped cases with inverters.

    python tests/data/make_andes_inverters.py FOLDER

FOLDER has of each case what ANDES gave: `CASE_data.json`, every parameter as entered, `CASE_powerflow.csv`,
`CASE_eigenvalues.csv` with participations, and `CASE_shunt.csv.gz`, a conductance of 0.1 p.u. put on a bus at 1 s.
ANDES is under the GPL: nothing of its program is here. Where a system is not as entered: README.md of
`config/references`.
"""

from __future__ import annotations

import csv
import gzip
import json
import math
import sys
from pathlib import Path
from typing import Any

from facts_damping.machine_controls.block_models import MODELS
from facts_damping_grids.text import rows_text

HERE = Path(__file__).parents[2] / "config" / "references" / "andes_inverters"
CASES = ("kundur_reg", "kundur_wtds", "ieee14_solar", "ieee14_reecb1", "ieee14_regcp1", "ieee14_wt3")
ADDED = 1e-8  # p.u., to r and x of every line
EVERY = 12  # samples of a series
LOWEST = 0.2  # p.u., of limits of valves: one starts at its own
# Eigenvalues of states that act on nothing, or stand in a numerator and a denominator alike.
NOTHING = ("LL_x EXDC2", "s3_x REPCA1")
NOTHING_AT = {"ieee14_reecb1": ("PLL1", "PLL2")}
NAMES = {  # ours of ANDES's
    "QMax": "Qmax",
    "QMin": "Qmin",
    "VMAX": "Vmax",
    "VMIN": "Vmin",
    "PMAX": "Pmax",
    "PMIN": "Pmin",
    "Kip": "KIP",
    "thmax": "TetaMax",
    "thmin": "TetaMin",
    "dthmax": "RTetaMax",
    "dthmin": "RTetaMin",
    "theta0": "Theta0",
    **{f"sp{i}": f"spd{i}" for i in range(1, 5)},
}
# Ours and ANDES's, in turn.
FIELDS = "rating Sn D D Ra ra Xl xl Xd xd Xd1 xd1 Xd2 xd2 Td01 Td10 Td02 Td20 Xq xq Xq1 xq1 Xq2 xq2 Tq01 Tq10 Tq02 Tq20"
OTHERWISE = {"REECA1": {"Thld": 0.0, "Thld2": 0.0, "Vref0": 0.0, "Vbias": 0.0}, "REECB1": {"Vref0": 0.0}}

Row = dict[str, Any]


def fields(model: str, row: Row, **more: Any) -> Row:
    """The fields of a model by our names."""
    ours = row | {NAMES.get(name, name): value for name, value in row.items()} | more
    unused = {*MODELS[model].ignored.split(), *MODELS[model].optional.split()}
    return {"model": model, **{name: ours[name] for name in MODELS[model].fields.split() if name not in unused}}


def network(data: Row) -> Row:
    """Buses, branches, loads and shunts."""
    base, lines, transformers = data["system_base_MVA"], [], []
    for row in data["Line"]:
        if row["u"]:
            branch = {"name": row["idx"], "from": f"B{row['bus1']}", "to": f"B{row['bus2']}"}
            z = {"r": row["r"] + ADDED, "x": row["x"] + ADDED}
            if row["tap"] != 1.0 or row["phi"] != 0.0:
                transformers.append({**branch, "rating": base, **z, "tap": row["tap"]})
            else:
                lines.append({**branch, **z, "b": row["b"]})
    loads = [(f"load_{row['bus']}", row["bus"], row["p0"] * base, row["q0"] * base) for row in data["PQ"]]
    shunts = [(f"shunt_{row['bus']}", row["bus"], row["g"] * base, row["b"] * base) for row in data.get("Shunt", ())]
    return {
        "buses": [{"name": f"B{row['idx']}", "nominal_voltage": row["Vn"]} for row in data["Bus"]],
        "lines": lines,
        "transformers": transformers,
        "loads": [{"name": name, "bus": f"B{bus}", "P": P, "Q": Q} for name, bus, P, Q in loads],
        "shunts": [{"name": name, "bus": f"B{bus}", "Q": Q, "P": P} for name, bus, P, Q in shunts],
    }


def machines(data: Row, static: dict[Any, Row]) -> Row:
    """Machines with their exciters and governors."""
    rows, names = list[Row](), dict[Any, str]()
    for row in data["GENROU"]:
        start = static[row["gen"]]
        names[row["idx"]] = f"G{row['bus']}"
        place = {"name": f"G{row['bus']}", "bus": f"B{row['bus']}", "V": start["v0"], "H": row["M"] / 2.0}
        angle = {"slack": True, "angle": math.degrees(start["a0"])} if "a0" in start else {"P": start["p0"] * 100.0}
        saturation = {"S10": row["S10"], "S12": row["S12"]} if row["S10"] else {}
        names_of_both = FIELDS.split()
        of_machine = {a: row[b] for a, b in zip(names_of_both[::2], names_of_both[1::2], strict=True)}
        rows.append({**place, **angle, "model": "genrou", **of_machine, **saturation})
    exciters = [
        {"machine": names[row["syn"]], **fields(model, row, **({"KF": row["KF1"]} if model == "EXDC2" else {}))}
        for model in ("EXDC2", "EXST1", "ESST3A")
        for row in data.get(model, ())
    ]
    governors = [
        {"machine": names[row["syn"]], **fields("TGOV1", row, DT=row["Dt"], VMIN=min(row["VMIN"], LOWEST))}
        for row in data["TGOV1"]
    ]
    return {"machines": rows, "exciters": exciters, "governors": governors}


def inverters(case: str, data: Row, static: dict[Any, Row]) -> Row:
    """The inverter with its controls."""
    (row,) = data["REGCA1"] if "REGCA1" in data else data["REGCP1"]
    start, name = static[row["gen"]], f"IBR{row['bus']}"
    place = {"name": name, "bus": f"B{row['bus']}", "rating": row["Sn"], "P": start["p0"] * 100.0, "V": start["v0"]}
    controls = []
    for model in ("REECA1", "REECB1", "REPCA1", "WTDTA1", "WTARA1", "WTPTA1", "WTTQA1"):
        for control in data.get(model, ()):
            more = dict(OTHERWISE.get(model, {}))
            if model == "REPCA1":
                line = next(line for line in data["Line"] if line["idx"] == control["line"])
                more |= {"Rc": 0.0, "Xc": 0.0}
                place_of = {"bus": f"B{line['bus1']}", "branch": control["line"]}
            elif model == "WTDTA1":
                more |= {"Freq1": control["Freq1"] / (2.0 * math.pi)}
            elif model == "WTTQA1" and case == "kundur_wtds":
                more |= {"KIP": 0.0, "Temax": 99.0}
            placed = place_of if model == "REPCA1" else {}
            controls.append({"inverter": name, **fields(model, control, **more), **placed})
    for control in data.get("WTDS", ()):
        of_shaft = {"H": control["H"], "DAMP": control["D"], "Htfrac": 0.0, "Freq1": 0.0, "Dshaft": 0.0}
        controls.append({"inverter": name, "model": "WTDTA1", **of_shaft})
    return {"inverters": [place | fields("REGCA1", row)], "inverter_controls": controls}


def system(case: str, data: Row) -> Row:
    """A case as a system, with a PMU at each bus; that of the inverter's bus measures the power out of it."""
    static = {row["idx"]: row for kind in ("PV", "Slack") for row in data[kind]}
    grid, sources = network(data), inverters(case, data, static)
    (inverter,) = sources["inverters"]
    out = [
        row["name"] for row in (*grid["lines"], *grid["transformers"]) if inverter["bus"] in (row["from"], row["to"])
    ]
    pmus = [
        {"name": row["name"], "bus": row["name"], **({"branches": out} if row["name"] == inverter["bus"] else {})}
        for row in grid["buses"]
    ]
    head = {"name": case, "description": f"{case} of ANDES 2.0.0", "ranges": "physical"}
    head |= {"base_power": data["system_base_MVA"], "frequency": data["frequency_Hz"], "line_model": "pi"}
    content = head | grid | machines(data, static) | sources | {"pmus": pmus}
    return {key: value for key, value in content.items() if value != []}


def write(name: str, rows: list[list[Any]]) -> None:
    """Write a table."""
    with (HERE / name).open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


def table(text: str) -> list[Row]:
    """The rows of a file of ANDES's."""
    return list(csv.DictReader(line for line in text.splitlines() if not line.startswith("#")))


def acts(case: str, row: Row) -> bool:
    """Whether an eigenvalue is not of a state that acts on nothing."""
    first = row["participations"].split("=")[0]
    return not first.startswith((*NOTHING, "WO_x BusFreq", "L_y BusFreq")) and not any(
        part in first for part in NOTHING_AT.get(case, ())
    )


def main(source: Path) -> None:
    """Write systems and figures."""
    eigenvalues, voltages = [["case", "re", "im"]], [["case", "bus", "V", "angle"]]
    for case in CASES:
        folder = source / case
        data = json.loads((folder / f"{case}_data.json").read_text())
        content = system(case, data)
        head = "# A case of ANDES 2.0.0 by its parameters: see README.md of config/references.\n"
        (HERE / f"{case}.yaml").write_text(head + rows_text(content), encoding="utf-8")
        all_of_them = table((folder / f"{case}_eigenvalues.csv").read_text())
        eigenvalues += [[case, row["re_1_per_s"], row["im_rad_per_s"]] for row in all_of_them if acts(case, row)]
        flow = table((folder / f"{case}_powerflow.csv").read_text())
        voltages += [[case, f"B{row['bus']}", row["v_pu"], row["angle_rad"]] for row in flow]
        series = folder / f"{case}_shunt.csv.gz"
        if series.exists():
            names = {"t": "time_s", **{f"V_{row['name']}": f"bus{row['name'][1:]}.v" for row in content["buses"]}}
            numbers = {f"G{row['bus']}": row["idx"] for row in data["GENROU"]}
            names |= {f"w_{name}": f"GENROU.{number}.omega" for name, number in numbers.items()}
            names["P"] = f"{'REGCP1' if 'REGCP1' in data else 'REGCA1'}.1.Pe"
            rows = table(gzip.decompress(series.read_bytes()).decode())[::EVERY]
            write(f"{case}_shunt.csv", [list(names), *([row[theirs] for theirs in names.values()] for row in rows)])
    write("eigenvalues.csv", eigenvalues)
    write("voltages.csv", voltages)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
