"""Clocks, timers, guard conditions and wait sets of a loopback."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rclpy.impl.implementation_singleton import rclpy_implementation as real

from facts_damping.signals import NEVER
from facts_damping_testing.loopback.domain import Destroyable
from facts_damping_testing.loopback.processes import wall_ns, world

if TYPE_CHECKING:
    from collections.abc import Callable

ROS_TIME, STEADY_TIME = 1, 3  # rcl_clock_type_t


class GuardCondition(Destroyable):
    """Wakes a wait set once it is triggered."""

    def __init__(self, _context: Any) -> None:
        super().__init__()
        self._triggered = False

    def trigger_guard_condition(self) -> None:
        self._triggered = True

    def is_ready(self) -> bool:
        return self._triggered

    def reset(self) -> None:
        self._triggered = False


class Clock(Destroyable):
    """Time of the world; that of a ROS clock may be overridden."""

    def __init__(self, clock_type: int) -> None:
        super().__init__()
        self._type, self._override, self._enabled = clock_type, 0, False

    def now_ns(self) -> int:
        if self._type == ROS_TIME and self._enabled:
            return self._override
        return world().now_ns if self._type == STEADY_TIME else wall_ns()

    def get_now(self) -> Any:
        return real.rcl_time_point_t(self.now_ns(), self._type)

    def get_ros_time_override_is_enabled(self) -> bool:
        return self._enabled

    def set_ros_time_override_is_enabled(self, enabled: bool) -> None:
        self._enabled = enabled

    def set_ros_time_override(self, point: Any) -> None:
        self._override = point.nanoseconds

    def add_clock_callback(self, *_: Any) -> None:
        """Ignore the callback: jumps of time are not reported."""

    remove_clock_callback = add_clock_callback


class Timer(Destroyable):
    """Is ready once per period of a clock."""

    def __init__(self, clock: Clock, _context: Any, period_ns: int, autostart: bool = True) -> None:
        super().__init__()
        self._clock, self._period, self._canceled = clock, period_ns, not autostart
        self._last = clock.now_ns()
        self._next = self._last + period_ns

    def is_ready(self) -> bool:
        return not self._canceled and self._clock.now_ns() >= self._next

    is_timer_ready = is_ready

    def due_ns(self) -> int:
        """The world's time at which it is ready; NEVER if the time of its clock is set from outside."""
        if self._canceled or self._clock.get_ros_time_override_is_enabled():
            return NEVER
        return world().now_ns + max(0, self._next - self._clock.now_ns())

    def call_timer(self) -> None:
        now = self._clock.now_ns()
        self._last, self._next = now, self._next + self._period
        if self._next < now and self._period:
            self._next = now + self._period - (now - self._next) % self._period

    def call_timer_with_info(self) -> Any:
        expected = self._next
        self.call_timer()
        return {"expected_call_time": expected, "actual_call_time": self._last}

    def cancel_timer(self) -> None:
        self._canceled = True

    def reset_timer(self) -> None:
        self._canceled, self._next = False, self._clock.now_ns() + self._period

    def is_timer_canceled(self) -> bool:
        return self._canceled

    def get_timer_period(self) -> int:
        return self._period

    def change_timer_period(self, period_ns: int) -> None:
        self._period = period_ns

    def time_since_last_call(self) -> int:
        return self._clock.now_ns() - self._last

    def time_until_next_call(self) -> int | None:
        return None if self._canceled else self._next - self._clock.now_ns()


def _adder(kind: str) -> Callable[[WaitSet, Any], int]:
    def add(wait_set: WaitSet, entity: Any) -> int:
        added = wait_set.added[kind]
        added.append(entity)
        return len(added) - 1

    return add


class WaitSet(Destroyable):
    """Waits until one of its entities is ready."""

    KINDS = ("subscription", "guard_condition", "timer", "client", "service")

    def __init__(self, *_: Any) -> None:
        super().__init__()
        self.clear_entities()

    def clear_entities(self) -> None:
        self.added: dict[str, list[Any]] = {kind: [] for kind in self.KINDS}
        self._ready: dict[str, list[int]] = {kind: [] for kind in self.KINDS}

    add_subscription, add_guard_condition, add_timer, add_client, add_service = map(_adder, KINDS)

    def wait(self, timeout_ns: int) -> None:
        """Wait at most `timeout_ns`; without limit if it is negative."""
        ready = [waitable.is_ready for added in self.added.values() for waitable in added]
        until = NEVER if timeout_ns < 0 else world().now_ns + timeout_ns
        until = min(until, *(timer.due_ns() for timer in self.added["timer"]), NEVER)
        world().wait(lambda: any(is_ready() for is_ready in ready), until)
        self._ready = {
            kind: [waitable.pointer for waitable in added if waitable.is_ready()] for kind, added in self.added.items()
        }
        for guard in self.added["guard_condition"]:
            guard.reset()

    def get_ready_entities(self, kind: str) -> list[int]:
        return self._ready[kind]

    def is_ready(self, kind: str, index: int) -> bool:
        return kind in self.added and self.added[kind][index].is_ready()
