"""Real autopilots opened to be driven by hand, by `angler_mjx.teleop`."""

from pathlib import Path

from angler_mjx.scenario.scenario import Scenario
from angler_mjx.teleop.opening import Opened, Opener, Tell
from angler_sitl.firmware.parameters import Level, Source
from angler_sitl.session import SitlSession
from angler_sitl.wire.ground_station import GroundStation


def opener(*, level: Level, source: Source, gcs: str | None, binary: Path | None) -> Opener:
    """What `angler_mjx.teleop.driving.run` takes.

    Args:
        level: where commands enter.
        source: where the autopilots learn their position.
        gcs: ground station that may join.
        binary: the ArduSub; None for the usual one.

    Raises:
        ConfigError: no such ground station.
    """
    station = None if gcs is None else GroundStation(gcs)

    def opened(scenario: Scenario, world: int, logs: Path | None, tell: Tell | None) -> Opened:
        if tell is not None:
            count = len(scenario.members())
            tell(f"{scenario.name}: world {world}, compiling, then booting {count} ArduSub")
        session = SitlSession(
            scenario, world=world, level=level, source=source, binary=binary, folder=logs
        )
        if station is None:
            return Opened(session=session)
        station.join(session)
        return Opened(session=session, watchers=[station])

    return opened
