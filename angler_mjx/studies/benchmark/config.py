"""What a benchmark file says: planners, and the scenes whose problems all of them are asked."""

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
    """One of those that are compared: a planner, flown as it planned or online, or a policy."""

    renamed_keys: ClassVar[Mapping[str, str]] = {"knows": "information"}

    name: PlannerName = ""
    """One that `angler plan --list` names, or FILE.py:CLASS, from the folder of this file."""
    policy: PolicyName | None = None
    """Instead of a planner: a policy by its name in a scenario, such as mppi, or FILE.py:CLASS,
    which flies without plans."""
    label: Label | None = None
    """What tables and figures call it; its name, or its class, and how it is flown if left out."""
    settings: dict[str, Any] = Field(default_factory=dict)
    """Its own, as in the scenario's table [planner.NAME], [policy.NAME] or [policy.CLASS]."""
    information: InformationConfig | None = None
    """What it is told, whatever others are told: for planners that can make no use of more."""
    replan_hz: float = 0.0
    """As in the scenario's table [planner]: plans are made anew so often in flight."""
    delay_s: float = 0.0
    """As in the scenario's table [planner]."""
    order: Literal["free", "kept"] | None = None
    """As in the scenario's table [execution]; the scenario's if left out."""
    presets: tuple[str, ...] = ()
    """Of the file's presets those whose problems it is asked; all if left out."""
    teams: tuple[Annotated[int, Field(ge=1, le=1024)], ...] = ()
    """Sizes of teams that it is asked; all if left out."""

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
        """How its plans are looked after while they are flown; empty if they are not."""
        options = {key: getattr(self, key) for key in ("replan_hz", "delay_s", "order")}
        return {key: value for key, value in options.items() if value}

    @property
    def title(self) -> str:
        """Its label."""
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
    """What the world is like in some of the problems."""

    name: Label
    set: Changes = Field(default_factory=dict)
    """Keys of the scenario that are otherwise here; tables are merged."""


class BenchmarkConfig(FileModel):
    """A whole benchmark file. Every planner is asked every problem.

    The problems are those of each scene in each preset, for each size of team, each seed, and each
    thing that may be known.
    """

    renamed_keys: ClassVar[Mapping[str, str]] = {"knows": "information"}

    schema_version: SchemaVersion = 1
    """Of this form of files."""
    name: str = Field(pattern=r"^[A-Za-z0-9_-]+$", max_length=100)
    """Of the results folder, if it is given none."""
    description: str = ""
    """For people."""
    scenario: str
    """That all problems are made of: a shipped one, or a file, from the folder of this one."""
    set: Changes = Field(default_factory=dict)
    """Keys of the scenario that are otherwise in this benchmark; tables are merged."""
    presets: tuple[str, ...] = ()
    """Of worlds, each with its own horizon unless set.time.horizon_s is given; the scenario's, with
    its horizon, if left out."""
    scene: tuple[SceneEntry, ...] = ()
    """What else the worlds differ in; nothing if left out."""
    teams: tuple[Annotated[int, Field(ge=1, le=1024)], ...] = ()
    """Numbers of robots, taken from the entries of the scenario's fleet in proportion to their
    counts; the scenario's fleet if left out."""
    seeds: tuple[Annotated[int, Field(ge=0, lt=2**31)], ...] = ()
    """Of the worlds; the scenario's if left out."""
    problems: int = Field(default=30, ge=1, le=100_000)
    """Worlds of each scene, team and seed."""
    information: tuple[InformationConfig, ...] = ()
    """What the planners may know; the scenario's if left out."""
    deadline_s: float = Field(default=5.0, gt=0.0, le=86400.0)
    """Wall-clock time for each problem."""
    points: int | None = Field(default=None, ge=2, le=MAX_POINTS)
    """Most way-points of a path; the scenario's if left out."""
    close_after: int = Field(default=0, ge=0)
    """A planner whose first so many problems of a scene, team and seed all ended without any plan
    is not asked the others; 0 asks all."""
    examples: int = Field(default=1, ge=0, le=100)
    """Problems of each scene and team that are kept to be drawn, with plans and flights."""
    planner: tuple[PlannerEntry, ...] = Field(min_length=1, max_length=256)

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
    """Names that are of presets."""
    for name in names:
        presets.load_preset(name)
    return names


def _require_unique(key: str, values: Sequence[object]) -> None:
    duplicates = [value for i, value in enumerate(values) if value in values[:i]]
    if duplicates:
        raise ValueError(
            f"{key}: {format_value(duplicates[0])} is there twice; names tell them apart"
        )
