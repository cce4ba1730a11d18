"""Status of each robot of a flight, one row per robot."""

from dataclasses import dataclass

import numpy as np

from angler_mjx.runs.session.interface import Observation
from angler_sitl.session import SitlSession
from angler_sitl.steering.autopilot_commander import mode_name


@dataclass(frozen=True, kw_only=True)
class MissionStatus:
    """Status of one robot."""

    name: str
    mode: str
    armed: bool
    has_position: bool
    """Whether its autopilot has a position estimate."""
    off_m: float
    """Distance from the true position to the target."""
    clearance_m: float
    outcome: str
    remark: str
    """Further remarks; empty if there are none."""

    def format_line(self) -> str:
        """Return the status as a line of text."""
        parts = [
            f"{self.name}: {self.mode}, {'armed' if self.armed else 'disarmed'}",
            f"EKF {'good' if self.has_position else 'bad'}",
            f"off {self.off_m:.2f} m",
            f"clear {self.clearance_m:.2f} m",
            self.outcome,
        ]
        return ", ".join([*parts, *([self.remark] if self.remark else [])])


def collect_status(session: SitlSession, observation: Observation) -> list[MissionStatus]:
    """Return the status of all robots.

    Args:
        session: after a step.
        observation: of that step.
    """
    autopilots, estimate = session.autopilots, observation.truth or observation.estimate
    target_m, clearance_m = np.asarray(observation.target_m), np.asarray(observation.clearance_m)
    off_m = np.linalg.norm(np.asarray(estimate.p) - target_m, axis=1)
    rows = []
    for i, (pilot, status) in enumerate(zip(autopilots.pilots, observation.status, strict=True)):
        is_lost = i in autopilots.lost
        # The autopilot's own note is in columns; the status of the orders comes first.
        note = autopilots.note(i) if is_lost else status.note.removesuffix(pilot.note())
        refusal = f"refused: {status.refused}" if status.refused and not is_lost else ""
        rows.append(
            MissionStatus(
                name=session.robots[i].name,
                mode="lost" if is_lost else mode_name(pilot.mode),
                armed=pilot.armed and not is_lost,
                has_position=pilot.has_position and not is_lost,
                off_m=float(off_m[i]),
                clearance_m=float(clearance_m[i]),
                outcome=status.outcome.name.lower(),
                remark=refusal or note.rstrip("; "),
            )
        )
    return rows
