"""Manifest of a dataset: ``dataset.json``, written last, which describes all other files.

A dataset is a folder: ``dataset.json``; ``index.parquet``, a row per episode; ``runs/PART``, run
folders; ``sha256sums.txt``, which ``sha256sum -c`` reads; ``README.md`` and ``croissant.json``,
made of these.
"""

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from angler_mjx.errors import ConfigError
from angler_mjx.files import FileModel, parse_model, read_json
from angler_mjx.learning.datasets.sampling import SampleConfig
from angler_mjx.runs.storage.atomic_files import write_json
from angler_mjx.runs.storage.checksums import is_inside

SCHEMA_VERSION = 1
MANIFEST, INDEX, SUMS = "dataset.json", "index.parquet", "sha256sums.txt"

SPLITS = ("train", "val", "test")
"""Splits by environment; those of shifted scenes are ``test_NAME``."""


class PartEntry(FileModel):
    """Run folder of a dataset."""

    path: str
    """Path below the dataset's folder, with slashes."""
    scene: str
    expert: str
    robots: int = Field(ge=1)
    worlds: int = Field(ge=1)
    seed: int = Field(ge=0)
    split: str | None
    """Split of all its episodes; None where their environments decide."""
    digest: str
    """Digest of all inputs of its problems; see `Scenario.digest`."""
    tile: int = Field(ge=1)
    """Worlds in one device call; the bytes depend on it."""
    kernels: str | None

    @model_validator(mode="after")
    def _stays_inside(self) -> Self:
        require_inside(self.path)
        return self


class ArrayEntry(FileModel):
    """Array of the trajectories."""

    dims: tuple[str, ...]
    unit: str
    description: str
    dtype: str
    step: float | None
    """Step in its unit, where it is stored in steps; None where it is exact."""


class Manifest(FileModel):
    """Contents of ``dataset.json``."""

    schema_version: Literal[1] = 1
    name: str
    description: str
    licence: str
    created: str
    """UTC, ISO 8601."""
    command: str
    episodes: int = Field(ge=1)
    splits: dict[str, int]
    """Number of episodes of each split."""
    sample: SampleConfig = SampleConfig()
    """Requested fractions of the chosen episodes of train, val and test."""
    chosen: dict[str, int] = Field(default_factory=dict)
    """Number of chosen episodes of each split."""
    split_shares: dict[str, float]
    """Fractions of environments, in scenes that are not shifted."""
    parts: tuple[PartEntry, ...] = Field(min_length=1)
    conventions: dict[str, str]
    """Frames, units, quaternions, missing values."""
    arrays: dict[str, ArrayEntry]
    """Arrays of every part's trajectories, by their names."""
    time: dict[str, float]
    """Steps and rates, s and Hz; horizons are in the parts' config.json."""
    seeds: dict[str, Any]
    """Seed of the dataset, and the derivation of keys from seeds."""
    parameter_sets: dict[str, str]
    """SHA-256 of every vehicle and thruster file, by name and set."""
    environment: dict[str, Any]
    """Versions, device, machine, commit."""
    sums: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    """SHA-256 of ``sha256sums.txt``, which holds that of every other file."""


def require_inside(path: str) -> None:
    """Refuse a path that leaves the dataset's folder.

    Raises:
        ValueError: the path leaves the folder.
    """
    if not is_inside(path) or "\\" in path:
        raise ValueError(f"path {path!r} leaves the dataset's folder")


def read_manifest(root: Path) -> Manifest:
    """Read the manifest of a dataset.

    Raises:
        ConfigError: the file is missing, damaged, or of an unknown version.
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
    """Write the manifest, complete or not at all.

    Raises:
        OSError: writing failed.
    """
    write_json(root / MANIFEST, manifest.model_dump(mode="json"))
