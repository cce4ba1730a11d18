"""Text of the screen: the scene in two lines, a line for each robot, and refusals."""

import math
import textwrap
from collections.abc import Sequence

import numpy as np

from angler_mjx import frames
from angler_mjx.robot.control.commands import PoseTarget
from angler_mjx.runs.session.interface import Observation, RobotInfo, RobotStatus
from angler_mjx.teleop.keys import HELP
from angler_mjx.teleop.pace import Overruns
from angler_mjx.teleop.pilot import DriveMode, TeleopPilot, heading

WIDTH = 79
"""Usable width of a terminal of 80 columns."""

_HEAD = "  robot     depth m  hdg   m/s clear m  driven by  outcome"


def format_screen(
    title: str,
    robots: Sequence[RobotInfo],
    observation: Observation,
    pilot: TeleopPilot,
    overruns: Overruns | None,
) -> list[str]:
    """Return the lines of the screen, from the top; no line is longer than `WIDTH`.

    Args:
        title: of the scene.
        robots: of the session.
        observation: latest.
        pilot: its modes and notes are shown.
        overruns: so far; None without real time.
    """
    pace = "as fast as possible" if overruns is None else str(overruns)
    rows = [
        f"{title}  {observation.time_s:.1f} s  {pace}",
        f"speed {pilot.speed_mps:.2f} m/s  turn {pilot.turn_radps:.2f} rad/s  "
        f"stops after {pilot.silence_s:g} s of silence  ?: help  Q: end",
        "",
        _HEAD,
        *(_format_robot(i, robot, observation, pilot) for i, robot in enumerate(robots)),
        "",
    ]
    for i, (robot, status) in enumerate(zip(robots, observation.status, strict=True)):
        rows += _format_arm(i, robot, observation, pilot)
        rows += _format_remarks(robot, status, pilot.remark(i))
    if pilot.is_help_shown:
        rows += ["", *HELP]
    return [line[:WIDTH] for line in rows]


def format_drive_mode(robot: int, pilot: TeleopPilot, status: RobotStatus) -> str:
    """Return the drive mode of a robot, in a word or two."""
    if status.refused:
        return "hold"
    mode = pilot.mode(robot)
    if mode is not DriveMode.PLAN:
        return str(mode.value)
    return str(DriveMode.HOLD.value) if status.command == PoseTarget.__name__ else status.command


def compass_heading_deg(q: np.ndarray) -> float:
    """Return the compass heading, degrees clockwise from north in [0, 360), of q [4], F to W."""
    return math.degrees(heading(frames.quaternion_enu_to_ned(np.asarray(q, float)))) % 360.0


def _format_robot(i: int, robot: RobotInfo, observation: Observation, pilot: TeleopPilot) -> str:
    p, q, nu = (
        np.asarray(part)[i]
        for part in (observation.estimate.p, observation.estimate.q, observation.estimate.nu)
    )
    status = observation.status[i]
    clearance = "-" if observation.clearance_m is None else f"{observation.clearance_m[i]:.2f}"
    mark = ">" if i in pilot.selected else " "
    return (
        f"{mark} {robot.name:<9.9} {-p[2]:7.2f} {round(compass_heading_deg(q)) % 360:4d} "
        f"{np.linalg.norm(nu[:3]):5.2f} {clearance:>7}  {format_drive_mode(i, pilot, status):<9.9} "
        " "
        f"{status.outcome.name.lower():<17}  {'refused' if status.refused else ''}"
    ).rstrip()


def _format_arm(
    i: int, robot: RobotInfo, observation: Observation, pilot: TeleopPilot
) -> list[str]:
    """Return the joints of a driven robot's arm, on lines of their own; none without an arm."""
    arm, joints = pilot.arm(i), observation.estimate.joints
    if arm is None or joints is None:
        return []
    text = f"{robot.name}: {arm.format_joints(np.asarray(joints.position)[i])}"
    return textwrap.wrap(text, WIDTH, subsequent_indent="    ")


def _format_remarks(robot: RobotInfo, status: RobotStatus, remark: str) -> list[str]:
    """Return the notes of a robot's driver and of the pilot, on lines of their own."""
    texts = [f"refused: {status.refused}"] if status.refused else []
    texts += [text for text in (status.note, remark) if text]
    return [
        line
        for text in texts
        for line in textwrap.wrap(f"{robot.name}: {text}", WIDTH, subsequent_indent="    ")
    ]
