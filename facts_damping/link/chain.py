"""A chain of stages that entries pass in sequence; compiled.

A chain is a table of stages. A stage's model is a code that `traverse` branches on. Random numbers are drawn in advance
(`stages.py`), so `traverse` gives the time at which an entry leaves, in ns and not rounded to frames, or NEVER.
It processes all entries that are sent together: the PMUs of a frame, or one setpoint.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facts_damping import random_numbers
from facts_damping.compiling import compiled
from facts_damping.compiling.structs import Array, Bool1, Bool2, Float2, Float4, Int1, Int2, Int4, Struct
from facts_damping.link import stages as kinds
from facts_damping.signals import CHANNELS, NEVER, to_ns

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


FOREVER = NEVER

STAGE = np.dtype(
    [
        ("model", "i8"),
        ("from_ns", "i8"),  # start: acts on entries sent from this time on
        ("until_ns", "i8"),  # end: acts on entries sent before this time
        ("begin_ns", "i8"),  # start as in the file; a replay records its window before it
        ("delay_ns", "i8"),  # delay, wait, age or offset of time stamps
        ("number", "f8"),  # bias, factor, rate or standard deviation
        ("measurement", "i8"),  # column of the disturbed value; -1: all
        ("window", "i8"),  # entries in a replayed window, or draws of noise
        ("stamped", "i8"),  # 1: a wait counts from the time of sending
        ("complete", "i8"),  # 1: a wait ends when all entries have arrived
        ("hold", "i8"),  # 1: a missing entry is replaced by the last one
    ]
)


class Chain(Struct):
    """A chain of one direction of a link, with the state of its stages."""

    rows: Annotated[NDArray[Any], Array(STAGE, 1)]
    channel_mask: Bool2  # (stages, channels): the stage acts on the channel
    drawn: Int4  # (stages, draws, copies, channels): delay in ns, NEVER, or 1 for a copy
    last_ns: Int2  # (stages, channels): when the last entry left
    stored: Bool2  # (stages, channels): `kept` has an entry
    kept: Float4  # (stages, window, channels, width): values of earlier entries, draws of noise


class Chains(Chain, each=Chain):
    """Chains of several links; shorter ones are padded with stages without effect."""


class Packets(Struct):
    """Entries passing a chain, one per channel."""

    now_ns: Int2  # (copies, channels): time of leaving the stage; NEVER: lost
    stamp_ns: Int1  # (channels,): time of measurement; NEVER: no entry
    status: Int1  # (channels,): status bits of a frame's entry; none for a setpoint
    values: Float2  # (channels, width)
    number: Int1  # (channels,): number of entries sent before
    copied: Bool1  # (channels,)
    held: Bool1  # (channels,): lost and replaced by the last one


class AllPackets(Packets, each=Packets):
    """Entries of several links."""


class DirectionSpec(NamedTuple):
    """A direction of a run's links: channels, size and rate of entries, seed of random numbers."""

    channels: Sequence[str]  # PMUs or devices
    groups: Mapping[str, Sequence[str]]  # channels by group names that stages may use
    width: int  # number of values of an entry
    per_tick: int  # most entries sent in a tick, all channels together
    frame_rate: int
    draws: int
    seed: tuple[int, int]  # seed of the run, index of the direction


def chains(by_link: Sequence[Sequence[Any]], way: DirectionSpec) -> tuple[Chains, AllPackets]:
    """Build the chains of several links from their stages, and arrays for passing entries."""
    stages = [stage for listed in by_link for stage in listed]
    codes = [kinds.MODELS[stage.model].code for stage in stages]
    n, maximum, channels = len(by_link), max((len(listed) for listed in by_link), default=0), len(way.channels)
    draws = way.draws if any(code in kinds.CHANCE for code in codes) else 1
    copies = 2 if kinds.DUPLICATE in codes else 1
    windows = [_window(stage, way) for stage in stages if stage.model in ("replay", "noise")]
    built = Chains(
        rows=np.zeros((n, maximum), STAGE),
        channel_mask=np.zeros((n, maximum, channels), np.bool_),
        drawn=np.zeros((n, maximum, draws, copies, channels), np.int64),
        last_ns=np.zeros((n, maximum, channels), np.int64),
        stored=np.zeros((n, maximum, channels), np.bool_),
        kept=np.zeros((n, maximum, max(windows, default=1), channels, way.width)),
    )
    for link, listed in enumerate(by_link):
        for s, stage in enumerate(listed):
            put(built, link, s, stage, way)
    packets = AllPackets(
        now_ns=np.zeros((n, copies, channels), np.int64),
        stamp_ns=np.zeros((n, channels), np.int64),
        status=np.zeros((n, channels), np.int64),
        values=np.zeros((n, channels, way.width)),
        number=np.zeros((n, channels), np.int64),
        copied=np.zeros((n, channels), np.bool_),
        held=np.zeros((n, channels), np.bool_),
    )
    return built, packets


def _window(stage: Any, way: DirectionSpec) -> int:
    """Number of entries in a replayed window, or of draws of noise."""
    if stage.model == "noise":
        return max(1, way.draws)
    frames: int = round(stage.window * way.frame_rate)
    return max(1, frames)


def put(link_chains: Chains, link: int, s: int, stage: Any, way: DirectionSpec) -> None:
    """Write a stage to index `s` of a link, with its draws, which depend only on seed and indices."""
    row, model, begin = link_chains.rows[link], kinds.MODELS[stage.model], to_ns(stage.start)
    code = model.code
    row[s]["model"], row[s]["begin_ns"] = code, begin
    row[s]["from_ns"] = 0 if code == kinds.REPLAY else begin
    row[s]["until_ns"] = FOREVER if stage.duration is None else begin + to_ns(stage.duration)
    row[s]["delay_ns"] = to_ns(getattr(stage, model.time)) if model.time else 0
    row[s]["number"] = getattr(stage, model.number) if model.number else 0.0
    measurement = getattr(stage, "measurement", None)
    row[s]["measurement"] = -1 if measurement is None else list(CHANNELS).index(measurement)
    if code in (kinds.REPLAY, kinds.NOISE):
        row[s]["window"] = _window(stage, way)
    if code == kinds.WAIT:
        row[s]["stamped"], row[s]["hold"] = stage.reference == "stamp", stage.missing == "hold"
        row[s]["complete"] = stage.send == "complete"
    names = [channel for name in stage.channels or way.channels for channel in way.groups.get(name, [name])]
    link_chains.channel_mask[link, s] = [name in names for name in way.channels]
    seed, direction = way.seed
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(link, direction, s)))
    if code == kinds.NOISE:
        window = link_chains.kept[link, s, : row[s]["window"]]
        window[:] = random_numbers.standard_normal(random, window.shape)
    if code in kinds.CHANCE:
        link_chains.drawn[link, s] = kinds.draw(stage, link_chains.drawn.shape[2:], way.channels, random)


def longest_delay_ns(link_chains: Chains) -> int:
    """Longest possible delay of a chain, ns."""
    drawn = np.where(link_chains.drawn == NEVER, 0, link_chains.drawn).max(axis=(2, 3, 4), initial=0)
    fixed = np.maximum(link_chains.rows["delay_ns"], 0)  # a negative offset of time stamps adds no delay
    return int((fixed + np.where(link_chains.rows["model"] == kinds.DRAWN, drawn, 0)).sum(axis=1).max(initial=0))


@compiled
def traverse(c: Chain, p: Packets, sent_ns: int, first: int, end: int) -> None:
    """Pass the entries of channels `first` to before `end`, all sent at `sent_ns`, through a chain.

    `p` holds the entries and then the results; `now_ns` is NEVER for a lost entry or a copy that was not made.
    """
    for s in range(c.rows.size):
        row = c.rows[s]
        if sent_ns < row.from_ns or sent_ns >= row.until_ns:
            continue
        if row.model == kinds.WAIT:
            _align(c, p, s, sent_ns, first, end)
            continue
        for channel in range(first, end):
            if not c.channel_mask[s, channel]:
                continue
            if p.stamp_ns[channel] == NEVER:  # absent from the frame
                continue
            if row.model in kinds.DISTURBING:
                _disturb(c, p, s, channel, sent_ns)
            else:
                _delay(c, p, s, channel)


@compiled
def _delay(c: Chain, p: Packets, s: int, channel: int) -> None:
    """Apply a stage that delays, loses or duplicates an entry."""
    row, n = c.rows[s], p.number[channel] % c.drawn.shape[1]
    if row.model == kinds.DUPLICATE:
        if p.now_ns[0, channel] != NEVER and not p.copied[channel] and c.drawn[s, n, 0, channel] != 0:
            p.now_ns[1, channel] = p.now_ns[0, channel]
            p.copied[channel] = True
        return
    for copy in range(p.now_ns.shape[0]):
        now = p.now_ns[copy, channel]
        if now == NEVER:
            continue
        if row.model == kinds.CONSTANT:
            now += row.delay_ns
        elif row.model == kinds.DRAWN:
            drawn = c.drawn[s, n, copy, channel]
            now = NEVER if drawn == NEVER else now + drawn
        elif row.model == kinds.IN_ORDER:
            now = max(now, c.last_ns[s, channel])
            c.last_ns[s, channel] = now
        else:
            now = max(now, p.stamp_ns[channel] + row.delay_ns)
        p.now_ns[copy, channel] = now


@compiled
def _disturb(c: Chain, p: Packets, s: int, channel: int, sent_ns: int) -> None:
    """Apply a stage that changes an entry's values or time stamp."""
    row = c.rows[s]
    if row.model == kinds.SPOOF:
        p.stamp_ns[channel] += row.delay_ns
        return
    if row.model == kinds.FLIP:
        _turn_over(p, channel, c.drawn[s, p.number[channel] % c.drawn.shape[1], 0, channel], row.measurement)
        return
    place = p.number[channel] % row.window if row.model in (kinds.REPLAY, kinds.NOISE) else 0
    keeps = sent_ns < row.begin_ns or (row.model == kinds.FREEZE and not c.stored[s, channel])
    for j in range(p.values.shape[1]):
        if row.measurement >= 0 and row.measurement != j:
            continue
        if row.model == kinds.BIAS:
            p.values[channel, j] += row.number
        elif row.model == kinds.SCALE:
            p.values[channel, j] *= row.number
        elif row.model == kinds.RAMP:
            p.values[channel, j] += row.number * (sent_ns - row.begin_ns) * 1e-9
        elif row.model == kinds.NOISE:
            p.values[channel, j] += row.number * c.kept[s, place, channel, j]
        elif keeps:
            c.kept[s, place, channel, j] = p.values[channel, j]
        else:
            p.values[channel, j] = c.kept[s, place, channel, j]
    if row.model == kinds.FREEZE:
        c.stored[s, channel] = True


@compiled
def _turn_over(p: Packets, channel: int, drawn: int, measurement: int) -> None:
    """Invert a bit of one of an entry's values; `drawn`: 1 + number of the bit, or 0: none."""
    if drawn == 0:
        return
    bit, value = (drawn - 1) % kinds.BITS, (drawn - 1) // kinds.BITS % p.values.shape[1]
    words = p.values[channel].view(np.int64)
    words[measurement if measurement >= 0 else value] ^= np.int64(1) << np.int64(bit)


@compiled
def _align(c: Chain, p: Packets, s: int, sent_ns: int, first: int, end: int) -> None:
    """Let a frame's entries leave together: when all have arrived, or at the end of the wait; late ones are lost."""
    row = c.rows[s]
    earliest, latest = NEVER, 0
    for channel in range(first, end):
        if c.channel_mask[s, channel]:
            earliest, latest = min(earliest, p.now_ns[0, channel]), max(latest, p.now_ns[0, channel])
    if earliest == NEVER and row.stamped == 0:
        return
    deadline = (sent_ns if row.stamped == 1 else earliest) + row.delay_ns
    leaves = latest if latest <= deadline and row.complete == 1 else deadline
    for channel in range(first, end):
        if not c.channel_mask[s, channel]:
            continue
        if p.now_ns.shape[0] > 1:
            p.now_ns[1, channel] = NEVER
        if p.now_ns[0, channel] <= deadline:
            p.now_ns[0, channel] = leaves
            c.stored[s, channel] = True
            for j in range(p.values.shape[1]):
                c.kept[s, 0, channel, j] = p.values[channel, j]
        elif row.hold == 1 and c.stored[s, channel]:
            p.now_ns[0, channel] = leaves
            p.held[channel] = True
            if p.stamp_ns[channel] == NEVER:  # absent: replaced by the last one, with a new time stamp
                p.stamp_ns[channel] = sent_ns
            for j in range(p.values.shape[1]):
                p.values[channel, j] = c.kept[s, 0, channel, j]
        else:
            p.now_ns[0, channel] = NEVER
