"""Contents of ``sweep.json`` and of a comparison of two runs."""

from typing import TypedDict

from angler_mjx.runs.storage.planning_summary import PlanningSummary


class RateEntry(TypedDict):
    """A fraction with its interval."""

    rate: float
    low: float
    high: float


class MeanEntry(TypedDict):
    """A mean with its interval; None where nothing has a value, or the interval is unknown."""

    mean: float | None
    low: float | None
    high: float | None
    count: int


class ShiftEntry(TypedDict):
    """Change of a mean from the first to the second, as `paired.MeanShift`."""

    pairs: int
    first: float | None
    second: float | None
    difference: float | None
    low: float | None
    high: float | None


class RateChangeEntry(TypedDict):
    """Change of a rate from the first to the second, as `paired.RateChange`."""

    both: int
    only_first: int
    only_second: int
    neither: int
    difference: float
    low: float | None
    high: float | None
    p: float


class PairingEntry(TypedDict):
    """What the second of two runs changed, as `paired.RunPairing`."""

    worlds: int
    teams: RateChangeEntry
    tasks: RateChangeEntry | None
    task_s: ShiftEntry | None
    robots: RateChangeEntry | None
    share: ShiftEntry
    share_p: float
    costs: dict[str, ShiftEntry]
    same_problems: bool


class TaskEntry(TypedDict):
    """Tasks of the worlds of a cell: how many were completed, and when [s]."""

    completed: RateEntry
    completed_s: MeanEntry


class SweepAxisEntry(TypedDict):
    """A key of a sweep and its values."""

    key: str
    names: list[str]
    values: list[object]


class SweepCellEntry(TypedDict):
    """A cell of a sweep, as `measures.measure_run` measures it; others stand beside these."""

    cell: int
    run: str
    set: dict[str, str]
    robots: int
    planned: RateEntry
    planning: PlanningSummary | None
    outcomes: dict[str, RateEntry]
    team: RateEntry
    task: TaskEntry | None
    time_to_goal_s: MeanEntry
    energy_j: MeanEntry
    min_clearance_m: MeanEntry


class SweepPairEntry(PairingEntry):
    """Two cells that differ in one key."""

    key: str
    first: int
    second: int


class SweepResults(TypedDict):
    """Contents of ``sweep.json``."""

    scenario: str
    worlds: int
    seed: int
    complete: bool
    axes: list[SweepAxisEntry]
    cells: list[SweepCellEntry]
    pairs: list[SweepPairEntry]
    environment: dict[str, object]


class ChangedKey(TypedDict):
    """A key of two scenarios, or an outcome of two runs, that differs."""

    key: str
    first: object
    second: object


class OutcomeChange(TypedDict):
    """Robots by their two outcomes."""

    first: str
    second: str
    robots: int


class ChangedRobot(TypedDict):
    """A robot that ended otherwise."""

    robot: int
    first: str
    second: str


class TaskTimes(TypedDict):
    """Times [s] at which a world completed its task in both runs; None: it did not."""

    first_s: float | None
    second_s: float | None


class ChangedWorld(TypedDict):
    """A world that the second run changed."""

    world: int
    task: TaskTimes | None
    arrived_first: int
    arrived_second: int
    lost: int
    won: int
    time_s: float | None
    robots: list[ChangedRobot]


class ComparedPlanning(TypedDict):
    """Planning of both runs, by `planning_summary.summarise_planning`."""

    first: PlanningSummary | None
    second: PlanningSummary | None


class RunComparison(PairingEntry):
    """What `compare.compare_runs` finds."""

    first: str
    second: str
    config: list[ChangedKey]
    asked: int
    planning: ComparedPlanning
    outcomes: list[OutcomeChange]
    changed: list[ChangedWorld]
