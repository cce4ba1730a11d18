"""One autopilot as the session sees it: its estimates, its status, and its inputs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from angler_mjx.errors import RunError
from angler_mjx.frames import body_frd_to_flu, quaternion_ned_to_enu, vector_ned_to_enu
from angler_mjx.robot.control.allocation import NEUTRAL_US
from angler_mjx.runs.session.interface import Floats
from angler_mjx.runs.session.state_view import rotate_vectors
from angler_sitl.wire import messages
from angler_sitl.wire.link import MavlinkLink, PacketTap
from angler_sitl.wire.ports import Ports

MODE_NAMES = {
    0: "STABILIZE",
    1: "ACRO",
    2: "ALT_HOLD",
    3: "AUTO",
    4: "GUIDED",
    7: "CIRCLE",
    9: "SURFACE",
    16: "POSHOLD",
    19: "MANUAL",
    20: "MOTOR_DETECT",
    21: "SURFTRAK",
}

AUTO_MODE = 3
"""Number of the mode in which the firmware flies its mission."""

ALT_HOLD_MODE, GUIDED_MODE, SURFACE_MODE, POSHOLD_MODE = 2, 4, 9, 16
"""Numbers of further modes."""

STREAM_RATES_HZ = {
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 50.0,
    dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 50.0,
    dialect.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 5.0,
    dialect.MAVLINK_MSG_ID_HEARTBEAT: 5.0,
    dialect.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
}
"""Requested messages and their rates.

Pose and velocity come more than once per control period, so they are at most 20 ms old."""

_CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])
"""Signs of the inverse of an attitude."""

_N_OUTPUTS = 8
"""Number of thrusters of the largest frame."""

POSE_MESSAGES = ("LOCAL_POSITION_NED", "ATTITUDE_QUATERNION")
"""Messages of the autopilot's estimate of its motion."""
_POSE_MESSAGE_SET = set(POSE_MESSAGES)

_MAX_POSE_AGE_S = 0.5
"""Max age of a pose to extrapolate; beyond it a fault is likely, and the note reports it."""


@dataclass(frozen=True, kw_only=True)
class EstimatedMotion:
    """Motion estimates of robots; [R] leads."""

    p: Floats
    """[R, 3] m in W."""
    q: Floats
    """[R, 4] F to W."""
    nu: Floats
    """[R, 6] in F."""


@dataclass(frozen=True, kw_only=True)
class NavigationFix:
    """External navigation of one robot at one time, NED and FRD."""

    p: Floats
    q: Floats
    velocity_mps: Floats
    position_std_m: Floats
    velocity_std_mps: Floats
    attitude_std_rad: Floats


class AutopilotCommander:
    """Autopilot behind a link.

    Attributes:
        link: commands and telemetry.
        name: of the robot.
        sysid: system number of the autopilot.
    """

    def __init__(self, link: MavlinkLink) -> None:
        """Take over a link; nothing is sent."""
        self.link, self.name, self.sysid = link, link.name, link.sysid

    def tick(self, time_s: float) -> None:
        """Process one control period of the scene's clock: receive messages, send heartbeats."""
        self.link.tick(time_s)

    def set_mode(self, mode: int) -> None:
        """Request a mode by the firmware's number; the heartbeat shows whether it is followed."""
        self.link.command(dialect.MAV_CMD_DO_SET_MODE, 1, mode)

    @property
    def armed(self) -> bool:
        """Whether the motors may turn, by the heartbeat; a command acknowledgement may be wrong."""
        beat = self.link.latest.get("HEARTBEAT")
        return beat is not None and bool(beat.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)

    @property
    def mode(self) -> int | None:
        """Firmware number of the current mode."""
        beat = self.link.latest.get("HEARTBEAT")
        return None if beat is None else int(beat.custom_mode)

    @property
    def flags(self) -> int | None:
        """Flags of the filter, EKF_STATUS_FLAGS."""
        report = self.link.latest.get("EKF_STATUS_REPORT")
        return None if report is None else int(report.flags)

    @property
    def has_position(self) -> bool:
        """Whether the filter has a position estimate."""
        flags = self.flags
        if flags is None or not self.link.latest.keys() >= _POSE_MESSAGE_SET:
            return False
        position_flag, constant_position_flag = (
            dialect.EKF_POS_HORIZ_ABS,
            dialect.EKF_CONST_POS_MODE,
        )
        return bool(flags & position_flag) and not flags & constant_position_flag

    @property
    def battery_v(self) -> float | None:
        """Battery voltage; None where none is reported."""
        status = self.link.latest.get("SYS_STATUS")
        if status is None or status.voltage_battery in (0, 0xFFFF):
            return None
        return float(status.voltage_battery) / 1000.0

    def note(self) -> str:
        """Return a short note on the autopilot's status."""
        battery = self.battery_v
        parts = [
            mode_name(self.mode),
            "armed" if self.armed else "disarmed",
            f"EKF {'good' if self.has_position else 'bad'} ({self.flags})",
        ]
        return ", ".join([*parts, *([] if battery is None else [f"{battery:.1f} V"])])

    def estimate_state(self, time_s: float) -> list[float]:
        """Return the autopilot's estimate of its own motion, extrapolated to the current time.

        Args:
            time_s: current time of its clock.

        Returns:
            Position [3] m and velocity [3] m/s in NED, attitude [4] FRD to NED, rates [3] rad/s in
            FRD.

        Raises:
            RunError: there is no estimate yet; see `located`.
        """
        if not self.link.latest.keys() >= _POSE_MESSAGE_SET:
            raise RunError(f"{self.name}: its autopilot has not told its motion yet")
        position, attitude = (self.link.latest[kind] for kind in POSE_MESSAGES)
        age = self._find_pose_age(time_s)
        age = age if 0.0 <= age <= _MAX_POSE_AGE_S else 0.0
        return [
            position.x + position.vx * age,
            position.y + position.vy * age,
            position.z + position.vz * age,
            *(position.vx, position.vy, position.vz),
            *(attitude.q1, attitude.q2, attitude.q3, attitude.q4),
            *(attitude.rollspeed, attitude.pitchspeed, attitude.yawspeed),
        ]

    def _find_pose_age(self, time_s: float) -> float:
        """Return the age [s] of the last pose; the autopilot's clock is the scene's."""
        return time_s - float(self.link.latest["LOCAL_POSITION_NED"].time_boot_ms) / 1000.0


class SimulatedCommander(AutopilotCommander):
    """Autopilot that flies in the simulated water, behind its two links.

    Attributes:
        vision: external navigation.
    """

    def __init__(self, name: str, sysid: int, ports: Ports, tap: PacketTap | None = None) -> None:
        """Take over the sockets; nothing is sent before the autopilot's first message."""
        super().__init__(MavlinkLink(ports.mavlink, name=name, sysid=sysid, tap=tap))
        self.vision = MavlinkLink(ports.vision, name=name, sysid=sysid)

    def tick(self, time_s: float) -> None:
        """Process one control period on both links."""
        super().tick(time_s)
        self.vision.tick(time_s)

    def send_fix(self, time_s: float, fix: NavigationFix) -> None:
        """Send a position fix, if the autopilot listens already."""
        if self.vision.has_peer:
            self.vision.send(
                messages.vision_position(
                    time_s, fix.p, fix.q, fix.position_std_m, fix.attitude_std_rad
                )
            )
            self.vision.send(messages.vision_speed(time_s, fix.velocity_mps, fix.velocity_std_mps))

    def send_neutral(self) -> None:
        """Set all passed-through outputs to neutral."""
        self.link.send(messages.build_override(self.sysid, np.full(_N_OUTPUTS, NEUTRAL_US)))


def collect_motion(pilots: Sequence[AutopilotCommander], time_s: float) -> EstimatedMotion:
    """Return the autopilots' estimates of their own motion, extrapolated to the current time.

    Args:
        pilots: R commanders.
        time_s: current time of their clock.

    Raises:
        RunError: an autopilot has no estimate yet.
    """
    states = np.array([pilot.estimate_state(time_s) for pilot in pilots])
    p, v, q, omega = np.split(states, (3, 6, 10), axis=1)
    q = quaternion_ned_to_enu(q)
    q = q / np.linalg.norm(q, axis=1, keepdims=True)
    velocity = rotate_vectors(q * _CONJUGATE, vector_ned_to_enu(v))
    nu = np.concatenate([velocity, body_frd_to_flu(omega)], axis=1)
    return EstimatedMotion(p=vector_ned_to_enu(p), q=q, nu=nu)


def mode_name(number: int | None) -> str:
    """Return the name of a mode."""
    return "no mode" if number is None else MODE_NAMES.get(number, f"mode {number}")
