"""A dataset that is read: which episodes, and each of them."""

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import zarr

from angler_mjx.errors import ConfigError, UnsupportedError, format_value
from angler_mjx.learning.datasets import index, manifest
from angler_mjx.learning.datasets.config import SplitConfig
from angler_mjx.learning.datasets.reading.episode import Episode
from angler_mjx.learning.datasets.reading.statistics import Statistics, compute_statistics
from angler_mjx.learning.datasets.reading.stored import StoredArray
from angler_mjx.learning.datasets.reading.windows import Windows
from angler_mjx.robot.vehicles import library
from angler_mjx.runs.storage import folder, trajectory_layout
from angler_mjx.runs.storage.read_errors import wrap_read_errors

FIELDS = ("p_m", "q", "nu", "target_m", "current_mps", "pwm_us", "obstacle_p_m")
"""Arrays that are read where none are named."""


class Dataset:
    """Episodes of a dataset, or of a run folder; may be sent to other processes."""

    def __init__(
        self,
        root: Path,
        table: pa.Table,
        parts: Sequence[Path],
        fields: Sequence[str],
    ) -> None:
        """See `open_dataset`."""
        self.root = root
        self.index = table
        """A row an episode; see `angler_mjx.learning.datasets.index`."""
        self.fields = tuple(fields)
        self.parts = tuple(parts)
        """Run folders, by the index's ``part``."""
        self._stored: dict[tuple[int, str], StoredArray] = {}
        self._names: dict[int, list[str]] = {}
        self._runs: dict[int, folder.Run] = {}
        self._thrusters: dict[tuple[int, str], int] = {}
        self._environment_cache: tuple[tuple[int, int], dict[str, np.ndarray]] = ((-1, -1), {})
        self._rows: dict[str, np.ndarray] = {
            name: table[name].to_numpy(zero_copy_only=False)
            for name in ("part", "world", "samples", "robots")
        }

    def __getstate__(self) -> dict[str, Any]:
        """What another process needs; it opens runs anew."""
        return {**self.__dict__, "_runs": {}, "_environment_cache": ((-1, -1), {})}

    def __len__(self) -> int:
        """Episodes."""
        return len(self.index)

    @property
    def samples(self) -> np.ndarray:
        """Int [episode] until the last robot had ended."""
        return self._rows["samples"]

    @property
    def robots(self) -> np.ndarray:
        """Int [episode] of the teams."""
        return self._rows["robots"]

    def open_array(self, episode: int, name: str) -> StoredArray:
        """An array of the run in which an episode lies.

        Raises:
            ConfigError: there is none of that name, or it is damaged.
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
        """Arrays [world, time, ...] of the run in which an episode lies."""
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
        """Values of one array: [time, robot, ...] or [time, obstacle, ...].

        Args:
            episode: its place in the index.
            name: of the array.
            times: of its samples; until its end if None.

        Raises:
            ConfigError: there is none of that name, or it is damaged.
        """
        whole = slice(0, int(self.samples[episode])) if times is None else times
        return self.open_array(episode, name).read(int(self._rows["world"][episode]), whole)

    def episode(self, episode: int) -> Episode:
        """A flight with all that is known of it.

        Raises:
            ConfigError: a file of it is damaged.
            IndexError: there is no such episode.
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
        """The run folder of a part."""
        run = self._runs.get(part)
        if run is None:
            run = self._runs[part] = folder.Run(self.parts[part])
        return run

    def _environment(self, part: int, world: int) -> dict[str, np.ndarray]:
        """Of a world; those of a tile are stored together, and the last ones are kept."""
        tile = max(self.run(part).scenario.tile or 1, 1)
        first = world - world % tile
        if self._environment_cache[0] != (part, first):
            run = self.run(part)
            group: Any = run.trajectories[trajectory_layout.ENVIRONMENT_GROUP]
            with wrap_read_errors(run.path):
                arrays = {
                    name: np.asarray(node[first : first + tile])
                    for name, node in group.members(max_depth=None)
                    if isinstance(node, zarr.Array) and node.ndim
                }
            self._environment_cache = (part, first), arrays
        return {name: values[world - first] for name, values in self._environment_cache[1].items()}

    def goals_m(self, episode: int) -> np.ndarray:
        """[robot, 3] in W."""
        part = int(self._rows["part"][episode])
        goals: np.ndarray = self._goals[part][int(self._rows["world"][episode])]
        return goals

    @cached_property
    def _goals(self) -> Mapping[int, np.ndarray]:
        goals = {}
        for part in sorted(set(self._rows["part"].tolist())):
            group: Any = self.run(part).trajectories
            with wrap_read_errors(self.parts[part]):
                goals[part] = np.asarray(group[f"{trajectory_layout.ENVIRONMENT_GROUP}/goal_m"][:])
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
        """Windows of a fixed length, of all episodes; see `Windows`."""
        return Windows(self, length, stride=stride, every=every, of=of, neighbours=neighbours)

    @cached_property
    def vehicles(self) -> tuple[str, ...]:
        """Labels of all vehicles that fly in it, sorted."""
        parts = set(self._rows["part"].tolist())
        return tuple(sorted({x for part in parts for x in self._part_labels(part)}))

    def vehicle_labels(self, episode: int) -> list[str]:
        """Return the vehicle of each robot [robot], by its label in ``episodes.parquet``."""
        return self._part_labels(int(self._rows["part"][episode]))

    def _part_labels(self, part: int) -> list[str]:
        """Vehicles of the robots of a part: the same in all of its worlds."""
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
            count = self._thrusters[part, label] = len(vehicle.thrusters.layout)
        return count

    def obstacles_exist(self, episode: int) -> np.ndarray:
        """Return which rows of obstacle arrays are obstacles of this episode, bool [obstacle]."""
        environment = self._environment(
            int(self._rows["part"][episode]), int(self._rows["world"][episode])
        )
        exist: np.ndarray = np.asarray(environment.get("obstacles/exists", ()), bool)
        return exist

    def statistics(self, max_episodes: int = 1000, *, vehicle: str | None = None) -> Statistics:
        """Return mean and standard deviation of each field's components, float32 [component].

        Counted are robots on their way, obstacles that exist and thrusters that a robot has. A
        thruster of one vehicle is another one of the next: in datasets of several `vehicles`, name
        one to normalise pulse widths.

        Args:
            max_episodes: number of episodes to read, evenly spread.
            vehicle: count robots of this vehicle alone; all if None.

        Raises:
            ConfigError: there is no such vehicle, or a file is damaged.
        """
        return compute_statistics(self, max_episodes, vehicle)

    def xarray(self, part: int = 0) -> Any:
        """Trajectories of a part as an `xarray.Dataset`, read when looked at.

        Raises:
            UnsupportedError: xarray is not installed.
        """
        try:
            import xarray
        except ImportError as error:
            raise UnsupportedError("xarray is not installed: pip install xarray") from error
        return xarray.open_zarr(self.parts[part] / folder.TRAJECTORIES, consolidated=False)


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
        root: its folder.
        split: train, val, test, test_NAME, or several; all if None.
        fields: arrays of episodes and windows, by their names in the runs.
        success: only episodes in which the whole team arrived, or only the others; all if None.
        chosen: only episodes that the dataset's ``[sample]`` chose, or only the others; all if
            None.

    Raises:
        ConfigError: there is no such dataset, split or array, or it is damaged.
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
        raise ConfigError(f"fields: {format_value(unknown[0])} is none of {', '.join(available)}")
    if split is not None:
        splits = [split] if isinstance(split, str) else list(split)
        existing = sorted(set(table["split"].to_pylist()))
        for name in splits:
            if name not in existing:
                raise ConfigError(
                    f"split: {format_value(name)} is none of {', '.join(existing)} of {root}"
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
