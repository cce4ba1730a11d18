"""One flight of a team, and what windows and statistics read of a dataset's flights."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import pyarrow as pa

from angler_mjx.learning.datasets.reading.stored import StoredArray


@dataclass(frozen=True, kw_only=True)
class Episode:
    """A flight: until its last robot had ended."""

    about: Mapping[str, Any]
    """Its row of the index."""
    time_s: np.ndarray
    """[t]."""
    arrays: Mapping[str, np.ndarray]
    """By their names in the run, [t, robot, ...] or [t, obstacle, ...]; the manifest says units."""
    running: np.ndarray
    """bool [t, robot]: whether a robot was still on its way. What comes after its end repeats its
    last state."""
    plan_time_s: np.ndarray
    """[robot, point]; the last one is repeated."""
    plan_m: np.ndarray
    """[robot, point, 3] in W."""
    start_m: np.ndarray
    """[robot, 3] in W."""
    goal_m: np.ndarray
    """[robot, 3] in W."""
    environment: Mapping[str, np.ndarray]
    """Rock, floor, obstacles and current by their names in the run."""
    outcomes: tuple[str, ...]
    """How each robot ended."""


class Episodes(Protocol):
    """Flights of a dataset, one a row of its index; `Dataset` says what each member gives."""

    index: pa.Table
    fields: tuple[str, ...]

    def __len__(self) -> int:
        """Return the number of episodes."""

    @property
    def samples(self) -> np.ndarray:
        """Int [episode]."""

    @property
    def robots(self) -> np.ndarray:
        """Int [episode]."""

    @property
    def vehicles(self) -> tuple[str, ...]:
        """Labels of all vehicles."""

    def open_array(self, episode: int, name: str) -> StoredArray:
        """Return an array of the run that holds an episode."""

    def names(self, episode: int) -> list[str]:
        """Return the names of these arrays."""

    def values(self, episode: int, name: str, times: slice | None = None) -> np.ndarray:
        """Return the values of an array in one episode."""

    def goals_m(self, episode: int) -> np.ndarray:
        """Return [robot, 3] in W."""

    def vehicle_labels(self, episode: int) -> list[str]:
        """Return the vehicle of each robot."""

    def thrusters(self, episode: int, label: str) -> int:
        """Return the number of thrusters of a vehicle."""

    def obstacles_exist(self, episode: int) -> np.ndarray:
        """Return bool [obstacle]."""
