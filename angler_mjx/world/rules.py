"""How the static cells of a world come about: the rules that a preset or a file can name.

Each rule is a model for files; `draw_cells` turns one and a random key into cells. What it gives
is always one cavern: free cells that the largest cavern does not reach are filled.
"""

from typing import Annotated, Literal

import jax
import jax.numpy as jnp
from pydantic import Field

from angler_kernels.caverns import largest_cavern
from angler_kernels.cellular_automaton import step
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


class WallsRule(FileModel):
    """Walls one cell thick across the grid, at right angles to x, each with one square gate."""

    type: Literal["walls"] = "walls"
    count: int = Field(default=3, ge=1)
    gate_cells: int = Field(default=3, ge=1)

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
    """No cells at all."""

    type: Literal["open"] = "open"


type Rule = Annotated[AutomatonRule | WallsRule | OpenRule, Field(discriminator="type")]


def draw_cells(
    rule: AutomatonRule | WallsRule | OpenRule,
    shape: Shape,
    fill: float | jax.Array,
    key: jax.Array,
) -> jax.Array:
    """Occupied cells, bool [nx, ny, nz], of one world.

    Args:
        rule: static.
        shape: number of cells along x, y, z; static.
        fill: [] share of walls that an automaton starts from.
        key: random key of this world's cells.
    """
    match rule:
        case AutomatonRule():
            wall = jax.random.uniform(key, shape, jnp.float32) < fill
            for _ in range(rule.steps):
                wall = step(wall, rule.die_below, rule.born_above)
            return ~largest_cavern(~wall)
        case WallsRule():
            return _walls(rule, shape, key)
        case OpenRule():
            return jnp.zeros(shape, bool)


def _walls(rule: WallsRule, shape: Shape, key: jax.Array) -> jax.Array:
    """Evenly spaced walls; the gate of each is drawn uniformly over all its places."""
    nx, ny, nz = shape
    # i-th wall of n: the cells before, between and after differ by one at most.
    at_x = jnp.array([(i + 1) * nx // (rule.count + 1) for i in range(rule.count)])
    span = jnp.array([ny, nz]) - rule.gate_cells + 1
    corner = jax.random.randint(key, (rule.count, 2), 0, span)
    y, z = jnp.arange(ny)[:, None], jnp.arange(nz)
    in_y = (y >= corner[:, :1, None]) & (y < corner[:, :1, None] + rule.gate_cells)
    in_z = (z >= corner[:, 1:, None]) & (z < corner[:, 1:, None] + rule.gate_cells)
    return jnp.zeros(shape, bool).at[at_x].set(~(in_y & in_z))
