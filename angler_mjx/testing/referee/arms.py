"""Arms of vehicles for the referee: postures by the recorded joints, and their limits.

Written from the description of vehicle files, without the simulator's own kinematics.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from angler_mjx.testing.referee.geometry import Floats

LIMIT_FRACTION = 0.05
"""Fraction of its range by which a joint may be beyond a limit: stops are springs."""


@dataclass(frozen=True, kw_only=True)
class RefereeArm:
    """Links [L] and joints [J] of a vehicle, in the order of the record; capsules [c]."""

    parent: Sequence[int]
    """[L] link that carries each, listed before it; -1: the vehicle."""
    joint: Sequence[int]
    """[L] joint that moves each; -1: none."""
    position_m: Floats
    """[L, 3] origin in the parent's frame, from the centre of mass in the vehicle's."""
    rotation: Floats
    """[L, 3, 3] to the parent's frame."""
    names: Sequence[str]
    """[J] names of the joints."""
    slides: Sequence[bool]
    """[J] whether each is prismatic."""
    axis: Floats
    """[J, 3] in the frame of its link."""
    zero: Floats
    """[J] position at which the link lies as the file says."""
    lower: Floats
    """[J] limits, rad or m."""
    upper: Floats
    """[J]"""
    capsule_link: NDArray[np.int64]
    """[c] link of each capsule."""
    a_m: Floats
    """[c, 3] one end of each axis, in the link's frame."""
    b_m: Floats
    """[c, 3] the other end."""
    r_m: Floats
    """[c]"""
    end_link: int = -1
    """Link that carries the end effector; -1: none."""
    end_m: Floats = field(default_factory=lambda: np.zeros(3))
    """[3] end effector in the frame of its link."""

    def locate_capsules(self, joints: Floats) -> tuple[Floats, Floats]:
        """Return the ends [T, c, 3] of the capsules' axes in body axes, for joints [T, J]."""
        origin, turn = self._locate_links(joints)
        at, to_body = origin[:, self.capsule_link], turn[:, self.capsule_link]
        return at + _apply(to_body, self.a_m), at + _apply(to_body, self.b_m)

    def locate_end_effector(self, joints: Floats) -> Floats:
        """Return the end effector [T, 3] from the centre of mass in body axes, for [T, J]."""
        origin, turn = self._locate_links(joints)
        offset = np.tile(self.end_m, (len(joints), 1))
        return origin[:, self.end_link] + _apply(turn[:, self.end_link], offset)

    def _locate_links(self, joints: Floats) -> tuple[Floats, Floats]:
        """Return origins [T, L, 3] and rotations [T, L, 3, 3] of links in body axes."""
        origins: list[Floats] = []
        turns: list[Floats] = []
        for link, (parent, joint) in enumerate(zip(self.parent, self.joint, strict=True)):
            origin = np.tile(self.position_m[link], (len(joints), 1))
            turn = np.tile(self.rotation[link], (len(joints), 1, 1))
            if parent >= 0:
                origin = origins[parent] + _apply(turns[parent], origin)
                turn = turns[parent] @ turn
            if joint >= 0:
                change = joints[:, joint] - self.zero[joint]
                if self.slides[joint]:
                    origin = origin + _apply(turn, change[:, None] * self.axis[joint])
                else:
                    turn = turn @ _rotations(self.axis[joint], change)
            origins.append(origin)
            turns.append(turn)
        return np.stack(origins, axis=1), np.stack(turns, axis=1)

    def find_excess(self, joints: Floats) -> str:
        """Return which joint is beyond its limits in which state of [T, J]; empty for none."""
        slack = LIMIT_FRACTION * (self.upper - self.lower)
        beyond = (joints < self.lower - slack) | (joints > self.upper + slack)
        if not beyond.any():
            return ""
        state, joint = np.argwhere(beyond)[0]
        return (
            f"joint {self.names[joint]} is at {joints[state, joint]:.4g} in state {state}, and its "
            f"limits are {self.lower[joint]:g} and {self.upper[joint]:g}"
        )


def read_arm(file: Mapping[str, Any]) -> RefereeArm | None:
    """Read the arm of a vehicle file; None for a vehicle without links.

    Raises:
        KeyError: a key is missing.
    """
    links = _order_links(file.get("links", []), "base")
    if not links:
        return None
    tables = {item["name"]: item for item in file.get("joints", [])}
    moving = [link["joint"] for link in links if link.get("joint") is not None]
    joints = [tables[name] for name in moving]
    names, tip = [link["name"] for link in links], file.get("end_effector")
    centre = np.asarray(file["base"]["center_of_mass_m"], float)
    parent = [-1 if _parent(link) == "base" else names.index(_parent(link)) for link in links]
    offset = np.array([centre if number < 0 else np.zeros(3) for number in parent])
    capsules = [(i, item) for i, link in enumerate(links) for item in link.get("capsules", [])]
    ends = {
        name: np.array([item[name] for _, item in capsules], float).reshape(-1, 3)
        for name in ("from_m", "to_m")
    }
    return RefereeArm(
        parent=parent,
        joint=[moving.index(link["joint"]) if link.get("joint") else -1 for link in links],
        position_m=np.array([link["position_m"] for link in links], float) - offset,
        rotation=np.array([_from_rpy(link.get("rpy_rad", (0.0, 0.0, 0.0))) for link in links]),
        names=moving,
        slides=[item["type"] == "prismatic" for item in joints],
        axis=np.array([item["axis"] for item in joints], float).reshape(-1, 3),
        zero=np.array([item.get("zero", 0.0) for item in joints], float),
        lower=np.array([item["lower"] for item in joints], float),
        upper=np.array([item["upper"] for item in joints], float),
        capsule_link=np.array([i for i, _ in capsules], np.int64),
        a_m=ends["from_m"],
        b_m=ends["to_m"],
        r_m=np.array([item["radius_m"] for _, item in capsules], float),
        end_link=-1 if tip is None else names.index(tip["link"]),
        end_m=np.zeros(3) if tip is None else np.array(tip["position_m"], float),
    )


def _parent(link: Mapping[str, Any]) -> str:
    return str(link.get("parent", "base"))


def _order_links(links: Sequence[Mapping[str, Any]], parent: str) -> list[Mapping[str, Any]]:
    """Return the links below a parent, each before its own, in the order of the record."""
    ordered: list[Mapping[str, Any]] = []
    for link in links:
        if _parent(link) == parent:
            ordered += [link, *_order_links(links, str(link["name"]))]
    return ordered


def _from_rpy(rpy_rad: Sequence[float]) -> Floats:
    """Return the rotation [3, 3] of roll, pitch and yaw: about z, then y, then x."""
    x, y, z = (
        _rotations(axis, np.array([angle]))[0]
        for axis, angle in zip(np.eye(3), rpy_rad, strict=True)
    )
    rotation: Floats = z @ y @ x
    return rotation


def _rotations(axis: Floats, angle: Floats) -> Floats:
    """Return rotations [T, 3, 3] about a unit axis [3] by angles [T], by Rodrigues's formula."""
    cross = np.cross(np.eye(3), axis)  # cross @ v = axis x v
    sine, versine = np.sin(angle)[:, None, None], (1.0 - np.cos(angle))[:, None, None]
    rotation: Floats = np.eye(3) + sine * cross + versine * (cross @ cross)
    return rotation


def _apply(rotation: Floats, vector: Floats) -> Floats:
    """Return vectors [..., 3] turned by rotations [..., 3, 3]."""
    turned: Floats = np.einsum("...ij,...j->...i", rotation, vector)
    return turned
