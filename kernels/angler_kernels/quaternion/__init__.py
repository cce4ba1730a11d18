"""Unit quaternions, wxyz, rotating body vectors into the world."""

from angler_kernels.quaternion.reference import (
    conjugate,
    exp,
    exp_small,
    from_yaw,
    multiply,
    rotate,
    rotate_inverse,
    to_matrix,
    up,
    yaw,
)

__all__ = [
    "conjugate",
    "exp",
    "exp_small",
    "from_yaw",
    "multiply",
    "rotate",
    "rotate_inverse",
    "to_matrix",
    "up",
    "yaw",
]
