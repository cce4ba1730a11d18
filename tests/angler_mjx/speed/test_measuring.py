from dataclasses import replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.cli.main import main
from angler_mjx.errors import ConfigError, RunError
from angler_mjx.sim.state import Outcome
from angler_mjx.speed import measuring, roofline
from angler_mjx.speed import (
    rows as speed,
)
from angler_mjx.speed.measured import free_motion, hull_clearance, recording, simulation
from angler_mjx.speed.measured.hull_clearance import require_change
from angler_mjx.speed.measured.simulation import require_moving
from angler_mjx.speed.workloads import (
    PROFILES,
    WORKLOADS,
    Request,
    cases,
)

from .rows import make_row


def ask(**changes):
    return cases(Request(**changes))


@pytest.fixture(scope="module")
def measured():
    """One closed loop, small enough for a test, on the engine that runs everywhere."""
    (case,) = ask(workloads=("closed_loop_8",), worlds=(2,), robots=(2,), kernels="xla")
    (row,) = measuring.run([case], lambda case: None)
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


SIMULATED = [name for name, workload in WORKLOADS.items() if workload.kind == "simulation"]


@pytest.mark.parametrize("name", SIMULATED)
def test_operations_of_every_simulation_are_counted(name):
    """Traced only: what follows the timed calls of `measure`."""
    (case,) = ask(workloads=(name,), worlds=(2,), robots=(1,))
    counted = simulation._count(case.scenario.model_dump_json())
    # Hundreds of operations for a physics step of one robot, on either engine.
    assert 500 < counted.flops < 50_000
    # A scenario's repeats share one count.
    assert simulation._count(case.scenario.model_dump_json()) is counted


def test_drawing_worlds_ends_with_a_number():
    (case,) = ask(workloads=("env_generation",), worlds=(2,), robots=(1,))
    (row,) = measuring.run([case], lambda case: None)
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


def test_one_standing_robot_is_refused():
    path = np.full((2, 3), 0.5)
    path[1, 2] = 0.0
    with pytest.raises(RunError, match="1 of 6 robots stood still"):
        require_moving(state(path_length_m=jnp.asarray(path)), SAMPLE, 1.25)


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
    rows = list(measuring.run(chosen, lambda case: None))
    # 64 worlds are not tried after 16 did not fit.
    assert [(row.worlds, row.robots) for row in rows] == [(4, 1), (16, 1), (4, 2), (16, 2)]
    assert [row.out_of_memory for row in rows] == [False, True, False, True]
    assert "4 worlds in one call fit" in rows[1].refused
    assert rows[1].median is None


def test_a_refused_run_has_no_number(monkeypatch):
    def measure(*args, **kwargs):
        raise RunError("the timed run holds NaN: no number is given")

    monkeypatch.setattr(simulation, "measure", measure)
    (row,) = measuring.run(ask(workloads=("mjx",), worlds=(4,)), lambda case: None)
    assert row.median is None
    assert "NaN" in row.refused
    assert not row.out_of_memory


@pytest.mark.parametrize("profile", sorted(PROFILES))
def test_all_workloads_of_a_profile_load(profile):
    chosen = cases(Request(profile=profile))
    assert {case.workload.kind for case in chosen} <= {
        "dynamics",
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
    (case,) = ask(workloads=("reef_fleet",), worlds=(4,), robots=(1,), kernels="triton")
    assert case.scenario.kernels == "triton"
    assert [entry.count for entry in case.scenario.fleet] == [1]


def test_the_dynamics_have_one_robot_in_each_world_and_one_engine():
    chosen = ask(workloads=("dynamics",), worlds=(1, 64), robots=(4, 16))
    assert [(case.worlds, case.robots) for case in chosen] == [(1, 1), (64, 1)]
    with pytest.raises(ConfigError, match="fused engine alone"):
        ask(workloads=("dynamics",), worlds=(1,), engine="mjx")


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
    main(["bench", "--workload", name, "--worlds", "2", "--robots", "1", "--out", str(out)])
    (row,) = speed.read(out)
    assert row["refused"] is None
    assert row["median"] > 0


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
        rows = speed.read(out)
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

    def measure(scenario, *, label, worlds, repeats, folder):
        return make_row(workload=label, worlds=worlds, unit="MB/s", extra=extra)

    monkeypatch.setattr(recording, "measure", measure)
    out = tmp_path / "rows.jsonl"
    main(["bench", "--workload", "recording", "--worlds", "2", "--out", str(out)])
    said = " ".join(capsys.readouterr().out.split())
    assert "90% of what the disk takes" in said
    assert "above 0.48 Hz" in said
    (row,) = speed.read(out)
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
