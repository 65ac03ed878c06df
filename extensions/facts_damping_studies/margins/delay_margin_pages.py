"""Output of the delay study: lines for the terminal, JSON, a picture."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from facts_damping.analysis.plotting.plots import COLOURS
from facts_damping.case.names import controller_names
from facts_damping.output.picture_files import save_picture
from facts_damping.plant.grid import power_flow
from facts_damping.small_signal.modal_tables import figures
from facts_damping_studies.margins.criteria import CRITERIA
from facts_damping_studies.margins.delay_margin import DRIFT
from facts_damping_studies.parameters import DAMPING_RATIO

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from facts_damping.small_signal import eigenmodes
    from facts_damping_studies.margins.delay_margin import Margin, Track
    from facts_damping_studies.margins.delay_margin_runs import Beside

ROW = 0.02  # s, between the rows of the table
BEYOND = 0.1  # s, range of table and picture beyond the margin
DPI = 130
MAXIMUM = 7  # largest number of modes in terminal and picture
SHOWN = ("frequency_hz", "damping_ratio")
PADE = {"held": "delay and half a frame", "continuous": "delay alone"}


def names(margin: Margin) -> list[str]:
    """Names of the followed modes: their kind, numbered where several are of one kind."""
    kinds = [track.label for track in margin.tracks]
    return [kind if kinds.count(kind) == 1 else f"{kind} {kinds[: i + 1].count(kind)}" for i, kind in enumerate(kinds)]


def rows(margin: Margin) -> list[int]:
    """Indices of the delays in the table: every 20 ms."""
    return [i for i, delay in enumerate(margin.delays) if abs(delay / ROW - round(delay / ROW)) < 1e-6]


def shown_to(margin: Margin) -> float:
    """Upper limit of delay in the terminal's table and the picture, s: somewhat beyond the last stability limit."""
    limits = [end for ends in margin.stable for end in ends if end < margin.delays[-1]]
    return min(float(margin.delays[-1]), max(limits, default=float(margin.delays[-1])) + BEYOND)


def shown(margin: Margin) -> list[tuple[str, Track]]:
    """The displayed modes with their names: all, or if there are many, those whose damping depends most on delay."""
    named = list(zip(names(margin), margin.tracks, strict=True))
    if len(named) <= MAXIMUM:
        return named
    in_view = margin.delays <= shown_to(margin) + 1e-9

    def moved(track: Track) -> float:
        ratios = [
            mode.damping_ratio for mode, near in zip(track.modes, in_view, strict=True) if near and mode is not None
        ]
        return max(ratios, default=0.0) - min(ratios, default=0.0)

    maximum = sorted(margin.tracks, key=moved, reverse=True)[:MAXIMUM]
    return [(name, track) for name, track in named if any(track is top_track for top_track in maximum)]


def margin_text(margin: Margin, beside: Beside | None) -> Iterator[str]:
    """Lines for the terminal."""
    case, longest = margin.case, margin.delays[-1]
    controllers_text = ", ".join(f"{c.name} from {c.signals[0]} to {'+'.join(c.devices)}" for c in case.controllers)
    yield f"{case.system.name}: {controllers_text}; {case.run.frame_rate} frames/s"
    if max(margin.own) - min(margin.own) <= 0.0:
        yield f"delay: from measurement to device, in place of the link's mean of {_ms(margin.own[0])}"
    else:
        longer = ", ".join(_ms(delay - min(margin.own)) for delay in margin.own)
        yield f"delay: from measurement to device, of the shortest link; the links are longer than that by {longer}"
    limit = _limit(margin.margin, longest)
    if margin.critical is not None:
        hertz = margin.critical.frequency_hz
        limit += f": there {f'a mode of {hertz:.3f} Hz grows' if hertz > DRIFT else 'a real eigenvalue grows: drift'}"
    yield f"\ndelay margin, linear, sampled and held      {limit}"
    for name, value in margin.pade.items():
        yield f"{f'  with a Pade term, {PADE[name]}':<43} {_limit(value, longest)}"
    yield f"{f'stable, of 0 to {_ms(longest)}':<43} {_spans(margin.stable)}"
    yield f"{f'damping ratios of at least {100 * DAMPING_RATIO:g} %':<43} {_spans(margin.damped)}"
    if beside is not None:
        yield from _runs(margin, beside)
    named = shown(margin)
    heads = [f"{name}: Hz, ratio" for name, _ in named]
    wide = max(26, *(len(head) + 2 for head in heads))
    yield "\ndelay ms  " + "".join(f"{head:>{wide}}" for head in heads) + "   growth 1/s of, Hz"
    for i in rows(margin):
        if margin.delays[i] <= shown_to(margin) + 1e-9:
            cells = "".join(f"{_cell(track.modes[i]):>{wide}}" for _, track in named)
            worst = margin.worst[i]
            yield f"{1e3 * margin.delays[i]:8.0f}  {cells}{worst.real:13.4f}{worst.imag / (2.0 * np.pi):8.3f}"
    if len(named) < len(margin.tracks):
        yield f"and {len(margin.tracks) - len(named)} modes that the delay moves less, in --json"


def _spans(intervals: Sequence[Sequence[float]]) -> str:
    return ", ".join(f"{1e3 * a:.4g} to {_ms(b)}" for a, b in intervals) or "nowhere"


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.4g} ms"


def _limit(value: float | None, longest: float) -> str:
    return f"beyond {_ms(longest)}" if value is None else _ms(value)


def _cell(mode: eigenmodes.Eigenmode | None) -> str:
    return "-" if mode is None else f"{mode.frequency_hz:.4f}  {mode.damping_ratio:7.4f}"


def _runs(margin: Margin, beside: Beside) -> Iterator[str]:
    near = "not near the linear margin" if beside.pulse is None else _ms(beside.pulse)
    yield f"time domain, a pulse of 0.01 %              {near}"
    for row in beside.scenario:
        words = f"  {margin.case.scenario.name}, {CRITERIA[row.criterion].holds} over {row.horizon:g} s"
        yield f"{words:<43} {_spans(row.holds)}"
    yield "\ndelay ms   ringdown of a run: Hz, ratio       linear: Hz, ratio"
    for delay, modes in beside.ringdown:
        for mode in modes:
            other = nearest(margin, delay, mode.frequency_hz)
            yield f"{1e3 * delay:8.0f}   {mode.frequency_hz:15.4f}  {mode.damping_ratio:7.4f}  {_cell(other):>26}"


def nearest(margin: Margin, delay: float, hertz: float) -> eigenmodes.Eigenmode | None:
    """The followed linear mode with the nearest frequency."""
    i = int(np.argmin(np.abs(margin.delays - delay)))
    there = [track.modes[i] for track in margin.tracks]
    return min((m for m in there if m is not None), key=lambda m: abs(m.frequency_hz - hertz), default=None)


def document(margin: Margin, beside: Beside | None) -> dict[str, Any]:
    """The JSON of `margin` (docs/results_json.md)."""
    content: dict[str, Any] = {
        "run": margin.case.summary(),
        "link_delays_s": margin.own,
        "margin_s": margin.margin,
        "critical": None if margin.critical is None else figures(margin.critical),
        "stable_s": [list(span) for span in margin.stable],
        "damped_s": [list(span) for span in margin.damped],
        "longest_s": float(margin.delays[-1]),
        "pade_s": margin.pade,
        "delays": [
            {
                "delay_s": float(margin.delays[i]),
                "growth": float(margin.worst[i].real),
                "growth_hz": float(margin.worst[i].imag / (2.0 * np.pi)),
                "modes": [
                    {"name": name, **figures(mode)}
                    for name, mode in zip(names(margin), (track.modes[i] for track in margin.tracks), strict=True)
                    if mode is not None
                ],
            }
            for i in range(len(margin.delays))
        ],
    }
    if beside is not None:
        content["time_domain"] = {
            "pulse_s": beside.pulse,
            "scenario": [
                {"criterion": x.criterion, "horizon_s": x.horizon, "holds_s": x.holds} for x in beside.scenario
            ],
            "ringdown": [
                {"delay_s": delay, "modes": [{name: getattr(mode, name) for name in SHOWN} for mode in modes]}
                for delay, modes in beside.ringdown
            ],
        }
    return content


def plot_loops(margin: Margin, path: Path) -> Path:
    """The one-line diagram with the paths of the control loops, and the mode at the margin, as PNG."""
    from facts_damping_studies.modes import one_line  # noqa: PLC0415 (its library takes a while to be loaded)

    case = margin.case
    loops = []
    for c, name in enumerate(controller_names(case)):
        row = case.controllers[c]
        pmus = list(dict.fromkeys(s for signal in row.signals for s in case.system.signals[signal].weights))
        late = _ms(margin.own[case.used_links[c]])
        loops.append(one_line.Loop(f"{name}: {', '.join(row.signals)}, {late}", pmus, list(row.devices)))
    flow = power_flow.solve(case.system, case.run.devices)
    return one_line.plot(case.system, flow, case.run.devices, margin.critical, path, loops)


def plot(margin: Margin, beside: Beside | None, path: Path) -> Path:
    """Damping ratio and frequency of the modes against delay, with the margin marked, as PNG."""
    figure = Figure(figsize=(7.5, 6.5), layout="constrained")
    damping, frequency = figure.subplots(2, 1, sharex=True, height_ratios=[1.4, 1.0])
    end = shown_to(margin)
    in_view = margin.delays <= end + 1e-9
    ends = [0.0, *(limit for span in margin.stable for limit in span), end]  # between them unstable and stable in turn
    points = [(1e3 * delay, mode) for delay, modes in (beside.ringdown if beside else ()) for mode in modes]
    for axes, field in ((damping, "damping_ratio"), (frequency, "frequency_hz")):
        for (name, track), colour in zip(shown(margin), COLOURS, strict=False):
            values = np.array([np.nan if m is None else getattr(m, field) for m in track.modes])
            axes.plot(1e3 * margin.delays[in_view], values[in_view], color=colour, lw=1.8, label=name)
        if beside is not None:
            xy = [at for at, _ in points], [getattr(mode, field) for _, mode in points]
            axes.plot(*xy, "ko", ms=5, mfc="none", label="ringdown of runs")
        if margin.margin:
            axes.axvline(1e3 * margin.margin, color="black", ls="--", lw=1.0)
        for a, b in zip(ends[::2], ends[1::2], strict=True):
            if min(b, end) > a:
                axes.axvspan(1e3 * a, 1e3 * min(b, end), color="0.9", zorder=0)
        axes.grid(visible=True, alpha=0.3)
        axes.set_xlim(0.0, 1e3 * end)
    damping.axhline(0.0, color="black", lw=0.8)
    if margin.margin:
        place: dict[str, Any] = {"xytext": (6, 10), "textcoords": "offset points", "fontsize": 9}
        damping.annotate(f"margin {_ms(margin.margin)}", (1e3 * margin.margin, 0.0), **place)
    damping.set_ylabel("damping ratio")
    frequency.set(ylabel="frequency [Hz]", xlabel="delay from measurement to device [ms]; shaded: not stable")
    damping.legend(fontsize=9)
    controllers_text = ", ".join(f"{c.name}, {c.signals[0]} to {'+'.join(c.devices)}" for c in margin.case.controllers)
    figure.suptitle(
        f"{margin.case.system.name}: {controllers_text}, {margin.case.run.frame_rate} frames/s", fontsize=11
    )
    return save_picture(figure, path, dpi=DPI, metadata={"Software": None})
