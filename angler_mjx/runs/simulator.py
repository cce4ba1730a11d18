"""A scenario made runnable: worlds from indices, and the compiled reset, step and segment.

This is where ``vmap`` over worlds and ``jit`` stand. Every call works on one tile: a fixed number
of worlds with consecutive global indices, so a run of any size compiles once, and the same tile on
the same kind of device gives the same bytes wherever it stands in a run.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.control.commands import ThrusterPwm
from angler_mjx.planning import grid as grid_planner
from angler_mjx.runs.scenario import Scenario
from angler_mjx.sim import engines, fleet
from angler_mjx.sim.state import Sample, World, WorldState
from angler_mjx.world import generate
from angler_mjx.world.config import WorldRecipe, resolve

DEFAULT_TILE = {"cpu": 128, "gpu": 4096}
"""Worlds in one device call where the scenario does not say: measured in docs/validation.md."""


PREPARED_AT_ONCE = 4096
"""Worlds drawn and planned in one go. 16,384 at once were a tenth faster on an H200, but took 209 s
to compile instead of 39 s, and memory grows with the planner's history."""


def default_tile(worlds: int) -> int:
    """Tile for a run of ``worlds`` on the default device: never more than the run holds."""
    return min(worlds, DEFAULT_TILE.get(jax.default_backend(), DEFAULT_TILE["cpu"]))


type _Step = Callable[..., tuple[WorldState, Sample]]


@dataclass(frozen=True, kw_only=True)
class CompileTime:
    """Seconds from Python to machine code, by function."""

    prepare_s: float
    reset_s: float
    segment_s: float

    @property
    def total_s(self) -> float:
        """All of them."""
        return self.prepare_s + self.reset_s + self.segment_s


class Simulator:
    """Compiled simulation of one scenario, a tile of worlds at a time.

    Attributes:
        scenario: what is simulated.
        tile: worlds in one call.
        fleet: compiled vehicles.
        spec: settings of the simulation.
        samples: stored samples in one segment.
        steps_per_sample: control steps from one to the next.
    """

    def __init__(self, scenario: Scenario, *, tile: int | None = None) -> None:
        """Read the vehicles and put the functions together; nothing is compiled yet.

        Args:
            scenario: what to simulate.
            tile: worlds in one call; the scenario's, or else the device's default.

        Raises:
            ConfigError: a vehicle file has faults, or the fleet does not fit the world's cells.
        """
        self.scenario = scenario
        self.tile = tile or scenario.tile or default_tile(scenario.worlds)
        self.spec = scenario.sim_spec()
        self.fleet = fleet.build(scenario.members())
        timing = scenario.time
        self.steps_per_sample = timing.steps_per_sample or _divisor(timing.control_steps, 100)
        self.samples = (
            _divisor(timing.control_steps // self.steps_per_sample, 25)
            if timing.steps_per_sample
            else 1
        )
        recipe = resolve(scenario.world)
        generate.check_fleet(recipe, np.asarray(fleet.radius_bound(self.fleet)))
        self._plan = grid_planner.GridPlannerConfig(
            horizon_s=timing.horizon_s, margin_m=scenario.planner.margin_m
        )
        self._one_world = partial(_one_world, scenario, recipe, self._plan)
        self._compiled = False
        self._prepare: Callable[..., World] = jax.jit(self._prepare_tile)
        engine = engines.by_name(scenario.engine)
        self._reset: Callable[..., WorldState] = jax.jit(partial(engine.reset, self.spec))
        self._step: _Step = jax.jit(partial(engine.control_step, self.spec))
        self._segment: _Step = jax.jit(
            partial(
                engine.segment,
                self.spec,
                n_sample=self.samples,
                steps_per_sample=self.steps_per_sample,
            ),
            donate_argnums=2,
        )

    @property
    def segment_steps(self) -> int:
        """Control steps in one segment."""
        return self.samples * self.steps_per_sample

    @property
    def segments(self) -> int:
        """Segments in the horizon."""
        return self.scenario.time.control_steps // self.segment_steps

    def variants(self) -> list[tuple[str, str]]:
        """Vehicle and parameter set of each variant, in the order of ``World.variant``."""
        kinds = fleet.variants(self.scenario.members())
        return [(kind.vehicle, kind.parameter_set) for kind in kinds]

    def worlds(self, first: int = 0, *, seed: int | None = None) -> World:
        """Worlds first .. first + tile - 1: drawn, furnished and planned.

        Args:
            first: global index of the first world.
            seed: instead of the scenario's.

        Returns:
            World with [tile] leading on every leaf.
        """
        number = self.scenario.seed if seed is None else seed
        return self._prepare(self.fleet, jnp.uint32(number), jnp.uint32(first))

    def world_shape(self) -> World:
        """Shapes and types of ``worlds``, without computing any."""
        number = jax.ShapeDtypeStruct((), jnp.uint32)
        shapes: World = jax.eval_shape(self._prepare_tile, self.fleet, number, number)
        return shapes

    def reset(self, worlds: World) -> WorldState:
        """State of each world at t = 0."""
        return self._reset(self.fleet, worlds)

    def step(
        self, worlds: World, state: WorldState, command: ThrusterPwm | None = None
    ) -> tuple[WorldState, Sample]:
        """One control step.

        Args:
            worlds: from ``worlds``.
            state: from ``reset`` or the step before.
            command: signals [tile, robot, thruster] to send instead of the cascade's.

        Returns:
            The next state, and the sample of the state before with its command.
        """
        return self._step(self.fleet, worlds, state, command)

    def segment(self, worlds: World, state: WorldState) -> tuple[WorldState, Sample]:
        """``segment_steps`` control steps; the given state's memory is used up.

        Returns:
            The state after them, and samples [tile, samples, ...].
        """
        return self._segment(self.fleet, worlds, state)

    def compile(self) -> CompileTime:
        """Compile for this tile ahead of time; later calls use the compiled functions.

        Returns:
            What it took; zeros if it was done before.
        """
        if self._compiled:
            return CompileTime(prepare_s=0.0, reset_s=0.0, segment_s=0.0)
        kinds, number = self.fleet, jnp.uint32(0)
        self._prepare, prepare_s = _compiled(self._prepare, kinds, number, number)
        worlds = self.world_shape()
        state = jax.eval_shape(self._reset, kinds, worlds)
        self._reset, reset_s = _compiled(self._reset, kinds, worlds)
        self._segment, segment_s = _compiled(self._segment, kinds, worlds, state)
        self._compiled = True
        return CompileTime(prepare_s=prepare_s, reset_s=reset_s, segment_s=segment_s)

    def _prepare_tile(self, kinds: fleet.Fleet, seed: jax.Array, first: jax.Array) -> World:
        index = first + jnp.arange(self.tile, dtype=jnp.uint32)
        one = partial(self._one_world, kinds, seed)
        if self.tile <= PREPARED_AT_ONCE:
            return jax.vmap(one)(index)
        worlds: World = jax.lax.map(one, index, batch_size=PREPARED_AT_ONCE)
        return worlds


def _one_world(
    scenario: Scenario,
    recipe: WorldRecipe,
    planner: grid_planner.GridPlannerConfig,
    kinds: fleet.Fleet,
    seed: jax.Array,
    index: jax.Array,
) -> World:
    """World ``index`` of a run: its key is the run's, folded with the global index."""
    key = jax.random.fold_in(jax.random.key(seed), index)
    variant, cascade, body = fleet.draw(kinds, jax.random.fold_in(key, 0))
    environment = generate.generate(
        recipe,
        fleet.radius_bound(kinds),
        jax.random.fold_in(key, 1),
        scenario.time.horizon_s,
        scenario.water.density_kgpm3,
    )
    path = grid_planner.plan(
        environment, cascade.vehicle.radius_m, cascade.cruise_speed_mps, planner
    )
    return World(environment=environment, variant=variant, body=body, cascade=cascade, path=path)


def _divisor(total: int, most: int) -> int:
    """Largest divisor of ``total`` up to ``most``: short segments make a steady progress bar."""
    return max(n for n in range(1, most + 1) if total % n == 0)


def _compiled(function: Any, *example: Any) -> tuple[Callable[..., Any], float]:
    start = time.perf_counter()
    executable = function.lower(*example).compile()
    return executable, time.perf_counter() - start
