"""Tuning as a whole: knobs, flights, both methods, folders, files that others read."""

import dataclasses
import math

import numpy as np
import pytest

from angler_mjx.cli import main
from angler_mjx.errors import ConfigError
from angler_mjx.progress import Progress
from angler_mjx.robot.control import stages
from angler_mjx.robot.control.laws.ardusub.gains import ArduSubGains
from angler_mjx.scenario.scenario import load_scenario, shipped_scenarios
from angler_mjx.studies.tuning import (
    figures,
    flying,
    folder,
    gain_files,
    knobs,
    problem,
    samples,
    search,
    tune,
)
from angler_mjx.studies.tuning.optimisers import Cma
from angler_mjx.studies.tuning.problem import TuningProblem, TuningSettings

SCENARIO = "open_water_current"
ROLLOUTS = 6
"""Two robots on three courses, once each."""


@pytest.fixture(autouse=True)
def _small(monkeypatch):
    # One program serves candidates and single flights; and the commit is not asked for.
    monkeypatch.setattr(flying, "CHUNK", {"cpu": ROLLOUTS})
    monkeypatch.setenv("ANGLER_COMMIT", "0" * 40)


def settings(controller="cascade", method="cma", **more):
    given = {
        "scenario": load_scenario(SCENARIO),
        "controller": controller,
        "objective": "ise",
        "method": method,
        "rollouts": ROLLOUTS,
        "generations": 2,
        "seed": 1,
    }
    return TuningSettings(**{**given, **more})


@pytest.mark.parametrize("controller", stages.CONTROLLERS)
def test_knobs_change_gains_within_bounds_and_never_their_sign(controller):
    spec = problem.spec_of(load_scenario(SCENARIO), controller)
    turned = knobs.build_knobs(spec)
    for end in ("low", "high"):
        at = [getattr(knob, end) for knob in turned]
        for stage, gains in zip(
            spec.stages, knobs.apply_settings(spec, turned, np.array(at)), strict=True
        ):
            if stage.check is not None:
                stage.check(gains)
        for knob, setting in zip(turned, at, strict=True):
            assert -math.log(knobs.SPAN) <= knob.low <= 0 <= knob.high <= math.log(knobs.SPAN)
            for name, value in zip(knob.gains, knob.values(setting), strict=True):
                assert value > 0
                least, most = knobs.RANGES.get(name, (0.0, math.inf))
                assert least * (1 - 1e-3) <= value <= most * (1 + 1e-3)
    # What is written has four digits, and settings are of what is written.
    for knob, at in zip(
        turned, knobs.round_settings(turned, [0.1234567] * len(turned)), strict=True
    ):
        assert knob.values(at) == knob.values(0.1234567) or at in (knob.low, knob.high)


def test_gains_that_a_scenario_gives_are_where_the_search_begins():
    given = {"name": "cascade", "gains": {"velocity": {"velocity_per_s": 3.25}}}
    loaded = load_scenario(SCENARIO, controller=given)
    (knob,) = [
        k
        for k in knobs.build_knobs(problem.spec_of(loaded, "cascade"))
        if k.gains[0].startswith("vel")
    ]
    assert knob.start == (3.25,)
    begin = knobs.build_knobs(problem.spec_of(loaded, "pid"))
    assert begin == knobs.build_knobs(problem.spec_of(load_scenario(SCENARIO), "pid"))


def test_flights_are_known_by_their_numbers_and_go_round_robots_and_courses():
    robots = samples.select_robots(load_scenario("heterogeneous"))
    assert any("blue_ismc" in label for label in robots.left_out)
    assert not any("blue_ismc" in label for label in robots.labels)
    n = 3 * len(robots.labels)
    few = samples.sample_flights(robots, n, 4, samples.TRAIN, 0.05, timed=True)
    more = samples.sample_flights(robots, 2 * n, 4, samples.TRAIN, 0.05, timed=True)
    other = samples.sample_flights(robots, n, 4, samples.HELD_OUT, 0.05, timed=True)
    assert sorted(few.group) == list(range(n))
    for name in ("start_m", "yaw_rad"):
        a, b = (np.asarray(getattr(x.settings, name)) for x in (few, more))
        np.testing.assert_array_equal(a, b[:n])
    mass = [
        np.asarray(x.settings.plant.mass_kg / x.settings.params.vehicle.mass_kg)
        for x in (few, other)
    ]
    assert not np.any(mass[0] == mass[1])
    # A fifth more or less, to float32.
    assert np.all(np.abs(mass[0] - 1.0) <= 0.2 + 1e-6)
    weak = samples.sample_flights(robots, n, 4, samples.TRAIN, 0.05, timed=True, thrust_error=0.3)
    thrust = np.asarray(weak.settings.plant.B) / np.where(
        believed := np.asarray(few.settings.params.vehicle.B), believed, np.inf
    )
    share = thrust.max(axis=(1, 2))
    assert np.all(np.abs(share - 1.0) <= 0.3 + 1e-6)
    assert np.ptp(share) > 0.3
    np.testing.assert_array_equal(few.settings.plant.B, few.settings.params.vehicle.B)
    still = np.asarray(few.reference.still) == 1
    speed = np.linalg.norm(np.asarray(few.settings.current[0].velocity_mps), axis=1)
    able = np.asarray(few.settings.params.vehicle.terminal_speed_mps)[:, :2].min(axis=1)
    assert np.all(speed <= np.minimum(0.8, 0.6 * able) + 1e-6)
    assert np.all(speed[~still] == 0.0)
    swirl = np.abs(np.asarray(few.settings.current[1].circulation_m2ps)).max(axis=1)
    np.testing.assert_array_equal(swirl > 0, ~still)
    # Targets of steps are 0.5 to 2 m away; the reference is where the vehicle is to be at the end.
    steps = few.group % 3 == 0
    away = np.linalg.norm(few.reference.pose[steps, -1, :3] - [0, 0, -10.0], axis=1)
    assert np.all((away >= 0.5) & (away <= 2.0))


def test_a_fleet_that_nothing_holds_level_is_refused():
    fleet = [{"vehicle": "bluerov2", "parameter_set": "blue_ismc"}]
    with pytest.raises(ConfigError, match="level"):
        samples.select_robots(load_scenario(SCENARIO, fleet=fleet))


@pytest.fixture(scope="module")
def cascade():
    return TuningProblem(settings())


@pytest.mark.nightly(by="tuning/test_search.py")
def test_the_gradient_is_that_of_the_flights_and_evolution_goes_the_same_way(cascade):
    d = len(cascade.knobs)
    origin = np.zeros((1, d))
    sloped = cascade.evaluate(origin, gradients=True, done=lambda _: None)
    assert sloped.costs[0] == pytest.approx(1.0, rel=1e-4)
    gradient = np.array(sloped.gradients[0])
    h = 0.03
    steps = np.concatenate([h * np.eye(d), -h * np.eye(d)])
    costs = np.array(cascade.evaluate(steps, gradients=False, done=lambda _: None).costs)
    slope = (costs[:d] - costs[d:]) / (2 * h)
    # Curvature over 3 % of a gain, and clipped thrust that has kinks, leave a few per cent.
    np.testing.assert_allclose(gradient, slope, atol=0.05 * np.abs(slope).max())
    history = search.TuningHistory()
    low, high = ([getattr(k, end) for k in cascade.knobs] for end in ("low", "high"))

    def evaluate(candidates, *, gradients):
        return cascade.evaluate(candidates, gradients=gradients, done=lambda _: None)

    search.run_search(Cma(low, high, seed=2), evaluate, history, 3, lambda _: None)
    cost, best = history.best()
    assert cost < 0.9
    # Downhill by the gradient, within 75 degrees of the steepest way.
    cosine = -np.dot(best, gradient) / (np.linalg.norm(best) * np.linalg.norm(gradient))
    assert cosine > math.cos(math.radians(75))


class Stop(Progress):
    """Interrupts after some generations."""

    def __init__(self, after):
        self.after = after

    def describe(self, text):
        if text.startswith(f"generation {self.after},"):
            raise KeyboardInterrupt


def read(path):
    return {entry.name: entry.read_bytes() for entry in sorted(path.iterdir())}


def test_a_tuning_that_was_interrupted_leaves_its_best_and_ends_with_the_same_bytes(
    tmp_path, monkeypatch
):
    # One figure stands for all; the command draws them all below.
    monkeypatch.setattr(figures, "FIGURES", {"search": figures.plot_search})
    # Flights of 15 s are as good to be repeated as those of 30 s.
    monkeypatch.setattr(samples, "FLIGHT_S", 15.0)
    monkeypatch.setattr(flying, "FLIGHT_S", 15.0)
    wanted = settings("ardusub", objective="robust")
    whole = tune.tune(wanted, tmp_path / "whole")
    assert whole.complete
    part = tune.tune(wanted, tmp_path / "part", Stop(1))
    assert not part.complete
    assert "1 of 2 generations (interrupted)" in (tmp_path / "part" / "gains.toml").read_text()
    assert part.history.generations == whole.history.generations[:1]
    again = tune.tune(wanted, tmp_path / "part", resume=True)
    assert again.complete
    assert read(tmp_path / "part") == read(tmp_path / "whole")
    names = {"checkpoint.json", "gains.toml", "report.md", "ardusub.param", "ardusub.params"}
    assert set(read(tmp_path / "whole")) == names | {"search.png"}
    assert whole.train.cost <= 1.0
    assert whole.train.cost == pytest.approx(whole.history.best()[0], rel=0.05)
    with pytest.raises(ConfigError, match="complete"):
        tune.tune(wanted, tmp_path / "whole", resume=True)
    with pytest.raises(ConfigError, match="exists"):
        tune.tune(wanted, tmp_path / "whole")
    # The scenario takes the gains as they are written.
    scenario = tmp_path / "with_gains.toml"
    source = shipped_scenarios()[SCENARIO].read_text(encoding="utf-8")
    assert "[controller" not in source
    scenario.write_text(source + "\n" + (tmp_path / "whole" / "gains.toml").read_text())
    assert load_scenario(scenario).controller.stack()[1] == whole.gains


def test_an_interrupt_before_anything_is_known_leaves_a_tuning_to_go_on_with(tmp_path):
    class Now(Progress):
        def advance(self, amount, vehicle_steps=0):
            raise KeyboardInterrupt

    wanted, out = settings(), tmp_path / "early"
    with pytest.raises(KeyboardInterrupt):
        tune.tune(wanted, out, Now())
    assert not out.exists()
    with pytest.raises(ConfigError, match="--resume"):
        tune.tune(wanted, out)
    with pytest.raises(ConfigError, match=r"another seed \(1 there, 2 here\)"):
        tune.tune(dataclasses.replace(wanted, seed=2), out, resume=True)
    start = folder.TuningCheckpoint(settings={}, provenance={})
    claimed, found = folder.declare_folder(start, lambda _: None).acquire(out, resume=True)
    assert found.generations == []
    assert claimed.building.name == ".early.partial"
    claimed.release()


COMMENTS = ("one", "two")


def test_parameter_files_hold_what_differs_by_the_names_of_the_firmware(tmp_path):
    gains = ArduSubGains(PSC_VELXY_P=4.25, ATC_RAT_RLL_D=0.0123, SERVO_TRIM=1510.0, ANGLE_MAX=3000)
    written = gain_files.format_param_file(gains, 6, COMMENTS)
    lines = [line for line in written.splitlines() if not line.startswith("#")]
    values = {name: float(value) for name, value in (line.split(",") for line in lines)}
    servos = {f"SERVO{i}_TRIM": 1510.0 for i in range(1, 7)}
    assert values == {
        "PSC_VELXY_P": 4.25,
        "ATC_RAT_RLL_D": 0.0123,
        "ANGLE_MAX": 3000.0,
        # The surrogate flies with other than the firmware's own 1000.
        "WPNAV_SPEED": 100.0,
        **servos,
    }
    known = {field.name for field in dataclasses.fields(ArduSubGains)}
    assert set(values) - set(servos) < known
    assert all(len(name) <= 16 for name in values)  # MAVLink has no longer ones
    tabbed = [
        line.split("\t")
        for line in gain_files.format_params_file(gains, 6, COMMENTS).splitlines()[2:]
    ]
    assert {row[2]: float(row[3]) for row in tabbed} == values
    kinds = {row[2]: row[4] for row in tabbed}
    assert kinds["ANGLE_MAX"] == kinds["SERVO3_TRIM"] == "4"
    assert kinds["PSC_VELXY_P"] == kinds["WPNAV_SPEED"] == "9"
    mavparm = pytest.importorskip("pymavlink.mavparm")
    path = tmp_path / "ardusub.param"
    path.write_text(written)
    loaded = mavparm.MAVParmDict()
    assert loaded.load(str(path))
    assert dict(loaded) == values


def test_all_tuned_parameters_of_ardusub_have_a_documented_range():
    tuned = {name for names in knobs.TUNED_GAINS["ardusub"] for name in names}
    assert tuned == set(knobs.RANGES)
    default = ArduSubGains()
    for name, (least, most) in knobs.RANGES.items():
        assert least <= getattr(default, name) <= most


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--controller", "casc"], "there is cascade"),
        (["--controller", "cascade", "--rollouts", "5"], "6 at least"),
        (["--controller", "cascade", "--generations", "0"], "1 or more"),
    ],
)
def test_what_cannot_be_used_is_refused_with_a_message(arguments, message, tmp_path, capsys):
    out = tmp_path / "out"
    given = ["tune", SCENARIO, "--objective", "ise", "--out", str(out), *arguments]
    with pytest.raises(SystemExit) as ended:
        main.main(given)
    assert ended.value.code == 2
    assert message in " ".join(capsys.readouterr().err.split())
    assert list(tmp_path.iterdir()) == []


def test_the_command_tunes_and_says_what_came_of_it(tmp_path, capsys):
    out = tmp_path / "out"
    given = ["tune", SCENARIO, "--controller", "cascade", "--objective", "energy"]
    given += ["--method", "cma", "--rollouts", "6", "--generations", "1", "--out", str(out)]
    main.main(given)
    printed = capsys.readouterr().out
    assert printed.splitlines()[-1] == str(out)
    assert "velocity.velocity_per_s: 4 ->" in printed
    assert "tuned for energy" in (out / "report.md").read_text()
    drawn = {path.stem for path in out.glob("*.png")}
    assert drawn == {"search", "errors", "tracks"}
    assert not list(out.glob("ardusub*"))
