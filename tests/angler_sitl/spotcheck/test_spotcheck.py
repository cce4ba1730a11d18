"""Spot checks: picking, gaps by closed forms, worlds made again, and a whole one with other flyers.

The run is made by hand, and who flies its worlds again is put in by the tests; but in the last one,
which needs a real ArduSub.
"""

import csv
import importlib.util
import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pyarrow as pa
import pytest
from matplotlib.figure import Figure

from angler_mjx.cli.main import main
from angler_mjx.errors import ConfigError, RunError
from angler_mjx.progress import Progress
from angler_mjx.robot.control.commands.joint_trajectory import JointTrajectory
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.laws.ardusub.gains import ArduSubGains
from angler_mjx.robot.vehicles import library
from angler_mjx.runs.rollout import rollout
from angler_mjx.runs.storage.folder import (
    EPISODES,
    SUMMARY,
    TRAJECTORIES,
    Run,
)
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.sim.state import Outcome, World
from angler_sitl.firmware import parameters, probe
from angler_sitl.spotcheck import (
    figures,
    flight,
    gaps,
    rebuilt_worlds,
    runner,
    world_flyers,
    world_selection,
)
from angler_sitl.spotcheck.flight import SpotcheckFlight
from angler_sitl.spotcheck.results import SpotcheckSettings

SCENE = """
schema_version = 1
name = "small"
seed = 4
worlds = 1
engine = "fused"

[time]
horizon_s = 6.0
record_hz = 5.0

[world]
preset = "open"
placement = "random"

[[fleet]]
vehicle = "bluerov2_heavy"
parameter_set = "wu2018"

[[fleet]]
vehicle = "bluerov2"
"""


CROSSING = """
schema_version = 1
name = "crossing"
engine = "fused"
worlds = 1
tile = 1

[time]
horizon_s = 40.0
record_hz = 5.0

[world]
preset = "open"
shape = [10, 10, 4]
depth_m = 2.0
placement = "given"
start_m = [[-5.0, 0.0, -6.0], [0.0, -5.0, -4.0]]
goal_m = [[5.0, 0.0, -6.0], [0.0, 5.0, -4.0]]

[[world.currents]]
type = "uniform"
velocity_mps = [0.0, -0.15, 0.0]

[[world.obstacles.explicit]]
type = "sphere"
radius_m = 0.7
position_m = [0.0, 1.6, -6.0]
motion = {type = "drift"}

[[fleet]]
vehicle = "bluerov2_heavy"
count = 2

[planner]
replan_hz = 1.0
delay_s = 0.25
information = {obstacles = "observed"}
"""


def episodes(outcomes):
    """A table of worlds of two robots: the one given, and one that arrived."""
    world = np.repeat(np.arange(len(outcomes)), 2)
    ends = [end for outcome in outcomes for end in (outcome, "reached")]
    return pa.table({"world": world, "outcome": ends})


def test_rare_outcomes_are_picked_first():
    table = episodes(["reached"] * 40 + ["timeout"] * 5 + ["diverged"])
    for seed in range(10):
        picks = world_selection.pick_worlds(table, 6, seed=seed)
        worlds = [pick.world for pick in picks]
        assert worlds == sorted(set(worlds))
        why = [pick.why for pick in picks]
        # Three outcomes take turns: once diverged, for there is no more, then by turns of two.
        assert why.count("diverged") == 1
        assert why.count("timeout") in (2, 3)
        assert 45 in worlds
    assert world_selection.pick_worlds(table, 6, seed=3) == world_selection.pick_worlds(
        table, 6, seed=3
    )
    drawn = {
        tuple(p.world for p in world_selection.pick_worlds(table, 6, seed=seed))
        for seed in range(10)
    }
    assert len(drawn) > 1


def test_without_strata_any_world_is_as_likely():
    table = episodes(["reached"] * 19 + ["diverged"])
    rare = sum(
        19 in [p.world for p in world_selection.pick_worlds(table, 2, seed=seed, stratify="none")]
        for seed in range(200)
    )
    # 2 of 20 worlds: 20 of 200 draws, with a standard deviation of 4.2.
    assert 4 <= rare <= 36
    assert len(world_selection.pick_worlds(table, 20, stratify="none")) == 20


def test_more_worlds_than_there_are_cannot_be_picked():
    with pytest.raises(ConfigError, match="the run has 3 worlds"):
        world_selection.pick_worlds(episodes(["reached"] * 3), 4)
    with pytest.raises(ConfigError, match="--episodes 0"):
        world_selection.pick_worlds(episodes(["reached"] * 3), 0)


def straight(*, delay_s=0.0, aside_m=0.0, end_s=20.0, outcome="reached", pwm_us=1600):
    """One robot east at 0.5 m/s for so long, sampled at 5 Hz for 4 s more, then at rest."""
    time = np.arange(0.0, end_s + 4.0, 0.2)
    x = 0.5 * np.clip(time - delay_s, 0.0, end_s - delay_s)
    p = np.stack([x, np.zeros_like(x), aside_m + np.zeros_like(x)], axis=1)[:, None]
    signals = np.full((time.size, 1, 3), 1500)
    signals[..., 0], signals[..., 1] = pwm_us, 3000 - pwm_us  # the third is padding
    reached = outcome == "reached"
    row = {
        "outcome": outcome,
        "time_to_goal_s": end_s if reached else float("nan"),
        "failure_time_s": float("nan") if reached else end_s,
        "min_clearance_m": 1.0 - aside_m,
    }
    return SpotcheckFlight(time_s=time, p_m=p, pwm_us=signals, rows=(row,))


def test_a_way_aside_is_as_far_as_it_is():
    (gap,) = gaps.compute_gaps(0, straight(aside_m=0.3, pwm_us=1650), straight())
    for value in (gap.track_rms_m, gap.path_rms_m, gap.track_end_m, gap.endpoint_m):
        assert value == pytest.approx(0.3)
    assert gap.arrival_s == 0.0
    assert gap.clearance_m == pytest.approx(-0.3)
    assert (gap.effort_us, gap.other_effort_us) == (pytest.approx(150.0), pytest.approx(100.0))
    assert gap.agrees


def test_a_delay_is_no_way_aside():
    (gap,) = gaps.compute_gaps(0, straight(delay_s=2.0, end_s=22.0), straight())
    # 1 m behind, but for the first 2 s, in which that grows: rms over 20 s by integration.
    assert gap.track_rms_m == pytest.approx(np.sqrt((18.0 + 2.0 / 3.0) / 20.0), rel=0.01)
    assert gap.track_end_m == pytest.approx(1.0)
    assert gap.path_rms_m == pytest.approx(0.0, abs=1e-9)
    assert gap.arrival_s == pytest.approx(2.0)
    assert gap.endpoint_m == pytest.approx(0.0, abs=1e-9)


def test_robots_are_compared_until_the_first_of_both_ends():
    failed = straight(end_s=7.1, outcome="collision_static")
    (gap,) = gaps.compute_gaps(5, failed, straight())
    assert (gap.world, gap.robot) == (5, 0)
    assert gap.time_s[-1] == pytest.approx(7.0)
    assert gap.track_rms_m == pytest.approx(0.0, abs=1e-9)
    # It failed at 3.55 m, the goal is at 10 m. Between two samples, 10 cm apart at 0.5 m/s, it is
    # taken to go on evenly.
    assert gap.endpoint_m == pytest.approx(6.45, abs=0.05)
    assert np.isnan(gap.arrival_s)
    assert not gap.agrees


def test_sums_count_what_they_say():
    same = gaps.compute_gaps(0, straight(aside_m=0.1), straight())
    lost = gaps.compute_gaps(1, straight(end_s=5.0, outcome="timeout"), straight())
    either = gaps.compute_gaps(
        2, straight(outcome="timeout"), straight(outcome="collision_static", aside_m=0.5)
    )
    one = gaps.summarise_gaps([*same, *lost, *either])
    assert (one.robots, one.agree, one.arrivals_agree) == (3, 1, 2)
    assert one.endpoint_m[0] == pytest.approx(0.1)  # only of the one that agrees
    assert one.track_rms_m[0] == pytest.approx(0.1)
    assert one.agree_low < 1 / 3 < one.agree_high


@pytest.fixture(scope="module")
def made():
    """Makers of the runs that pictures are tested with: no simulation, a second's work."""
    path = Path(__file__).parents[2] / "angler_mjx" / "report" / "conftest.py"
    spec = importlib.util.spec_from_file_location("runs_by_hand", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def run(made, tmp_path_factory):
    """Two worlds of four robots, 60 s."""
    path = tmp_path_factory.mktemp("runs") / "run"
    return made.make_run(path, [made.make_scene(0), made.make_scene(1)], 2)


@pytest.fixture(scope="module")
def world(made):
    """World 1 of the run as it is drawn again: one world leads, plans as the planner gives them."""
    scene = made.make_scene(1)
    environment = jax.tree.map(lambda leaf: np.asarray(leaf)[None], scene.environment)
    plans = [np.r_[robot.plan_m, robot.plan_m[-1:]] for robot in scene.robots]
    times = np.tile(np.float32([0.0, 30.0, 60.0, 60.0]), (1, 4, 1))
    return World(
        environment=environment,
        variant=np.zeros((1, 4), np.int32),
        cruise_speed_mps=np.ones((1, 4), np.float32),
        path=Trajectory(time_s=times, position_m=np.float32([plans]), found=np.ones((1, 4), bool)),
    )


def test_a_run_that_a_policy_commanded_is_refused(run, settings, tmp_path, capsys):
    copy = tmp_path / "run"
    shutil.copytree(run.path, copy)
    (copy / "policy.json").write_text('{"class": "mine.Policy", "sha256": "0"}')
    out = tmp_path / "out"
    with pytest.raises(SystemExit) as left:
        main(["spotcheck", str(copy), "--ardusub", str(settings.binary), "--out", str(out)])
    assert left.value.code == 2
    said = capsys.readouterr().err
    assert said.count("angler: ") == 1
    assert "policy.json: a policy commanded the robots of this run" in " ".join(said.split())
    assert not out.exists()


@pytest.mark.parametrize("flag", ["--out", "--resume"])
def test_a_name_that_cannot_be_is_refused(flag, run, settings, tmp_path):
    long = tmp_path / ("x" * 300)
    with pytest.raises(ConfigError, match=f"{flag} x.*has 300 bytes"):
        runner.run_spot_check(run.path, settings, long, None, resume=flag == "--resume")


def test_a_world_is_made_again_byte_by_byte(run, world):
    like = rebuilt_worlds.compare_world(run, 1, world)
    assert like.identical == like.arrays > 10
    assert "byte by byte" in like.describe()


def test_the_plans_that_were_recorded_are_flown(run, made, world, tmp_path):
    """Whatever the planner of the scenario would give now; of either type, byte by byte."""
    flown = rebuilt_worlds.add_recorded_plans(run, 1, world)
    assert jax.tree.structure(flown) == jax.tree.structure(world)
    np.testing.assert_array_equal(flown.path.position_m, world.path.position_m)
    np.testing.assert_array_equal(flown.path.time_s, world.path.time_s)
    assert np.asarray(flown.planned).all()
    motion = made.make_motion(2)
    jointed = made.make_run(tmp_path / "run", [made.make_scene(0), made.make_scene(1)], 2, motion)
    path = rebuilt_worlds.add_recorded_plans(jointed, 1, world).path
    assert isinstance(path, JointTrajectory)
    np.testing.assert_array_equal(path.position[..., :3], world.path.position_m)
    np.testing.assert_array_equal(path.position[0, ..., 3], motion["plan_yaw_rad"][1])
    np.testing.assert_array_equal(path.velocity[0], motion["plan_velocity"][1])
    np.testing.assert_array_equal(path.degree[0], motion["plan_degree"][1])
    assert path.degree.dtype == np.int32


def test_another_world_is_refused_and_rounding_is_told(run, world):
    with pytest.raises(RunError, match="world 0 cannot be made again"):
        rebuilt_worlds.compare_world(run, 0, world)
    environment = world.environment
    near = replace(environment, start_m=environment.start_m + 1e-5)
    like = rebuilt_worlds.compare_world(run, 1, replace(world, environment=near))
    assert like.identical == like.arrays - 1
    assert like.where == "environment/start_m"
    assert 0 < like.difference < 2e-5


def test_a_flight_is_read_as_it_was_written(run, tmp_path):
    known = flight.load_recorded(run, 1, 4)
    assert known.p_m.shape == (301, 4, 3)  # 60 s at 5 Hz
    flight.save_flight(tmp_path / "a" / "one.npz", known)
    again = flight.load_flight(tmp_path / "a" / "one.npz")
    np.testing.assert_array_equal(again.p_m, known.p_m)
    np.testing.assert_array_equal(again.pwm_us, known.pwm_us)
    assert json.dumps(again.rows) == json.dumps(known.rows)
    assert flight.load_recorded(run, 1, 1).p_m.shape == (301, 1, 3)
    (tmp_path / "a" / "one.npz").write_bytes(b"PK\x03\x04 cut short")
    with pytest.raises(ConfigError, match=r"one\.npz: cannot be read"):
        flight.load_flight(tmp_path / "a" / "one.npz")


class Reports(Progress):
    """A progress that remembers."""

    def __init__(self):
        self.begun, self.flights = None, 0

    def start(self, total, done=0, unit="worlds"):
        self.begun = (total, done)
        assert unit == "flights"

    def advance(self, amount, vehicle_steps=0):
        self.flights += amount


class Shifted:
    """Flies what the run recorded, so far aside; interrupted when its time has come."""

    def __init__(self, run, aside_m, left):
        self._run, self._aside, self._left = run, aside_m, left

    def __enter__(self):
        return self

    def __exit__(self, *ended):
        pass

    def fly(self, index, worlds, tell):
        if self._left[0] == 0:
            raise KeyboardInterrupt
        self._left[0] -= 1
        tell(1.0)
        known = flight.load_recorded(self._run, index, worlds.variant.shape[1])
        return replace(known, p_m=known.p_m + np.array([0.0, 0.0, self._aside]))


@pytest.fixture
def flyers(monkeypatch, run, stand_in, world):
    """Puts in other flyers; a list of one number: how many flights are left until Ctrl-C."""
    left = [-1]
    aside = {"surrogate": 0.05, "cascade": 0.0, "thrusters": 0.1, "guided": 0.3}
    monkeypatch.setattr(
        runner, "_make_flyer", lambda found, name, count: Shifted(run, aside[name], left)
    )
    monkeypatch.setattr(
        runner.rebuilt_worlds, "sample_worlds", lambda scenario, indices: {1: world}
    )
    monkeypatch.setattr(
        runner.world_selection,
        "pick_worlds",
        lambda *_, **__: (world_selection.WorldPick(world=1, why="x"),),
    )
    return left


@pytest.fixture
def settings(stand_in):
    return SpotcheckSettings(episodes=1, binary=stand_in.path)


def test_a_spot_check_reports_the_gaps(run, flyers, settings, tmp_path):
    out, reports = tmp_path / "check", Reports()
    found = runner.run_spot_check(run.path, settings, out, reports)
    assert found.complete
    assert (reports.begun, reports.flights) == ((4, 0), pytest.approx(4))
    with (out / "gaps.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * 3 * 4  # levels, references, robots
    gap = {(row["level"], row["against"]): float(row["track_rms_m"]) for row in rows}
    assert gap["thrusters", "recorded"] == pytest.approx(0.1, rel=1e-4)
    assert gap["guided", "surrogate"] == pytest.approx(0.25, rel=1e-4)
    assert gap["guided", "cascade"] == pytest.approx(0.3, rel=1e-4)
    report = (out / "report.md").read_text()
    assert "byte by byte" in report
    for name in ("summary.png", "world_000001_4.png"):
        assert name in report
        assert (out / name).stat().st_size > 10_000
    with pytest.raises(ConfigError, match="exists"):
        runner.run_spot_check(run.path, settings, out, reports)
    with pytest.raises(ConfigError, match="complete"):
        runner.run_spot_check(run.path, settings, out, reports, resume=True)


def test_what_was_interrupted_goes_on(run, flyers, settings, tmp_path, monkeypatch):
    # Drawn in the test above; here they would take most of the time.
    for name in ("plot_summary", "plot_world"):
        monkeypatch.setattr(figures, name, lambda *_: Figure(figsize=(1.0, 1.0)))
    out, reports = tmp_path / "check", Reports()
    flyers[0] = 3
    found = runner.run_spot_check(run.path, settings, out, reports)
    assert not found.complete
    assert "Interrupted" in (out / "report.md").read_text()
    assert [key[1] for key in found.flights] == ["recorded", "surrogate", "cascade", "thrusters"]
    with pytest.raises(ConfigError, match="--resume"):
        runner.run_spot_check(run.path, settings, out, reports)
    other = replace(settings, source="vicon")
    with pytest.raises(
        ConfigError, match=r"begun with another source .see .*: 'vision', not 'vicon'"
    ):
        runner.run_spot_check(run.path, other, out, reports, resume=True)
    flyers[0] = -1
    again = runner.run_spot_check(run.path, settings, out, reports, resume=True)
    assert again.complete
    assert reports.begun == (4, 3)
    assert "Interrupted" not in (out / "report.md").read_text()


def test_what_cannot_be_checked_is_refused(run, stand_in, tmp_path, capsys):
    bare = tmp_path / "bare"
    bare.mkdir()
    for name in ("config.json", SUMMARY, EPISODES):
        (bare / name).write_bytes((run.path / name).read_bytes())
    assert not (Run(bare).path / TRAJECTORIES).exists()
    program = str(stand_in.path)
    for given, said in (
        ([str(tmp_path / "none"), "--episodes", "1"], "not a run folder"),
        ([str(run.path), "--episodes", "9"], "the run has 2 worlds"),
        ([str(bare), "--episodes", "1"], "trajectories.zarr: is missing"),
        ([str(run.path), "--episodes", "1", "--robots", "5"], "the run has 4 robots"),
        ([str(run.path), "--episodes", "1", "--speed", "fast"], "--speed fast"),
        ([str(run.path), "--episodes", "1", "--resume"], "there is no interrupted spot check"),
        ([str(run.path), "--episodes", "1", "--ardusub", str(tmp_path / "x")], str(tmp_path / "x")),
    ):
        asked = given if "--ardusub" in given else [*given, "--ardusub", program]
        with pytest.raises(SystemExit) as ended:
            main(["spotcheck", *asked, "--out", str(tmp_path / "out")])
        assert ended.value.code == 2
        assert said in capsys.readouterr().err.replace("\n", " ")
        assert not (tmp_path / "out").exists()


def test_fewer_robots_of_a_world_are_the_first_of_it(world):
    like = jax.tree.map(lambda leaf: leaf, world)
    short = replace(
        like,
        variant=like.variant[:, :3],
        environment=replace(like.environment, start_m=like.environment.start_m[:, :3]),
    )
    cut = rebuilt_worlds.select_robots(world, short, 3)
    assert cut.variant.shape == (1, 3)
    assert cut.path.time_s.shape == (1, 3, 4)
    np.testing.assert_array_equal(cut.environment.start_m, world.environment.start_m[:, :3])
    np.testing.assert_array_equal(cut.environment.grid.occupied, world.environment.grid.occupied)


@pytest.fixture
def anew(run, tmp_path):
    """The run as of a scenario whose plans are made anew in flight."""
    copy = tmp_path / "anew"
    shutil.copytree(run.path, copy)
    config = json.loads((copy / "config.json").read_text())
    planner = config["planner"]
    planner |= {"replan_hz": 2.0, "delay_s": 0.25}
    planner["information"] = {"obstacles": "observed", "current": "nothing"}
    config["execution"] = {"order": "kept"}
    (copy / "config.json").write_text(json.dumps(config))
    (copy / "policy.json").write_text('{"class": "of the scenario", "sha256": "0"}')
    return copy


def test_a_run_that_planned_anew_is_checked_and_said_to_be_one(
    anew, flyers, settings, tmp_path, monkeypatch
):
    for name in ("plot_summary", "plot_world"):
        monkeypatch.setattr(figures, name, lambda *_: Figure(figsize=(1.0, 1.0)))
    found = runner.run_spot_check(anew, settings, tmp_path / "check", Reports())
    assert found.complete
    report = (tmp_path / "check" / "report.md").read_text()
    for said in ("at 2 Hz", "0.25 s later", "obstacles: observed", "in the order"):
        assert said in report
    # Of each kind of flight: how many robots ended in each way.
    rows = found.flights[1, "guided", 4].rows
    planned = sum(row["planned"] for row in rows)
    reached = sum(row["outcome"] == "reached" for row in rows)
    assert f"| guided | 4 | {planned} of 4 | {reached} of 4" in report


class Booted:
    """A session whose only robot flies on and on, and that remembers its commands."""

    def __init__(self, scenario, **_):
        self.resets, self.reports = 0, []

    def reset(self, worlds):
        self.resets += 1
        return SimpleNamespace(status=(SimpleNamespace(outcome=Outcome.RUNNING),))

    def step(self, commands=None):
        self.reports.append(commands)
        return SimpleNamespace(status=(SimpleNamespace(outcome=Outcome.RUNNING),))

    def inside(self):
        simulator = SimpleNamespace(labels=list)
        return SimpleNamespace(worlds=None, state=None, sample=np.zeros(1), simulator=simulator)


class Planning:
    """What looks after plans: commands are numbers, counted from each beginning."""

    made = 0

    def __init__(self, session):
        Planning.made += 1
        self.restart()

    def restart(self):
        self.number = 0

    def commands(self, observation):
        self.number += 1
        return {0: self.number}


@pytest.mark.parametrize("flown", [True, False])
def test_autopilots_get_the_commands_of_the_policy_of_the_scenario(flown, monkeypatch):
    monkeypatch.setattr(world_flyers, "SitlSession", Booted)
    monkeypatch.setattr(world_flyers.online_policy, "OnlineFlyer", Planning)
    monkeypatch.setattr(world_flyers.flight, "build_flight", lambda *_, **__: None)
    monkeypatch.setattr(Planning, "made", 0)
    time = SimpleNamespace(control_steps=3, steps_per_sample=1, control_dt_s=0.05)
    flyer = world_flyers.SitlFlyer(
        SimpleNamespace(time=time, seed=1, flown=flown), "guided", "vision", "max", None
    )
    for index in (4, 7):
        flyer.fly(index, None, lambda share: None)
    session = flyer._session
    assert session.resets == 2
    if flown:  # begun anew in the second world, and compiled for the first alone
        assert session.reports == [{0: 1}, {0: 2}, {0: 3}] * 2
        assert Planning.made == 1
    else:
        assert session.reports == [None] * 6


@pytest.mark.sitl
def test_the_surrogates_gains_are_those_of_the_firmware(ardusub, tmp_path):
    given = parameters.for_vehicle(library.load_vehicle("bluerov2_heavy"), "guided", "vision")
    with probe.start_stationary(ardusub, tmp_path, given) as still:
        read = probe.query_autopilot(still).parameters
    ours = vars(ArduSubGains())
    trims = {read[f"SERVO{n}_TRIM"] for n in range(1, 9)}
    assert trims == {ours.pop("SERVO_TRIM")}
    differing = {
        # The firmware keeps float32.
        name: (value, read.get(name))
        for name, value in ours.items()
        if read.get(name) != pytest.approx(value, rel=1e-6)
    }
    assert differing == {}


@pytest.mark.sitl
def test_a_real_autopilot_flies_the_plan_of_a_run(ardusub, tmp_path):
    (tmp_path / "small.toml").write_text(SCENE)
    run = rollout(load_scenario(tmp_path / "small.toml"), out=tmp_path / "run")
    settings = SpotcheckSettings(
        episodes=1, against=("cascade",), levels=("thrusters",), binary=ardusub.path
    )
    found = runner.run_spot_check(run.path, settings, tmp_path / "check", Reports())
    assert all("byte by byte" in text for text in found.likeness.values())
    for gap in found.list_gaps("thrusters", 2, "cascade"):
        # The same controllers on the same plan, by way of a real autopilot's filter and outputs,
        # some 10 ms later: at 0.5 m/s that is a centimetre or so. Left standing it would be 2 m.
        assert gap.track_rms_m < 0.1
        assert gap.agrees
    for gap in found.list_gaps("thrusters", 2, "recorded"):
        assert gap.track_rms_m < 0.1


@pytest.mark.sitl
def test_a_real_autopilot_is_planned_for_anew_as_in_a_run(ardusub, tmp_path):
    """A sphere drifts into the way of the first robot, and no plan before the start knows of it."""
    (tmp_path / "crossing.toml").write_text(CROSSING)
    run = rollout(load_scenario(tmp_path / "crossing.toml"), out=tmp_path / "run")
    settings = SpotcheckSettings(episodes=1, against=(), levels=("guided",), binary=ardusub.path)
    found = runner.run_spot_check(run.path, settings, tmp_path / "check", Reports())
    rows = found.flights[0, "guided", 2].rows
    # Along its first plan it is hit: see the flights of planning/online, in the same scene.
    assert [row["outcome"] for row in rows] == ["reached", "reached"]
    for gap in found.list_gaps("guided", 2, "recorded"):
        assert gap.agrees
        # Of two plans that are nearly as good either may be taken, and then flights are a metre
        # apart; both are flown at cruise speed, 20 s of it.
        assert abs(gap.arrival_s) < 4.0
