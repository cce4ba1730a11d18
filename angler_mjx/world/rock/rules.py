"""Rules that generate the static cells of a world, as named by a preset or a file.

Each rule is a model for files; `sample_cells` turns a rule and random keys into cells, one world
for each key. The result of random rules is one cavern: free cells outside the largest one are
filled. Maps stay as they are.
"""

import math
from typing import Annotated, Literal

import jax
import jax.numpy as jnp
import numpy as np
from pydantic import Field

from angler_kernels.bit_grid import full_grid, pack_grid
from angler_kernels.caverns import largest_cavern
from angler_kernels.cellular_automaton import apply_rule
from angler_mjx.errors import ConfigError
from angler_mjx.files import FileModel

type Shape = tuple[int, int, int]


class AutomatonRule(FileModel):
    """Random walls, then a cellular automaton on the 26 neighbours: clumps that look like rock."""

    type: Literal["automaton"] = "automaton"
    die_below: int = Field(ge=0, le=27)
    """A wall with fewer neighbouring walls becomes free."""
    born_above: int = Field(ge=0, le=26)
    """A free cell with more neighbouring walls becomes a wall."""
    steps: int = Field(ge=0, le=20)
    """Number of steps of the automaton."""


class WallsRule(FileModel):
    """Walls one cell thick across the grid, at right angles to x, each with one square gate."""

    type: Literal["walls"] = "walls"
    count: int = Field(default=3, ge=1, le=128)
    """Number of walls."""
    gate_cells: int = Field(default=3, ge=1, le=128)
    """Edge of a gate, in cells."""

    def check(self, shape: Shape) -> None:
        """Raise a ConfigError if the walls do not fit between the start and goal cells."""
        if self.gate_cells > min(shape[1:]):
            raise ConfigError(
                f"rule.gate_cells = {self.gate_cells}: wider than the grid, shape = {shape}"
            )
        if 2 * self.count + 1 > shape[0]:
            raise ConfigError(
                f"rule.count = {self.count}: walls need a free cell before, between and after "
                f"them, which takes more than the {shape[0]} cells along x"
            )


class OpenRule(FileModel):
    """A grid without rock."""

    type: Literal["open"] = "open"


class MapLayer(FileModel):
    """A horizontal layer of a map, or several equal ones."""

    rows: tuple[str, ...] = Field(min_length=2, max_length=128)
    """Rows from north to south; a letter for each cell, from west to east: # rock, . water."""
    count: int = Field(default=1, ge=1, le=128)
    """Number of layers of cells that are like this one."""


class CellsRule(FileModel):
    """Cells of a map, the same in all worlds."""

    type: Literal["cells"] = "cells"
    layers: tuple[MapLayer, ...] = Field(min_length=1, max_length=128)
    """Layers from the bottom up."""

    def check(self, shape: Shape) -> None:
        """Raise a ConfigError if the map is not of the grid's shape, or has other letters."""
        layers = sum(layer.count for layer in self.layers)
        if layers != shape[2]:
            raise ConfigError(
                f"rule.layers: {layers} layers, the grid has {shape[2]}, shape = {shape}"
            )
        for i, layer in enumerate(self.layers):
            if len(layer.rows) != shape[1]:
                raise ConfigError(
                    f"rule.layers.{i}.rows: {len(layer.rows)} rows, the grid has {shape[1]} along "
                    f"y, shape = {shape}"
                )
            for j, row in enumerate(layer.rows):
                if len(row) != shape[0] or set(row) - {"#", "."}:
                    raise ConfigError(
                        f"rule.layers.{i}.rows.{j}: must be {shape[0]} letters # or ., as many as "
                        f"cells along x; has {len(row)}"
                    )

    def cells(self) -> np.ndarray:
        """Return whether each cell is rock, bool [nx, ny, nz]."""
        layers = [
            np.array([[letter == "#" for letter in row] for row in layer.rows[::-1]]).T
            for layer in self.layers
            for _ in range(layer.count)
        ]
        return np.stack(layers, axis=2)


type AnyRule = AutomatonRule | WallsRule | OpenRule | CellsRule
type Rule = Annotated[AutomatonRule | WallsRule | OpenRule | CellsRule, Field(discriminator="type")]


def sample_cells(
    rule: AnyRule,
    shape: Shape,
    fill: float | jax.Array,
    keys: jax.Array,
) -> jax.Array:
    """Sample the occupied cells of worlds.

    Args:
        rule: static.
        shape: number of cells along x, y, z; static.
        fill: [] initial fraction of walls of an automaton.
        keys: [n_world] random key of each world's cells.

    Returns:
        Packed cells, uint32 [nx, ny, words, n_world] (see `angler_kernels.bit_grid`).
    """
    whole = full_grid(shape)[..., None]
    match rule:
        case AutomatonRule():

            def at_random(key: jax.Array) -> jax.Array:
                # Sampled flat: the same numbers, and a third of the compile time.
                wall = jax.random.uniform(key, (math.prod(shape),), jnp.float32) < fill
                return pack_grid(wall.reshape(shape))

            wall = jax.vmap(at_random, out_axes=-1)(keys)
            wall = jax.lax.fori_loop(
                0,
                rule.steps,
                lambda _, wall: apply_rule(wall, rule.die_below, rule.born_above, shape[2]),
                wall,
            )
            return whole & ~largest_cavern(whole & ~wall, shape[2])
        case WallsRule():
            return jax.vmap(lambda key: pack_grid(_sample_walls(rule, shape, key)), out_axes=-1)(
                keys
            )
        case OpenRule():
            return jnp.zeros((*whole.shape[:3], keys.shape[0]), jnp.uint32)
        case CellsRule():
            packed = pack_grid(jnp.asarray(rule.cells()))[..., None]
            return jnp.broadcast_to(packed, (*packed.shape[:3], keys.shape[0]))


def _sample_walls(rule: WallsRule, shape: Shape, key: jax.Array) -> jax.Array:
    """Return evenly spaced walls; the position of each gate is sampled uniformly."""
    nx, ny, nz = shape
    # i-th wall of n: the numbers of cells before, between and after differ by one at most.
    at_x = jnp.array([(i + 1) * nx // (rule.count + 1) for i in range(rule.count)])
    span = jnp.array([ny, nz]) - rule.gate_cells + 1
    corner = jax.random.randint(key, (rule.count, 2), 0, span)
    y, z = jnp.arange(ny)[:, None], jnp.arange(nz)
    in_y = (y >= corner[:, :1, None]) & (y < corner[:, :1, None] + rule.gate_cells)
    in_z = (z >= corner[:, 1:, None]) & (z < corner[:, 1:, None] + rule.gate_cells)
    return jnp.zeros(shape, bool).at[at_x].set(~(in_y & in_z))
