"""Comparison of arrays that two devices computed, within bounds that give their reason."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Bound:
    """Agreement that a pair of arrays must reach."""

    atol: float = 0.0
    """Largest difference of one element, in the unit of the array."""
    fraction: float = 1.0
    """Least fraction of rows whose elements all agree."""
    axes: int = 1
    """Leading axes that number the rows: 2 for [world, robot]."""
    why: str = "same numbers"
    """Source of the difference that is allowed."""


EXACT = Bound()


def differences(
    device: Mapping[str, np.ndarray],
    reference: Mapping[str, np.ndarray],
    bounds: Mapping[str, Bound],
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
        text, is_fault = _compare(name, device[name], reference[name], bounds.get(name, EXACT))
        if text:
            (faults if is_fault else notes).append(text)
    return faults, notes


def _compare(name: str, ours: np.ndarray, theirs: np.ndarray, bound: Bound) -> tuple[str, bool]:
    """Describe the disagreement of one pair of arrays, empty if none; and whether it is a fault."""
    if ours.shape != theirs.shape:
        return f"{name}: shape {ours.shape}, on the CPU {theirs.shape}", True
    if ours.size == 0:
        return f"{name}: holds nothing", True
    if ours.dtype.kind == "f":
        with np.errstate(invalid="ignore"):
            apart = np.abs(ours.astype(np.float64) - theirs.astype(np.float64))
        equal = (ours == theirs) | (np.isnan(ours) & np.isnan(theirs))
        apart = np.where(equal, 0.0, np.where(np.isnan(apart), np.inf, apart))
    else:
        apart = np.where(ours == theirs, 0.0, np.inf)
    rows = ours.shape[: bound.axes]
    agrees = (apart <= bound.atol).reshape(*rows, -1).all(axis=-1)
    fraction = float(agrees.mean())
    if fraction == 1.0:
        return "", False
    first = tuple(int(i) for i in np.argwhere(~agrees)[0])
    text = (
        f"{name}: {fraction:.4f} of {agrees.size} rows within {bound.atol:g}, "
        f"{bound.fraction:g} must be; first at {first}: largest difference "
        f"{float(apart[first].max()):.3g} ({bound.why})"
    )
    return text, fraction < bound.fraction
