"""Action FollowJointTrajectory of one robot: goals, feedback, results, cancellation, tolerances.

A goal follows the rules of ros2_control's JointTrajectoryController: a new goal cancels the last
one, and a robot whose goal ends early holds its position. The limits of the session's paths hold
for every goal; tolerances of a goal are judged in addition.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.host_arrays import as_leaf
from angler_mjx.report.interop import ros_messages as ros
from angler_mjx.report.interop.ros_encoding import find_encoder
from angler_mjx.robot.control.commands import BodyTwist, PoseTarget
from angler_mjx.robot.control.commands.joint_goal import (
    GoalError,
    JointGoal,
    JointPoint,
    build_trajectory,
)
from angler_mjx.robot.control.commands.joint_tolerance import (
    JointTolerance,
    ResultCode,
    Tolerances,
    build_tolerances,
)
from angler_mjx.robot.control.commands.joint_trajectory import (
    VEHICLE_JOINTS,
    JointTrajectory,
    is_continuous,
    sample_state,
)
from angler_mjx.runs.session.interface import Floats, Observation, Session
from angler_mjx.serve import decoding
from angler_mjx.serve.backends.interface import ACTION, Reply
from angler_mjx.serve.commands import CommandInbox
from angler_mjx.serve.messages import measure_joints
from angler_mjx.sim.state import Outcome

ACCEPTED, EXECUTING, SUCCEEDED, CANCELED, ABORTED = 1, 2, 4, 5, 6
"""Numbers of ``action_msgs/GoalStatus``."""
_NO_ERROR, _REJECTED, _UNKNOWN_GOAL, _TERMINATED = 0, 1, 2, 3
"""Numbers of ``action_msgs/CancelGoal``."""
MAX_FINISHED = 32
"""Number of finished goals whose results are kept."""
MAX_POINTS = 256
"""Rows of a reference; longer goals have feedback without a reference."""
TOPIC = "follow_joint_trajectory"
TRAJECTORY = JointTrajectory.__name__
"""Command of a robot that follows a goal, as in its status."""

type Publish = Callable[[str, ros.Message], None]
"""Publisher of ``feedback`` or ``status``."""

_sample = jax.jit(sample_state)


@dataclass(kw_only=True)
class _Goal:
    uuid: bytes
    stamp_s: float
    """When it was accepted."""
    start_s: float
    """When its trajectory starts."""
    message: JointGoal
    reference: JointTrajectory | None
    tolerances: Tolerances
    status: int = ACCEPTED
    code: ResultCode = ResultCode.SUCCESSFUL
    text: str = ""
    is_sent: bool = False
    """Whether a step took its command."""
    waiting: list[Reply] = field(default_factory=list)

    @property
    def is_active(self) -> bool:
        return self.status in (ACCEPTED, EXECUTING)


class GoalServer:
    """Goals of one robot."""

    def __init__(self, session: Session, robot: int, inbox: CommandInbox, publish: Publish) -> None:
        """Compile the reference of goals.

        Args:
            session: session of the robot.
            robot: its index.
            inbox: commands of the session's robots.
            publish: publisher of its feedback and status.
        """
        self._session, self._robot, self._inbox = session, robot, inbox
        self._publish = publish
        self._goals: list[_Goal] = []
        self._joints = (*VEHICLE_JOINTS, *session.robots[robot].joints)
        self.accepted = self.finished = 0
        still = JointGoal(joint_names=("x",), points=(JointPoint(time_s=1.0, positions=(0.0,)),))
        _sample(self._build_reference(still, np.zeros(len(self._joints))), jnp.zeros(()))

    def send(self, data: bytes, reply: Reply, observation: Observation) -> None:
        """Accept or reject a goal.

        Args:
            data: request of ``send_goal``.
            reply: sender of the answer.
            observation: present scene.
        """
        time_s = observation.time_s
        try:
            goal = self._read_goal(data, observation)
            self._session.check(self._robot, goal.message)
        except ConfigError as error:
            code = error.code.name if isinstance(error, GoalError) else "INVALID_GOAL"
            self._inbox.refuse(self._robot, TOPIC, f"{code}: {error}")
            self._answer(reply, "SendGoal", {"accepted": False, "stamp": ros.make_stamp(time_s)})
            return
        for active in self._list_active():
            self._finish(active, CANCELED, ResultCode.SUCCESSFUL, "replaced by a new goal", time_s)
        self._inbox.put(self._robot, TOPIC, goal.message)
        self._goals.append(goal)
        self.accepted += 1
        self._answer(reply, "SendGoal", {"accepted": True, "stamp": ros.make_stamp(time_s)})
        self._publish_status(time_s)

    def cancel(self, data: bytes, reply: Reply, observation: Observation) -> None:
        """Cancel one goal, those accepted until a time, or all."""
        encode = find_encoder("action_msgs/CancelGoal_Response")
        try:
            info = decoding.decode_message("action_msgs/CancelGoal_Request", data).goal_info
            uuid, until_s = bytes(info.goal_id.uuid), decoding.read_time(info.stamp)
        except ConfigError as error:
            self._inbox.refuse(self._robot, TOPIC, str(error))
            reply(bytes(encode({"return_code": _REJECTED})))
            return
        is_any, time_s = not any(uuid), observation.time_s
        named = [goal for goal in self._goals if goal.uuid == uuid]
        if is_any:
            chosen = [
                goal for goal in self._list_active() if until_s == 0 or goal.stamp_s <= until_s
            ]
        else:
            chosen = [goal for goal in named if goal.is_active]
        code = _NO_ERROR
        if not chosen and not is_any:
            code = _TERMINATED if named else _UNKNOWN_GOAL
        listed = [_describe(goal) for goal in chosen]
        reply(bytes(encode({"return_code": code, "goals_canceling": listed})))
        for goal in chosen:
            self._finish(goal, CANCELED, ResultCode.SUCCESSFUL, "cancelled by the client", time_s)
        if chosen:
            self._hold(observation)

    def get_result(self, data: bytes, reply: Reply) -> None:
        """Answer with the result of a goal once it has ended; unknown goals at once."""
        try:
            request = decoding.decode_message(f"{ACTION}_GetResult_Request", data)
            uuid = bytes(request.goal_id.uuid)
        except ConfigError as error:
            self._inbox.refuse(self._robot, TOPIC, str(error))
            uuid = b""
        for goal in self._goals:
            if goal.uuid == uuid:
                if goal.is_active:
                    goal.waiting.append(reply)
                else:
                    self._send_result(goal, reply)
                return
        self._answer(reply, "GetResult", {"status": 0})

    def update(self, observation: Observation) -> None:
        """Judge the active goal after a step, and publish its feedback."""
        for goal in self._list_active():
            if not goal.is_sent:  # its command was taken by this step
                goal.is_sent, goal.status = True, EXECUTING
                self._publish_status(observation.time_s)
            self._judge(goal, observation)

    def abort(self, reason: str, time_s: float) -> None:
        """End the active goal, because of a reset or the end of the session."""
        for goal in self._list_active():
            self._finish(goal, ABORTED, ResultCode.INVALID_GOAL, reason, time_s)

    def _judge(self, goal: _Goal, observation: Observation) -> None:
        status, time_s = observation.status[self._robot], observation.time_s
        if status.outcome is not Outcome.RUNNING:
            text = f"the robot's episode ended: {status.outcome.name.lower()}"
            self._finish(goal, ABORTED, ResultCode.INVALID_GOAL, text, time_s)
            return
        if status.refused:
            self._finish(goal, ABORTED, ResultCode.INVALID_GOAL, status.refused, time_s)
            return
        # Half a period: times are sums in floating point.
        if time_s < goal.start_s + 0.5 * self._session.dt_s and status.command != TRAJECTORY:
            return  # it has not begun
        if status.command != TRAJECTORY:
            text = f"replaced by {status.command}"
            self._finish(goal, CANCELED, ResultCode.SUCCESSFUL, text, time_s)
            return
        names, actual, speed = measure_joints(
            self._session.robots[self._robot], observation.estimate, self._robot
        )
        elapsed_s = max(0.0, time_s - goal.start_s)
        desired, rate = self._desired(goal, elapsed_s, observation, actual)
        error, rate_error = self._wrap(desired - actual), rate - speed
        self._publish_feedback(
            goal, time_s, names, (desired, rate), (actual, speed), (error, rate_error)
        )
        code = next(
            (code for code in ResultCode if status.note.startswith(code.name)), ResultCode.ACTIVE
        )
        self._judge_code(goal, code, elapsed_s, error, rate_error, observation)

    def _wrap(self, error: Floats) -> Floats:
        """Return errors of joints; of continuous ones within [-pi, pi) rad."""
        return np.array(
            [
                np.remainder(value + np.pi, 2 * np.pi) - np.pi if is_continuous(name) else value
                for name, value in zip(self._joints, error, strict=True)
            ]
        )

    def _judge_code(
        self,
        goal: _Goal,
        code: ResultCode,
        elapsed_s: float,
        error: Floats,
        rate_error: Floats,
        observation: Observation,
    ) -> None:
        """Finish a goal by the code of its session and by the tolerances of the goal."""
        time_s = observation.time_s
        if code in (ResultCode.PATH_TOLERANCE_VIOLATED, ResultCode.GOAL_TOLERANCE_VIOLATED):
            text = observation.status[self._robot].note
            self._finish(goal, ABORTED, code, text, time_s)
            return
        end_s = goal.message.points[-1].time_s
        limits = goal.tolerances.goal if elapsed_s >= end_s else goal.tolerances.path
        outside = self._list_outside(limits, error, rate_error)
        if elapsed_s < end_s:
            if outside:
                self._finish(
                    goal, ABORTED, ResultCode.PATH_TOLERANCE_VIOLATED, "; ".join(outside), time_s
                )
                self._hold(observation)
            return
        has_limits = bool(np.isfinite(np.asarray(goal.tolerances.goal.position)).any())
        if code is ResultCode.SUCCESSFUL and not outside:
            self._finish(goal, SUCCEEDED, code, "", time_s)
        elif has_limits and outside and elapsed_s > end_s + float(goal.tolerances.goal_time_s):
            self._finish(
                goal, ABORTED, ResultCode.GOAL_TOLERANCE_VIOLATED, "; ".join(outside), time_s
            )
            self._hold(observation)

    def _list_outside(self, limits: Any, error: Floats, rate_error: Floats) -> list[str]:
        return [
            f"joint {name!r}: off by {abs(away):.3g}, {limit:.3g} is allowed"
            for name, away, limit in [
                *zip(self._joints, error, np.asarray(limits.position), strict=True),
                *zip(self._joints, rate_error, np.asarray(limits.velocity), strict=True),
            ]
            if abs(away) > limit
        ]

    def _read_goal(self, data: bytes, observation: Observation) -> _Goal:
        request = decoding.decode_message(f"{ACTION}_SendGoal_Request", data)
        goal = request.goal
        if len(goal.multi_dof_trajectory.points):
            raise ConfigError("multi_dof_trajectory: not followed; give joints")
        if len(goal.component_path_tolerance) or len(goal.component_goal_tolerance):
            raise ConfigError(
                "component_path_tolerance, component_goal_tolerance: not judged; give tolerances "
                "of joints"
            )
        if any(other.uuid == bytes(request.goal_id.uuid) for other in self._goals):
            raise ConfigError("goal_id: there is a goal of this number already")
        message = decoding.read_trajectory(goal.trajectory)
        if not message.points:
            raise ConfigError("points: empty; give at least one")
        tolerances = build_tolerances(
            self._joints,
            path=_read_tolerances(goal.path_tolerance),
            goal=_read_tolerances(goal.goal_tolerance),
            goal_time_s=decoding.read_time(goal.goal_time_tolerance),
        )
        _, position, _ = measure_joints(
            self._session.robots[self._robot], observation.estimate, self._robot
        )
        reference = None
        if set(message.joint_names) <= set(self._joints) and len(message.points) < MAX_POINTS:
            self._session.check(self._robot, message)
            reference = self._build_reference(message, position)
        return _Goal(
            uuid=bytes(request.goal_id.uuid),
            stamp_s=observation.time_s,
            start_s=max(observation.time_s, message.stamp_s),
            message=message,
            reference=reference,
            tolerances=tolerances,
        )

    def _build_reference(self, message: JointGoal, position: Floats) -> JointTrajectory:
        return build_trajectory(
            message, joints=self._joints, position=position.tolist(), size=MAX_POINTS
        )

    def _desired(
        self, goal: _Goal, elapsed_s: float, observation: Observation, actual: Floats
    ) -> tuple[Floats, Floats]:
        """Return the reference of all joints: positions and speeds.

        The position in W is the guidance's, whose clock waits for the robot.
        """
        if goal.reference is None:
            return actual, np.zeros_like(actual)
        state = _sample(goal.reference, jnp.asarray(elapsed_s, goal.reference.time_s.dtype))
        desired, rate = np.array(state.position, float), np.array(state.velocity, float)
        if observation.target_m is not None and elapsed_s < goal.message.points[-1].time_s:
            desired[:3] = observation.target_m[self._robot]
        return desired, rate

    def _publish_feedback(
        self,
        goal: _Goal,
        time_s: float,
        names: Sequence[str],
        desired: tuple[Floats, Floats],
        actual: tuple[Floats, Floats],
        error: tuple[Floats, Floats],
    ) -> None:
        """Publish positions and velocities of all joints: desired, measured, and their errors."""

        def point(values: tuple[Floats, Floats]) -> ros.Message:
            positions, velocities = values
            return {
                "positions": positions.tolist(),
                "velocities": velocities.tolist(),
                "time_from_start": ros.make_stamp(max(0.0, time_s - goal.start_s)),
            }

        feedback = {
            "header": ros.make_header(time_s, ""),
            "joint_names": list(names),
            "desired": point(desired),
            "actual": point(actual),
            "error": point(error),
        }
        self._publish("feedback", {"goal_id": {"uuid": list(goal.uuid)}, "feedback": feedback})

    def _hold(self, observation: Observation) -> None:
        """Command the robot to hold its position."""
        estimate, i = observation.estimate, self._robot
        _, joints, _ = measure_joints(self._session.robots[i], estimate, i)
        command: Any = BodyTwist(nu=as_leaf(np.zeros(6)))
        if PoseTarget in self._session.robots[i].accepts:
            command = PoseTarget(
                position_m=as_leaf(joints[:3]),
                velocity_mps=as_leaf(np.zeros(3)),
                yaw_rad=as_leaf(np.asarray(joints[3])),
            )
        self._inbox.put(i, TOPIC, command)

    def _list_active(self) -> list[_Goal]:
        return [goal for goal in self._goals if goal.is_active]

    def _finish(self, goal: _Goal, status: int, code: ResultCode, text: str, time_s: float) -> None:
        goal.status, goal.code, goal.text = status, code, text
        self.finished += 1
        waiting, goal.waiting = goal.waiting, []
        for reply in waiting:
            self._send_result(goal, reply)
        ended = [goal for goal in self._goals if not goal.is_active]
        for old in ended[:-MAX_FINISHED]:
            self._goals.remove(old)
        self._publish_status(time_s)

    def _send_result(self, goal: _Goal, reply: Reply) -> None:
        result = {"error_code": int(goal.code), "error_string": goal.text}
        self._answer(reply, "GetResult", {"status": goal.status, "result": result})

    def _answer(self, reply: Reply, part: str, message: ros.Message) -> None:
        reply(bytes(find_encoder(f"{ACTION}_{part}_Response")(message)))

    def _publish_status(self, time_s: float) -> None:
        listed = [{"goal_info": _describe(goal), "status": goal.status} for goal in self._goals]
        self._publish("status", {"status_list": listed})


def _describe(goal: _Goal) -> ros.Message:
    """Return a goal as ``action_msgs/GoalInfo``."""
    return {"goal_id": {"uuid": list(goal.uuid)}, "stamp": ros.make_stamp(goal.stamp_s)}


def _read_tolerances(rows: Sequence[Any]) -> dict[str, JointTolerance]:
    """Return tolerances by joint, with the names of sessions.

    Raises:
        ConfigError: one is of accelerations, which are not measured.
    """
    table = {}
    for row in rows:
        if row.acceleration > 0:
            raise ConfigError(f"tolerance of joint {row.name!r}: accelerations are not measured")
        name = decoding.BLUE_JOINTS.get(row.name, row.name)
        table[name] = JointTolerance(position=row.position, velocity=row.velocity)
    return table
