"""Motion of the links of one vehicle, and the terms of the water on them.

Generalised velocity xi [n] = [nu; speeds of the joints], n = 6 + J, with nu that of the base at its
centre of mass, in F. The velocity of link l at its centre of mass, along its own axes, is
nu_l = J_l xi, [6]; a wrench w_l there acts on xi by J_l^T w_l. Of a body in water, as in
`angler_kernels.rigid_body`,

    w_l = - M_A (nu_l' - nu_c') - C_A(nu_lr) nu_lr - drag + buoyancy + [rho V Dv_c/Dt; 0],

    nu_l' = J_l xi' + J_l' xi,

so links add J_l^T M_A J_l to the inertia and J_l^T (w_l - M_A J_l' xi) to the force. The current is
that at the base, for all links. Drag is that of strips across and along the axes of cylinders.

No J_l is built. Velocities, wrenches and matrices of links are carried to the base's centre of mass
and axes, where those of all links add up: J_l = X_l [1, S_l], with X_l from there to the link, and
S_l the screws of the joints that move it (Featherstone, Rigid Body Dynamics Algorithms, 2008,
chapters 2, 5 and 6: recursive Newton-Euler and composite bodies). The acceleration J_l' xi is X_l
times the sum of the cross products of velocities and screws.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import quaternion, rigid_body
from angler_mjx.robot.vehicles.link_params import STRIPS, LinkParams, LinkTree


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class JointMotion:
    """Positions and speeds of the joints [J] of one vehicle, as they are or as they shall be."""

    position: jax.Array
    """[J] rad or m."""
    velocity: jax.Array
    """[J] rad/s or m/s."""


@dataclass(frozen=True, kw_only=True)
class LinkPoses:
    """Poses of links [L] and joints [J] in the frame F of the base."""

    origin: jax.Array
    """[L, 3] origin of each link's frame from the base's centre of mass, m."""
    rotation: jax.Array
    """[L, 3, 3] rotation from each link's frame."""
    center: jax.Array
    """[L, 3] centre of mass, m."""
    anchor: jax.Array
    """[J, 3] point on the axis of each joint, m."""
    axis: jax.Array
    """[J, 3] axis of each joint."""


@dataclass(frozen=True, kw_only=True)
class LinkMotion:
    """Velocities of links [L] at their centres of mass, along their own axes."""

    tree: LinkTree
    poses: LinkPoses
    screws: jax.Array
    """[J, 6] velocity at the base's centre of mass, in F, by the speed of each joint."""
    acceleration: jax.Array
    """[L, 6] J_l' xi: acceleration of each link at constant xi."""
    velocity: jax.Array
    """[L, 6] nu_l = J_l xi."""


def locate_links(links: LinkParams, position: jax.Array) -> LinkPoses:
    """Return the poses of links with their joints at ``position`` [J]."""
    tree = links.tree
    axis = _pick_or_zero(links.axis, tree.joints)
    change = _pick_or_zero(position - links.zero, tree.joints)
    slides = np.array([j >= 0 and tree.slides[j] for j in tree.joints])
    rotation, offset = links.rotation, links.position_m
    if slides.any():
        slide = jnp.where(slides, change, 0.0)[:, None]
        offset = offset + slide * _each_times(rotation, axis)
        change = jnp.where(slides, 0.0, change)
    rotation = _products(rotation, _turns(axis, change))
    poses: list[jax.Array] = []  # [3, 4] each: rotation and origin
    for i, parent in enumerate(tree.parents):
        pose = jnp.concatenate([rotation[i], offset[i][:, None]], axis=1)
        if parent >= 0:
            moved = _products(poses[parent][:, :3], pose)
            pose = jnp.concatenate([moved[:, :3], moved[:, 3:] + poses[parent][:, 3:]], axis=1)
        poses.append(pose)
    pose = jnp.stack(poses)
    rotation, origin = pose[:, :, :3], pose[:, :, 3]
    carrier = _carriers(tree)
    return LinkPoses(
        origin=origin,
        rotation=rotation,
        center=origin + _each_times(rotation, links.center_of_mass_m),
        anchor=_pick(origin, carrier),
        axis=_each_times(_pick(rotation, carrier), links.axis),
    )


def move_links(links: LinkParams, joints: JointMotion, nu: jax.Array) -> LinkMotion:
    """Return the motion of links.

    Args:
        links: of the vehicle.
        joints: their motion.
        nu: [6] velocity of the base, in F.
    """
    tree, poses = links.tree, locate_links(links, joints.position)
    turning = jnp.where(np.array(tree.slides, bool)[:, None], 0.0, poses.axis)
    linear = _cross(poses.anchor, turning) + poses.axis - turning
    screws = jnp.concatenate([linear, turning], axis=1)
    twist = nu + _sum_joints(tree, joints.velocity[:, None] * screws)
    carried = _pick(twist, _carriers(tree))
    bend = _cross(carried[:, 3:], linear) + _cross(carried[:, :3], turning)
    bend = jnp.concatenate([bend, _cross(carried[:, 3:], turning)], axis=1)
    return LinkMotion(
        tree=tree,
        poses=poses,
        screws=screws,
        acceleration=_to_links(poses, _sum_joints(tree, joints.velocity[:, None] * bend)),
        velocity=_to_links(poses, twist),
    )


def link_velocities(motion: LinkMotion, xi: jax.Array) -> jax.Array:
    """Return J_l xi [L, 6] for any xi [n] in the posture of ``motion``."""
    twist = xi[:6] + _sum_joints(motion.tree, xi[6:, None] * motion.screws)
    return _to_links(motion.poses, twist)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class EndEffectorMotion:
    """Pose of the end effector, and its velocity by xi, in F."""

    position: jax.Array
    """[3] from the base's centre of mass, m."""
    rotation: jax.Array
    """[3, 3] from the end effector's frame."""
    jacobian: jax.Array
    """[6, n] velocity and angular velocity by xi = [nu; speeds of the joints]."""


def locate_end_effector(links: LinkParams, position: jax.Array) -> EndEffectorMotion:
    """Return the motion of the end effector with the joints at ``position`` [J].

    Raises:
        ValueError: the vehicle file has no end effector.
    """
    tree, i = links.tree, links.tree.end_effector
    if i < 0:
        raise ValueError("the vehicle file has no table [end_effector]")
    poses = locate_links(links, position)
    tip = poses.origin[i] + rigid_body.matrix_times(poses.rotation[i], links.end_effector_m)
    rotation = jnp.sum(poses.rotation[i][:, :, None] * links.end_effector_rotation[None], axis=1)
    moves = jnp.asarray(tree.moves[i], tip.dtype)[:, None]
    turning = jnp.where(jnp.asarray(tree.slides)[:, None], 0.0, poses.axis)
    linear = moves * (_cross(turning, tip - poses.anchor) + poses.axis - turning)
    identity = jnp.eye(3, dtype=tip.dtype)
    columns = [
        jnp.concatenate([identity, jnp.zeros_like(identity)], axis=1),
        jnp.concatenate([_cross(identity, tip), identity], axis=1),
        jnp.concatenate([linear, moves * turning], axis=1),
    ]
    return EndEffectorMotion(position=tip, rotation=rotation, jacobian=jnp.concatenate(columns).T)


def _carriers(tree: LinkTree) -> tuple[int, ...]:
    """Return the number of the link [J] that each joint moves first."""
    return tuple(tree.joints.index(j) for j in range(len(tree.slides)))


def _pick(array: jax.Array, numbers: tuple[int, ...]) -> jax.Array:
    """Return rows [k, ...] of an array [m, ...] by their numbers."""
    if numbers == tuple(range(array.shape[0])):
        return array
    return array[np.array(numbers, int)]


def _pick_or_zero(array: jax.Array, numbers: tuple[int, ...]) -> jax.Array:
    """Return rows [k, ...] of an array [m, ...] by their numbers, zero for -1."""
    if -1 not in numbers:
        return _pick(array, numbers)
    return jnp.concatenate([array, jnp.zeros_like(array, shape=(1, *array.shape[1:]))])[
        np.array(numbers, int)
    ]


def _sum_joints(tree: LinkTree, by_joint: jax.Array) -> jax.Array:
    """Return the sums [L, 6] over the joints that move each link of ``by_joint`` [J, 6]."""
    moves = jnp.asarray(tree.moves, by_joint.dtype)
    return _sum_products(moves[:, :, None], by_joint[None], 1)


def _to_links(poses: LinkPoses, twist: jax.Array) -> jax.Array:
    """Return velocities [L, 6] at the links' centres along their axes from those at the base."""
    linear = twist[:, :3] + _cross(twist[:, 3:], poses.center)
    parts = jnp.stack([linear, twist[:, 3:]], axis=1)
    rotated = _sum_products(parts[:, :, :, None], poses.rotation[:, None], 2)
    return jnp.reshape(rotated, twist.shape)


def _to_base(poses: LinkPoses, wrench: jax.Array) -> jax.Array:
    """Return wrenches [L, 6] at the base's centre along its axes from those on links."""
    parts = jnp.reshape(wrench, (-1, 2, 1, 3))
    rotated = _sum_products(poses.rotation[:, None], parts, 3)
    force = rotated[:, 0]
    return jnp.concatenate([force, rotated[:, 1] + _cross(poses.center, force)], axis=1)


def _bodies_to_base(poses: LinkPoses, matrix: jax.Array) -> jax.Array:
    """Return symmetric matrices [L, 6, 6] of links as they act at the base's centre, in F."""
    rotation = poses.rotation[:, None]
    center = _each_times(_transpose(poses.rotation), poses.center)[:, None]
    mass, product, inertia = matrix[:, :3, :3], matrix[:, :3, 3:], matrix[:, 3:, 3:]
    inertia = inertia + _cross(center, _transpose(product))
    product = product + _cross(center, mass)
    inertia = inertia + _transpose(_cross(center, _transpose(product)))
    blocks = jnp.stack([mass, product, inertia], axis=1)
    turned = _products(_products(rotation, blocks), _transpose(rotation))
    return _symmetric(turned[:, 0], turned[:, 1], turned[:, 2])


def join_bodies(motion: LinkMotion, matrix: jax.Array) -> jax.Array:
    """Return the sum [n, n] over links of J_l^T A_l J_l, for symmetric A [L, 6, 6]."""
    tree, screws = motion.tree, motion.screws
    alone = _bodies_to_base(motion.poses, matrix)
    bodies = [alone[i] for i in range(len(tree.parents))]
    base = jnp.zeros_like(bodies[0])
    for i, parent in reversed(list(enumerate(tree.parents))):
        if parent >= 0:
            bodies[parent] = bodies[parent] + bodies[i]
        else:
            base = base + bodies[i]
    if not tree.slides:
        return base
    moved = jnp.stack([bodies[i] for i in _carriers(tree)])
    border = _each_times(moved, screws)  # [J, 6]
    # A joint acts on those that it carries, and they on it.
    carries = np.array(tree.carries)
    product = _sum_products(border[:, None], screws[None], 2)
    joined = jnp.where(carries | np.eye(len(screws), dtype=bool), product, 0.0)
    joined = joined + jnp.where(carries, product, 0.0).T
    return jnp.concatenate(
        [
            jnp.concatenate([base, border.T], axis=1),
            jnp.concatenate([border, joined], axis=1),
        ]
    )


def join_wrenches(motion: LinkMotion, wrench: jax.Array) -> jax.Array:
    """Return the sum [n] over links of J_l^T w_l, for w [L, 6]."""
    at_base = _to_base(motion.poses, wrench)
    moves = jnp.asarray(motion.tree.moves, wrench.dtype)
    moved = _sum_products(moves[:, :, None], at_base[:, None], 0)
    efforts = _sum_products(motion.screws, moved, 1)
    return jnp.concatenate([jnp.sum(at_base, axis=0), efforts])


def added_mass(links: LinkParams, density: jax.Array | float) -> jax.Array:
    """Return the added mass [L, 6, 6] of links, for the density [] of the water, kg/m^3."""
    return links.M_A + density * links.added_volume


def inertia_and_wrench(
    links: LinkParams,
    motion: LinkMotion,
    z: jax.Array,
    q: jax.Array,
    v_c: jax.Array,
    Dv_c: jax.Array,
    density: jax.Array | float,
    gravity: jax.Array | float,
) -> tuple[jax.Array, jax.Array]:
    """Return the inertia [L, 6, 6] of links, and the wrench [L, 6] on them at constant xi.

    Dry and added mass, weight and buoyancy, Coriolis terms and those of the flow; no drag.

    Args:
        links: of the vehicle.
        motion: of the links.
        z: [] height of the base above the surface, m, in W.
        q: [4] attitude of the base.
        v_c: [3] flow, m/s, in W.
        Dv_c: [3] its material derivative, m/s^2, in W.
        density: [] of the water, kg/m^3.
        gravity: [] m/s^2.
    """
    M_A, mass, up_base = added_mass(links, density), links.mass_kg[:, None], quaternion.world_up(q)
    flow_base, rate_base = quaternion.rotate_inverse(q, v_c), quaternion.rotate_inverse(q, Dv_c)
    up, flow, rate = _along_links(motion.poses, jnp.stack([up_base, flow_base, rate_base]))
    v, omega = motion.velocity[:, :3], motion.velocity[:, 3:]
    acceleration, turning_rate = motion.acceleration[:, :3], motion.acceleration[:, 3:]
    p_cb = links.center_of_buoyancy_m - links.center_of_mass_m
    height = z + jnp.sum(motion.poses.center * up_base, axis=1) + jnp.sum(p_cb * up, axis=1)
    submerged = rigid_body.submerged_fraction(height, links.fade_height_m)
    displaced = (density * links.volume_m3 * submerged)[:, None]
    # Momenta of the water at nu_r, and their rates by nu_l' - nu_c'.
    linear = jnp.stack([v - flow, acceleration - rate + _cross(omega, flow)], axis=1)
    angular = jnp.stack([omega, turning_rate], axis=1)
    moved = jnp.concatenate([linear, angular], axis=2)[:, :, None]
    momentum, pushed = jnp.moveaxis(_sum_products(M_A[:, None], moved, 3), 1, 0)
    spin, spun = jnp.moveaxis(jnp.sum(links.inertia_kgm2[:, None] * angular[:, :, None], 3), 1, 0)
    inert = mass * acceleration + pushed[:, :3] + _cross(omega, mass * v + momentum[:, :3])
    force = displaced * (gravity * up + rate) - mass * gravity * up - inert
    inert = spun + pushed[:, 3:] + _cross(omega, spin + momentum[:, 3:])
    inert = inert + _cross(v - flow, momentum[:, :3])
    moment = _cross(p_cb, displaced * gravity * up) - inert
    return M_A + _dry_inertia(links), jnp.concatenate([force, moment], axis=1)


def _dry_inertia(links: LinkParams) -> jax.Array:
    """Return the dry inertia [L, 6, 6] of links at their centres of mass."""
    mass = links.mass_kg[:, None, None] * jnp.eye(3, dtype=links.mass_kg.dtype)
    corner = ((0, 0), (0, 3), (0, 3)), ((0, 0), (3, 0), (3, 0))
    return jnp.pad(mass, corner[0]) + jnp.pad(links.inertia_kgm2, corner[1])


def relative_velocity(motion: LinkMotion, q: jax.Array, v_c: jax.Array) -> jax.Array:
    """Return the velocities [L, 6] of links in water that flows at v_c [3] m/s in W, for q [4]."""
    flow = _along_links(motion.poses, quaternion.rotate_inverse(q, v_c)[None])[0]
    return motion.velocity - jnp.concatenate([flow, jnp.zeros_like(flow)], axis=1)


@dataclass(frozen=True, kw_only=True)
class _Cylinders:
    """Velocities of cylinders [L, C] of links through the water, along the links' axes.

    The velocity along its axis is the same for all strips of a cylinder.
    """

    arm: jax.Array
    """[L, C, 3] centre from the link's centre of mass, m."""
    offset: jax.Array
    """[L, C, S] centre of each strip along the axis from there, m."""
    along: jax.Array
    """[L, C] velocity along the axis."""
    across: jax.Array
    """[L, C, S, 3] velocity of each strip across the axis."""


def drag_wrench(links: LinkParams, nu_r: jax.Array, density: jax.Array | float) -> jax.Array:
    """Return the drag [L, 6] of links at velocities ``nu_r`` [L, 6] through the water.

    Each strip drags - rho (A_n |v_n| v_n + A_a |v_a| v_a), with v_n across its axis, v_a along it.
    """
    moving, axis = _move_cylinders(links, nu_r), links.cylinder_axis
    weight = links.normal_area_m2[:, :, None] * _length(moving.across)
    along = STRIPS * links.axial_area_m2 * jnp.abs(moving.along) * moving.along
    force = _sum_products(weight[..., None], moving.across, 2) + along[:, :, None] * axis
    lever = _sum_products((weight * moving.offset)[..., None], moving.across, 2)
    moment = _cross(moving.arm, force) + _cross(axis, lever)
    return -density * jnp.sum(jnp.concatenate([force, moment], axis=2), axis=1)


def drag_slope(links: LinkParams, nu_r: jax.Array, density: jax.Array | float) -> jax.Array:
    """Return the symmetric [L, 6, 6] - d(drag)/d(nu_r) at ``nu_r`` [L, 6]; see `drag_wrench`."""
    moving, axis = _move_cylinders(links, nu_r), links.cylinder_axis
    speed, area = _length(moving.across), density * links.normal_area_m2[:, :, None]
    # d(|v| v)/dv = |v| 1 + v v^T / |v|
    normal, bend = area * speed, area / jnp.where(speed > 0, speed, 1.0)
    axial = (2.0 * density) * links.axial_area_m2 * jnp.abs(moving.along)
    along_axis = _outer(axis, axis)
    plane = jnp.eye(3, dtype=nu_r.dtype) - along_axis
    # Moments of the strips about the centres of cylinders, of degrees 0 to 2.
    powers = jnp.stack([jnp.ones_like(speed), moving.offset, moving.offset * moving.offset])
    moments = jnp.sum(powers * normal, axis=3)[..., None, None] * plane
    bent = (powers * bend)[..., None] * moving.across
    moments = moments + _sum_products(bent[..., None], moving.across[None, ..., None, :], 3)
    linear, first, second = moments[0], moments[1], moments[2]
    linear = linear + (STRIPS * axial)[:, :, None, None] * along_axis
    arm, axis = moving.arm[:, :, None], axis[:, :, None]
    mixed = _cross(arm, linear) + _cross(axis, first)
    second = _cross(arm, first) + _cross(axis, second)
    angular = _cross(arm, _transpose(mixed)) + _cross(axis, _transpose(second))
    return _symmetric(*(jnp.sum(block, axis=1) for block in (linear, mixed, angular)))


def _move_cylinders(links: LinkParams, nu_r: jax.Array) -> _Cylinders:
    """Return the motion of cylinders of links with velocities ``nu_r`` [L, 6]."""
    axis, omega = links.cylinder_axis, nu_r[:, None, 3:]
    arm = links.cylinder_m - links.center_of_mass_m[:, None]
    strips = (np.arange(STRIPS) + 0.5) / STRIPS - 0.5
    offset = links.cylinder_length_m[:, :, None] * jnp.asarray(strips, nu_r.dtype)
    v = nu_r[:, None, :3] + _cross(omega, arm)
    along = _sum_products(v, axis, 2)
    across = v - along[:, :, None] * axis
    across = across[:, :, None] + offset[..., None] * _cross(omega, axis)[:, :, None]
    return _Cylinders(arm=arm, offset=offset, along=along, across=across)


def _length(vector: jax.Array) -> jax.Array:
    """Return lengths [...] of vectors [..., 3], with a derivative of 0 at 0."""
    square = _sum_products(vector, vector, vector.ndim - 1)
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)


def _outer(a: jax.Array, b: jax.Array) -> jax.Array:
    return a[..., :, None] * b[..., None, :]


def _cross(a: jax.Array, b: jax.Array) -> jax.Array:
    """Return cross products [..., 3] of vectors [..., 3], in fewer operations than `jnp.cross`."""
    return _rolled(a * _rolled(b) - _rolled(a) * b)


def _rolled(vector: jax.Array) -> jax.Array:
    """Return vectors [..., 3] as (y, z, x)."""
    return jnp.concatenate([vector[..., 1:], vector[..., :1]], axis=-1)


def _transpose(matrix: jax.Array) -> jax.Array:
    return jnp.swapaxes(matrix, -1, -2)


def _symmetric(linear: jax.Array, mixed: jax.Array, angular: jax.Array) -> jax.Array:
    """Return symmetric matrices [L, 6, 6] from blocks [L, 3, 3]."""
    upper = jnp.concatenate([linear, mixed], axis=2)
    return jnp.concatenate([upper, jnp.concatenate([_transpose(mixed), angular], axis=2)], axis=1)


def _along_links(poses: LinkPoses, vectors: jax.Array) -> jax.Array:
    """Return vectors [k, 3] of F along the axes of links, [k, L, 3]."""
    return _sum_products(poses.rotation[None], vectors[:, None, :, None], 2)


def _sum_products(a: jax.Array, b: jax.Array, axis: int) -> jax.Array:
    """Return the sum of ``a * b`` over an axis of few entries, term by term.

    A reduction would keep all products in memory.
    """
    count = max(a.shape[axis], b.shape[axis])
    if not min(a.shape[axis], b.shape[axis]):  # a vehicle without joints
        return jnp.sum(a * b, axis=axis)
    total = _entry(a, 0, axis) * _entry(b, 0, axis)
    for k in range(1, count):
        total = total + _entry(a, k, axis) * _entry(b, k, axis)
    return total


def _entry(array: jax.Array, k: int, axis: int) -> jax.Array:
    """Return entry k along an axis, or the only one."""
    return jax.lax.index_in_dim(array, min(k, array.shape[axis] - 1), axis, keepdims=False)


def _each_times(matrix: jax.Array, vector: jax.Array) -> jax.Array:
    """Return products [L, m] of matrices [L, m, k] and vectors [L, k]."""
    return _sum_products(matrix, vector[:, None, :], 2)


def _products(a: jax.Array, b: jax.Array) -> jax.Array:
    """Return products [..., m, n] of matrices [..., m, k] and [..., k, n], as products and sums."""
    return _sum_products(a[..., :, :, None], b[..., None, :, :], a.ndim - 1)


def _turns(axis: jax.Array, angle: jax.Array) -> jax.Array:
    """Return rotations [L, 3, 3] about unit vectors [L, 3] by ``angle`` [L] rad.

    Also the identity for an angle of zero about no axis.
    """
    sine, cosine = jnp.sin(angle)[:, None, None], jnp.cos(angle)[:, None, None]
    identity = jnp.eye(3, dtype=axis.dtype)
    skew = jnp.swapaxes(_cross(axis[:, None], identity), 1, 2)  # columns: axis x e_i
    return cosine * identity + sine * skew + (1.0 - cosine) * _outer(axis, axis)
