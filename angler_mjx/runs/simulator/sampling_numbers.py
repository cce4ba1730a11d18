"""Numbers of a scenario that the program of its worlds takes as an argument.

Scenarios that differ in them alone have the same program: strengths of currents, fill and clearance
of worlds, sizes and fractions of obstacles, ranges of factors, breakdowns, density of the water.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import jax

from angler_mjx.files import JsonTable
from angler_mjx.host_arrays import as_numbers
from angler_mjx.sampling import UniformRange
from angler_mjx.scenario.randomise_table import RandomiseConfig
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.world.config import WorldNumbers, resolve_world
from angler_mjx.world.currents import pad_samplers

WORLD_NUMBERS: dict[str, bool | set[str]] = {
    **dict.fromkeys(("fill", "clearance_m", "min_obstacles", "redraw_limit", "currents"), True),
    "obstacles": {"dynamic"},
}
"""Fields of a recipe that only `WorldNumbers` holds, or the structure of it. The floor is not one
of them: tasks are made for it."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class FactorNumbers:
    """Ranges of the factors of a world."""

    current: UniformRange
    sensor_noise: UniformRange


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class BreakdownNumbers:
    """Probability and times of breakdowns."""

    fraction: jax.Array
    """[] probability that a robot breaks down."""
    time_s: UniformRange


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class SamplingNumbers:
    """Numbers of the worlds of a scenario."""

    world: WorldNumbers
    density_kgpm3: jax.Array
    """[] of the water, for the masses of obstacles."""
    factors: FactorNumbers | None
    """None where worlds have no factors."""
    breakdowns: BreakdownNumbers | None
    """None without breakdowns."""

    def padded(self) -> "SamplingNumbers":
        """Return the numbers of worlds whose currents are padded; see `currents.padding`."""
        currents = pad_samplers(self.world.currents)
        return replace(self, world=replace(self.world, currents=currents))


def sampling_numbers(scenario: Scenario) -> SamplingNumbers:
    """Return the numbers of a scenario's worlds (host side)."""
    return SamplingNumbers(
        world=resolve_world(scenario.world).numbers(scenario.time.horizon_s),
        density_kgpm3=as_numbers(scenario.water.density_kgpm3),
        factors=_factor_numbers(scenario.randomise),
        breakdowns=breakdown_numbers(scenario),
    )


def static_table(
    scenario: Scenario, excluded: Mapping[str, bool | set[str]] | None = None
) -> JsonTable:
    """Return the tables of a scenario that programs hold, without those of `sampling_numbers`.

    Scenarios with equal tables and numbers of equal structure sample worlds by the same program.

    Args:
        scenario: scenario.
        excluded: further keys to leave out, as of pydantic.
    """
    table: JsonTable = scenario.model_dump(
        mode="json",
        exclude={
            **(excluded or {}),
            "world": True,
            "breakdowns": True,
            "randomise": {"current", "sensor_noise"},
        },
    )
    recipe = resolve_world(scenario.world)
    table["world"] = recipe.model_dump(mode="json", exclude=WORLD_NUMBERS)
    return table


def breakdown_numbers(scenario: Scenario) -> BreakdownNumbers | None:
    """Return the numbers of a scenario's breakdowns (host side)."""
    settings = scenario.breakdowns
    if settings.fraction == 0.0:
        return None
    return BreakdownNumbers(
        fraction=as_numbers(settings.fraction),
        time_s=UniformRange.between(*settings.span_s(scenario.time.horizon_s)),
    )


def _factor_numbers(config: RandomiseConfig) -> FactorNumbers | None:
    if not config.changes_worlds:
        return None
    return FactorNumbers(
        current=UniformRange.between(*config.current),
        sensor_noise=UniformRange.between(*config.sensor_noise),
    )
