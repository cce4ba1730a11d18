"""Rows of results in plain values: what the JSON files of sweeps and comparisons hold."""

from collections.abc import Mapping
from typing import TypedDict

from angler_mjx.runs.storage.planning_summary import PlanningSummary

type Rate = Mapping[str, float]
"""``count``, ``rate``, ``low`` and ``high`` of a rate."""
type Mean = Mapping[str, float | None]
"""``count``, ``mean``, ``low`` and ``high`` of a mean; None for what is not defined."""


class TaskRow(TypedDict):
    """Tasks of a run."""

    completed: Rate
    """Rate of worlds."""
    completed_s: Mean


class RunRow(TypedDict):
    """Measures of a run."""

    worlds: int
    robots: int
    """Robots of a world."""
    problems: str
    """Digest of the scenario."""
    planned: Rate
    """Rate of robots that have a path."""
    planning: PlanningSummary | None
    outcomes: Mapping[str, Rate]
    """Rate of robots, by outcome."""
    team: Rate
    """Rate of worlds in which all robots arrived."""
    task: TaskRow | None
    """None of a run without a task."""
    time_to_goal_s: Mean
    energy_j: Mean
    path_length_m: Mean
    min_clearance_m: Mean
    vehicle_steps_per_s: float
    simulate_s: float
    compile_s: float


class CellRow(RunRow):
    """Measures of the run of a cell."""

    cell: int
    run: str
    """Path of the run below the folder."""
    set: dict[str, str]
    """Values by key, as they were written."""


class PairCounts(TypedDict):
    """Number of pairs of yes and no, by what became of both."""

    both: int
    only_first: int
    only_second: int
    neither: int


class RateRow(PairCounts):
    """Change of a rate from a first run to a second one."""

    difference: float | None
    """Rate of the second minus that of the first."""
    low: float | None
    high: float | None
    p: float
    """Exact, two-sided: that neither is likelier to have it alone."""


class ShiftRow(TypedDict):
    """Change of a mean from a first run to a second one; None for what is not defined."""

    pairs: int
    first: float | None
    """Mean of the first run, over the pairs."""
    second: float | None
    difference: float | None
    low: float | None
    high: float | None


class PairingRow(TypedDict):
    """Change from a first run to a second one of the same worlds."""

    worlds: int
    """Worlds that both runs hold."""
    teams: RateRow
    """Worlds in which all robots arrived."""
    tasks: RateRow | None
    """Worlds that completed their task; None where a run has none."""
    task_s: ShiftRow | None
    """Time of completion, of worlds that completed their task in both runs."""
    robots: RateRow | None
    """Robots that arrived; counts are of robots, difference and p of worlds. None where the fleets
    have different sizes."""
    share: ShiftRow
    """Fraction of a world's robots that arrived."""
    share_p: float
    """p of the sign test on that fraction."""
    costs: Mapping[str, ShiftRow]
    """By column; empty where the fleets have different sizes."""


class PairRow(PairingRow):
    """Two cells of a sweep that differ in one key."""

    key: str
    first: int
    """Number of the first cell."""
    second: int
    same_problems: bool


class AxisRow(TypedDict):
    """Axis of a sweep."""

    key: str
    names: list[str]
    values: list[object]


class SweepResults(TypedDict):
    """Content of ``sweep.json``."""

    scenario: str
    worlds: int
    seed: int
    complete: bool
    axes: list[AxisRow]
    cells: list[CellRow]
    pairs: list[PairRow]
    environment: Mapping[str, object]


class KeyChange(TypedDict):
    """Key of a scenario that differs between two runs."""

    key: str
    first: object
    second: object


class OutcomeChange(TypedDict):
    """Number of robots by their outcomes in two runs."""

    first: str
    second: str
    robots: int


class RobotChange(TypedDict):
    """Robot of a world with another outcome in the second run."""

    robot: int
    first: str
    second: str


class ChangedWorld(TypedDict):
    """World that ended otherwise in the second run."""

    world: int
    task: dict[str, float | None] | None
    """``first_s`` and ``second_s``: times of completion."""
    arrived_first: int
    arrived_second: int
    lost: int
    won: int
    time_s: float | None
    robots: list[RobotChange]


class RunComparison(PairingRow):
    """Two runs against each other."""

    first: str
    """Path of the first run."""
    second: str
    config: list[KeyChange]
    same_problems: bool
    asked: int
    """Worlds of the first run's scenario."""
    planning: Mapping[str, PlanningSummary | None]
    """By ``first`` and ``second``."""
    outcomes: list[OutcomeChange]
    changed: list[ChangedWorld]
    """Worlds that changed most first."""
