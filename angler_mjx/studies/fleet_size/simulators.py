"""Compiled simulators, as few as the sizes and conditions of a study need.

A team of another size is another program, and compiling one takes longer than flying a batch. Two
conditions share a simulator where their scenarios differ in nothing but the current and breakdowns:
the worlds are drawn once, and each gets the current and the breakdowns that it would have been
drawn with. Two things are needed for it:

- currents of the same form. So still water among moving ones is ``randomise.current = [0.0, 0.0]``;
  an empty list of currents is another form, and another program;
- that no planner knows of currents or of obstacles that drift with them.
"""

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial

import jax
import numpy as np

from angler_mjx.runs.simulator.sampling_numbers import sampling_numbers
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.simulator.world_preparation import sample_water_and_breakdowns
from angler_mjx.runs.simulator_cache import MAX_AHEAD, SimulatorCache
from angler_mjx.scenario.randomise_table import UNCHANGED
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.state import World
from angler_mjx.studies.fleet_size.conditions import Condition, FleetSizeStudy
from angler_mjx.world.currents import Current


class Simulators:
    """The simulators of a study, compiled when they are needed or a little before."""

    def __init__(self, study: FleetSizeStudy, *, tile: int, devices: int | None) -> None:
        """Nothing is compiled yet.

        Args:
            study: whose.
            tile: worlds of one device in one call.
            devices: to fly on; all if None.
        """
        self._study, self._devices = study, devices
        self.tile = tile
        """Worlds of one device in one call."""
        self._cache = SimulatorCache()
        self._keys: dict[tuple[str, int], str] = {}
        breakdowns = [
            study.scenario(entry, study.sizes[0]).breakdowns for entry in study.conditions
        ]
        # Where some conditions have breakdowns, programs of all can have them.
        self._breakdowns = max(breakdowns, key=lambda entry: entry.fraction)
        self._samplers: dict[
            tuple[str, int], Callable[..., tuple[Current, jax.Array | np.ndarray | None]]
        ] = {}

    @property
    def compiled(self) -> int:
        """Number of simulators whose compilation began."""
        return self._cache.compiled

    def begin(self, cells: Iterable[tuple[Condition, int]]) -> None:
        """Begin to compile what the next cells need, a few programs ahead."""
        ahead: set[str] = set()
        for condition, size in cells:
            key, build = self._entry(condition, size)
            self._cache.begin(key, build)
            ahead.add(key)
            if len(ahead) > MAX_AHEAD:
                return

    def of(self, condition: Condition, size: int) -> Simulator:
        """Return a compiled simulator; errors as of `SimulatorCache.of`."""
        return self._cache.of(*self._entry(condition, size))

    def change(
        self,
        condition: Condition,
        size: int,
        simulator: Simulator,
        firsts: Sequence[int],
        world: World,
    ) -> World:
        """Worlds of a simulator as the condition has them.

        Args:
            condition: that is flown.
            size: of the team.
            simulator: of `of`.
            firsts: first world of each device's tile.
            world: worlds as the simulator drew them.
        """
        scenario = self._study.scenario(condition, size)
        if not _can_replace_water(scenario):
            return world
        key = (condition.name, size)
        if key not in self._samplers:
            sample_water = partial(sample_water_and_breakdowns, scenario)
            self._samplers[key] = jax.jit(jax.vmap(sample_water, in_axes=(None, None, 0)))
        index = np.concatenate(
            [np.arange(first, first + self.tile, dtype=np.uint32) for first in firsts]
        )
        current, fails_at_s = self._samplers[key](
            sampling_numbers(scenario), np.uint32(scenario.seed), index
        )
        if fails_at_s is None and world.fails_at_s is not None:
            fails_at_s = np.full(world.fails_at_s.shape, np.inf, world.fails_at_s.dtype)
        sharding = world.environment.start_m.sharding
        current, fails_at_s = jax.device_put((current, fails_at_s), sharding)
        environment = replace(world.environment, current=current)
        return replace(world, environment=environment, fails_at_s=fails_at_s)

    def close(self) -> None:
        """Close all simulators."""
        self._cache.close()

    def _entry(self, condition: Condition, size: int) -> tuple[str, Callable[[], Simulator]]:
        """Return the key of a simulator, and what makes it."""
        scenario = self._canonical(self._study.scenario(condition, size))
        key = self._keys.get((condition.name, size))
        if key is None:
            key = self._keys[condition.name, size] = _program_key(scenario)
        return key, partial(Simulator, scenario, tile=self.tile, devices=self._devices)

    def _canonical(self, scenario: Scenario) -> Scenario:
        """The scenario whose programs serve all that differ in current and breakdowns alone."""
        if not _can_replace_water(scenario):
            return scenario
        randomise = scenario.randomise.model_copy(update={"current": UNCHANGED})
        update = {"randomise": randomise, "breakdowns": self._breakdowns}
        return scenario.model_copy(update=update)


def _can_replace_water(scenario: Scenario) -> bool:
    """Whether current and breakdowns can be put into worlds that were drawn without regard to them.

    A task asks no planner; of others it must know neither the current nor what drifts with it.
    """
    if scenario.randomise.sensor_noise != UNCHANGED:
        return False
    information = scenario.planner.information
    blind = information.current == information.obstacles == "nothing"
    return scenario.task_spec() is not None or (blind and scenario.planner.name != "current")


def _program_key(scenario: Scenario) -> str:
    """Of the programs of a canonical scenario: the same text is the same programs."""
    table = scenario.model_dump(mode="json", exclude={"name", "description"})
    if _can_replace_water(scenario):
        number = jax.ShapeDtypeStruct((), np.uint32)
        sample_water = partial(sample_water_and_breakdowns, scenario)
        form = jax.eval_shape(sample_water, sampling_numbers(scenario), number, number)
        table["world"]["currents"] = f"{jax.tree.structure(form)} {jax.tree.leaves(form)}"
    return json.dumps(table, sort_keys=True)
