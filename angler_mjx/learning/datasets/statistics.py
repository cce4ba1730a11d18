"""Mean and standard deviation of a dataset's fields, without padding."""

import numpy as np

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.learning.datasets.episode import Episodes
from angler_mjx.runs.storage import trajectory_layout

type Statistics = dict[str, tuple[np.ndarray, np.ndarray]]
"""Mean and standard deviation, float32 [component] each, by the names of fields."""


class _Moments:
    """Sums of the components of one field."""

    def __init__(self) -> None:
        self.count = self._first = self._second = np.zeros(0)

    def add(self, values: np.ndarray, mask: np.ndarray) -> None:
        """Add values [..., component] where the mask, bool of the same shape, is true.

        Vehicles of other parts may have more thrusters than those so far.
        """
        axes = tuple(range(values.ndim - 1))
        width = max(values.shape[-1], self.count.size)
        missing = [(0, 0)] * len(axes) + [(0, width - values.shape[-1])]
        values, mask = np.pad(np.where(mask, values, 0.0), missing), np.pad(mask, missing)
        for sums in ("count", "_first", "_second"):
            before = getattr(self, sums)
            setattr(self, sums, np.pad(before, (0, width - before.size)))
        self.count += mask.sum(axis=axes)
        self._first += values.sum(axis=axes)
        self._second += (values**2).sum(axis=axes)

    def result(self) -> tuple[np.ndarray, np.ndarray]:
        """Return mean and standard deviation; NaN without values."""
        count = np.where(self.count > 0.0, self.count, np.nan)
        mean = self._first / count
        spread = np.sqrt(np.maximum(self._second / count - mean**2, 0.0))
        return mean.astype(np.float32), spread.astype(np.float32)


def compute_statistics(data: Episodes, max_episodes: int, vehicle: str | None) -> Statistics:
    """Compute the statistics of `Dataset.statistics`."""
    vehicles = data.vehicles
    if vehicle is not None and vehicle not in vehicles:
        raise ConfigError(f"vehicle: {format_value(vehicle)} is not among {', '.join(vehicles)}")
    moments: dict[str, _Moments] = {}
    for i in np.unique(
        np.linspace(0, len(data) - 1, min(max_episodes, len(data))).astype(int)
    ).tolist():
        is_running = data.values(i, "outcome") == 0
        if vehicle is not None:
            is_running = is_running & (np.array(data.vehicle_labels(i)) == vehicle)
        for name in (name for name in data.fields if name in data.names(i)):
            values, mask = _read_with_mask(data, i, name, is_running)
            moment = moments.setdefault(name, _Moments())
            moment.add(values, mask)
    return {name: moment.result() for name, moment in moments.items() if moment.count.any()}


def _read_with_mask(
    data: Episodes, episode: int, name: str, is_running: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return values [..., component] of a field and which of them count, bool of the same shape.

    Ended robots, missing obstacles, samples that are not finite, missing thrusters, and samples
    without a command do not count.

    Args:
        data: the dataset.
        episode: row of its index.
        name: name of the field.
        is_running: bool [time, robot].
    """
    dims = trajectory_layout.ARRAYS[name].dims
    values = data.values(episode, name).astype(float)
    if dims[-1] in ("time", "robot", "obstacle"):
        values, dims = values[..., None], (*dims, "component")
    mask = np.isfinite(values).all(axis=-1, keepdims=True) & np.ones(values.shape, bool)
    rest = (1,) * (values.ndim - 2)
    if dims[1] == "robot":
        mask &= is_running.reshape(*is_running.shape, *rest)
    elif dims[1] == "obstacle":
        mask &= data.obstacles_exist(episode).reshape(1, -1, *rest)
    if dims[-1] == "thruster":
        thrusters = np.array(
            [data.thrusters(episode, label) for label in data.vehicle_labels(episode)]
        )
        mask &= (np.arange(values.shape[-1]) < thrusters[:, None]) & (values > 0.0)
    return values, mask
