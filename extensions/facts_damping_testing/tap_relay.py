"""A cable with real delay between two network interfaces (TAP).

`python -m facts_damping_testing.tap_relay near far --delay 0.02` joins them: a packet that enters one leaves
the other after delay +- jitter, in order, or is lost. Needs Linux and root.

It is for tests with nodes on several hosts (docs/operate.md); studies use simulated links.
"""

from __future__ import annotations

import argparse
import fcntl
import heapq
import os
import random
import select
import signal
import struct
import sys
from itertools import count
from typing import NamedTuple

from facts_damping.nodes import clock

TUNSETIFF, IFF_TAP, IFF_NO_PI = 0x400454CA, 0x0002, 0x1000
LONGEST_NAME = 15
LARGEST_PACKET = 65_536


class Cable(NamedTuple):
    """Effect of a cable on packets: delay and jitter in s, fraction that is lost."""

    delay: float
    jitter: float
    loss: float


def interface(name: str) -> int:
    """Make a TAP interface. Returns its file descriptor, which reads and writes Ethernet frames. Raises `OSError`."""
    descriptor = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(descriptor, TUNSETIFF, struct.pack("16sH", name.encode(), IFF_TAP | IFF_NO_PI))
    return descriptor


def relay(ends: tuple[int, int], cable: Cable, seed: int) -> None:
    """Forward packets between two interfaces until interrupted."""
    chance, number = random.Random(seed), count()
    leaves = dict.fromkeys(ends, 0.0)  # time at which the last packet leaves by this end
    waiting: list[tuple[float, int, int, bytes]] = []
    poll = select.poll()
    for end in ends:
        poll.register(end, select.POLLIN)
    while True:
        pause = None if not waiting else max(0.0, 1e3 * (waiting[0][0] - clock.monotonic()))
        for end, _ in poll.poll(pause):
            packet, other = os.read(end, LARGEST_PACKET), ends[end == ends[0]]
            if chance.random() >= cable.loss:
                late = max(0.0, cable.delay + chance.uniform(-cable.jitter, cable.jitter))
                leaves[other] = max(leaves[other], clock.monotonic() + late)
                heapq.heappush(waiting, (leaves[other], next(number), other, packet))
        while waiting and waiting[0][0] <= clock.monotonic():
            _, _, other, packet = heapq.heappop(waiting)
            try:
                os.write(other, packet)
            except OSError:  # the interface is down: drop the packet
                continue


def main() -> None:
    """Entry point."""
    program, text = "python -m facts_damping_testing.tap_relay", (__doc__ or "").split("\n")[0]
    parser = argparse.ArgumentParser(prog=program, description=text)
    parser.add_argument("near", help="name of one interface")
    parser.add_argument("far", help="name of the other")
    parser.add_argument("--delay", type=float, default=0.0, metavar="S", help="delay, s")
    parser.add_argument("--jitter", type=float, default=0.0, metavar="S", help="delay +- so much, s")
    parser.add_argument("--loss", type=float, default=0.0, metavar="FRACTION", help="fraction of packets that is lost")
    parser.add_argument("--seed", type=int, default=0, help="of jitter and loss")
    arguments = parser.parse_args()
    for name, maximum in (("delay", 60.0), ("jitter", 60.0), ("loss", 1.0)):
        value = getattr(arguments, name)
        if not 0.0 <= value <= maximum:
            parser.error(f"--{name}: {value:g} given; allowed: 0 to {maximum:g}")
    for name in (arguments.near, arguments.far):
        if not 0 < len(name) <= LONGEST_NAME or "/" in name or " " in name:
            allowed = f"a name of 1 to {LONGEST_NAME} characters without blanks and slashes"
            parser.error(f"{name!r} given; allowed: {allowed}")
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        ends = interface(arguments.near), interface(arguments.far)
        relay(ends, Cable(arguments.delay, arguments.jitter, arguments.loss), arguments.seed)
    except OSError as error:
        sys.exit(f"relay: {error.strerror or error}; needed: root, Linux's /dev/net/tun, names that are not in use")
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
