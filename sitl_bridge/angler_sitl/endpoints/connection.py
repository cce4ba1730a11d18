"""Connection to vehicles: heard, identified, located; nothing is armed, no mode is changed."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from angler_mjx.errors import RunError
from angler_mjx.frames import GeodeticOrigin, geodetic_to_local
from angler_sitl.autopilots.boot_steps import BootClock, request_version, run_steps, wait_until
from angler_sitl.endpoints.addresses import VehicleAddress
from angler_sitl.endpoints.vehicles import VehicleFleet
from angler_sitl.steering.vehicle_commander import RATES_HZ, VehicleCommander, VehicleLink
from angler_sitl.wire.endpoint import Endpoint
from angler_sitl.wire.link import TLOG_NAME, MavlinkMessage, PacketTap, TelemetryLog

HEARTBEAT_TIMEOUT_S = 10.0
POSITION_TIMEOUT_S = 60.0
"""Time limit of the filter of a vehicle that was just switched on: with GPS it takes 41 s."""

_MM_PER_M = 1e3
_DEG = 1e-7


def open_fleet(
    addresses: Sequence[VehicleAddress], *, dt_s: float, logs: Path | None = None
) -> VehicleFleet:
    """Open the endpoints of robots ``robot_0``, ``robot_1``, ..., and identify their autopilots.

    Args:
        addresses: address of each robot.
        dt_s: control period.
        logs: folder of telemetry logs; none are kept if left out.

    Raises:
        ConfigError: an endpoint cannot be opened.
        RunError: nothing is heard of a vehicle, or it is no ArduSub.
    """
    with ExitStack() as stack:
        endpoints: dict[str, Endpoint] = {}
        pilots = []
        for i, address in enumerate(addresses):
            text = address.endpoint.text
            if text not in endpoints:
                endpoints[text] = Endpoint(address.endpoint)
                stack.callback(endpoints[text].close)
            tap = None if logs is None else _open_log(logs / f"robot_{i}", stack)
            channel = endpoints[text].open_channel(address.sysid)
            link = VehicleLink(channel, name=f"robot_{i}", sysid=address.sysid, tap=tap)
            pilots.append(VehicleCommander(link))
        texts = [address.endpoint.text for address in addresses]
        fleet = VehicleFleet(pilots, texts, list(endpoints.values()), dt_s=dt_s)
        clock = BootClock(time_s=fleet.time_s)
        steps = [
            _identify(pilot, endpoints[text], clock)
            for pilot, text in zip(pilots, texts, strict=True)
        ]
        run_steps(steps, clock, fleet.wait)
        fleet.keep(stack.pop_all())
        return fleet


def locate_fleet(fleet: VehicleFleet, origin: GeodeticOrigin | None) -> None:
    """Wait for the positions of all vehicles, and find their origins in W.

    Args:
        fleet: open.
        origin: of W on the globe; if left out, that of the first vehicle's filter. A filter that
            has none receives it.

    Raises:
        RunError: a vehicle has no position in time, or states no origin.
    """
    fleet.poll()  # what has waited since the connection
    for pilot in fleet.pilots:
        pilot.link.restart_delay()
    clock = BootClock(time_s=fleet.time_s)
    run_steps([_locate(pilot, clock, origin) for pilot in fleet.pilots], clock, fleet.wait)
    stated = [pilot.link.latest["GPS_GLOBAL_ORIGIN"] for pilot in fleet.pilots]
    base = origin or read_origin(stated[0])
    for pilot, message in zip(fleet.pilots, stated, strict=True):
        east, north = geodetic_to_local(base, message.latitude * _DEG, message.longitude * _DEG)
        # Heights of satellite navigation differ by metres: z is that of each filter.
        pilot.origin_ned_m = np.array([north, east, 0.0])


def read_origin(message: MavlinkMessage) -> GeodeticOrigin:
    """Return the origin of a filter of a ``GPS_GLOBAL_ORIGIN``."""
    return GeodeticOrigin(
        latitude_deg=message.latitude * _DEG,
        longitude_deg=message.longitude * _DEG,
    )


def _open_log(folder: Path, stack: ExitStack) -> PacketTap:
    folder.mkdir(parents=True, exist_ok=True)
    log = TelemetryLog(folder / TLOG_NAME)
    stack.callback(log.close)
    return log.log_packet


def _identify(pilot: VehicleCommander, endpoint: Endpoint, clock: BootClock) -> Iterator[None]:
    """Wait for the heartbeat of a vehicle, and refuse any but an ArduSub."""
    end_s = clock.time_s + HEARTBEAT_TIMEOUT_S
    while "HEARTBEAT" not in pilot.link.latest:
        if clock.time_s >= end_s:
            raise RunError(_describe_silence(pilot, endpoint))
        endpoint.greet()
        yield
    beat = pilot.link.latest["HEARTBEAT"]
    autopilot = _name_of("MAV_AUTOPILOT", beat.autopilot)
    vehicle = _name_of("MAV_TYPE", beat.type)
    is_ardusub = (
        beat.autopilot == dialect.MAV_AUTOPILOT_ARDUPILOTMEGA
        and beat.type == dialect.MAV_TYPE_SUBMARINE
    )
    if not is_ardusub:
        raise RunError(
            f"{pilot.name}: system {pilot.sysid} at {endpoint.address.text} is a {vehicle} with "
            f"{autopilot}; only ArduSub is commanded (MAV_TYPE_SUBMARINE with "
            "MAV_AUTOPILOT_ARDUPILOTMEGA)"
        )


def _describe_silence(pilot: VehicleCommander, endpoint: Endpoint) -> str:
    """Return what was heard instead of a vehicle."""
    others = ", ".join(str(sysid) for sysid in sorted(endpoint.heard) if sysid != pilot.sysid)
    if endpoint.heard[pilot.sysid]:
        heard = f"only other components of system {pilot.sysid}"
    elif others:
        heard = f"systems {others}; name it with --system-id"
    else:
        heard = endpoint.fault or "nothing; check the address, and what listens or sends there"
    return (
        f"{pilot.name}: no heartbeat of system {pilot.sysid} at {endpoint.address.text} within "
        f"{HEARTBEAT_TIMEOUT_S:g} s; heard: {heard}"
    )


def _name_of(enum: str, number: int) -> str:
    entry = dialect.enums[enum].get(number)
    return f"{enum} {number}" if entry is None else str(entry.name)


def _locate(
    pilot: VehicleCommander, clock: BootClock, origin: GeodeticOrigin | None
) -> Iterator[None]:
    """Request a vehicle's streams, and wait for its position and the origin of its filter."""
    link = pilot.link

    def is_located() -> bool:
        return pilot.has_position and "GPS_GLOBAL_ORIGIN" in link.latest

    def request() -> None:
        for message, rate in RATES_HZ.items():
            link.request_stream(message, rate)
        request_version(pilot)
        number = dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN
        link.command(dialect.MAV_CMD_REQUEST_MESSAGE, number)
        if origin is not None and "GPS_GLOBAL_ORIGIN" not in link.latest:
            link.send(
                dialect.MAVLink_set_gps_global_origin_message(
                    pilot.sysid,
                    round(origin.latitude_deg / _DEG),
                    round(origin.longitude_deg / _DEG),
                    round(origin.altitude_m * _MM_PER_M),
                )
            )

    yield from wait_until(
        is_located,
        pilot,
        clock,
        POSITION_TIMEOUT_S,
        "has no position, or states no origin of its filter (GPS_GLOBAL_ORIGIN)",
        request,
    )
