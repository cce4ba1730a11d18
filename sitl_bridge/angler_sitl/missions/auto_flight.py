"""Flight of uploaded missions in AUTO: plans, progress, and the gap to the batch simulator."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from angler_kernels import quaternion
from angler_mjx.errors import RunError
from angler_mjx.files import JsonValue
from angler_mjx.planning.planner import MAX_POINTS
from angler_mjx.robot.control.commands.joint_goal import JointGoal
from angler_mjx.runs.session.interface import Observation
from angler_mjx.scenario.scenario import Scenario
from angler_sitl.missions.firmware_mission import FirmwareMission, plan_mission
from angler_sitl.missions.mission_gap import MissionGap, Track, compute_gap, fly_batch
from angler_sitl.session import SitlSession
from angler_sitl.steering.autopilot_commander import AUTO_MODE, mode_name

SWITCH_TIMEOUT_S = 2.0
"""Time within which the heartbeat has to show AUTO."""


class AutoFlight:
    """Missions of all robots of a session under way; a watcher of its steps.

    Attributes:
        goals: plan of the mission of each robot, as a JointTrajectory.
    """

    def __init__(self, session: SitlSession, missions: Sequence[FirmwareMission]) -> None:
        """Make the plans, from the positions and the parameters of the robots.

        Args:
            session: just reset, with the missions uploaded.
            missions: of each robot.

        Raises:
            ConfigError: a plan has too many points, or parameters cannot be used.
        """
        self._session, self._missions = session, missions
        observation = session.observe()
        motion = observation.truth or observation.estimate
        positions, attitudes = np.asarray(motion.p, float), np.asarray(motion.q, float)
        self._plans = [
            plan_mission(
                mission,
                pilot.link.parameters,
                start_m=(float(p[0]), float(p[1]), float(p[2])),
                start_yaw_rad=float(quaternion.yaw(q)),
            )
            for mission, pilot, p, q in zip(
                missions, session.autopilots.pilots, positions, attitudes, strict=True
            )
        ]
        self.goals: dict[int, JointGoal] = {
            i: planned.goal for i, (_, planned) in enumerate(self._plans)
        }
        self._track = Track(session)
        self._begin_s = 0.0

    def begin(self) -> None:
        """Switch all robots to AUTO."""
        self._begin_s = self._session.autopilots.time_s
        self._session.start_missions(self._is_on_last_leg)

    def after(self, observation: Observation) -> None:
        """Record a step; see `Watcher`.

        Raises:
            RunError: a robot did not switch to AUTO.
        """
        self._track.after(observation)
        if abs(observation.time_s - SWITCH_TIMEOUT_S) > 0.5 * self._session.dt_s:
            return
        for pilot in self._session.autopilots.pilots:
            if pilot.mode != AUTO_MODE:
                texts = pilot.link.format_last_texts()
                raise RunError(
                    f"{pilot.name}: is in {mode_name(pilot.mode)}, not in AUTO, after "
                    f"{SWITCH_TIMEOUT_S:g} s; ArduSub says: {texts}"
                )

    def has_completed(self, robot: int) -> bool:
        """Return whether a robot has completed the last item that moves it."""
        return self._completed_s(robot) is not None

    def measure_gaps(
        self,
        scenario: Scenario,
        world: int,
        duration_s: float,
        report: Callable[[str], None],
    ) -> JsonValue:
        """Fly the plans in the batch simulator, and return the gap of each robot.

        Args:
            scenario: of the flight.
            world: index of the world.
            duration_s: of the flight.
            report: receives a line for each robot.
        """
        batch = fly_batch(scenario, world, self.goals, duration_s=duration_s, points=MAX_POINTS)
        gaps: list[JsonValue] = []
        for i, (route, planned) in enumerate(self._plans):
            ends = not any(math.isinf(stop.hold_s) for stop in route)
            gap = compute_gap(
                self._track, batch, i, route, planned, self._completed_s(i) if ends else None
            )
            report(f"{self._session.robots[i].name}: {format_gap(gap)}")
            gaps.append({**gap.table(), "plan_s": round(planned.duration_s, 3)})
        return gaps

    def _completed_s(self, robot: int) -> float | None:
        """Return the time at which a robot completed its mission; None if it has not."""
        reached = self._session.autopilots.pilots[robot].link.reached
        mission = self._missions[robot]
        for i in range(len(reached)):
            if mission.count_moves(number for number, _ in reached[: i + 1]) >= mission.moves:
                return reached[i][1] - self._begin_s
        return None

    def _is_on_last_leg(self, robot: int) -> bool:
        reached = self._session.autopilots.pilots[robot].link.reached
        mission = self._missions[robot]
        return mission.count_moves(number for number, _ in reached) >= mission.moves - 1


def format_gap(gap: MissionGap) -> str:
    """Return a gap in one line."""
    return (
        f"ArduSub in AUTO against the batch: path {gap.path_rms_m:.2f} m root mean square, "
        f"{gap.path_max_m:.2f} m at most; at the same time {gap.apart_rms_m:.2f} and "
        f"{gap.apart_max_m:.2f} m; way-points passed up to {gap.passing_max_s:.1f} s apart; "
        f"mission completed {gap.end_s:+.1f} s after the end of the plan"
    )
