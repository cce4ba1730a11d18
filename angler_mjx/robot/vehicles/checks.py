"""Checks that the numbers of a vehicle file describe a body that can exist.

Each function raises ValueError with the reason and the remedy; the models turn it into a fault of
the file.
"""

import math
from collections.abc import Sequence

import numpy as np

type Matrix = tuple[tuple[float, ...], ...]

SMALLEST, LARGEST = 1e-9, 1e9
"""Range of masses, inertias, lengths and coefficients of a vehicle file; SI units."""

PWM_LOW_US, PWM_HIGH_US = 1100, 1900
"""PWM range [us] that a thruster file must cover."""

# Matrices and unit vectors are typed by hand in files: more than this is an error, not rounding.
_RELATIVE_TOLERANCE = 1e-6


def _symmetric_matrix(value: object, size: int) -> np.ndarray:
    """Turn a diagonal or a full matrix of a file into a symmetric array.

    Raise ValueError otherwise.
    """
    shape_hint = f"give {size} diagonal values or {size} rows of {size} values"
    rows = value if isinstance(value, tuple | list) else ()
    cells = [x for row in rows for x in (row if isinstance(row, tuple | list) else (row,))]
    if any(isinstance(x, bool) or not isinstance(x, int | float) for x in cells):
        raise ValueError(f"every value must be a number; {shape_hint}")
    try:
        matrix = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(shape_hint) from error
    if matrix.shape == (size,):
        matrix = np.diag(matrix)
    if matrix.shape != (size, size):
        raise ValueError(shape_hint)
    if not np.all(np.abs(matrix) <= LARGEST):
        raise ValueError(f"every value must be finite, {LARGEST:g} at most")
    if np.any(np.abs(matrix - matrix.T) > _RELATIVE_TOLERANCE * np.max(np.abs(matrix))):
        raise ValueError("must be symmetric; make entry [i][j] equal to entry [j][i]")
    return (matrix + matrix.T) / 2


def _to_rows(matrix: np.ndarray) -> Matrix:
    return tuple(tuple(float(entry) for entry in row) for row in matrix)


def check_inertia(value: object) -> Matrix:
    """Check rotational inertia (3 diagonal values or 3 x 3) and return the full matrix."""
    matrix = _symmetric_matrix(value, 3)
    low, middle, high = np.linalg.eigvalsh(matrix)
    if low < SMALLEST:
        raise ValueError(
            f"must be positive definite; a principal moment is below {SMALLEST:g}, or negative"
        )
    if low + middle < high * (1 - _RELATIVE_TOLERANCE):
        raise ValueError(
            f"no rigid body has principal moments {low:.4g}, {middle:.4g}, {high:.4g}: "
            "the two smaller ones must add up to at least the largest"
        )
    return _to_rows(matrix)


def check_added_mass(value: object) -> Matrix:
    """Check added mass (6 diagonal values or 6 x 6) and return the full matrix."""
    matrix = _symmetric_matrix(value, 6)
    low, *_, high = np.linalg.eigvalsh(matrix)
    if low < -_RELATIVE_TOLERANCE * max(high, 0.0):
        raise ValueError("must not be negative; give added mass as positive numbers")
    return _to_rows(matrix)


def check_damping(value: tuple[float, ...]) -> tuple[float, ...]:
    """Check six damping coefficients."""
    if len(value) != 6 or min(value) < 0 or max(value) > LARGEST:
        raise ValueError(
            f"give six values for [u v w p q r], none of them negative or above {LARGEST:g}"
        )
    return value


def check_damping_table(value: object) -> tuple[float, ...] | Matrix:
    """Check damping: six values of the diagonal, or six rows of six.

    A matrix that is diagonal is returned as its diagonal.
    """
    rows = value if isinstance(value, tuple | list) else ()
    if not any(isinstance(row, tuple | list) for row in rows):
        if any(isinstance(x, bool) or not isinstance(x, int | float) for x in rows):
            raise ValueError("every value must be a number; give six values or six rows of six")
        return check_damping(tuple(float(x) for x in rows))
    if len(rows) != 6 or any(not isinstance(row, tuple | list) or len(row) != 6 for row in rows):
        raise ValueError("give six values for [u v w p q r], or six rows of six values")
    if any(isinstance(x, bool) or not isinstance(x, int | float) for row in rows for x in row):
        raise ValueError("every value must be a number; give six values or six rows of six")
    matrix = np.asarray(value, dtype=np.float64)
    if not np.all(np.abs(matrix) <= LARGEST):
        raise ValueError(f"every value must be finite, {LARGEST:g} at most")
    diagonal = check_damping(tuple(float(x) for x in np.diag(matrix)))
    return diagonal if np.array_equal(matrix, np.diag(diagonal)) else _to_rows(matrix)


def check_passive(matrix: np.ndarray) -> None:
    """Check that linear damping [6, 6] takes energy at every velocity."""
    low, *_, high = np.linalg.eigvalsh((matrix + matrix.T) / 2)
    if low < -_RELATIVE_TOLERANCE * max(high, 0.0):
        raise ValueError(
            f"linear: its symmetric part has the eigenvalue {low:.4g}, so that still water would "
            "drive the vehicle; correct the entries off the diagonal"
        )


def check_distinct_names(kind: str, names: list[str]) -> None:
    """Check that no name occurs twice."""
    if len(set(names)) < len(names):
        twice = sorted({name for name in names if names.count(name) > 1})
        raise ValueError(f"{kind} names must differ; more than once: {', '.join(twice)}")


def check_apart(from_m: Sequence[float], to_m: Sequence[float]) -> None:
    """Check that the ends [3] of an axis are apart.

    MuJoCo takes no capsule without a length; files give millimetres.
    """
    if math.dist(from_m, to_m) < 1e-3:
        raise ValueError("from_m and to_m: must be at least 1 mm apart, also for a ball")


def check_unit_vector(value: tuple[float, float, float]) -> tuple[float, float, float]:
    """Check a direction."""
    length = float(np.linalg.norm(value))
    if abs(length - 1) > _RELATIVE_TOLERANCE:
        raise ValueError(f"must be a unit vector; its length is {length:.6g}")
    return value


def check_positive(value: float) -> float:
    """Check a number above zero that float32 can compute with."""
    if not SMALLEST <= value <= LARGEST:
        raise ValueError(f"must lie between {SMALLEST:g} and {LARGEST:g} (SI units)")
    return value
