"""Trials: flights against closed forms, measures against known answers, draws by their seeds."""

import csv
import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.cli import main
from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.commands import ThrusterPwm
from angler_mjx.sim.engines import free_flight
from angler_mjx.studies.flights import courses, kinds, tracks
from angler_mjx.studies.flights import samples as drawing
from angler_mjx.studies.flights.kinds import FlightKind
from angler_mjx.studies.trials import (
    document,
    figure_of_eight,
    figures,
    sample_report,
    samples,
    steps,
)
from angler_mjx.studies.trials.trial import Trial, misses_of_eight, misses_of_step
from angler_mjx.world.currents import Uniform

from ...compiling import quickly

HEAVY = FlightKind(vehicle="bluerov2_heavy", parameter_set="wu2018")


@pytest.fixture(scope="module")
def drifting():
    """One vehicle, 2 kg too heavy and thrusters still, in a current, for 60 s."""
    spec = kinds.spec_of("cascade")
    params = kinds.select_rows(kinds.build_params([HEAVY]), [0])
    params = jax.tree.map(lambda leaf: leaf[0], params)
    neutral = params.vehicle.volume_m3 * 1000.0
    plant = dataclasses.replace(params.vehicle, mass_kg=neutral + 2.0)

    @quickly
    def fly(flow):
        return free_flight.simulate_flight(
            spec,
            params,
            jnp.array([0.0, 0.0, -200.0]),
            jnp.array(0.0),
            ThrusterPwm(pwm_us=jnp.full(params.vehicle.B.shape[1], 1500.0)),
            (Uniform(velocity_mps=flow),),
            control_steps=1200,
            plant=plant,
        )

    return fly(jnp.array([0.4, -0.2, 0.0])), plant


def test_a_vehicle_without_thrust_sinks_and_drifts_as_its_drag_has_it(drifting):
    flight, plant = drifting
    D_l, D_q = float(plant.D_l[2]), float(plant.D_q[2])
    weight = 2.0 * 9.81
    sinking = 2 * weight / (D_l + math.sqrt(D_l**2 + 4 * D_q * weight))
    p = np.asarray(flight.p, float)
    v = (p[-1] - p[-101]) / 5.0
    # 60 s are dozens of time constants; float32 of 200 m is 1.5e-5 m, over 5 s.
    np.testing.assert_allclose(v, [0.4, -0.2, -sinking], atol=2e-3)
    np.testing.assert_array_equal(p[0], [0.0, 0.0, -200.0])


def test_the_figure_of_eight_has_the_derivatives_that_it_says():
    points = courses.figure_of_eight(0.5, 1500, 0.02)
    position, velocity, acceleration = np.moveaxis(points, 1, 0)
    # Central differences err by h^2 / 6 of the third derivative of each, which is below 20.
    for lower, upper in ((position, velocity), (velocity, acceleration)):
        found = np.gradient(lower, 0.02, axis=0)[5:-5]
        np.testing.assert_allclose(found, upper[5:-5], atol=1.4e-3)
    speed = np.linalg.norm(velocity[:, :3], axis=1)
    assert speed[0] == 0.0
    np.testing.assert_allclose(speed[200:], 0.5, rtol=1e-6)
    # The nose points along the path.
    heading = np.stack([np.cos(position[:, 3]), np.sin(position[:, 3])], axis=1)
    np.testing.assert_allclose(heading[200:] * 0.5, velocity[200:, :2], atol=1e-6)


def test_the_vortices_reach_the_speed_that_is_asked_for():
    vortices = drawing.build_vortices(np.array([0.0, 0.4]))
    a = np.linspace(0, 2 * np.pi, 2000)
    line = jnp.asarray(np.stack([2 * np.sin(a), np.sin(2 * a), 0 * a], axis=1), float)
    for row, most in enumerate((0.0, 0.4)):
        one = jax.tree.map(lambda leaf, row=row: leaf[row], vortices)
        flow = quickly(jax.vmap(lambda p, one=one: one.flow(p, jnp.zeros(()))[0]))(line)
        # The greatest speed lies between the points that it was looked for at.
        assert float(jnp.linalg.norm(flow, axis=1).max()) == pytest.approx(most, rel=1e-3)


def test_rise_and_settling_of_a_first_order_answer():
    t = 0.001 * np.arange(20_000)
    answer = 1.0 - np.exp(-t)
    # ln 9 and ln 50, to the step of time.
    assert tracks.rise_of(t, answer) == pytest.approx(math.log(9), abs=2e-3)
    assert tracks.settling_of(t, answer) == pytest.approx(math.log(50), abs=2e-3)
    assert math.isnan(tracks.rise_of(t, 0.5 * answer))
    assert tracks.settling_of(t, 0.5 * answer) == math.inf


@pytest.mark.parametrize(
    ("amplitude", "decay_s", "expected"),
    [(0.02, math.inf, True), (0.005, math.inf, False), (0.5, 5.0, False), (0.5, 40.0, True)],
)
def test_only_swings_that_do_not_die_out_are_oscillations(amplitude, decay_s, expected):
    t = 0.05 * np.arange(1200)
    pose = np.zeros((1200, 4))
    pose[:, 1] = amplitude * np.exp(-(t - 40.0) / decay_s) * np.sin(2.0 * t)
    assert tracks.is_oscillating(pose, -200) is expected


@pytest.fixture(scope="module")
def flown():
    return {name: steps.fly_steps(name, [HEAVY]) for name in ("cascade", "los")}


def test_the_cascade_meets_its_targets_and_los_steers_its_own_heading(flown):
    assert [s.axis for s in flown["cascade"].steps[::2]] == ["x", "y", "z", "yaw"]
    assert [s.axis for s in flown["los"].steps[::2]] == ["x", "y", "z"]
    for name in flown:
        assert not any(misses_of_step(s) for s in flown[name].steps)
    assert all(math.isnan(s.error_rad) for s in flown["los"].steps)
    bad = dataclasses.replace(flown["cascade"].steps[0], error_m=0.03, error_rad=0.1, swings=True)
    assert misses_of_step(bad) == ["oscillates", "3 cm", "5.7 degrees"]
    # In the current 3 cm are within the target.
    assert misses_of_step(dataclasses.replace(bad, current_mps=0.5, swings=False)) == []


SEEDS = (3, 8, 170)


@pytest.fixture(scope="module")
def verdicts():
    return list(samples.fly_samples("cascade", SEEDS))


def test_a_seed_is_a_draw_within_its_limits():
    many = [samples.sample_trial(seed) for seed in range(300)]
    assert {one.kind for one in many} == set(kinds.shipped_vehicles())
    volts = [one.battery_v for one in many]
    assert min(volts) >= 12.0
    assert max(volts) <= 18.0
    assert max(np.linalg.norm(one.current_mps) for one in many) <= 0.8
    assert max(np.linalg.norm(one.step_m) for one in many) <= 2.0
    shares = np.stack([one.gain_factors for one in many])
    assert shares.min() >= 0.8
    assert shares.max() <= 1.2
    again = samples.sample_trial(170)
    assert again.kind == many[170].kind
    np.testing.assert_array_equal(again.gain_factors, many[170].gain_factors)


def test_every_gain_is_scaled_by_its_own_share_but_settings_stay():
    shares = np.linspace(0.8, 1.2, 64)[None]
    cascade = samples.gains_of(kinds.spec_of("cascade"), shares)
    follow, pose, _, _ = cascade
    np.testing.assert_allclose(follow.lag_stop_m, 1.0 * shares[:, 2], rtol=1e-6)
    np.testing.assert_allclose(pose.position_per_s, 0.8 * shares[:, 3], rtol=1e-6)
    _, firmware = samples.gains_of(kinds.spec_of("ardusub"), shares)
    assert float(firmware.SERVO_TRIM[0]) == 1500.0
    assert float(firmware.WPNAV_SPEED[0]) == 100.0
    np.testing.assert_allclose(firmware.PSC_POSXY_P, 1.0 * shares[:, 3], rtol=1e-6)


def test_a_draw_flies_alone_as_it_does_among_others(verdicts):
    (alone,) = samples.fly_samples("cascade", SEEDS[1:2])
    among = verdicts[1]
    assert alone.sample.seed == among.sample.seed == 8
    # Compiled for another number of robots the sums round otherwise; the loop is stable.
    assert alone.distance_m == pytest.approx(among.distance_m, abs=1e-3)
    assert alone.tilt_rad == pytest.approx(among.tilt_rad, abs=1e-3)
    assert alone.outcome == among.outcome


def test_outcomes_are_told_apart(verdicts):
    good = dataclasses.replace(
        verdicts[0],
        tilt_rad=0.1,
        rate_radps=1.0,
        end_rate_radps=0.0,
        distance_m=0.0,
        able_mps=0.7,
    )
    fast = dataclasses.replace(good.sample, current_mps=np.array([0.6, 0.0, 0.0]))
    slow = dataclasses.replace(good.sample, current_mps=np.array([0.3, 0.0, 0.0]))

    def outcome(**changes):
        return dataclasses.replace(good, **changes).outcome

    assert outcome() == "station"
    assert outcome(sample=fast, distance_m=2.0) == "outrun"
    assert outcome(sample=slow, distance_m=2.0) == "away"
    for fault in ({"tilt_rad": 1.2}, {"rate_radps": 11.0}, {"end_rate_radps": 0.6}):
        assert outcome(**fault) == "failed"
    assert dataclasses.replace(good, distance_m=math.nan).fault == "diverges"


def test_nothing_holds_level_what_has_neither_weight_nor_thrusters_for_it():
    (loose,) = kinds.find_unstabilised()
    params = kinds.build_params([loose])
    # Its centres of mass and of buoyancy are one, and no thruster is asked for pitch.
    assert float(jnp.abs(params.vehicle.p_cb_m).max()) == 0.0
    assert float(jnp.abs(params.allocation.B_inverse[0, :, 4]).max()) == 0.0


def trial_of(name, flown, verdicts):
    t = np.linspace(0, 2 * np.pi, 50)
    line = np.stack([2 * np.sin(t), np.sin(2 * t)], axis=1)
    eights = tuple(
        figure_of_eight.FigureOfEight(
            kind=HEAVY,
            condition=condition,
            speed_mps=0.5,
            in_time_m=0.1,
            across_m=0.05,
            track_m=line,
            course_m=line,
        )
        for condition, _, _ in figure_of_eight.CONDITIONS
    )
    return Trial(controller=name, flown=flown[name], eights=eights, verdicts=tuple(verdicts[name]))


def test_the_document_holds_what_was_measured(tmp_path, flown, verdicts):
    away = [dataclasses.replace(verdict, distance_m=2.0) for verdict in verdicts]
    verdicts = {"cascade": verdicts, "los": away}
    trials = [trial_of(name, flown, verdicts) for name in ("cascade", "los")]
    assert [len(misses_of_eight(e)) for e in trials[0].eights] == [1, 0, 0]
    page = tmp_path / "control.md"
    page.write_text(f"before\n{document.BEGIN}\nold\n{document.END}\nafter\n")
    document.write_document(
        page, document.format_document(trials, flown["cascade"].steps, "images")
    )
    found = page.read_text()
    assert found.startswith("before\n")
    assert found.endswith("after\n")
    assert "\nold\n" not in found
    assert (
        "| [cascade](#cascade) | 0.0 cm, 0.0° | 0.0 cm | 10.0 cm; 1 of 1 miss | 10.0 cm |" in found
    )
    # Every row of a table has as many cells as the one above it.
    rows = [line for line in found.splitlines() if line.startswith("|")]
    widths = [line.count("|") for line in rows]
    heads = [i for i, line in enumerate(rows) if line.startswith("| ---")]
    assert all(widths[i] == widths[i - 1] == widths[i + 1] for i in heads)
    sample_report.write_samples(tmp_path / "draws.csv", trials)
    with (tmp_path / "draws.csv").open() as file:
        listed = {
            (row["controller"], int(seed))
            for row in csv.DictReader(file)
            for seed in row["seeds"].split()
        }
    lost = {
        (name, v.sample.seed) for name in verdicts for v in verdicts[name] if v.outcome != "station"
    }
    assert {("los", seed) for seed in SEEDS} <= lost
    assert listed == lost
    figure = figures.plot_trial(trials[1])
    assert [axes.get_title(loc="left") for axes in figure.axes[:3]] == [
        "2 m along x",
        "2 m along y",
        "2 m along z",
    ]


def test_a_page_without_marks_is_left_alone(tmp_path):
    page = tmp_path / "control.md"
    page.write_text("nothing here\n")
    with pytest.raises(ConfigError, match="no place for tables"):
        document.write_document(page, "x")
    assert page.read_text() == "nothing here\n"


def test_the_command_refuses_what_is_not_there(capsys):
    for arguments in (["--controller", "autopilot"], ["--draws", "-1"], ["--draw", "-3"]):
        with pytest.raises(SystemExit) as stopped:
            main.main(["control", *arguments])
        assert stopped.value.code == 2
    said = capsys.readouterr().err
    assert "unknown controller 'autopilot'; there is cascade, pid" in said


def test_the_command_flies_one_draw(capsys):
    main.main(["control", "--controller", "cascade", "--draw", "8"])
    assert "cascade, draw 8: bluerov2_heavy, von_benzon2022, 13.9 V" in capsys.readouterr().out
