"""Submissions: a folder with a card and plans, read without trust in any of it.

    card.toml           who, what, on which machine, and which sets are entered
    plans/SET.zarr      a file of plans for each set (docs/reference/plan_files.md)

What is wrong with a file makes its problems fail, with the reason; only a card that cannot be
understood is refused.
"""

import stat
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import zarr
from pydantic import Field, field_validator, model_validator

from angler_mjx.errors import AnglerError, ConfigError, format_value
from angler_mjx.files import FileModel, parse_model, read_toml
from angler_mjx.leaderboard import problem_sets
from angler_mjx.leaderboard.problem_files import SetRecord
from angler_mjx.leaderboard.problem_sets import FrozenBenchmark, ProblemSet
from angler_mjx.robot.control.commands.joint_trajectory import CUBIC, LINEAR
from angler_mjx.runs.storage.plans.read import GROUND, SCHEMA, SCHEMA_VERSION, SPEED_LIMIT
from angler_mjx.runs.storage.read_errors import wrap_read_errors
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.user_classes import is_class_of_file

CARD, PLANS = "card.toml", "plans"
MAX_FILE_POINTS = 1024
"""Points of a path that are read; a file with wider arrays is refused."""
MAX_NOTE = 200
"""Characters of a reason of a file that are read."""
_OPTIONAL_WIDTHS = {"yaw_rad": 0, "velocity": 4, "acceleration": 4, "degree": 0}
"""Optional arrays of a file of plans, with the size of the axis behind that of the points."""
_PINNED = ("deadline_s", "points")
"""Keys of a scenario's ``planner`` that are the benchmark's."""
NO_POLICY = "none"
"""Policy of robots that fly their plans."""
MIN_REPLAN_HZ = 0.1
"""Least rate at which a planner that enters in flight plans anew."""

type Text = Annotated[str, Field(min_length=1, max_length=2000)]


class ProgramConfig(FileModel):
    """A program that plans problem by problem, run in a sandbox."""

    command: Annotated[tuple[str, ...], Field(min_length=1, max_length=64)]
    """Program and arguments; relative to the submission's folder ``program``. It receives the paths
    of the problem and of the plan to write as two further arguments."""
    memory_gib: Annotated[float, Field(gt=0, le=64)] = 4.0
    processes: Annotated[int, Field(ge=1, le=256)] = 16


class InFlightConfig(FileModel):
    """A planner or policy of the package that commands the robots in flight."""

    planner: dict[str, Any] = Field(default_factory=dict)
    """Keys of a scenario's ``planner``."""
    policy: dict[str, Any] = Field(default_factory=dict)
    """Keys of a scenario's ``policy``."""
    execution: dict[str, Any] = Field(default_factory=dict)
    """Keys of a scenario's ``execution``."""

    @field_validator("planner")
    @classmethod
    def _refuse_pinned(cls, table: dict[str, Any]) -> dict[str, Any]:
        if pinned := [key for key in _PINNED if key in table]:
            raise ValueError(f"{pinned[0]} is given by the benchmark: leave it out")
        return table

    @model_validator(mode="after")
    def _require_flight(self) -> Self:
        """Refuse planners that only plan before the flight: their time has a limit."""
        rate = self.planner.get("replan_hz")
        is_replanned = isinstance(rate, int | float) and rate >= MIN_REPLAN_HZ
        if not self.has_policy and not is_replanned:
            raise ValueError(
                "commands nothing in flight: give a policy, or a planner with replan_hz of at "
                f"least {MIN_REPLAN_HZ:g}; plans made before the flight are entered as "
                'kind = "plans" (angler leaderboard plan)'
            )
        return self

    @property
    def has_policy(self) -> bool:
        """Return whether a policy commands the robots."""
        return self.policy.get("name", NO_POLICY) not in ("", NO_POLICY)

    @field_validator("planner", "policy")
    @classmethod
    def _refuse_code(cls, table: dict[str, Any]) -> dict[str, Any]:
        """Refuse classes of files: they would run in the judge's process, outside the sandbox."""
        name = str(table.get("name", ""))
        if is_class_of_file(name):
            raise ValueError(
                f"name = {format_value(name)}: is a class of a file; in flight only planners and "
                "policies of the package fly: submit plans, or a program"
            )
        return table


class Card(FileModel):
    """The card of a submission."""

    schema_version: Literal[1] = 1
    benchmark: Text
    """Name and version of the benchmark."""
    name: Text
    """Name on the board."""
    authors: Annotated[tuple[Text, ...], Field(max_length=100)] = ()
    description: Annotated[str, Field(max_length=2000)] = ""
    url: Annotated[str, Field(max_length=500, pattern=r"^(https?://\S+)?$")] = ""
    """Page of the submission, which the board links."""
    kind: Literal["plans", "program", "in_flight"] = "plans"
    machine: Annotated[str, Field(max_length=500)] = ""
    """Machine of the planning times."""
    machine_factor: Annotated[float, Field(ge=0.05, le=20)] = 1.0
    """Times as long as the reference core that a core of that machine needs, by ``angler bench
    --workload search``; stated planning times are divided by it."""
    sets: tuple[Text, ...] = ()
    """Sets or parts of names of sets that are entered; all if left out."""
    program: ProgramConfig | None = None
    in_flight: InFlightConfig | None = None

    @model_validator(mode="after")
    def _require_table(self) -> Self:
        for kind, table in (("program", self.program), ("in_flight", self.in_flight)):
            if (self.kind == kind) != (table is not None):
                raise ValueError(
                    f"kind = {format_value(self.kind)}: the table [{kind}] must be there for "
                    f"kind = {format_value(kind)}, and for no other"
                )
        return self


def read_card(folder: Path) -> Card:
    """Read the card of a submission.

    Raises:
        ConfigError: there is none, it has faults, or it is of another benchmark.
    """
    path = folder / CARD
    if not path.is_file():
        raise ConfigError(f"{folder}: is no submission: {CARD} is missing")
    card = parse_model(Card, read_toml(path), source=str(path))
    title = problem_sets.load_benchmark().title
    if card.benchmark != title:
        raise ConfigError(
            f"{path}: benchmark = {format_value(card.benchmark)}: this program judges "
            f"{format_value(title)}"
        )
    return card


def select_entered(benchmark: FrozenBenchmark, card: Card, source: Path) -> list[ProblemSet]:
    """Return the sets that a card enters.

    Raises:
        ConfigError: a name fits no set.
    """
    try:
        return problem_sets.select_problem_sets(benchmark, card.sets)
    except ConfigError as error:
        raise ConfigError(f"{source / CARD}: sets: {error}") from error


@dataclass(frozen=True, kw_only=True)
class PlanRows:
    """Plans of the problems of a set, of one shape whatever the file had."""

    arrays: Mapping[str, np.ndarray]
    """``points`` int32 [world, robot], ``time_s`` float32 [world, robot, point], ``position_m``
    float32 [world, robot, point, 3], and optional arrays of the file."""
    planning_s: np.ndarray
    """float [world], as stated or measured; NaN if unknown."""
    faults: Sequence[str] = field(default=())
    """Reason of each problem that has no usable plan as a whole; empty texts for others."""
    notes: Mapping[tuple[int, int], str] = field(default_factory=dict)
    """What the file says of why robots have no path, by problem and robot."""


def store_rows(path: Path, rows: PlanRows) -> None:
    """Write the plans of a set with their times and faults, to go on with after an interruption."""
    partial = path.with_suffix(".partial.npz")
    arrays: dict[str, Any] = {f"plan/{name}": values for name, values in rows.arrays.items()}
    np.savez(partial, planning_s=rows.planning_s, faults=np.array(rows.faults, str), **arrays)
    partial.replace(path)


def load_rows(path: Path) -> PlanRows:
    """Read what `store_rows` wrote."""
    with np.load(path, allow_pickle=False) as stored:
        arrays = {
            name.removeprefix("plan/"): stored[name]
            for name in stored.files
            if name.startswith("plan/")
        }
        return PlanRows(
            arrays=arrays, planning_s=stored["planning_s"], faults=stored["faults"].tolist()
        )


def empty_rows(entry: ProblemSet, reason: str) -> PlanRows:
    """Return rows without a path, whose problems all fail for a reason."""
    shape = (entry.problems, entry.robots)
    return PlanRows(
        arrays={
            "points": np.zeros(shape, np.int32),
            "time_s": np.zeros((*shape, 2), np.float32),
            "position_m": np.zeros((*shape, 2, 3), np.float32),
        },
        planning_s=np.full(entry.problems, np.nan),
        faults=[reason] * entry.problems,
    )


def read_plans(
    path: Path, entry: ProblemSet, record: SetRecord, seed: int, max_points: int
) -> PlanRows:
    """Read the plans of a set; what cannot be used has a reason instead.

    Args:
        path: of the file of plans.
        entry: the set.
        record: of it, in the manifest.
        seed: attribute of the files of its problems; see `problem_files.printed_seed`.
        max_points: points that a path may have.
    """
    if not path.exists():
        return empty_rows(entry, f"{path.name} is missing")
    if path.is_symlink() or (special := find_special_file(path, links=False)):
        name = path.name if path.is_symlink() else special
        return empty_rows(entry, f"{name} is a link, pipe or device")
    try:
        with wrap_read_errors(Path(path.name)):
            return _read_group(path, entry, record, seed, max_points)
    except AnglerError as error:
        return empty_rows(entry, str(error))


def find_special_file(path: Path, *, links: bool) -> str:
    """Return the name of what lies in a folder and is neither file nor folder; empty if nothing.

    Pipes and devices would be read for ever; links in a file of plans may lead to files of the
    judge.

    Args:
        path: of the folder.
        links: whether links to files and folders may lie there.
    """
    for folder, folders, files in path.walk():
        for name in (*folders, *files):
            found = folder / name
            if found.is_symlink():
                if links and (found.is_file() or found.is_dir() or not found.exists()):
                    continue
            elif stat.S_IFMT(found.lstat().st_mode) in (stat.S_IFREG, stat.S_IFDIR):
                continue
            return str(found.relative_to(path.parent))
    return ""


def _read_group(
    path: Path, entry: ProblemSet, record: SetRecord, seed: int, max_points: int
) -> PlanRows:
    group = zarr.open_group(path, mode="r")
    attributes = dict(group.attrs)
    if (attributes.get("schema"), attributes.get("schema_version")) != (SCHEMA, SCHEMA_VERSION):
        raise ConfigError(f"{path.name}: holds no plans of schema version {SCHEMA_VERSION}")
    if attributes.get("digest") != record.digest:
        raise ConfigError(
            f"{path.name}: digest is {format_value(str(attributes.get('digest'))[:12])}, that of "
            f"the problems is {record.digest[:12]}: its plans are of other problems"
        )
    if attributes.get("seed") != seed:  # not printed: results are published
        raise ConfigError(
            f"{path.name}: seed is missing or not {seed}, that of the problems: its plans are of "
            "others"
        )
    if "sha256" in attributes and attributes["sha256"] != list(record.sha256):
        raise ConfigError(f"{path.name}: sha256 differs from that of the frozen problems")
    shapes = {name: np.shape(array) for name, array in group.arrays()}
    rows = (entry.problems, entry.robots)
    points = shapes["time_s"][-1] if len(shapes.get("time_s", ())) == 3 else 0
    if not 2 <= points <= MAX_FILE_POINTS:
        raise ConfigError(
            f"{path.name}: time_s must be [world, robot, point] with 2 to {MAX_FILE_POINTS} points"
        )
    expected = {"points": rows, "time_s": (*rows, points), "position_m": (*rows, points, 3)}
    for name, width in _OPTIONAL_WIDTHS.items():
        if name in shapes:
            expected[name] = (*rows, points, width)[: 4 if width else 3]
    if "planning_s" in shapes:
        expected["planning_s"] = rows[:1]
    for name, shape in expected.items():
        if shapes.get(name) != shape:
            raise ConfigError(
                f"{path.name}/{name}: has the shape {shapes.get(name)}; must be {shape}"
            )
    if len(expected.keys() & _OPTIONAL_WIDTHS.keys()) and "yaw_rad" not in expected:
        raise ConfigError(f"{path.name}: has velocity, acceleration or degree without yaw_rad")
    arrays, damage = _read_arrays(path, group, list(expected), entry.problems)
    planning_s = arrays.pop("planning_s", np.full(entry.problems, np.nan))
    limited = _limit_points(arrays, planning_s.astype(float), max_points, damage)
    limited = _require_straight(limited)
    return replace(limited, notes=_read_notes(group, shapes.get("reason") == rows))


def _read_notes(group: zarr.Group, has_reasons: bool) -> dict[tuple[int, int], str]:
    """Read why robots have no path; nothing where the file does not say it as it should."""
    texts = group.attrs.get("reasons")
    if not has_reasons or not isinstance(texts, list):
        return {}
    try:
        with wrap_read_errors(Path("reason")):
            index = np.asarray(group.get_array("reason")[:]).astype(int)
    except AnglerError:
        return {}
    return {
        (world, robot): "".join(c for c in str(texts[at])[:MAX_NOTE] if c.isprintable())
        for (world, robot), at in np.ndenumerate(index)
        if 0 <= at < len(texts)
    }


def _read_arrays(
    path: Path, group: zarr.Group, names: Sequence[str], problems: int
) -> tuple[dict[str, np.ndarray], list[str]]:
    """Read arrays, and the damage of each problem; problem by problem where the whole has some."""
    damage = [""] * problems
    arrays = {}
    for name in names:
        array = group.get_array(name)
        try:
            with wrap_read_errors(Path(path.name) / name):
                arrays[name] = np.asarray(array[:])
        except AnglerError:
            rows = np.zeros(array.shape, array.dtype)
            for world in range(problems):
                try:
                    with wrap_read_errors(Path(path.name) / name):
                        rows[world] = array[world]
                except AnglerError as error:
                    damage[world] = damage[world] or str(error)
            arrays[name] = rows
    return arrays, damage


def _limit_points(
    arrays: dict[str, np.ndarray],
    planning_s: np.ndarray,
    max_points: int,
    damage: Sequence[str],
) -> PlanRows:
    """Take out paths that are too long, and columns that no path needs any more."""
    counts = arrays["points"].astype(np.int64)
    is_long = counts > max_points
    faults = []
    for world, (row, points) in enumerate(zip(is_long, counts, strict=True)):
        text = damage[world]
        if row.any() and not text:
            robot = int(np.argmax(row))
            text = f"robot {robot}: path of {points[robot]} points, at most {max_points}"
        stated = planning_s[world]
        if np.isinf(stated) or stated < 0.0:
            text = text or f"planning_s is {stated:g}"
        faults.append(text)
    arrays["points"] = np.where(is_long, 0, np.clip(counts, 0, max_points)).astype(np.int32)
    cut = {
        name: values if name == "points" else values[:, :, :max_points]
        for name, values in arrays.items()
    }
    types = {"points": np.int32, "degree": np.int32}
    with np.errstate(over="ignore", invalid="ignore"):
        typed = {name: values.astype(types.get(name, np.float32)) for name, values in cut.items()}
    return PlanRows(arrays=typed, planning_s=planning_s, faults=faults)


def _require_straight(rows: PlanRows) -> PlanRows:
    """Take out problems with a path that bends between its points, and what would bend it."""
    arrays = dict(rows.arrays)
    velocity, _, degree = (
        arrays.pop(name, None) for name in ("velocity", "acceleration", "degree")
    )
    if degree is None:
        if velocity is None:
            return rows
        degree = np.full(arrays["time_s"].shape, CUBIC)  # as files of plans have it
    # A point's degree is of the segment that begins there: the last one has none.
    is_segment = np.arange(degree.shape[-1]) < arrays["points"][..., None] - 1
    is_bent = np.any(is_segment & (degree > LINEAR), axis=-1)
    faults = list(rows.faults)
    for world in np.flatnonzero(is_bent.any(axis=-1)):
        robot = int(np.argmax(is_bent[world]))
        faults[world] = faults[world] or (
            f"robot {robot}: path with velocities or of a degree above {LINEAR}; paths lead "
            "straight from point to point"
        )
    arrays["points"] = np.where(is_bent, 0, arrays["points"])
    return replace(rows, arrays=arrays, faults=faults)


def write_plans(path: Path, scenario: Scenario, rows: PlanRows) -> None:
    """Write plans of a set as a file for `runs.rollout`, with the true seed of its worlds.

    Args:
        path: to make.
        scenario: of the set.
        rows: the plans.
    """
    group = zarr.open_group(path, mode="w")
    group.attrs.update(
        {
            "schema": SCHEMA,
            "schema_version": SCHEMA_VERSION,
            "digest": scenario.digest(),
            "seed": scenario.seed,
            "scenario": scenario.name,
            SPEED_LIMIT: GROUND,
        }
    )
    is_fault = np.array([bool(fault) for fault in rows.faults])
    for name, values in rows.arrays.items():
        kept = np.where(is_fault[:, None], 0, values) if name == "points" else values
        group.create_array(name, data=kept)
    group.create_array("planning_s", data=rows.planning_s.astype(np.float32))
