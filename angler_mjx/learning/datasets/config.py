"""What a dataset file says: what is flown, by whom, and who learns from what."""

import math
from typing import Annotated, Self

from pydantic import Field, model_validator

from angler_mjx.files import FileModel
from angler_mjx.learning.datasets.sampling import SampleConfig
from angler_mjx.quantities import SchemaVersion
from angler_mjx.scenario.editing import Changes
from angler_mjx.studies.benchmark.config import PlannerEntry

RESERVED_KEYS = ("worlds", "seed", "policy", "execution")
"""Keys of a scenario that a dataset file says by keys of its own."""

type DatasetName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$", max_length=60)]


class DatasetScene(FileModel):
    """Worlds of one kind, with teams of some sizes."""

    name: DatasetName
    weight: float = Field(default=1.0, gt=0.0, le=1e6)
    """Its share of the episodes, beside the weights of the other scenes."""
    set: Changes = Field(default_factory=dict)
    """Keys of the scenario that are otherwise here; tables are merged."""
    teams: tuple[Annotated[int, Field(ge=1, le=1024)], ...] = ()
    """Numbers of robots, in equal shares; the scenario's fleet if left out."""
    shifted: bool = False
    """Whether nobody is to learn from it: all its episodes are a test by its name."""

    @property
    def split(self) -> str | None:
        """Of all its episodes; None where their environments decide."""
        return f"test_{self.name}" if self.shifted else None


class Expert(PlannerEntry):
    """One whose flights are recorded: a planner, flown as it planned or online, or a policy."""

    weight: float = Field(default=1.0, gt=0.0, le=1e6)
    """Its share of the episodes of a scene, beside the weights of the others there."""


class SplitConfig(FileModel):
    """Shares of the environments, of scenes that are not shifted."""

    train: float = Field(default=0.8, ge=0.0, le=1.0)
    val: float = Field(default=0.1, ge=0.0, le=1.0)
    test: float = Field(default=0.1, ge=0.0, le=1.0)

    @model_validator(mode="after")
    def _check_sum(self) -> Self:
        total = self.train + self.val + self.test
        if not math.isclose(total, 1.0, abs_tol=1e-9):
            raise ValueError(f"train + val + test = {total:g}: must be 1")
        return self


class DatasetConfig(FileModel):
    """A whole dataset file."""

    schema_version: SchemaVersion = 1
    """Of this form of files."""
    name: DatasetName
    """Of the dataset, and of its folder if it is given none."""
    description: str = ""
    """For people."""
    licence: Annotated[str, Field(min_length=1, max_length=200)] = "CC-BY-4.0"
    """Of the data, an SPDX identifier where there is one."""
    scenario: str
    """That all episodes are made of: a shipped one, or a file, from the folder of this one."""
    seed: int = Field(default=0, ge=0, lt=2**31)
    """Of the dataset; each part has one of its own, made of it."""
    set: Changes = Field(default_factory=dict)
    """Keys of the scenario that are otherwise in this dataset; tables are merged."""
    split: SplitConfig = SplitConfig()
    sample: SampleConfig = SampleConfig()
    """What is chosen of what was flown."""
    scene: tuple[DatasetScene, ...] = Field(min_length=1, max_length=256)
    expert: tuple[Expert, ...] = Field(min_length=1, max_length=64)

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
            reserved = next((key for key in RESERVED_KEYS if key in table), None)
            if reserved is not None:
                instead = {"worlds": "--episodes", "seed": "seed"}.get(reserved, "[[expert]]")
                raise ValueError(f"{location}.{reserved}: give {instead} instead")
        return self
