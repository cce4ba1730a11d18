"""How far two flights of the same world are apart, robot by robot and in sum."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from angler_mjx.robot.control.allocation import NEUTRAL_US
from angler_mjx.runs.storage.intervals import clustered
from angler_sitl.spotcheck.flight import Floats, SpotcheckFlight


@dataclass(frozen=True, kw_only=True)
class Gap:
    """One robot of one world: a flight against another; differences are the first minus it."""

    world: int
    robot: int
    outcome: str
    """Of the flight."""
    other_outcome: str
    """Of the one that it is held against."""
    time_s: Floats
    """[T] while both were on their way."""
    apart_m: Floats
    """[T] distance of the two at the same time."""
    track_rms_m: float
    """Root mean square of it."""
    track_end_m: float
    """Distance at the last time at which both were on their way."""
    path_rms_m: float
    """Root mean square distance to the other's way, whenever that was there: without delays."""
    endpoint_m: float
    """Between the places where their episodes ended."""
    arrival_s: float
    """Difference of arrival times; NaN unless both arrived."""
    clearance_m: float
    """Difference of least clearances."""
    effort_us: float
    """Root mean square signal beside neutral, while both were on their way."""
    other_effort_us: float

    @property
    def agrees(self) -> bool:
        """Whether both ended the same way."""
        return self.outcome == self.other_outcome


@dataclass(frozen=True, kw_only=True)
class Sum:
    """All robots of all worlds of one kind of flight against another."""

    robots: int
    agree: int
    """Ended the same way."""
    arrivals_agree: int
    """Both arrived, or neither."""
    agree_low: float
    agree_high: float
    """95 % interval of the share of ``agree``, by world: robots of one are not independent."""
    track_rms_m: tuple[float, float]
    """Median, and nine of ten are below; so the others."""
    path_rms_m: tuple[float, float]
    endpoint_m: tuple[float, float]
    """Of those that ended the same way."""
    arrival_s: tuple[float, float]
    """Median, and the least that nine of ten differ by at most, whichever is earlier."""
    clearance_m: tuple[float, float]
    effort_ratio: float
    """Median of the flight's effort over the other's."""


def between(world: int, flight: SpotcheckFlight, other: SpotcheckFlight) -> list[Gap]:
    """Gaps of all robots of a world.

    Args:
        world: global index.
        flight: of the autopilots.
        other: with the same robots, sampled at the same rate.
    """
    return [_gap(world, i, flight, other) for i in range(len(flight.rows))]


def _gap(world: int, robot: int, flight: SpotcheckFlight, other: SpotcheckFlight) -> Gap:
    ends = float(flight.end_s[robot]), float(other.end_s[robot])
    row, other_row = flight.rows[robot], other.rows[robot]
    count = min(flight.time_s.size, other.time_s.size)
    # The first sample is always there: everybody begins at the same place.
    both = flight.time_s[:count] <= max(min(ends), 0.0)
    way, other_way = flight.p_m[:count, robot][both], other.p_m[:count, robot][both]
    apart = np.linalg.norm(way - other_way, axis=1)
    last = min(ends)
    until = other.p_m[other.time_s <= ends[1], robot]
    places = [one.place(robot, end) for one, end in zip((flight, other), ends, strict=True)]
    met = [one.place(robot, last) for one in (flight, other)]
    arrived = row["outcome"] == other_row["outcome"] == "reached"
    return Gap(
        world=world,
        robot=robot,
        outcome=row["outcome"],
        other_outcome=other_row["outcome"],
        time_s=flight.time_s[:count][both],
        apart_m=apart,
        track_rms_m=_rms(apart),
        track_end_m=float(np.linalg.norm(met[0] - met[1])),
        path_rms_m=_rms(_to_way(way, until)),
        endpoint_m=float(np.linalg.norm(places[0] - places[1])),
        arrival_s=ends[0] - ends[1] if arrived else float("nan"),
        clearance_m=float(row["min_clearance_m"] - other_row["min_clearance_m"]),
        effort_us=_effort(flight.pwm_us[:count, robot][both]),
        other_effort_us=_effort(other.pwm_us[:count, robot][both]),
    )


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _effort(pwm_us: NDArray[np.int64]) -> float:
    """Of the thrusters that are there; where no pulse was sent (0) there is no effort."""
    beside = np.where(pwm_us == 0, 0.0, pwm_us - NEUTRAL_US)
    used = np.any(beside != 0.0, axis=0)
    return _rms(beside[:, used]) if used.any() else 0.0


def _to_way(points: Floats, way: Floats) -> Floats:
    """[n] distance of points [n, 3] to a way [m, 3] of straight pieces."""
    if len(way) < 2:
        found: Floats = np.linalg.norm(points - way[0], axis=1)
        return found
    begin, piece = way[:-1], np.diff(way, axis=0)
    length = np.maximum(np.sum(piece**2, axis=1), 1e-12)
    away = points[:, None] - begin
    along = np.clip(np.sum(away * piece, axis=2) / length, 0.0, 1.0)
    nearest: Floats = np.min(np.linalg.norm(away - along[..., None] * piece, axis=2), axis=1)
    return nearest


def add_up(gaps: Sequence[Gap]) -> Sum:
    """What gaps come to; at least one."""
    agree = sum(gap.agrees for gap in gaps)
    same = np.array([gap.agrees for gap in gaps])
    shares = clustered({"same": same, "another": ~same}, np.array([gap.world for gap in gaps]))
    low, high = shares["same"].low, shares["same"].high
    ratios = [gap.effort_us / gap.other_effort_us for gap in gaps if gap.other_effort_us > 0]
    arrival = [gap.arrival_s for gap in gaps]
    return Sum(
        robots=len(gaps),
        agree=agree,
        arrivals_agree=sum(
            (gap.outcome == "reached") == (gap.other_outcome == "reached") for gap in gaps
        ),
        agree_low=low,
        agree_high=high,
        track_rms_m=_spread([gap.track_rms_m for gap in gaps]),
        path_rms_m=_spread([gap.path_rms_m for gap in gaps]),
        endpoint_m=_spread([gap.endpoint_m for gap in gaps if gap.agrees]),
        arrival_s=(_spread(arrival)[0], _spread(np.abs(arrival))[1]),
        clearance_m=_spread([gap.clearance_m for gap in gaps]),
        effort_ratio=_spread(ratios)[0],
    )


def _spread(values: Any) -> tuple[float, float]:
    """Median and 90th percentile of those that are numbers; NaN where there are none."""
    known = np.asarray(values, float)
    known = known[np.isfinite(known)]
    if known.size == 0:
        return float("nan"), float("nan")
    half, ninety = np.quantile(known, [0.5, 0.9])
    return float(half), float(ninety)
