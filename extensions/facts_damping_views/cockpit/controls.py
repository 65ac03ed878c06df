"""What the controls of a cockpit become: a service with its request, or a line for the program that runs the graph.

Each goes through what the nodes offer anyway, so that every change is checked, published and recorded by them.
"""

from __future__ import annotations

import json
import math
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.case import names
from facts_damping.control.table import kind_of
from facts_damping.errors import InputError, check_known
from facts_damping.parameters.supervision import watches
from facts_damping.plant.grid.power_flow import solve
from facts_damping_views.cockpit.layout import PLANT

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from facts_damping.case.model import Case

TRIGGER, APPLY, STEP, PARAMETER = "trigger", "apply", "step", "parameter"  # kinds of requests: services of nodes,
LINE, REPORT, PRESET = "line", "report", "preset"  # and others
AGAIN, EVENT = "again", "event"  # lines for the program that runs the graph; the second begins so
ALL = "all"  # choice of a channel: all PMUs of the link

Values = dict[tuple[str, str], Any]  # what sliders and toggles stand at, by control and channel


class Request(NamedTuple):
    """A call of a service of a node, `kind` TRIGGER, APPLY, STEP or PARAMETER; a LINE for the launcher; a REPORT.

    Or a PRESET, which gives values to other controls one after the other. `content`: the change as text, the number of
    ticks, name and value of the parameter, the line, or the moves of the preset (`Move`).
    """

    kind: str
    service: str = ""
    content: Any = ""


START_AGAIN = Request(LINE, "", AGAIN)


class Move(NamedTuple):
    """A value that a preset gives to another control, some seconds after the one before."""

    wait_s: float
    control: str
    value: Any


class Control(NamedTuple):
    """A control: as the page gets it, and the request that a value becomes, given all values with it."""

    shown: dict[str, Any]
    request: Callable[[Any, Values], Request]
    keeps: bool = False  # it stands at its value: a slider or a toggle

    @property
    def id(self) -> str:
        """Its name in messages."""
        return str(self.shown["id"])


SLIDERS = {  # of a link: label, unit, largest value, step
    "delay": ("added delay", "ms", 500.0, 5.0),
    "jitter": ("added jitter", "ms", 200.0, 5.0),
    "loss": ("loss", "%", 100.0, 1.0),
}
GROWTH = (10.0, 400.0, 0.5)  # of the delay that a preset adds: step and end, ms; wall time between two steps, s
SIGN = "preset/sign"  # the toggle of the wrong sign
COMMANDS = ("arm", "disarm", "reset", "probe")  # of a supervisor


def controls(case: Case, *, launched: bool = False, paced: bool = True, again: bool = False) -> dict[str, Control]:
    """Controls of a case by id. `paced`: by the clock.

    `launched`: the program that runs the graph reads lines; `again`: and starts it again.
    """
    all_controls = [
        *_presets(case),
        *_link(case),
        *_grid(case),
        *_supervisors(case),
        *_nodes(case, launched=launched and paced),
        *_run(again=again),
    ]
    return {control.id: control for control in all_controls}


def _shown(name: str, label: str, kind: str, **more: Any) -> dict[str, Any]:
    usual: dict[str, Any] = {"unit": "", "low": None, "high": None, "step": None, "value": None, "fields": []}
    usual["hint"] = ""  # what to know before it is used
    return {"id": name, "group": name.partition("/")[0], "label": label, "kind": kind, **usual, **more}


def _choice(name: str, choices: list[str], value: str = "") -> dict[str, Any]:
    return {"name": name, "kind": "choice", "choices": choices, "value": value or choices[0], "unit": ""}


def _number(name: str, unit: str, low: float, high: float, value: float) -> dict[str, Any]:
    return {"name": name, "kind": "number", "low": low, "high": high, "value": value, "unit": unit}


def _presets(case: Case) -> list[Control]:
    """What one wants to see first, of the first link and controller: ordinary changes, each as if made by hand."""
    here = f"link/{names.link_addresses(case)[0]}"

    def grow(_: Any, values: Values) -> Request:
        step, end, wait_s = GROWTH
        begin = float(values.get((f"{here}/delay", ALL), 0.0))
        steps = range(1, 1 + max(0, math.ceil((end - begin) / step)))
        return Request(PRESET, "", [Move(wait_s, f"{here}/delay", min(end, begin + k * step)) for k in steps])

    fail = Request(PRESET, "", [Move(0.0, f"{here}/cut", True)])
    presets = [
        Control(_shown("preset/delay", "a delay that grows", "button"), grow),
        Control(_shown("preset/cut", "a link that fails", "button"), lambda _, __: fail),
    ]
    if case.controllers:
        place = "in the controller" if _has_gain(case) else "behind the supervisor"
        shown = _shown(SIGN, f"wrong sign {place}", "toggle", value=False)
        presets.append(Control(shown, partial(_wrong_sign, case), keeps=True))
    return presets


def _has_gain(case: Case) -> bool:
    """Whether the first controller has a gain that can be changed during a run."""
    parameter = kind_of(case.controllers[0]).parameters.get("gain")
    return parameter is not None and parameter.live


def _wrong_sign(case: Case, wrong: Any, values: Values) -> Request:
    """The gain of the first controller, or if it has none its setpoints on their way, with the other sign."""
    if not _has_gain(case):
        return _linked(case, case.used_links[0], wrong, values)
    gain: Any = case.controllers[0].parameters["gain"]
    sign = -1.0 if wrong else 1.0
    value = [sign * of_device for of_device in gain] if isinstance(gain, list) else sign * gain
    return Request(PARAMETER, f"{names.controller_addresses(case)[0]}/set_parameters", ("gain", value))


def _jump_hint(case: Case) -> str:
    """What a jump of the delay does, if a supervisor waits for frames."""
    watch = None if case.supervision is None else watches(case.supervision)["missing"]
    if watch is None or not watch.follows:
        return ""
    return f"a jump over {1e3 * watch.limit:.0f} ms leaves a gap: the supervisor trips by missing"


def _link(case: Case) -> list[Control]:
    link_controls = []
    for i, address in enumerate(names.link_addresses(case)):
        channel = _choice("channel", [ALL, *(pmu.name for pmu in case.system.pmus), *case.run.devices])
        request = partial(_linked, case, i)
        for name, (label, unit, high, step) in SLIDERS.items():
            more: dict[str, Any] = {"unit": unit, "low": 0.0, "high": high, "step": step, "value": 0.0}
            more |= {"fields": [channel], "hint": _jump_hint(case) if name == "delay" else ""}
            shown = _shown(f"link/{address}/{name}", f"{address}: {label}", "slider", **more)
            link_controls.append(Control(shown, request, keeps=True))
        shown = _shown(f"link/{address}/cut", f"{address}: cut", "toggle", value=False)
        link_controls.append(Control(shown, request, keeps=True))
    return link_controls


def _linked(case: Case, link: int, _: Any, values: Values) -> Request:
    """The run's link with what the sliders add at the end of its stages; both ways are lost while it is cut."""
    address = names.link_addresses(case)[link]
    content = case.links[link].model_dump()
    here = f"link/{address}/"
    channels = dict.fromkeys(channel for name, channel in values if name.startswith(here))
    for channel in channels:
        delay, jitter, loss = (float(values.get((f"{here}{name}", channel), 0.0)) for name in SLIDERS)
        added: list[dict[str, Any]] = []
        if jitter:
            added.append({"model": "uniform", "low": delay / 1e3, "high": (delay + jitter) / 1e3})
        elif delay:
            added.append({"model": "constant", "delay": delay / 1e3})
        if loss:
            added.append({"model": "bernoulli", "loss": loss / 100.0})
        way = "down" if channel in case.run.devices else "up"
        on = {} if channel in (ALL, "") else {"channels": [channel]}
        content[way] += [{"stage": "network", **stage, **on} for stage in added]
    if values.get((SIGN, "")) and link == case.used_links[0] and not _has_gain(case):
        content["down"].append({"stage": "network", "model": "scale", "factor": -1.0})
    if values.get((f"{here}cut", "")):
        for way in ("up", "down"):
            content[way].append({"stage": "network", "model": "bernoulli", "loss": 1.0})
    return Request(APPLY, f"{address}/apply", json.dumps(content))


def _grid(case: Case) -> list[Control]:
    system = case.system
    lines = [*(row.name for row in system.lines), *(row.name for row in system.transformers)]
    loads = {load.name: load.P for load in system.loads if load.P}
    flow = solve(system, case.run.devices)
    machines = {m.name: flow.generation[m.name].real * system.base_power for m in system.machines}
    sources = {name: power for name, power in (loads | machines).items() if abs(power) > 1e-6}
    largest = max((abs(power) for power in (loads | machines).values()), default=1.0)
    grid_controls = []

    def add(name: str, label: str, fields: list[dict[str, Any]], event: Callable[[Any], dict[str, Any]]) -> None:
        shown = _shown(f"grid/{name}", label, "form", fields=fields)
        grid_controls.append(
            Control(shown, lambda value, _: Request(APPLY, f"{PLANT}/apply", json.dumps(event(value))))
        )

    buses = _choice("bus", [bus.name for bus in system.buses])
    duration = _number("duration", "s", 0.01, 1.0, 0.1)
    add("fault", "fault at a bus", [buses, duration], lambda value: {"kind": "fault", **value})
    if lines:
        way = _choice("to", ["out", "in"])
        add(
            *("line", "line or transformer out, in", [_choice("line", lines), way]),
            lambda value: {"kind": f"line_{value['to']}", "line": value["line"]},
        )
    if loads:
        change = _number("change", "MW", -largest, largest, round(0.05 * largest, 1))
        add(
            *("load", "load step", [_choice("load", list(loads)), change]),
            lambda value: {
                "kind": "load_step",
                "load": value["load"],
                "change": round(value["change"] / loads[value["load"]], 6),
            },
        )
    if sources:
        of = [_number("frequency", "Hz", 0.05, 2.5, 0.5), _number("amplitude", "MW", 0.0, largest, 0.01 * largest)]
        more = [_number("ramp", "s", 0.0, 60.0, 2.0), _number("duration", "s", 1.0, 600.0, 30.0)]
        add(
            *("oscillation", "forced oscillation", [_choice("source", list(sources)), *of, *more]),
            lambda value: {
                "kind": "forced_oscillation",
                ("machine" if value["source"] in machines else "load"): value["source"],
                **{name: value[name] for name in ("frequency", "ramp", "duration")},
                "amplitude": round(value["amplitude"] / abs(sources[value["source"]]), 6),
            },
        )
    rearm = Request(TRIGGER, f"{PLANT}/rearm")
    return [*grid_controls, Control(_shown("grid/rearm", "re-arm released devices", "button"), lambda _, __: rearm)]


def _button(name: str, label: str, request: Request) -> Control:
    return Control(_shown(name, label, "button"), lambda _, __: request)


def _supervisors(case: Case) -> list[Control]:
    controllers = names.controller_addresses(case)
    return [
        _button(f"supervisor/{controllers[c]}/{what}", f"{controllers[c]}: {what}", Request(TRIGGER, f"{node}/{what}"))
        for c, node in names.supervisor_addresses(case).items()
        for what in COMMANDS
    ]


def _nodes(case: Case, *, launched: bool) -> list[Control]:
    """Kill and restart, where the launcher does it; arm, for what joined."""
    controllers = {
        str(a) for a, c in zip(names.controller_addresses(case), case.controllers, strict=True) if kind_of(c).node
    }
    node_controls, supervisors = [], {str(address) for address in names.supervisor_addresses(case).values()}
    for node in names.replaceable(case):
        if launched and node not in controllers:
            node_controls += [
                _button(f"nodes/{node}/{what}", f"{what} {node}", Request(LINE, "", f"{what} {node}"))
                for what in ("kill", "restart")
            ]
        if node not in controllers | supervisors:
            node_controls.append(_button(f"nodes/{node}/arm", f"arm {node}", Request(TRIGGER, f"{node}/arm")))
    return node_controls


def _run(*, again: bool) -> list[Control]:
    start = [Control(_shown("run/again", "again", "button"), lambda _, __: START_AGAIN)] if again else []
    run_controls = [
        _button(f"run/{what}", what, Request(TRIGGER, f"{PLANT}/{what}")) for what in ("pause", "resume", "reset")
    ]
    step = _shown("run/step", "step", "form", fields=[_number("ticks", "ticks", 1, 6000, 1)])
    run_controls.append(Control(step, lambda value, _: Request(STEP, f"{PLANT}/step", round(value["ticks"]))))
    return [*start, *run_controls, _button("run/report", "report of what is recorded so far", Request(REPORT))]


def checked(control: Control, value: Any) -> tuple[str, Any]:
    """Channel (empty: none) and value, as the control allows it. Raises `InputError` naming what is allowed.

    A slider takes a number, or `{"value": number, "channel": name}`; a toggle true or false; a form its fields, where
    one that is missing has the value shown; a button nothing.
    """
    shown = control.shown
    if shown["kind"] == "toggle":
        if not isinstance(value, bool):
            raise InputError(f"{control.id}: {_short(value)} given; allowed: true, false")
        return "", value
    if shown["kind"] == "slider":
        request_fields = value if isinstance(value, dict) else {"value": value}
        _only(control.id, request_fields, ("value", "channel"))
        channel = request_fields.get("channel", ALL)
        _choose(f"{control.id}: channel", channel, shown["fields"][0]["choices"])
        return str(channel), _within(control.id, request_fields.get("value"), shown["low"], shown["high"])
    if shown["kind"] == "button":
        return "", None
    if not isinstance(value, dict):
        raise InputError(f"{control.id}: {_short(value)} given; allowed: {{field: value}}")
    fields = {field["name"]: field for field in shown["fields"]}
    _only(control.id, value, fields)
    return "", {
        name: _field(f"{control.id}: {name}", field, value.get(name, field["value"])) for name, field in fields.items()
    }


def _field(where: str, field: Mapping[str, Any], value: Any) -> Any:
    if field["kind"] == "number":
        return _within(where, value, field["low"], field["high"])
    _choose(where, value, field["choices"])
    return value


def _choose(where: str, value: Any, choices: list[str]) -> None:
    check_known(where, value if isinstance(value, str) else _short(value), choices)


def _only(where: str, fields: Mapping[str, Any], allowed: Any) -> None:
    for name in fields:
        if name not in allowed:
            raise InputError(f"{where}: field {_short(name)} given; allowed: {', '.join(allowed)}")


def _within(where: str, value: Any, low: float, high: float) -> float:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not number or not low <= value <= high or math.isnan(value):
        raise InputError(f"{where}: {_short(value)} given; allowed: {low:g} to {high:g}")
    return float(value)


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:40]}..."
