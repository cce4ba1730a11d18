"""Hydrodynamics of shapes of uniform density: volume, inertia, added mass and drag.

Geometry only: multiply by the mass, by the water's density or by half of it. Plain numpy in double
precision, evaluated on the host while a world's obstacles are set up.

Validity: deeply submerged bodies, Reynolds numbers of 1e4 to 3e5 (0.02 to 0.6 m/s at 0.5 m), where
the drag coefficients of bluff bodies are constant. No linear drag.
"""

import math
from dataclasses import dataclass

import numpy as np

type Floats = np.ndarray[tuple[int, ...], np.dtype[np.float64]]

DRAG_SPHERE = 0.47
DRAG_CUBE = 1.05
DRAG_CYLINDER = 1.17
"""Subcritical drag coefficients on frontal area: sphere, cube with its face to the flow, circular
cylinder across the flow (Hoerner, Fluid-Dynamic Drag, 1965, chapter 3)."""

_SPIN_FRICTION = 0.012
"""Moment coefficient of skin friction, 2 M / (rho/2 omega^2 r^5), of a rotating disk at a Reynolds
number of 2.5e5 (0.146 Re^-0.2: Schlichting, Boundary-Layer Theory, chapter 21); the order of
magnitude of a spinning sphere's."""

_ASPECT = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 10.0])
_PRISM = np.array([0.579 * math.pi / 4, 0.68, 0.72, 0.72, 0.76, 0.75, 0.78, 0.77, 0.80])
"""Added volume of a square prism moving along its axis over the cube of its side, by length over
side: the coefficients of DNV-RP-C205 (appendix on added mass of three-dimensional bodies: square
prism 0.68, 0.36, 0.24, 0.19, 0.15, 0.13, 0.11, 0.08 for 1 to 7 and 10) times length over side, and
the square plate (0.579 of the sphere-like volume pi/4 side^3) at length zero."""


@dataclass(frozen=True, kw_only=True)
class Body:
    """Geometry of a shape in the water, about its centre, in its own axes."""

    volume_m3: float
    inertia_m2: Floats
    """[3] principal moments over the mass."""
    added: Floats
    """[6] diagonal added mass over the water's density, m^3 and m^5."""
    drag: Floats
    """[6] quadratic drag over half the water's density, m^2 and m^5."""


def build_sphere(radius: float) -> Body:
    """Return a sphere; added mass: half the displaced mass (Lamb, Hydrodynamics, 1932, art. 92)."""
    volume = 4.0 / 3.0 * math.pi * radius**3
    spin = 0.5 * _SPIN_FRICTION * radius**5
    return Body(
        volume_m3=volume,
        inertia_m2=np.full(3, 0.4 * radius**2),
        added=np.array([0.5 * volume] * 3 + [0.0] * 3),
        drag=np.array([DRAG_SPHERE * math.pi * radius**2] * 3 + [spin] * 3),
    )


def build_box(half: tuple[float, float, float]) -> Body:
    """Return a box with half extents ``half``.

    Added mass along an axis: the square prism with the same length and frontal area (DNV table
    above). Added inertia and rotational drag are strip estimates, with each strip of a face moving
    as fast as the rotation carries it: an upper bound for the added inertia.
    """
    h = np.array(half)
    face = np.array([4.0 * h[1] * h[2], 4.0 * h[2] * h[0], 4.0 * h[0] * h[1]])
    side = np.sqrt(face)
    push = side**3 * np.interp(2.0 * h / side, _ASPECT, _PRISM)
    j, k = np.array([1, 2, 0]), np.array([2, 0, 1])
    return Body(
        volume_m3=float(8.0 * np.prod(h)),
        inertia_m2=(h[j] ** 2 + h[k] ** 2) / 3.0,
        added=np.concatenate([push, (push[j] * h[k] ** 2 + push[k] * h[j] ** 2) / 3.0]),
        drag=DRAG_CUBE * np.concatenate([face, h * (h[j] ** 4 + h[k] ** 4)]),
    )


def build_capsule(radius: float, half_length: float) -> Body:
    """Return a capsule along z; ``half_length`` is that of its axis, without the caps.

    Added mass of the prolate spheroid with the same volume and the same length over width (Lamb,
    1932, art. 114 and 115). Drag: caps as a sphere, cylinder across the flow; across-axis
    rotation as strips.
    """
    r, half = radius, half_length
    barrel, caps = 2.0 * math.pi * r**2 * half, 4.0 / 3.0 * math.pi * r**3
    volume = barrel + caps
    across = barrel * (r**2 / 4 + half**2 / 3) + caps * (0.4 * r**2 + half**2 + 0.75 * half * r)
    along = barrel * r**2 / 2 + caps * 0.4 * r**2
    ends = DRAG_SPHERE * math.pi * r**2
    side = ends + DRAG_CYLINDER * 4.0 * r * half
    spin = 0.5 * _SPIN_FRICTION * (r**5 + 2.0 * r**4 * half)
    tumble = DRAG_CYLINDER * r * ((half + r) ** 4 - r**4) + spin
    return Body(
        volume_m3=volume,
        inertia_m2=np.array([across, across, along]) / volume,
        added=_prolate_spheroid(volume, (half + r) / r),
        drag=np.array([side, side, ends, tumble, tumble, spin]),
    )


def _prolate_spheroid(volume: float, slenderness: float) -> Floats:
    """Return the added mass [6] over density of a spheroid along z, length over width >= 1."""
    e2 = 1.0 - slenderness**-2
    b2 = (volume / (4.0 / 3.0 * math.pi * slenderness)) ** (2.0 / 3.0)
    a2 = b2 * slenderness**2
    e = math.sqrt(e2)
    if e < 0.05:
        # Series about the sphere; the closed form cancels there. Next term: e^4 < 1e-5.
        along, across = 2.0 / 3.0 - 4.0 / 15.0 * e2, 2.0 / 3.0 + 2.0 / 15.0 * e2
    else:
        log = math.log((1.0 + e) / (1.0 - e))
        along = 2.0 * (1.0 - e2) / e**3 * (0.5 * log - e)
        across = 1.0 / e2 - (1.0 - e2) / (2.0 * e**3) * log
    gap = across - along
    bottom = 2.0 * (a2 - b2) - (a2 + b2) * gap
    turn = 0.2 * (a2 - b2) ** 2 * gap / bottom if gap > 0.0 else 0.0
    surge, sway = along / (2.0 - along), across / (2.0 - across)
    return volume * np.array([sway, sway, surge, turn, turn, 0.0])
