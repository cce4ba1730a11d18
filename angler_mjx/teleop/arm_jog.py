"""Conversion of keys to motions of the joints of one robot's arm.

Each key moves the target of one joint by a step. The target leads the joint by little, so that an
arm stops soon after the last key, and stays between the limits of the joint.
"""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from angler_mjx.robot.control.commands.whole_body import JointTarget
from angler_mjx.robot.vehicles.links import Joint

JOINT_KEYS = "123456789"
"""Keys that choose a joint of the arm, in the order of the vehicle file."""
MOVE_KEYS = {"]": 1, "[": -1}
"""Keys that move the chosen joint up or down."""
GRIPPER_KEYS = {"g": 1, "v": -1}
"""Keys that open or close the gripper."""
ARM_KEYS = (*JOINT_KEYS, *MOVE_KEYS, *GRIPPER_KEYS)

STEPS = 50
"""Steps of a joint from one limit to the other."""
LEAD_S = 0.5
"""Time at the joint's full speed by which its target leads it at most; at least one step."""

LEAD_MARGIN = 1.05
"""Factor of the lead beyond which something else has moved a joint, and its target is dropped."""


class ArmJog:
    """Targets of the joints of one robot.

    Attributes:
        joint: index of the chosen joint.
    """

    def __init__(self, joints: Sequence[Joint]) -> None:
        """Choose the first joint.

        Args:
            joints: joints of the arm, in the order of the vehicle file.
        """
        self.joint = 0
        self._joints = tuple(joints)
        self._lower = np.array([joint.lower for joint in joints])
        self._upper = np.array([joint.upper for joint in joints])
        self._step = (self._upper - self._lower) / STEPS
        speed = np.array([joint.actuator.max_speed for joint in joints])
        self._lead = np.maximum(LEAD_S * speed, self._step)
        self._moves = np.zeros(len(joints), int)
        self._target: np.ndarray | None = None

    def press(self, key: str) -> None:
        """Process a key of `ARM_KEYS`; one of a joint that the arm lacks does nothing."""
        if key in MOVE_KEYS:
            self._moves[self.joint] += MOVE_KEYS[key]
        elif key in GRIPPER_KEYS:
            for i, joint in enumerate(self._joints):
                self._moves[i] += GRIPPER_KEYS[key] * joint.is_gripper
        elif JOINT_KEYS.index(key) < len(self._joints):
            self.joint = JOINT_KEYS.index(key)

    def take_target(self, position: np.ndarray) -> JointTarget | None:
        """Return the motion for the keys since the last call; None without any.

        Args:
            position: [J] measured positions of the joints, rad or m.
        """
        moves, self._moves = self._moves, np.zeros_like(self._moves)
        if not moves.any() or not np.isfinite(position).all():
            return None
        before = position if self._target is None else self._target
        is_near = np.abs(before - position) <= LEAD_MARGIN * self._lead
        moved = np.where(is_near, before, position) + moves * self._step
        led = np.clip(moved, position - self._lead, position + self._lead)
        self._target = np.clip(led, self._lower, self._upper)
        still = jnp.zeros(len(moves))
        return JointTarget(
            position=jnp.asarray(self._target, still.dtype), velocity=still, acceleration=still
        )

    def format_joints(self, position: np.ndarray) -> str:
        """Return the positions [J] of the joints in a line; the chosen one stands in brackets."""
        parts = []
        for i, (joint, value) in enumerate(zip(self._joints, position, strict=True)):
            unit = f"{1e3 * value:z.1f} mm" if joint.type == "prismatic" else f"{value:z.2f}"
            text = f"{joint.name} {unit}"
            parts.append(f"[{text}]" if i == self.joint else text)
        return "  ".join(parts)
