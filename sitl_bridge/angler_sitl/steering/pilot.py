"""One autopilot as the session sees it: what it believes, how it stands, and what it is fed."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from angler_mjx.errors import RunError
from angler_mjx.frames import body_frd_to_flu, quaternion_ned_to_enu, vector_ned_to_enu
from angler_mjx.robot.control.allocation import NEUTRAL_US
from angler_mjx.runs.session.interface import Floats
from angler_sitl.wire import messages
from angler_sitl.wire.link import Link, Tap
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

STREAMS_HZ = {
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 50.0,
    dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 50.0,
    dialect.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 5.0,
    dialect.MAVLINK_MSG_ID_HEARTBEAT: 5.0,
    dialect.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
}
"""What is asked for, and how often: pose and velocity more than once in a control period, so that
they are at most 20 ms old."""

_OUTPUTS = 8
"""Thrusters of the largest frame."""

_PLACE_AND_TURN = ("LOCAL_POSITION_NED", "ATTITUDE_QUATERNION")
_MOTION = set(_PLACE_AND_TURN)

_OLDEST_S = 0.5
"""A pose older than this is not carried on: something is wrong, and the note says what."""


@dataclass(frozen=True, kw_only=True)
class PilotMotion:
    """How robots move; [R] leads."""

    p: Floats
    """[R, 3] m in W."""
    q: Floats
    """[R, 4] F to W."""
    nu: Floats
    """[R, 6] in F."""


@dataclass(frozen=True, kw_only=True)
class Fix:
    """External navigation of one robot at one time, NED and FRD."""

    p: Floats
    q: Floats
    velocity_mps: Floats
    position_std_m: Floats
    velocity_std_mps: Floats
    attitude_std_rad: Floats


class AutopilotCommander:
    """An autopilot behind its two links.

    Attributes:
        link: commands and telemetry.
        vision: external navigation.
    """

    def __init__(self, name: str, sysid: int, ports: Ports, tap: Tap | None = None) -> None:
        """Take over its sockets; nothing is sent before it speaks."""
        self.name, self.sysid = name, sysid
        self.link = Link(ports.mavlink, name=name, sysid=sysid, tap=tap)
        self.vision = Link(ports.vision, name=name, sysid=sysid)

    def tick(self, time_s: float) -> None:
        """Once in a control period, by the scene's clock: take what came, send heartbeats."""
        self.link.tick(time_s)
        self.vision.tick(time_s)

    def navigate(self, time_s: float, fix: Fix) -> None:
        """Tell it where it is, if it listens already."""
        if self.vision.heard:
            self.vision.send(
                messages.vision_position(
                    time_s, fix.p, fix.q, fix.position_std_m, fix.attitude_std_rad
                )
            )
            self.vision.send(messages.vision_speed(time_s, fix.velocity_mps, fix.velocity_std_mps))

    def neutral(self) -> None:
        """Let all of its outputs that are passed through stand still."""
        self.link.send(messages.override(self.sysid, np.full(_OUTPUTS, NEUTRAL_US)))

    @property
    def armed(self) -> bool:
        """Whether its motors may turn, by its own heartbeat; an answer to a command may lie."""
        beat = self.link.latest.get("HEARTBEAT")
        return beat is not None and bool(beat.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)

    @property
    def mode(self) -> int | None:
        """The firmware's number of its mode."""
        beat = self.link.latest.get("HEARTBEAT")
        return None if beat is None else int(beat.custom_mode)

    @property
    def flags(self) -> int | None:
        """Flags of its filter, EKF_STATUS_FLAGS."""
        report = self.link.latest.get("EKF_STATUS_REPORT")
        return None if report is None else int(report.flags)

    @property
    def located(self) -> bool:
        """Whether its filter knows its position."""
        flags = self.flags
        if flags is None or not self.link.latest.keys() >= _MOTION:
            return False
        known, given_up = dialect.EKF_POS_HORIZ_ABS, dialect.EKF_CONST_POS_MODE
        return bool(flags & known) and not flags & given_up

    @property
    def battery_v(self) -> float | None:
        """Voltage of its battery; None where it does not say."""
        status = self.link.latest.get("SYS_STATUS")
        if status is None or status.voltage_battery in (0, 0xFFFF):
            return None
        return float(status.voltage_battery) / 1000.0

    def note(self) -> str:
        """How it stands, in a few words."""
        battery = self.battery_v
        parts = [
            mode_name(self.mode),
            "armed" if self.armed else "disarmed",
            f"EKF {'good' if self.located else 'bad'} ({self.flags})",
        ]
        return ", ".join([*parts, *([] if battery is None else [f"{battery:.1f} V"])])

    def told(self, time_s: float) -> list[float]:
        """What it believes of its own motion, carried on to now.

        Args:
            time_s: of its clock, now.

        Returns:
            Position [3] m and velocity [3] m/s in NED, attitude [4] FRD to NED, rates [3] rad/s in
            FRD.

        Raises:
            RunError: it has not told yet; see `located`.
        """
        if not self.link.latest.keys() >= _MOTION:
            raise RunError(f"{self.name}: its autopilot has not told its motion yet")
        place, turn = (self.link.latest[kind] for kind in _PLACE_AND_TURN)
        age = time_s - place.time_boot_ms / 1000.0
        age = age if 0.0 <= age <= _OLDEST_S else 0.0
        return [
            place.x + place.vx * age,
            place.y + place.vy * age,
            place.z + place.vz * age,
            *(place.vx, place.vy, place.vz),
            *(turn.q1, turn.q2, turn.q3, turn.q4),
            *(turn.rollspeed, turn.pitchspeed, turn.yawspeed),
        ]


def motion_of(pilots: Sequence[AutopilotCommander], time_s: float) -> PilotMotion:
    """What autopilots believe of their own motion, carried on to now.

    Args:
        pilots: R of them.
        time_s: of their clock, now.

    Raises:
        RunError: one of them has not told yet.
    """
    told = np.array([pilot.told(time_s) for pilot in pilots])
    p, v, q, omega = np.split(told, (3, 6, 10), axis=1)
    q = quaternion_ned_to_enu(q)
    q = q / np.linalg.norm(q, axis=1, keepdims=True)
    velocity = _into_body(q, vector_ned_to_enu(v))
    nu = np.concatenate([velocity, body_frd_to_flu(omega)], axis=1)
    return PilotMotion(p=vector_ned_to_enu(p), q=q, nu=nu)


def mode_name(number: int | None) -> str:
    """Name of a mode."""
    return "no mode" if number is None else MODE_NAMES.get(number, f"mode {number}")


def _into_body(q: Floats, v: Floats) -> Floats:
    """Vectors of W in F; [R] leads."""
    w, axis = q[:, :1], -q[:, 1:]
    once: Any = 2.0 * np.cross(axis, v)
    turned: Floats = v + w * once + np.cross(axis, once)
    return turned
