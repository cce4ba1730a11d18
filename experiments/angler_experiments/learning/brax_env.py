"""Fleet environment for Brax's trainers: all worlds in one state.

Brax must not wrap it: the environment replaces ended worlds, and episodes have their own length.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import jax
import jax.numpy as jnp
from brax.envs.base import Env, State

from angler_mjx.learning.environment import FleetEnv


@contextmanager
def patch_device_put() -> Iterator[None]:
    """Restore, while Brax 0.14 trains, the one function that it calls and JAX 0.11 lacks."""

    def device_put_replicated[T](tree: T, devices: Sequence[jax.Device]) -> T:
        def replicate(leaf: jax.Array) -> jax.Array:
            return jnp.broadcast_to(leaf, (len(devices), *jnp.shape(leaf)))

        replicated: T = jax.tree.map(replicate, tree)
        return replicated

    if hasattr(jax, "device_put_replicated"):
        yield
        return
    jax.device_put_replicated = device_put_replicated  # type: ignore[assignment]
    try:
        yield
    finally:
        del jax.device_put_replicated


class BraxFleet(Env):  # type: ignore[misc]
    """Worlds of one robot each; observations [W, size], actions [W, size]."""

    def __init__(self, env: FleetEnv) -> None:
        """Wrap an environment with one robot in a world."""
        self._env = env

    def reset(self, rng: jax.Array) -> State:
        """Reset all worlds; ``rng`` [W, 2], of which the first is used."""
        key = jax.random.wrap_key_data(rng.reshape(-1, rng.shape[-1])[0])
        state, observation = self._env.reset(key)
        zeros = jnp.zeros(self._env.worlds)
        info = {"truncation": zeros, "episode_done": zeros, "episode_metrics": {}}
        return State(
            pipeline_state=state, obs=observation[:, 0], reward=zeros, done=zeros, info=info
        )

    def step(self, state: State, action: jax.Array) -> State:
        """Advance all worlds by one control step."""
        next_state, observation, reward, terminated, truncated, _ = self._env.step(
            state.pipeline_state, action[:, None]
        )
        done = (terminated | truncated).astype(reward.dtype)
        info = {
            **state.info,
            "truncation": truncated.astype(reward.dtype),
            "episode_done": done,
        }
        return state.replace(
            pipeline_state=next_state,
            obs=observation[:, 0],
            reward=reward[:, 0],
            done=done,
            info=info,
        )

    @property
    def observation_size(self) -> int:
        """Return the size of an observation."""
        return self._env.observation_shape[-1]

    @property
    def action_size(self) -> int:
        """Return the size of an action."""
        return self._env.action_shape[-1]

    @property
    def backend(self) -> str:
        """Return a name that is none of Brax's engines."""
        return "angler_mjx"

    def unbatched(self, **_: object) -> "BraxFleet":
        """Return the environment itself: wrappers are ignored."""
        return self
