"""Static description of the bodies of a world that can touch: what a program is compiled for."""

from dataclasses import dataclass

import numpy as np

POINTS_PER_BODY = 4
"""Contact points that the solver takes for each body; the deepest are taken."""
MAX_POINTS = 96
"""Contact points of a world that the solver takes."""
MIN_PAIRS = 24
"""Nearest pairs of shapes of one combination that are worked out, at the least."""


@dataclass(frozen=True)
class BodyLayout:
    """Numbers of bodies and shapes of one world.

    Bodies are the robots, then the obstacles; each is a tree of its own. Shapes are the capsules of
    the robots' hulls, robot by robot, then a capsule for each obstacle, then a box for each.
    """

    robots: int
    joints: int
    """Of each robot."""
    capsules: int
    """Of each robot's hull and links."""
    obstacles: int
    has_capsules: bool
    """Whether obstacles can be spheres or capsules."""
    has_boxes: bool
    """Whether obstacles can be boxes."""

    @property
    def bodies(self) -> int:
        """Return the number of bodies."""
        return self.robots + self.obstacles

    @property
    def robot_velocities(self) -> int:
        """Return the generalised velocities of a robot."""
        return 6 + self.joints

    @property
    def velocities(self) -> int:
        """Return the generalised velocities of the world."""
        return self.robots * self.robot_velocities + self.obstacles * 6

    @property
    def shapes(self) -> int:
        """Return the number of shapes."""
        return self.robots * self.capsules + self.obstacles * (self.has_capsules + self.has_boxes)

    @property
    def points(self) -> int:
        """Return the number of contact points that the solver takes."""
        return min(MAX_POINTS, max(8, POINTS_PER_BODY * self.bodies))

    @property
    def pairs(self) -> int:
        """Return the number of pairs of shapes of one combination that are worked out."""
        return max(MIN_PAIRS, 3 * self.bodies)

    def shape_bodies(self) -> np.ndarray:
        """Return int32 [shapes]: the body of each shape."""
        robots = np.repeat(np.arange(self.robots), self.capsules)
        obstacles = np.arange(self.robots, self.bodies)
        kinds = [obstacles] * (self.has_capsules + self.has_boxes)
        return np.concatenate([robots, *kinds]).astype(np.int32)

    def is_box(self) -> np.ndarray:
        """Return bool [shapes]."""
        boxes = np.zeros(self.shapes, bool)
        if self.has_boxes:
            boxes[self.shapes - self.obstacles :] = True
        return boxes
