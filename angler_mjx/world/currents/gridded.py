"""Currents from an ocean model's file: one field for all worlds, each at its position and time."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, Self

import jax
import jax.numpy as jnp
import numpy as np
from pydantic import Field as Key
from pydantic import ValidationInfo, field_validator, model_validator

from angler_kernels.gridded_field import gridded_velocity
from angler_mjx.errors import format_value
from angler_mjx.files import FileModel, absolute_path, format_path
from angler_mjx.quantities import MAX_SPEED_MPS
from angler_mjx.sampling import fold_keys
from angler_mjx.world.currents.fields import Current, Flow
from angler_mjx.world.ocean import OceanField, load_field
from angler_mjx.world.ocean.deepest_cells import (
    DeepestCells,
    Span,
    find_deepest_cells,
    locate_origin,
    span_in,
)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Gridded:
    """A field on a grid of positions and times, linear between knots and held beyond the ends.

    All worlds share the field, which is no part of a world's arrays: programs hold its numbers.
    """

    knot: jax.Array
    """int32 [4] along y, x, depth and time: reference knots of the world's origin and start."""
    rest: jax.Array
    """[4] offsets of origin and start from these knots, in units of the field's axes."""
    rate: jax.Array
    """[4] positions on the axes per metre along y, x and z of W, and per second."""
    factor: jax.Array
    """[3] factors on the velocity along x, y and z."""
    field: OceanField = field(metadata={"static": True})
    numbers: Any = None
    """Location of the field's ``numbers`` for kernels; None for the field's own."""

    def flow(self, p: jax.Array, t: jax.Array) -> Flow:
        """See `Component.flow`."""
        numbers = self.numbers
        if numbers is None:
            # The same arrays in every call: a program then holds them once.
            numbers = tuple(array.astype(p.dtype, copy=False) for array in self.field.numbers)
        values, *uneven = numbers
        long = [axis.step is None and not axis.knots for axis in self.field.axes]
        axes = [
            (axis, uneven.pop(0) if is_long else None)
            for axis, is_long in zip(self.field.axes, long, strict=True)
        ]
        return gridded_velocity(
            p, t, values, self.field.shape, axes, self.knot, self.rest, self.rate, self.factor
        )

    def scaled(self, factor: jax.Array) -> Self:
        """See `Component.scaled`."""
        return replace(self, factor=factor * self.factor)


def list_fields(current: Current) -> tuple[OceanField, ...]:
    """Return the fields of a current, each once."""
    fields = [component.field for component in current if isinstance(component, Gridded)]
    return tuple(dict.fromkeys(fields))


def bind_fields(current: Current, where: Callable[[OceanField], Sequence[Any]]) -> Current:
    """Return a current whose fields are read from the location that ``where`` returns."""
    return tuple(
        replace(component, numbers=tuple(where(component.field)))
        if isinstance(component, Gridded)
        else component
        for component in current
    )


class ScaleConfig(FileModel):
    """Scale factors of a field for tanks and rivers: size and speed."""

    space: float = Key(default=1.0, ge=1e-6, le=1e6)
    """Metres here per metre of the file, horizontally."""
    depth: float = Key(default=1.0, ge=1e-6, le=1e6)
    """Metres here per metre of depth in the file."""
    speed: float = Key(default=1.0, ge=0.0, le=1e3)
    """Horizontal speed here over that of the file; the vertical speed is scaled by depth / space in
    addition."""
    time: float | None = Key(default=None, ge=1e-6, le=1e9)
    """Seconds here per second of the file; space / speed if left out: drifting bodies then pass the
    same pattern."""

    @property
    def seconds(self) -> float:
        """Return the seconds here per second of the file."""
        if self.time is not None:
            return self.time
        return self.space / self.speed if self.speed else 1.0


@jax.tree_util.register_static
@dataclass(frozen=True, kw_only=True)
class GridSampler:
    """Sampler of a `GridConfig`; see `CurrentSampler`. Programs hold its numbers and its field."""

    config: "GridConfig"
    horizon_s: float

    def sample(self, key: jax.Array, lo: jax.Array, hi: jax.Array) -> Gridded:
        """Sample a position in water for the middle of the region, and a start time of its run."""
        return self.config.sample(key, lo, hi, self.horizon_s)


class GridConfig(FileModel):
    """The current of an ocean model's file; each world has its own position and time in it."""

    type: Literal["grid"] = "grid"
    file: str = Key(min_length=1, max_length=4096)
    """NetCDF file with CF conventions; see `docs/how_to/ocean.md`."""
    u: str | None = None
    """Name of the eastward velocity in the file; identified by its standard_name if left out."""
    v: str | None = None
    """Name of the northward velocity."""
    w: str | None = None
    """Name of the upward velocity; none if left out and no standard_name identifies it."""
    latitude: Span | None = None
    """Min and max latitude of worlds, in degrees (of files in metres: m along y); all of the file's
    water if left out. Two equal values are a single position."""
    longitude: Span | None = None
    """Min and max longitude, eastward (of files in metres: m along x)."""
    time: tuple[str, str] | None = None
    """Earliest and latest start, UTC, as in "2024-06-01T12:00"; if left out, any start whose whole
    run lies in the file's times."""
    coast: bool = False
    """Whether land is rock: cells whose nearest knot has no water at its depth. If not, values of
    water are extended onto land."""
    scale: ScaleConfig = ScaleConfig()

    @field_validator("file")
    @classmethod
    def _resolve_path(cls, file: str, info: ValidationInfo) -> str:
        """Return the absolute path of a path relative to the scenario's folder."""
        return absolute_path(file, info)

    @model_validator(mode="after")
    def _check_span(self) -> Self:
        _ = self.field  # errors of the file name it
        try:
            self._find_deepest_cells()
            self.starts_s(0.0)
            self._require_slow()
        except ValueError as error:
            raise ValueError(f"{error} ({format_path(self.file)})") from error
        return self

    def _require_slow(self) -> None:
        """Require that the scaled field does not exceed the speed limit of currents."""
        values, scale = self.field.values, self.scale
        factor = np.array([1.0, 1.0, scale.depth / scale.space], np.float32)
        squares = np.square(values * factor[: values.shape[-1]])
        fastest = scale.speed * float(np.sqrt(np.sum(squares, axis=-1).max()))
        if fastest > MAX_SPEED_MPS:
            raise ValueError(
                f"scale: makes {fastest:g} m/s of the file's water; no faster than "
                f"{MAX_SPEED_MPS:g} m/s, give a smaller speed"
            )

    @property
    def field(self) -> OceanField:
        """Return the field of the file."""
        return load_field(self.file, {"u": self.u, "v": self.v, "w": self.w})

    @cached_property
    def deepest_cells(self) -> DeepestCells:
        """Return the cells in which worlds may lie."""
        return self._find_deepest_cells()

    def _find_deepest_cells(self) -> DeepestCells:
        field = self.field
        y = span_in("latitude", self.latitude, field.knots[0])
        x = span_in("longitude", self.longitude, field.knots[1], turns=field.degrees)
        return find_deepest_cells(field.wet, field.knots, field.degrees, y, x)

    def starts_s(self, horizon_s: float) -> Span:
        """Return the earliest and latest start, in seconds after the file's first time.

        Args:
            horizon_s: horizon of a run, which must end within the file's times.

        Raises:
            ValueError: there is no such start.
        """
        knots = self.field.knots[3]
        if len(knots) == 1:
            return 0.0, 0.0
        last = float(knots[-1]) - horizon_s / self.scale.seconds
        begin = np.datetime64(self.field.begin)
        covered = f"{self.field.begin} to {begin + np.timedelta64(int(knots[-1]), 's')}"
        if last < 0.0:
            raise ValueError(
                f"file: covers {covered}, {knots[-1]:g} s; a run of {horizon_s:g} s "
                f"(time.horizon_s) takes {horizon_s / self.scale.seconds:g} s of them"
            )
        if self.time is None:
            return 0.0, last
        try:
            low, high = ((np.datetime64(one) - begin) / np.timedelta64(1, "s") for one in self.time)
        except ValueError as error:
            raise ValueError(
                f"time = {format_value(list(self.time))}: must be two times as in 2024-06-01T12:00"
            ) from error
        if not 0.0 <= low <= high <= last:
            raise ValueError(
                f"time = {format_value(list(self.time))}: needs early <= late within the file's "
                f"{covered}"
                + (f", {horizon_s:g} s (time.horizon_s) before their end" if horizon_s else "")
            )
        return float(low), float(high)

    def sampler(self, horizon_s: float) -> GridSampler:
        """Return the sampler of a run."""
        return GridSampler(config=self, horizon_s=horizon_s)

    def sample(self, key: jax.Array, lo: jax.Array, hi: jax.Array, horizon_s: float) -> Gridded:
        """Sample a position in water for the middle of the region, and a start time of its run."""
        field, scale = self.field, self.scale
        position_key, time_key = fold_keys(key, 2)
        depth = jnp.asarray(field.knots[2], float)
        middle = -0.5 * (lo[2] + hi[2]) / scale.depth
        level = jnp.clip(jnp.searchsorted(depth, middle, side="right") - 1, 0)
        count = jnp.asarray(self.deepest_cells.count)
        level = jnp.minimum(level, jnp.sum(count > 0) - 1)
        knot, beyond = self.deepest_cells.sample(position_key, level)
        centre = 0.5 * (lo + hi)
        rest, rate = locate_origin(knot, beyond, field.knots, field.degrees, scale.space, centre)
        early, late = self.starts_s(horizon_s)
        times = field.knots[3]
        first = max(int(np.searchsorted(times, early, side="right")) - 1, 0)
        since = (early - times[first]) + jax.random.uniform(time_key, (), float) * (late - early)
        # Relative to the knot before it: float32 cannot resolve seconds after years.
        after = jnp.asarray(times[first:] - times[first], float)
        past = jnp.clip(jnp.searchsorted(after, since, side="right") - 1, 0)
        others = jnp.stack([jnp.full((), -field.knots[2][0]), since - after[past]])
        return Gridded(
            knot=jnp.concatenate([knot, jnp.stack([jnp.zeros_like(past), first + past])]),
            rest=jnp.concatenate([rest, others]).astype(lo.dtype),
            rate=jnp.concatenate(
                [rate, jnp.array([-1.0 / scale.depth, 1.0 / scale.seconds])]
            ).astype(lo.dtype),
            factor=scale.speed * jnp.array([1.0, 1.0, scale.depth / scale.space], lo.dtype),
            field=field,
        )
