"""One autopilot that somebody else started: its messages are checked before they count.

A pose counts if its numbers are finite, if it is newer than the last one by the autopilot's clock,
and if it did not wait on its way. Everything else is counted and ignored.
"""

import math
from collections import Counter

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from angler_mjx.runs.session.interface import Floats
from angler_sitl.steering.autopilot_commander import (
    GUIDED_MODE,
    POSE_MESSAGES,
    AutopilotCommander,
)
from angler_sitl.wire import messages
from angler_sitl.wire.link import DatagramSocket, MavlinkLink, MavlinkMessage, PacketTap

MAX_DELAY_S = 1.0
"""Max time by which a pose may come later than the fastest one, for its stamp."""
MAX_POSITION_M = 1e5
"""Max coordinate of a position; beyond it the position is a fault."""

_RESTART_S = 3.0
"""Step back of the autopilot's clock that is a restart, and not a packet out of order."""
_DRIFT = 0.05
"""Rate at which the fastest delay is forgotten: the two clocks drift against each other."""
_UNIT_TOLERANCE = 0.05
"""Max difference of the length of an attitude from 1."""

RATES_HZ = {
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 50.0,
    dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 50.0,
    dialect.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 5.0,
    dialect.MAVLINK_MSG_ID_HEARTBEAT: 5.0,
    dialect.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: 10.0,
    dialect.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
}
"""Requested messages and their rates, on this endpoint alone."""


class VehicleLink(MavlinkLink):
    """MAVLink with one autopilot; wrong, late, duplicate and foreign messages are ignored.

    Attributes:
        heard_s: time of the last message of the autopilot; minus infinity before the first.
        arrivals: time of the last accepted message of each kind, by its name.
        counts: ignored messages: ``component``, ``not_finite``, ``duplicate``, ``late``.
        has_restarted: whether the autopilot's clock began anew.
    """

    def __init__(
        self, bound: DatagramSocket, *, name: str, sysid: int, tap: PacketTap | None = None
    ) -> None:
        """Take over a channel."""
        super().__init__(bound, name=name, sysid=sysid, tap=tap)
        self.heard_s, self.has_restarted = -math.inf, False
        self.arrivals: dict[str, float] = {}
        self.counts: Counter[str] = Counter()
        self._stamps: dict[str, float] = {}
        self._fastest: tuple[float, float] | None = None

    def restart_delay(self) -> None:
        """Measure delays anew, after what had waited was taken."""
        self._fastest = None

    def _is_accepted(self, message: MavlinkMessage) -> bool:
        reason = self._find_fault(message)
        if reason:
            self.counts[reason] += 1
            return False
        self.arrivals[message.get_type()] = self._time_s
        return True

    def _find_fault(self, message: MavlinkMessage) -> str:
        """Return why a message does not count; empty if it does."""
        if message.get_srcComponent() != dialect.MAV_COMP_ID_AUTOPILOT1:
            return "component"
        self.heard_s = self._time_s
        if message.get_type() not in POSE_MESSAGES:
            return ""
        return self._find_pose_fault(message)

    def _find_pose_fault(self, message: MavlinkMessage) -> str:
        kind = message.get_type()
        if not _is_sound(message):
            return "not_finite"
        stamp_s = message.time_boot_ms / 1000.0
        last_s = self._stamps.get(kind, -math.inf)
        if stamp_s < last_s - _RESTART_S:
            self.has_restarted = True
        if stamp_s <= last_s:
            return "duplicate"
        if self._measure_delay(stamp_s) > MAX_DELAY_S:
            return "late"
        self._stamps[kind] = stamp_s
        return ""

    def _measure_delay(self, stamp_s: float) -> float:
        """Return by how much a message came later than the fastest one, s."""
        offset_s = self._time_s - stamp_s
        fastest_s = offset_s
        if self._fastest is not None:
            before_s, seen_s = self._fastest
            fastest_s = min(before_s + _DRIFT * (self._time_s - seen_s), offset_s)
        self._fastest = (fastest_s, self._time_s)
        return offset_s - fastest_s


def _is_sound(message: MavlinkMessage) -> bool:
    """Return whether the numbers of a pose can be used."""
    if message.get_type() == "LOCAL_POSITION_NED":
        numbers = (message.x, message.y, message.z, message.vx, message.vy, message.vz)
        return all(abs(number) <= MAX_POSITION_M for number in numbers)  # NaN is not
    q = (message.q1, message.q2, message.q3, message.q4)
    rates = (message.rollspeed, message.pitchspeed, message.yawspeed)
    is_unit = abs(math.hypot(*q) - 1.0) <= _UNIT_TOLERANCE
    return is_unit and all(abs(rate) <= MAX_POSITION_M for rate in rates)


class VehicleCommander(AutopilotCommander):
    """Autopilot behind a `VehicleLink`.

    Attributes:
        link: checked messages.
        origin_ned_m: [3] origin of the autopilot's filter in NED from W's origin.
    """

    link: VehicleLink

    def __init__(self, link: VehicleLink) -> None:
        """Take over a link; nothing is sent."""
        super().__init__(link)
        self.origin_ned_m: Floats = np.zeros(3)
        self._position_good_s = -math.inf

    def tick(self, time_s: float) -> None:
        """Process one control period of the wall clock."""
        super().tick(time_s)
        report_s = self.link.arrivals.get("EKF_STATUS_REPORT", -math.inf)
        if self.has_position:
            ages = [self.link.arrivals.get(kind, -math.inf) for kind in POSE_MESSAGES]
            self._position_good_s = min(*ages, report_s)

    @property
    def position_good_s(self) -> float:
        """Time of the last good position; minus infinity before the first."""
        return self._position_good_s

    @property
    def is_guided(self) -> bool:
        """Whether the vehicle is armed and takes position targets."""
        return self.armed and self.mode == GUIDED_MODE

    def read_pwm(self) -> list[int]:
        """Return the last signals [16] of its outputs, us; 0 where none were reported."""
        outputs = self.link.latest.get("SERVO_OUTPUT_RAW")
        if outputs is None:
            return [0] * 16
        return [int(getattr(outputs, f"servo{n}_raw")) for n in range(1, 17)]

    def estimate_state(self, time_s: float) -> list[float]:
        """Return its motion as `AutopilotCommander.estimate_state`, with the position from W."""
        state = super().estimate_state(time_s)
        return [*(np.array(state[:3]) + self.origin_ned_m).tolist(), *state[3:]]

    def send_target(
        self, time_s: float, position_m: Floats, velocity_mps: Floats, yaw_rad: float
    ) -> None:
        """Send a position target [3] m in W with its velocity [3] m/s in W and heading."""
        target = messages.build_position_target(
            self.sysid, time_s, position_m, velocity_mps, yaw_rad, self.origin_ned_m
        )
        self.link.send(target)

    def send_centred_sticks(self) -> None:
        """Send sticks at rest: without a pilot's input its failsafe would end the flight."""
        self.link.send(messages.build_manual_control(self.sysid, np.zeros(4)))

    def disarm(self) -> None:
        """Request to stop the motors."""
        self.link.command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0)

    def _find_pose_age(self, time_s: float) -> float:
        """Return the age [s] of the last pose, since it arrived."""
        return time_s - self.link.arrivals["LOCAL_POSITION_NED"]
