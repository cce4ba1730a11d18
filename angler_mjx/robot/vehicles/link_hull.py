"""Hulls of the links of a vehicle: their capsules, and how far they reach."""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import numpy as np

from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.hull import Capsule
from angler_mjx.robot.vehicles.link_params import mount_m, rotation_matrix
from angler_mjx.robot.vehicles.links import BASE
from angler_mjx.robot.vehicles.thrusters import FloatArray

ON_BASE = -1
"""Number of the base among the links."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class LinkCapsules:
    """Capsules [c] of the links of one robot, each in the frame of its link."""

    link: jax.Array
    """int32 [c] number of each capsule's link; `ON_BASE` for one in F, from the centre of mass."""
    a_m: jax.Array
    """[c, 3] one end of each axis."""
    b_m: jax.Array
    """[c, 3] other end."""
    r_m: jax.Array
    """[c] radii."""


def build_link_capsules(config: VehicleConfig) -> LinkCapsules | None:
    """Return the capsules of a vehicle's links; None for a vehicle without any."""
    links = config.find_links(None)
    capsules = [(i, capsule) for i, link in enumerate(links) for capsule in link.capsules]
    if not links:
        return None
    dtype = jax.numpy.result_type(float)
    a_m = np.array([capsule.from_m for _, capsule in capsules], dtype).reshape(-1, 3)
    b_m = np.array([capsule.to_m for _, capsule in capsules], dtype).reshape(-1, 3)
    return LinkCapsules(
        link=jax.device_put(np.array([i for i, _ in capsules], np.int32)),
        a_m=jax.device_put(a_m),
        b_m=jax.device_put(b_m),
        r_m=jax.device_put(np.array([capsule.radius_m for _, capsule in capsules], dtype)),
    )


def home_link_reach_m(config: VehicleConfig) -> float:
    """Return the distance [m] from the base's centre of mass that its links at home stay within.

    0 without links.
    """
    joints = {joint.name: joint for joint in config.joints}
    poses, reach_m = {BASE: (np.zeros(3), np.eye(3))}, 0.0
    for link in config.find_links(None):
        center, turn = poses[link.parent]
        origin = center + turn @ mount_m(config, link)
        rotation = turn @ rotation_matrix(link.rpy_rad)
        if link.joint is not None:
            joint = joints[link.joint]
            change, axis = joint.home - joint.zero, np.asarray(joint.axis)
            if joint.type == "prismatic":
                origin = origin + rotation @ (change * axis)
            else:
                rotation = rotation @ _turn(axis, change)
        poses[link.name] = origin, rotation
        ends = [(origin + rotation @ end, c.radius_m) for c in link.capsules for end in _ends(c)]
        reach_m = max([reach_m, *(float(np.linalg.norm(end)) + r for end, r in ends)])
    return reach_m


def max_link_reach_m(config: VehicleConfig) -> float:
    """Return a bound [m] of the distance of links from the base's centre of mass in any posture.

    It is that of the arm drawn out straight: the lengths between joints added up. 0 without links.
    """
    joints = {joint.name: joint for joint in config.joints}
    origin_m, reach_m = {BASE: 0.0}, 0.0
    for link in config.find_links(None):
        joint = joints.get(link.joint or "")
        travel_m = 0.0
        if joint is not None and joint.type == "prismatic":
            travel_m = max(abs(joint.lower - joint.zero), abs(joint.upper - joint.zero))
        mount = float(np.linalg.norm(mount_m(config, link)))
        origin_m[link.name] = origin_m[link.parent] + mount + travel_m
        far = [np.linalg.norm(end) + c.radius_m for c in link.capsules for end in _ends(c)]
        reach_m = max([reach_m, *(origin_m[link.name] + float(value) for value in far)])
    return reach_m


def _ends(capsule: Capsule) -> tuple[FloatArray, FloatArray]:
    return np.asarray(capsule.from_m), np.asarray(capsule.to_m)


def _turn(axis: FloatArray, angle: float) -> FloatArray:
    """Return the rotation [3, 3] about a unit vector [3] by ``angle`` rad."""
    cross = np.cross(np.eye(3), axis)
    rotation: FloatArray = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
    return rotation


def pad_link_capsules(
    variants: Sequence[LinkCapsules | None],
    hulls: Sequence[tuple[jax.Array, jax.Array, jax.Array]],
) -> list[LinkCapsules | None]:
    """Return the capsules of the variants of a fleet in arrays of one length.

    Padding repeats the first capsule of the vehicle's own hull, which changes no distance.

    Args:
        variants: None for a vehicle without links, and everywhere in the result if all are.
        hulls: ends [3] and radius [] of the first capsule of each vehicle's hull, in F.
    """
    armed = [capsules for capsules in variants if capsules is not None]
    if not armed:
        return list(variants)
    count = max(len(capsules.link) for capsules in armed)
    nothing: LinkCapsules = jax.tree.map(lambda leaf: np.asarray(leaf)[:0], armed[0])
    return [
        _pad_capsules(nothing if capsules is None else capsules, hull, count)
        for capsules, hull in zip(variants, hulls, strict=True)
    ]


def _pad_capsules(
    capsules: LinkCapsules, hull: tuple[jax.Array, jax.Array, jax.Array], count: int
) -> LinkCapsules:
    on_base = jax.device_put(np.int32(ON_BASE))
    repeated = LinkCapsules(link=on_base, a_m=hull[0], b_m=hull[1], r_m=hull[2])
    more = count - len(capsules.link)

    def extend(leaf: jax.Array, row: jax.Array) -> np.ndarray:
        return np.concatenate([leaf, np.broadcast_to(row, (more, *leaf.shape[1:]))])

    padded: LinkCapsules = jax.tree.map(extend, capsules, repeated)
    return padded
