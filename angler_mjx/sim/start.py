"""How a world begins: robots at rest at their starts, obstacles in place, nothing accounted yet."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_mjx.errors import ConfigError
from angler_mjx.sim import hearing, robot, sensing
from angler_mjx.sim import policy as policies
from angler_mjx.sim.cargo import find_error, open_grips
from angler_mjx.sim.detection import detect_contacts
from angler_mjx.sim.physics import step as physics
from angler_mjx.sim.physics.contact.grips import take_hold
from angler_mjx.sim.physics.step import Multibody
from angler_mjx.sim.policy import Policy
from angler_mjx.sim.posture import locate_end_effectors
from angler_mjx.sim.state import FleetWorld, SimSpec, World, WorldState
from angler_mjx.sim.world_context import GoalAssignment, WorldContext
from angler_mjx.sim.world_phases import sense_motion
from angler_mjx.world import obstacles as obstacle_motion
from angler_mjx.world.acoustics import channel
from angler_mjx.world.tasks import task_update as tasks
from angler_mjx.world.tasks.spec import TaskState


def reset[Body](
    spec: SimSpec,
    engine: Multibody[Body],
    bodies: Body,
    world: FleetWorld,
    policy: Policy | None = None,
) -> WorldState:
    """One world at t = 0.

    Args:
        spec: settings.
        engine: of the fleet.
        bodies: the robots as the engine wants them, [R] leading.
        world: constants of the world.
        policy: that is to command the robots, if one is.

    Raises:
        ConfigError: the controllers cannot be commanded by the policy.
    """
    environment, water = world.environment, spec.water
    attitude = jax.vmap(quaternion.from_yaw)(environment.start_yaw_rad)
    vehicles = jax.vmap(physics.reset, (None, 0, 0, 0, 0, None, None))(
        engine,
        bodies,
        world.control.vehicle,
        environment.start_m,
        attitude,
        environment.current,
        water,
    )
    moving = obstacle_motion.reset(
        environment.obstacles, environment.current, water.density_kgpm3, water.gravity_mps2
    )
    contact = detect_contacts(environment, world.control.vehicle, vehicles, moving)
    cargo = grips = None
    if spec.cargo is not None and spec.contact is not None and spec.contact.grip is not None:
        # It is held: at rest, as the robots are, and not on its way with the water.
        body = spec.cargo.body
        moving = replace(
            moving, nu=moving.nu.at[body].set(0.0), nu_dot=moving.nu_dot.at[body].set(0.0)
        )
        error = find_error(spec.cargo, environment, moving)
        robots = environment.start_m.shape[:1]
        cargo = jax.tree.map(lambda x: jnp.broadcast_to(x, robots), error)
        grip, tips = spec.contact.grip, None
        if grip.by_end_effector:
            assert vehicles.joints is not None  # the scenario refuses fleets without arms
            tips = locate_end_effectors(world.control.vehicle, vehicles.joints.position)
        hold_m, approach = vehicles.p, spec.cargo.approach
        if approach is not None:
            hold_m = hold_m.at[:, 2].add(-approach.above_m)
        grips = take_hold(grip, hold_m, vehicles.q, moving.p, moving.q, tips)
        if approach is not None:
            grips = open_grips(grips)
    state = WorldState(
        vehicles=vehicles,
        carry=jax.vmap(partial(robot.reset_controllers, spec))(vehicles, environment.start_yaw_rad),
        obstacles=moving,
        tally=robot.begin_tally(
            contact,
            environment.start_m.dtype,
            collides=spec.contact is not None,
            cargo=cargo,
        ),
        step=jnp.zeros((), jnp.int32),
        senses=sensing.reset(spec, world, vehicles),
        task=_begin_task(spec, world),
        grips=grips,
    )
    if policy is not None:
        state = _begin_policy(spec, world, state, policy)
    if spec.acoustics is None:
        return state
    start_m = environment.start_m
    modem_state = hearing.reset(spec.acoustics, start_m, policy, state.policy, state.task)
    return replace(state, modem=modem_state)


def _begin_task(spec: SimSpec, world: World) -> TaskState | None:
    """The task of a world, of which nothing is done."""
    if spec.task is None:
        return None
    if world.task is None:
        raise ConfigError("the worlds have no task, and the simulation is of one; draw them for it")
    return tasks.begin_task(
        spec.task, world.task, world.environment.start_m, heard=spec.acoustics is not None
    )


def _begin_policy(
    spec: SimSpec, world: FleetWorld, state: WorldState, policy: Policy
) -> WorldState:
    """A state with the memory of a policy, which knows what the first step tells the robots."""
    context = WorldContext(
        spec=spec,
        policy=policy,
        world=world,
        number=state.step,
        vehicles=state.vehicles,
        obstacles=state.obstacles,
        outcome=state.tally.outcome,
        grips=state.grips,
    )
    belief = sense_motion(context, state.senses)[1]
    others = None if spec.acoustics is None else channel.init_heard(world.environment.start_m)
    sent = None
    if state.task is not None:  # The first look at the task comes with the first step.
        sent = GoalAssignment(goal_m=state.task.goal_m, goal_index=state.task.target)
    inputs = context.build_policy_input(belief, others, sent)
    memory = policies.begin_policy(policy, spec.stages, world.policy_key, inputs)
    return replace(state, policy=memory)
