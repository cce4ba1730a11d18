"""Cards that the plan command writes, and finds again."""

import fcntl
from types import SimpleNamespace

import numpy as np
import pytest
import zarr

from angler_mjx.errors import ConfigError
from angler_mjx.leaderboard import entering, problem_files, problem_sets, set_scenarios, submission
from angler_mjx.planning.device_planner import DevicePlanner, build_device_planner
from angler_mjx.progress import Progress
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.studies.speed.measured import graph_search


@pytest.fixture
def card():
    return {
        "schema_version": 1,
        "benchmark": problem_sets.load_benchmark().title,
        "name": "grid",
        "authors": [],
        "description": "planner",
        "kind": "plans",
        "machine": "A Core",
        "sets": ["open-still-known-01"],
    }


def test_a_card_has_the_factor_of_its_machine_and_keeps_it(tmp_path, monkeypatch, card):
    factors = iter([1.2345, 9.0])
    monkeypatch.setattr(graph_search, "measure_time_factor", lambda: next(factors))
    path = tmp_path / "card.toml"
    for _ in range(2):
        assert entering._write_card(path, card, {"name": "RRTConnect"}) == pytest.approx(
            1.234, abs=1e-3
        )
    assert submission.read_card(tmp_path).machine_factor == pytest.approx(1.234, abs=1e-3)
    with pytest.raises(ConfigError, match=r"another submission \(name, sets would differ\)"):
        entering._write_card(path, card | {"name": "b", "sets": []}, {"name": "RRTConnect"})


def test_planners_on_an_accelerator_are_named_and_not_scaled(tmp_path, monkeypatch, card):
    monkeypatch.setattr(graph_search, "measure_time_factor", lambda: 2.0)
    monkeypatch.setattr(entering.jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(entering.jax, "devices", lambda: [SimpleNamespace(device_kind="A Card")])
    monkeypatch.setattr(entering, "processor_name", lambda: "A Core")
    machines = [entering._name_machine({"name": name}) for name in ("priority", "RRTConnect")]
    assert machines == ["A Card", "A Core"]
    factors = [
        entering._write_card(tmp_path / f"{name}.toml", card, {"name": name})
        for name in ("priority", "RRTConnect")
    ]
    assert factors == [1.0, 2.0]


def test_a_planner_is_timed_while_others_wait(tmp_path, monkeypatch):
    lock, written = tmp_path / "lock", []

    def write_plans(part):
        with lock.open("w") as other, pytest.raises(BlockingIOError):
            fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
        written.append(part)

    program = SimpleNamespace(write_plans=write_plans)
    monkeypatch.setattr(entering, "_compile_planner", lambda part, programs: program)
    for part in ("first", "second"):
        entering._plan_timed_alone(part, {}, lock)
    assert written == ["first", "second"]


def plan_by_grid(out, manifest, *sets, **options):
    entering.plan_submission(
        out, {"name": "grid"}, Progress(), manifest=manifest, name="grid", sets=sets, **options
    )


def test_sets_of_problems_of_one_shape_share_a_compiled_planner(tmp_path, monkeypatch, manifest):
    built = []

    def build(spec, settings):
        built.append(settings.information.obstacles)
        return build_device_planner(spec, settings)

    monkeypatch.setattr(entering, "build_device_planner", build)
    plan_by_grid(
        tmp_path, manifest, "open-still-known-01", "dense-still-known-01", "open-moving-known-01"
    )
    # Rock is an input of the program; whether obstacles move is a setting.
    assert len(built) == 2
    benchmark = problem_sets.load_benchmark()
    alike = ("open-still-known-01", "dense-still-known-01")
    for entry in problem_sets.select_problem_sets(benchmark, alike):
        made = zarr.open_group(tmp_path / "plans" / f"{entry.name}.zarr", mode="r")
        attempt = manifest.find(entry.name).attempt
        scenario = problem_files.build_set_scenario(benchmark, entry, attempt, problem_sets.PUBLIC)
        planned = set_scenarios.build_planned_scenario(scenario, {"name": "grid"}, "test")
        path = Simulator(planned, devices=1).worlds(0).path
        count = entry.problems
        assert np.all(path.found[:count])
        for key, flown in (("time_s", path.time_s), ("position_m", path.position_m)):
            np.testing.assert_allclose(made[key][:], flown[:count], rtol=1e-5, atol=1e-5)


def test_each_problem_is_planned_and_timed_alone(tmp_path, monkeypatch, manifest):
    """A batch takes little longer than its slowest problem: its parts would look fast."""
    sizes, seconds = [], iter([0.0, 1.5, 10.0, 10.25])

    def plan_batch(self, problems):
        sizes.append(len(problems.floor_z_m))
        return original(self, problems)

    original = DevicePlanner.plan_batch
    monkeypatch.setattr(DevicePlanner, "plan_batch", plan_batch)
    clock = SimpleNamespace(perf_counter=lambda: next(seconds))
    monkeypatch.setattr(entering, "time", clock)
    plan_by_grid(tmp_path, manifest, "open-still-known-01")
    assert set(sizes) == {1}  # it is traced
    made = zarr.open_group(tmp_path / "plans" / "open-still-known-01.zarr", mode="r")
    assert made["planning_s"][:].tolist() == [1.5, 0.25]


def test_processes_side_by_side_plan_the_same(tmp_path, manifest):
    sets = ("open-still-known-01", "reef-still-known-01")
    for count in (1, 2):
        plan_by_grid(tmp_path / str(count), manifest, *sets, processes=count)
    for name in sets:
        one, two = (
            zarr.open_group(tmp_path / count / "plans" / f"{name}.zarr", mode="r")
            for count in ("1", "2")
        )
        for key in ("points", "time_s", "position_m"):
            np.testing.assert_array_equal(one[key][:], two[key][:])
        assert np.all(two["points"][:] >= 2)
        assert np.all((two["planning_s"][:] > 0) & np.isfinite(two["planning_s"][:]))
    assert sorted(path.name for path in (tmp_path / "2").iterdir()) == ["card.toml", "plans"]
