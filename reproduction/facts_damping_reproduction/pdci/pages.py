"""The page on the Pacific DC Intertie: answers, a figure, tables as CSV; all sentences follow from the results.

    python -m facts_damping_reproduction.pdci.pages results/pdci

writes `pdci.md`, `damping.png` and the CSVs into the folder. A `tuned.csv` that is there (`pdci.tuned` writes it, and
takes longer) becomes part of the page.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from pyarrow import csv

from facts_damping.analysis.plotting.plots import COLOURS
from facts_damping.output.picture_files import save_picture
from facts_damping.output.tables import table
from facts_damping.output.writing import write_whole
from facts_damping_reproduction.adaptation.decide import Ratio
from facts_damping_reproduction.pdci import study
from facts_damping_reproduction.templates import render
from facts_damping_studies.campaigns.invariants import HARM
from facts_damping_studies.pages import as_csv
from facts_damping_studies.score.entries import NONE

if TYPE_CHECKING:
    from collections.abc import Sequence

Rows = list[dict[str, Any]]
SMALL = 8  # MW/mHz, up to which north-south B is the strongest mode of the response to the brake
TYPICAL = 0.1  # s, delay of the answers
LINES = (
    ("p_class", 0.016666667),
    ("p_class", 0.1),
    ("p_class", 0.2),
    ("p_class", 0.3),
    ("ideal", 0.1),
)  # in the figure
SAID = {"none": "no control", "p_class": "P class", "ideal": "exact"}  # PMUs of the converters' table
STUDIES = {
    "linear": study.linear,
    "ringdown": study.ringdowns,
    "converters": study.converters,
    "events": study.events,
    "failures": study.failures,
}
NAMES = ("north-south A", "north-south B", "least damped")


def plot(rows: Rows, path: Path) -> Path:
    """Damping ratios against the gain, a panel for each mode; a band for each delay, as it moves within a frame."""
    figure = Figure(figsize=(4.4, 6.2), layout="constrained")
    panels: Any = figure.subplots(len(NAMES), 1, sharex=True)
    for axes, name in zip(panels, NAMES, strict=True):
        for (pmus, delay), colour in zip(LINES, COLOURS, strict=False):
            shown = [row for row in rows if (row["measurement"], row["delay_s"]) == (pmus, delay)]
            ends = ([100 * row[f"{name}, {end}"] for row in shown] for end in ("min", "max"))
            exact = {"hatch": "////", "facecolor": "none", "edgecolor": "0.5", "lw": 0.0}
            style = exact if pmus == "ideal" else {"color": colour, "alpha": 0.6, "lw": 0.8}
            more = ", exact frequencies" if pmus == "ideal" else ""
            axes.fill_between([row["gain"] for row in shown], *ends, label=f"{delay:.2g} s{more}", **style)
        title = name if name != "least damped" else f"least damped mode below {study.plan()['below']:g} Hz"
        axes.set_title(title, fontsize=9, loc="left")
        axes.set_ylabel("damping ratio [%]", fontsize=8)
        axes.grid(visible=True, color="0.92")
        axes.set_axisbelow(True)
        axes.axhline(0.0, color="black", lw=0.8)
    panels[0].legend(title="P class: delay, and up to a frame more", fontsize=7, title_fontsize=7, ncols=2)
    panels[-1].set_xlabel("gain [MW/mHz]", fontsize=9)
    return save_picture(figure, path, dpi=180, metadata={"Software": None})


def main_pmus() -> tuple[str, list[float]]:
    """The PMUs of the main row, and their delays, s."""
    measurement: dict[str, list[float]] = study.plan()["measurement"]
    return next(iter(measurement.items()))


def span(row: dict[str, Any], mode: str) -> str:
    """The interval of a mode's damping ratio over the phase of the delay."""
    low, high = (f"{100 * row[f'{mode}, {end}']:.1f}" for end in ("min", "max"))
    return f"{high} %" if low == high else f"{low} to {high} %"


def at(rows: Rows, **asked: Any) -> dict[str, Any]:
    """The row with these values."""
    return next(row for row in rows if all(row[name] == value for name, value in asked.items()))


def limit(rows: Rows, gain: float) -> float:
    """The largest delay of the plan up to which, at any phase, no slow mode is less damped than without control."""
    free, last = at(rows, gain=0)["least damped"], 0.0
    pmus, delays = main_pmus()
    for delay in delays:
        if at(rows, measurement=pmus, gain=gain, delay_s=delay)["least damped, min"] < free:
            break
        last = delay
    return last


def apart(linear: Rows, ringdown: Rows) -> float:
    """Largest difference of the damping ratio of north-south B after the brake from the linear one, for small gains.

    With larger ones other modes are stronger in the response.
    """
    small = [row for row in ringdown if row["gain"] <= SMALL and row["delay_s"] < main_pmus()[1][-1]]
    of_linear = [at(linear, gain=row["gain"], delay_s=row["delay_s"])["north-south B"] for row in small]
    return max(
        float(abs(row["damping_ratio"] - linear_ratio)) for row, linear_ratio in zip(small, of_linear, strict=True)
    )


def values(linear: Rows, events: Rows, failures: Rows) -> dict[str, Any]:
    """The numbers of the answers: how much damping, until which delay, what fails how."""
    gain, strongest = study.plan()["gain"], study.plan()["gains"][-1]
    free, law = at(linear, gain=0), at(linear, measurement=main_pmus()[0], gain=gain, delay_s=TYPICAL)
    exact, filtered = (
        at(linear, measurement="ideal", gain=gain, delay_s=TYPICAL),
        at(linear, measurement="m_class", gain=gain),
    )
    ratios = [
        at(events, event=kind, gain=gain)["ITAE"] / at(events, event=kind, gain=0)["ITAE"]
        for kind in study.plan()["events"]
    ]
    none = at(events, event="brake", gain=0)["ITAE"]
    worse = [[row["failure"] for row in failures if row["supervised"] is flag and not row["ITAE"] <= HARM * none]
             for flag in (False, True)]  # fmt: skip
    return {
        "a_free": f"{100 * free['north-south A']:.1f} %",
        "b_free": f"{100 * free['north-south B']:.1f} %",
        "a_law": span(law, "north-south A"),
        "b_law": span(law, "north-south B"),
        "b_exact": span(exact, "north-south B"),
        "b_filtered": span(filtered, "north-south B"),
        "filtered": f"{1000 * filtered['delay_s']:.0f} ms",
        "gain": f"{gain}",
        "events": f"{len(ratios)}",
        "smallest": f"{100 * (1 - max(ratios)):.0f}",
        "largest": f"{100 * (1 - min(ratios)):.0f}",
        "below": f"{study.plan()['below']:g}",
        "limit": f"{limit(linear, gain):g} s",
        "strongest": f"{strongest}",
        "limit_of_strongest": f"{limit(linear, strongest):g} s",
        "harm": f"{100 * (HARM - 1):.0f} %",
        "alone": ", ".join(name for name in worse[0] if name not in worse[1]) or "none",
        "supervised": ", ".join(worse[1]) or "none",
    }


def failure_table(failures: Rows, none: float) -> list[str]:
    """Each failure, without a supervisor and with one: ITAE relative to no control, and the verdict."""
    lines = [
        [name, *(cell for flag in (False, True) for cell in _cells(at(failures, failure=name, supervised=flag), none))]
        for name in study.plan()["failures"]
    ]
    for line, name in zip(lines, study.plan()["failures"], strict=True):
        row = at(failures, failure=name, supervised=True)
        never = "never armed" if row["armed_s"] is None else "-"
        line.append(never if row["tripped_s"] is None else f"{row['tripped_s']:.1f} s, {row['cause']}")
    heads = ["failure", "ITAE", "verdict", "supervised: ITAE", "verdict", "tripped at"]
    return table(heads, lines, 1, markdown=True)


def converter_table(rows: Rows) -> list[str]:
    """Damping ratios of north-south A and B, a line for each kind of converters, a column for each loop."""
    loops = dict.fromkeys((row["measurement"], row["delay_s"]) for row in rows)
    lines = []
    for name in study.plan()["converters"]:
        cells = [at(rows, converters=name, measurement=pmus, delay_s=delay) for pmus, delay in loops]
        lines.append([name, *(", ".join(f"{100 * row[f'north-south {mode}']:.1f}" for mode in "AB") for row in cells)])
    heads = [SAID[pmus] if delay is None else f"{SAID[pmus]}, {delay:g} s" for pmus, delay in loops]
    return table(["DC lines", *heads], lines, 1, markdown=True)


def moved(rows: Rows) -> float:
    """Largest difference that the schedule's kind makes to a damping ratio."""
    kinds = [name for name, kind in study.plan()["converters"].items() if kind["modulation"] == "power"]
    ratios = [
        [row[f"north-south {mode}"] for row in rows if row["converters"] == name for mode in "AB"] for name in kinds
    ]
    return float(np.ptp(ratios, axis=0).max())


def _cells(row: dict[str, Any], none: float) -> list[str]:
    change = "-" if row["ITAE"] is None else f"{100 * (row['ITAE'] / none - 1):+.0f} %"
    return [change, row["verdict"]]


def tuned_table(rows: Rows) -> list[str]:
    """Each arm against no control and against the law, with the decision, and its effort in % of the limit."""
    law, lines = study.plan()["tuned"]["law"], []
    for arm in dict.fromkeys(row["arm"] for row in rows):
        free, over_law = (_ratio(rows, arm, against) for against in (NONE, law))
        effort = next(f"{100 * row['effort']:.0f} %" for row in rows if row["arm"] == arm)
        lines.append(
            [
                arm,
                free.text() if free else "-",
                *((over_law.text(), over_law.decision) if over_law else ("-", "-")),
                effort,
            ]
        )
    return table(
        ["controller", "against no control", f"against the {law}", "decision", "effort"], lines, 1, markdown=True
    )


def _ratio(rows: Rows, arm: str, against: str) -> Ratio | None:
    matching = [row for row in rows if (row["arm"], row["against"]) == (arm, against)]
    return Ratio(**{name: matching[0][name] for name in Ratio._fields}) if matching else None


def tuned_values(rows: Rows) -> dict[str, Any]:
    """What the page says of tuned controllers: the arms by decision, the table, and the plan's numbers."""
    if not rows:
        return {"tuned": None}
    part = study.plan()["tuned"]
    against_law = [row for row in rows if row["against"] == part["law"]]
    decided = {
        what: [row["arm"] for row in against_law if row["decision"] == what]
        for row in against_law
        for what in [row["decision"]]
    }
    loops, searches = sum(row["loops"] for row in against_law), part["search"]["seeds"] * len(against_law)
    texts = {
        "decided": "; ".join(f"{what}: {', '.join(f'`{name}`' for name in names)}" for what, names in decided.items()),
        "table": "\n".join(tuned_table(rows)),
        "cases": rows[0]["cases"],
        "seeds": part["search"]["seeds"],
        "margin": f"{100 * part['margin']:g} %",
        "points": round(loops / searches / part["search"]["cases"]),
    }
    return {"tuned": texts}


def page(tables: dict[str, Rows]) -> str:
    """The page, from the tables by their names; without the table `tuned` that part is left out."""
    none = at(tables["events"], event="brake", gain=0)["ITAE"]
    numbers = values(tables["linear"], tables["events"], tables["failures"])
    numbers |= {"small": f"{SMALL}", "apart": f"{100 * apart(tables['linear'], tables['ringdown']):.1f}"}
    numbers |= {"moved": f"{100 * moved(tables['converters']):.1f}"}
    numbers |= tuned_values(tables.get("tuned", []))
    parts = {"failures": failure_table(tables["failures"], none), "converters": converter_table(tables["converters"])}
    return render("pdci/pdci.md", **{name: "\n".join(lines) for name, lines in parts.items()}, **numbers)


def write(folder: Path) -> list[Path]:
    """Compute all of it and write it."""
    tables = {name: compute() for name, compute in STUDIES.items()}
    for name, rows in tables.items():
        write_whole(folder / f"{name}.csv", as_csv(list(rows[0]), [list(row.values()) for row in rows]))
    before = folder / "tuned.csv"
    tuned = {"tuned": csv.read_csv(before).to_pylist()} if before.exists() else {}
    write_whole(folder / "pdci.md", page(tables | tuned))
    plot(tables["linear"], folder / "damping.png")
    return [folder / name for name in ("pdci.md", "damping.png", *(f"{name}.csv" for name in tables))]


def main(arguments: Sequence[str]) -> None:
    """Write into the folder that is given."""
    folder = Path(arguments[0])
    folder.mkdir(parents=True, exist_ok=True)
    print(*(f"written: {path}" for path in write(folder)), sep="\n")


if __name__ == "__main__":
    main(sys.argv[1:])
