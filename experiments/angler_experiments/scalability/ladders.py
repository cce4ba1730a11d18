"""Varied sizes of the cost study: one at a time, in steps of a factor."""

from dataclasses import dataclass
from pathlib import Path

from angler_mjx.files import parse_model
from angler_mjx.scenario.editing import scenario_table
from angler_mjx.scenario.scenario import Scenario, load_scenario
from angler_mjx.studies.grid import SettingAxis, iterate_cells

HEIGHT = 16
"""Number of cells vertically; the grid planner takes 32 at most, so worlds grow sideways."""
SCENARIO = Path(__file__).with_name("cost.toml")


@dataclass(frozen=True, kw_only=True)
class Ladder:
    """Varied size; all else as in ``cost.toml``."""

    name: str
    label: str
    """Label for figures."""
    key: str | None
    """Key of the scenario; None for the number of worlds, and for vehicles alone."""
    gpu: tuple[int, ...]
    """Sizes on a GPU."""
    cpu: tuple[int, ...]
    mjx: tuple[int, ...] = ()
    """Sizes on a GPU by the mjx engine, which is much slower; on a CPU as ``cpu``."""

    def axes(self, *sizes: int) -> tuple[SettingAxis, ...]:
        """Return the axis of some sizes; none where no key of the scenario is varied."""
        if self.key is None:
            return ()
        values = tuple([n, n, HEIGHT] if self.name == "cells" else n for n in sizes)
        return (SettingAxis(key=self.key, values=values, names=tuple(map(str, sizes))),)

    def count(self, size: int) -> int:
        """Return the number of varied things."""
        return size * size * HEIGHT if self.name == "cells" else size

    def sizes(self, engine: str, backend: str) -> tuple[int, ...]:
        """Return the sizes at which an engine is measured."""
        if backend == "cpu":
            return self.cpu
        return self.mjx if engine == "mjx" else self.gpu


LADDERS = (
    Ladder(
        name="dynamics",
        label="vehicles, equations of motion alone",
        key=None,
        gpu=(1024, 16_384, 262_144, 1_048_576),
        cpu=(64, 256, 1024),
        mjx=(1024, 16_384, 131_072),
    ),
    Ladder(
        name="worlds",
        label="worlds, 8 robots each",
        key=None,
        gpu=(64, 1024, 4096, 16_384, 65_536),
        cpu=(4, 16, 64),
        mjx=(64, 512, 4096),
    ),
    Ladder(
        name="robots",
        label="robots in a world",
        key="fleet.0.count",
        gpu=(1, 4, 16, 64),
        cpu=(1, 2, 4),
        mjx=(1, 4, 16),
    ),
    Ladder(
        name="obstacles",
        label="moving obstacles in a world",
        key="world.obstacles.dynamic.count",
        gpu=(4, 16, 64, 256),
        cpu=(4, 16, 64),
    ),
    Ladder(
        name="vortices",
        label="vortices in a world",
        key="world.currents.0.count",
        gpu=(1, 4, 16, 64),
        cpu=(1, 4, 16),
    ),
    Ladder(
        name="cells",
        label="cells of a world",
        key="world.shape",
        gpu=(8, 16, 32, 64),
        cpu=(8, 16, 32),
    ),
    Ladder(
        name="points",
        label="way-points of a path",
        key="planner.points",
        gpu=(8, 32, 128, 512),
        cpu=(8, 32, 128),
    ),
)
"""Ladders; the first is of vehicles alone, the others of whole worlds."""

BY_NAME = {one.name: one for one in LADDERS}


def build_scenario(ladder: Ladder, size: int, engine: str) -> Scenario:
    """Build the scenario of one rung.

    Args:
        ladder: varied size.
        size: its value.
        engine: fused or mjx.
    """
    (cell,) = iterate_cells(ladder.axes(size))
    table = cell.edit(scenario_table(load_scenario(SCENARIO, engine=engine)))
    return parse_model(Scenario, table, source=f"{SCENARIO.name} ({ladder.name} {size})")
