"""Tracing of decisions that rounding changed: two flights of the same worlds, robot by robot.

For every robot with another outcome the quantities that could have caused it are compared in the
order of time: samples, the plan, the obstacle or robot that it touched in either run, its
set-point, itself. The first quantity that deviates by more than rounding explains is named, with
its deviation then and a second before. Where none does, the two runs agreed to the end, and a
threshold (contact, arrival, edge of the region) lay between them.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import SupportsInt

import numpy as np

from angler_experiments.shared.flights import StudyFlight
from angler_mjx.sim.state import Outcome, Touched

type Array = np.ndarray

PLAN_M = 1e-3
"""Distance beyond which two plans differ: the planner has cells of metres."""
STANDARD_DEVIATIONS = 5.0
"""Standard deviations of the random walk of rounding errors that `bound_m` allows."""
TURN_M = 1e-3
"""Change of an obstacle's displacement from one control step (50 ms) to the next that counts as a
bounce: 0.02 m/s of velocity, 0.4 m/s^2; the water does not push it so hard."""


class Cause(StrEnum):
    """First quantity that differed."""

    WORLD = "the world that was drawn"
    PLAN = "plan: a tie of the planner"
    BOUNCE = "a bounce of the obstacle that it touched"
    DRIFT = "the drift of the obstacle that it touched"
    ROBOT = "the robot that it touched"
    AIM = "guidance: where it aims"
    SELF = "its own motion"
    TOUCH = "a touch by a margin"
    ARRIVAL = "arrival before something else"
    EDGE = "another threshold at the end"


@dataclass(frozen=True, kw_only=True)
class Trace:
    """Trace of one robot with another outcome."""

    world: int
    robot: int
    outcomes: tuple[str, str]
    end_s: tuple[float, float]
    cause: Cause
    at_s: float
    """Time at which it deviated by more than rounding explains, or at which the first of the two
    ended."""
    size_m: float
    """Deviation at that time; metres."""
    before_m: float
    """Deviation a second earlier."""


def is_different(a: StudyFlight, b: StudyFlight) -> Array:
    """Return which robots [W, R] have another outcome, or with another object."""
    is_same: Array = (
        (a.outcome == b.outcome) & (a.touched == b.touched) & (a.touched_index == b.touched_index)
    )
    return ~is_same


def bound_m(steps: Array, reach_m: float) -> Array:
    """Return the distance [m] up to which rounding separates two float32 runs of one equation.

    Both round the position once a physics step, by up to half a unit in the last place (ulp) of the
    greatest coordinate. The two errors are independent and uniform, so the difference is a random
    walk with steps of variance ulp^2 / 6: after n steps its standard deviation is ulp sqrt(n / 6).
    Five of these are allowed. Rounding of velocities and forces adds little: damping and
    the control loop take it out within seconds.

    Args:
        steps: physics steps taken.
        reach_m: greatest coordinate.
    """
    ulp = float(np.spacing(np.float32(reach_m)))
    bound: Array = STANDARD_DEVIATIONS * ulp * np.sqrt(np.maximum(steps, 1) / 6)
    return bound


def trace_differences(
    a: StudyFlight, b: StudyFlight, dt_s: float, physics_steps: int
) -> list[Trace]:
    """Trace every robot with another outcome, by world and number.

    Args:
        a: first run.
        b: other run of the same worlds.
        dt_s: control period.
        physics_steps: physics steps in a control step.
    """
    reach = float(np.abs(a.p[np.isfinite(a.p)]).max())
    steps = np.arange(a.p.shape[1], dtype=np.float64) * physics_steps
    bound = bound_m(steps, reach)
    return [
        _trace_robot(a, b, int(w), int(r), bound, dt_s) for w, r in np.argwhere(is_different(a, b))
    ]


@dataclass(frozen=True, kw_only=True)
class _Divergence:
    """Candidate of the first difference."""

    cause: Cause
    step: int
    gap: Array
    """[T] m deviation."""


def _trace_robot(
    a: StudyFlight, b: StudyFlight, w: int, r: int, bound: Array, dt_s: float
) -> Trace:
    ends = (float(a.end_time_s[w, r]), float(b.end_time_s[w, r]))
    last = min(len(bound) - 1, max(0, round(min(ends) / dt_s)))
    divergences = sorted(_find_divergences(a, b, w, r, bound, last), key=lambda sign: sign.step)
    first = divergences[0] if divergences else _threshold_divergence(a, b, w, r, last)
    second = round(1.0 / dt_s)
    return Trace(
        world=w,
        robot=r,
        outcomes=(_outcome_name(a.outcome[w, r]), _outcome_name(b.outcome[w, r])),
        end_s=ends,
        cause=first.cause,
        at_s=first.step * dt_s,
        size_m=float(first.gap[first.step]),
        before_m=float(first.gap[max(0, first.step - second)]),
    )


def _find_divergences(
    a: StudyFlight, b: StudyFlight, w: int, r: int, bound: Array, last: int
) -> Iterator[_Divergence]:
    """Yield deviations beyond rounding before the first of the two ends.

    Deviations of the same step come in the order of cause and effect.
    """
    sampled_fields = ("cells", "variant", "redraws")
    if any(not np.array_equal(getattr(a, n)[w], getattr(b, n)[w]) for n in sampled_fields):
        yield _Divergence(cause=Cause.WORLD, step=0, gap=np.full(last + 1, np.inf))
    for name in ("start_m", "goal_m", "plan_m"):
        gap = float(np.abs(getattr(a, name)[w, r] - getattr(b, name)[w, r]).max())
        if gap > PLAN_M:
            cause = Cause.PLAN if name == "plan_m" else Cause.WORLD
            yield _Divergence(cause=cause, step=0, gap=np.full(last + 1, gap))
    for flight in (a, b):
        index = int(flight.touched_index[w, r])
        if flight.touched[w, r] == Touched.OBSTACLE:
            first_track, second_track = a.obstacle_p[w, :, index], b.obstacle_p[w, :, index]
            yield from _find_track_divergence(Cause.BOUNCE, first_track, second_track, bound, last)
        if flight.touched[w, r] == Touched.ROBOT:
            yield from _find_track_divergence(
                Cause.ROBOT, a.p[w, :, index], b.p[w, :, index], bound, last
            )
    # The set-point moves with the robot's own position; rounding of both.
    yield from _find_track_divergence(
        Cause.AIM, a.target_m[w, :, r], b.target_m[w, :, r], 2 * bound, last
    )
    yield from _find_track_divergence(Cause.SELF, a.p[w, :, r], b.p[w, :, r], bound, last)


def _find_track_divergence(
    cause: Cause, a: Array, b: Array, bound: Array, last: int
) -> Iterator[_Divergence]:
    """Yield the time at which two tracks [T, 3] separate."""
    distance_m = np.linalg.norm(a.astype(np.float64) - b, axis=-1)
    outside = np.flatnonzero(distance_m[: last + 1] > bound[: last + 1])
    if not outside.size:
        return
    step = int(outside[0])
    if cause is Cause.BOUNCE and not (_is_bounce(a, step) or _is_bounce(b, step)):
        cause = Cause.DRIFT
    yield _Divergence(cause=cause, step=step, gap=distance_m)


def _is_bounce(track: Array, step: int) -> bool:
    """Return whether an obstacle bounced within three control steps of a step."""
    window = track[max(0, step - 3) : step + 4].astype(np.float64)
    return bool(np.abs(np.diff(window, 2, axis=0)).max(initial=0.0) > TURN_M)


def _threshold_divergence(a: StudyFlight, b: StudyFlight, w: int, r: int, last: int) -> _Divergence:
    """Return the threshold that lay between two runs that agreed until the first ended."""
    kinds = {int(a.outcome[w, r]), int(b.outcome[w, r])}
    touching = {Outcome.COLLISION_STATIC, Outcome.COLLISION_DYNAMIC, Outcome.COLLISION_ROBOT}
    cause = Cause.TOUCH if kinds & touching else Cause.EDGE
    if cause is Cause.EDGE and Outcome.REACHED in kinds:
        cause = Cause.ARRIVAL
    gap = np.linalg.norm(a.p[w, :, r].astype(np.float64) - b.p[w, :, r], axis=-1)
    for flight in (a, b):
        if flight.touched[w, r] == Touched.OBSTACLE:
            index = int(flight.touched_index[w, r])
            offset_m = a.obstacle_p[w, :, index].astype(np.float64) - b.obstacle_p[w, :, index]
            gap = np.maximum(gap, np.linalg.norm(offset_m, axis=-1))
    return _Divergence(cause=cause, step=last, gap=gap)


def _outcome_name(outcome: SupportsInt) -> str:
    return Outcome(int(outcome)).name.lower()
