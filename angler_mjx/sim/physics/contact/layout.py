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
    axis_pieces: tuple[int, ...] = ()
    """`ContactSpec.axis_pieces`."""
    links: int = 0
    """How many of the capsules of each robot, the last ones, are of its arm and do not meet the
    body that it holds: a gripper is closed around it."""
    held: int = -1
    """That obstacle; -1 for none."""
    slips: bool = False
    """Whether the grips of robots hold by friction."""

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
        """Return the number of contact points that the solver takes.

        A long capsule can touch rock with both ends of each of its pieces, and between them.
        """
        along = 2 * sum(count for count in self.axis_pieces if count > 1)
        return min(MAX_POINTS, max(8, POINTS_PER_BODY * self.bodies + along))

    @property
    def pairs(self) -> int:
        """Return the number of pairs of shapes of one combination that are worked out.

        Those whose bounding spheres are nearest or overlap most are taken, which can be all pairs
        with long capsules, touching or not: these count in addition.
        """
        long = sum(count != 1 for count in self.axis_pieces)
        shapes = self.robots * self.capsules + self.obstacles
        return max(MIN_PAIRS, 3 * self.bodies) + long * shapes

    def capsule_pieces(self) -> np.ndarray:
        """Return int [shapes]: pieces of the axis of each capsule, 0 for boxes."""
        pieces = np.where(self.is_box(), 0, 1)
        first = self.robots * self.capsules
        pieces[first : first + len(self.axis_pieces)] = self.axis_pieces
        return pieces

    def shape_bodies(self) -> np.ndarray:
        """Return int32 [shapes]: the body of each shape."""
        robots = np.repeat(np.arange(self.robots), self.capsules)
        obstacles = np.arange(self.robots, self.bodies)
        kinds = [obstacles] * (self.has_capsules + self.has_boxes)
        return np.concatenate([robots, *kinds]).astype(np.int32)

    def meets(self, first: int, second: int) -> bool:
        """Return whether two shapes can touch: not of one body, nor a gripper and what it holds."""
        owners = self.shape_bodies()
        if owners[first] == owners[second]:
            return False
        arm, held = (first, second) if first < second else (second, first)
        is_arm = arm < self.robots * self.capsules and (
            arm % self.capsules >= self.capsules - self.links
        )
        return not (is_arm and self.held >= 0 and owners[held] == self.robots + self.held)

    def is_box(self) -> np.ndarray:
        """Return bool [shapes]."""
        boxes = np.zeros(self.shapes, bool)
        if self.has_boxes:
            boxes[self.shapes - self.obstacles :] = True
        return boxes
