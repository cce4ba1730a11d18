"""Settings of a task, its samples for a world, and its state.

A task is M jobs, each done by a single robot. Jobs are places to visit (tour), viewpoints of parts
of a surface (survey), or goods to deliver to other places (deliver). All places of a world are in
one list of P: beginnings of jobs [M], destinations of goods [M] (deliver only), and the homes of
the robots [R], which are their starts.
"""

from dataclasses import dataclass
from fractions import Fraction
from typing import Literal

import jax

type Kind = Literal["tour", "survey", "deliver"]
type Surface = Literal["floor", "rock", "both"]
type WhenFinished = Literal["hold", "return"]
type WhenDropped = Literal["lost", "back"]

MAX_JOBS = 512
"""Max number of jobs of a task."""


@dataclass(frozen=True, kw_only=True)
class Footprint:
    """Field of view of a robot: a cone about the body's downward axis, of limited range."""

    half_angle_rad: float
    """Half angle of the cone; pi sees all directions."""
    range_m: float
    wide: int
    """Cells to each side of the robot's cell that the footprint can reach."""
    down: int
    """Cells below it."""
    up: int
    """Cells above it."""


@dataclass(frozen=True, kw_only=True)
class SurveySpec:
    """Settings of a survey: surface and field of view."""

    of: Surface
    footprint: Footprint
    altitude_cells: int
    """Height of viewpoints above the surface, in cells."""
    coverage: float
    """Fraction of the visible surface that must be seen."""

    def required_cells(self, total: jax.Array) -> jax.Array:
        """Return the least whole number of cells that reaches the coverage of ``total``.

        Exact: the coverage is taken as the decimal fraction of its file (denominators to 32,768),
        since 0.6 in single precision requires 16 of 25 cells.

        Args:
            total: int32 [...] number of visible cells.
        """
        ratio = Fraction(self.coverage).limit_denominator(2**15)
        whole, rest = total // ratio.denominator, total % ratio.denominator
        return whole * ratio.numerator - (-rest * ratio.numerator // ratio.denominator)


@dataclass(frozen=True, kw_only=True)
class TaskSpec:
    """Settings of a task that are fixed at compile time."""

    kind: Kind
    jobs: int
    """M, the max number of jobs; worlds of a survey may have fewer."""
    robots: int
    """R, the number of robots."""
    tolerance_m: float
    """Distance from a place within which a robot's centre has reached it."""
    period: int
    """Control steps between two updates of the task."""
    allocation: str = "nearest"
    """Name of the allocation; see `angler_mjx.world.tasks.allocation`."""
    after: WhenFinished = "hold"
    """Behaviour of robots without remaining jobs: hold, or return to their starts."""
    shared: bool = True
    """Whether each place of a tour is visited by one robot; if not, every robot visits all."""
    ordered: bool = False
    """Whether each robot visits the places of a tour in their order."""
    dropped: WhenDropped = "lost"
    """State of goods whose robot ended: lost, or back at their pickup place."""
    survey: SurveySpec | None = None
    timed: bool = False
    """Whether the first time at which each cell of a survey is seen is stored, for records."""

    @property
    def goods_return(self) -> bool:
        """Return whether goods can return to their pickup place."""
        return self.kind == "deliver" and self.dropped == "back"

    @property
    def words(self) -> int:
        """Return the number of 32-bit words that hold one bit for each job."""
        return -(-self.jobs // 32)

    @property
    def homes(self) -> int:
        """Return the index of the first robot's home among the places."""
        return self.jobs * (2 if self.kind == "deliver" else 1)

    @property
    def positions(self) -> int:
        """Return P, the number of places."""
        return self.homes + self.robots


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class SurveyWorld:
    """Surface of a survey in one world; cells are those of the grid."""

    cells: jax.Array
    """bool [nx, ny, nz] free cells next to a surface that are visible from a viewpoint."""
    words: jax.Array
    """uint32 [nx, ny, w] the same, packed along z, for the updates."""
    ground: jax.Array
    """int32 [nx, ny] lowest free cell of each column; nz where there is none."""
    of_job: jax.Array
    """uint32 [M, c, w] cells of a job, in the columns about its viewpoint, packed along z
    (`angler_kernels.bit_grid`); see `visibility.window_columns`."""
    count: jax.Array
    """int32 [] number of ``cells``."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class TaskWorld:
    """The task of one world."""

    position_m: jax.Array
    """[P, 3] in W; see the module's docstring."""
    exists: jax.Array
    """bool [M]."""
    rank: jax.Array
    """int32 [M] index of each job in boustrophedon order."""
    part: jax.Array
    """int32 [R] each robot's part of that order, where it is cut into equal parts."""
    fits: jax.Array
    """bool [] whether the world has room for the task."""
    survey: SurveyWorld | None = None


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class TaskState:
    """State of the task of one world."""

    done: jax.Array
    """bool [M] jobs that are done, in truth."""
    lost: jax.Array
    """bool [M] goods that can no longer be delivered."""
    by: jax.Array
    """int32 [M] robot that did it, the last one where all robots had to; -1 before."""
    done_at_s: jax.Array
    """[M] time of completion; NaN before."""
    believed_over: jax.Array
    """uint32 [R, W] jobs that each robot believes to be over, as bits; where a tour is not shared,
    the places that it visited."""
    target: jax.Array
    """int32 [R] target place of each robot; -1: it stays."""
    goal_m: jax.Array
    """[R, 3] in W: that place, or the position where it stays."""
    carrying: jax.Array
    """int32 [R] job of the goods that it carries; -1 for none."""
    did: jax.Array
    """int32 [R] number of jobs done by each robot; where a tour is not shared, of places
    visited."""
    finished: jax.Array
    """bool [R] whether the robot has no remaining jobs."""
    complete: jax.Array
    """bool [] whether the task is complete."""
    completed_s: jax.Array
    """[] time of completion; NaN before."""
    progress: jax.Array
    """[] fraction of the task that is done; of a survey, the fraction seen."""
    seen: jax.Array | None = None
    """uint32 [nx, ny, w] cells of a survey that a robot has seen, packed along z."""
    seen_at_s: jax.Array | None = None
    """[nx, ny, nz] time at which each cell was first seen; NaN before. None where not stored."""
    goods_belief: "GoodsBelief | None" = None
    """Goods that each robot believes to be carried; None with full information, or where no goods
    return."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class GoodsBelief:
    """Goods that each robot believes to be carried by others, so that it need not go there."""

    missing: jax.Array
    """uint32 [R, W] goods whose place it found empty, as bits."""
    at_s: jax.Array
    """[R] time of the last addition."""
    in_hand: jax.Array
    """uint32 [R, W] these goods, and those that others report to carry."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class TaskReport:
    """Reports of robots on their part of a task, [R] leading."""

    over: jax.Array
    """uint32 [R, W] jobs that each robot believes to be over, as bits."""
    carrying: jax.Array
    """int32 [R] job of the goods that it carries; -1 for none."""
    at_work: jax.Array
    """bool [R] whether its episode continues."""
