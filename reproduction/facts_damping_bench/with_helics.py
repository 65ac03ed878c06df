"""Two HELICS federates in two processes, in step: `python -m facts_damping_bench.with_helics ROLE PORT STEPS`.

Each publishes two doubles in a step, asks for the next one, and reads the two of the other. The plant's process has the
broker, and says at the end how many steps a second there were.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time

import helics as h

from facts_damping_bench.session import end_with_parent

PERIOD = 0.01  # s, simulated; whole nanoseconds, as HELICS counts them
FIRST = 20  # steps that are not counted
PLANT, CONTROLLER = "plant", "controller"


def federate(role: str, port: int) -> tuple[object, list[object], list[object]]:
    """A federate of values in a core of its own, its publications and its subscriptions."""
    other = {PLANT: CONTROLLER, CONTROLLER: PLANT}[role]
    info = h.helicsCreateFederateInfo()
    h.helicsFederateInfoSetCoreTypeFromString(info, "zmq")
    h.helicsFederateInfoSetCoreInitString(info, f"--federates=1 --broker_address=tcp://127.0.0.1:{port}")
    h.helicsFederateInfoSetTimeProperty(info, h.HELICS_PROPERTY_TIME_PERIOD, PERIOD)
    created = h.helicsCreateValueFederate(role, info)
    doubles = h.HELICS_DATA_TYPE_DOUBLE
    out = [h.helicsFederateRegisterGlobalPublication(created, f"{role}{i}", doubles, "") for i in (0, 1)]
    latest = [h.helicsFederateRegisterSubscription(created, f"{other}{i}", "") for i in (0, 1)]
    return created, out, latest


def exchange(role: str, port: int, steps: int) -> float:
    """Steps a second."""
    own_federate, out, latest = federate(role, port)
    h.helicsFederateEnterExecutingMode(own_federate)
    began, total = 0.0, 0.0
    for k in range(FIRST + steps):
        if k == FIRST:
            began = time.perf_counter()
        for publication in out:
            h.helicsPublicationPublishDouble(publication, float(k))
        h.helicsFederateRequestTime(own_federate, (k + 1) * PERIOD)
        total += sum(h.helicsInputGetDouble(subscription) for subscription in latest)
    took = time.perf_counter() - began
    if total <= 0.0:
        raise RuntimeError("nothing was heard")
    h.helicsFederateDisconnect(own_federate)
    h.helicsFederateFree(own_federate)
    return steps / took


def main() -> None:
    """Both, where asked for the plant."""
    end_with_parent(int(sys.argv[4]))
    role, port, steps = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    if role == CONTROLLER:
        exchange(role, port, steps)
        return
    out = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    broker = h.helicsCreateBroker("zmq", "", f"--federates=2 --localport={port}")
    command = [sys.executable, "-m", "facts_damping_bench.with_helics", CONTROLLER, str(port), str(steps)]
    other = subprocess.Popen([*command, str(os.getpid())])
    try:
        rate = exchange(role, port, steps)
        other.wait(timeout=30)
        h.helicsBrokerWaitForDisconnect(broker, 5000)
    finally:
        other.kill()
        h.helicsCloseLibrary()
    out.write(json.dumps({"per_s": rate}) + "\n")


if __name__ == "__main__":
    main()
