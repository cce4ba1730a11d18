"""What a task consists of: its settings, what is drawn of it for a world, and what changes.

A task is M jobs, each of which a robot does alone. Jobs are places to be visited (tour), points
from which a part of a surface is seen (survey), or goods to be brought to other places (deliver).
All places of a world stand in one list of P: where jobs begin [M], where goods go [M] (deliver
alone), and the homes of the robots [R], which are their starts.
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
"""Of a task."""


@dataclass(frozen=True, kw_only=True)
class Footprint:
    """What a robot sees at a time: a cone about the body's downward axis, of limited range."""

    half_angle_rad: float
    """Of the cone; pi sees everything about the robot."""
    range_m: float
    wide: int
    """Cells to each side of a robot's that the footprint can reach."""
    down: int
    """And below it."""
    up: int
    """And above."""


@dataclass(frozen=True, kw_only=True)
class SurveySpec:
    """What is to be seen, and with what."""

    of: Surface
    footprint: Footprint
    altitude_cells: int
    """Height of viewpoints above what they look at."""
    coverage: float
    """Share of what can be seen that has to be."""

    def required_cells(self, total: jax.Array) -> jax.Array:
        """Return the least whole number of cells that is the coverage of ``total``, int32 [...].

        Exact: the coverage is taken as the fraction that its file says (denominators to 32,768),
        since 0.6 in single precision asks for 16 of 25 cells.

        Args:
            total: int32 [...] cells that can be seen.
        """
        ratio = Fraction(self.coverage).limit_denominator(2**15)
        whole, rest = total // ratio.denominator, total % ratio.denominator
        return whole * ratio.numerator - (-rest * ratio.numerator // ratio.denominator)


@dataclass(frozen=True, kw_only=True)
class TaskSpec:
    """Settings of a task that are fixed while it is compiled."""

    kind: Kind
    jobs: int
    """M, at most; worlds of a survey may have fewer."""
    robots: int
    """R."""
    tolerance_m: float
    """How near a robot's centre has to come to a place."""
    period: int
    """Control steps from one look at the task to the next."""
    allocation: str = "nearest"
    """Who shares jobs out, by name; see `angler_mjx.world.tasks.allocation`."""
    after: WhenFinished = "hold"
    """Whether robots return to their starts when nothing is left for them."""
    shared: bool = True
    """Whether each place of a tour is for one robot; otherwise every robot visits all."""
    ordered: bool = False
    """Whether each robot visits the places of a tour in their order."""
    dropped: WhenDropped = "lost"
    """What becomes of goods whose robot ended: lost, or back where they were taken from."""
    survey: SurveySpec | None = None
    timed: bool = False
    """Whether it is kept when each cell of a survey was seen first, for what is recorded."""

    @property
    def goods_return(self) -> bool:
        """Whether goods that somebody took may lie where they were again."""
        return self.kind == "deliver" and self.dropped == "back"

    @property
    def words(self) -> int:
        """32-bit words that hold one bit for each job."""
        return -(-self.jobs // 32)

    @property
    def homes(self) -> int:
        """Index of the first robot's home among the places."""
        return self.jobs * (2 if self.kind == "deliver" else 1)

    @property
    def positions(self) -> int:
        """P."""
        return self.homes + self.robots


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class SurveyWorld:
    """What is to be seen in one world; cells are those of the grid."""

    cells: jax.Array
    """bool [nx, ny, nz] free cells next to a surface that can be seen from some viewpoint."""
    words: jax.Array
    """uint32 [nx, ny, w] the same, packed along z, as each look wants them."""
    ground: jax.Array
    """int32 [nx, ny] lowest free cell of each column; nz where there is none."""
    of_job: jax.Array
    """uint32 [M, c, w] which cells of the columns about its viewpoint are a job's, packed along z
    (`angler_kernels.bit_grid`); see `sight.columns`."""
    count: jax.Array
    """int32 [] number of ``cells``."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class TaskWorld:
    """The task of one world."""

    position_m: jax.Array
    """[P, 3] in W; see the module's text."""
    exists: jax.Array
    """bool [M]."""
    rank: jax.Array
    """int32 [M] place of each job in boustrophedon order."""
    part: jax.Array
    """int32 [R] which part of that order is each robot's, where it is cut into equal ones."""
    fits: jax.Array
    """bool [] whether the world has room for the task."""
    survey: SurveyWorld | None = None


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class TaskState:
    """How far the task of one world is."""

    done: jax.Array
    """bool [M] in truth."""
    lost: jax.Array
    """bool [M] goods that nobody can bring any more."""
    by: jax.Array
    """int32 [M] robot that did it, the last one where all had to; -1 before."""
    done_at_s: jax.Array
    """[M] when; NaN before."""
    believed_over: jax.Array
    """uint32 [R, W] jobs that each robot knows to be over, as bits; where a tour is not shared,
    the places that it visited."""
    target: jax.Array
    """int32 [R] place that each robot goes to; -1: it stays."""
    goal_m: jax.Array
    """[R, 3] in W: that place, or where it stays."""
    carrying: jax.Array
    """int32 [R] job whose goods it carries; -1 for none."""
    did: jax.Array
    """int32 [R] jobs that each robot did; where a tour is not shared, places that it visited."""
    finished: jax.Array
    """bool [R] whether nothing is left for it."""
    complete: jax.Array
    """bool [] whether the task is."""
    completed_s: jax.Array
    """[] when; NaN before."""
    progress: jax.Array
    """[] share of the task that is done, of a survey the share that was seen."""
    seen: jax.Array | None = None
    """uint32 [nx, ny, w] cells of a survey that some robot has seen, packed along z."""
    seen_at_s: jax.Array | None = None
    """[nx, ny, nz] when some robot saw each cell first; NaN before. None where nobody asks."""
    goods_belief: "GoodsBelief | None" = None
    """What each robot takes to be in hand; None where all know all, or no goods come back."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class GoodsBelief:
    """Goods that each robot takes to be in somebody's hands, so that it need not go there."""

    missing: jax.Array
    """uint32 [R, W] of which it found the place empty, as bits."""
    at_s: jax.Array
    """[R] when, the last time that one was added."""
    in_hand: jax.Array
    """uint32 [R, W] those, and the ones that others say they carry."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class TaskReport:
    """What robots say of their part of a task, [R] leading."""

    over: jax.Array
    """uint32 [R, W] jobs that each knows to be over, as bits."""
    carrying: jax.Array
    """int32 [R] job whose goods it carries; -1 for none."""
    at_work: jax.Array
    """bool [R] whether its episode goes on."""
