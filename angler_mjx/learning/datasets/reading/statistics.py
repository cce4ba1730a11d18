"""Mean and standard deviation of what a dataset holds, without padding."""

import numpy as np

from angler_mjx.errors import ConfigError, shown
from angler_mjx.learning.datasets.reading.episode import Episodes
from angler_mjx.runs.storage import layout

type Statistics = dict[str, tuple[np.ndarray, np.ndarray]]
"""Mean and standard deviation, float32 [component] each, by the names of fields."""


class _Moments:
    """Sums of the components of one field."""

    def __init__(self) -> None:
        self.count = self._first = self._second = np.zeros(0)

    def add(self, values: np.ndarray, known: np.ndarray) -> None:
        """Add values [..., component] where they are known, bool of the same shape.

        Vehicles of other parts may have more thrusters than those so far.
        """
        axes = tuple(range(values.ndim - 1))
        width = max(values.shape[-1], self.count.size)
        missing = [(0, 0)] * len(axes) + [(0, width - values.shape[-1])]
        values, known = np.pad(np.where(known, values, 0.0), missing), np.pad(known, missing)
        for sums in ("count", "_first", "_second"):
            before = getattr(self, sums)
            setattr(self, sums, np.pad(before, (0, width - before.size)))
        self.count += known.sum(axis=axes)
        self._first += values.sum(axis=axes)
        self._second += (values**2).sum(axis=axes)

    def result(self) -> tuple[np.ndarray, np.ndarray]:
        """Return mean and standard deviation; NaN where nothing is known."""
        count = np.where(self.count > 0.0, self.count, np.nan)
        mean = self._first / count
        spread = np.sqrt(np.maximum(self._second / count - mean**2, 0.0))
        return mean.astype(np.float32), spread.astype(np.float32)


def statistics(data: Episodes, most: int, vehicle: str | None) -> Statistics:
    """See `Dataset.statistics`."""
    known_vehicles = data.vehicles
    if vehicle is not None and vehicle not in known_vehicles:
        raise ConfigError(f"vehicle: {shown(vehicle)} is none of {', '.join(known_vehicles)}")
    moments: dict[str, _Moments] = {}
    for i in np.unique(np.linspace(0, len(data) - 1, min(most, len(data))).astype(int)).tolist():
        counted = data.values(i, "outcome") == 0
        if vehicle is not None:
            counted = counted & (np.array(data.labels(i)) == vehicle)
        for name in (name for name in data.fields if name in data.names(i)):
            values, known = _known(data, i, name, counted)
            of = moments.setdefault(name, _Moments())
            of.add(values, known)
    return {name: of.result() for name, of in moments.items() if of.count.any()}


def _known(
    data: Episodes, episode: int, name: str, counted: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return values [..., component] of a field and which of them count, bool of the same shape.

    Left out are robots that have ended, obstacles that do not exist, samples that are not finite,
    thrusters that a robot does not have, and samples without a command.

    Args:
        data: the dataset.
        episode: position in its index.
        name: of the field.
        counted: bool [time, robot].
    """
    dims = layout.ARRAYS[name].dims
    values = data.values(episode, name).astype(float)
    if dims[-1] in ("time", "robot", "obstacle"):
        values, dims = values[..., None], (*dims, "component")
    known = np.isfinite(values).all(axis=-1, keepdims=True) & np.ones(values.shape, bool)
    rest = (1,) * (values.ndim - 2)
    if dims[1] == "robot":
        known &= counted.reshape(*counted.shape, *rest)
    elif dims[1] == "obstacle":
        known &= data.obstacles_exist(episode).reshape(1, -1, *rest)
    if dims[-1] == "thruster":
        thrusters = np.array([data.thrusters(episode, label) for label in data.labels(episode)])
        known &= (np.arange(values.shape[-1]) < thrusters[:, None]) & (values > 0.0)
    return values, known
