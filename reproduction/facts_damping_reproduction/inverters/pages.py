"""The page on inverters: answers, figures, tables as CSV; all sentences follow from the results.

    python -m facts_damping_reproduction.inverters.pages results/inverters

writes `inverters_results.md`, two figures and the CSVs into the folder. Searches and runs that the folder has are not
computed again.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure

from facts_damping.analysis.plotting.plots import COLOURS
from facts_damping.output.picture_files import save_picture
from facts_damping.output.tables import table
from facts_damping.output.writing import write_whole
from facts_damping_reproduction.adaptation.decide import Ratio
from facts_damping_reproduction.inverters import comparison, study
from facts_damping_reproduction.inverters.laws import BARE, MAIN
from facts_damping_reproduction.templates import render
from facts_damping_studies.campaigns.invariants import HARM
from facts_damping_studies.pages import as_csv
from facts_damping_studies.score.entries import NONE
from facts_damping_studies.sweeps.pool import workers

if TYPE_CHECKING:
    from collections.abc import Sequence

Rows = list[dict[str, Any]]
WITH, OFF = "one an area", "none"  # stabilisers
FOLLOWING, DROOPS, VIRTUAL = "following", "droops", "virtual machine"
SENDING, RECEIVING, BOTH = "sending area", "receiving area", "both areas"
GROWING = 1e-3  # 1/s, above which a grid is unstable; less is round-off
ADDED = (  # after the evaluation
    ("POD-P, designed", "POD-Q, designed"),
    ("POD-P, designed", "SSSC, designed"),
    ("virtual machines", "SSSC, designed"),
)
PAIRS = (  # of the question
    ("POD-P", "POD-Q"),
    ("POD-P", "SSSC"),
    ("POD-Q", "SSSC"),
    ("stabilisers everywhere", "POD-P"),
    ("virtual machines", "POD-P"),
    ("virtual machines", "droops"),
    ("virtual machines and P", "virtual machines"),
    ("virtual machines and V", "virtual machines"),
)
NAMES = ("modes", "constants", "comparison", "claim", "delays", "failures")


def at(rows: Rows, **asked: Any) -> dict[str, Any]:
    """The row with these values."""
    return next(row for row in rows if all(row[name] == value for name, value in asked.items()))


def unstable(row: dict[str, Any]) -> bool:
    """Whether a grid of `modes` has no steady state that it keeps."""
    return row["growth"] is None or row["growth"] > GROWING


def plot_modes(rows: Rows, path: Path) -> Path:
    """Damping ratio of the interarea mode over the share, a panel for each place; crosses: the grid is unstable."""
    figure = Figure(figsize=(7.6, 2.9), layout="constrained")
    panels: Any = figure.subplots(1, 3, sharey=True)
    for axes, place in zip(panels, study.plan()["modes"]["places"], strict=True):
        for colour, kind in zip(COLOURS, study.plan()["kinds"], strict=False):
            for stabilisers, style in ((WITH, "-"), (OFF, ":")):
                shown = [
                    row for row in rows if (row["stabilisers"], row["kind"], row["place"]) == (stabilisers, kind, place)
                ]
                known = [row for row in shown if row["interarea"] is not None]
                places = [100 * row["share"] for row in known], [100 * row["interarea"] for row in known]
                label = kind if stabilisers == WITH else None
                axes.plot(*places, style, color=colour, marker="o", ms=3, label=label)
                lost = [row for row in shown if unstable(row)]
                heights = [100 * (row["interarea"] or 0.0) for row in lost]
                axes.plot([100 * row["share"] for row in lost], heights, "x", color=colour, ms=7)
        axes.set_title(place, fontsize=9, loc="left")
        axes.set_xlabel("share of inverters [%]", fontsize=9)
        axes.axhline(0.0, color="black", lw=0.8)
        axes.grid(visible=True, color="0.92")
    panels[0].set_ylabel("damping ratio, interarea [%]", fontsize=9)
    panels[-1].legend(fontsize=7, loc="upper left")
    return save_picture(figure, path, dpi=150, metadata={"Software": None})


def plot_delays(rows: Rows, path: Path) -> Path:
    """Damping ratio of the interarea mode over the delay, a line for each controller; crosses: the loop is unstable."""
    figure = Figure(figsize=(4.4, 2.9), layout="constrained")
    axes: Any = figure.subplots()
    for colour, arm in zip(COLOURS, study.plan()["failed"], strict=False):
        shown = [row for row in rows if row["arm"] == arm and row["damping_ratio"] is not None]
        axes.plot(
            [1e3 * row["delay_s"] for row in shown],
            [100 * row["damping_ratio"] for row in shown],
            color=colour,
            marker=".",
            label=arm,
        )
        lost = [row for row in shown if row["growth"] > GROWING]
        axes.plot(
            [1e3 * row["delay_s"] for row in lost],
            [100 * row["damping_ratio"] for row in lost],
            "x",
            color=colour,
            ms=7,
        )
    axes.set_xlabel("delay [ms]", fontsize=9)
    axes.set_ylabel("damping ratio, interarea [%]", fontsize=9)
    axes.axhline(0.0, color="black", lw=0.8)
    axes.grid(visible=True, color="0.92")
    axes.legend(fontsize=7)
    return save_picture(figure, path, dpi=150, metadata={"Software": None})


def of_pair(rows: Rows, arm: str, against: str) -> Ratio:
    """The ratio of two arms."""
    row = at(rows, arm=arm, against=against)
    return Ratio(**{name: row[name] for name in Ratio._fields})


def arm_table(rows: Rows) -> list[str]:
    """Each arm against no control: index, damping ratio, effort, losses."""
    lines = []
    for row in (row for row in rows if row["against"] == NONE):
        linear = f"grows, {row['growth_hz']:.1f} Hz" if row["growth"] > GROWING else percent(row["damping_ratio"])
        cells, effort = [of_pair(rows, row["arm"], NONE).text(), linear], percent(row["effort"] or None)
        lines.append([row["arm"], *cells, effort, f"{row['lost']} of {row['runs']}"])
    return table(["arm", "ITAE, to no control", "damping ratio", "effort", "lost"], lines, 1, markdown=True)


def pair_table(rows: Rows) -> list[str]:
    """The pairs of the question, with their decisions."""
    lines = [
        [arm, against, of_pair(rows, arm, against).text(), of_pair(rows, arm, against).decision]
        for arm, against in (*PAIRS, *ADDED)
    ]
    return table(["arm", "against", "ITAE", "decision"], lines, 2, markdown=True)


def claim_table(rows: Rows) -> list[str]:
    """The parts of the claim, by both measures."""
    lines = [
        [
            f"{row['arm']} against {row['against']}",
            "about as good" if row["against"] == "PSS" else "better",
            change(row),
            row["by_index"],
            f"{percent(row['damping_ratio'])} against {percent(row['damping_ratio_of_other'])}",
            row["by_damping_ratio"],
        ]
        for row in rows
    ]
    return table(["claim", "", "ITAE", "by it", "damping ratio", "by it"], lines, 2, markdown=True)


def failure_table(rows: Rows) -> list[str]:
    """Change of the ITAE to no control of each controller under each failure, alone and supervised."""
    heads = ["from the event on", *study.plan()["failed"]]
    lines = [
        [
            failure,
            *(f"{_of_none(rows, arm, failure, False)}; {_of_none(rows, arm, failure, True)}" for arm in heads[1:]),
        ]
        for failure in study.plan()["failures"]
    ]
    return table(heads, lines, 1, markdown=True)


def _of_none(rows: Rows, arm: str, failure: str, supervised: bool) -> str:
    value = at(rows, arm=arm, failure=failure, supervised=supervised)["of_none"]
    return "lost" if value is None else f"{100 * (value - 1):+.0f} %"


def percent(value: float | None) -> str:
    """A fraction in percent."""
    return "-" if value is None else f"{100 * value:.1f} %"


def change(row: dict[str, Any]) -> str:
    """A ratio as a change with its interval."""
    values = [100.0 * (row[name] - 1.0) for name in ("ratio", "low", "high")]
    return f"{values[0]:+.0f} % [{values[1]:+.0f}, {values[2]:+.0f}]"


def delay_limit(rows: Rows, arm: str) -> str:
    """The largest delay of the plan up to which the loop is stable."""
    last = 0.0
    for row in (row for row in rows if row["arm"] == arm):
        if row["growth"] > GROWING:
            break
        last = row["delay_s"]
    return f"{1e3 * last:.0f} ms"


def verdict(rows: Rows, measure: str) -> str:
    """Whether the claim holds by a measure: all of it, a part to the contrary, or open."""
    parts = [row[measure] for row in rows]
    return "refuted" if "refuted" in parts else "open" if "open" in parts else "confirmed"


def harmful(rows: Rows, supervised: bool) -> str:
    """The failures that make the ITAE larger than without control, with their controllers."""
    named = {
        failure: [
            row["arm"]
            for row in rows
            if (row["failure"], row["supervised"]) == (failure, supervised) and not (row["of_none"] or HARM + 1) <= HARM
        ]
        for failure in study.plan()["failures"]
    }
    return "; ".join(f"{failure} ({', '.join(who)})" for failure, who in named.items() if who) or "none"


def values(tables: dict[str, Rows]) -> dict[str, Any]:
    """The numbers of the sentences."""
    rows, compared = tables["modes"], tables["comparison"]

    def ratio(kind: str, place: str, share: float, stabilisers: str = WITH) -> str:
        return percent(at(rows, stabilisers=stabilisers, kind=kind, place=place, share=share)["interarea"])

    def of_constant(kind: str, name: str) -> str:
        shown = [row for row in tables["constants"] if (row["kind"], row["constant"]) == (kind, name)]
        return ", ".join(percent(row["interarea"]) for row in shown)

    following = [row for row in rows if row["kind"] == FOLLOWING and row["stabilisers"] == WITH and row["share"] > 0.5]
    return {
        "intact": ratio(FOLLOWING, BOTH, 0),
        "sending": ratio(FOLLOWING, SENDING, 0.5),
        "receiving": ratio(FOLLOWING, RECEIVING, 0.5),
        "both": ratio(FOLLOWING, BOTH, 0.5),
        "droops": ratio(DROOPS, BOTH, 0.5),
        "virtual": ratio(VIRTUAL, BOTH, 0.5),
        "bare": ratio(FOLLOWING, BOTH, 0, OFF),
        "bare_virtual": ratio(VIRTUAL, BOTH, 0.5, OFF),
        "unstable": f"{sum(map(unstable, following))} of {len(following)}",
        **{
            f"{name}_{key}": of_constant(kind, name)
            for kind, key in ((DROOPS, "droops"), (VIRTUAL, "virtual"))
            for name in study.plan()["constants"][kind]["inverter"]
        },
        "cases": f"{len(comparison.cases())}",
        "seeds": f"{study.plan()['search']['seeds']}",
        "points": f"{_points(compared)}",
        "margin": percent(study.plan()["margin"]).replace(".0", ""),
        "as_good": f"{100 * study.plan()['claim']['as_good']:.0f} %",
        "rule": " ".join(study.plan()["rule"].split()),
        "decisions": decisions(compared),
        "added": added(compared),
        "claim_index": verdict(tables["claim"], "by_index"),
        "claim_ratio": verdict(tables["claim"], "by_damping_ratio"),
        "pod": tables["claim"][-1]["against"],
        "harm": f"{100 * (HARM - 1):.0f} %",
        "alone": harmful(tables["failures"], False),
        "supervised": harmful(tables["failures"], True),
        "typical": f"{1e3 * study.plan()['typical']:.0f} ms",
        "limits": ", ".join(f"`{arm}` {delay_limit(tables['delays'], arm)}" for arm in study.plan()["failed"]),
    }


def decisions(rows: Rows) -> str:
    """The pairs of the question by decision."""
    named: dict[str, list[str]] = {}
    for arm, against in PAIRS:
        named.setdefault(of_pair(rows, arm, against).decision, []).append(f"{arm} against {against}")
    return "; ".join(f"{decision}: {', '.join(pairs)}" for decision, pairs in named.items())


def added(rows: Rows) -> str:
    """The pairs of laws by design, each with its decision."""
    return "; ".join(f"{arm} against {against}: {of_pair(rows, arm, against).decision}" for arm, against in ADDED)


def _points(rows: Rows) -> int:
    """Points that a search tried, on the mean."""
    loops = [row["loops"] for row in rows if row["against"] == NONE and row["loops"]]
    asked = study.plan()["search"]
    return round(float(sum(loops)) / (len(loops) * int(asked["seeds"]) * int(asked["cases"])))


def page(tables: dict[str, Rows]) -> str:
    """The page, from the tables by their names."""
    compared = tables["comparison"]
    return render(
        "inverters/inverters.md",
        arms="\n".join(arm_table(compared)),
        pairs="\n".join(pair_table(compared)),
        claim="\n".join(claim_table(tables["claim"])),
        failures="\n".join(failure_table(tables["failures"])),
        **values(tables),
    )


def compute(folder: Path, jobs: int) -> dict[str, Rows]:
    """All tables."""
    with workers(jobs) as each:
        main, bare = (comparison.compared(part, folder / part, each) for part in (MAIN, BARE))
        failed = comparison.failures(main, each)
    return {
        "modes": study.modes(),
        "constants": study.constants(),
        "comparison": comparison.ratios(main),
        "claim": comparison.claim(bare),
        "delays": comparison.delays(main),
        "failures": failed,
    }


def write(folder: Path, tables: dict[str, Rows]) -> list[Path]:
    """Write the tables, the figures and the page."""
    for name, rows in tables.items():
        write_whole(folder / f"{name}.csv", as_csv(list(rows[0]), [list(row.values()) for row in rows]))
    write_whole(folder / "inverters_results.md", page(tables))
    plot_modes(tables["modes"], folder / "modes.png")
    plot_delays(tables["delays"], folder / "delays.png")
    names = ("inverters_results.md", "modes.png", "delays.png", *(f"{name}.csv" for name in tables))
    return [folder / name for name in names]


def main(arguments: Sequence[str]) -> None:
    """Compute, or continue, in the folder that is given, and write there."""
    folder = Path(arguments[0])
    for path in write(folder, compute(folder, os.cpu_count() or 1)):
        print(f"written: {path}")


if __name__ == "__main__":
    main(sys.argv[1:])
