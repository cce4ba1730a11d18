"""Motion of all bodies of one world that touch and hold each other, compiled to one call.

The steps are those of the simulator (`angler_mjx.sim.contact_motion.step_together`), in float64 and
at the step of the lock-step: vehicles, obstacles and grips move together.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp

from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.sim import robot
from angler_mjx.sim.contact_motion import MovingWorld, find_layout, step_together
from angler_mjx.sim.impacts import add_impacts, no_impacts
from angler_mjx.sim.physics.closed_form import ClosedForm
from angler_mjx.sim.physics.contact.candidates import Rock
from angler_mjx.sim.physics.contact.grips import Grips
from angler_mjx.sim.physics.contact.resolve import ContactSpec
from angler_mjx.sim.physics.step import Water
from angler_mjx.sim.state import FleetWorld, WorldState
from angler_mjx.world.environment import Environment
from angler_sitl.scene.motion import (
    DIVERGED_COLUMN,
    OUTCOME_COLUMN,
    STEPS_COLUMN,
    VEHICLE_COLUMN,
    ContactBodies,
    MotionArrays,
    MotionRows,
    SceneMotion,
    compile_step,
    find_joint_reference,
    flatten_tree,
    pack_row,
    to_thruster_pwm,
    unflatten_tree,
)


def compile_contact_motion(
    contact: ContactSpec,
    water: Water,
    dt_s: float,
    steps_per_period: int,
    worlds: FleetWorld,
    state: WorldState,
) -> SceneMotion:
    """Compile the step for worlds like this one.

    Args:
        contact: settings of contact.
        water: the medium.
        dt_s: the step.
        steps_per_period: steps between judgements, which take the impacts of a period.
        worlds: [1] leads; another of the same scenario has the same shapes.
        state: [1] leads.
    """
    constants_tree = select_contact_constants(worlds)
    bodies_tree = ContactBodies.of_state(state)
    rows = MotionRows.of_vehicles(state.vehicles)
    thrusters = worlds.control.vehicle.B.shape[-1]

    def step(
        constants: jax.Array,
        arrays: MotionArrays,
        inputs: jax.Array,
        targets: jax.Array | None = None,
        begin: jax.Array | None = None,
    ) -> MotionArrays:
        state_rows, flat_bodies = arrays
        params, environment, rock = unflatten_tree(constants_tree, constants)
        bodies = unflatten_tree(bodies_tree, flat_bodies)
        before = jax.vmap(rows.unpack_row)(state_rows[:, VEHICLE_COLUMN:])
        outcome, number = inputs[:, OUTCOME_COLUMN], inputs[0, STEPS_COLUMN]
        pwm = to_thruster_pwm(inputs[:, :thrusters], state_rows.dtype)
        thrust_n, _ = jax.vmap(robot.thrust_and_power)(params, pwm)
        world = _flown_world(worlds, params, environment)
        moving = MovingWorld(
            contact=contact,
            layout=find_layout(contact, environment, params, before),
            engine=ClosedForm(gravity_mps2=water.gravity_mps2),
            body=params,
            world=world,
            water=water,
            dt=dt_s,
            thrust_n=thrust_n,
            rock=rock,
            alive=robot.is_moving(outcome),
        )
        taken = (number % steps_per_period).astype(state_rows.dtype)  # in this period
        moved, obstacles, grips, impacts = step_together(
            moving,
            before,
            bodies.obstacles,
            number.astype(state_rows.dtype) * dt_s,
            find_joint_reference(inputs, targets, begin, dt_s),
            _scale_wrench(bodies.grips, taken),
        )
        grips = _scale_wrench(grips, 1.0 / (taken + 1.0))
        after, broken = jax.vmap(robot.hold_if_ended)(outcome, before, moved)
        packed = jax.vmap(pack_row, (0, 0, 0, 0, None))(
            before, after, state_rows[:, DIVERGED_COLUMN], broken, dt_s
        )
        none = no_impacts(len(packed), state_rows.dtype, holds=grips is not None)
        begins = taken == 0
        so_far = jax.tree.map(lambda new, old: jnp.where(begins, new, old), none, bodies.impacts)
        after_bodies = ContactBodies(
            obstacles=obstacles, grips=grips, impacts=add_impacts(so_far, impacts)
        )
        leaves = [jnp.ravel(leaf) for leaf in jax.tree.leaves(after_bodies)]
        return packed, jnp.concatenate([leaf.astype(packed.dtype) for leaf in leaves])

    widths = rows.pack(state.vehicles).shape[1], len(flatten_tree(bodies_tree))
    return SceneMotion(
        step=compile_step(step, constants_tree, state.vehicles, widths),
        vehicles=rows,
        select_constants=select_contact_constants,
        bodies=bodies_tree,
    )


def select_contact_constants(world: FleetWorld) -> tuple[VehicleParams, Environment, Rock]:
    """Return what the steps of bodies that touch need; [1] leads."""
    environment = world.environment
    return world.control.vehicle, environment, jax.vmap(Rock.of)(environment.grid)


def _scale_wrench(grips: Grips | None, factor: jax.Array) -> Grips | None:
    """Return grips with this multiple of their wrench: a mean from a sum, or a sum from a mean."""
    return None if grips is None else replace(grips, wrench=factor * grips.wrench)


def _flown_world(worlds: FleetWorld, params: VehicleParams, environment: Environment) -> FleetWorld:
    """Return one world with these vehicles and surroundings; other parts are not looked at."""
    one: FleetWorld = jax.tree.map(lambda leaf: leaf[0], worlds)
    return replace(one, control=replace(one.control, vehicle=params), environment=environment)
