"""Commands between two steps: the last of each robot, checked and counted."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.host_arrays import as_leaf
from angler_mjx.robot.control.commands import BodyTwist
from angler_mjx.runs.session.interface import Session, SessionCommand
from angler_mjx.serve import decoding

type Report = Callable[[str], None]


@dataclass(kw_only=True)
class _RobotInbox:
    """Commands of one robot."""

    command: SessionCommand | None = None
    """Command of the next step; None to go on with the last one."""
    topic: str = ""
    twist_s: float | None = None
    """Time of the last velocity, of a robot that is driven by velocities."""
    counts: Counter[str] = field(default_factory=Counter)
    refused: str = ""
    """Reason of the last refusal."""


class CommandInbox:
    """Commands that messages carry to the robots of a session.

    A message that cannot be followed is refused: it is counted and reported once for each robot and
    topic, and the robot goes on with its last command.
    """

    def __init__(self, session: Session, silence_s: float, report: Report) -> None:
        """Start with no commands.

        Args:
            session: session that checks the commands.
            silence_s: time of the scene without a velocity after which a robot that is driven by
                velocities stops.
            report: receives the first refusal of each robot and topic.
        """
        self._session, self._silence_s, self._report = session, silence_s, report
        self._robots = [_RobotInbox() for _ in session.robots]
        self._reported: set[tuple[int, str]] = set()

    def reset(self) -> None:
        """Forget all commands; counts stay."""
        for inbox in self._robots:
            inbox.command, inbox.twist_s = None, None

    def receive_twist(self, robot: int, data: bytes, time_s: float) -> None:
        """Take a velocity from the bytes of a message.

        Args:
            robot: its index.
            data: of a ``geometry_msgs/Twist``.
            time_s: time of the scene.
        """
        if self._receive(robot, "cmd_vel", lambda: decoding.decode_twist(data)):
            self._robots[robot].twist_s = time_s

    def receive_trajectory(self, robot: int, data: bytes) -> None:
        """Take a ``trajectory_msgs/JointTrajectory``."""
        self._receive(robot, "joint_trajectory", lambda: decoding.decode_trajectory(data))

    def receive_signals(self, robot: int, data: bytes) -> None:
        """Take a ``std_msgs/Float64MultiArray`` of thruster signals, us."""
        count = len(self._session.robots[robot].thrusters)
        self._receive(robot, "thrusters", lambda: decoding.decode_signals(data, count))

    def put(self, robot: int, topic: str, command: SessionCommand) -> None:
        """Take a command that was checked."""
        inbox = self._robots[robot]
        inbox.counts["replaced"] += inbox.command is not None
        inbox.command, inbox.topic, inbox.twist_s = command, topic, None

    def take(self, time_s: float) -> dict[int, SessionCommand]:
        """Return the commands of the step that begins now."""
        commands: dict[int, SessionCommand] = {}
        for robot, inbox in enumerate(self._robots):
            is_silent = inbox.twist_s is not None and time_s - inbox.twist_s > self._silence_s
            if inbox.command is None and is_silent:
                inbox.counts["stopped"] += 1
                inbox.command, inbox.twist_s = BodyTwist(nu=as_leaf(np.zeros(6))), None
            if inbox.command is not None:
                commands[robot], inbox.command = inbox.command, None
        return commands

    def describe(self) -> list[dict[str, str]]:
        """Return the counts of each robot, for the diagnostics."""
        return [
            {
                **{
                    name: str(inbox.counts[name])
                    for name in ("received", "refused_messages", "replaced", "stopped")
                },
                "refusal": inbox.refused,
            }
            for inbox in self._robots
        ]

    def count(self, name: str) -> int:
        """Return a count, summed over the robots."""
        return sum(inbox.counts[name] for inbox in self._robots)

    def refuse(self, robot: int, topic: str, reason: str) -> None:
        """Count a refusal, and report the first of a robot and topic."""
        inbox = self._robots[robot]
        inbox.counts["refused_messages"] += 1
        inbox.refused = reason
        if (robot, topic) not in self._reported:
            self._reported.add((robot, topic))
            name = self._session.robots[robot].name
            self._report(f"/{name} {topic}: {reason}; further refusals are counted")

    def _receive(self, robot: int, topic: str, decode: Callable[[], SessionCommand]) -> bool:
        inbox = self._robots[robot]
        inbox.counts["received"] += 1
        try:
            command = decode()
            self._session.check(robot, command)
        except ConfigError as error:
            self.refuse(robot, topic, str(error))
            return False
        self.put(robot, topic, command)
        return True
