"""Dataset file: scenes, experts and splits."""

import math
from typing import Annotated, Self

from pydantic import Field, model_validator

from angler_mjx.files import FileModel
from angler_mjx.learning.datasets.sampling import SampleConfig
from angler_mjx.quantities import SchemaVersion
from angler_mjx.scenario.editing import Changes
from angler_mjx.studies.benchmark.config import PlannerEntry
from angler_mjx.studies.grid import find_reserved_key

RESERVED_KEYS = {
    "worlds": "--episodes",
    "seed": "seed",
    "policy": "[[expert]]",
    "execution": "[[expert]]",
}
"""Keys of a scenario that a dataset file replaces by keys of its own."""

type DatasetName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$", max_length=60)]


class DatasetScene(FileModel):
    """Worlds of one kind, with teams of some sizes."""

    name: DatasetName
    """Name of the scene, unique in the file; also a part of the names of run folders."""
    weight: float = Field(default=1.0, gt=0.0, le=1e6)
    """Weight of its episodes relative to the other scenes."""
    set: Changes = Field(default_factory=dict)
    """Keys of the scenario that differ in the scene; tables are merged."""
    teams: tuple[Annotated[int, Field(ge=1, le=1024)], ...] = ()
    """Team sizes [robots], each with the same fraction of the episodes; the scenario's fleet if
    left out."""
    shifted: bool = False
    """Whether the scene is for testing alone: all its episodes are of the split test_NAME."""

    @property
    def split(self) -> str | None:
        """Return the split of all its episodes; None where their environments decide."""
        return f"test_{self.name}" if self.shifted else None


class Expert(PlannerEntry):
    """Pilot of recorded flights: a planner, executed offline or online, or a policy."""

    weight: float = Field(default=1.0, gt=0.0, le=1e6)
    """Weight of its episodes relative to the other experts of a scene."""


class SplitConfig(FileModel):
    """Fractions of the environments by split, in scenes that are not shifted; their sum is 1."""

    train: float = Field(default=0.8, ge=0.0, le=1.0)
    """Fraction for training."""
    val: float = Field(default=0.1, ge=0.0, le=1.0)
    """Fraction for validation."""
    test: float = Field(default=0.1, ge=0.0, le=1.0)
    """Fraction for tests."""

    @model_validator(mode="after")
    def _check_sum(self) -> Self:
        total = self.train + self.val + self.test
        if not math.isclose(total, 1.0, abs_tol=1e-9):
            raise ValueError(f"train + val + test = {total:g}: must be 1")
        return self


class DatasetConfig(FileModel):
    """A whole dataset file. Each scene, team size and expert is a part of the episodes."""

    schema_version: SchemaVersion = 1
    """Version of the file format."""
    name: DatasetName
    """Name of the dataset, and of its folder unless that is named otherwise."""
    description: str = ""
    """Free text for readers; the head of the dataset card."""
    licence: Annotated[str, Field(min_length=1, max_length=200)] = "CC-BY-4.0"
    """Licence of the data, an SPDX identifier where one exists."""
    scenario: str
    """Scenario of all episodes: a shipped one, or a file, relative to the folder of this file."""
    seed: int = Field(default=0, ge=0, lt=2**31)
    """Seed of the dataset; each part has a seed of its own, derived from it."""
    set: Changes = Field(default_factory=dict)
    """Keys of the scenario that differ in this dataset; tables are merged. Keys that this file
    replaces by keys of its own, such as seed or policy, are refused with the key to use."""
    split: SplitConfig = SplitConfig()
    sample: SampleConfig = SampleConfig()
    scene: tuple[DatasetScene, ...] = Field(min_length=1, max_length=256)
    """Kinds of worlds, each with a name of its own."""
    expert: tuple[Expert, ...] = Field(min_length=1, max_length=64)
    """Pilots of the flights, each with a label of its own."""

    @model_validator(mode="after")
    def _check_unique_names(self) -> Self:
        for kind, names in (
            ("scene", [scene.name for scene in self.scene]),
            ("expert", [expert.title for expert in self.expert]),
        ):
            duplicate = next((name for name in names if names.count(name) > 1), None)
            if duplicate is not None:
                key = "label" if kind == "expert" else "name"
                raise ValueError(
                    f"{kind} {duplicate!r} is there twice; give each a {key} of its own"
                )
        return self

    @model_validator(mode="after")
    def _check_reserved_keys(self) -> Self:
        for location, table in (
            ("set", self.set),
            *((f"scene {scene.name!r}, set", scene.set) for scene in self.scene),
        ):
            if fault := find_reserved_key(table, RESERVED_KEYS):
                raise ValueError(f"{location}.{fault}")
        return self
