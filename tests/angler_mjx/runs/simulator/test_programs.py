"""Shared programs: the same for scenarios that differ in labels, never for others."""

import re
from concurrent.futures import ThreadPoolExecutor
from importlib.resources import files

import jax
import numpy as np
import pytest
import xarray as xr

from angler_experiments.ocean import headland
from angler_mjx.planning.planner import PathShape
from angler_mjx.planning.routes.policy import AlongRoutes
from angler_mjx.runs.simulator import programs
from angler_mjx.runs.simulator.compilation import CompileTime
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.editing import scenario_table, set_value
from angler_mjx.scenario.scenario import Scenario

WITHOUT_PATHS = PathShape(points=2)


@pytest.fixture(autouse=True)
def _no_others():
    programs.clear_shared()
    yield
    programs.clear_shared()


@pytest.fixture(scope="module")
def small(scenario):
    return scenario.model_copy(update={"worlds": 4, "tile": 2})


def _programs(scenario, **options):
    return Simulator(scenario, **options).programs


def _edited(scenario, edits):
    """A scenario with values at dotted keys, checked anew."""
    table = scenario_table(scenario)
    for key, value in edits.items():
        table = set_value(table, key, value)
    return Scenario.model_validate(table)


def test_a_scenario_of_another_name_and_seed_uses_the_programs_and_gives_its_own_results(small):
    first = Simulator(small)
    first.compile()
    edits = {"name": "other", "description": "text", "seed": 9, "worlds": 40}
    other = small.model_copy(update=edits)
    second = Simulator(other)
    assert second.programs is first.programs
    assert second.compile() == CompileTime()
    assert second.problems(0, 1, seed=9)[0].name.scenario == "other"
    shared = _flown(second)
    programs.clear_shared()
    alone = Simulator(other)
    assert alone.programs is not first.programs
    for path, leaf in jax.tree.leaves_with_path(_flown(alone)):
        np.testing.assert_array_equal(
            leaf, dict(jax.tree.leaves_with_path(shared))[path], err_msg=jax.tree_util.keystr(path)
        )


def test_a_planner_and_an_order_that_auto_chose_share_the_programs_of_their_names(small):
    assert small.planner.by_auto
    assert small.execution.by_auto
    edits = {"planner.name": small.planner.name, "execution.order": small.execution.order}
    named = _edited(small, edits)
    assert not named.planner.by_auto
    assert not named.execution.by_auto
    assert _programs(named) is _programs(small)


def _flown(simulator):
    worlds = simulator.worlds(0)
    return jax.device_get((worlds, simulator.segment(worlds, simulator.reset(worlds))))


@pytest.mark.parametrize(
    "edit",
    [
        {"engine": "fused"},
        {"goal_tolerance_m": 0.31},
        {"water.density_kgpm3": 1025.0},
        {"time.horizon_s": 1.0},
        {"time.physics_dt_s": 0.005},
        {"store.also": ["clearance"]},
        {"fleet.0.count": 2},
        {"fleet.0.estimate": "ekf"},
        {"planner.margin_m": 0.2},
        {"planner.points": 16},
        {"planner.information.obstacles": "predicted"},
        {"planner.replan_hz": 1.0},
        {"controller.name": "ardusub"},
        {"world.preset": "open"},
        {"breakdowns.fraction": 0.5},
        {"randomise.current": [0.5, 1.5]},
        {"acoustics": {"model": "range", "range_m": 20.0}},
    ],
    ids=lambda edit: next(iter(edit)),
)
def test_another_simulation_has_other_programs(small, edit):
    assert _programs(_edited(small, edit)) is not _programs(small)


def test_other_arguments_of_the_simulator_make_other_programs(small):
    first = _programs(small)
    assert _programs(small, tile=4) is not first
    assert _programs(small, paths=WITHOUT_PATHS) is not first
    with jax.enable_x64(True):
        assert _programs(small) is not first
    with jax.debug_nans(True):
        assert _programs(small) is not first
    assert _programs(small) is first


def test_a_vehicle_file_that_was_edited_is_read_again(small, tmp_path):
    vehicle = tmp_path / "mine.toml"
    text = (files("angler_mjx.robot.vehicles") / "data" / "bluerov2.toml").read_text()
    vehicle.write_text(text)
    edited = _edited(small, {"fleet": [{"vehicle": str(vehicle), "count": 1}]})
    first = _programs(edited)
    vehicle.write_text(re.sub(r"(?m)^mass_kg = .*", "mass_kg = 13.0", text))
    again = _programs(edited)
    assert again is not first
    before, after = (jax.tree.leaves(one.flight.fleet.control) for one in (first, again))
    assert any(np.any(old != new) for old, new in zip(before, after, strict=True))


def _in_current(small, file):
    return _edited(small, {"world.currents": [{"type": "grid", "file": str(file)}]})


def test_a_file_of_a_current_that_was_edited_is_read_again(small, tmp_path):
    first = tmp_path / "first.nc"
    headland.write_dataset(first)
    made = _programs(_in_current(small, first))
    assert _programs(_in_current(small, first)) is made
    before = _flown(Simulator(_in_current(small, first)))
    with xr.open_dataset(first) as data:
        faster = data.load()
    faster["uo"] *= 1.5
    faster.to_netcdf(first)
    edited = _in_current(small, first)
    assert _programs(edited) is not made
    after = _flown(Simulator(edited))
    assert np.any(before[1][1].current_mps != after[1][1].current_mps)


def test_code_of_a_caller_is_traced_anew(small, tmp_path):
    policy = AlongRoutes(
        dt_s=small.time.control_dt_s,
        horizon_s=2.0,
        routes_margin_m=0.3,
        period=5,
        observation_period=5,
    )
    assert _programs(small, policy=policy) is not _programs(small, policy=policy)
    file = tmp_path / "batch.py"
    file.write_text("class Batch:\n    def plan_batch(self, problems):\n        return None\n")
    planned = _edited(small, {"planner.name": f"{file}:Batch"})
    assert _programs(planned) is not _programs(planned)
    online = _edited(planned, {"planner.replan_hz": 1.0})
    assert _programs(online) is not _programs(online)


def test_planners_of_the_host_share_the_programs_that_draw_their_problems(small, tmp_path):
    file = tmp_path / "hosted.py"
    lines = (f"class {name}:\n    def plan(self, problem):\n        return []\n" for name in "AB")
    file.write_text("\n".join(lines))
    first, other = (_edited(small, {"planner.name": f"{file}:{name}"}) for name in "AB")
    assert _programs(first) is _programs(other)
    assert _programs(first) is not _programs(small)


def test_worlds_of_given_paths_are_sampled_by_the_same_program_at_each_information_level(small):
    edits = {"planner.information.obstacles": "predicted"}
    unaware, predicted = (
        Simulator(one, paths=WITHOUT_PATHS) for one in (small, _edited(small, edits))
    )
    assert unaware.programs is predicted.programs
    levels = [
        simulator.sample_problems()[1].information.obstacles for simulator in (unaware, predicted)
    ]
    assert levels == ["nothing", "predicted"]


def test_a_policy_that_takes_the_information_level_of_the_planner_has_its_own_programs(small):
    made = []
    for level in ("observed", "predicted"):
        edits = {"policy": {"name": "mppi"}, "planner.information": {"obstacles": level}}
        simulator = Simulator(_edited(small, edits), paths=WITHOUT_PATHS)
        assert simulator.policy.information.obstacles == level
        made.append(simulator.programs)
    assert made[0] is not made[1]
    assert made[0].flight is not made[1].flight


PLANNERS = {"planner.name": "priority", "planner.margin_m": 0.2, "planner.deadline_s": 3.0}
ROCK = {"world.rule": {"type": "walls", "count": 1, "gate_cells": 3}}


def test_flights_of_other_planners_and_rock_are_the_same_programs(small):
    fleet = [{"vehicle": "bluerov2", "count": 2}]  # of one kind: traced in half the time
    fused = _edited(small, {"engine": "fused", "fleet": fleet})
    edits = [{}, PLANNERS, ROCK]
    made = [_programs(_edited(fused, edit)) for edit in edits]
    assert len(set(map(id, made))) == len(edits)
    assert all(one.flight is made[0].flight for one in made)
    texts = []
    for one in made:
        flight, worlds = programs.FlightPrograms(one._setup), one.batch_shape
        state = flight.reset.shape(flight.fleet, worlds)
        cells = flight.pack_cells.shape(worlds)
        texts.append(flight.segment.lower(flight.fleet, worlds, state, cells).as_text())
    assert texts[0] == texts[1] == texts[2]


@pytest.mark.parametrize("edits", [PLANNERS, ROCK], ids=["planner", "rock"])
def test_flights_are_compiled_once(small, edits):
    first, other = Simulator(small), Simulator(_edited(small, edits))
    assert first.compile().segment_s > 0
    again = other.compile()
    assert (again.reset_s, again.segment_s) == (0, 0)
    assert again.prepare_s > 0
    flown = _flown(other)
    programs.clear_shared()
    alone = Simulator(other.scenario)
    assert alone.programs.flight is not first.programs.flight
    jax.tree.map(np.testing.assert_array_equal, _flown(alone), flown)


@pytest.mark.parametrize(
    "edit",
    [
        {"planner.replan_hz": 1.0},
        {"planner.points": 16},
        {"time.physics_dt_s": 0.005},
        {"policy.name": "mppi"},
    ],
    ids=lambda edit: next(iter(edit)),
)
def test_another_flight_has_other_programs(small, edit):
    assert _programs(_edited(small, edit)).flight is not _programs(small).flight


def test_the_planner_of_a_flight_is_part_of_its_programs(small):
    online = _edited(small, {"planner.replan_hz": 1.0})
    other = _edited(online, {"planner.margin_m": 0.2})
    assert _programs(other).flight is not _programs(online).flight


def test_the_least_recently_used_programs_are_dropped(small, monkeypatch):
    monkeypatch.setattr(programs, "MAX_SHARED", 2)
    one, two = _programs(small), _programs(small, tile=1)
    assert _programs(small) is one
    _programs(small, tile=3)
    assert _programs(small) is one
    assert _programs(small, tile=1) is not two


def test_threads_compile_once(small):
    simulators = [Simulator(small) for _ in range(3)]
    with ThreadPoolExecutor(3) as threads:
        took = list(threads.map(lambda simulator: simulator.compile().total_s, simulators))
    assert sorted(seconds > 0 for seconds in took) == [False, False, True]
