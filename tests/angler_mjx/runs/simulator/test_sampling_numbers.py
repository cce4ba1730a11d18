"""Numbers of worlds are arguments of programs: scenarios that differ in them compile nothing."""

from dataclasses import replace
from functools import partial

import jax
import numpy as np
import pytest

from angler_mjx.planning.planner import PathShape
from angler_mjx.runs.simulator.programs import FlightPrograms, Programs
from angler_mjx.runs.simulator.sampling_numbers import sampling_numbers
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.simulator.world_preparation import sample_water_and_breakdowns
from angler_mjx.scenario.editing import scenario_table, set_value
from angler_mjx.scenario.scenario import Scenario, load_scenario

NUMBERS = {
    "seed": 8,
    "world.preset": "dense",
    "world.min_obstacles": 3,
    "world.redraw_limit": 50,
    "world.clearance_m": 0.4,
    "world.obstacles.dynamic.radius_m": [0.3, 0.7],
    "world.obstacles.dynamic.cube_fraction": 0.4,
    "world.obstacles.dynamic.rise_fraction": 0.3,
    "world.obstacles.dynamic.sink_fraction": 0.15,
    "world.obstacles.dynamic.vertical_speed_mps": [0.03, 0.2],
    "world.currents.0.max_speed_mps": 0.25,
    "world.currents.0.std_mps": 0.1,
    "world.currents.0.mean_mps": [0.1, 0.0, 0.0],
    "world.currents.0.time_constant_s": 50.0,
    "world.currents.0.vertical_fraction": 0.2,
    "world.currents.0.knot_dt_s": 10.0,
    "world.currents.1.peak_speed_mps": [0.2, 0.7],
    "world.currents.1.core_radius_m": [1.5, 2.5],
    "randomise.current": [0.6, 1.4],
    "breakdowns.fraction": 0.2,
    "breakdowns.earliest_s": 10.0,
}
"""Of `reef_fleet` with factors and breakdowns."""
OF_ALL_PROGRAMS = {
    "world.floor_depth_m": 40.0,
    "water.density_kgpm3": 1025.0,
    "world.currents.1.count": 2,
}
"""Numbers that are arguments of the sampling, and constants of other programs."""


@pytest.fixture(scope="module")
def reef():
    changes = {"randomise.current": [0.5, 1.5], "breakdowns.fraction": 0.1}
    return edited(load_scenario("reef_fleet", engine="fused", tile=2), changes)


def edited(scenario, edits):
    table = scenario_table(scenario)
    for key, value in edits.items():
        table = set_value(table, key, value)
    return Scenario.model_validate(table)


@pytest.fixture(scope="module")
def setup(reef):
    return Simulator(reef).programs._setup


def sampling_text(setup):
    """StableHLO of the program of worlds without plans; it has no locations."""
    compiled = Programs(replace(setup, planner=None))
    return compiled.prepare.lower(*compiled._prepare_shapes()).as_text()


def test_the_sampling_of_other_numbers_is_the_same_program(reef, setup):
    other = edited(reef, NUMBERS | OF_ALL_PROGRAMS)
    first, second = (jax.tree.leaves_with_path(sampling_numbers(s)) for s in (reef, other))
    same = [
        jax.tree_util.keystr(path)
        for (path, a), (_, b) in zip(first, second, strict=True)
        if not (a != b).any()
    ]
    assert same == [f".factors.sensor_noise.{end}" for end in ("low", "width")]
    assert sampling_text(setup) == sampling_text(replace(setup, scenario=other))


@pytest.mark.parametrize("key", NUMBERS)
def test_scenarios_of_other_numbers_share_their_programs(reef, setup, key):
    other = edited(reef, {key: NUMBERS[key]})
    assert replace(setup, scenario=other).key() == setup.key()


@pytest.mark.parametrize(
    "edit",
    [
        *({key: value} for key, value in OF_ALL_PROGRAMS.items()),
        {"world.obstacles.dynamic.count": 11},
        {"world.obstacles.dynamic.cube_fraction": 1.0},
        {"world.currents.0.knot_dt_s": 3.0},
        {"world.currents.1.count": 5},
        {"breakdowns": {}},
        {"randomise": {}},
    ],
    ids=lambda edit: next(iter(edit)),
)
def test_scenarios_of_another_form_have_programs_of_their_own(reef, setup, edit):
    assert replace(setup, scenario=edited(reef, edit)).key() != setup.key()


def test_worlds_have_the_vortices_and_knots_of_their_scenario(reef):
    """Those of a simulator that shares its programs with one of other numbers."""
    other = edited(reef, {"world.currents.0.knot_dt_s": 10.0})
    first, second = (Simulator(scenario, paths=PathShape(points=2)) for scenario in (reef, other))
    assert second.programs is first.programs
    for simulator, knots, vortices in ((first, 25, 3), (second, 13, 3)):
        markov, eddies = simulator.world_shape().environment.current
        assert markov.knots_mps.shape == (2, knots, 3)
        assert eddies.core_m.shape == (2, vortices)
    worlds = second.worlds()
    markov, eddies = worlds.environment.current
    assert (markov.knots_mps.shape, eddies.centre_m.shape) == ((2, 13, 3), (2, 3, 2))
    current, _ = jax.vmap(partial(sample_water_and_breakdowns, other), (None, None, 0))(
        sampling_numbers(other), np.uint32(other.seed), np.arange(2, dtype=np.uint32)
    )
    jax.tree.map(
        partial(np.testing.assert_allclose, rtol=1e-5), worlds.environment.current, current
    )


def test_flights_over_more_knots_are_the_same_program(setup, reef):
    """Up to 32, of a longer horizon too."""
    other = edited(reef, {"world.currents.0.knot_dt_s": 10.0, "time.horizon_s": 150.0})
    assert flight_text(setup) == flight_text(replace(setup, scenario=other))


def test_worlds_of_other_numbers_of_vortices_are_sampled_by_one_program(setup, reef):
    other = replace(setup, scenario=edited(reef, {"world.currents.1.count": 4}))
    sampled = [Programs(replace(of, planner=None)) for of in (setup, other)]
    assert [made.batch_shape.environment.current[1].core_m.shape for made in sampled] == [
        (2, 3),
        (2, 4),
    ]
    assert sampling_text(setup) == sampling_text(other)


def flight_text(setup):
    compiled = Programs(replace(setup, planner=None))
    flight, worlds = FlightPrograms(setup), compiled.batch_shape
    state, cells = flight.reset.shape(flight.fleet, worlds), flight.pack_cells.shape(worlds)
    return flight.segment.lower(flight.fleet, worlds, state, cells).as_text()
