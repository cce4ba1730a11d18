"""Rotor of third order: from a transfer function to one exact step.

The thrust f follows its command u by f = (b_2 s^2 + b_1 s + b_0) / (s^3 + a_2 s^2 + a_1 s + a_0) u,
with b_0 = a_0, so that it settles at the command. All of it is computed once, on the host, in
float64.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from angler_mjx.robot.vehicles.thrusters import FloatArray


@dataclass(frozen=True)
class RotorFilter:
    """Coefficients of the transfer function from command to thrust, highest power first."""

    numerator: tuple[float, float, float]
    """b_2, b_1, b_0; 1/s, 1/s^2, 1/s^3."""
    denominator: tuple[float, float, float]
    """a_2, a_1, a_0, that of s^3 being 1; 1/s, 1/s^2, 1/s^3."""


@dataclass(frozen=True)
class RotorStep:
    """Step of the filter, as an input of `angler_kernels.thruster.rotor_filter`."""

    settled: FloatArray
    """[3] states at rest for a command of 1 N."""
    transition: FloatArray
    """[3, 3] exp(A dt)."""
    mean: FloatArray
    """[3] first row of the mean of exp(A t) over the step."""


ORDER = 3
"""Number of states."""


@lru_cache(maxsize=64)
def discretise_rotor(rotor: RotorFilter, dt: float) -> RotorStep:
    """Return the exact step of ``dt`` seconds for a command that is held.

    States of the observer form, x_1 = f, x_1' = -a_2 x_1 + x_2 + b_2 u, x_2' = -a_1 x_1 + x_3 +
    b_1 u, x_3' = -a_0 x_1 + b_0 u, with x_2 divided by a_2 and x_3 by a_1: all are in newtons, of
    the size of the thrust.
    """
    b_2, b_1, _ = rotor.numerator
    a_2, a_1, a_0 = rotor.denominator
    A = np.array([[-a_2, a_2, 0.0], [-a_1 / a_2, 0.0, a_1 / a_2], [-a_0 / a_1, 0.0, 0.0]])
    # exp of [[A, I], [0, 0]] t holds exp(A t) and its integral from 0 to t.
    both = np.zeros((2 * ORDER, 2 * ORDER))
    both[:ORDER, :ORDER], both[:ORDER, ORDER:] = A, np.eye(ORDER)
    exponential = _matrix_exponential(both * dt)
    return RotorStep(
        settled=np.array([1.0, (a_2 - b_2) / a_2, (a_1 - b_1) / a_1]),
        transition=exponential[:ORDER, :ORDER],
        mean=exponential[0, ORDER:] / dt,
    )


def _matrix_exponential(matrix: FloatArray) -> FloatArray:
    """Return exponential of a small matrix.

    Taylor's series of a 2^-n part of it, squared n times.
    """
    halvings = max(0, math.ceil(math.log2(max(np.abs(matrix).sum(axis=1).max(), 1.0)))) + 2
    part = matrix / 2.0**halvings
    term = total = np.eye(len(matrix))
    for k in range(1, 16):  # rows of `part` sum to 1/4 at most: 0.25^16 / 16! is far below 1e-16
        term = term @ part / k
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return total
