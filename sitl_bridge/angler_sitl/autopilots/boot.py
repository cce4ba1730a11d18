"""Boot of autopilots from just started processes to armed in their mode.

All autopilots go through the same steps at the same time, checked once in a control period. An
autopilot sends its first message; its streams and all its parameters are requested, and the origin
is sent until confirmed; its filter finds its position; its mode is set; it is armed. Time limits
are by the scene's clock, so they hold at any speed. A timeout ends in one message with ArduSub's
own last texts.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as dialect

from angler_sitl.autopilots.boot_steps import (
    BootClock,
    request_version,
    run_steps,
    send_until_followed,
    wait_until,
)
from angler_sitl.firmware.parameters import PositionSource
from angler_sitl.steering.autopilot_commander import STREAM_RATES_HZ, AutopilotCommander
from angler_sitl.wire import messages
from angler_sitl.wire.mission_upload import MissionUpload, UploadItem

HEARTBEAT_TIMEOUT_S = 15.0
POSITION_TIMEOUT_S: dict[PositionSource, float] = {"vision": 40.0, "vicon": 40.0, "gps": 120.0}
"""Time limit of the filter: with GPS it takes 41 s, else 5 s."""
PARAMETERS_TIMEOUT_S = 20.0
MODE_TIMEOUT_S = 10.0
ARM_TIMEOUT_S = 20.0
HOME_TIMEOUT_S = 10.0
SPOOL_S = 1.0
"""Time after the last was armed: its motors are held back for 0.4 s, and it would drift."""
_MAX_REQUESTS = 20
"""Max parameters requested individually per control period, where the list came with gaps."""


@dataclass(frozen=True, kw_only=True)
class WorldOrigin:
    """Position of W's origin on the globe; the water's surface is at altitude 0."""

    lat_deg: float
    lon_deg: float


@dataclass(frozen=True, kw_only=True)
class BootTimes:
    """Times until the last autopilot was ready."""

    sim_s: float
    wall_s: float


def boot_autopilots(
    pilots: Sequence[AutopilotCommander],
    advance: Callable[[], float],
    *,
    mode: int,
    source: PositionSource,
    home: WorldOrigin,
    missions: Sequence[Sequence[UploadItem]] = (),
) -> BootTimes:
    """Bring up autopilots that were just started.

    Args:
        pilots: all of them.
        advance: advances all autopilots by one control period, external navigation included, and
            returns the scene's time.
        mode: the firmware's number.
        source: position source of their filters.
        home: of the scene.
        missions: items that each autopilot receives, home first; no mission if left out.

    Raises:
        RunError: an autopilot does not come up, with its name and the reason.
    """
    began, now = time.perf_counter(), advance()
    first, clock = now, BootClock(time_s=now)
    pending = [
        _boot_steps(pilot, clock, mode, source, home, mission)
        for pilot, mission in zip(pilots, missions or [()] * len(pilots), strict=True)
    ]
    run_steps(pending, clock, advance)
    end = clock.time_s + SPOOL_S
    while clock.time_s < end:
        clock.time_s = advance()
    return BootTimes(sim_s=clock.time_s - first, wall_s=time.perf_counter() - began)


def _boot_steps(
    pilot: AutopilotCommander,
    clock: BootClock,
    mode: int,
    source: PositionSource,
    home: WorldOrigin,
    mission: Sequence[UploadItem],
) -> Iterator[None]:
    """Run the steps of one autopilot; it yields whenever time has to advance."""
    link = pilot.link

    def has_heartbeat() -> bool:
        return "HEARTBEAT" in link.latest

    yield from wait_until(
        has_heartbeat, pilot, clock, HEARTBEAT_TIMEOUT_S, "says nothing on MAVLink"
    )
    for message, rate in STREAM_RATES_HZ.items():
        link.request_stream(message, rate)
    link.request_parameters()
    request_version(pilot)
    origin = _origin_sender(pilot, home)

    def has_position() -> bool:
        return pilot.has_position

    yield from wait_until(
        has_position, pilot, clock, POSITION_TIMEOUT_S[source], "its EKF finds no position", origin
    )
    yield from wait_until(
        _parameters_complete(pilot),
        pilot,
        clock,
        PARAMETERS_TIMEOUT_S,
        "does not give its parameters",
        _missing_requester(pilot),
    )
    if mission:
        yield from _set_home(pilot, clock, home)
        upload = MissionUpload(link, mission)
        while not upload.advance(clock.time_s):
            yield
    yield from send_until_followed(
        pilot, clock, MODE_TIMEOUT_S, dialect.MAV_CMD_DO_SET_MODE, (1, mode), mode
    )
    yield from send_until_followed(
        pilot, clock, ARM_TIMEOUT_S, dialect.MAV_CMD_COMPONENT_ARM_DISARM, (1,), mode
    )


def _set_home(pilot: AutopilotCommander, clock: BootClock, home: WorldOrigin) -> Iterator[None]:
    """Set home at the surface above W's origin: depths of a mission count from it.

    The firmware's own home has the height of the barometer's zero, which is where it was started.
    """
    command = dialect.MAV_CMD_DO_SET_HOME

    def is_set() -> bool:
        return bool(pilot.link.acks.get(command) == dialect.MAV_RESULT_ACCEPTED)

    def send() -> None:
        pilot.link.send(messages.build_home(pilot.sysid, home.lat_deg, home.lon_deg))

    yield from wait_until(
        is_set, pilot, clock, HOME_TIMEOUT_S, "does not take its home", send, command
    )


def _origin_sender(pilot: AutopilotCommander, home: WorldOrigin) -> Callable[[], None]:
    """Return a sender of W's origin to an autopilot, active until it confirms."""

    def send_origin() -> None:
        if "GPS_GLOBAL_ORIGIN" not in pilot.link.latest:
            pilot.link.send(
                dialect.MAVLink_set_gps_global_origin_message(
                    pilot.sysid, round(home.lat_deg * 1e7), round(home.lon_deg * 1e7), 0
                )
            )

    return send_origin


def _parameters_complete(pilot: AutopilotCommander) -> Callable[[], bool]:
    """Return the condition that all parameters have come."""
    link = pilot.link
    return lambda: 0 < link.parameter_count <= len(link.parameter_indices)


def _missing_requester(pilot: AutopilotCommander) -> Callable[[], None]:
    """Return a sender of requests for parameters whose messages were lost."""

    def request_missing() -> None:
        link = pilot.link
        request_version(pilot)
        if not link.parameter_count:
            link.request_parameters()
            return
        gaps = [i for i in range(link.parameter_count) if i not in link.parameter_indices]
        for index in gaps[:_MAX_REQUESTS]:
            link.request_parameter(index)

    return request_missing
