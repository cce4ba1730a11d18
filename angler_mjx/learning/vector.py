"""Environment with Gymnasium's vector API: arrays of NumPy in and out.

Needs the extra ``learn``. A sub-environment is a world with all its robots: observations are [W, R,
size], actions [W, R, size], and the reward of a world is the sum over its robots.
"""

import jax
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from angler_mjx.errors import ConfigError
from angler_mjx.learning import observations
from angler_mjx.learning.actions import check_actions
from angler_mjx.learning.environment import EnvState, FleetEnv

type Numbers = np.ndarray
type VectorInfo = dict[str, np.ndarray | VectorInfo]


class FleetVectorEnv(VectorEnv[Numbers, Numbers, Numbers]):
    """Batch of worlds, replaced in the step in which they end.

    Where any ended, ``info["final_obs"]`` and ``info["final_info"]`` hold their last values, and
    ``info["_final_obs"]`` and ``info["_final_info"]`` bool [W] mark these worlds. Every other entry
    has such a mask too, which is False for replaced worlds.
    """

    def __init__(self, env: FleetEnv) -> None:
        """Wrap an environment and share its bank."""
        self._env = env
        self._state: EnvState | None = None
        self._step, self._reset = jax.jit(FleetEnv.step), FleetEnv.reset
        low, high = observations.build_bounds(env.rules.parts)
        self.num_envs = env.worlds
        self.single_observation_space = Box(
            np.tile(low, (env.robots, 1)), np.tile(high, (env.robots, 1)), dtype=np.float32
        )
        self.single_action_space = Box(-1.0, 1.0, env.action_shape[1:], np.float32)
        self.observation_space = batch_space(self.single_observation_space, env.worlds)
        self.action_space = batch_space(self.single_action_space, env.worlds)
        self.metadata = {
            "autoreset_mode": AutoresetMode.SAME_STEP,
            "observation_layout": observations.LAYOUT,
            "units": {part.name: part.unit for part in env.rules.parts},
            "action_unit": env.rules.action.unit,
            "action_range": env.rules.action.range,
        }
        self.spec, self.render_mode, self.closed = None, None, False

    def reset(
        self, *, seed: int | np.integer | None = None, options: dict[str, object] | None = None
    ) -> tuple[Numbers, VectorInfo]:
        """Start all worlds at t = 0.

        Args:
            seed: whole number that samples worlds of the bank; left out, they are its first at the
                first reset, and sampled further after it.
            options: None; there are no options.

        Raises:
            ConfigError: the seed is not a whole number, or there are options.
        """
        if options:
            raise ConfigError(f"options = {options}: there are no options; leave them out")
        if seed is not None and (isinstance(seed, bool) or not isinstance(seed, int | np.integer)):
            raise ConfigError(f"seed = {seed!r}: give one whole number for all worlds, or None")
        key = None if self._state is None else self._state.key
        if seed is not None:
            key = jax.random.key(int(seed) % 2**32)
        self._state, observation = self._reset(self._env, key)
        return np.array(observation, np.float32), {}

    def step(self, actions: Numbers) -> tuple[Numbers, Numbers, Numbers, Numbers, VectorInfo]:
        """Advance all worlds by one control step.

        Raises:
            ConfigError: no reset before, or the actions have another shape, or a number that is not
                finite.
        """
        if self._state is None:
            raise ConfigError("step: the environment was not reset; call reset first")
        clean_actions = np.asarray(actions, np.float32)
        check_actions(clean_actions, self._env.action_shape)
        self._state, observation, reward, terminated, truncated, info = self._step(
            self._env, self._state, clean_actions
        )
        host_values = jax.device_get((observation, reward, terminated, truncated, info))
        observation, reward, terminated, truncated, info = host_values
        final_observation = np.array(info.pop("final_obs"), np.float32)
        ended = terminated | truncated
        step_info = _add_masks(info, ~ended)
        if ended.any():
            step_info |= {"final_obs": final_observation, "_final_obs": ended}
            step_info |= {"final_info": _add_masks(info, ended), "_final_info": ended}
        total_reward = reward.sum(axis=1)
        return np.array(observation, np.float32), total_reward, terminated, truncated, step_info


def _add_masks(info: VectorInfo, mask: Numbers) -> VectorInfo:
    """Return info with a mask bool [W] beside each entry, also in nested dictionaries."""
    masked: VectorInfo = {}
    for name, value in info.items():
        masked[name] = _add_masks(value, mask) if isinstance(value, dict) else value
        masked[f"_{name}"] = mask.copy()
    return masked
