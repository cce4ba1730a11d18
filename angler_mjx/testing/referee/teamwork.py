"""Task of one world, recomputed from the robots' positions at each look.

The judged quantities are visited places, taken and delivered goods, seen cells, the time of
completion, and robots with nothing left. The targets of robots are their own decision and are taken
as stored. docs/reference/tasks.md defines the rules.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from angler_mjx.testing.referee.geometry import Floats
from angler_mjx.testing.referee.sight import Camera, Cells, Flags, find_visible

NEVER = 2**31
"""Control step of an event that does not happen."""


@dataclass(frozen=True, kw_only=True)
class TaskRules:
    """Task rules of ``config.json``."""

    kind: str
    tolerance_m: float
    period: int
    """Control steps between looks."""
    is_shared: bool
    is_ordered: bool
    returns: bool
    """Whether robots finish at their starts."""
    goods_return: bool
    """Whether goods of a robot that ended return to their pick-up place."""
    coverage: Fraction
    surface: str
    half_angle_rad: float
    range_m: float
    is_fully_informed: bool
    """Whether every robot knows at once which jobs are done."""


class TaskTable(TypedDict, total=False):
    """Table ``task`` of ``config.json``."""

    type: str
    tolerance_m: float
    look_s: float
    shared: bool
    ordered: bool
    after: str
    dropped: str
    coverage: float
    of: str
    half_angle_deg: float
    range_m: float


def read_rules(table: TaskTable, control_dt_s: float, acoustics: str) -> TaskRules | None:
    """Return the rules of a run; None where each robot has a goal of its own.

    Args:
        table: task of the run.
        control_dt_s: control period of the run.
        acoustics: model of the acoustics of the run.
    """
    kind = table.get("type", "goal")
    if kind == "goal":
        return None
    return TaskRules(
        kind=kind,
        tolerance_m=float(table["tolerance_m"]),
        period=round(float(table["look_s"]) / control_dt_s),
        is_shared=bool(table.get("shared", True)),
        is_ordered=bool(table.get("ordered", False)),
        returns=table["after"] == "return",
        goods_return=table.get("dropped") == "back",
        coverage=Fraction(str(table.get("coverage", 1))),
        surface=str(table.get("of", "")),
        half_angle_rad=float(np.radians(table.get("half_angle_deg", 0.0))),
        range_m=float(table.get("range_m", 0.0)),
        is_fully_informed=acoustics == "perfect",
    )


@dataclass(frozen=True, kw_only=True)
class TaskRecord:
    """Record of a world at its looks: K looks, R robots, M jobs, P places."""

    step: NDArray[np.int64]
    """[K] control steps before each look."""
    dt_s: float
    p: Floats
    """[K, R, 3] in W."""
    q: Floats
    """[K, R, 4]"""
    running: Flags
    """[K, R]"""
    target: NDArray[np.int64]
    """[K, R] place assigned to each robot by each look; -1: it stays."""
    carrying: NDArray[np.int64]
    """[K, R] goods that each robot carries after it; -1: none."""
    environment: Mapping[str, np.ndarray]
    """Static data, and task data that were stored once."""
    low_m: Floats
    band_m: float
    """Distances that differ from the tolerance by less can be changed by rounding."""

    @property
    def jobs(self) -> int:
        """Number of jobs M."""
        return len(self.environment["task/exists"])

    @property
    def exists(self) -> Flags:
        """Bool [M] whether a job exists."""
        exists: Flags = np.asarray(self.environment["task/exists"]).astype(bool)
        return exists

    def look_at(self, time_s: Floats) -> NDArray[np.int64]:
        """Return the look of each time; K for NaN, -1 for a time between looks."""
        steps = np.nan_to_num(np.asarray(time_s, float) / self.dt_s, nan=-1.0)
        index = np.searchsorted(self.step, np.round(steps).astype(np.int64))
        stored_steps = np.append(self.step, -1)[np.minimum(index, len(self.step))]
        fits = np.abs(stored_steps - steps) < 1e-3
        return np.where(np.isnan(time_s), len(self.step), np.where(fits, index, -1)).astype(
            np.int64
        )


@dataclass(kw_only=True)
class JudgedTask:
    """Judgement of a task."""

    jobs_done: NDArray[np.int64]
    """[R] number of jobs, or of places where every robot visits all."""
    progress: float
    completed_step: int
    finished_step: NDArray[np.int64]
    """[R] control steps after which a robot that still ran has reached; `NEVER`."""
    is_bounded: bool = False
    """Whether the robot of each job is taken from the record where that is possible."""
    doubt: str = ""
    """Quantities that rounding can have changed."""
    faults: list[str] = field(default_factory=list)
    """Stored task data that are impossible."""


def judge_task(rule: TaskRules, record: TaskRecord) -> JudgedTask:
    """Judge the task of a world."""
    distances_m = np.linalg.norm(record.p[:, :, None] - record.environment["task/place_m"], axis=3)
    is_near = (distances_m <= rule.tolerance_m) & record.running[..., None]
    if rule.kind == "deliver":
        judged = _judge_delivery(rule, record, is_near)
    elif rule.kind == "survey":
        judged = _judge_survey(rule, record, distances_m, is_near)
    else:
        judged = _judge_tour(rule, record, is_near)
    is_close = (np.abs(distances_m - rule.tolerance_m) < record.band_m) & record.running[..., None]
    if is_close.any():
        look, robot, goal_index = np.argwhere(is_close)[0]
        judged.doubt = (
            f"robot {robot} is {distances_m[look, robot, goal_index] - rule.tolerance_m:.2g} m "
            "beyond "
            f"tolerance_m of place {goal_index} at {record.step[look] * record.dt_s:g} s"
        )
    return judged


def _first_look(true: Flags) -> NDArray[np.int64]:
    """Return the first look [...] at which flags [K, ...] are set; K for none."""
    first: NDArray[np.int64] = np.where(true.any(axis=0), true.argmax(axis=0), len(true))
    return first


def _step_of_look(record: TaskRecord, look: int) -> int:
    return int(record.step[look]) if look < len(record.step) else NEVER


def _finished_steps(
    rule: TaskRules, record: TaskRecord, near: Flags, is_over: Flags
) -> NDArray[np.int64]:
    """Return the number of control steps until each robot has reached [R].

    Args:
        rule: of the task.
        record: of the world.
        near: bool [K, R, P].
        is_over: bool [K, R] whether nothing is left for a robot.
    """
    robots = near.shape[1]
    if rule.returns:
        home = near.shape[2] - robots + np.arange(robots)
        is_over = is_over & near[:, np.arange(robots), home]
    looks = _first_look(is_over & record.running)
    return np.array([min(_step_of_look(record, look) + 1, NEVER) for look in looks], np.int64)


def _count_jobs(by: NDArray[np.int64], robots: int) -> NDArray[np.int64]:
    """Return the number of jobs done by each robot [R]."""
    return np.bincount(by[by >= 0], minlength=robots).astype(np.int64)


def _judge_tour(rule: TaskRules, record: TaskRecord, is_near: Flags) -> JudgedTask:
    is_near = is_near.copy()
    looks, robots, jobs = *is_near.shape[:2], record.jobs
    is_near_job = is_near[:, :, :jobs]
    if rule.is_shared:
        done = np.logical_or.accumulate(is_near_job.any(axis=1), axis=0)
        first = _first_look(done)
        by = np.array(
            [is_near_job[k, :, j].argmax() if k < looks else -1 for j, k in enumerate(first)]
        )
        is_over = np.broadcast_to(done.all(axis=1)[:, None], (looks, robots))
        jobs_done, progress = _count_jobs(by, robots), done[-1].mean()
        complete = _first_look(done.all(axis=1))
    else:
        visited = np.zeros((looks, robots, jobs), bool)
        before = np.zeros((robots, jobs), bool)
        for k in range(looks):
            next_job = np.arange(jobs) == before.argmin(axis=1)[:, None]
            before = before | (is_near_job[k] & (next_job | (not rule.is_ordered)))
            visited[k] = before
        is_over = visited.all(axis=2)
        jobs_done, progress = visited[-1].sum(axis=1), visited[-1].mean()
        complete = _first_look(is_over.all(axis=1))
        done = visited.all(axis=1)
        last_come = visited & ~np.concatenate([np.zeros((1, robots, jobs), bool), visited[:-1]])
        first = _first_look(done)
        by = np.array(
            [last_come[k, :, j].argmax() if k < looks else -1 for j, k in enumerate(first)]
        )
    judged = JudgedTask(
        jobs_done=jobs_done,
        progress=float(progress),
        completed_step=_step_of_look(record, int(complete)),
        finished_step=_finished_steps(rule, record, is_near, is_over),
    )
    _compare_jobs(record, judged, by, first)
    return judged


def _compare_jobs(
    record: TaskRecord, judged: JudgedTask, by: NDArray[np.int64], first: NDArray[np.int64]
) -> None:
    """Compare the robot and look of each job with the stored ones, [M] each."""
    stored_by = np.asarray(record.environment["task/by"])
    stored = record.look_at(record.environment["task/done_at_s"])
    for job in np.flatnonzero((stored_by != by) | (stored != first))[:3]:
        when = [_format_time(record, int(x)) for x in (stored[job], first[job])]
        judged.faults.append(
            f"job {job}: stored by robot {stored_by[job]} {when[0]}, judged by robot {by[job]} "
            f"{when[1]}"
        )


def _format_time(record: TaskRecord, look: int) -> str:
    if look < 0:
        return "at no look"
    return "never" if look >= len(record.step) else f"at {record.step[look] * record.dt_s:g} s"


def _judge_delivery(rule: TaskRules, record: TaskRecord, is_near: Flags) -> JudgedTask:
    looks, robots, jobs = *is_near.shape[:2], record.jobs
    begin, end = is_near[:, :, :jobs], is_near[:, :, jobs : 2 * jobs]
    numbers = np.arange(jobs)
    carries = np.full(robots, -1)
    by, first = np.full(jobs, -1), np.full(jobs, looks)
    done, is_lost = np.zeros(jobs, bool), np.zeros(jobs, bool)
    is_over, complete = np.zeros((looks, robots), bool), looks
    faults: list[str] = []
    sent = np.full(robots, -1)
    for k in range(looks):
        running = record.running[k]
        holds = carries[:, None] == numbers
        brings = holds & end[k]
        is_lost |= (holds & ~running[:, None]).any(axis=0) & (not rule.goods_return)
        carries = np.where(running & ~brings.any(axis=1), carries, -1)
        is_available = ~(done | is_lost | (holds & running[:, None]).any(axis=0))
        picks_up = begin[k] & (sent[:, None] == numbers) & is_available & (carries < 0)[:, None]
        for job in np.flatnonzero(picks_up.any(axis=0)):
            carries[picks_up[:, job].argmax()] = job
        new = brings.any(axis=0) & ~done
        by[new], first[new] = brings[:, new].argmax(axis=0), k
        done |= new
        complete = min(complete, k) if done.all() else complete
        is_over[k] = (done | is_lost).all() & (carries < 0)
        for robot in np.flatnonzero(record.carrying[k] != carries)[: 1 if not faults else 0]:
            faults.append(
                f"robot {robot} is stored with goods {record.carrying[k, robot]} "
                f"{_format_time(record, k)}, judged {carries[robot]}"
            )
        sent = record.target[k]
    judged = JudgedTask(
        jobs_done=_count_jobs(by, robots),
        progress=float(done.mean()),
        completed_step=_step_of_look(record, complete),
        finished_step=_finished_steps(rule, record, is_near, is_over),
        faults=faults,
    )
    _compare_jobs(record, judged, by, first)
    return judged


def _judge_survey(
    rule: TaskRules, record: TaskRecord, distances_m: Floats, is_near: Flags
) -> JudgedTask:
    """Judge a survey: cells by sight, viewpoints as far as the record determines their cells."""
    looks, robots, jobs = *is_near.shape[:2], record.jobs
    cells, faults = (
        np.argwhere(record.environment["task/cells"] > 0),
        _find_wrong_cells(rule, record),
    )
    sure, can = _find_views(rule, record, cells)
    stored = record.look_at(np.asarray(record.environment["task/seen_at_s"])[tuple(cells.T)])
    was_seen = record.environment["task/cells"][tuple(cells.T)] == 2
    first = _first_look(sure)
    fits = (stored <= first) & (stored >= 0) & (was_seen == (stored < looks))
    is_seen = np.pad(can, ((0, 1), (0, 0)), constant_values=True)
    fits &= is_seen[np.clip(stored, 0, looks), np.arange(len(cells))]
    for index in np.flatnonzero(~fits)[:3]:
        faults.append(
            f"cell {tuple(map(int, cells[index]))}: stored as seen "
            f"{_format_time(record, int(stored[index]))}, judged "
            f"{_format_time(record, int(first[index]))}"
        )
    when = np.where(fits, stored, first)
    count = np.array([np.sum(when <= k) for k in range(looks)])
    total = max(len(cells), 1)
    required = -(-rule.coverage.numerator * total // rule.coverage.denominator)
    complete = _first_look(count >= required)
    by, done = _check_viewpoints(record, distances_m[:, :, :jobs], is_near[:, :, :jobs], faults)
    over = (done[None] <= np.arange(looks)[:, None]) | ~record.exists
    is_over = over.all(axis=1) | (np.arange(looks) >= complete)
    return JudgedTask(
        jobs_done=_count_jobs(by, robots),
        progress=float(count[-1] / total),
        completed_step=_step_of_look(record, int(complete)),
        finished_step=_finished_steps(
            rule, record, is_near, np.broadcast_to(is_over[:, None], (looks, robots))
        ),
        is_bounded=True,
        faults=faults,
    )


def _find_views(rule: TaskRules, record: TaskRecord, cells: Cells) -> tuple[Flags, Flags]:
    """Return the cells seen by any robot at each look, certainly and possibly, bool [K, n]."""
    eye = Camera(
        half_angle_rad=rule.half_angle_rad,
        range_m=rule.range_m,
        occupied=np.asarray(record.environment["grid/occupied"]).astype(bool),
        low_m=record.low_m,
        edge_m=float(record.environment["grid/cell_m"]),
    )
    is_visible, can_be_visible = (np.zeros((len(record.step), len(cells)), bool) for _ in range(2))
    for k, robot in np.argwhere(record.running):
        visible = find_visible(eye, record.p[k, robot], record.q[k, robot], cells)
        is_visible[k] |= visible[0]
        can_be_visible[k] |= visible[1]
    return is_visible, can_be_visible


def _find_wrong_cells(rule: TaskRules, record: TaskRecord) -> list[str]:
    """Return the faults of the cells to be seen: each is water at a surface."""
    rock = np.asarray(record.environment["grid/occupied"]).astype(bool)
    cells = np.asarray(record.environment["task/cells"]) > 0
    height = record.low_m[2] + float(record.environment["grid/cell_m"]) * (
        np.arange(rock.shape[2]) + 0.5
    )
    water = ~rock & (height > float(record.environment["floor_z_m"]))
    lowest = water & (np.cumsum(water, axis=2) == 1)
    wide, beside = np.pad(rock, 1), np.zeros_like(rock)
    for axis in range(3):
        for step in (-1, 1):
            beside |= np.roll(wide, step, axis)[1:-1, 1:-1, 1:-1]
    allowed = {"floor": lowest, "rock": beside & ~rock, "both": lowest | (beside & ~rock)}
    wrong = np.argwhere(cells & ~allowed[rule.surface])
    return [f"cell {tuple(map(int, cell))} is no water at what is surveyed" for cell in wrong[:3]]


def _check_viewpoints(
    record: TaskRecord, distances_m: Floats, is_near: Flags, faults: list[str]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the robot of each job [M] and the look of its completion [M], as far as possible.

    The cells of a viewpoint are not stored. A job is over once a robot looked from its
    viewpoint; before that it is credited to the nearest robot whose episode goes on.

    Args:
        record: of the world.
        distances_m: [K, R, M] distances to viewpoints.
        is_near: bool [K, R, M].
        faults: list that receives the faults.
    """
    looks = len(record.step)
    by = np.where(record.exists, np.asarray(record.environment["task/by"]), -1)
    done = np.where(record.exists, record.look_at(record.environment["task/done_at_s"]), looks)
    at_point = _first_look(is_near.any(axis=1))
    for job in np.flatnonzero(record.exists):
        k, robot = int(done[job]), int(by[job])
        fault = (
            "" if k <= at_point[job] else f"a robot was there {_format_time(record, at_point[job])}"
        )
        if 0 <= k < looks and not fault:
            distance_m = np.where(record.running[k], distances_m[k, :, job], np.inf)
            if robot < 0 or distance_m[robot] > distance_m.min() + record.band_m:
                fault = f"robot {distance_m.argmin()} was nearest of those under way"
        if k < 0 or (k == looks) != (robot < 0):
            fault = "no robot can have done it then"
        if fault:
            faults.append(f"job {job}: stored by robot {robot} {_format_time(record, k)}: {fault}")
            by[job] = is_near[at_point[job], :, job].argmax() if at_point[job] < looks else -1
            done[job] = at_point[job]
    return by, done
