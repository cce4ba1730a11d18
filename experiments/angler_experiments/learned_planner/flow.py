"""Flow matching: from noise to paths along straight lines, and back."""

import jax
import jax.numpy as jnp

from angler_experiments.learned_planner import network
from angler_experiments.learned_planner.network import EncodedScene, Params
from angler_experiments.learned_planner.scene import Scene
from angler_experiments.learned_planner.shapes import N_CHANNELS, N_INNER_POINTS


def loss(
    params: Params, scenes: Scene, paths: jax.Array, has_path: jax.Array, key: jax.Array
) -> jax.Array:
    """Return the mean square error [] of velocities over a batch of worlds.

    Args:
        params: parameters of the network.
        scenes: scenes, [W] leading.
        paths: [W, R, inner, 4] paths of the expert.
        has_path: bool [W, R] whether the path is learned.
        key: key of noise and times.
    """
    of_noise, of_time = jax.random.split(key)
    noise = jax.random.normal(of_noise, paths.shape)
    time = jax.random.uniform(of_time, paths.shape[:1])
    fraction = time[:, None, None, None]
    interpolated = (1.0 - fraction) * noise + fraction * paths

    def predict(scene: Scene, path: jax.Array, t: jax.Array) -> jax.Array:
        return network.velocity(params, network.encode_scene(params, scene), path, t)

    error = jax.vmap(predict)(scenes, interpolated, time) - (paths - noise)
    path_error = jnp.mean(error**2, axis=(2, 3))
    return jnp.sum(jnp.where(has_path, path_error, 0.0)) / jnp.maximum(jnp.sum(has_path), 1)


def sample_paths(
    params: Params, context: EncodedScene, key: jax.Array, samples: int, steps: int
) -> jax.Array:
    """Sample paths [samples, R, inner, 4] of one team.

    Each robot's noise is sampled by its index in the batch of ``key``'s numbers; see
    `sample_noise`.

    Args:
        params: parameters of the network.
        context: encoded scene of the world.
        key: key of the noise.
        samples: number of paths of each robot.
        steps: number of steps of the flow.
    """
    initial_noise = sample_noise(key, samples, context.exists.shape[0])
    return integrate_flow(params, context, initial_noise, steps)


def sample_noise(key: jax.Array, samples: int, robots: int) -> jax.Array:
    """Sample initial noise [samples, R, inner, 4].

    Of a robot by its number, in a team of any size.
    """

    def sample_robot(robot: jax.Array) -> jax.Array:
        return jax.random.normal(
            jax.random.fold_in(key, robot), (samples, N_INNER_POINTS, N_CHANNELS)
        )

    return jnp.swapaxes(jax.vmap(sample_robot)(jnp.arange(robots)), 0, 1)


def integrate_flow(
    params: Params, context: EncodedScene, initial_noise: jax.Array, steps: int
) -> jax.Array:
    """Transport noise [samples, R, inner, 4] to paths by ``steps`` steps of the midpoint rule."""
    rate = jax.vmap(network.velocity, in_axes=(None, None, 0, None))
    dt = 1.0 / steps

    def step(path: jax.Array, index: jax.Array) -> tuple[jax.Array, None]:
        t = index * dt
        midpoint = path + 0.5 * dt * rate(params, context, path, t)
        return path + dt * rate(params, context, midpoint, t + 0.5 * dt), None

    end, _ = jax.lax.scan(step, initial_noise, jnp.arange(steps))
    return end
