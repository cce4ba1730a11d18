"""How each robot of a flight stands, in a row of plain facts."""

from dataclasses import dataclass

import numpy as np

from angler_mjx.runs.session.interface import Observation
from angler_sitl.session import SitlSession
from angler_sitl.steering.autopilot_commander import mode_name


@dataclass(frozen=True, kw_only=True)
class MissionStatus:
    """Of one robot."""

    name: str
    mode: str
    armed: bool
    has_position: bool
    """Whether its autopilot knows its position."""
    off_m: float
    """From where it truly is to what it aims at."""
    clearance_m: float
    outcome: str
    remark: str
    """What there is to say beside that; empty if nothing."""

    def format_line(self) -> str:
        """In a line of text."""
        parts = [
            f"{self.name}: {self.mode}, {'armed' if self.armed else 'disarmed'}",
            f"EKF {'good' if self.has_position else 'bad'}",
            f"off {self.off_m:.2f} m",
            f"clear {self.clearance_m:.2f} m",
            self.outcome,
        ]
        return ", ".join([*parts, *([self.remark] if self.remark else [])])


def collect_status(session: SitlSession, observation: Observation) -> list[MissionStatus]:
    """How everybody stands.

    Args:
        session: after a step.
        observation: of that step.
    """
    autopilots, estimate = session.autopilots, observation.truth or observation.estimate
    target_m, clearance_m = np.asarray(observation.target_m), np.asarray(observation.clearance_m)
    off_m = np.linalg.norm(np.asarray(estimate.p) - target_m, axis=1)
    rows = []
    for i, (pilot, status) in enumerate(zip(autopilots.pilots, observation.status, strict=True)):
        is_lost = i in autopilots.lockstep.lost
        # The autopilot's own words stand in columns; what the orders say comes before them.
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
