"""What stays the same of a tile of worlds during a segment, laid out for kernels."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import lanes
from angler_kernels.lanes.planes import PlaneLayout, SampleBuffer
from angler_mjx.robot.control.plans import Plan
from angler_mjx.robot.control.stack import ControlParams
from angler_mjx.sim.engines.cuda import launch
from angler_mjx.sim.engines.cuda.bank import ConstantBank
from angler_mjx.sim.engines.lanes.layout import grid_shape, pack_cells
from angler_mjx.sim.engines.lanes.steps import Cells
from angler_mjx.sim.fleet import Fleet, VehicleGroup, laden_cruise
from angler_mjx.sim.state import EngineConstants, World
from angler_mjx.world.currents import Current, bind_fields, list_fields
from angler_mjx.world.environment import region_corners
from angler_mjx.world.obstacles import Obstacles
from angler_mjx.world.obstacles.types import bounding_radius
from angler_mjx.world.ocean import OceanField

type Refs = Sequence[jax.Ref]
"""References of a kernel to `Tile.arrays`."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class RobotConstants:
    """Of one robot."""

    variant: jax.Array
    path: Plan
    goal_m: jax.Array
    cruise_speed_mps: jax.Array
    laden_cruise_mps: jax.Array | None
    """With their load; None where there are none, as with the next."""
    fails_at_s: jax.Array | None


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class WorldConstants:
    """Of one world."""

    current: Current
    origin_m: jax.Array
    cell_m: jax.Array
    floor_z_m: jax.Array
    lo: jax.Array
    hi: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class BodyConstants:
    """Of one obstacle."""

    obstacle: Obstacles
    reach: jax.Array
    """Radius of the bounding sphere, m; -inf for padding."""


class Tile:
    """Constants of worlds in flat arrays, and where their parts lie.

    Worlds [W] that fly are those whose constants are given, or some of them: lanes then look up
    which one they are.

    Attributes:
        worlds, robots, obstacles: numbers of them; obstacles [in each world] include padding.
        some_rows: whether lanes look up which world they are.
        some_obstacle: whether any row of obstacles can be more than padding.
        grid: cells along x, y and z.
        groups: of the fleet.
        dtype: of all numbers.
        arrays: what kernels are given: see ``read_*`` for what is in them, and at the end what the
            currents of all worlds look up.
    """

    def __init__(
        self,
        fleet: Fleet,
        worlds: World,
        rows: jax.Array | None = None,
        constants: EngineConstants = (),
        cells: jax.Array | None = None,
    ) -> None:
        """Pack a tile.

        Args:
            fleet: of the worlds.
            worlds: [B] of which there are constants.
            rows: int32 [W] which of them fly; all, in order, if left out.
            constants: of `constants`, of the same fleet and worlds, where it is there.
            cells: of `pack_cells`, of the same worlds; packed now if left out.
        """
        environment = worlds.environment
        self.dtype = environment.start_m.dtype
        self._stored, self.robots = environment.start_yaw_rad.shape
        self.worlds = self._stored if rows is None else rows.shape[0]
        self.some_rows = rows is not None
        self.obstacles = environment.obstacles.kind.shape[1]
        self.some_obstacle = bool(environment.obstacles.kinds)
        self.grid = grid_shape(environment)
        self.groups = fleet.groups
        self._numbered = fleet.loaded_variant
        self._bank, bank = ConstantBank.of(fleet, self.dtype)
        neighbours = pack_cells(worlds) if cells is None else cells
        self._cells = neighbours[0].size
        self._robot, robot = self.pack(
            RobotConstants(
                variant=worlds.variant,
                path=worlds.path,
                goal_m=environment.goal_m,
                cruise_speed_mps=worlds.cruise_speed_mps,
                laden_cruise_mps=laden_cruise(fleet, worlds) if fleet.can_carry else None,
                fails_at_s=worlds.fails_at_s,
            ),
            2,
        )
        lo, hi = jax.vmap(region_corners)(environment)
        self._world, water = self.pack(
            WorldConstants(
                current=environment.current,
                origin_m=environment.grid.origin_m,
                cell_m=environment.grid.cell_m,
                floor_z_m=environment.floor_z_m,
                lo=lo,
                hi=hi,
            ),
            1,
        )
        obstacles = environment.obstacles
        radius = jax.vmap(jax.vmap(bounding_radius))(obstacles.kind, obstacles.size_m)
        reach = jnp.where(obstacles.exists, radius, -jnp.inf)
        self._body, body = self.pack(BodyConstants(obstacle=obstacles, reach=reach), 2)
        which = jnp.zeros(1, jnp.int32) if rows is None else rows
        self.constants: EngineConstants = constants or (
            bank,
            robot,
            water,
            body,
            neighbours.reshape(-1),
        )
        self._fields = list_fields(environment.current)
        tables = [jnp.asarray(x, self.dtype) for field in self._fields for x in field.numbers]
        self.arrays = (*self.constants, which, *tables)

    def pack[T](self, tree: T, lead: int) -> tuple[PlaneLayout[T], jax.Array]:
        """A tree of arrays [W, (n,) ...] flat, and where its parts lie."""
        layout = PlaneLayout.of(tree, lead)
        return layout, layout.pack(tree, self.dtype)

    def shape(self, *tail: int) -> jax.ShapeDtypeStruct:
        """Shape of numbers of one body."""
        return jax.ShapeDtypeStruct(tail, self.dtype)

    def layout(self, tree: object, rows: int) -> PlaneLayout[Any]:
        """Layout of arrays [W, rows, ...], from shapes [...] of one body."""
        shapes = jax.tree.map(
            lambda leaf: jax.ShapeDtypeStruct((self.worlds, rows, *leaf.shape), leaf.dtype), tree
        )
        return PlaneLayout.of(shapes, 2)

    def sample_buffer[T](self, layout: PlaneLayout[T], samples: int) -> SampleBuffer[T]:
        """Room for samples of a layout."""
        return SampleBuffer(
            layout=layout, samples=samples, rows=layout.lanes // self.worlds, worlds=self.worlds
        )

    def world_index(self, refs: Refs, at: jax.Array) -> jax.Array:
        """Whose constants those of worlds number ``at`` are, in a kernel given ``arrays``."""
        return refs[5][at] if self.some_rows else at

    def body_of(self, row: jax.Array, world: jax.Array) -> jax.Array:
        """Number of the constants of bodies number ``row`` of ``world``, robots or obstacles."""
        return row * self._stored + world

    def read_robot(self, refs: Refs, lane: jax.Array) -> RobotConstants:
        """Constants of robots number ``lane``; see `body_of`."""
        return self._robot.read_lanes(launch.make_loader(refs[1]), lane)

    def params(
        self,
        refs: Refs,
        group: VehicleGroup,
        constants: RobotConstants,
        loaded: jax.Array | None = None,
    ) -> ControlParams:
        """Parameters of robots of a group; ``loaded`` says who carries something, if any can."""
        variant, cruise = constants.variant[()], constants.cruise_speed_mps
        if loaded is not None and constants.laden_cruise_mps is not None:
            variant = self._numbered(variant, loaded)
            cruise = lanes.select_lanes(loaded, constants.laden_cruise_mps, cruise)
        params = self._bank.read_lanes(launch.make_loader(refs[0]), group, variant)
        return replace(params, cruise_speed_mps=cruise)

    def params_at(self, refs: Refs, group: VehicleGroup, lane: jax.Array) -> ControlParams:
        """Parameters of robots number ``lane`` of a group, but for their cruise speeds."""
        variant = self._robot.read_part(launch.make_loader(refs[1]), lane, lambda x: x.variant)
        return self._bank.read_lanes(launch.make_loader(refs[0]), group, variant[()])

    def read_water(self, refs: Refs, at: jax.Array) -> WorldConstants:
        """Constants of worlds number ``at``."""
        return self._world.read_lanes(launch.make_loader(refs[2]), at)

    def current(self, refs: Refs, water: WorldConstants) -> Current:
        """The current of worlds, and where it looks up what all of them share."""
        first, field_refs = 6, {}
        for field in self._fields:
            field_refs[field] = refs[first : first + len(field.numbers)]
            first += len(field.numbers)

        def where(field: OceanField) -> list[lanes.LookupTable]:
            both = zip(field_refs[field], field.numbers, strict=True)
            return [
                lanes.LookupTable(launch.make_loader(ref), x.shape, self.dtype) for ref, x in both
            ]

        return bind_fields(water.current, where)

    def read_body[T](self, refs: Refs, index: jax.Array, only: Callable[[BodyConstants], T]) -> T:
        """A part of the constants of obstacles number ``index``."""
        return self._body.read_part(launch.make_loader(refs[3]), index, only)

    def read_cells(self, refs: Refs, water: WorldConstants, at: jax.Array) -> Cells:
        """Cells of worlds number ``at``."""
        base = at * np.int32(self._cells)
        load = launch.make_loader(refs[4])
        return Cells(
            neighbours=lanes.LookupTable(load, (self._cells,), np.int32, base=base),
            origin_m=water.origin_m,
            cell_m=water.cell_m,
            floor_z_m=water.floor_z_m,
            lo=water.lo,
            hi=water.hi,
        )
