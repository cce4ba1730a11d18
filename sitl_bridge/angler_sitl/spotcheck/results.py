"""What was asked of a spot check, and what it found so far."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from angler_mjx.runs.storage.folder import Run
from angler_sitl.firmware.parameters import PositionSource
from angler_sitl.spotcheck import gaps
from angler_sitl.spotcheck.flight import RECORDED, SpotcheckFlight
from angler_sitl.spotcheck.gaps import FlightGap
from angler_sitl.spotcheck.world_flyers import ReferenceController, SpotLevel
from angler_sitl.spotcheck.world_selection import Stratify, WorldPick

type FlightKey = tuple[int, str, int]
"""World, name of what flew, robots."""


@dataclass(frozen=True, kw_only=True)
class SpotcheckSettings:
    """What is asked for."""

    episodes: int = 8
    stratify: Stratify = "outcome"
    seed: int = 0
    """Of the draw of worlds."""
    against: tuple[ReferenceController, ...] = ("surrogate", "cascade")
    levels: tuple[SpotLevel, ...] = ("thrusters", "guided")
    robots: tuple[int, ...] = ()
    """Each count is flown: the first so many of each world. Empty for all robots of the run."""
    source: PositionSource = "vision"
    speed: Literal["max"] | float = "max"
    binary: Path | None = None

    def to_request(self) -> dict[str, Any]:
        """What the results depend on, as JSON has it."""
        chosen = {k: v for k, v in asdict(self).items() if k not in ("speed", "binary")}
        return {k: list(v) if isinstance(v, tuple) else v for k, v in chosen.items()}

    @property
    def references(self) -> tuple[str, ...]:
        """What autopilots are held against."""
        return (RECORDED, *self.against)


@dataclass(frozen=True, kw_only=True)
class SpotcheckResult:
    """A spot check, whole or as far as it came."""

    run: Run
    settings: SpotcheckSettings
    picks: tuple[WorldPick, ...]
    counts: tuple[int, ...]
    """Robots."""
    likeness: Mapping[int, str]
    """Of each world made again to the one recorded."""
    autopilot: str
    """Version and checksum of the ArduSub."""
    provenance: Mapping[str, Any]
    flights: Mapping[FlightKey, SpotcheckFlight] = field(default_factory=dict)
    complete: bool = False

    def list_gaps(self, level: str, robots: int, reference: str) -> list[FlightGap]:
        """Of all worlds that have both flights."""
        all_gaps = list[FlightGap]()
        for pick in self.picks:
            flight = self.flights.get((pick.world, level, robots))
            other = self.flights.get((pick.world, reference, robots))
            if flight is not None and other is not None:
                all_gaps += gaps.compute_gaps(pick.world, flight, other)
        return all_gaps

    @property
    def plans(self) -> str:
        """Who made the plans, when, and knowing what: the same in every flight."""
        scenario = self.run.scenario
        planner, information = scenario.planner, scenario.planner.information
        parts = [f"by {planner.name} before the start"]
        if planner.replan_hz:
            parts.append(
                f"anew in every flight at {planner.replan_hz:g} Hz, taken up "
                f"{planner.delay_s:g} s later; known of obstacles: {information.obstacles}, of the "
                f"current: {information.current}"
            )
        if scenario.execution.order == "kept":
            parts.append("flown in the order of the plans")
        return ", ".join(parts)

    def flight_names(self) -> tuple[str, ...]:
        """Of all flights of a world, in the order of tables and legends."""
        return (*self.settings.references, *self.settings.levels)
