"""Conversions of conventions, only in this module: ENU/FLU and its mirror NED/FRD.

Inside the simulator all quantities are in ENU, east-north-up (world), and FLU, forward-left-up
(body). North-east-down and forward-right-down exist only at the interfaces: autopilots, SNAME
tables, the controllers of other projects. Every map here is its own inverse; both names exist so
that a call states its direction. Functions take NumPy or JAX arrays with any leading axes and
return the same kind and dtype.

Files of ground stations state latitudes and longitudes: `GeodeticOrigin` puts W on the WGS84
ellipsoid.
"""

import math
from dataclasses import dataclass

import jax
import numpy as np

_HALF_SQRT = math.sqrt(0.5)

_WGS84_A_M, _WGS84_E2 = 6_378_137.0, 6.694379990141317e-3
"""Semi-major axis and squared first eccentricity of the WGS84 ellipsoid."""
_MAX_NEWTON_STEPS, _NEWTON_TOLERANCE_M = 20, 1e-6

type Pair = tuple[float, float]


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


@dataclass(frozen=True, kw_only=True)
class GeodeticOrigin:
    """Position of W's origin on the WGS84 ellipsoid.

    x and y are those of the tangent plane at the origin (east, north); z is the height above the
    surface of the water, which is at `altitude_m` everywhere.
    """

    latitude_deg: float
    longitude_deg: float
    altitude_m: float = 0.0
    """Altitude of the surface of the water, in the datum of the file that states it."""


def geodetic_to_local(origin: GeodeticOrigin, latitude_deg: float, longitude_deg: float) -> Pair:
    """Return x, y [m] in W of a position on the surface of the water.

    Args:
        origin: of W.
        latitude_deg: of the position.
        longitude_deg: of the position.
    """
    offset = np.subtract(
        _geodetic_to_ecef(latitude_deg, longitude_deg, origin.altitude_m),
        _geodetic_to_ecef(origin.latitude_deg, origin.longitude_deg, origin.altitude_m),
    )
    east, north, _ = _ecef_to_enu_rotation(origin) @ offset
    return float(east), float(north)


def local_to_geodetic(origin: GeodeticOrigin, x_m: float, y_m: float) -> Pair:
    """Return latitude and longitude [deg] of a position on the surface of the water.

    The inverse of `geodetic_to_local`, by Newton steps with the radii of curvature at the origin.

    Args:
        origin: of W.
        x_m: east of it.
        y_m: north of it.
    """
    sine = math.sin(math.radians(origin.latitude_deg))
    w2 = 1.0 - _WGS84_E2 * sine * sine
    meridian_m = _WGS84_A_M * (1.0 - _WGS84_E2) / w2**1.5
    parallel_m = _WGS84_A_M / math.sqrt(w2) * math.cos(math.radians(origin.latitude_deg))
    latitude, longitude = origin.latitude_deg, origin.longitude_deg
    for _ in range(_MAX_NEWTON_STEPS):
        x, y = geodetic_to_local(origin, latitude, longitude)
        if math.hypot(x_m - x, y_m - y) < _NEWTON_TOLERANCE_M:
            break
        latitude += math.degrees((y_m - y) / meridian_m)
        longitude += math.degrees((x_m - x) / parallel_m)
    return latitude, longitude


def _geodetic_to_ecef(
    latitude_deg: float, longitude_deg: float, height_m: float
) -> tuple[float, float, float]:
    """Return Earth-centred, Earth-fixed coordinates [m] on WGS84."""
    latitude, longitude = math.radians(latitude_deg), math.radians(longitude_deg)
    sine, cosine = math.sin(latitude), math.cos(latitude)
    normal_m = _WGS84_A_M / math.sqrt(1.0 - _WGS84_E2 * sine * sine)
    level_m = (normal_m + height_m) * cosine
    return (
        level_m * math.cos(longitude),
        level_m * math.sin(longitude),
        (normal_m * (1.0 - _WGS84_E2) + height_m) * sine,
    )


def _ecef_to_enu_rotation(origin: GeodeticOrigin) -> np.ndarray:
    """Return the rotation [3, 3] from ECEF to east, north, up at a position."""
    latitude, longitude = math.radians(origin.latitude_deg), math.radians(origin.longitude_deg)
    sp, cp, sl, cl = (
        math.sin(latitude),
        math.cos(latitude),
        math.sin(longitude),
        math.cos(longitude),
    )
    return np.array([[-sl, cl, 0.0], [-sp * cl, -sp * sl, cp], [cp * cl, cp * sl, sp]])
