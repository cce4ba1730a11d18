"""Comparison of arrays that two devices computed, within bounds that give their reason."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True, kw_only=True)
class ErrorBound:
    """Agreement that a pair of arrays must reach."""

    atol: float = 0.0
    """Largest difference of one element, in the unit of the array."""
    rtol: float = 0.0
    """Difference that is allowed beyond it, as a fraction of the CPU's element."""
    fraction: float = 1.0
    """Least fraction of rows whose elements all agree."""
    axes: int = 1
    """Leading axes that number the rows: 2 for [world, robot]."""
    why: str = "same numbers"
    """Source of the difference that is allowed."""
    equal: str | None = None
    """Array whose rows must agree for a row of this one to be compared."""


EXACT = ErrorBound()


def compare_arrays(
    device: Mapping[str, np.ndarray],
    reference: Mapping[str, np.ndarray],
    bounds: Mapping[str, ErrorBound],
) -> tuple[list[str], list[str]]:
    """Compare two sets of arrays by name.

    Args:
        device: results of the device under test.
        reference: results of the CPU.
        bounds: by name; arrays without one must be equal.

    Returns:
        Faults, one line each, and notes on every array that is not equal within its bound.
    """
    faults, notes = [], []
    if device.keys() != reference.keys():
        faults.append(f"arrays differ: {sorted(device.keys() ^ reference.keys())}")
    for name in sorted(device.keys() & reference.keys()):
        ours, theirs, bound = device[name], reference[name], bounds.get(name, EXACT)
        if bound.equal in device.keys() & reference.keys():
            rows = _rows_agree(device[bound.equal], reference[bound.equal], bounds[bound.equal])
            ours, theirs = ours[rows], theirs[rows]
            bound = replace(bound, axes=1)
        text, is_fault = _compare_pair(name, ours, theirs, bound)
        if text:
            (faults if is_fault else notes).append(text)
    return faults, notes


def _compare_pair(
    name: str, ours: np.ndarray, theirs: np.ndarray, bound: ErrorBound
) -> tuple[str, bool]:
    """Describe the disagreement of one pair of arrays, empty if none; and whether it is a fault."""
    if ours.shape != theirs.shape:
        return f"{name}: shape {ours.shape}, on the CPU {theirs.shape}", True
    if ours.size == 0:
        return f"{name}: holds nothing", True
    difference = _element_differences(ours, theirs)
    does_agree = _rows_agree(ours, theirs, bound)
    fraction = float(does_agree.mean())
    if fraction == 1.0:
        return "", False
    first = tuple(int(i) for i in np.argwhere(~does_agree)[0])
    text = (
        f"{name}: {fraction:.4f} of {does_agree.size} rows within {bound.atol:g}"
        f"{f' + {bound.rtol:.0%}' if bound.rtol else ''}, "
        f"{bound.fraction:g} must be; first at {first}: largest difference "
        f"{float(difference[first].max()):.3g} ({bound.why})"
    )
    return text, fraction < bound.fraction


def _element_differences(ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    """Return differences of elements: infinite of NaN and a number, and of unequal integers."""
    if ours.dtype.kind != "f":
        return np.where(ours == theirs, 0.0, np.inf)
    with np.errstate(invalid="ignore"):
        difference = np.abs(ours.astype(np.float64) - theirs.astype(np.float64))
    is_equal = (ours == theirs) | (np.isnan(ours) & np.isnan(theirs))
    return np.where(is_equal, 0.0, np.where(np.isnan(difference), np.inf, difference))


def _rows_agree(ours: np.ndarray, theirs: np.ndarray, bound: ErrorBound) -> np.ndarray:
    """Return which rows agree in all of their elements, bool with the axes of the rows."""
    if ours.shape != theirs.shape:
        return np.zeros(ours.shape[: bound.axes], bool)
    allowed = bound.atol
    if bound.rtol:
        allowed = bound.atol + bound.rtol * np.abs(np.nan_to_num(theirs, posinf=0.0, neginf=0.0))
    is_within = _element_differences(ours, theirs) <= allowed
    return is_within.reshape(*ours.shape[: bound.axes], -1).all(axis=-1)
