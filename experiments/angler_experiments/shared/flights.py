"""Whole episodes stored at control rate, for comparing two runs of the same worlds.

A flight holds samples and plans, the positions of every robot and obstacle at each control step,
and the outcome of each robot. It goes through a file, so that the two runs can be of two processes.
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import jax
import numpy as np

from angler_mjx.robot.control import plans
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.engines import base as engines
from angler_mjx.sim.fleet import Fleet
from angler_mjx.sim.record import Sample
from angler_mjx.sim.state import World, WorldState

type Array = np.ndarray


@dataclass(frozen=True, kw_only=True)
class StudyFlight:
    """Worlds of one run; W worlds, R robots, T control steps, K obstacles, N way-points."""

    cells: Array
    """bool [W, x, y, z] rock."""
    variant: Array
    """[W, R] vehicle and parameter set."""
    start_m: Array
    """[W, R, 3] start."""
    goal_m: Array
    """[W, R, 3] goal."""
    redraws: Array
    """[W] repeated samplings of the world."""
    planned: Array
    """bool [W, R] whether the planner found a path."""
    plan_m: Array
    """[W, R, N, 3] way-points."""
    plan_s: Array
    """[W, R, N] times of way-points."""
    p: Array
    """[W, T, R, 3] m in W."""
    target_m: Array
    """[W, T, R, 3] set-point of the position."""
    pwm_us: Array
    """[W, T, R, n_thruster] signals."""
    obstacle_p: Array
    """[W, T, K, 3] positions of obstacles."""
    outcome: Array
    """[W, R] outcomes."""
    end_time_s: Array
    """[W, R] end times."""
    path_length_m: Array
    """[W, R] path lengths."""
    energy_j: Array
    """[W, R] electrical energies."""
    touched: Array
    """[W, R] kind of the touched object, a `Touched`."""
    touched_index: Array
    """[W, R] index of the touched object."""


def record_at_control_rate(scenario: Scenario) -> Scenario:
    """Return the scenario with a sample at every control step."""
    timing = {**scenario.time.model_dump(), "record_hz": 1.0 / scenario.time.control_dt_s}
    return Scenario.model_validate({**scenario.model_dump(), "time": timing})


def fly_scenario(scenario: Scenario, tile: int) -> StudyFlight:
    """Fly all worlds of a scenario that is sampled at control rate, on JAX's default device."""
    simulator = Simulator(scenario, tile=tile)
    parts = []
    for first in range(0, scenario.worlds, tile):
        worlds = simulator.worlds(first)
        state, samples = simulator.reset(worlds), []
        for _ in range(simulator.segments):
            state, sample = simulator.segment(worlds, state)
            samples.append(_select_samples(sample))
        parts.append(_build_flight(worlds, state, samples))
    return _join_tiles(parts, scenario.worlds)


def fly_in_double(scenario: Scenario, tile: int) -> tuple[StudyFlight, StudyFlight]:
    """Fly the same worlds in float32 and in float64.

    Worlds are sampled and planned in float32, and their numbers copied unchanged: both fly the same
    reefs, currents, vehicles and plans.
    """
    simulator = Simulator(scenario, tile=tile)
    engine = engines.by_name(scenario.engine, "xla")
    reset = jax.jit(partial(engine.reset, simulator.spec))
    segment = jax.jit(
        partial(
            engine.segment,
            simulator.spec,
            n_sample=simulator.samples,
            steps_per_sample=simulator.steps_per_sample,
        )
    )

    def fly_tile(kinds: Fleet, worlds: World) -> StudyFlight:
        state, samples = reset(kinds, worlds), []
        for _ in range(simulator.segments):
            state, sample = segment(kinds, worlds, state)
            samples.append(_select_samples(sample))
        return _build_flight(worlds, state, samples)

    singles, doubles = [], []
    for first in range(0, scenario.worlds, tile):
        worlds = simulator.worlds(first)
        singles.append(fly_tile(simulator.fleet, worlds))
        with jax.enable_x64(True):
            doubles.append(fly_tile(_to_float64(simulator.fleet), _to_float64(worlds)))
    return _join_tiles(singles, scenario.worlds), _join_tiles(doubles, scenario.worlds)


def save_flight(flight: StudyFlight, path: Path) -> None:
    """Write a flight into a file."""
    np.savez(path, **{name: getattr(flight, name) for name in StudyFlight.__dataclass_fields__})


def load_flight(path: Path) -> StudyFlight:
    """Read a flight of `save_flight`."""
    with np.load(path) as arrays:
        return StudyFlight(**{name: arrays[name] for name in arrays.files})


def _to_float64[T](tree: T) -> T:
    """Return the same numbers as float64; the caller must enable float64 in JAX."""

    def to_float64(leaf: jax.Array) -> jax.Array:
        return leaf.astype(np.float64) if np.issubdtype(leaf.dtype, np.floating) else leaf

    doubled: T = jax.tree.map(to_float64, tree)
    return doubled


def _select_samples(sample: Sample) -> dict[str, Array]:
    """Select the stored parts of a segment's samples [W, T, ...]."""
    names = ("p", "target_m", "pwm_us", "obstacle_p")
    return {name: np.asarray(getattr(sample, name)) for name in names}


def _build_flight(worlds: World, state: WorldState, samples: list[dict[str, Array]]) -> StudyFlight:
    environment, tally = worlds.environment, state.tally
    constants = {
        "cells": environment.grid.occupied,
        "variant": worlds.variant,
        "start_m": environment.start_m,
        "goal_m": environment.goal_m,
        "redraws": environment.redraws,
        "planned": worlds.planned,
        "plan_m": plans.points_m(worlds.path),
        "plan_s": worlds.path.time_s,
    }
    ends = ("outcome", "end_time_s", "path_length_m", "energy_j", "touched", "touched_index")
    all_samples = {name: np.concatenate([s[name] for s in samples], axis=1) for name in samples[0]}
    return StudyFlight(
        **{name: np.asarray(leaf) for name, leaf in constants.items()},
        **{name: np.asarray(getattr(tally, name)) for name in ends},
        **all_samples,
    )


def _join_tiles(parts: list[StudyFlight], worlds: int) -> StudyFlight:
    """Join tiles, without the padding of the last."""
    return StudyFlight(
        **{
            name: np.concatenate([getattr(part, name) for part in parts])[:worlds]
            for name in StudyFlight.__dataclass_fields__
        }
    )
