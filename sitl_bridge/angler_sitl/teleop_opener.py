"""Opener of real autopilots for teleoperation by `angler_mjx.teleop`."""

from pathlib import Path

from angler_mjx.scenario.scenario import Scenario
from angler_mjx.teleop.opening import OpenedSession, Report, SessionOpener
from angler_sitl.firmware.parameters import CommandLevel, PositionSource
from angler_sitl.missions.ground_station import GroundStation
from angler_sitl.session import SitlSession


def build_session_opener(
    *, level: CommandLevel, source: PositionSource, gcs: str | None, binary: Path | None
) -> SessionOpener:
    """Build the session opener for `angler_mjx.teleop.driving.run_teleop`.

    Args:
        level: where commands enter.
        source: position source of the autopilots.
        gcs: ground station that may join.
        binary: ArduSub executable; None for the usual one.

    Raises:
        ConfigError: no such ground station.
    """
    station = None if gcs is None else GroundStation(gcs)

    def open_session(
        scenario: Scenario, world: int, logs: Path | None, report: Report | None
    ) -> OpenedSession:
        if report is not None:
            count = len(scenario.members())
            report(f"{scenario.name}: world {world}, compiling, then booting {count} ArduSub")
        session = SitlSession(
            scenario, world=world, level=level, source=source, binary=binary, folder=logs
        )
        if station is None:
            return OpenedSession(session=session)
        station.join(session)
        return OpenedSession(session=session, watchers=[station])

    return open_session
