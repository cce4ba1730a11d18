"""Whole episodes kept at control rate: what two runs of the same worlds are compared by.

A flight holds what was drawn and planned, where every robot and obstacle was at each control step,
and how each robot ended. It goes through a file, so that the two runs can be of two processes.
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from angler_mjx.robot.control import plans
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.engines import base as engines
from angler_mjx.sim.fleet import Fleet
from angler_mjx.sim.record import Sample
from angler_mjx.sim.state import World, WorldState

type Array = NDArray[Any]


@dataclass(frozen=True, kw_only=True)
class StudyFlight:
    """All worlds of one run; W worlds, R robots, T control steps, K obstacles, N way-points."""

    cells: Array
    """bool [W, x, y, z] rock."""
    variant: Array
    """[W, R] vehicle and set."""
    start_m: Array
    """[W, R, 3]."""
    goal_m: Array
    """[W, R, 3]."""
    redraws: Array
    """[W]."""
    planned: Array
    """bool [W, R] whether the planner found a way."""
    plan_m: Array
    """[W, R, N, 3]."""
    plan_s: Array
    """[W, R, N]."""
    p: Array
    """[W, T, R, 3] m in W."""
    target_m: Array
    """[W, T, R, 3] where the controller aims."""
    pwm_us: Array
    """[W, T, R, n_thruster]."""
    obstacle_p: Array
    """[W, T, K, 3]."""
    outcome: Array
    """[W, R]."""
    end_time_s: Array
    """[W, R]."""
    path_length_m: Array
    """[W, R]."""
    energy_j: Array
    """[W, R]."""
    touched: Array
    """[W, R] a `Touched`."""
    touched_index: Array
    """[W, R]."""


def at_control_rate(scenario: Scenario) -> Scenario:
    """The scenario with a sample at every control step."""
    timing = {**scenario.time.model_dump(), "record_hz": 1.0 / scenario.time.control_dt_s}
    return Scenario.model_validate({**scenario.model_dump(), "time": timing})


def fly(scenario: Scenario, tile: int) -> StudyFlight:
    """Fly all worlds of a scenario that is sampled at control rate, on JAX's default device."""
    simulator = Simulator(scenario, tile=tile)
    parts = []
    for first in range(0, scenario.worlds, tile):
        worlds = simulator.worlds(first)
        state, samples = simulator.reset(worlds), []
        for _ in range(simulator.segments):
            state, sample = simulator.segment(worlds, state)
            samples.append(_kept(sample))
        parts.append(_flight(worlds, state, samples))
    return _together(parts, scenario.worlds)


def fly_in_double(scenario: Scenario, tile: int) -> tuple[StudyFlight, StudyFlight]:
    """The same worlds flown in float32 and in float64.

    Worlds are drawn and planned in float32, and their numbers taken over as they are: both fly the
    same reefs, currents, vehicles and plans.
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

    def flown(kinds: Fleet, worlds: World) -> StudyFlight:
        state, samples = reset(kinds, worlds), []
        for _ in range(simulator.segments):
            state, sample = segment(kinds, worlds, state)
            samples.append(_kept(sample))
        return _flight(worlds, state, samples)

    singles, doubles = [], []
    for first in range(0, scenario.worlds, tile):
        worlds = simulator.worlds(first)
        singles.append(flown(simulator.fleet, worlds))
        with jax.enable_x64(True):
            doubles.append(flown(_double(simulator.fleet), _double(worlds)))
    return _together(singles, scenario.worlds), _together(doubles, scenario.worlds)


def save(flight: StudyFlight, path: Path) -> None:
    """Write a flight into a file."""
    np.savez(path, **{name: getattr(flight, name) for name in StudyFlight.__dataclass_fields__})


def load(path: Path) -> StudyFlight:
    """Read what `save` wrote."""
    with np.load(path) as held:
        return StudyFlight(**{name: held[name] for name in held.files})


def _double[T](tree: T) -> T:
    """The same numbers as float64; JAX has to be asked for it around the call."""

    def wide(leaf: Any) -> Any:
        return leaf.astype(np.float64) if np.issubdtype(leaf.dtype, np.floating) else leaf

    doubled: T = jax.tree.map(wide, tree)
    return doubled


def _kept(sample: Sample) -> dict[str, Array]:
    """What is kept of a segment's samples [W, T, ...]."""
    names = ("p", "target_m", "pwm_us", "obstacle_p")
    return {name: np.asarray(getattr(sample, name)) for name in names}


def _flight(worlds: World, state: WorldState, samples: list[dict[str, Array]]) -> StudyFlight:
    drawn, tally = worlds.environment, state.tally
    constants = {
        "cells": drawn.grid.occupied,
        "variant": worlds.variant,
        "start_m": drawn.start_m,
        "goal_m": drawn.goal_m,
        "redraws": drawn.redraws,
        "planned": worlds.planned,
        "plan_m": plans.points_m(worlds.path),
        "plan_s": worlds.path.time_s,
    }
    ends = ("outcome", "end_time_s", "path_length_m", "energy_j", "touched", "touched_index")
    whole = {name: np.concatenate([s[name] for s in samples], axis=1) for name in samples[0]}
    return StudyFlight(
        **{name: np.asarray(leaf) for name, leaf in constants.items()},
        **{name: np.asarray(getattr(tally, name)) for name in ends},
        **whole,
    )


def _together(parts: list[StudyFlight], worlds: int) -> StudyFlight:
    """Tiles one after another, without the padding of the last."""
    return StudyFlight(
        **{
            name: np.concatenate([getattr(part, name) for part in parts])[:worlds]
            for name in StudyFlight.__dataclass_fields__
        }
    )
