"""The manifest of a dataset: ``dataset.json``, which is written last and says what all else is.

A dataset is a folder: ``dataset.json``; ``index.parquet``, a row an episode; ``runs/PART``, run
folders; ``sha256sums.txt``, which ``sha256sum -c`` takes too; ``README.md`` and ``croissant.json``,
made of these.
"""

from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from angler_mjx.errors import ConfigError
from angler_mjx.files import FileModel, parse_model, read_json
from angler_mjx.learning.datasets.sampling import SampleConfig
from angler_mjx.runs.storage import folder

SCHEMA_VERSION = 1
MANIFEST, INDEX, SUMS = "dataset.json", "index.parquet", "sha256sums.txt"

SPLITS = ("train", "val", "test")
"""By environment; those of shifted scenes are ``test_NAME``."""


class PartEntry(FileModel):
    """A run folder of a dataset."""

    path: str
    """Below the dataset's folder, with slashes."""
    scene: str
    expert: str
    robots: int = Field(ge=1)
    worlds: int = Field(ge=1)
    seed: int = Field(ge=0)
    split: str | None
    """Of all its episodes; None where their environments decide."""
    digest: str
    """Of all that its problems are drawn from; see `Scenario.digest`."""
    tile: int = Field(ge=1)
    """Worlds in one device call: part of the bytes."""
    kernels: str | None

    @model_validator(mode="after")
    def _stays_inside(self) -> Self:
        require_inside(self.path)
        return self


class ArrayEntry(FileModel):
    """An array of the trajectories."""

    dims: tuple[str, ...]
    unit: str
    description: str
    dtype: str
    step: float | None
    """In its unit, where it is stored in steps; None where it is exact."""


class Manifest(FileModel):
    """``dataset.json``."""

    schema_version: Literal[1] = 1
    name: str
    description: str
    licence: str
    created: str
    """UTC, ISO 8601."""
    command: str
    episodes: int = Field(ge=1)
    splits: dict[str, int]
    """Episodes of each."""
    sample: SampleConfig = SampleConfig()
    """Shares that the chosen ones of train, val and test were to have."""
    chosen: dict[str, int] = Field(default_factory=dict)
    """Chosen episodes of each split."""
    split_shares: dict[str, float]
    """Of environments, in scenes that are not shifted."""
    parts: tuple[PartEntry, ...] = Field(min_length=1)
    conventions: dict[str, str]
    """Frames, units, quaternions, what is missing."""
    arrays: dict[str, ArrayEntry]
    """Of every part's trajectories, by their names."""
    time: dict[str, float]
    """Steps and rates, s and Hz; horizons stand in the parts' config.json."""
    seeds: dict[str, Any]
    """The dataset's own, and how keys are made of seeds."""
    parameter_sets: dict[str, str]
    """SHA-256 of every vehicle and thruster file, by name and set."""
    environment: dict[str, Any]
    """Versions, device, machine, commit."""
    sums: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    """SHA-256 of ``sha256sums.txt``, which holds that of every other file."""


def require_inside(path: str) -> None:
    """Refuse a path that leaves the dataset's folder.

    Raises:
        ValueError: it does.
    """
    pure = PurePosixPath(path)
    if pure.is_absolute() or ".." in pure.parts or not pure.parts or "\\" in path:
        raise ValueError(f"path {path!r} leaves the dataset's folder")


def read_manifest(root: Path) -> Manifest:
    """The manifest of a dataset.

    Raises:
        ConfigError: there is none, or it is damaged, or of a version that is not known here.
    """
    path = root / MANIFEST
    if not path.is_file():
        unfinished = root.parent / f".{root.name}.partial"
        hint = ""
        if unfinished.exists():
            hint = f"; it is being made, or was broken off, in {unfinished}: go on with --resume"
        raise ConfigError(f"{root}: not a dataset (no {MANIFEST} in it){hint}")
    table = read_json(path)
    version = table.get("schema_version") if isinstance(table, dict) else None
    if version != SCHEMA_VERSION:
        raise ConfigError(
            f"{path}: schema_version = {version!r}, and {SCHEMA_VERSION} is known here; read it "
            "with the version of angler-mjx that made it"
        )
    return parse_model(Manifest, table, source=str(path))


def write_manifest(root: Path, manifest: Manifest) -> None:
    """Write the manifest, whole or not at all.

    Raises:
        OSError: the disk gave out.
    """
    folder.write_json(root / MANIFEST, manifest.model_dump(mode="json"))
