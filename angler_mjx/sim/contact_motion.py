"""Physics steps of everything in a world at once, where bodies touch and push each other.

Each body is advanced as if it were alone, and what touches changes the velocity that it ends with
(`angler_mjx.sim.physics.contact.resolve`). A body whose motion contact changed moves with the
velocity at the end of the step (semi-implicit Euler), which keeps the energy of a bounce; any other
keeps what the free step gave, to the bit.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import quaternion, rigid_body
from angler_mjx.robot.control.commands.whole_body import JointTarget
from angler_mjx.robot.vehicles.damping import damping_wrench
from angler_mjx.robot.vehicles.link_motion import JointMotion, move_links
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.sim.impacts import Impacts, add_impacts, no_impacts
from angler_mjx.sim.physics import step as physics
from angler_mjx.sim.physics.closed_form import ClosedForm
from angler_mjx.sim.physics.contact import candidates, mjx_contact
from angler_mjx.sim.physics.contact.candidates import Rock
from angler_mjx.sim.physics.contact.grips import (
    Grips,
    find_grip_points,
    find_grip_rows,
    let_go,
    measure_forces,
    measure_wrench,
)
from angler_mjx.sim.physics.contact.layout import BodyLayout
from angler_mjx.sim.physics.contact.mjx_contact import Shapes
from angler_mjx.sim.physics.contact.resolve import (
    ContactForces,
    ContactSpec,
    WorldBodies,
    resolve_contact,
)
from angler_mjx.sim.physics.mjx_engine import BodyInertia
from angler_mjx.sim.physics.step import FreeStep, Multibody, VehicleState, Water
from angler_mjx.sim.posture import hull_capsules, locate_end_effectors
from angler_mjx.sim.state import FleetWorld, Touched
from angler_mjx.sim.step import joint_reference
from angler_mjx.world import obstacles as obstacle_motion
from angler_mjx.world.environment import Environment, region_corners
from angler_mjx.world.obstacles import BOX, DRIFT, Obstacles, ObstacleState

type Moved = tuple[VehicleState, ObstacleState, Grips | None, Impacts]
"""Robots, obstacles, grips and impacts after physics steps."""


@dataclass(frozen=True, kw_only=True)
class MovingWorld:
    """What does not change in a control period of one world with contact."""

    contact: ContactSpec
    layout: BodyLayout
    engine: Multibody[BodyInertia] | ClosedForm
    body: BodyInertia | VehicleParams
    """[R] inertia of the robots, as the engine wants it."""
    world: FleetWorld
    water: Water
    dt: float
    """Physics step, s."""
    thrust_n: jax.Array
    """[R, n_thruster] N that the thrusters settle at."""
    rock: Rock
    alive: jax.Array
    """bool [R] whether the robot moves; one that failed is held."""


def find_layout(
    contact: ContactSpec, environment: Environment, vehicles: VehicleParams, state: VehicleState
) -> BodyLayout:
    """Return the numbers of bodies of one world, from the settings and the shapes of its arrays."""
    hull = jax.eval_shape(
        hull_capsules, vehicles, None if state.joints is None else state.joints.position
    )
    obstacles, grip = environment.obstacles, contact.grip
    capsules = vehicles.link_capsules
    links = 0 if capsules is None else capsules.link.shape[-1]
    return BodyLayout(
        robots=state.p.shape[0],
        joints=0 if state.joints is None else state.joints.position.shape[1],
        capsules=hull[2].shape[1],
        obstacles=obstacles.kind.shape[0],
        has_capsules=any(kind != BOX for kind in obstacles.kinds),
        has_boxes=BOX in obstacles.kinds,
        axis_pieces=contact.axis_pieces,
        links=links if grip is not None and grip.by_end_effector else 0,
        held=grip.body if grip is not None and grip.by_end_effector else -1,
        slips=grip is not None and grip.friction_limits is not None,
    )


def move_together(
    moving: MovingWorld,
    vehicles: VehicleState,
    obstacles: ObstacleState,
    t: jax.Array,
    steps: int,
    joints: JointTarget | None,
    grips: Grips | None = None,
) -> Moved:
    """Return robots, obstacles, grips and impacts after the physics steps of a control period.

    Args:
        moving: the world.
        vehicles: [R] leads.
        obstacles: [O] leads.
        t: [] s at the beginning.
        steps: how many.
        joints: [R, J] motion that the servos of joints follow; None where no robot has any.
        grips: of the robots; None where they hold nothing.
    """

    def step_once(i: jax.Array, now: Moved) -> Moved:
        elapsed_s = i.astype(t.dtype) * moving.dt
        reference = None if joints is None else joint_reference(joints, elapsed_s)
        vehicles, obstacles, grips, impacts = now
        vehicles, obstacles, grips, new = step_together(
            moving, vehicles, obstacles, t + elapsed_s, reference, grips
        )
        return vehicles, obstacles, grips, add_impacts(impacts, new)

    if grips is not None:
        grips = replace(grips, wrench=jnp.zeros_like(grips.wrench))
    none = no_impacts(vehicles.p.shape[0], vehicles.p.dtype, holds=grips is not None)
    # `vmap` batches a loop twice where its start is not of each world and its end is; XLA drops a
    # choice between equals.
    none, grips = jax.tree.map(lambda x: jnp.where(t < 0.0, x, x), (none, grips))
    moved: Moved = jax.lax.fori_loop(0, steps, step_once, (vehicles, obstacles, grips, none))
    vehicles, obstacles, grips, impacts = moved
    if grips is not None:
        grips = replace(grips, wrench=grips.wrench / steps)
    return vehicles, obstacles, grips, impacts


def step_together(
    moving: MovingWorld,
    vehicles: VehicleState,
    obstacles: ObstacleState,
    t: jax.Array,
    reference: JointMotion | None,
    grips: Grips | None = None,
) -> Moved:
    """Return robots, obstacles, grips and impacts after one physics step.

    The wrenches of the step are added to those of the grips.

    Args:
        moving: the world.
        vehicles: [R] leads.
        obstacles: [O] leads.
        t: [] s.
        reference: [R, J] that the servos of joints hold; None where no robot has any.
        grips: of the robots; None where they hold nothing.
    """
    environment, control = moving.world.environment, moving.world.control
    rows, current = environment.obstacles, environment.current
    with jax.named_scope("free"):
        axes = (None, 0, 0, 0, 0, None, None, None, None, 0)
        step_freely: Callable[..., FreeStep] = physics.step_freely
        free = jax.vmap(step_freely, axes)(
            moving.engine,
            moving.body,
            control.vehicle,
            vehicles,
            moving.thrust_n,
            current,
            t,
            moving.dt,
            moving.water,
            reference,
        )
        water = moving.water.density_kgpm3, moving.water.gravity_mps2
        drift_one = partial(
            obstacle_motion.drift_freely,
            current=current,
            t=t,
            dt=moving.dt,
            density=water[0],
            gravity=water[1],
        )
        drifted_nu, nu_dot = jax.vmap(drift_one)(rows, obstacles)
    drifts = (rows.motion == DRIFT) & rows.exists
    with jax.named_scope("candidates"):
        touches = candidates.join_touches(
            mjx_contact.find_touches(moving.layout, shapes := _locate(moving, vehicles, obstacles)),
            candidates.touch_ground(moving.layout, shapes, moving.rock, environment.floor_z_m),
        )
    with jax.named_scope("contact"):
        bodies = _join_bodies(moving, vehicles, free, obstacles, drifted_nu, drifts)
        holding = tips = None
        if grips is not None and moving.contact.grip is not None:
            grip, robots = moving.contact.grip, moving.layout.robots
            if grip.by_end_effector:
                joints = None if vehicles.joints is None else vehicles.joints.position
                tips = locate_end_effectors(control.vehicle, joints)
            hold = find_grip_points(grip, vehicles.p, bodies.rotation[:robots], tips)
            holding = find_grip_rows(grip, moving.layout, grips, hold, bodies.p, bodies.rotation)
        forces = resolve_contact(moving.contact, moving.layout, bodies, touches, moving.dt, holding)
    after = _settle_robots(moving, vehicles, free, forces)
    moved = _settle_obstacles(moving, obstacles, drifted_nu, nu_dot, drifts, forces, t + moving.dt)
    impacts = _find_impacts(moving.layout, forces)
    force_n, moment_nm = forces.grip_force_n, forces.grip_moment_nm
    if grips is not None and moving.contact.grip is not None and force_n is not None:
        slip_m = None
        if holding is not None and moving.contact.grip.friction_limits is not None:
            slip_m = jnp.linalg.norm(holding.error[:, :3], axis=1)
        pull = measure_forces(moving.contact.grip, grips.held, force_n, slip_m)
        if moment_nm is not None:
            wrench = jnp.concatenate([force_n, moment_nm], axis=1)
            rotation = bodies.rotation[: moving.layout.robots]
            if tips is not None:
                body = moving.layout.robots + moving.contact.grip.body
                offset_m = bodies.p[body] - vehicles.p
                center_m = jax.vmap(quaternion.rotate_inverse)(vehicles.q, offset_m)
                grips = replace(grips, center_m=center_m, lever_m=tips.position)
            lever_m = None if tips is None else tips.position
            now = measure_wrench(grips.held, wrench, rotation, lever_m)
            grips = replace(grips, wrench=grips.wrench + now)
        impacts, grips = replace(impacts, grips=pull), let_go(grips, pull, moving.alive)
    return after, moved, grips, impacts


def _locate(moving: MovingWorld, vehicles: VehicleState, obstacles: ObstacleState) -> Shapes:
    joints = None if vehicles.joints is None else vehicles.joints.position
    a, b, r = hull_capsules(moving.world.control.vehicle, joints)

    def to_world(p: jax.Array, q: jax.Array, points: jax.Array) -> jax.Array:
        return p + jax.vmap(quaternion.rotate, (None, 0))(q, points)

    to_all = jax.vmap(to_world)
    hulls = to_all(vehicles.p, vehicles.q, a), to_all(vehicles.p, vehicles.q, b), r
    rows = moving.world.environment.obstacles
    return candidates.locate_shapes(moving.layout, hulls, rows, obstacles.p, obstacles.q)


def _to_world(q: jax.Array, nu: jax.Array) -> jax.Array:
    """Return velocities [..., n] whose linear part is in W, from those in body frames."""
    linear = jnp.vectorize(quaternion.rotate, signature="(4),(3)->(3)")(q, nu[..., :3])
    return jnp.concatenate([linear, nu[..., 3:]], axis=-1)


def _join_bodies(
    moving: MovingWorld,
    vehicles: VehicleState,
    free: FreeStep,
    obstacles: ObstacleState,
    drifted_nu: jax.Array,
    drifts: jax.Array,
) -> WorldBodies:
    end = free.state
    before, after = vehicles.nu, end.nu
    if vehicles.joints is not None and end.joints is not None:
        before = jnp.concatenate([before, vehicles.joints.velocity], axis=1)
        after = jnp.concatenate([after, end.joints.velocity], axis=1)
    velocity = [_to_world(vehicles.q, before), _to_world(obstacles.q, obstacles.nu)]
    _, q = jax.vmap(partial(rigid_body.advance_pose, dt=moving.dt))(
        obstacles.p, obstacles.q, obstacles.nu, drifted_nu
    )
    drifted = jnp.where(drifts[:, None], _to_world(q, drifted_nu), velocity[1])
    robots = _to_world(end.q, after)
    rows = moving.world.environment.obstacles
    mass = jnp.concatenate([jnp.repeat(rows.mass_kg[:, None], 3, 1), rows.inertia_kgm2], axis=1)
    mass = jnp.where(drifts[:, None], mass + rows.M_A, 1.0)
    inertia = mass[:, None, :] * jnp.eye(6, dtype=mass.dtype)
    screws, moved = _joint_screws(moving, vehicles)
    return WorldBodies(
        p=jnp.concatenate([vehicles.p, obstacles.p]),
        rotation=jax.vmap(quaternion.to_matrix)(jnp.concatenate([vehicles.q, obstacles.q])),
        free=jnp.concatenate([moving.alive, drifts]),
        velocity=jnp.concatenate([jnp.ravel(part) for part in velocity]),
        unconstrained=jnp.concatenate([jnp.ravel(robots), jnp.ravel(drifted)]),
        M_robots=jax.vmap(_inertia_to_world)(vehicles.q, _implicit_inertia(moving, free)),
        M_obstacles=jax.vmap(_inertia_to_world)(obstacles.q, inertia),
        screws=screws,
        moved=moved,
    )


def _implicit_inertia(moving: MovingWorld, free: FreeStep) -> jax.Array:
    """Return the inertia [R, n, n] of robots with the damping that is implicit in a step."""
    if free.nu_r is None:
        return free.M
    params = moving.world.control.vehicle
    slope = jax.vmap(rigid_body.damping_slope)(params.D_l, params.D_q, free.nu_r)
    return free.M + (0.5 * moving.dt) * slope[:, :, None] * jnp.eye(6, dtype=slope.dtype)


def _inertia_to_world(q: jax.Array, inertia: jax.Array) -> jax.Array:
    """Return an inertia [n, n] whose linear part is in W, for attitude q [4]."""
    turn = jnp.eye(inertia.shape[0], dtype=inertia.dtype)
    turn = turn.at[:3, :3].set(quaternion.to_matrix(q))
    turned = jnp.sum(turn[:, :, None] * inertia[None], axis=1)
    return jnp.sum(turned[:, None] * turn[None], axis=2)


def _joint_screws(
    moving: MovingWorld, vehicles: VehicleState
) -> tuple[jax.Array | None, jax.Array | None]:
    """Return screws [R, J, 6] of the joints, and which shapes [G, J] each moves."""
    params, joints = moving.world.control.vehicle, vehicles.joints
    links, capsules, layout = params.links, params.link_capsules, moving.layout
    if joints is None or links is None or capsules is None:
        return None, None
    screws = jax.vmap(lambda of, now, nu: move_links(of, now, nu).screws)(
        links, joints, vehicles.nu
    )
    # The base is the last, number -1: no joint moves it.
    by_link = np.concatenate([np.asarray(links.tree.moves, float), np.zeros((1, layout.joints))])
    of_links = jnp.asarray(by_link, vehicles.p.dtype)[capsules.link]  # [R, c, J]
    base = jnp.zeros((layout.robots, layout.capsules - of_links.shape[1], layout.joints))
    of_robots = jnp.concatenate([base.astype(of_links.dtype), of_links], axis=1)
    others = jnp.zeros((layout.shapes - layout.robots * layout.capsules, layout.joints))
    of_robots = jnp.reshape(of_robots, (-1, layout.joints))
    return screws, jnp.concatenate([of_robots, others.astype(of_robots.dtype)])


def _settle_robots(
    moving: MovingWorld, vehicles: VehicleState, free: FreeStep, forces: ContactForces
) -> VehicleState:
    """Return robots after the step: those that contact pushed with their new velocity."""
    layout, params = moving.layout, moving.world.control.vehicle
    split = layout.robots * layout.robot_velocities
    velocity = jnp.reshape(forces.velocity[:split], (layout.robots, layout.robot_velocities))

    def settle(
        params: VehicleParams,
        before: VehicleState,
        free: FreeStep,
        velocity: jax.Array,
        touched: jax.Array,
        alive: jax.Array,
    ) -> VehicleState:
        p, q, nu = _move_pose(before.p, before.q, velocity[:6], moving.dt)
        end, joints = free.state, free.state.joints
        force_before = end.force_before
        if free.nu_r is not None:
            damping = partial(damping_wrench, params)
            through = free.nu_r - before.nu
            force_before = force_before + damping(through + nu) - damping(through + end.nu)
        if joints is not None and before.joints is not None:
            speed = velocity[6:]
            joints = JointMotion(
                position=before.joints.position + moving.dt * speed, velocity=speed
            )
        pushed = replace(end, p=p, q=q, nu=nu, joints=joints, force_before=force_before)
        settled: VehicleState = jax.tree.map(
            lambda new, old, held: jnp.where(alive, jnp.where(touched, new, old), held),
            pushed,
            end,
            before,
        )
        return settled

    touched = forces.touched[: layout.robots]
    return jax.vmap(settle)(params, vehicles, free, velocity, touched, moving.alive)


def _move_pose(
    p: jax.Array, q: jax.Array, velocity: jax.Array, dt: float
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return pose and velocity nu [6] after dt at a velocity [6], its linear part in W."""
    turn = quaternion.exp_small(dt * velocity[3:])
    turned = quaternion.multiply(q, turn)
    turned = turned * jax.lax.rsqrt(jnp.sum(turned * turned))
    linear = quaternion.rotate_inverse(turned, velocity[:3])
    return p + dt * velocity[:3], turned, jnp.concatenate([linear, velocity[3:]])


def _settle_obstacles(
    moving: MovingWorld,
    obstacles: ObstacleState,
    drifted_nu: jax.Array,
    nu_dot: jax.Array,
    drifts: jax.Array,
    forces: ContactForces,
    end_s: jax.Array,
) -> ObstacleState:
    """Return obstacles after the step; a side or the top of the region turns them back."""
    layout, environment = moving.layout, moving.world.environment
    split = layout.robots * layout.robot_velocities
    velocity = jnp.reshape(forces.velocity[split:], (layout.obstacles, 6))
    lo, hi = region_corners(environment)

    def settle(
        body: Obstacles,
        before: ObstacleState,
        drifted_nu: jax.Array,
        nu_dot: jax.Array,
        drifts: jax.Array,
        velocity: jax.Array,
        touched: jax.Array,
    ) -> ObstacleState:
        scripted = obstacle_motion.follow_script(body, before, end_s, lo, hi)
        p, q = rigid_body.advance_pose(before.p, before.q, before.nu, drifted_nu, moving.dt)
        free = p, q, drifted_nu
        pushed = _move_pose(before.p, before.q, velocity, moving.dt)
        p, q, nu = (jnp.where(touched, new, old) for new, old in zip(pushed, free, strict=True))
        radius = obstacle_motion.bounding_radius(body.kind, body.size_m)
        v = quaternion.rotate(q, nu[:3])
        p, v = obstacle_motion.keep_within(p, v, (lo + radius).at[2].set(-jnp.inf), hi - radius)
        nu = jnp.concatenate([quaternion.rotate_inverse(q, v), nu[3:]])
        drifted = ObstacleState(p=p, q=q, nu=nu, nu_dot=nu_dot)
        settled: ObstacleState = jax.tree.map(
            lambda new, old: jnp.where(drifts, new, old), drifted, scripted
        )
        return settled

    return jax.vmap(settle)(
        environment.obstacles,
        obstacles,
        drifted_nu,
        nu_dot,
        drifts,
        velocity,
        forces.touched[layout.robots :],
    )


def _find_impacts(layout: BodyLayout, forces: ContactForces) -> Impacts:
    """Return the impacts of the robots of one world in one step."""
    owners = np.concatenate([layout.shape_bodies(), [-1, -1]])
    kinds = np.where(owners < layout.robots, Touched.ROBOT, Touched.OBSTACLE)
    kinds[-2:] = Touched.CELL, Touched.FLOOR
    numbers = np.where(owners < layout.robots, owners, owners - layout.robots)
    numbers[-2:] = -1
    touches = forces.touches
    sides = [(touches.first, touches.second), (touches.second, touches.first)]
    pushes = forces.normal_force_n > 0.0
    robot = jnp.arange(layout.robots)[:, None]
    is_robots = [(jnp.asarray(owners)[side][None] == robot) & pushes for side, _ in sides]
    meets = is_robots[0] | is_robots[1]  # [R, k]
    energy = jnp.where(meets, forces.impact_energy_j, -1.0)
    hardest = jnp.argmax(energy, axis=1)
    other = jnp.where(
        jnp.take_along_axis(is_robots[0], hardest[:, None], axis=1)[:, 0],
        sides[0][1][hardest],
        sides[1][1][hardest],
    )
    any_touch = jnp.any(meets, axis=1)

    def of_robots(values: jax.Array) -> jax.Array:
        return jnp.max(jnp.where(meets, values, 0.0), axis=1)

    return Impacts(
        energy_j=of_robots(forces.impact_energy_j),
        closing_speed_mps=jnp.where(any_touch, forces.closing_speed_mps[hardest], 0.0),
        touched=jnp.where(any_touch, jnp.asarray(kinds)[other], 0).astype(jnp.int32),
        touched_index=jnp.where(any_touch, jnp.asarray(numbers)[other], -1).astype(jnp.int32),
        depth_m=of_robots(touches.depth_m),
        force_n=of_robots(forces.normal_force_n),
    )
