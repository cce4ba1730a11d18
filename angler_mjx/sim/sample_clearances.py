"""Distances to what is near, of recorded samples: worked out from these, not in every step.

A sample holds where everything is, so that what is asked for here costs nothing between samples,
is the same function in every engine, and adds nothing to the programs of runs that do not ask.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp

from angler_mjx.sim.detection import compute_distances
from angler_mjx.sim.record import Clearance, Sample
from angler_mjx.sim.state import FleetWorld, SimSpec
from angler_mjx.world.obstacles import ObstacleState


def add_clearances(spec: SimSpec, worlds: FleetWorld, sample: Sample) -> Sample:
    """A sample [W, ...] of worlds with the distances that are asked for."""
    if "clearance" not in spec.also:
        return sample
    return replace(sample, clearance=_compute_clearances(worlds, _extract_poses(sample)))


def add_all_clearances(spec: SimSpec, worlds: FleetWorld, samples: Sample) -> Sample:
    """The same of samples [W, n, ...], one after another: all at once would need much memory."""
    if "clearance" not in spec.also:
        return samples
    in_turn = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 1, 0), _extract_poses(samples))
    by_sample = jax.lax.map(lambda poses: _compute_clearances(worlds, poses), in_turn)
    by_world: Clearance = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, 1), by_sample)
    return replace(samples, clearance=by_world)


def _extract_poses(sample: Sample) -> tuple[jax.Array, ...]:
    joints = () if sample.joints is None else (sample.joints.position,)
    return sample.p, sample.q, sample.obstacle_p, sample.obstacle_q, *joints


def _compute_clearances(worlds: FleetWorld, poses: tuple[jax.Array, ...]) -> Clearance:
    def world_clearance(
        world: FleetWorld,
        p: jax.Array,
        q: jax.Array,
        body_p: jax.Array,
        body_q: jax.Array,
        joint_position: jax.Array | None = None,
    ) -> Clearance:
        still = jnp.zeros((*body_p.shape[:-1], 6), body_p.dtype)
        bodies = ObstacleState(p=body_p, q=body_q, nu=still, nu_dot=still)
        rock, obstacle, robot = compute_distances(
            world.environment, world.control.vehicle, p, q, bodies, joint_position
        )
        return Clearance(rock_m=rock, obstacle_m=obstacle, robot_m=robot)

    return jax.vmap(world_clearance)(worlds, *poses)
