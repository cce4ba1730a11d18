"""The world table of a scenario file, and its resolution to a recipe.

`WorldConfig` is the user's table: a preset and changes to it. `resolve_world` fills in all other
values from the preset and returns a `WorldRecipe`: complete, hashable, unique. `generate` takes the
recipe as a static argument, and `WorldNumbers` as an argument of the program.
"""

from dataclasses import dataclass
from typing import Annotated, Literal, Self

import jax
import numpy as np
from pydantic import Field, field_validator, model_validator

from angler_mjx.errors import ConfigError
from angler_mjx.files import FileModel
from angler_mjx.host_arrays import as_leaf, as_numbers
from angler_mjx.quantities import Coordinate, Length, PositiveLength
from angler_mjx.world import calibration, presets
from angler_mjx.world.currents import (
    CurrentConfig,
    CurrentSampler,
    GridConfig,
    build_samplers,
    ground,
)
from angler_mjx.world.currents.ground import BathymetryConfig
from angler_mjx.world.obstacles import DriftingSampler, ObstaclesConfig
from angler_mjx.world.rock.rules import AutomatonRule, CellsRule, OpenRule, Rule, WallsRule

type Vector = tuple[Coordinate, Coordinate, Coordinate]
type Placement = Literal["cross", "parallel", "random", "given"]
Cells = Annotated[int, Field(ge=2, le=128)]
Layers = Annotated[int, Field(ge=1, le=128)]
Fraction = Annotated[float, Field(ge=0, lt=1)]


class WorldConfig(FileModel):
    """The world of a scenario: a preset and changes to it; other keys are those of the preset."""

    preset: str = "reef"
    """Name of a shipped preset: angler2024, sparse, reef, dense, corridor, open,
    angler_nine_boxes."""
    density: Fraction | None = None
    """Fraction of occupied cells, on average over worlds."""
    fill: Fraction | None = None
    """Fraction of walls before the rule is applied, instead of density."""
    shape: tuple[Cells, Cells, Layers] | None = None
    """Number of cells along x, y, z; one along z for vehicles in the plane."""
    cell_m: Annotated[float, Field(ge=0.01, le=1000)] | None = None
    """Edge length of a cell."""
    depth_m: Length | None = None
    """Depth of the top of the grid below the surface."""
    floor_depth_m: PositiveLength | None = None
    """Depth of the sea floor; the bottom of the grid if neither file nor preset gives it."""
    rule: Rule | None = None
    """Rule that generates the cells of rock."""
    min_obstacles: Annotated[int, Field(ge=0, le=128**3)] | None = None
    """Min number of occupied cells; worlds with fewer are sampled again."""
    redraw_limit: Annotated[int, Field(ge=0, le=1_000_000)] = 100
    """Max number of resamplings of a world; a world that still cannot hold the fleet is given
    up."""
    placement: Placement | None = None
    """Starts and goals of robots: each from a different corner, side by side, random, or given."""
    clearance_m: Length = 0.3
    """Free water between two robots at their starts, and at their goals."""
    start_m: tuple[Vector, ...] = ()
    """Starts of the robots, for placement = "given"."""
    goal_m: tuple[Vector, ...] = ()
    """Goals of the robots, for placement = "given"."""
    currents: tuple[CurrentConfig, ...] = ()
    """Components of the current; their sum is the current."""
    bathymetry: BathymetryConfig | None = None
    """Sea floor from a file."""
    obstacles: ObstaclesConfig | None = None
    """Obstacles beside the cells of rock."""

    @property
    def files(self) -> tuple[str, ...]:
        """Return the files of its ocean models, each once."""
        files = [component.file for component in self.currents if isinstance(component, GridConfig)]
        files += [self.bathymetry.file] if self.bathymetry else []
        return tuple(dict.fromkeys(files))

    @property
    def file_digests(self) -> tuple[str, ...]:
        """Return the digests of what its files hold now; programs hold it too."""
        grids = [component for component in self.currents if isinstance(component, GridConfig)]
        digests = [component.field.digest for component in grids]
        return (*digests, self.bathymetry.floor.digest) if self.bathymetry else tuple(digests)

    @property
    def held_bytes(self) -> int:
        """Return the bytes of its current fields, which programs hold once for all worlds."""
        grids = [component for component in self.currents if isinstance(component, GridConfig)]
        return sum(sum(part.nbytes for part in component.field.numbers) for component in grids)

    @field_validator("preset")
    @classmethod
    def _check_preset(cls, name: str) -> str:
        presets.load_preset(name)
        return name

    @model_validator(mode="after")
    def _check_files(self) -> Self:
        ground.check_files(self.currents, self.bathymetry)
        return self

    @model_validator(mode="after")
    def _check_resolves(self) -> Self:
        resolve_world(self)
        return self


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class WorldNumbers:
    """Numbers of a recipe that programs take as arguments; the recipe itself is static.

    Worlds that differ in them alone are sampled by the same program.
    """

    fill: jax.Array
    """[] fraction of walls before the rule."""
    floor_z_m: jax.Array
    """[] height of the sea floor, m, W."""
    clearance_m: jax.Array
    """[] free water between robots at their starts and goals."""
    min_obstacles: jax.Array
    """int32 [] min number of occupied cells."""
    redraw_limit: jax.Array
    """int32 [] max number of resamplings."""
    currents: tuple[CurrentSampler, ...]
    drifting: DriftingSampler | None
    """None without sampled obstacles."""


class WorldRecipe(FileModel):
    """A fully resolved world config. Lengths in metres, W."""

    shape: tuple[int, int, int]
    cell_m: float
    origin_m: Vector
    """Lower corner of the grid, whose centre has x = y = 0."""
    floor_z_m: float
    rule: Rule
    fill: float
    min_obstacles: int
    redraw_limit: int
    placement: Placement
    clearance_m: float
    start_m: tuple[Vector, ...]
    goal_m: tuple[Vector, ...]
    currents: tuple[CurrentConfig, ...]
    bathymetry: BathymetryConfig | None
    obstacles: ObstaclesConfig

    def numbers(self, horizon_s: float) -> WorldNumbers:
        """Return the arguments of programs (host side).

        Args:
            horizon_s: time that the current covers.
        """
        return WorldNumbers(
            fill=as_numbers(self.fill),
            floor_z_m=as_numbers(self.floor_z_m),
            clearance_m=as_numbers(self.clearance_m),
            min_obstacles=as_leaf(np.int32(self.min_obstacles)),
            redraw_limit=as_leaf(np.int32(self.redraw_limit)),
            currents=build_samplers(self.currents, horizon_s),
            drifting=DriftingSampler.of(self.obstacles.dynamic),
        )

    @property
    def has_ground(self) -> bool:
        """Return whether files give the rock."""
        coasts = [
            component.coast for component in self.currents if isinstance(component, GridConfig)
        ]
        return self.bathymetry is not None or any(coasts)

    @property
    def is_empty(self) -> bool:
        """Return whether its worlds have no static obstacles: only water between flat faces."""
        bare = isinstance(self.rule, OpenRule) and not self.obstacles.explicit
        return bare and not self.has_ground

    @property
    def size_m(self) -> Vector:
        """Return the edges of the grid."""
        x, y, z = (n * self.cell_m for n in self.shape)
        return x, y, z


def resolve_world(config: WorldConfig) -> WorldRecipe:
    """Return the recipe of a world config.

    Raises:
        ConfigError: unknown preset, or values that contradict each other.
    """
    preset = presets.load_preset(config.preset)
    shape = config.shape or preset.shape
    cell = config.cell_m or preset.cell_m
    depth = preset.depth_m if config.depth_m is None else config.depth_m
    floor_depth = config.floor_depth_m or preset.floor_depth_m or depth + shape[2] * cell
    if floor_depth <= depth + cell:
        raise ConfigError(
            f"floor_depth_m = {floor_depth}: must lie at least a cell ({cell} m) below the top of "
            f"the grid, which is at a depth of {depth} m"
        )
    rule = config.rule or preset.rule
    if isinstance(rule, WallsRule | CellsRule):
        rule.check(shape)
    obstacles = config.obstacles or preset.obstacles
    if obstacles.dynamic.count > 0 and obstacles.dynamic.radius_m[1] >= cell:
        raise ConfigError(
            f"obstacles.dynamic.radius_m = {obstacles.dynamic.radius_m}: drifting ones must be "
            f"smaller in radius than a cell (cell_m = {cell})"
        )
    placement = config.placement or preset.placement
    _check_positions(config, placement)
    return WorldRecipe(
        shape=shape,
        cell_m=cell,
        origin_m=(-0.5 * shape[0] * cell, -0.5 * shape[1] * cell, -depth - shape[2] * cell),
        floor_z_m=-floor_depth,
        rule=rule,
        fill=_resolve_fill(config, preset, rule, shape),
        min_obstacles=(
            preset.min_obstacles if config.min_obstacles is None else config.min_obstacles
        ),
        redraw_limit=config.redraw_limit,
        placement=placement,
        clearance_m=config.clearance_m,
        start_m=config.start_m,
        goal_m=config.goal_m,
        currents=config.currents,
        bathymetry=config.bathymetry,
        obstacles=obstacles,
    )


def _resolve_fill(
    config: WorldConfig, preset: presets.Preset, rule: Rule, shape: tuple[int, int, int]
) -> float:
    """Return the fraction of walls before the rule; 0 for rules that do not use random walls."""
    density, fill = config.density, config.fill
    if density is not None and fill is not None:
        raise ConfigError(f"density = {density} and fill = {fill}: give one of them, not both")
    if density is None and fill is None:
        density, fill = preset.density, preset.fill
    if not isinstance(rule, AutomatonRule):
        if config.density is not None or config.fill is not None:
            key = "density" if config.density is not None else "fill"
            raise ConfigError(
                f"{key} = {config.density or config.fill}: has no meaning for rule "
                f"{rule.type!r} (preset {config.preset!r}); leave it out or take another preset"
            )
        return 0.0
    if fill is not None:
        return fill
    if density is None:
        raise ConfigError(f"rule {rule.type!r} with preset {config.preset!r} needs a density")
    return calibration.fill_for_density(rule, shape, density)


def _check_positions(config: WorldConfig, placement: str) -> None:
    n_start, n_goal = len(config.start_m), len(config.goal_m)
    if n_start != n_goal:
        raise ConfigError(f"start_m has {n_start} places and goal_m {n_goal}: needs one each")
    if (placement == "given") != (n_start > 0):
        raise ConfigError(
            f"placement = {placement!r} with {n_start} places in start_m: places and "
            'placement = "given" go together'
        )
