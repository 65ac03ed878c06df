"""The recipe of docs/operate.md, as it stands there: hosts as network namespaces, a cable with real delay."""

from __future__ import annotations

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from facts_damping.case.loading import load_case
from facts_damping.recording.reader import load
from facts_damping.simulation import loop
from facts_damping_testing.tap_relay import interface
from tests.nodes.graphs import PATIENCE_S, assert_same

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

TEXT = (Path(__file__).parents[2] / "docs" / "operate.md").read_text(encoding="utf-8")
HOSTS, CABLE, NODES, AWAY = re.findall(r"```sh\n(.*?)```", TEXT, re.DOTALL)


def permitted() -> bool:
    """Whether namespaces, bridges, cables and TAP interfaces can be made here."""
    if shutil.which("ip") is None:
        return False
    probe = f"fd{os.getpid()}"  # other processes try at the same time
    tried = (
        f"netns add {probe}",
        f"-n {probe} link add hub type bridge",
        f"-n {probe} link add one type veth peer name other",
    )
    statuses = [
        subprocess.run(["ip", *command.split()], capture_output=True, check=False).returncode for command in tried
    ]
    subprocess.run(["ip", "netns", "delete", probe], capture_output=True, check=False)
    try:
        os.close(interface(probe))
    except OSError:
        return False
    return not any(statuses)


pytestmark = pytest.mark.skipif(not permitted(), reason="needs root, iproute2, network namespaces and /dev/net/tun")


@pytest.fixture
def alone() -> Iterator[None]:
    """Reserves the hosts on this machine."""
    with socket.socket(socket.AF_UNIX) as held:
        deadline = time.monotonic() + 5 * PATIENCE_S
        while time.monotonic() < deadline:
            with suppress(OSError):
                held.bind("\0facts_damping_hosts")
                break
            time.sleep(0.5)
        yield


@pytest.fixture
def shell(alone: None, domain: int, tmp_path: Path) -> Iterator[Callable[[str], subprocess.CompletedProcess[str]]]:
    """Runs commands in a shell that ends with all that it started; hosts are deleted before and after."""
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    environment["PYTHONPATH"] = str(Path(__file__).parents[2])

    def run(commands: str) -> subprocess.CompletedProcess[str]:
        with (tmp_path / "output").open("w+") as output, (tmp_path / "errors").open("w+") as errors:
            popen = subprocess.Popen(
                ["bash", "-ec", commands],
                cwd=tmp_path,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=errors,
                start_new_session=True,
            )
            try:
                code = popen.wait(2 * PATIENCE_S)
            except subprocess.TimeoutExpired:
                code = -1
            with suppress(ProcessLookupError):
                os.killpg(popen.pid, signal.SIGKILL)  # all that it started
            popen.wait()
            output.seek(0)
            errors.seek(0)
            return subprocess.CompletedProcess(commands, code, output.read(), errors.read())

    def delete_hosts() -> None:
        for host in ("switch", "plant", "link", "control"):
            subprocess.run(["ip", "netns", "delete", f"fd_{host}"], capture_output=True, check=False)

    delete_hosts()
    yield run
    delete_hosts()


def test_nodes_on_several_hosts_give_the_bits_of_the_in_process_run(shell: Any, tmp_path: Path) -> None:
    done = shell(HOSTS + CABLE + NODES + AWAY)
    assert done.returncode == 0, done.stderr
    recorded = load(tmp_path / "recording")
    assert_same(recorded, loop.run(load_case("two_area_small", ["duration=2.0", "link=pdci"])))
    assert "fd_" not in subprocess.run(["ip", "netns", "list"], capture_output=True, text=True, check=True).stdout


def test_cable_delays_what_passes_it(shell: Any) -> None:
    """A datagram there and back takes twice 15 to 25 ms at least, without the cable nothing like it."""
    echo = (
        "import socket; s = socket.socket(type=socket.SOCK_DGRAM); s.bind(('', 7007))\n"
        "while True: s.sendto(*s.recvfrom(99))"
    )
    ask = (
        "import socket, time; s = socket.socket(type=socket.SOCK_DGRAM); s.settimeout(1.0); found = []\n"
        "while len(found) < 20:\n"
        "    began = time.monotonic(); s.sendto(b'x', ('10.77.0.{to}', 7007))\n"
        "    try: s.recvfrom(99); found.append(time.monotonic() - began)\n"
        "    except OSError: time.sleep(0.05)\n"
        "print(min(found))"
    )
    servers = "".join(f'ip netns exec fd_{host} python -c "{echo}" &\n' for host in ("link", "control"))
    asked = "".join(f'ip netns exec fd_plant python -c "{ask.format(to=to)}"\n' for to in (2, 3))
    done = shell(HOSTS + CABLE + servers + asked)
    assert done.returncode == 0, done.stderr
    near, far = (float(line) for line in done.stdout.split())
    assert near < 0.03 <= far


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["a", "b", "--delay", "-1"], "--delay: -1 given; allowed: 0 to 60"),
        (["a", "b", "--loss", "2"], "--loss: 2 given; allowed: 0 to 1"),
        (["a", "b" * 16], "allowed: a name of 1 to 15 characters"),
        (["lo", "b"], "needed: root, Linux's /dev/net/tun, names that are not in use"),
    ],
)
def test_cable_that_cannot_be_is_refused(arguments: list[str], expected: str) -> None:
    command = [sys.executable, "-m", "facts_damping_testing.tap_relay", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.returncode != 0
    assert expected in done.stderr.splitlines()[-1]
