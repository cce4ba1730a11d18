import re
import subprocess
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.cli.bench import bench
from angler_mjx.cli.main import main
from angler_mjx.errors import ConfigError, RunError
from angler_mjx.progress import Progress
from angler_mjx.runs import provenance
from angler_mjx.runs.simulator.compilation import CompiledFunction, CompileTime, ParallelCompiler
from angler_mjx.runs.simulator.simulator import default_tile
from angler_mjx.scenario.scenario import load_scenario, shipped_scenarios
from angler_mjx.sim.state import Outcome
from angler_mjx.studies.speed import roofline
from angler_mjx.studies.speed import (
    rows as speed,
)
from angler_mjx.studies.speed.measured import (
    compilation,
    free_motion,
    hull_clearance,
    measuring,
    recording,
    simulation,
)
from angler_mjx.studies.speed.measured.hull_clearance import require_change
from angler_mjx.studies.speed.measured.simulation import require_moving
from angler_mjx.studies.speed.workloads import (
    PROFILES,
    WORKLOADS,
    SpeedRequest,
    build_cases,
)

from .rows import make_row


def ask(**changes):
    return build_cases(SpeedRequest(**changes))


@pytest.fixture(scope="module")
def measured():
    """One closed loop, small enough for a test, on the engine that runs everywhere."""
    (case,) = ask(workloads=("closed_loop_8",), worlds=(2,), robots=(2,), kernels="xla")
    (row,) = measuring.measure_cases([case], lambda case: None)
    return row


@pytest.mark.nightly(by="test_the_command_measures_compares_and_tabulates")
def test_a_simulation_fills_its_row(measured):
    assert measured.refused is None
    assert (measured.workload, measured.engine, measured.kernels) == (
        "closed_loop_2",
        "fused",
        "xla",
    )
    assert measured.repeats == 10
    assert 0 < measured.low <= measured.median <= measured.high
    assert measured.active_share > 0.9
    assert measured.compile_s > 0
    assert measured.host_peak_bytes > 0
    # Arguments and results are a part of what the program needs.
    steps = 2 * 2 * 500
    assert 0 < measured.least_bytes * steps <= measured.program_bytes
    # A rigid body with its thrusters and current takes hundreds of operations a step, not millions.
    assert 500 < measured.flops < 50_000
    # XLA counts the body of the loop over control steps once, so it says less than was done.
    assert 0 < measured.xla_flops < measured.flops * steps
    assert measured.xla_bytes > 0
    assert "5 s of simulated time" in measured.inside
    assert "all worlds different" in measured.inside


SIMULATED = [
    name
    if name in ("mjx", "closed_loop_8")
    else pytest.param(name, marks=pytest.mark.nightly(by="mjx and closed_loop_8: either engine"))
    for name, workload in WORKLOADS.items()
    if workload.kind == "simulation"
]


@pytest.mark.parametrize("name", SIMULATED)
def test_operations_of_every_simulation_are_counted(name):
    """Traced only: what follows the timed calls of `measure`."""
    (case,) = ask(workloads=(name,), worlds=(2,), robots=(1,))
    counted = simulation._count_scenario_flops(case.scenario.model_dump_json())
    # Hundreds of operations for a physics step of one robot, on either engine.
    assert 500 < counted.flops < 50_000
    # A scenario's repeats share one count.
    assert simulation._count_scenario_flops(case.scenario.model_dump_json()) is counted


TINY = """
schema_version = 1
name = "tiny"
worlds = 2
engine = "fused"

[time]
horizon_s = 2.0

[world]
preset = "open"
shape = [8, 8, 8]

[[fleet]]
vehicle = "bluerov2"
parameter_set = "blue_gazebo"
count = 1
"""


CACHE_SETTINGS = (
    "jax_enable_compilation_cache",
    "jax_compilation_cache_dir",
    "jax_persistent_cache_min_compile_time_secs",
)


class OneOperation:
    """Three programs of one operation each, compiled as those of a simulator."""

    kernels = "xla"
    results: ClassVar = []

    def __init__(self, scenario, *, tile):
        self._argument = jnp.ones(tile)

    def compile(self):
        operations = {"prepare": jnp.sin, "reset": jnp.cos, "segment": jnp.cumsum}
        with ParallelCompiler(3) as programs:
            begun = {
                name: programs.begin(CompiledFunction(lambda x, of=of: of(x)), self._argument)
                for name, of in operations.items()
            }
        seconds = {f"{name}_s": program.result()[1] for name, program in begun.items()}
        return CompileTime(**seconds, total_s=sum(seconds.values()))

    def close(self):
        self.results.append(jax.config.jax_compilation_cache_dir)


def test_seconds_are_of_an_empty_and_then_of_a_full_cache(monkeypatch):
    monkeypatch.setattr(compilation, "Simulator", OneOperation)
    monkeypatch.setattr(OneOperation, "results", [])
    before = {name: getattr(jax.config, name) for name in CACHE_SETTINGS}
    (case,) = ask(workloads=("compile",), scenarios=("open_water_current",), worlds=(2,))
    rows = list(measuring.measure_cases([case], lambda case: None))
    assert [row.workload.removeprefix("compile/open_water_current") for row in rows] == [
        f"{name}{end}" for end in ("", "/cached") for name in ("", *PROGRAMS)
    ]
    assert [row.cached_programs for row in rows] == [0, 0, 0, 0, 3, 1, 1, 1]
    # The same folder for both, which is removed; the user's own is used again.
    first, second = OneOperation.results
    assert first == second != before["jax_compilation_cache_dir"]
    assert not Path(first).exists()
    assert {name: getattr(jax.config, name) for name in CACHE_SETTINGS} == before


def test_seconds_of_programs_that_are_compiled_twice_are_refused(monkeypatch):
    class Forgetful(OneOperation):
        def __init__(self, scenario, *, tile):
            super().__init__(scenario, tile=tile)
            for file in Path(jax.config.jax_compilation_cache_dir).glob("*-cache"):
                file.unlink()

    monkeypatch.setattr(compilation, "Simulator", Forgetful)
    (row,) = measuring.measure_cases(
        ask(workloads=("compile",), scenarios=("open_water_current",), worlds=(2,)),
        lambda case: None,
    )
    assert "3 of 3 programs were compiled a second time" in row.refused


PROGRAMS = ("/prepare", "/reset", "/segment")


@pytest.mark.nightly(by="test_seconds_are_of_an_empty_and_then_of_a_full_cache")
@pytest.mark.usefixtures("_known_device")
def test_programs_are_compiled_without_and_with_a_cache(tmp_path, capsys):
    """Cached programs are traced and not compiled; the user's cache holds none of them."""
    file, out = tmp_path / "tiny.toml", tmp_path / "rows.jsonl"
    file.write_text(TINY)
    before = {name: getattr(jax.config, name) for name in CACHE_SETTINGS}
    main(["bench", "--workload", "compile", "--scenario", str(file), "--out", str(out)])
    assert {name: getattr(jax.config, name) for name in CACHE_SETTINGS} == before
    rows = {row["workload"]: row for row in speed.read_rows(out)}
    seconds = {name.removeprefix("compile/tiny"): row["median"] for name, row in rows.items()}
    assert set(seconds) == {f"{name}{end}" for name in ("", *PROGRAMS) for end in ("", "/cached")}
    # Side by side: all takes as long as the longest, and no longer than one after the other.
    for end in ("", "/cached"):
        each = [seconds[f"{name}{end}"] for name in PROGRAMS]
        assert max(each) <= seconds[end] <= sum(each) + 1.0
    assert seconds["/segment/cached"] < seconds["/segment"]
    assert rows["compile/tiny"]["cached_programs"] == 0
    assert rows["compile/tiny/cached"]["cached_programs"] >= len(PROGRAMS)
    for row in rows.values():
        assert (row["worlds"], row["robots"], row["engine"]) == (2, 1, "fused")
        assert (row["processor"], row["cpu_count"]) == (provenance.processor_name(), cores())
        assert (row["versions"]["jax"], row["device"]) == (jax.__version__, "cpu")
    said = " ".join(capsys.readouterr().out.split())
    assert "compile/tiny/segment fused/xla" in said
    assert "compile: timed is tracing, lowering and compiling with an empty cache folder" in said


def cores():
    """Processors that `taskset` or a container leaves to this process, by another way."""
    return int(subprocess.run(["nproc"], capture_output=True, text=True, check=True).stdout)


@pytest.mark.parametrize("profile", ["full", "paper"])
def test_profiles_compile_teams_and_numbers_of_worlds(profile):
    found = {case.label: case for case in ask(workloads=("compile",), profile=profile)}
    assert len(found) == 8
    for case in found.values():
        assert len(case.scenario.members()) == case.robots
    million, team = found["compile/million"], found["compile/team_of_64"]
    assert (million.worlds, million.robots, million.scenario.engine) == (65536, 4, "fused")
    assert (team.worlds, team.robots) == (256, 64)
    assert found["compile/team_of_12"].worlds == 32
    assert found["compile/mppi"].scenario.policy.name == "mppi"
    assert found["compile/mppi"].scenario.name == "dense_dynamic"
    assert found["compile/reef_fleet_mjx"].scenario.engine == "mjx"
    # A team that grows keeps the planner by which its rates are compared.
    assert team.scenario.planner.name == "priority"


def test_all_shipped_scenarios_are_compiled_for_the_tile_of_a_run():
    found = {case.label: case for case in ask(workloads=("compile",))}
    assert set(found) == {f"compile/{name}" for name in shipped_scenarios()}
    assert found["compile/sitl_hold"].worlds == 1
    for case in found.values():
        assert case.worlds == default_tile(load_scenario(case.workload.source).worlds)
        assert case.robots == len(case.scenario.members())
    chosen = ask(workloads=("compile",), scenarios=("reef_fleet",), worlds=(2, 4), engine="fused")
    assert [(case.label, case.worlds) for case in chosen] == [
        ("compile/reef_fleet", 2),
        ("compile/reef_fleet", 4),
    ]
    assert {case.scenario.engine for case in chosen} == {"fused"}


def test_drawing_worlds_ends_with_a_number():
    (case,) = ask(workloads=("env_generation",), worlds=(2,), robots=(1,))
    (row,) = measuring.measure_cases([case], lambda case: None)
    assert row.refused is None
    assert 0 < row.low <= row.median <= row.high


def state(**changes):
    tally = {
        "outcome": jnp.full((2, 3), int(Outcome.RUNNING)),
        "path_length_m": jnp.full((2, 3), 0.5),
        "end_time_s": jnp.full((2, 3), 1.25),
    }
    vehicles = jnp.asarray(changes.pop("vehicles", np.ones((2, 3))))
    return SimpleNamespace(vehicles=vehicles, tally=SimpleNamespace(**(tally | changes)))


SAMPLE = SimpleNamespace(p=jnp.ones(3), q=jnp.ones(4), nu=jnp.ones(6))


def test_moving_robots_pass():
    assert require_moving(state(), SAMPLE, 1.25) == 1.0


def test_nan_is_refused():
    with pytest.raises(RunError, match="NaN"):
        require_moving(state(vehicles=np.array([1.0, np.nan])), SAMPLE, 1.25)
    sample = SimpleNamespace(p=jnp.ones(3), q=jnp.array([jnp.inf]), nu=jnp.ones(6))
    with pytest.raises(RunError, match="NaN"):
        require_moving(state(), sample, 1.25)


def test_a_standing_robot_counts_as_one_that_ended_at_once():
    path = np.full((2, 3), 0.5)
    path[1, 2] = 0.0
    with pytest.raises(RunError, match=r"only 83% .* 1 of 6 stood still"):
        require_moving(state(path_length_m=jnp.asarray(path)), SAMPLE, 1.25)
    many = {
        "path_length_m": jnp.full((4, 5), 0.5).at[0, 0].set(0.0),
        "end_time_s": jnp.full((4, 5), 1.25),
        "outcome": jnp.full((4, 5), int(Outcome.RUNNING)),
    }
    assert require_moving(state(**many), SAMPLE, 1.25) == pytest.approx(19 / 20)


def test_only_the_steps_that_robots_lived_count():
    end = np.full((2, 3), 1.25)
    outcome = np.full((2, 3), int(Outcome.RUNNING))
    end[0, 0], outcome[0, 0] = 0.625, int(Outcome.COLLISION_ROBOT)
    ended = state(end_time_s=jnp.asarray(end), outcome=jnp.asarray(outcome))
    assert require_moving(ended, SAMPLE, 1.25) == pytest.approx(5.5 / 6)
    with pytest.raises(RunError, match="on their way for only 50%"):
        require_moving(state(end_time_s=jnp.full((2, 3), 0.625)), SAMPLE, 1.25)


def test_distances_that_do_not_change_are_refused():
    require_change(np.zeros(4), np.ones(4))
    with pytest.raises(RunError, match="not finite"):
        require_change(np.array([np.nan]), np.ones(1))
    with pytest.raises(RunError, match="do not change"):
        require_change(np.ones(4), np.ones(4))


def test_what_does_not_fit_is_reported_and_the_rest_goes_on(monkeypatch):
    def measure(*, worlds, robots, repeats):
        if worlds > 5:
            raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: out of memory")
        return make_row(workload="clearance", worlds=worlds, robots=robots)

    monkeypatch.setattr(hull_clearance, "measure", measure)
    chosen = ask(workloads=("clearance",), worlds=(4, 16, 64), robots=(1, 2))
    rows = list(measuring.measure_cases(chosen, lambda case: None))
    # 64 worlds are not tried after 16 did not fit.
    assert [(row.worlds, row.robots) for row in rows] == [(4, 1), (16, 1), (4, 2), (16, 2)]
    assert [row.out_of_memory for row in rows] == [False, True, False, True]
    assert "4 worlds in one call fit" in rows[1].refused
    assert rows[1].median is None


def test_a_refused_run_has_no_number(monkeypatch):
    def measure(*args, **kwargs):
        raise RunError("the timed run holds NaN: no number is given")

    monkeypatch.setattr(simulation, "measure", measure)
    (row,) = measuring.measure_cases(ask(workloads=("mjx",), worlds=(4,)), lambda case: None)
    assert row.median is None
    assert "NaN" in row.refused
    assert not row.out_of_memory


@pytest.mark.parametrize("profile", sorted(PROFILES))
def test_all_workloads_of_a_profile_load(profile):
    chosen = build_cases(SpeedRequest(profile=profile))
    assert {case.workload.kind for case in chosen} <= {
        "dynamics",
        "arm_dynamics",
        "simulation",
        "preparation",
        "generation",
        "clearance",
    }
    for case in chosen:
        if case.scenario is not None:
            assert len(case.scenario.members()) == case.robots


def test_the_closed_loop_is_what_it_is_called():
    (case,) = ask(workloads=("closed_loop_8",), worlds=(64,))
    scenario = case.scenario
    assert case.label == "closed_loop_8"
    assert [entry.parameter_set for entry in scenario.fleet] == ["wu2018"]
    assert scenario.world.currents[0].count == 4
    # Every fifth physics step is recorded.
    assert scenario.time.steps_per_sample * scenario.time.physics_steps == 5
    # 24 cells on average of the 16^3.
    assert scenario.world.fill * 16**3 == pytest.approx(24, rel=0.01)


def test_engine_kernels_and_robots_are_passed_on():
    (case,) = ask(workloads=("reef_fleet",), worlds=(4,), robots=(16,), engine="mjx")
    assert case.scenario.engine == "mjx"
    assert [entry.count for entry in case.scenario.fleet] == [8, 8]
    (case,) = ask(workloads=("reef_fleet",), worlds=(4,), robots=(1,), kernels="cuda")
    assert case.scenario.kernels == "cuda"
    assert [entry.count for entry in case.scenario.fleet] == [1]


def test_the_dynamics_have_one_robot_in_each_world_and_one_engine():
    chosen = ask(workloads=("dynamics",), worlds=(1, 64), robots=(4, 16))
    assert [(case.worlds, case.robots) for case in chosen] == [(1, 1), (64, 1)]
    with pytest.raises(ConfigError, match="fused engine alone"):
        ask(workloads=("dynamics",), worlds=(1,), engine="mjx")
    chosen = ask(workloads=("dynamics_arm",), worlds=(1, 64), robots=(4, 16))
    assert [(case.worlds, case.robots) for case in chosen] == [(1, 1), (64, 1)]
    with pytest.raises(ConfigError, match="mjx engine alone"):
        ask(workloads=("dynamics_arm",), worlds=(1,), engine="fused")


def test_recording_is_the_demo_at_10_hz(tmp_path):
    (case,) = ask(workloads=("recording",), worlds=(4,), folder=tmp_path)
    assert case.scenario.time.record_hz == 10.0
    assert case.scenario.engine == "fused"
    assert case.folder == tmp_path


def test_a_scenario_is_a_workload_too():
    (case,) = ask(workloads=("heterogeneous",), worlds=(4,))
    assert case.scenario.name == "heterogeneous"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"workloads": ("reef_fleat",)}, "closed_loop_8"),
        ({"worlds": (4, 0)}, "--worlds 0"),
        ({"robots": (-1,)}, "--robots -1"),
        ({"repeats": 9}, "at least 10"),
        ({"workloads": ("compile",), "scenarios": ("reef",)}, "unknown scenario 'reef'"),
        ({"workloads": ("mjx",), "scenarios": ("reef_fleet",)}, "is for --workload compile"),
        ({"devices": 99}, "--devices 99"),
    ],
)
def test_what_cannot_be_measured_is_refused(changes, message):
    with pytest.raises(ConfigError, match=message):
        ask(**changes)


def test_the_command_measures_compares_and_tabulates(tmp_path, monkeypatch, capsys):
    # The device itself, in a sixteenth of the time.
    load = roofline._LOADS["cpu"]
    short = replace(load, copied=load.copied // 16, chained=load.chained // 16)
    monkeypatch.setitem(roofline._LOADS, "cpu", short)
    out = tmp_path / "rows.jsonl"
    size = ["--worlds", "2", "--robots", "2"]
    main(["bench", "--workload", "clearance", *size, "--out", str(out)])
    assert "queries/s" in capsys.readouterr().out
    main(["bench", "--compare", str(out), str(out)])
    assert "1.000" in capsys.readouterr().out
    main(["bench", "--table", str(out)])
    assert "| clearance |" in capsys.readouterr().out


@pytest.fixture
def _known_device(monkeypatch):
    """The limits of this machine are measured where a row is; elsewhere some will do."""
    known = roofline.DeviceSpeed(copy_bytes_per_s=1e10, fma_flops_per_s=1e11, driver=None)
    monkeypatch.setattr(roofline, "measure", lambda: known)


@pytest.mark.nightly(by="test_operations_of_every_simulation_are_counted")
@pytest.mark.usefixtures("_known_device")
@pytest.mark.parametrize("name", WORKLOADS)
def test_the_command_ends_with_a_row_of_every_workload(tmp_path, name):
    out = tmp_path / "rows.jsonl"
    size = ["--worlds", "2", "--robots", "1"]
    size += ["--scenario", "open_water_current"] if name == "compile" else []
    main(["bench", "--workload", name, *size, "--out", str(out)])
    rows = speed.read_rows(out)
    assert len(rows) == (8 if name == "compile" else 1)
    for row in rows:
        assert row["refused"] is None
        assert row["median"] > 0


class Amounts(Progress):
    """Progress as lists of steps and amounts."""

    def __init__(self):
        self.steps, self.amounts, self.units = [], [], []

    def start(self, total, done=0, unit="worlds"):
        self.units.append((total, unit))

    def describe(self, text):
        self.steps.append(text)

    def advance(self, amount, vehicle_steps=0):
        self.amounts.append(amount)


@pytest.mark.parametrize(
    ("seconds", "calls", "timed"),
    [
        ([0.2], 4, 1),
        # The first call loads the program.
        ([3.0, 0.2], 4, 2),
        ([9.0, 8.4], 1, 2),
        ([1.0, 1.0], 1, 2),
    ],
)
def test_a_turn_has_one_call_where_a_warm_call_is_long(seconds, calls, timed):
    left = list(seconds)
    assert simulation._choose_calls(4, lambda: left.pop(0)) == calls
    assert len(seconds) - len(left) == timed


def test_calls_are_not_timed_where_a_turn_has_one_anyway():
    assert simulation._choose_calls(1, lambda: pytest.fail("a call was timed")) == 1


@pytest.mark.parametrize(
    ("long_s", "begin"),
    [
        (0.0, "5 s of simulated time from rest, in one device call, as it takes 0 s or more: cur"),
        (1e9, "10 s of simulated time from rest, in 2 device calls: current"),
    ],
)
def test_a_row_says_how_many_calls_a_turn_has(tmp_path, monkeypatch, long_s, begin):
    """As on a GPU, where short calls are timed in turns of several."""
    file = tmp_path / "tiny.toml"
    file.write_text(TINY.replace("horizon_s = 2.0", "horizon_s = 60.0"))
    monkeypatch.setattr(simulation, "LONG_CALL_S", long_s)
    monkeypatch.setattr(simulation, "_max_calls", lambda simulator: 2)
    seen = Amounts()
    row = simulation.measure(
        load_scenario(file), label="tiny", worlds=2, repeats=10, counted=False, progress=seen
    )
    assert row.inside.startswith(begin)
    assert seen.steps == ["sampling and planning worlds", "compiling the simulation", "timing"]
    assert seen.units == [(10, "turns")]
    assert sum(seen.amounts) == 10


def test_turns_are_reported_after_their_time(monkeypatch):
    """Ten that count; the first never does, nor any within a second."""
    now_s = [0.0]
    monkeypatch.setattr(speed.time, "perf_counter", lambda: now_s[0])
    seen, counts = Amounts(), []
    for is_counted in speed.iterate_turns(3, seen):
        assert len(seen.amounts) == len(counts)
        counts.append(is_counted)
        now_s[0] += 0.6
    assert counts == seen.amounts == [False, False, True, True, True]
    assert seen.units == [(3, "turns")]


def test_a_scenario_in_which_a_policy_commands_is_measured(tmp_path):
    """Programs of a simulator with a policy have one more argument."""
    file = tmp_path / "tiny.toml"
    whole = TINY.replace("count = 1", "count = 2").replace("horizon_s = 2.0", "horizon_s = 60.0")
    file.write_text(whole + '[execution]\norder = "kept"\n')
    row = simulation.measure(load_scenario(file), label="tiny", worlds=2, repeats=10, counted=False)
    assert row.median > 0
    assert row.active_share > 0.9


@pytest.mark.usefixtures("_known_device")
def test_the_command_takes_several_of_everything(tmp_path, monkeypatch, capsys):
    def measure(*, worlds, robots, repeats):
        return make_row(workload="clearance", worlds=worlds, robots=robots, unit="queries/s")

    def motion(*, vehicles, repeats, kernels):
        return make_row(workload="dynamics", worlds=vehicles, robots=1)

    monkeypatch.setattr(hull_clearance, "measure", measure)
    monkeypatch.setattr(free_motion, "measure", motion)
    monkeypatch.setenv("ANGLER_COMMIT", "abc1234")
    out = tmp_path / "rows.jsonl"
    numbers = ["--worlds", "2", "4", "--robots", "1", "4", "16"]
    for times in (1, 2):  # what is measured again is appended
        main(["bench", "--workload", "clearance", "dynamics", *numbers, "--out", str(out)])
        rows = speed.read_rows(out)
        assert [(row["workload"], row["worlds"], row["robots"]) for row in rows] == times * [
            *(("clearance", worlds, robots) for robots in (1, 4, 16) for worlds in (2, 4)),
            *(("dynamics", worlds, 1) for worlds in (2, 4)),
        ]
    assert {row["commit"] for row in rows} == {"abc1234"}


@pytest.mark.usefixtures("_known_device")
def test_the_command_says_what_recording_found(tmp_path, monkeypatch, capsys):
    extra = {
        "disk_mbps": 500.0,
        "disk_spread": 0.1,
        "disk_ratio": 0.9,
        "samples_mbps": 900.0,
        "bytes_per_robot_sample": 94.0,
        "vehicle_steps_per_s": 1e9,
        "break_even_hz": 0.48,
    }

    def measure(scenario, *, label, worlds, repeats, folder, progress):
        return make_row(workload=label, worlds=worlds, unit="MB/s", extra=extra)

    monkeypatch.setattr(recording, "measure", measure)
    out = tmp_path / "rows.jsonl"
    main(["bench", "--workload", "recording", "--worlds", "2", "--out", str(out)])
    said = " ".join(capsys.readouterr().out.split())
    assert "90% of what the disk takes" in said
    assert "above 0.48 Hz" in said
    (row,) = speed.read_rows(out)
    assert row["extra"] == extra


def test_the_command_draws(tmp_path, rows_file):
    out = tmp_path / "new" / "performance.png"
    main(["bench", "--chart", str(rows_file), "--out", str(out)])
    assert out.read_bytes().startswith(b"\x89PNG")


def test_one_thing_at_a_time(capsys, rows_file):
    with pytest.raises(SystemExit, match="2"):
        main(["bench", "--chart", str(rows_file), "--table", str(rows_file)])
    assert "give one of them" in capsys.readouterr().err


def test_every_workload_says_what_it_is():
    assert all(workload.about for workload in WORKLOADS.values())


def test_help_and_page_name_every_workload():
    listed = re.search(r"workload: (.*?), or scenarios by name", " ".join(bench.__doc__.split()))
    assert listed[1].split(", ") == list(WORKLOADS)
    page = Path(__file__).parents[4] / "docs" / "explanation" / "performance.md"
    table = page.read_text(encoding="utf-8").partition("| workload |")[2].partition("\n\n")[0]
    assert sorted(re.findall(r"^\| `(\w+)` \|", table, re.M)) == sorted(WORKLOADS)


def test_the_page_says_which_workloads_a_profile_has():
    page = Path(__file__).parents[4] / "docs" / "explanation" / "performance.md"
    text = " ".join(page.read_text(encoding="utf-8").split())
    pattern = r"`--profile quick` measures (.*?) with 64 worlds\. .* measure all but (.*?), which"
    quick, left_out = re.search(pattern, text).groups()
    assert PROFILES["quick"].worlds == (64,)
    assert set(re.findall(r"`(\w+)`", quick)) == set(PROFILES["quick"].workloads)
    for profile in ("full", "paper"):
        rest = set(WORKLOADS) - set(PROFILES[profile].workloads)
        assert set(re.findall(r"`(\w+)`", left_out)) == rest
