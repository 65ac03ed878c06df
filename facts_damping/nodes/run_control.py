"""Run control: services of the plant that pause, resume and step the run, reset the plant, and apply an event now."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping_msgs.msg import RunState
from facts_damping_msgs.srv import Apply, Step
from rcl_interfaces.msg import SetParametersResult
from std_srvs.srv import Trigger

from facts_damping.errors import InputError, one_line
from facts_damping.nodes import clock
from facts_damping.nodes.base.parameters import declare, descriptor
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node
    from rclpy.parameter import Parameter

    from facts_damping.nodes.base.spinner import Spinner
    from facts_damping.nodes.frame_source import FrameSource
    from facts_damping.nodes.live_plant import LivePlant

REMIND_S = 0.4  # wall time between two reports of a pause: shorter than the time after which nodes report silence


class RunControl:
    """Services that control the run, and its paused state; the plant's lifecycle state is `inactive` while it waits."""

    waits, takes_part = False, True

    def __init__(self, node: Node, source: FrameSource, plant: LivePlant, progress: Callable[[], None]) -> None:
        """Create the services; during a pause, `progress` tells the calling program that the run is alive."""
        self._source, self._member, self._plant, self._progress = source, source.member, plant, progress
        self._paused: bool = False
        self._steps = 0
        for answer in (self.on_pause, self.on_resume, self.on_reset, self.on_rearm):
            node.create_service(Trigger, f"~/{answer.__name__.removeprefix('on_')}", answer)
        node.create_service(Step, "~/step", self.on_step)
        node.create_service(Apply, "~/apply", self.on_apply)
        text = "an event as in a scenario, without time: it happens at once, or if given at the start, then"
        if event := declare(node, "event", "", descriptor(text, read_only=False)):
            self._ask_event(event)
        node.add_on_set_parameters_callback(self.on_set)

    def deactivate(self) -> bool:
        """Pause the run. Returns false if it is paused already."""
        was_running, self._paused = not self._paused, True
        if was_running:
            self._member.change("pause")
        return was_running

    def activate(self) -> bool:
        """Resume the run. Returns false if it is not paused."""
        was_paused, self._paused, self._steps = self._paused, False, 0
        if was_paused:
            self._member.change("resume")
            self._source.publish_state(RunState.RUNNING, self._plant.tick, "goes on")
        return was_paused

    def _next(self) -> str:
        """From which tick and time a change acts."""
        tick = self._plant.tick + 1
        return f"from tick {tick} on, {self._plant.start(tick) / NANOSECONDS:.3f} s"

    def on_pause(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Pause: no tick begins until the run is resumed or stepped."""
        paused = f"the run is paused after tick {self._plant.tick}, {self._steps} ticks left to step"
        response.success = self.deactivate()
        response.message = f"paused {self._next()}" if response.success else paused
        return response

    def on_resume(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Resume a paused run."""
        response.success = self.activate()
        response.message = f"resumes {self._next()}" if response.success else "the run is not paused"
        return response

    def on_step(self, request: Step.Request, response: Step.Response) -> Step.Response:
        """Let a paused run go on for `request.ticks` ticks."""
        if not self._paused:
            response.message = "the run is not paused"
            return response
        if request.ticks == 0:
            response.message = "ticks: 0 given; allowed: at least 1"
            return response
        self._steps += request.ticks
        self._member.change("step", "", request.ticks)
        response.success, response.message = True, f"{request.ticks} ticks {self._next()}"
        return response

    def on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Reset the plant to its start; time goes on."""
        self._member.change("reset", act=self._plant.ask_reset())
        response.success, response.message = True, f"the plant restarts {self._next()}"
        return response

    def on_rearm(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Let every released device take setpoints again."""
        released = self._plant.released()
        response.success = bool(released)
        response.message = f"re-armed: {', '.join(released)}" if released else "no device is released"
        if released:
            self._member.change("rearm", act=self._plant.rearm)
        return response

    def _ask_event(self, text: str) -> None:
        """Queue an event for the next tick. Raises `InputError` if it cannot happen."""
        self._member.change("event", "", text, self._plant.ask_event(text))

    def on_set(self, parameters: list[Parameter[Any]]) -> SetParametersResult:
        """Queue an event that is set by the parameter `event`."""
        try:
            for parameter in parameters:
                if parameter.name == "event" and parameter.value:
                    self._ask_event(parameter.value)
        except InputError as error:
            return SetParametersResult(successful=False, reason=one_line(error))
        return SetParametersResult(successful=True)

    def on_apply(self, request: Apply.Request, response: Apply.Response) -> Apply.Response:
        """Queue an event for the next tick."""
        try:
            self._ask_event(request.change)
        except InputError as error:
            response.message = one_line(error)
        else:
            response.success, response.message = True, self._next()
        return response

    def hold(self, tick: int, spinner: Spinner) -> float:
        """Wait before a tick while the run is paused. Returns the wall time waited, s."""
        if not self._paused:
            return 0.0
        began, reported_s = clock.monotonic(), 0.0
        while self._held():
            if clock.monotonic() - reported_s > REMIND_S:
                reported_s = clock.monotonic()
                self._source.publish_state(RunState.PAUSED, tick - 1, "paused")
                self._progress()
            spinner.spin_once(0.05)
        self._steps = max(0, self._steps - 1)
        return clock.monotonic() - began

    def _held(self) -> bool:
        return self._paused and self._steps == 0
