"""The environment with many episodes in parallel: compiled loops in threads."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from facts_damping.compiling.structs import Table
from facts_damping.signals import NANOSECONDS
from facts_damping.simulation.parts import Parts
from facts_damping.simulation.programs.policies import check
from facts_damping_gym.episodes import checked, first_information, places_of
from facts_damping_gym.many import Episodes, step_many
from facts_damping_gym.single import Setting

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping_gym.episodes import Episode


class WideAreaDampingVector(VectorEnv[Any, Any, Any]):
    """`num_envs` parallel `WideAreaDamping` environments, each bit-equal to a single one with the seed `seed + index`.

    An ended episode restarts in the next step, which ignores the action and has reward 0. `threads`: None: the number
    of processors.
    """

    metadata = {  # noqa: RUF012 (as its base has it)
        "render_modes": [],
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(self, num_envs: int = 1, *, threads: int | None = None, **settings: Any) -> None:
        """As above."""
        settings.pop("render_mode", None)
        self._setting, self.num_envs = Setting(**settings), num_envs
        self.single_observation_space = self._setting.observation_space
        self.single_action_space = self._setting.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._random = [np_random(None)[0] for _ in range(num_envs)]
        self._episodes: list[Episode] = []
        self._waits, self._ended, self._lost = np.zeros((3, num_envs), np.bool_)
        self._ticks, self._time_ns, self._last = np.zeros((3, num_envs), np.int64)
        self._setpoints, self._limits = np.zeros((2, num_envs, *self._setting.action_space.shape))
        self._windows = np.zeros((num_envs, *self._setting.observation_space.shape), np.float32)
        self._weights = np.zeros((num_envs, *self._setting.weights.shape))
        self._deviations = np.zeros((num_envs, len(self._setting.weights)))
        self._points, self._seeds = np.zeros((2, num_envs), np.int64)
        places = places_of(self._setting.source.first, self._setting.controller)
        self._present, self._each = first_information(num_envs, places, [-1] * num_envs), np.ones(num_envs, np.bool_)
        self._all: Episodes | None = None
        self._threads = min(threads or os.cpu_count() or 1, num_envs)
        self._pool = ThreadPoolExecutor(self._threads)
        self._parts = [Parts() for _ in range(num_envs)]

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[Any], dict[str, Any]]:
        """Begin all episodes."""
        seeds = [seed + i for i in range(self.num_envs)] if isinstance(seed, int) else seed or []
        for i, episode_seed in enumerate(seeds):
            if episode_seed is not None:
                self._random[i] = np_random(episode_seed)[0]
        self._episodes = [self._begin(i, options) for i in range(self.num_envs)]
        self._ended[:] = False
        return self._windows.copy(), self._information()

    def _information(self) -> dict[str, Any]:
        """That of each episode, along a leading axis, without fields of a study; with Gymnasium's masks."""
        information = self._present
        present = {"point": self._points, "seed": self._seeds, "ITAE": information.itae, "in_synchronism": ~self._lost}
        present |= {"tripped": information.tripped, "setpoint": information.setpoints}
        return {name: values.copy() for name, values in present.items()} | {f"_{name}": self._each for name in present}

    def _begin(self, i: int, options: dict[str, Any] | None = None) -> Episode:
        seen = self._windows[i], self._deviations[i]
        episode, drawn = self._setting.begin(self._random[i], options, *seen, self._parts[i])
        self._all = None  # rebuilt from the present episodes
        self._ticks[i], self._last[i], self._lost[i] = episode.tick, episode.case.ticks - 1, episode.lost
        self._limits[i], self._weights[i] = episode.limits, episode.weights
        self._points[i], self._seeds[i] = drawn["point"], drawn["seed"]
        for name in ("supervisors", "itae", "integrand", "setpoints", "tripped"):
            getattr(self._present, name)[i] = getattr(episode.information, name)[0]
        return episode

    def step(
        self, actions: NDArray[Any]
    ) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """A step of each episode; for an ended one, the start of the next."""
        if not self._episodes:
            raise ResetNeeded("no episode is running: call reset")
        asked = checked(actions, self.action_space.shape or ())
        np.multiply(asked, self._limits, out=self._setpoints)
        self._waits[:] = self._ended
        for i in np.flatnonzero(self._waits):
            self._episodes[i] = self._begin(int(i))
        self._go_on()
        setting, goes = self._setting, ~self._waits
        lost, over = self._lost & goes, (self._ticks >= self._last) & ~self._lost & goes
        rewards = setting.reward(setting.dt, self._time_ns / NANOSECONDS, self._deviations, asked) - setting.lost * lost
        self._ended = lost | over
        return self._windows.copy(), np.where(goes, rewards, 0.0), lost, over, self._information()

    def _go_on(self) -> None:
        """Step all episodes that do not wait, split over the threads, in one compiled call."""
        if self._all is None:
            tables = (
                Table([episode.loop for episode in self._episodes]),
                Table([episode.eyes for episode in self._episodes]),
            )
            states = self._waits, self._ticks, self._time_ns, self._lost, self._setting.controller, self._setpoints
            seen = self._windows, self._setting.scale, self._weights, self._deviations, self._present
            parts: tuple[Any, ...] = (*tables, *states, *seen)
            self._all = Episodes(*parts)
        all_of = self._all
        list(self._pool.map(lambda first: step_many(all_of, first, self._threads), range(self._threads)))
        for i in np.flatnonzero(self._lost & ~self._waits):  # also stopped by an error of a class beside the agent
            check(self._episodes[i].loop.programs)

    def close_extras(self, **_: Any) -> None:
        """End the threads."""
        self._pool.shutdown()
