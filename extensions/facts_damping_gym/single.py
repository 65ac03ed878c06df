"""The environment, one episode at a time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium import spaces

from facts_damping.errors import InputError
from facts_damping.simulation.parts import Parts
from facts_damping_gym.episodes import Episode, Source, checked, weights_of
from facts_damping_gym.many import MAX_AGE, MAX_SIGNAL
from facts_damping_gym.reward import IndexReward, Reward
from facts_damping_gym.window import each_scale

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.record import Record


class Setting:
    """Common settings of all episodes of an environment: source, spaces, reward."""

    def __init__(
        self,
        run: str | None = "two_area_large",
        study: str | None = None,
        *,
        controller: int = 0,
        window: int = 8,
        scale: float | list[float] = 0.01,
        reward: Reward = IndexReward(),  # noqa: B008 (frozen)
        lost: float = 100.0,
        **fields: Any,
    ) -> None:
        """See `WideAreaDamping`."""
        if window < 1:
            raise InputError(f"window: {window} given; allowed: 1 or more ticks")
        self.source = Source(run, study, controller, fields)
        self.controller, self.reward, self.lost = controller, reward, lost
        agent = self.source.first.controllers[controller]
        self.scale = each_scale(scale, len(agent.signals))
        shape = (window, len(agent.signals))
        low, high = ([-MAX_SIGNAL, 0.0, 0.0], [MAX_SIGNAL, MAX_AGE, 1.0])
        edges = [np.broadcast_to(np.array(edge, np.float32), (*shape, 3)) for edge in (low, high)]
        self.observation_space: Any = spaces.Box(edges[0], edges[1], dtype=np.float32)
        self.action_space: Any = spaces.Box(-1.0, 1.0, (len(agent.devices),), np.float32)
        self.weights = weights_of(self.source.first)
        self.dt = 1.0 / self.source.first.run.frame_rate

    def begin(
        self,
        random: np.random.Generator,
        options: dict[str, Any] | None,
        window: NDArray[Any],
        deviations: NDArray[Any],
        parts: Parts,
    ) -> tuple[Episode, dict[str, Any]]:
        """A random episode and its information; raises an error if a study's points differ in signals or devices."""
        point, case = self.source.draw(random, options)
        agent, first = case.controllers[self.controller], self.source.first
        like = first.controllers[self.controller]
        if (agent.signals, agent.devices, case.run.frame_rate) != (like.signals, like.devices, first.run.frame_rate):
            raise InputError(f"study: point {point} has other signals, devices or frame_rate; allowed: the same in all")
        drawn = {"point": point, "seed": case.run.seed, **self.source.points[point]}
        return Episode(case, self.controller, self.scale, window, deviations, parts), drawn


class WideAreaDamping(gymnasium.Env[Any, Any]):
    """Damping control of a run by an agent, which replaces one of its controllers.

    A step is a frame. **Observation**, (window, signals, 3): for the last ticks, the newest last, each signal of the
    controller as delivered by its link, in units of `scale` (p.u.), its age (s), and 1 if the tick has no new value of
    it. **Action**, (devices,): setpoints, -1 to 1 of the limits; issued at the last arrival of the tick that it
    answers, and without effect if nothing arrived. **Reward**: see `IndexReward`; any similar function may replace it.
    `terminated` at loss of synchronism, with `lost` subtracted from the reward; `truncated` at the end.
    **Information**, also of `reset`: what was drawn (`point`, `seed`, fields of a study), `ITAE` so far (p.u. s^2),
    `in_synchronism`, `setpoint` in force, (devices,), p.u., and `tripped`: whether a supervisor has tripped the agent.

    `run`: name under config/runs, or a path; or `study`, name or path, from whose points episodes are drawn;
    `controller`: index of the replaced controller; `fields`: changed fields of the run, as in `facts_damping.simulate`.
    The seed of `reset` draws point and seed of the run; `options` may set `point` and `seed`. Raises `InputError`.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 (as its base has it)

    def __init__(self, run: str | None = "two_area_large", study: str | None = None, **settings: Any) -> None:
        """As above."""
        settings.pop("render_mode", None)
        self._setting = Setting(run, study, **settings)
        self.observation_space, self.action_space = self._setting.observation_space, self._setting.action_space
        self._window = np.zeros(self.observation_space.shape or (), np.float32)
        self._deviations = np.zeros(len(self._setting.weights))
        self.episode: Any = None  # an `Episode`, once one has begun
        self._drawn: dict[str, Any] = {}
        self._parts = Parts()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[Any], dict[str, Any]]:
        """Begin an episode."""
        super().reset(seed=seed)
        seen = self._window, self._deviations
        self.episode, self._drawn = self._setting.begin(self.np_random, options, *seen, self._parts)
        return self._window.copy(), self._information()

    def _information(self) -> dict[str, Any]:
        information, lost = self.episode.information, self.episode.lost
        so_far = {
            "ITAE": float(information.itae[0]),
            "in_synchronism": not lost,
            "tripped": bool(information.tripped[0]),
        }
        return {**self._drawn, **so_far, "setpoint": information.setpoints[0].copy()}

    def step(self, action: NDArray[Any]) -> tuple[NDArray[Any], float, bool, bool, dict[str, Any]]:
        """Answer the newest tick, and go on to the next one."""
        episode = self.episode
        if episode is None or episode.over or episode.lost:
            raise gymnasium.error.ResetNeeded("no episode is running: call reset")
        asked = checked(action, self._setting.action_space.shape)
        episode.step(asked)
        setting, lost = self._setting, episode.lost
        reward = float(setting.reward(setting.dt, np.float64(episode.time_s), self._deviations, asked))
        over = episode.over and not lost
        return self._window.copy(), reward - setting.lost * lost, lost, over, self._information()

    def record(self) -> Record:
        """The record of the episode up to now."""
        if self.episode is None:
            raise gymnasium.error.ResetNeeded("no episode is running: call reset")
        record: Record = self.episode.record()
        return record
