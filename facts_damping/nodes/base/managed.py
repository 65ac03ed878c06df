"""Managed nodes: what the transitions of ROS 2's lifecycle do to a node (design.ros2.org, "Managed nodes").

| state | the node |
|---|---|
| unconfigured | waits; it has no topics yet |
| inactive | has read its parameters and is connected; nothing that it does has an effect |
| active | acts |

By default a node configures and activates itself. With `autostart:=false` it waits for `ros2 lifecycle set`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

from rclpy.exceptions import ParameterException
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn

from facts_damping.errors import FactsDampingError, InputError, one_line
from facts_damping.nodes import clock
from facts_damping.nodes.base.log import NodeLog
from facts_damping.nodes.base.parameters import accept_whole_numbers, check_declared, declare, descriptor
from facts_damping.nodes.base.spinner import REQUESTS_S, Spinner, check_wanted, request_stop

if TYPE_CHECKING:
    from collections.abc import Callable

SUCCESS, FAILURE, ERROR = (
    TransitionCallbackReturn.SUCCESS,
    TransitionCallbackReturn.FAILURE,
    TransitionCallbackReturn.ERROR,
)
USER_ERRORS = (FactsDampingError, ParameterException)
AUTOSTART = "true: configure and activate by itself; false: wait for the transitions of ros2 lifecycle"


class Activation(Protocol):
    """Interface of what `activate` and `deactivate` do to a node; both raise `InputError` if they are refused."""

    @property
    def waits(self) -> bool:
        """Whether the node stays inactive until somebody activates it, as a joining node does."""

    @property
    def takes_part(self) -> bool:
        """Whether the node takes part in the run while it is inactive."""

    def activate(self) -> object:
        """Act from the next tick on."""

    def deactivate(self) -> object:
        """Have no effect from the next tick on."""


class AlwaysActive:
    """Activation of a node whose work has no pause."""

    waits = takes_part = False

    def activate(self) -> None:
        """Nothing to do."""

    def deactivate(self) -> None:
        """Refuse."""
        raise InputError("deactivate given; allowed: shutdown, as this node works until the run ends")


class NodeBody(Protocol):
    """Interface of a node's application class: constructed (`configure`), made ready, then run."""

    spinner: Spinner

    @property
    def activation(self) -> Activation:
        """What `activate` and `deactivate` do."""

    def ready(self) -> None:
        """Wait for peers and open files or ports."""

    def run(self) -> None:
        """Work until done or interrupted."""


class ManagedNode(LifecycleNode):
    """A lifecycle node around a node body, which `configure` makes."""

    def __init__(self, name: str, make: Callable[[ManagedNode], NodeBody], autostart: bool | None = None) -> None:
        """`autostart`: in place of the parameter, for a node that begins again."""
        super().__init__(name, start_parameter_services=True)
        accept_whole_numbers(self)
        asked = declare(self, "autostart", True, descriptor(AUTOSTART))
        self.autostart: bool = asked if autostart is None else autostart
        self.active = self.cleaned = False
        self.body: NodeBody | None = None
        self._construct, self._starting = make, False
        self._failure: Exception | None = None

    def construct(self) -> None:
        """Make the body: read parameters, build, set up the topics."""
        self.body = self._construct(self)

    def start(self) -> NodeBody:
        """Configure, and activate unless the node waits for that. Raises what failed."""
        self._starting = True
        self._trigger(self.trigger_configure)
        body = self.configured()
        if not body.activation.waits:
            self._trigger(self.trigger_activate)
        self._starting = False
        return body

    def configured(self) -> NodeBody:
        """The body, once `configure` has made it. Raises `Stopped` after a stop signal or `shutdown`."""
        spinner = Spinner(self)
        while self.body is None:
            self._serve(spinner)
        spinner.close()
        return self.body

    def wait_active(self, body: NodeBody) -> None:
        """Serve requests until the node may run: it is active, or takes part while it is inactive."""
        if body.activation.takes_part and not self.active:
            body.activation.deactivate()
        while not (self.active or body.activation.takes_part):
            self._serve(body.spinner)

    def _serve(self, spinner: Spinner) -> None:
        check_wanted()
        spinner.serve()
        if self._failure is not None and not isinstance(self._failure, USER_ERRORS):
            raise self._failure
        clock.sleep(REQUESTS_S)

    def _trigger(self, transition: Callable[[], TransitionCallbackReturn]) -> None:
        if transition() != SUCCESS and self._failure is not None:
            raise self._failure

    def _tried(self, act: Callable[[], Any]) -> TransitionCallbackReturn:
        """Do it; an error of the user's is logged, and the node stays in its state."""
        self._failure = None
        try:
            act()
        except Exception as error:  # noqa: BLE001 (rclpy would keep it to itself)
            self._failure = error
            if not isinstance(error, USER_ERRORS):
                return ERROR
            if not self._starting:
                NodeLog(self).error(one_line(error))
            return FAILURE
        return SUCCESS

    def on_configure(self, _: Any) -> TransitionCallbackReturn:
        """Make the body."""
        return self._tried(self._configure)

    def _configure(self) -> None:
        self.construct()
        check_declared(self)

    def on_activate(self, _: Any) -> TransitionCallbackReturn:
        """Let the body act."""
        return self._set_active(active=True)

    def on_deactivate(self, _: Any) -> TransitionCallbackReturn:
        """Let the body have no effect."""
        return self._set_active(active=False)

    def _set_active(self, *, active: bool) -> TransitionCallbackReturn:
        body = self.body
        if body is None:
            return ERROR
        result = self._tried(body.activation.activate if active else body.activation.deactivate)
        self.active = active if result == SUCCESS else self.active
        return result

    def on_cleanup(self, _: Any) -> TransitionCallbackReturn:
        """Begin again, unconfigured, with the parameters that the process was started with."""
        if self.body is None:
            return ERROR
        self.cleaned = True
        self.body.spinner.begin_again()
        return SUCCESS

    def on_shutdown(self, _: Any) -> TransitionCallbackReturn:
        """End, as after a stop signal."""
        request_stop()
        return SUCCESS
