"""Rows of the explicit obstacles of a file; the same in every world."""

import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from angler_mjx.world.obstacles import bodies
from angler_mjx.world.obstacles.config import (
    BoxConfig,
    CapsuleConfig,
    CircleMotion,
    DriftMotion,
    ExplicitConfig,
    SineMotion,
    SphereConfig,
    StraightMotion,
    Vector,
)
from angler_mjx.world.obstacles.types import (
    BOX,
    CAPSULE,
    CIRCLE,
    DRIFT,
    SINE,
    SPHERE,
    STATIC,
    STRAIGHT,
    Obstacles,
)

_MOTION = {"static": STATIC, "drift": DRIFT, "straight": STRAIGHT, "sine": SINE, "circle": CIRCLE}


def explicit_rows(items: Sequence[ExplicitConfig], density: jax.Array | float) -> Obstacles:
    """Return the obstacles of a list from a file, in its order.

    Args:
        items: at least one.
        density: [] density of the water, kg/m^3.
    """
    shapes = [_body_shape(item) for item in items]
    kind = [k for k, _, _ in shapes]
    body = [b for _, _, b in shapes]
    motion = [_MOTION[item.motion.type] for item in items]
    displaced = density * _to_array([b.volume_m3 for b in body])
    file_mass = _to_array([item.mass_kg or 0.0 for item in items])
    mass = jnp.where(file_mass > 0.0, file_mass, displaced)
    attitude = [_to_quaternion(item.rpy_deg) for item in items]
    return Obstacles(
        kind=jnp.array(kind, jnp.int32),
        size_m=_to_array([size for _, size, _ in shapes]),
        motion=jnp.array(motion, jnp.int32),
        path=_to_array([_motion_path(item) for item in items]),
        p0=_to_array([item.position_m for item in items]),
        q0=_to_array(attitude),
        nu0=_to_array([_start_velocity(item, q) for item, q in zip(items, attitude, strict=True)]),
        mass_kg=mass,
        inertia_kgm2=mass[:, None] * _to_array([b.inertia_m2 for b in body]),
        volume_m3=_to_array([b.volume_m3 for b in body]),
        M_A=density * _to_array([b.added for b in body]),
        D_l=jnp.zeros((len(items), 6)),
        D_q=0.5 * density * _to_array([b.drag for b in body]),
        exists=jnp.ones(len(items), bool),
        kinds=tuple(sorted(set(kind))),
        motions=tuple(sorted(set(motion))),
    )


def longest_axis(item: ExplicitConfig) -> bodies.Floats:
    """Return the vector [3] m, in W, from the centre of a body to the end of its longest axis.

    Of a capsule without its caps; of a box to the middle of a face; zero of a sphere.
    """
    kind, size, _ = _body_shape(item)
    half = {CAPSULE: (0.0, 0.0, size[1]), BOX: size, SPHERE: (0.0, 0.0, 0.0)}[kind]
    axis = np.where(np.arange(3) == np.argmax(half), half, 0.0)
    w, u = (q := _to_quaternion(item.rpy_deg))[0], q[1:]
    turn = 2.0 * np.cross(u, axis)
    rotated: bodies.Floats = axis + w * turn + np.cross(u, turn)
    return rotated


def find_gaps_m(item: ExplicitConfig, points: bodies.Floats) -> bodies.Floats:
    """Return distances [n], m, of points from the surface of a body; 0 and below are in it.

    Args:
        item: the body.
        points: [n, 3] from its centre, m, in W.
    """
    kind, size, _ = _body_shape(item)
    turn = Rotation.from_quat(_to_quaternion(item.rpy_deg), scalar_first=True)
    at = np.asarray(turn.inv().apply(points))
    if kind == BOX:
        outside: bodies.Floats = np.linalg.norm(np.maximum(np.abs(at) - size, 0.0), axis=1)
        return outside
    at[:, 2] -= np.clip(at[:, 2], -size[1], size[1])
    gaps: bodies.Floats = np.linalg.norm(at, axis=1) - size[0]
    return gaps


def _to_array(values: Sequence[object]) -> jax.Array:
    return jnp.asarray(np.array(values, float), float)


def _body_shape(item: ExplicitConfig) -> tuple[int, Vector, bodies.Body]:
    """Return kind, size as of `Obstacles.size_m`, and geometry."""
    match item:
        case SphereConfig():
            return SPHERE, (item.radius_m, 0.0, 0.0), bodies.build_sphere(item.radius_m)
        case BoxConfig():
            x, y, z = item.size_m
            half = (0.5 * x, 0.5 * y, 0.5 * z)
            return BOX, half, bodies.build_box(half)
        case CapsuleConfig():
            half_length = 0.5 * item.length_m
            size = (item.radius_m, half_length, 0.0)
            return CAPSULE, size, bodies.build_capsule(item.radius_m, half_length)


def _motion_path(item: ExplicitConfig) -> bodies.Floats:
    """Return the columns of `Obstacles.path`."""
    row = np.zeros(8)
    match item.motion:
        case StraightMotion() as motion:
            row[:3] = motion.velocity_mps
        case SineMotion() as motion:
            row[:3] = motion.amplitude_m
            row[3:5] = 2.0 * math.pi / motion.period_s, math.radians(motion.phase_deg)
        case CircleMotion() as motion:
            axis = np.array(motion.axis) / math.hypot(*motion.axis)
            axis = -axis if motion.clockwise else axis
            zero = np.eye(3)[1 if abs(axis[0]) > 0.9 else 0]
            arm = zero - (zero @ axis) * axis
            row[:3] = motion.radius_m * arm / np.linalg.norm(arm)
            row[3:5] = 2.0 * math.pi / motion.period_s, math.radians(motion.phase_deg)
            row[5:8] = axis
        case _:
            pass
    return row


def _start_velocity(item: ExplicitConfig, q: bodies.Floats) -> bodies.Floats:
    """Return the velocity [6] at the start relative to the water, body frame."""
    nu = np.zeros(6)
    if isinstance(item.motion, DriftMotion):
        v, w, u = np.array(item.motion.relative_velocity_mps), q[0], -q[1:]
        turn = 2.0 * np.cross(u, v)
        nu[:3] = v + w * turn + np.cross(u, turn)
    return nu


def _to_quaternion(rpy_deg: Vector) -> bodies.Floats:
    """Return the attitude [4] (wxyz) of rotations about the world's x, then y, then z."""
    roll, pitch, yaw = (0.5 * math.radians(angle) for angle in rpy_deg)
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    return np.array(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )
