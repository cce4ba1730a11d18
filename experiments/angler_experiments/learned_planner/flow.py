"""Flow matching: from noise to ways along straight lines, and back."""

import jax
import jax.numpy as jnp

from angler_experiments.learned_planner import network
from angler_experiments.learned_planner.network import Context, Params
from angler_experiments.learned_planner.scene import Scene
from angler_experiments.learned_planner.shapes import CHANNELS, INNER


def loss(
    params: Params, scenes: Scene, ways: jax.Array, counts: jax.Array, key: jax.Array
) -> jax.Array:
    """Mean square error [] of velocities over a batch of worlds.

    Args:
        params: of the network.
        scenes: [W] leading.
        ways: [W, R, inner, 4] of the expert.
        counts: bool [W, R] whose ways are to be learned.
        key: of noise and times.
    """
    of_noise, of_time = jax.random.split(key)
    noise = jax.random.normal(of_noise, ways.shape)
    time = jax.random.uniform(of_time, ways.shape[:1])
    share = time[:, None, None, None]
    between = (1.0 - share) * noise + share * ways

    def one(scene: Scene, way: jax.Array, t: jax.Array) -> jax.Array:
        return network.velocity(params, network.encode(params, scene), way, t)

    off = jax.vmap(one)(scenes, between, time) - (ways - noise)
    each = jnp.mean(off**2, axis=(2, 3))
    return jnp.sum(jnp.where(counts, each, 0.0)) / jnp.maximum(jnp.sum(counts), 1)


def draw(params: Params, context: Context, key: jax.Array, samples: int, steps: int) -> jax.Array:
    """Ways [samples, R, inner, 4] of one team.

    Each robot's noise is drawn by its place in the batch of ``key``'s numbers; see `noise`.

    Args:
        params: of the network.
        context: of the world.
        key: of the noise.
        samples: how many for each robot.
        steps: of the flow.
    """
    begin = noise(key, samples, context.exists.shape[0])
    return carried(params, context, begin, steps)


def noise(key: jax.Array, samples: int, robots: int) -> jax.Array:
    """Where ways begin, [samples, R, inner, 4]: of a robot by its number, in a team of any size."""

    def of(robot: jax.Array) -> jax.Array:
        return jax.random.normal(jax.random.fold_in(key, robot), (samples, INNER, CHANNELS))

    return jnp.swapaxes(jax.vmap(of)(jnp.arange(robots)), 0, 1)


def carried(params: Params, context: Context, begin: jax.Array, steps: int) -> jax.Array:
    """Noise [samples, R, inner, 4] carried to ways by ``steps`` steps of the midpoint rule."""
    rate = jax.vmap(network.velocity, in_axes=(None, None, 0, None))
    dt = 1.0 / steps

    def step(way: jax.Array, number: jax.Array) -> tuple[jax.Array, None]:
        t = number * dt
        half = way + 0.5 * dt * rate(params, context, way, t)
        return way + dt * rate(params, context, half, t + 0.5 * dt), None

    end, _ = jax.lax.scan(step, begin, jnp.arange(steps))
    return end
