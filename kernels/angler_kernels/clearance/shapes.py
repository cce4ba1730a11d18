"""Distances between segments, points and boxes, each for one pair, in closed form.

A distance is found in two parts: the parameter of the nearest point on each segment, then the
length of the gap there. The parameters are constants to differentiation: at the minimum the gap
does not change with them to first order (envelope theorem), so first derivatives are right and
stay finite; second derivatives are not provided. Where shapes touch the distance is 0 and its
gradient is 0. Lengths in metres; all shapes of a call in one frame unless it says otherwise.
"""

from collections.abc import Sequence
from typing import NamedTuple, Self

import jax
import jax.numpy as jnp

from angler_kernels.quaternion import rotate, rotate_inverse
from angler_kernels.traced_once import trace_once

SPHERE, BOX, CAPSULE = 0, 1, 2

type Vector = Sequence[jax.Array] | jax.Array
"""Three scalars, in an array or separate."""


def point_box(p: jax.Array, lo: jax.Array, hi: jax.Array) -> jax.Array:
    """Return the distance [] of a point p [3] to the axis-aligned box lo [3], hi [3]; inside 0."""
    return _safe_sqrt(
        _squared_length(
            [jnp.maximum(jnp.maximum(lo[i] - p[i], p[i] - hi[i]), 0.0) for i in range(3)]
        )
    )


@trace_once
def segment_point(a: jax.Array, b: jax.Array, p: jax.Array) -> jax.Array:
    """Return the distance [] of the segment a [3], b [3] to the point p [3]; a = b is allowed."""
    d, gap = b - a, a - p
    s = _nearest_parameter(d, -gap)
    return _safe_sqrt(_squared_length([gap[i] + s * d[i] for i in range(3)]))


@trace_once
def segment_segment(a1: jax.Array, b1: jax.Array, a2: jax.Array, b2: jax.Array) -> jax.Array:
    """Return distance [] of two segments, a1 [3] to b1 [3] and a2 [3] to b2 [3], in any position.

    They may be parallel, cross, or have no length. The squared gap is convex on the unit square of
    the two parameters: its minimum is the crossing of the two lines' common normal, if that lies in
    the square, or lies on one of the four edges, each of which is an end point against a segment.
    The least of the five is taken; each is the gap of two points of the segments, so rounding where
    the lines are nearly parallel can not make the answer too small.
    """
    d1, d2, gap = b1 - a1, b2 - a2, a1 - a2
    s1, s2 = _common_normal(d1, d2, gap)
    zero, end = jnp.zeros_like(s1), jnp.ones_like(s1)
    pairs = (
        (s1, s2),
        (_nearest_parameter(d1, -gap), zero),
        (_nearest_parameter(d1, d2 - gap), end),
        (zero, _nearest_parameter(d2, gap)),
        (end, _nearest_parameter(d2, gap + d1)),
    )

    def square(s: jax.Array, t: jax.Array) -> jax.Array:
        return _squared_length([gap[i] + s * d1[i] - t * d2[i] for i in range(3)])

    # The points are chosen, not the least of five gaps: often two of the five are the same points,
    # and a minimum passes its gradient to both or to neither where rounding separates them
    # in one place of the compiled program and not in another.
    (s, t), *others = pairs
    min_square = square(s, t)
    for u, v in others:
        other = square(u, v)
        nearer = other < min_square
        s, t, min_square = (
            jnp.where(nearer, x, y) for x, y in ((u, s), (v, t), (other, min_square))
        )
    return _safe_sqrt(square(s, t))


@trace_once
def segment_box(a: jax.Array, b: jax.Array, lo: jax.Array, hi: jax.Array) -> jax.Array:
    """Return the distance [] of the segment a [3], b [3] to the axis-aligned box lo [3], hi [3]."""
    line = LineSegment.from_ends(a, b)
    return line.gap_at(line.nearest_parameter(lo, hi), lo, hi)


class LineSegment(NamedTuple):
    """Segment a + s d, 0 <= s <= 1, prepared for distances to axis-aligned boxes."""

    a: list[jax.Array]
    d: list[jax.Array]
    weight: list[jax.Array]
    """d^2 of each coordinate."""
    inverse: list[jax.Array]
    """1 / d of each coordinate; 1 where the weight is 0."""

    @classmethod
    def from_ends(cls, a: Vector, b: Vector) -> Self:
        """Build the segment from a [3] to b [3]."""
        d = [b[i] - a[i] for i in range(3)]
        weight = [x * x for x in d]
        inverse = [1.0 / jnp.where(w > 0.0, x, 1.0) for x, w in zip(d, weight, strict=True)]
        return cls([a[i] for i in range(3)], d, weight, inverse)

    def nearest_parameter(self, lo: Vector, hi: Vector) -> jax.Array:
        """Return parameter [] of a point of the segment nearest to the box from lo [3] to hi [3].

        Half the derivative of the squared gap along the line grows with s and is piecewise linear,

            h(s) = sum_i w_i (s - clip(s, enter_i, leave_i)),  w_i = d_i^2,

        with the parameters at which the line passes the two planes of each pair of faces. It bends
        at these six only, where the term of that pair is zero. Between the last bend where h is
        negative and the first where it is not, one step of Newton finds the zero. Where h is
        nowhere negative on the segment the near end is nearest, where it is negative everywhere
        the far end. A constant to gradients.
        """
        planes = [
            ((lo[i] - self.a[i]) * self.inverse[i], (hi[i] - self.a[i]) * self.inverse[i])
            for i in range(3)
        ]
        slabs = [(jnp.minimum(u, v), jnp.maximum(u, v)) for u, v in planes]

        def beyond_slab(s: jax.Array, i: int) -> jax.Array:
            return s - jnp.clip(s, *slabs[i])

        left, right = jnp.zeros_like(self.a[0]), jnp.ones_like(self.a[0])
        for i, (j, k) in enumerate(((1, 2), (2, 0), (0, 1))):
            for s in planes[i]:
                before = (
                    self.weight[j] * beyond_slab(s, j) + self.weight[k] * beyond_slab(s, k) < 0.0
                )
                left = jnp.maximum(left, jnp.where(before, s, 0.0))
                right = jnp.minimum(right, jnp.where(before, 1.0, s))
        left, right = jnp.minimum(left, 1.0), jnp.maximum(right, 0.0)
        middle = 0.5 * (left + right)
        beyond = [beyond_slab(middle, i) for i in range(3)]
        h = sum(self.weight[i] * beyond[i] for i in range(3))
        rise = sum(jnp.where(beyond[i] == 0.0, 0.0, self.weight[i]) for i in range(3))
        at = jnp.clip(middle - h / jnp.where(rise > 0.0, rise, 1.0), left, right)
        return jax.lax.stop_gradient(at)

    def gap_at(
        self,
        s: jax.Array,
        lo: Vector,
        hi: Vector,
    ) -> jax.Array:
        """Return the distance [] of the segment's point at parameter s to a box; inside 0."""
        at = [self.a[i] + s * self.d[i] for i in range(3)]
        return _safe_sqrt(
            _squared_length([at[i] - jnp.clip(at[i], lo[i], hi[i]) for i in range(3)])
        )


@trace_once
def segment_oriented_box(
    a: jax.Array, b: jax.Array, p: jax.Array, q: jax.Array, half: jax.Array
) -> jax.Array:
    """Return the distance [] of a segment, a [3] to b [3], to a box with half extents ``half`` [3].

    Its centre is p [3], its attitude q [4] (wxyz), which rotates vectors of the box's frame to the
    frame of a, b and p.
    """
    return segment_box(rotate_inverse(q, a - p), rotate_inverse(q, b - p), -half, half)


@trace_once
def capsules_capsules(
    a1: jax.Array, b1: jax.Array, r1: jax.Array, a2: jax.Array, b2: jax.Array, r2: jax.Array
) -> jax.Array:
    """Return least distance [] between two unions of capsules; negative is overlap of the radii.

    Args:
        a1: [c, 3] one end of each axis of the first body.
        b1: [c, 3] other end.
        r1: [c] radii.
        a2: [e, 3] one end of each axis of the second body.
        b2: [e, 3] other end.
        r2: [e] radii.
    """
    to_second = jax.vmap(segment_segment, in_axes=(None, None, 0, 0))
    gap = jax.vmap(to_second, in_axes=(0, 0, None, None))(a1, b1, a2, b2)
    return jnp.min(gap - r1[:, None] - r2[None, :])


def capsules_obstacle(
    a: jax.Array,
    b: jax.Array,
    r: jax.Array,
    p: jax.Array,
    q: jax.Array,
    kind: jax.Array,
    size: jax.Array,
    kinds: Sequence[int] = (SPHERE, BOX, CAPSULE),
) -> jax.Array:
    """Return the least distance [] of a union of capsules to one obstacle; negative is overlap.

    Args:
        a: [c, 3] one end of each capsule's axis.
        b: [c, 3] other end.
        r: [c] radii.
        p: [3] centre of the obstacle.
        q: [4] its attitude, wxyz.
        kind: int [] 0 sphere, 1 box, 2 capsule.
        size: [3] sphere (radius, 0, 0); box half extents; capsule (radius, half length, 0), its
            axis along its own z.
        kinds: the kinds that can occur; others are not traced.
    """
    gap = jnp.full(r.shape, jnp.inf, a.dtype)
    if SPHERE in kinds:
        sphere = jax.vmap(segment_point, in_axes=(0, 0, None))(a, b, p) - size[0]
        gap = jnp.where(kind == SPHERE, sphere, gap)
    if BOX in kinds:
        to_box = jax.vmap(segment_oriented_box, in_axes=(0, 0, None, None, None))
        gap = jnp.where(kind == BOX, to_box(a, b, p, q, size), gap)
    if CAPSULE in kinds:
        axis = rotate(q, jnp.stack([jnp.zeros_like(size[1]), jnp.zeros_like(size[1]), size[1]]))
        to_axis = jax.vmap(segment_segment, in_axes=(0, 0, None, None))
        gap = jnp.where(kind == CAPSULE, to_axis(a, b, p - axis, p + axis) - size[0], gap)
    return jnp.min(gap - r)


def _squared_length(v: Vector) -> jax.Array:
    """Return the squared length [] of a vector."""
    return _dot(v, v)


def _dot(u: Vector, v: Vector) -> jax.Array:
    """Return the inner product [] of two vectors, written out."""
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


def _safe_sqrt(square: jax.Array) -> jax.Array:
    """Return the square root [] whose derivative at zero is zero instead of infinite."""
    return jnp.where(square > 0.0, jnp.sqrt(jnp.where(square > 0.0, square, 1.0)), 0.0)


def _nearest_parameter(d: jax.Array, to_point: Vector) -> jax.Array:
    """Return the parameter in [0, 1] of the point of a segment d nearest to a point.

    Both are relative to the start of the segment. A constant to gradients.
    """
    square = _squared_length(d)
    s = _dot(d, to_point) / jnp.where(square > 0.0, square, 1.0)
    return jax.lax.stop_gradient(jnp.clip(s, 0.0, 1.0))


def _common_normal(d1: jax.Array, d2: jax.Array, gap: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the parameters of the feet of two lines' common normal, clipped to [0, 1]; 0 if none.

    The determinant is taken as |d1 x d2|^2, which keeps its digits where the lines are nearly
    parallel; |d1|^2 |d2|^2 - (d1 . d2)^2 does not.
    """
    normal = _cross(d1, d2)
    det = _squared_length(normal)
    s1 = -_dot(_cross(gap, d2), normal) / jnp.where(det > 0.0, det, 1.0)
    s1 = jax.lax.stop_gradient(jnp.clip(s1, 0.0, 1.0))
    return s1, _nearest_parameter(d2, [gap[i] + s1 * d1[i] for i in range(3)])


def _cross(u: jax.Array, v: jax.Array) -> list[jax.Array]:
    """Return the vector product of two vectors [3], as three scalars."""
    return [u[i] * v[j] - u[j] * v[i] for i, j in ((1, 2), (2, 0), (0, 1))]
