"""Flight of a team, and the protocol by which windows and statistics read flights."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pyarrow as pa

from angler_mjx.learning.datasets.stored import StoredArray


@dataclass(frozen=True, kw_only=True)
class Episode:
    """Flight until its last robot had ended."""

    about: Mapping[str, str | int | float | bool]
    """Row of the index."""
    time_s: np.ndarray
    """[t] time since the start."""
    arrays: Mapping[str, np.ndarray]
    """Arrays by their names in the run, [t, robot, ...] or [t, obstacle, ...]; units are in the
    manifest."""
    running: np.ndarray
    """bool [t, robot] whether the robot has not ended. After its end its last state is repeated."""
    plan_time_s: np.ndarray
    """[robot, point] times of the plan; the last one is repeated."""
    plan_m: np.ndarray
    """[robot, point, 3] points of the plan in W."""
    start_m: np.ndarray
    """[robot, 3] start in W."""
    goal_m: np.ndarray
    """[robot, 3] goal in W."""
    environment: Mapping[str, np.ndarray]
    """Rock, floor, obstacles and current by their names in the run."""
    outcomes: tuple[str, ...]
    """Outcome of each robot."""


class Episodes(Protocol):
    """Flights of a dataset, one per row of its index; members as in `Dataset`."""

    index: pa.Table
    fields: tuple[str, ...]

    def __len__(self) -> int:
        """Return the number of episodes."""

    @property
    def samples(self) -> np.ndarray:
        """Return the number of samples, int [episode]."""

    @property
    def robots(self) -> np.ndarray:
        """Return the number of robots, int [episode]."""

    @property
    def vehicles(self) -> tuple[str, ...]:
        """Return the labels of all vehicles."""

    def open_array(self, episode: int, name: str) -> StoredArray:
        """Return an array of the run that holds an episode."""

    def names(self, episode: int) -> list[str]:
        """Return the names of these arrays."""

    def values(self, episode: int, name: str, times: slice | None = None) -> np.ndarray:
        """Return the values of an array in one episode."""

    def goals_m(self, episode: int) -> np.ndarray:
        """Return the goals [robot, 3] in W."""

    def vehicle_labels(self, episode: int) -> list[str]:
        """Return the vehicle of each robot."""

    def thrusters(self, episode: int, label: str) -> int:
        """Return the number of thrusters of a vehicle."""

    def obstacles_exist(self, episode: int) -> np.ndarray:
        """Return whether obstacles exist, bool [obstacle]."""
