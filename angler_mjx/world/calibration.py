"""Conversion from a requested density to the initial fill of the automaton.

The density of a rule's result has no closed form, so it is measured once and shipped as data.
``python -m angler_mjx.world.calibration`` measures it again and rewrites the file. Cells outside
the grid count as free, so walls die at the faces and small grids end up emptier; to first order
this is proportional to the fraction of cells at a face, that is to the mean of 1/nx, 1/ny, 1/nz,
and the table is interpolated linearly in it.
"""

import json
import math
from functools import cache, partial
from importlib import resources
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels.bit_grid import count_cells
from angler_mjx.errors import ConfigError
from angler_mjx.files import FileModel, parse_model
from angler_mjx.world.rock.rules import AutomatonRule, Shape, sample_cells

_FILE = "calibration.json"
_EDGES = (8, 12, 16, 24, 32)
_CELLS_PER_POINT = 4_000_000
"""Cells per point over worlds of any size: the standard error of the density is then below 1e-3 for
every rule and size here."""
_RULES = {
    AutomatonRule(die_below=2, born_above=12, steps=1): np.round(np.arange(0.005, 0.4001, 0.01), 4),
    AutomatonRule(die_below=6, born_above=8, steps=2): np.round(np.arange(0.12, 0.2801, 0.005), 4),
}


class CalibrationTable(FileModel):
    """Mean density after the rule and the filling of closed caverns, for cubes."""

    rule: AutomatonRule
    edge_cells: tuple[int, ...]
    fill: tuple[float, ...]
    density: tuple[tuple[float, ...], ...]
    """One row per edge, one value per fill; increasing along each row."""


class _Tables(FileModel):
    made_by: str
    tables: tuple[CalibrationTable, ...]


def fill_for_density(rule: AutomatonRule, shape: Shape, density: float) -> float:
    """Return the fraction of random walls that gives a density, on average over worlds.

    Raises:
        ConfigError: the rule was never measured, or the density is outside the measured range.
    """
    table = _load_tables().get(rule)
    if table is None:
        raise ConfigError(
            f"rule = {rule.model_dump()}: its density has not been measured; give fill instead of "
            "density, or a rule of one of the presets"
        )
    densities = _densities_for(table, shape)
    if not densities[0] <= density <= densities[-1]:
        raise ConfigError(
            f"density = {density}: this rule reaches {densities[0]:.4f} to {densities[-1]:.3f} on "
            f"{shape[0]} x {shape[1]} x {shape[2]} cells"
        )
    return float(np.interp(density, densities, table.fill))


def _densities_for(table: CalibrationTable, shape: Shape) -> np.ndarray:
    """Return the densities at the fills of the table, for a shape."""
    face_fraction = float(np.mean(1.0 / np.array(shape)))
    table_fractions = 1.0 / np.array(table.edge_cells)
    if not table_fractions.min() <= face_fraction <= table_fractions.max():
        raise ConfigError(
            f"shape = {shape}: density is known for grids like cubes of {min(table.edge_cells)} to "
            f"{max(table.edge_cells)} cells; give fill instead of density"
        )
    columns = np.array(table.density).T
    return np.array(
        [np.interp(face_fraction, table_fractions[::-1], column[::-1]) for column in columns]
    )


@cache
def _load_tables() -> dict[AutomatonRule, CalibrationTable]:
    path = resources.files("angler_mjx.world") / "data" / _FILE
    data = json.loads(path.read_text(encoding="utf-8"))
    return {table.rule: table for table in parse_model(_Tables, data, source=_FILE).tables}


def measure_densities(
    rule: AutomatonRule, fills: np.ndarray, edges: tuple[int, ...] = _EDGES
) -> CalibrationTable:
    """Measure the mean densities of a rule; all fills share random numbers, for smooth curves."""
    rows = []
    for edge in edges:
        n_world = min(256, max(8, 1_000_000 // edge**3))
        n_batch = -(-_CELLS_PER_POINT // (n_world * edge**3))
        of_batch = jax.jit(partial(_mean_density, rule, (edge, edge, edge), n_world))
        keys = jax.random.split(jax.random.key(edge), n_batch)
        measured = [np.mean([of_batch(fill, key) for key in keys]) for fill in fills]
        # Two fills may give equal densities within the error; the inverse needs a rising curve.
        rows.append(tuple(np.round(np.maximum.accumulate(np.array(measured, float)), 6).tolist()))
    return CalibrationTable(
        rule=rule, edge_cells=edges, fill=tuple(fills.tolist()), density=tuple(rows)
    )


def _mean_density(
    rule: AutomatonRule, shape: Shape, n_world: int, fill: jax.Array, key: jax.Array
) -> jax.Array:
    occupied = sample_cells(rule, shape, fill, jax.random.split(key, n_world))
    return jnp.mean(count_cells(occupied).astype(jnp.float32)) / math.prod(shape)


def main() -> None:
    """Measure all rules of the presets and rewrite the table."""
    tables = tuple(measure_densities(rule, fills) for rule, fills in _RULES.items())
    content = _Tables(made_by="python -m angler_mjx.world.calibration", tables=tables)
    Path(__file__).with_name("data").joinpath(_FILE).write_text(
        json.dumps(content.model_dump(), indent=1) + "\n", encoding="utf-8"
    )


if __name__ == "__main__":
    main()
