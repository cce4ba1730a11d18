"""Flight of armed robots along their plans until all have ended, or the time is up."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from angler_mjx.errors import RunError
from angler_mjx.robot.control.commands.joint_goal import JointGoal
from angler_mjx.robot.control.commands.joint_tolerance import ResultCode
from angler_mjx.runs.session.interface import Observation, RobotStatus, SessionCommand
from angler_mjx.runs.session.online_policy import OnlineFlyer
from angler_mjx.sim.state import Outcome
from angler_mjx.teleop.loop import Watcher
from angler_mjx.teleop.signals import StopRequest
from angler_sitl.session import SitlSession


@dataclass(frozen=True, kw_only=True)
class MissionFlight:
    """Result of a flight."""

    steps: int
    scene_s: float
    wall_s: float
    last: Observation
    broken: str = ""
    """Reason of an early end; empty if the flight was completed."""
    by_signal: bool = False
    """Whether a signal ended the flight."""

    @property
    def real_time(self) -> float:
        """Speed of the flight, times real time."""
        return self.scene_s / max(self.wall_s, 1e-9)


def fly_mission(
    session: SitlSession,
    *,
    duration_s: float,
    goals: Mapping[int, JointGoal] | None = None,
    whole: bool = False,
    policy: OnlineFlyer | None = None,
    has_completed: Callable[[int], bool] | None = None,
    watchers: Sequence[Watcher] = (),
    stop: StopRequest | None = None,
) -> MissionFlight:
    """Fly until every robot has ended, or until the time is up.

    A robot ends when it fails, when its autopilot is lost, and when it has completed its
    JointTrajectory; without a JointTrajectory, when it arrives.

    Args:
        session: just reset; goals were checked.
        duration_s: max time of the scene.
        goals: JointTrajectories by robot index; the other robots follow their plans.
        whole: fly to the end of that time, even if all robots have ended.
        policy: commands robots without a JointTrajectory in each step; None: they follow their
            plans.
        has_completed: whether a robot, by its index, has completed the mission that its firmware
            flies; None: the firmware flies none.
        watchers: called after every step.
        stop: request to stop, set by a signal.
    """
    start_s, steps = time.perf_counter(), 0
    observation, broken = session.observe(), ""
    commands = dict(goals or {})
    # Half a period: times are sums in floating point.
    while observation.time_s < duration_s - 0.5 * session.dt_s:
        if stop is not None and stop.requested:
            broken = "interrupted by a signal"
            break
        if not whole and steps and _all_ended(session, observation, goals or {}, has_completed):
            break
        try:
            of_policy = _command_others(policy, observation, goals or {})
            observation = session.step({**of_policy, **commands})
        except RunError as error:  # the flight so far is kept
            broken = str(error)
            break
        commands = {}
        steps += 1
        for watcher in watchers:
            watcher.after(observation)
    return MissionFlight(
        steps=steps,
        scene_s=observation.time_s,
        wall_s=time.perf_counter() - start_s,
        last=observation,
        broken=broken,
        by_signal=stop is not None and stop.requested,
    )


def _command_others(
    policy: OnlineFlyer | None, observation: Observation, goals: Mapping[int, JointGoal]
) -> dict[int, SessionCommand]:
    """Return what a policy commands robots that have no JointTrajectory."""
    if policy is None:
        return {}
    commands = policy.commands(observation)
    return {robot: command for robot, command in commands.items() if robot not in goals}


def _all_ended(
    session: SitlSession,
    observation: Observation,
    goals: Mapping[int, JointGoal],
    has_completed: Callable[[int], bool] | None,
) -> bool:
    lost = session.autopilots.lost
    return all(
        i in lost
        or (
            _has_ended(status, has_goal=i in goals)
            if has_completed is None
            else has_completed(i) or _has_failed(status)
        )
        for i, status in enumerate(observation.status)
    )


def _has_failed(status: RobotStatus) -> bool:
    return status.outcome not in (Outcome.RUNNING, Outcome.REACHED)


def _has_ended(status: RobotStatus, *, has_goal: bool) -> bool:
    if _has_failed(status):
        return True
    if not has_goal:
        return status.outcome is Outcome.REACHED
    is_active = status.note.startswith((ResultCode.ACTIVE.name, "a JointTrajectory begins"))
    return not is_active
