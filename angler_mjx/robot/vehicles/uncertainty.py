"""Uncertainty of a parameter set: standard deviations of its numbers and their correlation.

Deviations of a vehicle are normal with mean zero. Positions and the volume are shifted by them;
added mass, damping and masses are multiplied by their exponential, so the number of the file is the
median. Keys that are left out are certain.
"""

from collections.abc import Mapping, Sequence
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from angler_mjx.files import FileModel
from angler_mjx.robot.vehicles.hull import Name
from angler_mjx.robot.vehicles.rotor_config import Source

type Shift = Annotated[float, Field(ge=0.0, le=1.0)]
type LogShift = Annotated[float, Field(ge=0.0, le=3.0)]
type SixLogShifts = tuple[LogShift, LogShift, LogShift, LogShift, LogShift, LogShift]

_TOLERANCE = 1e-3
"""Correlations are rounded in files."""
_AXES = ("u", "v", "w", "p", "q", "r")
_ORDER: Mapping[str, tuple[str, ...]] = {
    "center_of_buoyancy_m": ("x", "y", "z"),
    "volume_m3": (),
    "added_mass": _AXES,
    "linear_damping": _AXES,
    "quadratic_damping": _AXES,
    "link_added_mass": (),
    "link_drag": (),
}
"""Keys in the order of the rows of ``correlation``, and the labels of their numbers; the masses of
links come last."""


class Uncertainty(FileModel):
    """Spread of the numbers of a parameter set; see `docs/how_to/randomise.md`.

    Standard deviations of added mass, damping and masses are those of the logarithm.
    """

    center_of_buoyancy_m: tuple[Shift, Shift, Shift] | None = None
    """[3] standard deviations of the centre of buoyancy."""
    volume_m3: Shift | None = None
    """Standard deviation of the displaced volume."""
    added_mass: SixLogShifts | None = None
    """[u v w p q r] standard deviations of the logarithm; off the diagonal the root of the product
    of two factors."""
    linear_damping: SixLogShifts | None = None
    """[u v w p q r] standard deviations of the logarithm."""
    quadratic_damping: SixLogShifts | None = None
    """[u v w p q r] standard deviations of the logarithm."""
    link_added_mass: LogShift | None = None
    """Standard deviation of the logarithm of the added mass of cylinders, one factor for all."""
    link_drag: LogShift | None = None
    """Standard deviation of the logarithm of the drag of cylinders, one factor for all."""
    link_mass: dict[Name, LogShift] = Field(default_factory=dict)
    """Standard deviations of the logarithm of the masses of links, by name of the link."""
    correlation: tuple[tuple[float, ...], ...] = ()
    """Correlation of all these numbers, a row for each in the order of this table; empty:
    independent."""
    source: Source

    @model_validator(mode="after")
    def _check_correlation(self) -> Self:
        if not self.labels:
            raise ValueError("no standard deviation is given; leave the table out")
        if self.correlation:
            _check_correlation(self.correlation, self.labels)
        return self

    @property
    def labels(self) -> tuple[str, ...]:
        """Return the names of the uncertain numbers [k], in the order of ``correlation``."""
        names = [
            f"{key}.{label}" if label else key
            for key, parts in _ORDER.items()
            if getattr(self, key) is not None
            for label in (parts or ("",))
        ]
        return (*names, *(f"link_mass.{name}" for name in self.link_mass))

    @property
    def standard_deviations(self) -> np.ndarray:
        """Return the standard deviations [k] of the uncertain numbers."""
        values = [
            np.atleast_1d(value) for key in _ORDER if (value := getattr(self, key)) is not None
        ]
        return np.concatenate([*values, np.array([*self.link_mass.values()], float)])

    @property
    def root(self) -> np.ndarray:
        """Return a root [k, k] of the covariance: it times standard normal numbers [k] deviates."""
        spread = self.standard_deviations
        lower = _semidefinite_root(np.array(self.correlation or np.eye(len(spread))))[0]
        scaled: np.ndarray = spread[:, None] * lower
        return scaled

    def split(self, deviations: Sequence[float]) -> dict[str, np.ndarray]:
        """Return deviations [k] by key; those of ``link_mass`` in the order of its names."""
        values, by_key = np.asarray(deviations, float), {}
        for key, parts in _ORDER.items():
            if getattr(self, key) is not None:
                n = max(len(parts), 1)
                by_key[key], values = values[:n], values[n:]
        return {**by_key, "link_mass": values}


def _check_correlation(rows: Sequence[Sequence[float]], labels: Sequence[str]) -> None:
    """Raise ValueError unless rows [k][k] are the correlation of the named numbers [k]."""
    k = len(labels)
    if len(rows) != k or any(len(row) != k for row in rows):
        raise ValueError(f"correlation: give {k} rows of {k} values, for {', '.join(labels)}")
    matrix = np.array(rows)
    if np.any(np.diag(matrix) != 1.0):
        raise ValueError("correlation: every number correlates with itself by 1")
    if np.any(np.abs(matrix - matrix.T) > 0.0):
        raise ValueError("correlation: must be symmetric; make entry [i][j] equal to entry [j][i]")
    fault = _semidefinite_root(matrix)[1]
    if fault is not None:
        raise ValueError(
            f"correlation: no numbers have these correlations (row {fault}, {labels[fault]}, does "
            "not fit the rows above it); the matrix must have no negative eigenvalue"
        )


def _semidefinite_root(matrix: np.ndarray) -> tuple[np.ndarray, int | None]:
    """Return the lower Cholesky factor [k, k] of a correlation, and the first row that has none.

    A row that the rows above determine has zero on the diagonal.
    """
    lower = np.zeros_like(matrix)
    fault = None
    for j in range(len(matrix)):
        pivot = matrix[j, j] - lower[j, :j] @ lower[j, :j]
        rest = matrix[j + 1 :, j] - lower[j + 1 :, :j] @ lower[j, :j]
        if pivot > _TOLERANCE:
            lower[j, j] = np.sqrt(pivot)
            lower[j + 1 :, j] = rest / lower[j, j]
        elif fault is None and (pivot < -_TOLERANCE or np.any(np.abs(rest) > 0.05)):
            fault = j
    return lower, fault
