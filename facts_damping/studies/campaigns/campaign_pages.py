"""Tables of a fault campaign: invariants, actions of the supervisor, effects on the grid, cost of supervision."""

from __future__ import annotations

import math
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.input_files import share_folder
from facts_damping.monitor_table import MONITORS
from facts_damping.studies.campaigns import campaign as study
from facts_damping.studies.campaigns.faults import FAULTS, NOTHING
from facts_damping.studies.campaigns.invariants import HARM, INVARIANTS
from facts_damping.studies.margins.margins import failed_fraction
from facts_damping.terminal import table

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from facts_damping.studies.campaigns.campaign import Plan

    Rows = Sequence[dict[str, Any]]

WORDS = {
    "within_limits": "outputs within limits, rates and authority",
    "lets_go": "the device at zero within time-out and ramp after the last accepted setpoint",
    "zero_after_trip": "the supervisor sends zero from a trip to the end of the run",
    "device_at_zero": "the device at zero after a trip",
    "cause_recorded": "every trip has its cause recorded",
    "keeps_synchronism": "synchronism kept if it is kept without control",
    "does_no_harm": f"ITAE at most {HARM:g} times that without control",
    "recorded": "the recording complete and readable",
    "as_computed": "the recording equal to the in-process run, bit for bit",
    "nothing_forged_acts": "no forged message has an effect",
}
CYCLING, FREQUENT = "limit cycle at the control rate", MONITORS["reversals"].limit
LISTED = 4  # number of places listed for a violated invariant


def invariant_table(rows: Rows, names: Sequence[str] = INVARIANTS) -> list[str]:
    """Invariants: number of draws in which each holds; faults, systems and scenarios in which it does not."""
    lines = []
    for name in names:
        asked = [row for row in rows if row.get(name) is not None]
        failed = [row for row in asked if not row[name]]
        places = _max(failed, lambda row: f"{row['fault']}, {row['base_run']} {row.get('scenario', '')}".strip())
        lines.append([WORDS[name], str(len(asked)), str(len(failed)), percent(len(failed), len(asked)), places])
    return table(["what must hold", "cases", "violated", "%", "most frequent"], lines, 1, markdown=True)


def fault_table(rows: Rows) -> list[str]:
    """By fault: armed draws, how many fell back and tripped, how soon, and the most frequent cause."""
    lines = []
    for fault in FAULTS:
        own = [row for row in rows if row["fault"] == fault and row["armed_s"] is not None and not row["early"]]
        if own:
            counts = [sum(row[name] is not None for row in own) for name in ("fallback_s", "tripped_s")]
            detected = [row for row in own if row["detected_s"] is not None]
            causes = _max(detected, lambda row: str(row["fallback_cause"] or row["cause"]))
            lines.append(
                [fault, str(len(own)), *map(str, counts), *_times([row["detected_s"] for row in detected]), causes]
            )
    heads = ["fault", "armed", "fell back", "tripped", "median, s", "99 %, s", "monitor"]
    return table(heads, lines, 1, markdown=True)


def grid_table(rows: Rows) -> list[str]:
    """Effects on the grid of faults that make control wrong, with and without supervision."""
    lines = []
    groups: dict[str, Callable[[dict[str, Any]], bool]] = {
        fault: (lambda row, fault=fault: row["fault"] == fault)  # type: ignore[misc]
        for fault, row in FAULTS.items()
        if row.wrong
    }
    calm = f"nothing fails, {CYCLING}"
    groups[calm] = lambda row: row["fault"] == NOTHING and row["reversals"] > FREQUENT
    for name, fits in groups.items():
        own = [row for row in rows if fits(row) and row["unsupervised_keeps_synchronism"] is not None]
        if own:
            cells = [
                [str(sum(not row[f"{which}keeps_synchronism"] for row in own)), *_ratios(own, which)]
                for which in ("", "unsupervised_")
            ]
            lines.append([name, str(len(own)), *(" / ".join(pair) for pair in zip(*cells, strict=True))])
    heads = ["what is wrong", "cases", "synchronism lost", "ITAE, median", "ITAE, 90 %", "ITAE, 99 %"]
    return table(heads, lines, 1, markdown=True)


def place_table(rows: Rows) -> list[str]:
    """By system and scenario: how often ITAE exceeds that without control, and how often before or without a fault."""
    lines = []
    for place in sorted({(row["base_run"], row.get("scenario", "")) for row in rows}):
        own = [row for row in rows if (row["base_run"], row.get("scenario", "")) == place]
        above = [row for row in own if not row["does_no_harm"]]
        calm = sum(row["early"] or row["fault"] == NOTHING for row in above)
        bare = [row for row in own if row.get("unsupervised_does_no_harm") is False]
        plain = [row["uncontrolled_ITAE"] for row in own if row["uncontrolled_ITAE"] is not None]
        without = f"{median(plain):.3g}" if plain else "synchronism lost"
        lines.append([" ".join(place), str(len(own)), without, str(len(above)), str(calm), str(len(bare))])
    heads = ["system, scenario", "cases", "ITAE without control", f"above {HARM:g}", "of these before a fault"]
    heads.append("unsupervised")
    return table(heads, lines, 1, markdown=True)


def cost_table(rows: Rows) -> list[str]:
    """Cost of supervision without faults: false trips, and loss of damping."""
    healthy = [row for row in rows if row["fault"] == NOTHING]
    sound = [row for row in healthy if row.get("sound")]
    false = [row for row in sound if row["tripped_s"] is not None or row["fallback_s"] is not None]
    interval = "-"
    if sound:
        of = {name: 100 * value for name, value in failed_fraction(len(false), len(sound)).items()}
        interval = f"{of['fraction']:.2f} % ({of['low']:.2f} to {of['high']:.2f} %)"
    pairs = [row["ITAE"] / row["unsupervised_ITAE"] for row in sound if row["ITAE"] and row["unsupervised_ITAE"]]
    both = f"{median(pairs):.3f}, {np.percentile(pairs, 99):.3f}" if pairs else "-"
    is_sound = f"damped without supervision, ITAE at most that without control, no {CYCLING}"
    found = [
        ["cases in which nothing fails", str(len(healthy))],
        [f"of these sound: {is_sound}", str(len(sound))],
        ["of these tripped or fallen back", f"{len(false)}: {interval}"],
        ["ITAE with supervision relative to without: median, 99 %", both],
    ]
    return table(["what", "found"], found, 1, markdown=True)


def controller_table(rows: Rows) -> list[str]:
    """By controller: how often it was armed, tripped without a fault, and did harm."""
    lines = []
    for name in dict.fromkeys((row["controller"], row["scheme"]) for row in rows):
        own = [row for row in rows if (row["controller"], row["scheme"]) == name]
        calm = [row for row in own if row["fault"] == NOTHING and row["armed_s"] is not None]
        tripped = sum(row["tripped_s"] is not None for row in calm)
        harmful = sum(not row["does_no_harm"] for row in own)
        kept = sum(not row["keeps_synchronism"] for row in own)
        counts = [str(len(own)), f"{tripped} of {len(calm)}", str(harmful), str(kept)]
        lines.append([" ".join(part for part in name if part), *counts])
    heads = ["controller", "cases", "tripped although nothing failed", f"ITAE above {HARM:g}", "synchronism lost"]
    return table(heads, sorted(lines), 1, markdown=True)


def page(made: Plan, rows: Rows, graphs: Rows, command: str) -> str:
    """The page of a campaign: the text beside its file, or a default one, with the tables inserted."""
    folder = share_folder() / "config" / "campaigns"
    own = folder / f"{made.name}.md"
    text = (own if own.is_file() else folder / "any.md").read_text(encoding="utf-8")
    about = {"name": [made.name], "description": [made.campaign.description], "command": [f"    {command}"]}
    for key, lines in {**about, **sections(rows, graphs), "counts": [f"{counts(rows)}."]}.items():
        text = text.replace(f"{{{{{key}}}}}", "\n".join(lines) or "None was made.")
    return text


def holds(row: dict[str, Any]) -> bool:
    """Whether all invariants hold for a draw or a graph."""
    return study.holds(row, tuple(WORDS))


def overview(rows: Rows, graphs: Rows) -> list[str]:
    """Summary for a terminal."""
    found = sections(rows, graphs)
    shown = [counts(rows), *found["invariants"], "", *found["cost"]]
    return shown + (["", f"{len(graphs)} graphs", *found["graphs"]] if graphs else [])


def sections(rows: Rows, graphs: Rows) -> dict[str, list[str]]:
    """All tables of a campaign, by name."""
    good = [row for row in rows if row["error"] is None]
    wrong = [row for row in good if row["wrong"]]
    found = {
        "invariants": invariant_table(good),
        "wrong": invariant_table(wrong, ("does_no_harm",)),
        "faults": fault_table(good),
        "controllers": controller_table(good),
        "places": place_table(good),
        "cost": cost_table(good),
        "grid": grid_table(good) if any("unsupervised_ratio" in row for row in good) else [],
    }
    sound = [row for row in graphs if row["error"] is None]
    return found | {"graphs": invariant_table(sound, tuple(WORDS)) if sound else []}


def counts(rows: Rows) -> str:
    """The numbers of cases as a sentence."""
    errors = sum(row["error"] is not None for row in rows)
    kinds = len({row["fault"] for row in rows if row["error"] is None} - {NOTHING})
    faults = {0: "without a fault", 1: "with one fault"}.get(kinds, f"with {kinds} faults")
    return f"{len(rows)} cases {faults}" + (f", {errors} with an error" if errors else "")


def _max(rows: Rows, what: Callable[[dict[str, Any]], str]) -> str:
    found: dict[str, int] = {}
    for row in rows:
        found[what(row)] = found.get(what(row), 0) + 1
    ranked = sorted(found.items(), key=lambda one: -one[1])
    more = [f"{len(ranked) - LISTED} others"] if len(ranked) > LISTED else []
    return "; ".join([*(f"{name} {count}" for name, count in ranked[:LISTED]), *more]) or "-"


def percent(part: int, of: int) -> str:
    """A fraction in per cent, to two digits after the point."""
    return f"{100.0 * part / of:.2f}" if of else "-"


def _times(found: Sequence[float]) -> list[str]:
    return [f"{median(found):.2f}", f"{np.percentile(found, 99):.2f}"] if found else ["-", "-"]


def _ratios(rows: Rows, which: str) -> list[str]:
    """Quantiles of ITAE relative to no control; a run that loses synchronism alone counts as the largest."""
    values = [math.inf if not row[f"{which}keeps_synchronism"] else row[f"{which}ratio"] for row in rows]
    known = [value for value in values if value is not None]
    method = "higher" if math.inf in known else "linear"  # nothing lies between a number and infinity
    found = [np.percentile(known, q, method=method) for q in (50, 90, 99)] if known else []  # type: ignore[call-overload]
    return ["lost" if math.isinf(x) else f"{x:.2f}" for x in found] or ["-"] * 3
