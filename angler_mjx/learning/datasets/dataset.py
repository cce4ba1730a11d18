"""Dataset for reading: a choice of episodes, and the data of each."""

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from angler_mjx.errors import ConfigError, UnsupportedError, format_value
from angler_mjx.learning.datasets import index, manifest
from angler_mjx.learning.datasets.config import SplitConfig
from angler_mjx.learning.datasets.episode import Episode
from angler_mjx.learning.datasets.statistics import Statistics, compute_statistics
from angler_mjx.learning.datasets.stored import StoredArray
from angler_mjx.learning.datasets.windows import Windows
from angler_mjx.robot.vehicles import library
from angler_mjx.runs.storage import environments, folder, trajectory_layout
from angler_mjx.runs.storage.read_errors import wrap_read_errors
from angler_mjx.runs.stored_arrays import stored_array, stored_group

if TYPE_CHECKING:
    from xarray import Dataset as XarrayDataset

FIELDS = ("p_m", "q", "nu", "target_m", "current_mps", "pwm_us", "obstacle_p_m")
"""Arrays that are read by default."""


class Dataset:
    """Episodes of a dataset, or of a run folder; may be sent to other processes."""

    def __init__(
        self,
        root: Path,
        table: pa.Table,
        parts: Sequence[Path],
        fields: Sequence[str],
    ) -> None:
        """Set the episodes; see `open_dataset`."""
        self.root = root
        self.index = table
        """Table with a row per episode; see `angler_mjx.learning.datasets.index`."""
        self.fields = tuple(fields)
        self.parts = tuple(parts)
        """Run folders, by the index's ``part``."""
        self._stored: dict[tuple[int, str], StoredArray] = {}
        self._names: dict[int, list[str]] = {}
        self._runs: dict[int, folder.Run] = {}
        self._thrusters: dict[tuple[int, str], int] = {}
        self._obstacles_exist: dict[int, np.ndarray] = {}
        self._environment_cache: tuple[tuple[int, int], dict[str, np.ndarray]] = ((-1, -1), {})
        self._rows: dict[str, np.ndarray] = {
            name: table[name].to_numpy(zero_copy_only=False)
            for name in ("part", "world", "samples", "robots")
        }

    def __getstate__(self) -> dict[str, object]:
        """Return the state for another process; it opens runs anew."""
        return {**self.__dict__, "_runs": {}, "_environment_cache": ((-1, -1), {})}

    def __len__(self) -> int:
        """Return the number of episodes."""
        return len(self.index)

    @property
    def samples(self) -> np.ndarray:
        """Return int [episode] samples until the last robot had ended."""
        return self._rows["samples"]

    @property
    def robots(self) -> np.ndarray:
        """Return int [episode] sizes of the teams."""
        return self._rows["robots"]

    def open_array(self, episode: int, name: str) -> StoredArray:
        """Return an array of the run that holds an episode.

        Raises:
            ConfigError: the array does not exist, or is damaged.
        """
        part = int(self._rows["part"][episode])
        array = self._stored.get((part, name))
        if array is None:
            path = self.parts[part] / folder.TRAJECTORIES / name
            if not (path / "zarr.json").is_file():
                raise ConfigError(
                    f"{path}: is not there; arrays of a run are {', '.join(self.names(episode))}"
                )
            array = self._stored[part, name] = StoredArray(path)
        return array

    def names(self, episode: int) -> list[str]:
        """Return the names of arrays [world, time, ...] of the run that holds an episode."""
        part = int(self._rows["part"][episode])
        names = self._names.get(part)
        if names is None:
            trajectories = self.parts[part] / folder.TRAJECTORIES
            timed = (
                name
                for name, kind in trajectory_layout.ARRAYS.items()
                if kind.dims[:1] == ("time",)
            )
            names = [name for name in timed if (trajectories / name / "zarr.json").is_file()]
            self._names[part] = names
        return names

    def values(self, episode: int, name: str, times: slice | None = None) -> np.ndarray:
        """Return the values of one array: [time, robot, ...] or [time, obstacle, ...].

        Args:
            episode: row of the index.
            name: name of the array.
            times: samples to read; until the episode's end if None.

        Raises:
            ConfigError: the array does not exist, or is damaged.
        """
        whole = slice(0, int(self.samples[episode])) if times is None else times
        return self.open_array(episode, name).read(int(self._rows["world"][episode]), whole)

    def episode(self, episode: int) -> Episode:
        """Return a flight with all its data.

        Raises:
            ConfigError: a file of it is damaged.
            IndexError: the episode does not exist.
        """
        if not 0 <= episode < len(self):
            raise IndexError(f"episode {episode} of {len(self)}")
        about = self.index.slice(episode, 1).to_pylist()[0]
        part, world = about["part"], about["world"]
        run, robots = self.run(part), about["robots"]
        environment = self._environment(part, world)
        plan = {
            name: self.open_array(episode, name).read(world) for name in ("plan_time_s", "plan_m")
        }
        rows = run.episodes.slice(world * robots, robots)
        present = self.names(episode)
        return Episode(
            about=about,
            time_s=np.arange(about["samples"]) / run.scenario.time.record_hz,
            arrays={n: self.values(episode, n) for n in self.fields if n in present},
            running=self.values(episode, "outcome") == 0,
            start_m=environment["start_m"],
            goal_m=environment["goal_m"],
            environment=environment,
            outcomes=tuple(rows["outcome"].to_pylist()),
            **plan,
        )

    def run(self, part: int) -> folder.Run:
        """Return the run folder of a part."""
        run = self._runs.get(part)
        if run is None:
            run = self._runs[part] = folder.Run(self.parts[part])
        return run

    def _environment(self, part: int, world: int) -> dict[str, np.ndarray]:
        """Return environment of a world.

        Those of a tile are stored together, the last are cached.
        """
        tile = max(self.run(part).scenario.tile or 1, 1)
        first = world - world % tile
        if self._environment_cache[0] != (part, first):
            run = self.run(part)
            group = stored_group(run.trajectories, trajectory_layout.ENVIRONMENT_GROUP)
            with wrap_read_errors(run.path):
                arrays = {
                    name: np.asarray(array[first : first + tile])
                    for name, array in environments.list_arrays(group).items()
                    if array.ndim
                }
            self._environment_cache = (part, first), arrays
        return {name: values[world - first] for name, values in self._environment_cache[1].items()}

    def goals_m(self, episode: int) -> np.ndarray:
        """Return goals [robot, 3] in W."""
        part = int(self._rows["part"][episode])
        goals: np.ndarray = self._goals[part][int(self._rows["world"][episode])]
        return goals

    @cached_property
    def _goals(self) -> Mapping[int, np.ndarray]:
        goals = {}
        for part in sorted(set(self._rows["part"].tolist())):
            group = self.run(part).trajectories
            with wrap_read_errors(self.parts[part]):
                goal_m = stored_array(group, f"{trajectory_layout.ENVIRONMENT_GROUP}/goal_m")
                goals[part] = np.asarray(goal_m[:])
        return goals

    def windows(
        self,
        length: int,
        *,
        stride: int = 1,
        every: int = 1,
        of: str = "team",
        neighbours: int = 0,
    ) -> Windows:
        """Return windows of a fixed length, of all episodes; see `Windows`."""
        return Windows(self, length, stride=stride, every=every, of=of, neighbours=neighbours)

    @cached_property
    def vehicles(self) -> tuple[str, ...]:
        """Return the labels of all vehicles of the dataset, sorted."""
        parts = set(self._rows["part"].tolist())
        return tuple(sorted({x for part in parts for x in self._part_labels(part)}))

    def vehicle_labels(self, episode: int) -> list[str]:
        """Return the vehicle of each robot [robot], by its label in ``episodes.parquet``."""
        return self._part_labels(int(self._rows["part"][episode]))

    def _part_labels(self, part: int) -> list[str]:
        """Return the vehicles of the robots of a part: the same in all of its worlds."""
        robots = len(self.run(part).scenario.members())
        labels: list[str] = self.run(part).episodes["vehicle"].slice(0, robots).to_pylist()
        return labels

    def thrusters(self, episode: int, label: str) -> int:
        """Return the number of thrusters of a vehicle, from the copy of its file in the run.

        Raises:
            ConfigError: the copy is damaged.
        """
        part = int(self._rows["part"][episode])
        count = self._thrusters.get((part, label))
        if count is None:
            vehicle = library.load_vehicle(self.run(part).vehicle_file(label))
            count = self._thrusters[part, label] = len(vehicle.actuator_names)
        return count

    def obstacles_exist(self, episode: int) -> np.ndarray:
        """Return which rows of obstacle arrays are obstacles of this episode, bool [obstacle]."""
        part, world = int(self._rows["part"][episode]), int(self._rows["world"][episode])
        stored = self._obstacles_exist.get(part)
        if stored is None:
            stored = self._obstacles_exist[part] = self._read_obstacles_exist(part)
        exist: np.ndarray = stored[world]
        return exist

    def _read_obstacles_exist(self, part: int) -> np.ndarray:
        """Read which rows of obstacle arrays are obstacles, bool [world, obstacle]."""
        run = self.run(part)
        group = stored_group(run.trajectories, trajectory_layout.ENVIRONMENT_GROUP)
        if "obstacles/exists" not in group:
            return np.zeros((run.scenario.worlds, 0), bool)
        with wrap_read_errors(run.path):
            return np.asarray(stored_array(group, "obstacles/exists")[:], bool)

    def statistics(self, max_episodes: int = 1000, *, vehicle: str | None = None) -> Statistics:
        """Return mean and standard deviation of each field's components, float32 [component].

        Robots before their end, existing obstacles and existing thrusters count. A thruster of one
        vehicle is another one of the next: in datasets of several `vehicles`, name one to normalise
        pulse widths.

        Args:
            max_episodes: number of episodes to read, evenly spread.
            vehicle: count robots of this vehicle alone; all if None.

        Raises:
            ConfigError: the vehicle does not exist, or a file is damaged.
        """
        return compute_statistics(self, max_episodes, vehicle)

    def xarray(self, part: int = 0) -> "XarrayDataset":
        """Return trajectories of a part as an `xarray.Dataset`, read on access.

        Raises:
            UnsupportedError: xarray is not installed.
        """
        try:
            import xarray
        except ImportError as error:
            raise UnsupportedError("xarray is not installed: pip install xarray") from error
        path = self.parts[part] / folder.TRAJECTORIES
        opened: XarrayDataset = xarray.open_zarr(path, consolidated=False)
        return opened


def open_dataset(
    root: Path | str,
    *,
    split: str | Sequence[str] | None = None,
    fields: Sequence[str] = FIELDS,
    success: bool | None = None,
    chosen: bool | None = True,
) -> Dataset:
    """Open a dataset, or a run folder as one.

    Args:
        root: folder of the dataset or run.
        split: train, val, test, test_NAME, or several; all if None.
        fields: arrays of episodes and windows, by their names in the runs.
        success: only episodes in which the whole team arrived, or only the others; all if None.
        chosen: only episodes that the dataset's ``[sample]`` chose, or only the others; all if
            None.

    Raises:
        ConfigError: the dataset, split or array does not exist, or is damaged.
    """
    root = Path(root)
    if not (root / manifest.MANIFEST).is_file() and (root / folder.SUMMARY).is_file():
        entry = {"scene": "run", "expert": folder.Run(root).scenario.planner.name, "split": None}
        split_config = SplitConfig(train=1.0, val=0.0, test=0.0)
        table, parts = index.build_rows(root, 0, entry, split_config, 0), [root]
    else:
        dataset_manifest = manifest.read_manifest(root)
        table, parts = index.read_index(root), [root / part.path for part in dataset_manifest.parts]
    unknown = [name for name in fields if name not in trajectory_layout.ARRAYS]
    if unknown:
        available = [
            name for name, kind in trajectory_layout.ARRAYS.items() if kind.dims[:1] == ("time",)
        ]
        raise ConfigError(f"fields: {format_value(unknown[0])} is not among {', '.join(available)}")
    if split is not None:
        splits = [split] if isinstance(split, str) else list(split)
        existing = sorted(set(table["split"].to_pylist()))
        for name in splits:
            if name not in existing:
                raise ConfigError(
                    f"split: {format_value(name)} is not among {', '.join(existing)} of {root}"
                )
        table = table.filter(pc.is_in(table["split"], pa.array(splits)))
    if success is not None:
        table = table.filter(pc.equal(table["success"], success))
    if chosen is not None:
        before = len(table)
        table = table.filter(pc.equal(table["chosen"], chosen))
        if before and not len(table):
            raise ConfigError(
                f"{root}: none of these {before} episodes is{' not' * (not chosen)} chosen; give "
                "chosen=None to read them all"
            )
    if not len(table):
        raise ConfigError(f"{root}: no episode is left of that split and success")
    return Dataset(root, table, parts, fields)
