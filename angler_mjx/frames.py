"""Conversions of conventions, only in this module: ENU/FLU and its mirror NED/FRD.

Inside the simulator all quantities are in ENU, east-north-up (world), and FLU, forward-left-up
(body). North-east-down and forward-right-down exist only at the interfaces: autopilots, SNAME
tables, the controllers of other projects. Every map here is its own inverse; both names exist so
that a call states its direction. Functions take NumPy or JAX arrays with any leading axes and
return the same kind and dtype.
"""

import math

import jax
import numpy as np

_HALF_SQRT = math.sqrt(0.5)


def vector_enu_to_ned[A: (jax.Array, np.ndarray)](vector: A) -> A:
    """Convert east-north-up to north-east-down: [x, y, z] -> [y, x, -z].

    Args:
        vector: [..., 3] in ENU.

    Returns:
        [..., 3] in NED.
    """
    return _stack_components(vector, [vector[..., 1], vector[..., 0], -vector[..., 2]])


def vector_ned_to_enu[A: (jax.Array, np.ndarray)](vector: A) -> A:
    """Convert north-east-down to east-north-up; see ``vector_enu_to_ned``."""
    return vector_enu_to_ned(vector)


def body_flu_to_frd[A: (jax.Array, np.ndarray)](vector: A) -> A:
    """Convert forward-left-up to forward-right-down: [x, y, z] -> [x, -y, -z].

    Args:
        vector: [..., 3] in FLU, or [..., 6] for a twist [v, w] or a wrench [force, torque].

    Returns:
        The same shape, in FRD.
    """
    sign = (1, -1, -1) * (vector.shape[-1] // 3)
    return _stack_components(vector, [s * vector[..., i] for i, s in enumerate(sign)])


def body_frd_to_flu[A: (jax.Array, np.ndarray)](vector: A) -> A:
    """Convert forward-right-down to forward-left-up; see ``body_flu_to_frd``."""
    return body_flu_to_frd(vector)


def quaternion_enu_to_ned[A: (jax.Array, np.ndarray)](quaternion: A) -> A:
    """Convert attitude FLU in ENU to attitude FRD in NED.

    q_NB = q_NW q_WF q_FB with q_NW = [0, 1, 1, 0] / sqrt(2) and q_FB = [0, 1, 0, 0], multiplied
    out and with the sign turned so that small tilts at heading north keep w > 0.

    Args:
        quaternion: [..., 4] wxyz, rotates FLU to ENU.

    Returns:
        [..., 4] wxyz, rotates FRD to NED.
    """
    w, x, y, z = (quaternion[..., i] for i in range(4))
    parts = [w + z, x + y, x - y, w - z]
    return _stack_components(quaternion, [_HALF_SQRT * part for part in parts])


def quaternion_ned_to_enu[A: (jax.Array, np.ndarray)](quaternion: A) -> A:
    """Convert attitude FRD in NED to attitude FLU in ENU; see ``quaternion_enu_to_ned``."""
    return quaternion_enu_to_ned(quaternion)


def _stack_components[A: (jax.Array, np.ndarray)](like: A, parts: list[A]) -> A:
    joined: A = like.__array_namespace__().stack(parts, axis=-1)
    return joined
