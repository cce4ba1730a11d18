"""Vehicles behind endpoints, on the wall clock: polled, estimated, armed on purpose, closed."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as dialect

from angler_mjx.runs.session.interface import Floats
from angler_mjx.teleop.pace import Overruns, RealTimePacer
from angler_sitl.autopilots.boot_steps import BootClock, run_steps, send_until_followed
from angler_sitl.firmware.probe import read_version
from angler_sitl.steering.autopilot_commander import GUIDED_MODE, EstimatedMotion, collect_motion
from angler_sitl.steering.vehicle_commander import VehicleCommander
from angler_sitl.wire.endpoint import Endpoint

MODE_TIMEOUT_S, ARM_TIMEOUT_S = 10.0, 10.0
_POLL_S = 0.05
"""Period of looks at the endpoints while nothing is flown."""


@dataclass(frozen=True, kw_only=True)
class VehicleReport:
    """State of a vehicle, for the person who arms it."""

    name: str
    address: str
    sysid: int
    version: str
    note: str
    position_m: Floats
    """[3] in W."""

    def __str__(self) -> str:
        """Return the state as a line of text."""
        x, y, z = map(float, self.position_m)
        return (
            f"{self.name}: system {self.sysid} at {self.address}, ArduSub {self.version}, "
            f"{self.note}, at ({x:.2f}, {y:.2f}, {z:.2f}) m"
        )


class VehicleFleet:
    """Vehicles in the order of the robots.

    Attributes:
        pilots: one commander per vehicle.
        addresses: their connection strings.
        endpoints: open endpoints.
        lost: reason of each lost vehicle, by its index.
        polled_s: time of the last poll.
    """

    def __init__(
        self,
        pilots: Sequence[VehicleCommander],
        addresses: Sequence[str],
        endpoints: Sequence[Endpoint],
        *,
        dt_s: float,
        clock: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Start the clock.

        Args:
            pilots: one commander per vehicle.
            addresses: their connection strings.
            endpoints: open endpoints.
            dt_s: control period.
            clock: of the wall, s.
            sleep: waits for seconds.
        """
        self.pilots, self.endpoints = list(pilots), list(endpoints)
        self.addresses, self.lost = list(addresses), dict[int, str]()
        self._dt_s, self._resources = dt_s, ExitStack()
        self._clock, self._sleep, self._began_s = clock, sleep, clock()
        self.polled_s = 0.0
        self.restart_pace()

    @property
    def time_s(self) -> float:
        """Wall time since the connection, s."""
        return self._clock() - self._began_s

    @property
    def overruns(self) -> Overruns:
        """Control periods that took longer than those of the wall clock."""
        return self._pacer.overruns

    @property
    def pwm(self) -> NDArray[np.int32]:
        """Last signals [R, 16] of the outputs, us."""
        return np.array([pilot.read_pwm() for pilot in self.pilots], np.int32)

    def restart_pace(self) -> None:
        """Begin a control period now."""
        self._pacer = RealTimePacer(self._dt_s, self._clock, self._sleep)

    def advance(self) -> float:
        """Wait for the end of the control period, take what arrived, return the time."""
        self._pacer.wait()
        return self.poll()

    def poll(self) -> float:
        """Take what has arrived, send the heartbeats that are due, return the time."""
        now_s = self.time_s
        for pilot in self.pilots:
            pilot.tick(now_s)
        self.polled_s = now_s
        return now_s

    def take_waiting(self) -> None:
        """Take what has waited since the last poll; it counts as if it had come then."""
        for pilot in self.pilots:
            pilot.tick(self.polled_s)
            pilot.link.restart_delay()

    def wait(self) -> float:
        """Wait a moment while nothing is flown, and return the time."""
        self._sleep(_POLL_S)
        return self.poll()

    def estimate_motion(self) -> EstimatedMotion:
        """Return the vehicles' estimates of their motion at the current time."""
        return collect_motion(self.pilots, self.time_s)

    def note(self, robot: int) -> str:
        """Return a short note on the state of a vehicle."""
        return self.lost.get(robot) or self.pilots[robot].note()

    def report(self) -> list[VehicleReport]:
        """Return the state of each vehicle, for the person who arms it."""
        reports = []
        for pilot, address, p in zip(
            self.pilots, self.addresses, self.estimate_motion().p, strict=True
        ):
            stated = pilot.link.latest.get("AUTOPILOT_VERSION")
            version = "of unknown version" if stated is None else read_version(stated)[0]
            reports.append(
                VehicleReport(
                    name=pilot.name,
                    address=address,
                    sysid=pilot.sysid,
                    version=version,
                    note=pilot.note(),
                    position_m=p,
                )
            )
        return reports

    def arm(self, robots: Sequence[int]) -> None:
        """Set GUIDED and arm, until the heartbeats say so.

        Raises:
            RunError: a vehicle refuses, with its reasons. All of them are disarmed then.
        """
        clock = BootClock(time_s=self.time_s)

        def bring_up(pilot: VehicleCommander) -> Iterator[None]:
            yield from send_until_followed(
                pilot,
                clock,
                MODE_TIMEOUT_S,
                dialect.MAV_CMD_DO_SET_MODE,
                (1, GUIDED_MODE),
                GUIDED_MODE,
            )
            yield from send_until_followed(
                pilot,
                clock,
                ARM_TIMEOUT_S,
                dialect.MAV_CMD_COMPONENT_ARM_DISARM,
                (1,),
                GUIDED_MODE,
            )

        try:
            run_steps([bring_up(self.pilots[i]) for i in robots], clock, self.wait)
        except BaseException:
            for i in robots:
                self.pilots[i].disarm()
            raise

    def keep(self, resources: ExitStack) -> None:
        """Close resources with the fleet: endpoints and logs."""
        self._resources.push(resources)

    def close(self) -> None:
        """Close all endpoints and logs; a second call has no effect."""
        self._resources.close()
