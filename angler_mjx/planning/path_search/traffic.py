"""Traffic: moving robots and bodies in time, from which a planned robot keeps clear."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.robot.control.commands.trajectory import Trajectory


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class GridTraffic:
    """Timed paths of robots, or of other bodies, as one robot has to respect them."""

    time_s: jax.Array
    """[R, P] times of the way-points; held after the last."""
    position_m: jax.Array
    """[R, P, 3] way-points, W."""
    reach_m: jax.Array
    """[R] distance to keep between the centres."""
    until_s: jax.Array
    """[R] time up to which this robot counts; negative: never."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class PlannedTraffic:
    """Traffic of one robot: other robots and bodies."""

    robots: GridTraffic
    bodies: GridTraffic | None
    """Obstacles; None where none is known of."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Balls:
    """The traffic during each layer: a ball per robot that holds it, grown by the reach."""

    centre_m: jax.Array
    """[L, R, 3] position at the middle of the layer."""
    radius_m: jax.Array
    """[L, R] reach plus the farthest motion within the layer; negative where the robot
    does not count."""


def build_balls(traffic: GridTraffic, layer_s: jax.Array, n_layer: int) -> Balls:
    """Build balls that hold the traffic during layers of ``layer_s`` [] from time 0 on.

    Within a layer a robot cannot be farther from where it is at the middle than the length of path
    between, whatever corners it takes.
    """
    half = np.arange(2 * n_layer + 1, dtype=np.int32) * (0.5 * layer_s)
    time, point = traffic.time_s, traffic.position_m
    leg = point[:, 1:] - point[:, :-1]
    span = time[:, 1:] - time[:, :-1]
    safe = jnp.where(span > 0.0, span, 1.0)
    fraction = jnp.clip((half[:, None, None] - time[:, :-1]) / safe, 0.0, 1.0)
    length = jnp.sqrt(jnp.sum(leg * leg, axis=-1))
    length_walked = jnp.sum(fraction * length, axis=-1)
    displacement_m = jnp.sum(fraction[1::2, ..., None] * leg, axis=2)
    max_deviation = jnp.maximum(
        length_walked[2::2] - length_walked[1:-1:2], length_walked[1:-1:2] - length_walked[:-2:2]
    )
    counts = half[:-1:2, None] <= traffic.until_s
    # 2 mm: rounding of the sums must not make a way look free that the exact test refuses.
    radius = traffic.reach_m + max_deviation + 2e-3
    return Balls(centre_m=point[:, 0] + displacement_m, radius_m=jnp.where(counts, radius, -1.0))


def concatenate_traffic(a: GridTraffic, b: GridTraffic) -> GridTraffic:
    """Concatenate two sets of rows; shorter rows repeat their last point."""
    points = max(a.time_s.shape[1], b.time_s.shape[1])

    def pad_rows(rows: GridTraffic) -> GridTraffic:
        extra = points - rows.time_s.shape[1]
        return GridTraffic(
            time_s=jnp.pad(rows.time_s, ((0, 0), (0, extra)), mode="edge"),
            position_m=jnp.pad(rows.position_m, ((0, 0), (0, extra), (0, 0)), mode="edge"),
            reach_m=rows.reach_m,
            until_s=rows.until_s,
        )

    combined: GridTraffic = jax.tree.map(
        lambda x, y: jnp.concatenate([x, y]), pad_rows(a), pad_rows(b)
    )
    return combined


def is_motion_clear(
    traffic: GridTraffic, a: jax.Array, t_a: jax.Array, b: jax.Array, t_b: jax.Array
) -> jax.Array:
    """Return whether steady motion from a [3] at t_a [] to b [3] at t_b keeps the reach; exact.

    Over the common time of the motion and one leg of another robot the relative motion is a
    straight line; its distance to the origin is the least distance.

    Returns:
        bool [].
    """
    return ~jnp.any(_meets_legs(traffic, a, t_a, b, t_b))


def meets_traffic(path: Trajectory, traffic: GridTraffic) -> jax.Array:
    """Return which rows of the traffic a path meets, its end held without limit; exact.

    Returns:
        bool [R].
    """
    position_m = jnp.concatenate([path.position_m, path.position_m[-1:]])
    # Nothing moves after the last way-point of all: standing so long is standing for ever.
    last = jnp.maximum(jnp.max(traffic.time_s), path.time_s[-1]) + 1.0
    time = jnp.append(path.time_s, last)
    legs = jax.vmap(_meets_legs, in_axes=(None, 0, 0, 0, 0))(
        traffic, position_m[:-1], time[:-1], position_m[1:], time[1:]
    )
    return jnp.any(legs, axis=(0, 2))


def _meets_legs(
    traffic: GridTraffic, a: jax.Array, t_a: jax.Array, b: jax.Array, t_b: jax.Array
) -> jax.Array:
    """Return whether steady motion comes within reach of each leg of the traffic, bool [R, P]."""
    begin = traffic.time_s
    end = jnp.concatenate([begin[:, 1:], jnp.full_like(begin[:, :1], jnp.inf)], axis=1)
    low = jnp.maximum(begin, t_a)
    high = jnp.minimum(jnp.minimum(end, t_b), traffic.until_s[:, None])
    moving = (end > begin) & jnp.isfinite(end)
    per_s = jnp.where(moving, 1.0 / jnp.where(moving, end - begin, 1.0), 0.0)
    rate = (b - a) / jnp.where(t_b > t_a, t_b - t_a, 1.0)
    near, step = [], []
    # Axis by axis on [R, P] arrays: the short last axis of points would not fill vector registers.
    for axis in range(3):
        point = traffic.position_m[:, :, axis]
        goes_to = jnp.concatenate([point[:, 1:], point[:, -1:]], axis=1)
        other = (goes_to - point) * per_s
        near.append(point + other * (low - begin) - a[axis] - rate[axis] * (low - t_a))
        step.append((other - rate[axis]) * (high - low))
    square = _dot_product(step, step)
    s = jnp.clip(-_dot_product(near, step) / jnp.where(square > 0.0, square, 1.0), 0.0, 1.0)
    gap = [n + s * d for n, d in zip(near, step, strict=True)]
    meets = _dot_product(gap, gap) < (traffic.reach_m**2)[:, None]
    return meets & (low <= high)


def _dot_product(a: list[jax.Array], b: list[jax.Array]) -> jax.Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
