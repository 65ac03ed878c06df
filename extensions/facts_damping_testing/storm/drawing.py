"""Draws storms: a run, its graph, and events, from a seed."""

from __future__ import annotations

import random
from typing import Any

from facts_damping.case.loading import make_case
from facts_damping_testing.storm.choices import Chance
from facts_damping_testing.storm.events import KINDS
from facts_damping_testing.storm.model import Event, Storm

RATES = (10, 10, 15, 20, 20, 25, 30, 60)  # frames/s
MODES: tuple[Any, ...] = ("lockstep", "lockstep", "realtime", "realtime", "free")
DURATIONS = (0.5, 1.0, 1.0, 2.0, 2.0, 3.0, 4.0)  # s
LONG_DURATIONS = 30.0, 300.0  # s; lowest and highest of long storms
CONTROLLERS: tuple[list[dict[str, Any]], ...] = (
    [{"name": "LLC"}],
    [{"name": "LLC-tuned"}],
    [{"name": "HBsWC", "scheme": "direct"}],
    [{"name": "HBsWC"}],
    [{"name": "ANFTSC"}],
    [{"name": "mine", "external": True}],
    [],
    [{"name": "LLC"}, {"name": "LLC-tuned", "signals": ["power"], "fallback_of": 0, "link": "ideal"}],
)
OF_TWO: tuple[list[dict[str, Any]], ...] = (
    [{"name": "LLC"}, {"name": "LLC", "devices": ["statcom"], "signals": ["w34"]}],
    [{"name": "ANFTSC", "devices": ["sssc", "statcom"]}],
)
STAGES: tuple[dict[str, Any], ...] = (
    {"model": "constant", "delay": 0.05},
    {"model": "uniform", "low": 0.0, "high": 0.1},
    {"model": "bernoulli", "loss": 0.1},
    {"model": "gilbert_elliott", "p_GB": 0.05, "p_BG": 0.3},
    {"model": "duplicate", "probability": 0.3},
    {"model": "flip", "probability": 0.01},
)
SUPERVISIONS: tuple[dict[str, Any], ...] = (
    {},
    {},
    {"supervision": "standard", "arm_at": 0.2},
    {"supervision": "standard", "arm_at": 0.0},
    {"supervision": "standard"},
    {"supervision": "strict"},
)


def _link(chance: random.Random) -> Any:
    if chance.random() < 0.4:
        return chance.choice(["ideal", "fibre", "pdci"])
    ways = {way: [dict(stage) for stage in chance.sample(STAGES, chance.randrange(3))] for way in ("up", "down")}
    return {"description": "", **ways}


def _run(chance: random.Random) -> dict[str, Any]:
    """A run of a small system."""
    system = chance.choice(["smib", "smib", "two_area"])
    run: dict[str, Any] = {
        "system": system,
        "scenario": chance.choice({"smib": ["nominal", "heavy"], "two_area": ["small", "large"]}[system]),
        "duration": chance.choice(DURATIONS),
        "frame_rate": chance.choice(RATES),
        "controllers": chance.choice(CONTROLLERS if system == "smib" else CONTROLLERS[:-1] + OF_TWO),
        "link": _link(chance),
        "seed": chance.randrange(1000),
        **chance.choice(SUPERVISIONS),
    }
    if chance.random() < 0.2:
        run["watchdog"] = {"timeout": chance.choice([0.1, 0.3]), "release_rate": 1.0, "good": chance.choice([1, 3])}
    if chance.random() < 0.3:  # PMUs of class P report frequencies, not speeds
        signals = {"w34": "f34", "speed": "frequency"}
        run["measurement"] = "p_class"
        run["controllers"] = [
            row | {"signals": [signals.get(name, name) for name in row.get("signals", ["speed"])]}
            for row in run["controllers"]
        ]
    devices = {name for row in run["controllers"] for name in row.get("devices", ["sssc"])}
    if len(devices) > 1:
        run["devices"] = ["sssc", "statcom"]
    return run


def draw(seed: int) -> Storm:
    """The storm of a seed."""
    chance = random.Random(seed)
    run, mode = _run(chance), chance.choice(MODES)
    if not run["controllers"]:
        run |= {"supervision": None, "arm_at": None}
    elif run["controllers"][-1].get("fallback_of") is not None and run.get("supervision") is None:
        run["supervision"] = "standard"
    late = chance.random() < 0.3
    storm = Storm(
        seed=seed,
        mode=mode,
        run=run,
        signed=chance.random() < 0.5 and not any(row.get("external") for row in run["controllers"]),
        discovery=round(chance.uniform(0.0, 1.0), 3) if late else 0.0,
    )
    return _with_events(storm, chance)


def long(storm: Storm, chance: random.Random) -> Storm:
    """A storm like another one, but of minutes: at the lowest rate, with new events."""
    run = storm.run | {"duration": round(chance.uniform(*LONG_DURATIONS), 1), "frame_rate": min(RATES)}
    return _with_events(storm.model_copy(update={"run": run}), chance)


def _with_events(storm: Storm, chance: random.Random) -> Storm:
    case = make_case(dict(storm.run), f"storm {storm.seed}")
    events = [event(Chance(chance, case, storm.mode)) for _ in range(min(1 + int(chance.expovariate(0.5)), 8))]
    return storm.model_copy(update={"events": sorted(events, key=lambda storm_event: storm_event.at)})


def event(chance: Chance) -> Event:
    """An event of a random kind, at a random time."""
    names = [name for name, kind in KINDS.items() if chance.mode in kind.modes]
    weights = [KINDS[name].weight for name in names]
    kind = chance.random.choices(names, weights)[0]
    starts = KINDS[kind].starts or chance.random.random() < 0.1
    at = chance.random.uniform(-1.0, 0.0) if starts else chance.random.uniform(0.0, chance.duration)
    return Event(at=round(at, 4), kind=kind, **KINDS[kind].draw(chance))
