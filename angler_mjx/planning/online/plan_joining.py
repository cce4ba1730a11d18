"""Transition between plans: the rest of one, and the line to the next."""

from dataclasses import replace

import jax
import jax.numpy as jnp

from angler_mjx.robot.control.commands.trajectory import Trajectory, sample_reference

MIN_SPEED_MPS = 0.05
"""Least speed [m/s] on the line to a plan's first point."""


def pad_plan(plan: Trajectory, points: int) -> Trajectory:
    """Pad a plan [R] to at least ``points`` rows by repeating the last."""
    extra = max(points - plan.time_s.shape[-1], 0)
    return replace(
        plan,
        time_s=jnp.pad(plan.time_s, ((0, 0), (0, extra)), mode="edge"),
        position_m=jnp.pad(plan.position_m, ((0, 0), (0, extra), (0, 0)), mode="edge"),
    )


def remaining_plan(plan: Trajectory, clock_s: jax.Array) -> Trajectory:
    """Return the rest of a robot's plan after a time [] of its clock, counted from 0 again."""
    position_m, _ = sample_reference(plan, clock_s)
    has_passed = plan.time_s <= clock_s
    return replace(
        plan,
        time_s=jnp.maximum(plan.time_s - clock_s, 0.0),
        position_m=jnp.where(has_passed[:, None], position_m, plan.position_m),
    )


def join_plan(position_m: jax.Array, plan: Trajectory, speed_mps: jax.Array) -> Trajectory:
    """Put a line from ``position_m`` [3] to a plan's first point before it; one row more.

    Where the robot's place on the old plan is the first point of the new one, that takes no time.
    """
    step_m = plan.position_m[0] - position_m
    lead_s = jnp.sqrt(jnp.sum(step_m * step_m)) / jnp.maximum(speed_mps, MIN_SPEED_MPS)
    zero = jnp.zeros_like(lead_s)[None]
    return Trajectory(
        time_s=jnp.concatenate([zero, plan.time_s + lead_s]),
        position_m=jnp.concatenate([position_m[None], plan.position_m]),
        found=plan.found,
    )
