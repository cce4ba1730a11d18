"""Request of a spot check, and its results so far."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

from angler_mjx.files import JsonTable
from angler_mjx.runs.storage.folder import Run
from angler_sitl.firmware.parameters import PositionSource
from angler_sitl.spotcheck import gaps
from angler_sitl.spotcheck.flight import RECORDED, SpotcheckFlight
from angler_sitl.spotcheck.gaps import FlightGap
from angler_sitl.spotcheck.world_flyers import ReferenceController, SpotLevel
from angler_sitl.spotcheck.world_selection import Stratify, WorldPick

type FlightKey = tuple[int, str, int]
"""World, name of the flight, robots."""


@dataclass(frozen=True, kw_only=True)
class SpotcheckSettings:
    """Settings of a spot check."""

    episodes: int = 8
    stratify: Stratify = "outcome"
    seed: int = 0
    """Seed of the selection of worlds."""
    against: tuple[ReferenceController, ...] = ("surrogate", "cascade")
    levels: tuple[SpotLevel, ...] = ("thrusters", "guided")
    robots: tuple[int, ...] = ()
    """Robot counts to fly: the first robots of each world. Empty for all robots of the run."""
    source: PositionSource = "vision"
    speed: Literal["max"] | float = "max"
    binary: Path | None = None

    def to_request(self) -> JsonTable:
        """Return the settings that determine the results, in JSON form."""
        chosen = {k: v for k, v in asdict(self).items() if k not in ("speed", "binary")}
        return {k: list(v) if isinstance(v, tuple) else v for k, v in chosen.items()}

    @property
    def references(self) -> tuple[str, ...]:
        """References that autopilots are compared with."""
        return (RECORDED, *self.against)


@dataclass(frozen=True, kw_only=True)
class SpotcheckResult:
    """Spot check, complete or partial."""

    run: Run
    settings: SpotcheckSettings
    picks: tuple[WorldPick, ...]
    counts: tuple[int, ...]
    """Robot counts."""
    likeness: Mapping[int, str]
    """Likeness of each rebuilt world to the recorded one."""
    autopilot: str
    """Version and checksum of the ArduSub."""
    provenance: JsonTable
    flights: Mapping[FlightKey, SpotcheckFlight] = field(default_factory=dict)
    complete: bool = False

    def list_gaps(self, level: str, robots: int, reference: str) -> list[FlightGap]:
        """Return the gaps of all worlds that have both flights."""
        all_gaps = list[FlightGap]()
        for pick in self.picks:
            flight = self.flights.get((pick.world, level, robots))
            other = self.flights.get((pick.world, reference, robots))
            if flight is not None and other is not None:
                all_gaps += gaps.compute_gaps(pick.world, flight, other)
        return all_gaps

    @property
    def plans(self) -> str:
        """Origin of the plans, their times and their information: the same in every flight."""
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
        if scenario.policy.name == "reach":
            begin_m = scenario.policy.reach.begin_m
            parts.append(f"left {begin_m:g} m from the goals for targets of the end effectors")
        return ", ".join(parts)

    def flight_names(self) -> tuple[str, ...]:
        """Return the names of all flights of a world, in the order of tables and legends."""
        return (*self.settings.references, *self.settings.levels)
