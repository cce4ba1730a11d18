"""Findings of the referee: one for each quantity of each robot, and their summary."""

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from typing import Literal

type Value = float | str | None
type CheckMethod = Literal["exact", "bounded", "unchecked"]
type FindingResult = Literal["agrees", "undecided", "disagrees"]
type Conclusion = Literal["agrees", "agrees in part", "inconclusive", "disagrees"]
"""Conclusion of a run.

agrees: every outcome was recomputed; agrees in part: some were; inconclusive: no outcome was, so
nothing confirms the results; disagrees: a finding does."""

QUANTITIES = {
    "outcome": "",
    "end_time_s": "s",
    "path_length_m": "m",
    "energy_j": "J",
    "min_clearance_m": "m",
    "min_separation_m": "m",
    "failure_pair": "",
    "impact_speed_mps": "m/s",
    "failure_place_m": "m",
    "record": "",
}
"""Judged quantities of each robot, with units.

``record``: whether the trajectory itself is possible: the start, rest of failed robots, and the
outcome beside each sample."""

TASK_QUANTITIES = {
    "jobs_done": "",
    "task_progress": "",
    "task_completed_s": "s",
    "task": "",
}
"""Judged quantities of runs with a task, with units.

``task``: whether the task data of the trajectories are possible: the robot and time of each job,
goods that robots carry, cells that were seen and when."""

CONTACT_QUANTITIES = {"impact_energy_j": "J", "contact_depth_m": "m"}
"""Judged quantities of runs in which bodies push each other, with units."""

CARRY_QUANTITIES = {
    "cargo_distance_m": "m",
    "cargo_angle_rad": "rad",
    "grip_force_n": "N",
    "internal_force_n": "N",
    "grip": "",
}
"""Judged quantities of runs whose robots hold a body together, with units.

``grip``: whether the body stays where each robot holds it, as long as it does."""

PATH_M, ENERGY_FRACTION, CLEARANCE_M, IMPACT_MPS = 1e-2, 1e-3, 1e-5, 1e-4
"""Tolerances of exact checks. Outcomes, pairs and times have to be equal."""

CARGO_M, CARGO_RAD = 1e-5, 1e-5
"""Tolerances of the pose of a held body, of sums and square roots in float32."""

ENERGY_J = 1e-2
"""Absolute tolerance of energies near zero."""


@dataclass(frozen=True, kw_only=True)
class RefereeFinding:
    """Finding on one quantity of one robot of one world."""

    world: int
    robot: int
    quantity: str
    how: CheckMethod
    """exact: recomputed; bounded: compared with the bounds of the record; unchecked: not
    determined by the record."""
    result: FindingResult
    """undecided: it differs, by a decision that rounding in float32 can have changed."""
    stored: Value
    judged: Value
    deviation: float = 0.0
    tolerance: float = 0.0
    note: str = ""

    def line(self) -> str:
        """Return the finding as text."""
        if self.result == "agrees":
            text = f"agrees ({self.how})"
        else:
            text = f"stored {_format_value(self.stored)}, judged {_format_value(self.judged)}"
        if self.result == "disagrees" and self.tolerance > 0.0:
            text += f", {self.deviation:.3g} apart, {self.tolerance:.3g} allowed"
        note = f": {self.note}" if self.note else ""
        undecided = "undecided, " if self.result == "undecided" else ""
        return f"world {self.world} robot {self.robot} {self.quantity}: {undecided}{text}{note}"

    def table(self) -> dict[str, object]:
        """Return the finding for JSON: non-finite numbers are null."""
        return {name: _to_json_value(value) for name, value in asdict(self).items()}


def _format_value(value: Value) -> str:
    return f"{value:.9g}" if isinstance(value, float) else str(value)


def _to_json_value(value: object) -> object:
    if not isinstance(value, float) or math.isfinite(value):
        return value
    return None if math.isnan(value) else str(value)


@dataclass(kw_only=True)
class FindingCount:
    """Counts of one quantity, over all judged robots."""

    exact: int = 0
    bounded: int = 0
    unchecked: int = 0
    undecided: int = 0
    disagrees: int = 0
    largest: float = 0.0
    """Largest deviation of agreeing exact checks, relative for energies."""
    why: dict[str, int] = field(default_factory=dict)
    """Reasons of bounded or missing checks, with the number of robots of each."""

    @property
    def robots(self) -> int:
        """Number of robots whose quantity was examined."""
        return self.exact + self.bounded + self.unchecked

    def text(self) -> str:
        """Return the counts in words: recomputed, bounded, and unchecked."""
        text = f"{self.exact:,} of {self.robots:,} worked out anew"
        text += f", {self.undecided:,} of these undecided" if self.undecided else ""
        for number, label in (
            (self.bounded, "held against bounds"),
            (self.unchecked, "not checked"),
        ):
            text += f", {number:,} {label}" if number else ""
        return text + (f" ({'; '.join(self.why)})" if self.why else "")


@dataclass(kw_only=True)
class RefereeVerdict:
    """Verdict on a run."""

    run: str
    planned_worlds: int
    """Number of planned worlds."""
    finished_worlds: int
    """Number of worlds with results."""
    worlds: int = 0
    """Number of judged worlds."""
    robots: int = 0
    passed_goal_early: int = 0
    """Number of robots at their goals before the last approaches of their plans, as stored."""
    sampled: str = ""
    counts: dict[str, FindingCount] = field(
        default_factory=lambda: {q: FindingCount() for q in QUANTITIES}
    )
    differences: list[RefereeFinding] = field(default_factory=list)
    """All findings that disagree or are undecided."""

    @property
    def conclusion(self) -> Conclusion:
        """Conclusion of the findings, by the number of recomputed outcomes."""
        outcomes = self.counts["outcome"]
        if any(count.disagrees for count in self.counts.values()):
            return "disagrees"
        confirmed = outcomes.exact - outcomes.undecided
        if confirmed == 0:
            return "inconclusive"
        return "agrees" if confirmed == outcomes.robots else "agrees in part"

    @property
    def agrees(self) -> bool:
        """Whether outcomes were recomputed and nothing disagrees."""
        return self.conclusion in ("agrees", "agrees in part")

    def add(self, findings: Iterable[RefereeFinding]) -> None:
        """Count findings."""
        for finding in findings:
            count = self.counts.setdefault(finding.quantity, FindingCount())
            setattr(count, finding.how, getattr(count, finding.how) + 1)
            if finding.how != "exact" and finding.note:
                count.why[finding.note] = count.why.get(finding.note, 0) + 1
            if finding.result == "agrees":
                count.largest = max(count.largest, finding.deviation)
                continue
            setattr(count, finding.result, getattr(count, finding.result) + 1)
            self.differences.append(finding)

    def table(self) -> dict[str, object]:
        """Return the verdict for JSON."""
        return {
            "run": self.run,
            "conclusion": self.conclusion,
            "agrees": self.agrees,
            "planned_worlds": self.planned_worlds,
            "finished_worlds": self.finished_worlds,
            "worlds": self.worlds,
            "robots": self.robots,
            "passed_goal_early": self.passed_goal_early,
            "sampled": self.sampled,
            "counts": {name: asdict(count) for name, count in self.counts.items()},
            "differences": [finding.table() for finding in self.differences],
        }
