"""Benchmark file: planners, and the scenes whose problems all of them receive."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, field_validator, model_validator

from angler_mjx.errors import format_value
from angler_mjx.files import FileModel
from angler_mjx.planning.planner import MAX_POINTS
from angler_mjx.quantities import SchemaVersion
from angler_mjx.scenario.editing import Changes
from angler_mjx.scenario.policy_tables import POLICIES, PolicyName
from angler_mjx.scenario.tables import InformationConfig, PlannerName
from angler_mjx.world import presets

type Label = Annotated[str, Field(min_length=1, max_length=60, pattern=r"^[^\x00-\x1f]+$")]


class PlannerEntry(FileModel):
    """A planner, flown as it planned or online, or a policy."""

    renamed_keys: ClassVar[Mapping[str, str]] = {"knows": "information"}

    name: PlannerName = ""
    """A planner of `angler plan --list`, or FILE.py:CLASS; required without a policy."""
    policy: PolicyName | None = None
    """Policy in place of a planner: its name in a scenario, such as mppi, or FILE.py:CLASS; flies
    without plans."""
    label: Label | None = None
    """Name in tables and figures, unique in the file; if left out, the name or class, and how it is
    flown."""
    settings: dict[str, Any] = Field(default_factory=dict)
    """Settings that differ from the defaults, as in the scenario's table [planner.NAME],
    [policy.NAME] or [policy.CLASS]."""
    information: InformationConfig | None = None
    """Information that it receives, whatever others receive; that of the file, or of the scenario,
    if left out."""
    replan_hz: float = Field(default=0.0, ge=0.0, le=1e4)
    """Rate of replanning in flight, as the scenario's planner.replan_hz; 0: none."""
    delay_s: float = Field(default=0.0, ge=0.0, le=86400.0)
    """Delay from the state that a new plan starts from until it is flown, as the scenario's
    planner.delay_s."""
    order: Literal["free", "kept"] | None = None
    """Order of robots at crossings, as the scenario's execution.order; the scenario's if left
    out."""
    presets: tuple[str, ...] = ()
    """Presets of worlds that it flies in; all if left out."""
    teams: tuple[Annotated[int, Field(ge=1, le=1024)], ...] = ()
    """Team sizes [robots] that it flies with; all if left out."""

    @model_validator(mode="after")
    def _require_planner_or_policy(self) -> Self:
        if not self.name and self.policy is None:
            raise ValueError(
                'name is missing: give a planner, or a policy, such as policy = "mppi"'
            )
        if self.name in POLICIES:
            raise ValueError(
                f"name = {format_value(self.name)}: is a policy; give policy = "
                f"{format_value(self.name)} instead"
            )
        if self.policy == "none":
            raise ValueError("policy = 'none': nobody flies by it; give the name of a planner")
        if self.policy is not None:
            for key in ("name", "replan_hz", "delay_s", "order"):
                if getattr(self, key):
                    raise ValueError(
                        f"{key} = {format_value(getattr(self, key))}: policy = "
                        f"{format_value(self.policy)} flies "
                        f"without plans; leave out {key}, or policy"
                    )
        return self

    @field_validator("presets")
    @classmethod
    def _require_presets(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        return _check_presets(names)

    @property
    def online(self) -> dict[str, object]:
        """Return the keys of replanning and of the order of robots that are set."""
        options = {key: getattr(self, key) for key in ("replan_hz", "delay_s", "order")}
        return {key: value for key, value in options.items() if value}

    @property
    def title(self) -> str:
        """Return the label, or the default one."""
        if self.label:
            return self.label
        name = (self.policy or self.name).rpartition(":")[2]
        parts = [
            name,
            f"{self.replan_hz:g} Hz" if self.replan_hz else "",
            f"{self.delay_s:g} s late" if self.delay_s else "",
            "order kept" if self.order == "kept" else "",
        ]
        return ", ".join(part for part in parts if part)


class SceneEntry(FileModel):
    """Worlds of one kind: those of the scenario with changed keys."""

    name: Label
    """Name in tables and figures, unique in the file."""
    set: Changes = Field(default_factory=dict)
    """Keys of the scenario that differ in the scene; tables are merged."""


class BenchmarkConfig(FileModel):
    """A whole benchmark file. Every planner receives every problem.

    The problems are those of each scene in each preset, for each team size, each seed, and each
    level of information.
    """

    renamed_keys: ClassVar[Mapping[str, str]] = {"knows": "information"}

    schema_version: SchemaVersion = 1
    """Version of the file format."""
    name: str = Field(pattern=r"^[A-Za-z0-9_-]+$", max_length=100)
    """Name of the benchmark; also of the results folder, unless `--out` names one."""
    description: str = ""
    """Free text for readers."""
    scenario: str
    """Scenario of all problems: a shipped one, or a file, relative to the folder of this file."""
    set: Changes = Field(default_factory=dict)
    """Keys of the scenario that differ in this benchmark; tables are merged. Keys that this file
    replaces by keys of its own, such as worlds or planner.name, are refused with the key to use."""
    presets: tuple[str, ...] = ()
    """Presets of worlds, each with its own horizon unless set.time.horizon_s is set; if left out,
    the scenario's, with its horizon."""
    scene: tuple[SceneEntry, ...] = ()
    """Kinds of worlds that differ in other keys; one, the scenario as it is, if left out."""
    teams: tuple[Annotated[int, Field(ge=1, le=1024)], ...] = ()
    """Team sizes [robots], divided among the entries of the scenario's fleet in proportion to their
    counts; the scenario's fleet if left out."""
    seeds: tuple[Annotated[int, Field(ge=0, lt=2**31)], ...] = ()
    """Seeds of the worlds; the scenario's if left out."""
    problems: int = Field(default=30, ge=1, le=100_000)
    """Number of worlds of each scene, preset, team size and seed."""
    information: tuple[InformationConfig, ...] = ()
    """Levels of information that planners receive, each a set of problems; the scenario's if left
    out."""
    deadline_s: float = Field(default=5.0, gt=0.0, le=86400.0)
    """Wall-clock time of a planner for each problem."""
    points: int | None = Field(default=None, ge=2, le=MAX_POINTS)
    """Max number of waypoints of a path; a longer path counts as no plan. The scenario's
    planner.points if left out."""
    close_after: int = Field(default=0, ge=0)
    """Number of problems without any plan, the first ones of a scene, team size and seed, after
    which a planner skips the others; 0: never."""
    examples: int = Field(default=1, ge=0, le=100)
    """Number of worlds of each scene and team size that are kept for figures, with plans and
    flights."""
    planner: tuple[PlannerEntry, ...] = Field(min_length=1, max_length=256)
    """Compared planners and policies, each with a label of its own; auto is refused."""

    @field_validator("presets")
    @classmethod
    def _require_presets(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        return _check_presets(names)

    @model_validator(mode="after")
    def _require_unique_names(self) -> Self:
        _require_unique("planner.label", [entry.title for entry in self.planner])
        _require_unique("scene.name", [entry.name for entry in self.scene])
        _require_unique("presets", self.presets)
        _require_unique("teams", self.teams)
        _require_unique("seeds", self.seeds)
        _require_unique("information", [str(entry) for entry in self.information])
        return self


def _check_presets(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of presets, and refuse others."""
    for name in names:
        presets.load_preset(name)
    return names


def _require_unique(key: str, values: Sequence[object]) -> None:
    duplicates = [value for i, value in enumerate(values) if value in values[:i]]
    if duplicates:
        raise ValueError(
            f"{key}: {format_value(duplicates[0])} is there twice; names tell them apart"
        )
