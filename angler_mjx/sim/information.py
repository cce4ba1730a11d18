"""What a planner or a policy may know of what moves, and how it comes to know it.

Four levels, of obstacles and of the current each. Drifting obstacles do not feel robots, so their
true motion can be rolled out ahead of the flight. What is predicted is worked out from one
observation: drifting obstacles in the current as far as that is known; scripted ones, whose script
nobody knows, straight on. Time is counted from the observation: that of a planner is made at the
start, that of a policy whenever it acts.
"""

import warnings
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import jax
import jax.numpy as jnp

from angler_kernels.quaternion import rotate
from angler_mjx._moved import renamed as _renamed
from angler_mjx.world import obstacles as bodies
from angler_mjx.world.currents import Current, Uniform, velocity
from angler_mjx.world.environment import Environment, region_corners
from angler_mjx.world.obstacles import (
    BOX,
    CAPSULE,
    DRIFT,
    SPHERE,
    STATIC,
    ObstacleState,
    bounding_radius,
)

type InformationLevel = Literal["nothing", "observed", "predicted", "truth"]
"""How much is known, the least first."""
LEVELS: tuple[str, ...] = get_args(InformationLevel.__value__)
"""Information levels, the least first."""

STEP_S = 0.5
"""Time between the places of a moving obstacle that are told: 0.5 m at 1 m/s."""


@dataclass(frozen=True, kw_only=True)
class Information:
    """What may be known."""

    obstacles: InformationLevel = "nothing"
    """Of those that move: nothing; where they are at the observation and how fast; where that will
    take them, in the current that is known; or where they will be."""
    current: InformationLevel = "nothing"
    """Nothing; its mean at the robots at the observation; all of it then, taken to stay; or all of
    it, for all time."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class ObstacleInformation:
    """Bodies that are not cells; [n] rows. Still ones stand on every map, whatever is known."""

    kind: jax.Array
    """int32 [n]: 0 sphere, 1 box, 2 capsule."""
    half_size_m: jax.Array
    """[n, 3] m: sphere (radius, 0, 0); box half edges along its own x, y, z; capsule (radius, half
    length of the axis, 0), the axis along the body's z."""
    radius_m: jax.Array
    """[n] sphere about the centre that holds the body, however it turns."""
    exists: jax.Array
    """bool [n] False for padding, and for what is not known."""
    moves: jax.Array
    """bool [n]."""
    velocity_mps: jax.Array
    """[n, 3] when observed; zero for still ones and where it is not known."""
    time_s: jax.Array
    """[T] times of the places since the observation; one, 0, where nothing is known of what
    comes."""
    p_m: jax.Array
    """[n, T, 3] places of the centre; held after the last."""
    q: jax.Array
    """[n, T, 4] attitudes, wxyz, body to W."""
    some_stand: bool = field(default=True, metadata={"static": True})
    """Whether any of them can be a still one: no code need look for those if not."""
    kinds: tuple[int, ...] = field(default=(SPHERE, BOX, CAPSULE), metadata={"static": True})
    """Kinds that occur; code for others need not be compiled."""

    @property
    def size_m(self) -> jax.Array:
        """[n, 3] the former name of `half_size_m`, with the same meaning."""
        warnings.warn(rename_warning(type(self)), DeprecationWarning, stacklevel=2)
        return self.half_size_m


def rename_warning(kind: type) -> str:
    """Return the warning of a class whose ``size_m`` has another name now."""
    return (
        f"{kind.__name__}.size_m is called half_size_m now: it holds half edges of boxes, where "
        "size_m of scenario files holds full edges"
    )


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class CurrentInformation:
    """The motion of the water as far as it is known."""

    components: Current
    """Added up; none where nothing is known."""
    stays: bool = field(metadata={"static": True})
    """Whether what was observed is taken to stay."""
    begin_s: jax.Array | None = None
    """[] time of the observation since the start of the flight; None for the start."""

    def velocity(self, p: jax.Array, t: jax.Array) -> jax.Array:
        """Velocity [3] m/s of the water at p [3] and t [] s after the observation."""
        after = jnp.zeros_like(t) if self.stays else t
        return velocity(self.components, p, after if self.begin_s is None else self.begin_s + after)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class SceneObservation:
    """What is seen of one world at a time of its flight."""

    time_s: jax.Array
    """[] since the start."""
    obstacles: ObstacleState
    at_m: jax.Array
    """[R, 3] where the robots are."""


def current_information(
    environment: Environment,
    level: InformationLevel,
    at_m: jax.Array | None = None,
    begin_s: jax.Array | None = None,
) -> CurrentInformation:
    """The current of one world at a level.

    Args:
        environment: one world.
        level: what may be known of it.
        at_m: [R, 3] the robots at the observation; their starts if left out.
        begin_s: [] time of the observation; the start if left out.
    """
    whole = environment.current
    if level == "nothing" or not whole:
        return CurrentInformation(components=(), stays=True)
    if level == "observed":
        robots = environment.start_m if at_m is None else at_m
        t = jnp.zeros((), robots.dtype) if begin_s is None else begin_s
        velocities = jax.vmap(lambda p: velocity(whole, p, t))(robots)
        return CurrentInformation(
            components=(Uniform(velocity_mps=jnp.mean(velocities, axis=0)),), stays=True
        )
    return CurrentInformation(components=whole, stays=level == "predicted", begin_s=begin_s)


def obstacle_information(
    environment: Environment,
    information: Information,
    horizon_s: float,
    dt_s: float,
    density: float,
    gravity: float,
    now: SceneObservation | None = None,
) -> ObstacleInformation:
    """The obstacles of one world at a level.

    Args:
        environment: one world.
        information: what may be known; of the current, for what is predicted.
        horizon_s: as far ahead as truth and prediction go.
        dt_s: step of the obstacles' motion: the control period of the simulation.
        density: of the water, kg/m^3.
        gravity: m/s^2, positive.
        now: what is observed; the start of the flight if left out.
    """
    body, level = environment.obstacles, information.obstacles
    moves = body.motion != STATIC
    still = all(motion == STATIC for motion in body.motions)
    if now is None:
        begin = bodies.reset(body, environment.current, density, gravity)
    else:
        begin = now.obstacles
    time, states = jnp.zeros(1), jax.tree.map(lambda leaf: leaf[None], begin)
    if level in ("predicted", "truth") and not still:
        predicted, runs = environment, True
        if level == "predicted":
            at_m, begin_s = (None, None) if now is None else (now.at_m, now.time_s)
            observed = current_information(environment, information.current, at_m, begin_s)
            predicted = replace(environment, current=observed.components)
            runs = not observed.stays
        since = None if now is None else now.time_s
        time, states = _predict_motion(
            predicted, begin, horizon_s, dt_s, density, gravity, since, runs
        )
    at_start = jax.vmap(lambda q, nu: rotate(q, nu[:3]))(begin.q, begin.nu)
    positions, attitudes = jnp.swapaxes(states.p, 0, 1), jnp.swapaxes(states.q, 0, 1)
    if level == "predicted":
        straight = begin.p[:, None] + at_start[:, None] * time[:, None]
        scripted = moves & (body.motion != DRIFT)
        positions = jnp.where(scripted[:, None, None], straight, positions)
    is_included = ~moves | (level != "nothing")
    return ObstacleInformation(
        kind=body.kind,
        half_size_m=jnp.where(is_included[:, None], body.size_m, 0.0),
        radius_m=jnp.where(is_included, jax.vmap(bounding_radius)(body.kind, body.size_m), 0.0),
        exists=body.exists & is_included,
        moves=moves,
        velocity_mps=jnp.where((moves & is_included)[:, None], at_start, 0.0),
        time_s=time,
        p_m=jnp.where(is_included[:, None, None], positions, 0.0),
        q=jnp.where(is_included[:, None, None], attitudes, jnp.array([1.0, 0.0, 0.0, 0.0])),
        some_stand=STATIC in body.motions,
        kinds=body.kinds,
    )


def _predict_motion(
    environment: Environment,
    begin: ObstacleState,
    horizon_s: float,
    dt_s: float,
    density: float,
    gravity: float,
    since_s: jax.Array | None,
    runs: bool,
) -> tuple[jax.Array, ObstacleState]:
    """Times [T] and states [T, n] every `STEP_S`, by the motion that the simulation steps too.

    ``runs``: whether the clock of the current does, from ``since_s`` [] on (0 where it is None).
    """
    every = max(1, round(STEP_S / dt_s))
    count = -(-round(horizon_s / dt_s) // every)
    lo, hi = region_corners(environment)

    def step(state: ObstacleState, number: jax.Array) -> tuple[ObstacleState, None]:
        if since_s is None:
            t = number * dt_s if runs else jnp.zeros(())
        else:
            t = since_s + number * dt_s if runs else since_s
        after = bodies.step(
            environment.obstacles,
            state,
            environment.current,
            t,
            dt_s,
            lo,
            hi,
            environment.grid,
            density,
            gravity,
        )
        return after, None

    def advance_interval(
        state: ObstacleState, number: jax.Array
    ) -> tuple[ObstacleState, ObstacleState]:
        after, _ = jax.lax.scan(step, state, number * every + jnp.arange(every))
        return after, after

    _, later = jax.lax.scan(advance_interval, begin, jnp.arange(count))
    states = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), begin, later)
    return jnp.arange(count + 1) * (every * dt_s), states


def __getattr__(name: str) -> object:
    """Return what had another name before 0.2."""
    return _renamed(__name__, name)
