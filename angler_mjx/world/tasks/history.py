"""Progress of the task of a world at each time of a record, for plots and files; host arrays."""

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import numpy as np

from angler_mjx.world.tasks.spec import TaskSpec


class RobotActivity(IntEnum):
    """Activity of a robot in its task."""

    GOES = 0
    """On its way to the beginning of a job."""
    BRINGS = 1
    """On its way with goods to their destination."""
    RETURNS = 2
    """On its way to its start."""
    WAITS = 3
    """Waiting for a job that it might have to take over."""
    ENDED = 4
    """Inactive: finished, or lost to the task."""


class GoodsStatus(IntEnum):
    """Status of goods."""

    WAIT = 0
    """At their pickup place."""
    TRAVEL = 1
    """Carried by a robot."""
    BROUGHT = 2
    """Delivered."""
    LOST = 3
    """Lost with a robot that ended."""


@dataclass(frozen=True, kw_only=True)
class TaskHistory:
    """The task of one world over time: T samples, R robots, M jobs, P places."""

    spec: TaskSpec
    time_s: np.ndarray
    """[T] times of the samples."""
    position_m: np.ndarray
    """[P, 3] in W; jobs first, then destinations of goods, then homes."""
    exists: np.ndarray
    """bool [M]."""
    by: np.ndarray
    """int [M] robot that did each job; -1: not done."""
    done_at_s: np.ndarray
    """[M] time of completion; NaN: not done."""
    progress: np.ndarray
    """[T] fraction of the task that is done; of a survey, the fraction of its cells seen."""
    did: np.ndarray
    """int [T, R] number of jobs done by each robot; where a tour is not shared, of places
    visited."""
    target: np.ndarray
    """int [T, R] target place of each robot; -1: it stays."""
    carrying: np.ndarray
    """int [T, R] job of the goods carried by each robot; -1 for none."""
    ended_s: np.ndarray
    """[R] end of the episode of each robot."""
    completed_s: float
    """Time of completion of the task; NaN: never."""
    cells: np.ndarray | None = None
    """bool [nx, ny, nz] cells of a survey."""
    seen_at_s: np.ndarray | None = None
    """[nx, ny, nz] time at which each cell was first seen; NaN: never."""

    def _has_passed(self, at_s: np.ndarray) -> np.ndarray:
        """Return whether times [n] have passed at the samples, bool [T, n]; in float32."""
        now = self.time_s * (1.0 + 1e-6) + 1e-6
        return at_s <= now[:, None]

    @cached_property
    def done(self) -> np.ndarray:
        """Return the jobs done by each sample, bool [T, M]."""
        return self._has_passed(self.done_at_s)

    @cached_property
    def seen(self) -> np.ndarray:
        """Return the cells of a survey seen by each sample, bool [T, n], in order of ``cells``."""
        if self.cells is None or self.seen_at_s is None:
            return np.zeros((len(self.time_s), 0), bool)
        return self._has_passed(self.seen_at_s[self.cells])

    @cached_property
    def doing(self) -> np.ndarray:
        """Return the activity of each robot, `RobotActivity` [T, R]."""
        activity = np.full(self.target.shape, RobotActivity.GOES)
        activity[self.target >= self.spec.jobs] = RobotActivity.BRINGS
        activity[self.target >= self.spec.homes] = RobotActivity.RETURNS
        activity[self.target < 0] = RobotActivity.WAITS
        activity[self._has_passed(self.ended_s)] = RobotActivity.ENDED
        return activity

    @cached_property
    def is_underway(self) -> np.ndarray:
        """Return whether each robot is on its way to a place, bool [T, R]."""
        return self.doing <= RobotActivity.RETURNS

    @cached_property
    def carrier(self) -> np.ndarray:
        """Return the robot that carries the goods of each job, int [T, M]; -1: none."""
        holds = self.carrying[..., None] == np.arange(self.spec.jobs)
        holds &= ~self._has_passed(self.ended_s)[..., None]
        return np.where(holds.any(axis=1), np.argmax(holds, axis=1), -1)

    @cached_property
    def goods(self) -> np.ndarray:
        """Return the status of the goods of each job, `GoodsStatus` [T, M]."""
        travels = self.carrier >= 0
        dropped = np.maximum.accumulate(travels, axis=0) & ~travels
        status = np.full(travels.shape, GoodsStatus.WAIT)
        if self.spec.dropped == "lost":
            status[dropped] = GoodsStatus.LOST
        status[travels] = GoodsStatus.TRAVEL
        status[self.done] = GoodsStatus.BROUGHT
        return status

    def goods_m(self, p_m: np.ndarray) -> np.ndarray:
        """Return the positions of goods, [T, M, 3] in W; NaN if lost, or not existing.

        Args:
            p_m: [T, R, 3] positions of the robots, in W.
        """
        jobs = self.spec.jobs
        at = np.broadcast_to(self.position_m[:jobs], (*self.goods.shape, 3)).copy()
        taken, brought = self.goods == GoodsStatus.TRAVEL, self.goods == GoodsStatus.BROUGHT
        when = np.nonzero(taken)[0]
        at[taken] = p_m[when, self.carrier[taken]]
        at[brought] = self.position_m[jobs + np.nonzero(brought)[1]]
        at[(self.goods == GoodsStatus.LOST) | ~self.exists] = np.nan
        return at

    def describe_activity(self, sample: int, robot: int) -> str:
        """Describe the activity of a robot at a sample; empty when its episode is over."""
        target = int(self.target[sample, robot])
        noun = {"tour": "place", "survey": "viewpoint", "deliver": "goods"}[self.spec.kind]
        return {
            RobotActivity.GOES: f"goes to {noun} {target}",
            RobotActivity.BRINGS: f"brings goods {target - self.spec.jobs}",
            RobotActivity.RETURNS: "returns",
            RobotActivity.WAITS: "waits",
            RobotActivity.ENDED: "",
        }[RobotActivity(self.doing[sample, robot])]

    def describe_progress(self, sample: int) -> str:
        """Describe the progress of the task at a sample, in a line."""
        jobs = int(self.exists.sum())
        done = int(self.done[sample][self.exists].sum())
        if self.cells is not None and self.spec.survey is not None:
            count, seen = int(self.cells.sum()), int(self.seen[sample].sum())
            wanted = 100 * self.spec.survey.coverage
            text = f"{seen} of {count} cells seen ({100 * seen // count} %, {wanted:g} % wanted)"
        elif self.spec.kind == "deliver":
            goods = self.goods[sample][self.exists].tolist()
            text = f"{done} of {jobs} goods brought, {goods.count(GoodsStatus.TRAVEL)} on the way"
            if lost := goods.count(GoodsStatus.LOST):
                text += f", {lost} lost"
        elif self.spec.shared:
            text = f"{done} of {jobs} places visited"
        else:
            visits = int(self.did[sample].sum())
            text = f"{visits} of {jobs * self.spec.robots} visits made"
        if self._has_passed(np.array([self.completed_s]))[sample, 0]:
            text += f"; complete after {self.completed_s:.0f} s"
        return text
