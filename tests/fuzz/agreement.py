"""Two engines on the same worlds: the same outcomes, but where rounding decided.

Both compute in float32, so tracks part: slowly where something dampens the motion, faster where a
robot tumbles, and then anything may follow. What rounding cannot do is to move a robot at once. So
of each world the first robot that ends otherwise is looked at. Its difference is *by rounding* if

- robots of that world had parted gradually: never by more than `GROWTH` times and `STEP_M` more
  from one sample to the next, and by less than `EARLY_M` in the first second; and
- what ended it by one engine was as near by the other as their robots were apart (`NEAR` times).
"""

from dataclasses import dataclass

import numpy as np

from angler_mjx.sim.state import Outcome

from .flying import Fault, Flight

EARLY_S, EARLY_M = 1.0, 2e-3
GROWTH, STEP_M = 3.0, 1e-3
NEAR, NEAR_M = 4.0, 5e-3
HITS = (Outcome.COLLISION_STATIC, Outcome.COLLISION_DYNAMIC, Outcome.COLLISION_ROBOT)


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """Where episodes end otherwise than by touch."""

    goal_m: np.ndarray
    """[W, R, 3]"""
    low_m: np.ndarray
    """[3]"""
    high_m: np.ndarray
    """[3]"""
    goal_tolerance_m: float


def compare(one: Flight, other: Flight, bounds: Bounds) -> tuple[list[Fault], list[str]]:
    """Differences that rounding does not explain, and a line for each that it does."""
    faults, excused = [], []
    apart = np.linalg.norm(one.p.astype(float) - other.p, axis=-1)  # [W, S, R]
    ends = np.stack([one.tally.end_time_s, other.tally.end_time_s])
    outcomes = np.stack([one.tally.outcome, other.tally.outcome])
    dt = one.time_s[1] - one.time_s[0]
    differs = (outcomes[0] != outcomes[1]) | (np.abs(ends[0] - ends[1]) > dt / 2)
    ends = np.where(outcomes == Outcome.RUNNING, np.inf, ends)
    for w in range(len(apart)):
        # All are compared until the first of a world ends otherwise: what follows may be its work.
        first_end = np.where(differs[w], ends[:, w].min(axis=0), np.inf)
        r = int(np.argmin(first_end))
        until = int(min(first_end[r] / dt + 0.5, len(one.time_s)))
        track = apart[w, :until].max(axis=1)
        torn = _torn(track, dt)
        where = {"world": one.first + w, "robot": r}
        if torn is not None:
            said = f"apart by {track[torn]:.2g} m at {one.time_s[torn]:.2f} s"
            said += f", {track[max(torn - 1, 0)]:.2g} m one sample before"
            faults.append(Fault(kind="engines", said=said, **where))
        if not differs[w, r]:
            continue
        gap = float(track[-1]) if until else 0.0
        names = [Outcome(int(k)).name.lower() for k in outcomes[:, w, r]]
        said = f"{names[0]} at {ends[0, w, r]:.2f} s, {names[1]} at {ends[1, w, r]:.2f} s"
        said += f", apart by {gap:.2g} m before"
        sooner = int(ends[1, w, r] < ends[0, w, r])
        margin = _margin((one, other)[1 - sooner], outcomes[sooner, w, r], w, r, bounds)
        if margin > NEAR * gap + NEAR_M:
            said += f"; by the other it was {margin:.2g} m from that"
            faults.append(Fault(kind="engines", said=said, **where))
        elif torn is None:
            excused.append(f"world {one.first + w} robot {r}: {said}")
    return faults, excused


def _torn(track: np.ndarray, dt: float) -> int | None:
    """Sample at which robots parted faster than rounding takes them apart."""
    early = track[: round(EARLY_S / dt)] > EARLY_M
    jump = np.zeros(len(track), bool)
    jump[1:] = track[1:] > GROWTH ** max(dt / 0.05, 1.0) * track[:-1] + STEP_M
    jump[: len(early)] |= early
    return int(np.argmax(jump)) if jump.any() else None


def _margin(flight: Flight, outcome: int, w: int, r: int, bounds: Bounds) -> float:
    """How far a robot was, at the least, from what ended it by the other engine."""
    p = flight.p[w, :, r].astype(float)
    if outcome in HITS:
        tally = flight.tally
        least = min(tally.min_clearance_m[w, r], tally.min_separation_m[w, r])
        return max(float(least), 0.0)
    if outcome == Outcome.REACHED:
        to_goal = np.linalg.norm(p - bounds.goal_m[w, r], axis=-1)
        return max(float(to_goal.min()) - bounds.goal_tolerance_m, 0.0)
    if outcome == Outcome.OUT_OF_BOUNDS:
        inside = np.minimum(p - bounds.low_m, bounds.high_m - p).min(axis=-1)
        return max(float(inside.min()), 0.0)
    return np.inf
