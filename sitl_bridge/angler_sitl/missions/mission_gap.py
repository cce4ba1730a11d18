"""Gap between a mission that the firmware flew and the batch simulator on the plan of it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from angler_mjx.errors import RunError
from angler_mjx.files import JsonTable
from angler_mjx.report.interop.mission_files.build_goal import PlannedMission
from angler_mjx.report.interop.mission_files.route import Stop
from angler_mjx.robot.control.commands.joint_goal import JointGoal
from angler_mjx.robot.control.commands.joint_tolerance import Tolerances
from angler_mjx.robot.control.commands.joint_trajectory import VEHICLE_JOINTS, JointState
from angler_mjx.runs.session.batch_session import BatchSession
from angler_mjx.runs.session.interface import Observation, Session
from angler_mjx.scenario.scenario import Scenario
from angler_sitl.scene.path_distance import distance_to_path

type Floats = NDArray[np.floating]

SAMPLE_S = 0.1
"""Min period of the samples of a track."""
PASSING_M = 0.5
"""Distance from a stop below which a robot has passed it."""


@dataclass(frozen=True, kw_only=True)
class MissionGap:
    """Gap of one robot; times are those of ArduSub minus those of the batch."""

    path_rms_m: float
    """Root mean square distance of ArduSub's track to the path of the batch, at any time."""
    path_max_m: float
    apart_rms_m: float
    """Root mean square distance between both at the same time."""
    apart_max_m: float
    passing_s: tuple[float, ...]
    """Difference of the times at which both first come within `PASSING_M` of each stop; NaN where
    one of them does not."""
    off_stop_m: tuple[float, ...]
    """Min distance of ArduSub's track to each stop, after the stop before."""
    end_s: float
    """Time at which ArduSub has completed its last item minus the end of the plan; NaN if it has
    not, or if the mission has no end."""

    @property
    def passing_max_s(self) -> float:
        """Largest absolute difference of passing times; NaN if there is none."""
        finite = np.abs([value for value in self.passing_s if np.isfinite(value)])
        return float(finite.max()) if finite.size else float("nan")

    def table(self) -> JsonTable:
        """Return the gap in plain values; null for NaN."""

        def plain(value: float) -> float | None:
            return round(value, 4) if np.isfinite(value) else None

        return {
            "path_rms_m": plain(self.path_rms_m),
            "path_max_m": plain(self.path_max_m),
            "apart_rms_m": plain(self.apart_rms_m),
            "apart_max_m": plain(self.apart_max_m),
            "passing_s": [plain(value) for value in self.passing_s],
            "off_stop_m": [plain(value) for value in self.off_stop_m],
            "end_s": plain(self.end_s),
        }


class Track:
    """True positions of all robots in each step of a session; a watcher."""

    def __init__(self, session: Session) -> None:
        """Begin with the positions of a session that was just reset."""
        self._times: list[float] = []
        self._positions: list[Floats] = []
        self.after(session.observe())

    def after(self, observation: Observation) -> None:
        """See `Watcher`."""
        if self._times and observation.time_s < self._times[-1] + SAMPLE_S - 1e-6:
            return
        motion = observation.truth or observation.estimate
        self._times.append(observation.time_s)
        self._positions.append(np.asarray(motion.p, float).copy())

    @property
    def time_s(self) -> Floats:
        """Times [T] of the samples."""
        return np.array(self._times)

    @property
    def position_m(self) -> Floats:
        """Positions [T, R, 3] in W."""
        return np.stack(self._positions)


def lift_tolerances() -> Tolerances:
    """Return tolerances that no motion violates: what flies a mission is not judged by its plan."""
    free = jnp.full(len(VEHICLE_JOINTS), jnp.inf)
    state = JointState(position=free, velocity=free, acceleration=free)
    return Tolerances(path=state, goal=state, goal_time_s=jnp.asarray(jnp.inf))


def fly_batch(
    scenario: Scenario,
    world: int,
    goals: Mapping[int, JointGoal],
    *,
    duration_s: float,
    points: int,
) -> Track:
    """Fly the plans of missions in the batch simulator, and return the tracks.

    Args:
        scenario: of both flights.
        world: index of the world.
        goals: plan of each robot.
        duration_s: of the flight.
        points: max number of points of a plan.

    Raises:
        RunError: the simulator refuses a plan.
    """
    session = BatchSession(
        scenario, world=world, points=points, tolerances=lift_tolerances(), start_tolerance=0.0
    )
    try:
        track = Track(session)
        observation = session.step(dict(goals))
        for status in observation.status:
            if status.refused:
                raise RunError(f"the batch cannot fly the plan: {status.refused}")
        track.after(observation)
        while observation.time_s < duration_s - 0.5 * session.dt_s:
            observation = session.step()
            track.after(observation)
    finally:
        session.close()
    return track


def compute_gap(
    flown: Track,
    batch: Track,
    robot: int,
    route: Sequence[Stop],
    planned: PlannedMission,
    completed_s: float | None,
) -> MissionGap:
    """Return the gap of a robot.

    Args:
        flown: tracks of the autopilots.
        batch: tracks of the batch simulator.
        robot: index of the robot.
        route: stops of its mission.
        planned: plan of it.
        completed_s: time at which ArduSub completed its last item; None if it has not.
    """
    count = min(len(flown.time_s), len(batch.time_s))
    path, other = flown.position_m[:, robot], batch.position_m[:, robot]
    apart = np.linalg.norm(path[:count] - other[:count], axis=1)
    beside = distance_to_path(path, other)
    stops = np.array([stop.position_m for stop in route])
    passed, off = _find_passing(flown.time_s, path, stops)
    other_passed, _ = _find_passing(batch.time_s, other, stops)
    return MissionGap(
        path_rms_m=float(np.sqrt(np.mean(beside**2))),
        path_max_m=float(beside.max()),
        apart_rms_m=float(np.sqrt(np.mean(apart**2))),
        apart_max_m=float(apart.max()),
        passing_s=tuple((passed - other_passed).tolist()),
        off_stop_m=tuple(off.tolist()),
        end_s=float("nan") if completed_s is None else completed_s - planned.duration_s,
    )


def _find_passing(time_s: Floats, path: Floats, stops: Floats) -> tuple[Floats, Floats]:
    """Return the first time within `PASSING_M` of each stop, and the min distance until the next.

    Stops are looked for one after the other: a path may cross one before its turn.
    """
    times, distances = np.full(len(stops), np.nan), np.full(len(stops), np.nan)
    first = 0
    for i, stop in enumerate(stops):
        distance = np.linalg.norm(path[first:] - stop, axis=1)
        inside = np.flatnonzero(distance < PASSING_M)
        if not inside.size:
            distances[i] = distance.min() if distance.size else np.nan
            continue
        entry = int(inside[0])
        # The robot stays inside until it leaves for the next stop.
        outside = np.flatnonzero(distance[entry:] >= PASSING_M)
        leave = len(distance) if not outside.size else entry + int(outside[0])
        times[i], distances[i] = time_s[first + entry], distance[entry:leave].min()
        first += entry
    return times, distances
