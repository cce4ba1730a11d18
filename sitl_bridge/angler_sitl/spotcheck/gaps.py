"""Gaps between two flights of the same world, per robot and in summary."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from angler_mjx.robot.control.allocation import NEUTRAL_US
from angler_mjx.runs.storage.confidence_intervals import clustered_rates
from angler_sitl.scene.path_distance import distance_to_path
from angler_sitl.spotcheck.flight import Floats, SpotcheckFlight


@dataclass(frozen=True, kw_only=True)
class FlightGap:
    """Gap of one robot between a flight and a reference; differences are flight minus reference."""

    world: int
    robot: int
    outcome: str
    """Outcome of the flight."""
    other_outcome: str
    """Outcome of the reference flight."""
    time_s: Floats
    """[T] while both were active."""
    apart_m: Floats
    """[T] distance between both at the same time."""
    track_rms_m: float
    """Root mean square of that distance."""
    track_end_m: float
    """Distance at the last time at which both were active."""
    path_rms_m: float
    """Root mean square distance to the path of the other flight, at any time: without delays."""
    endpoint_m: float
    """Distance between the end positions of their episodes."""
    arrival_s: float
    """Difference of arrival times; NaN unless both arrived."""
    clearance_m: float
    """Difference of min clearances."""
    effort_us: float
    """Difference of efforts: root mean square signal from neutral, while both were active."""
    other_effort_us: float

    @property
    def agrees(self) -> bool:
        """Whether both have the same outcome."""
        return self.outcome == self.other_outcome


@dataclass(frozen=True, kw_only=True)
class GapSummary:
    """Summary of all robots of all worlds for one kind of flight against a reference."""

    robots: int
    agree: int
    """Number with the same outcome."""
    arrivals_agree: int
    """Number with both arrived, or neither."""
    agree_low: float
    agree_high: float
    """95 % interval of the fraction of ``agree``, by world: its robots are not independent."""
    track_rms_m: tuple[float, float]
    """Median and 90th percentile; as for the others."""
    path_rms_m: tuple[float, float]
    endpoint_m: tuple[float, float]
    """Of robots with the same outcome."""
    arrival_s: tuple[float, float]
    """Median and 90th percentile of the absolute difference."""
    clearance_m: tuple[float, float]
    effort_ratio: float
    """Median ratio of the flight's effort to the reference's."""


def compute_gaps(world: int, flight: SpotcheckFlight, other: SpotcheckFlight) -> list[FlightGap]:
    """Return the gaps of all robots of a world.

    Args:
        world: global index.
        flight: of the autopilots.
        other: with the same robots, sampled at the same rate.
    """
    return [_compute_gap(world, i, flight, other) for i in range(len(flight.rows))]


def _compute_gap(
    world: int, robot: int, flight: SpotcheckFlight, other: SpotcheckFlight
) -> FlightGap:
    ends = float(flight.end_s[robot]), float(other.end_s[robot])
    row, other_row = flight.rows[robot], other.rows[robot]
    count = min(flight.time_s.size, other.time_s.size)
    # The first sample is always valid: every robot starts at the same position.
    is_shared = flight.time_s[:count] <= max(min(ends), 0.0)
    path, other_path = flight.p_m[:count, robot][is_shared], other.p_m[:count, robot][is_shared]
    apart = np.linalg.norm(path - other_path, axis=1)
    last = min(ends)
    other_flown = other.p_m[other.time_s <= ends[1], robot]
    end_positions = [
        track.position_at(robot, end) for track, end in zip((flight, other), ends, strict=True)
    ]
    last_positions = [track.position_at(robot, last) for track in (flight, other)]
    arrived = row["outcome"] == other_row["outcome"] == "reached"
    return FlightGap(
        world=world,
        robot=robot,
        outcome=row["outcome"],
        other_outcome=other_row["outcome"],
        time_s=flight.time_s[:count][is_shared],
        apart_m=apart,
        track_rms_m=_rms(apart),
        track_end_m=float(np.linalg.norm(last_positions[0] - last_positions[1])),
        path_rms_m=_rms(distance_to_path(path, other_flown)),
        endpoint_m=float(np.linalg.norm(end_positions[0] - end_positions[1])),
        arrival_s=ends[0] - ends[1] if arrived else float("nan"),
        clearance_m=float(row["min_clearance_m"] - other_row["min_clearance_m"]),
        effort_us=_compute_effort(flight.pwm_us[:count, robot][is_shared]),
        other_effort_us=_compute_effort(other.pwm_us[:count, robot][is_shared]),
    )


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _compute_effort(pwm_us: NDArray[np.int64]) -> float:
    """Return the effort of the existing thrusters; no pulse (0) counts as no effort."""
    deviation = np.where(pwm_us == 0, 0.0, pwm_us - NEUTRAL_US)
    used = np.any(deviation != 0.0, axis=0)
    return _rms(deviation[:, used]) if used.any() else 0.0


def summarise_gaps(gaps: Sequence[FlightGap]) -> GapSummary:
    """Return the summary of gaps; at least one."""
    agree = sum(gap.agrees for gap in gaps)
    is_same = np.array([gap.agrees for gap in gaps])
    rates = clustered_rates(
        {"same": is_same, "another": ~is_same}, np.array([gap.world for gap in gaps])
    )
    low, high = rates["same"].low, rates["same"].high
    ratios = [gap.effort_us / gap.other_effort_us for gap in gaps if gap.other_effort_us > 0]
    arrival = [gap.arrival_s for gap in gaps]
    return GapSummary(
        robots=len(gaps),
        agree=agree,
        arrivals_agree=sum(
            (gap.outcome == "reached") == (gap.other_outcome == "reached") for gap in gaps
        ),
        agree_low=low,
        agree_high=high,
        track_rms_m=_median_and_p90([gap.track_rms_m for gap in gaps]),
        path_rms_m=_median_and_p90([gap.path_rms_m for gap in gaps]),
        endpoint_m=_median_and_p90([gap.endpoint_m for gap in gaps if gap.agrees]),
        arrival_s=(_median_and_p90(arrival)[0], _median_and_p90(np.abs(arrival))[1]),
        clearance_m=_median_and_p90([gap.clearance_m for gap in gaps]),
        effort_ratio=_median_and_p90(ratios)[0],
    )


def _median_and_p90(values: Sequence[float] | Floats) -> tuple[float, float]:
    """Return the median and 90th percentile of the numbers among values; NaN if there are none."""
    finite = np.asarray(values, float)
    finite = finite[np.isfinite(finite)]
    if finite.size == 0:
        return float("nan"), float("nan")
    median, p90 = np.quantile(finite, [0.5, 0.9])
    return float(median), float(p90)
