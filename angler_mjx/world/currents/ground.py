"""Rock of a world from ocean-model files: sea floors by column, and coasts."""

from collections.abc import Sequence
from functools import cached_property
from typing import Literal, Self

import jax
import jax.numpy as jnp
from pydantic import Field as Key
from pydantic import ValidationInfo, field_validator, model_validator

from angler_kernels.table import take_row
from angler_mjx.files import FileModel, absolute_path, format_path
from angler_mjx.world.currents.fields import Current
from angler_mjx.world.currents.gridded import GridConfig, Gridded
from angler_mjx.world.ocean import SeaFloor, load_floor
from angler_mjx.world.ocean.deepest_cells import (
    DeepestCells,
    Span,
    find_deepest_cells,
    locate_origin,
    span_in,
)
from angler_mjx.world.ocean.floor import CellCentres, below_floor, dry_cells, knots_below


class BathymetryConfig(FileModel):
    """The sea floor of a file: in each column the cells below it are rock, and all cells of land.

    With a current of type "grid" the floor has the current's position; else worlds have their own
    positions in it.
    """

    file: str = Key(min_length=1, max_length=4096)
    """NetCDF file with CF conventions; see `docs/how_to/ocean.md`."""
    variable: str | None = None
    """Name of the sea floor's depth or height in the file; identified by its standard_name if left
    out."""
    positive: Literal["up", "down"] | None = None
    """Whether its values are heights ("up") or depths ("down"); for files without a standard_name
    or ``positive`` attribute of the variable."""
    latitude: Span | None = None
    """Min and max latitude of worlds, as in a current of type "grid"; not beside such a current."""
    longitude: Span | None = None
    """Min and max longitude, eastward; as latitude."""
    space: float | None = Key(default=None, ge=1e-6, le=1e6)
    """Metres here per metre of the file, 1 if left out; not beside a current of type "grid"."""
    depth: float | None = Key(default=None, ge=1e-6, le=1e6)
    """Metres here per metre of depth in the file, 1 if left out; not beside such a current
    either."""

    @field_validator("file")
    @classmethod
    def _resolve_path(cls, file: str, info: ValidationInfo) -> str:
        """Return the absolute path of a path relative to the scenario's folder."""
        return absolute_path(file, info)

    @model_validator(mode="after")
    def _check_span(self) -> Self:
        _ = self.floor  # errors of the file name it
        try:
            self._find_deepest_cells()
        except ValueError as error:
            raise ValueError(f"{error} ({format_path(self.file)})") from error
        return self

    @property
    def floor(self) -> SeaFloor:
        """Return the sea floor of the file."""
        return load_floor(self.file, self.variable, self.positive)

    @cached_property
    def deepest_cells(self) -> DeepestCells:
        """Return the cells in which worlds may lie, where no current gives the position."""
        return self._find_deepest_cells()

    def _find_deepest_cells(self) -> DeepestCells:
        floor = self.floor
        y = span_in("latitude", self.latitude, floor.knots[0])
        x = span_in("longitude", self.longitude, floor.knots[1], turns=floor.degrees)
        return find_deepest_cells(floor.wet[:, :, None], floor.knots, floor.degrees, y, x)


def check_files(currents: Sequence[FileModel], bathymetry: BathymetryConfig | None) -> None:
    """Refuse files that do not cover the same area.

    Args:
        currents: configs of the current's components.
        bathymetry: bathymetry of the same world, if any.

    Raises:
        ValueError: naming the key.
    """
    grids = [config for config in currents if isinstance(config, GridConfig)]
    if len(grids) > 1:
        raise ValueError(
            'currents: two of type "grid" lie at places of their own; give one, of a file that '
            "holds both"
        )
    if bathymetry is None or not grids:
        return
    for key in ("latitude", "longitude", "space", "depth"):
        if getattr(bathymetry, key) is not None:
            raise ValueError(
                f"bathymetry.{key}: the sea floor lies where the current of type "
                '"grid" does; leave it out, and say there where worlds lie'
            )
    field, floor = grids[0].field, bathymetry.floor
    if field.degrees != floor.degrees:
        raise ValueError(
            f"bathymetry.file: {bathymetry.file} and {grids[0].file} have different units of "
            "latitude and longitude; give both in degrees, or both in m"
        )
    for name, ours, theirs in zip(
        ("latitude", "longitude"), floor.knots, field.knots, strict=False
    ):
        if ours[0] > theirs[-1] or ours[-1] < theirs[0]:
            raise ValueError(
                f"bathymetry.file: {name} goes from {ours[0]:g} to {ours[-1]:g}, that of the "
                f"current from {theirs[0]:g} to {theirs[-1]:g}; give files of one area"
            )


def find_rock(
    configs: Sequence[FileModel],
    current: Current,
    bathymetry: BathymetryConfig | None,
    key: jax.Array,
    lo: jax.Array,
    hi: jax.Array,
    centres: CellCentres,
) -> jax.Array | None:
    """Return the cells bool [nx, ny, nz] of rock from files; None if no file gives rock.

    Args:
        configs: configs of the current's components.
        current: sampled current of the world.
        bathymetry: bathymetry of the world, if any.
        key: for a position of the sea floor where no current gives it.
        lo: [3] lower corner of the region, m, W.
        hi: [3] upper corner.
        centres: centres of the cells.
    """
    rock_cells = None
    grid_current = None
    for config, component in zip(configs, current, strict=True):
        if isinstance(config, GridConfig) and isinstance(component, Gridded):
            grid_current = (config, component)
    if grid_current is not None and grid_current[0].coast:
        field, component = grid_current[0].field, grid_current[1]
        rock_cells = dry_cells(
            field.wet,
            field.axes[:3],
            field.knots[:3],
            (component.knot, component.rest, component.rate),
            centres,
        )
    if bathymetry is None:
        return rock_cells
    floor = bathymetry.floor
    if grid_current is None:
        space, of_depth = bathymetry.space or 1.0, bathymetry.depth or 1.0
        knot, beyond = bathymetry.deepest_cells.sample(key, jnp.zeros((), jnp.int32))
        rest, rate = locate_origin(knot, beyond, floor.knots, floor.degrees, space, 0.5 * (lo + hi))
    else:
        config, component = grid_current
        of_depth, rate = config.scale.depth, component.rate[:2]
        parts = []
        for axis in range(2):
            below, between = knots_below(config.field.knots[axis], floor.knots[axis])
            knot_index = component.knot[axis]
            rest_of = component.rest[axis] + take_row(jnp.asarray(between, lo.dtype), knot_index)
            parts.append((take_row(jnp.asarray(below), knot_index), rest_of))
        knot, rest = (jnp.stack(part) for part in zip(*parts, strict=True))
    deep = below_floor(floor, (knot, rest, rate), of_depth, centres)
    return deep if rock_cells is None else rock_cells | deep
