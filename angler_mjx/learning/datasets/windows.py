"""Windows of episodes: arrays of one shape for any team, with masks."""

from collections.abc import Iterator

import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.learning.datasets.episode import Episodes
from angler_mjx.runs.storage import trajectory_layout

type Window = dict[str, np.ndarray]


class Windows:
    """Windows of a fixed length, in order of episodes; a sequence.

    Each window is a dict: the fields, [length, robot, ...] or [length, obstacle, ...]; ``goal_m``
    [robot, 3]; ``mask`` bool [length, robot], whether the robot exists and has not ended;
    ``obstacle_mask`` bool [obstacle], whether the obstacle exists; ``episode`` and ``first``, its
    position in the dataset. Rows of missing robots are zero. In windows of single robots the first
    row is that robot, followed by its nearest neighbours at the window's beginning.
    """

    def __init__(
        self,
        dataset: Episodes,
        length: int,
        *,
        stride: int = 1,
        every: int = 1,
        of: str = "team",
        neighbours: int = 0,
    ) -> None:
        """Count the windows.

        Args:
            dataset: dataset with the episodes.
            length: samples in a window.
            stride: samples from the beginning of one window to that of the next.
            every: samples from one sample of a window to the next.
            of: "team", or "robot": a window for each robot by itself.
            neighbours: other robots in windows of single robots.

        Raises:
            ConfigError: a number is out of range, or all episodes are shorter than a window.
        """
        limits = {"length": (length, 1), "stride": (stride, 1), "every": (every, 1)}
        for name, (value, minimum) in {**limits, "neighbours": (neighbours, 0)}.items():
            if value < minimum:
                raise ConfigError(f"{name} = {value}: must be {minimum} or more")
        if of not in ("team", "robot"):
            raise ConfigError(f'of = "{of}": must be "team" or "robot"')
        if neighbours and of == "team":
            raise ConfigError('neighbours: are of windows of single robots; give of = "robot"')
        self.dataset, self.length, self.stride, self.every = dataset, length, stride, every
        self.of, self.neighbours = of, neighbours
        self.span = (length - 1) * every + 1
        samples, robots = dataset.samples.astype(np.int64), dataset.robots.astype(np.int64)
        if samples.max() < self.span:
            raise ConfigError(
                f"length = {length}, every = {every}: the longest episode has {samples.max()} "
                f"samples, a window takes {self.span}"
            )
        starts = np.maximum((samples - self.span) // stride + 1, 0)
        self._windows_per_start = robots if of == "robot" else np.ones_like(robots)
        self._ends = np.cumsum(starts * self._windows_per_start)
        self.rows = neighbours + 1 if of == "robot" else int(robots.max())
        self._obstacles = self._max_obstacles()

    def _max_obstacles(self) -> int:
        """Return the largest number of obstacles of all parts."""
        if not any(name.startswith("obstacle") for name in self.dataset.fields):
            return 0
        first = np.unique(self.dataset.index["part"].to_numpy(), return_index=True)[1]
        max_count = 0
        for episode in first.tolist():
            if "obstacle_p_m" in self.dataset.names(episode):
                max_count = max(
                    max_count, self.dataset.open_array(episode, "obstacle_p_m").shape[2]
                )
        return max_count

    def __len__(self) -> int:
        """Return the number of windows."""
        return int(self._ends[-1])

    @property
    def ends(self) -> np.ndarray:
        """Return the cumulative number of windows to the end of each episode, int [episode]."""
        return self._ends

    def __getitem__(self, number: int) -> Window:
        """Return a window.

        Raises:
            ConfigError: a file is damaged.
            IndexError: the window does not exist.
        """
        if not 0 <= number < len(self):
            raise IndexError(f"window {number} of {len(self)}")
        episode = int(np.searchsorted(self._ends, number, side="right"))
        before = int(self._ends[episode - 1]) if episode else 0
        at, robot = divmod(int(number) - before, int(self._windows_per_start[episode]))
        first = at * self.stride
        times = slice(first, first + self.span, self.every)
        data = self.dataset
        team = int(data.robots[episode])
        outcome = data.values(episode, "outcome", times)
        chosen = self._select_robots(episode, team, robot, times)
        window: Window = {}
        for name in data.fields:
            dims = trajectory_layout.ARRAYS[name].dims
            if "obstacle" in dims and not self._obstacles:
                continue
            values = self._read_values(episode, name, times, dims)
            if "robot" in dims:
                window[name] = self._pad_rows(values[:, chosen], self.rows)
            else:
                window[name] = self._pad_rows(values, self._obstacles)
        mask = np.zeros((self.length, self.rows), bool)
        mask[:, : len(chosen)] = outcome[:, chosen] == 0
        goals = np.zeros((self.rows, 3), np.float32)
        goals[: len(chosen)] = data.goals_m(episode)[chosen]
        window |= {"mask": mask, "goal_m": goals}
        if self._obstacles:
            exist = data.obstacles_exist(episode)
            window["obstacle_mask"] = np.zeros(self._obstacles, bool)
            window["obstacle_mask"][: len(exist)] = exist
        window["episode"] = np.int64(episode)  # type: ignore[assignment]
        window["first"] = np.int64(first)  # type: ignore[assignment]
        return window

    def _read_values(
        self, episode: int, name: str, times: slice, dims: tuple[str, ...]
    ) -> np.ndarray:
        """Return the values of one array; zero rows where a part has no obstacles."""
        if "obstacle" in dims and name not in self.dataset.names(episode):
            tail = (3,) if name.endswith("_p_m") else (4,)
            return np.zeros((self.length, 0, *tail), np.float32)
        return self.dataset.values(episode, name, times)

    def _select_robots(self, episode: int, team: int, robot: int, times: slice) -> np.ndarray:
        """Return the robots of a window, in the order of its rows."""
        if self.of == "team":
            return np.arange(team)
        if not self.neighbours:
            return np.array([robot])
        positions_m = self.dataset.values(episode, "p_m", slice(times.start, times.start + 1))[0]
        distances_m = np.linalg.norm(positions_m - positions_m[robot], axis=-1)
        distances_m[robot] = -1.0
        nearest: np.ndarray = np.argsort(distances_m, kind="stable")[: self.neighbours + 1]
        return nearest

    def _pad_rows(self, values: np.ndarray, rows: int) -> np.ndarray:
        """Pad to [length, rows, ...] with zeros for missing rows and missing values."""
        padded = np.zeros((self.length, rows, *values.shape[2:]), np.float32)
        np.copyto(padded[:, : values.shape[1]], values, where=np.isfinite(values))
        return padded

    def __iter__(self) -> Iterator[Window]:
        """Iterate over the windows in order."""
        return (self[i] for i in range(len(self)))
