"""The figure of eight: how far from it each controller is, in still water and against odds."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from angler_mjx.robot.vehicles.thrusters import FloatArray
from angler_mjx.studies.flights import courses, flying, kinds, samples, tracks
from angler_mjx.studies.flights.courses import CourseTimes
from angler_mjx.studies.flights.flying import FlightSettings
from angler_mjx.studies.flights.kinds import FlightKind
from angler_mjx.studies.flights.samples import MASS_ERROR, VORTEX_MPS

SPEED_MPS, SLOW_MPS = 0.5, 0.3
"""Along the course; the slow one for sets that cannot make 0.5 m/s against the vortices."""
SLOW_SETS = ("von_benzon2022",)
FLIGHT_S = 60.0
"""Two rounds and a half at 0.5 m/s."""
POINT_S = 0.25
"""Between the points of the figure of eight."""
CONDITIONS = (
    ("still", 0.0, 0.0),
    ("vortices, 20 % heavier", VORTEX_MPS, MASS_ERROR),
    ("vortices, 20 % lighter", VORTEX_MPS, -MASS_ERROR),
)
"""Name, greatest speed of the water, and mass and inertia of the vehicle as a share above what the
controllers believe; its volume is as they believe, so it sinks or rises."""


@dataclass(frozen=True, kw_only=True)
class FigureOfEight:
    """What came of one figure of eight."""

    kind: FlightKind
    condition: str
    speed_mps: float
    in_time_m: float
    """RMS distance to where the course is at the time, from the start at rest to the end; nan for
    a controller that does not keep time."""
    across_m: float
    """RMS distance to the nearest point of the course."""
    track_m: FloatArray
    """[t, 2] flown, x and y from the centre of the figure."""
    course_m: FloatArray
    """[t, 2] what was to be flown."""

    @property
    def error_m(self) -> float:
        """In time where the controller keeps time, across the path where it does not."""
        return self.across_m if math.isnan(self.in_time_m) else self.in_time_m


def fly_eights(controller: str, vehicles: Sequence[FlightKind]) -> tuple[FigureOfEight, ...]:
    """Fly the figure of eight with some vehicles, in all conditions."""
    spec = kinds.spec_of(controller)
    timed = kinds.keeps_time(spec)
    cases = list(itertools.product(range(len(vehicles)), CONDITIONS))
    rows = [row for row, _ in cases]
    speeds = [_select_speed(vehicles[row], condition) for row, (condition, _, _) in cases]
    times = CourseTimes(flight_s=FLIGHT_S, point_s=POINT_S, dt_s=spec.control_dt_s)
    flown = [courses.follow_eight(speed, times) for speed in speeds]
    params = kinds.select_rows(kinds.build_params(vehicles), rows)
    heavier = np.array([1.0 + error for _, (_, _, error) in cases])
    settings = FlightSettings(
        params=params,
        plant=samples.perturb_vehicle(params.vehicle, heavier),
        start_m=flying.start_positions(len(cases)),
        yaw_rad=np.array([course.pose[0, 3] for course in flown]),
        command=courses.build_command(flown, timed=timed),
        current=(samples.build_vortices(np.array([flow for _, (_, flow, _) in cases])),),
    )
    gains = flying.same_gains(spec, len(cases))
    track = tracks.build_track(spec, flying.build_program(spec, times.steps)(settings, gains))
    out = []
    for i, (row, (condition, _, _)) in enumerate(cases):
        wanted = flown[i].pose[:, :3]
        position = track.position_m[i]
        out.append(
            FigureOfEight(
                kind=vehicles[row],
                condition=condition,
                speed_mps=speeds[i],
                in_time_m=tracks.rms(position - wanted) if timed else math.nan,
                across_m=tracks.rms(position - tracks.find_nearest_points(position, wanted)),
                track_m=position[:, :2],
                course_m=wanted[:, :2],
            )
        )
    return tuple(out)


def _select_speed(kind: FlightKind, condition: str) -> float:
    slow = kind.parameter_set in SLOW_SETS and condition != CONDITIONS[0][0]
    return SLOW_MPS if slow else SPEED_MPS
