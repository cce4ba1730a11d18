"""Sea trials against closed forms and independent integrations of simple vehicles."""

import csv
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, fsolve

from angler_mjx.cli.main import main
from angler_mjx.errors import ConfigError
from angler_mjx.robot.vehicles.library import load_thruster, load_vehicle
from angler_mjx.robot.vehicles.thrusters import tables_at
from angler_mjx.studies.sea_trials import measures
from angler_mjx.studies.sea_trials.actuators import build_actuators
from angler_mjx.studies.sea_trials.check_vehicle import TrialSettings, check_vehicle
from angler_mjx.studies.sea_trials.program import SAMPLE_S, TrialMotion

from ...robot.vehicles import made_up

R = math.sqrt(0.5)
# Four across the corners at the height of the centre of mass, four upward: all six axes.
HOVER = (
    ("front_right", (0.2, -0.2, 0.0), (-R, -R, 0.0), 1),
    ("front_left", (0.2, 0.2, 0.0), (-R, R, 0.0), 1),
    ("back_right", (-0.2, -0.2, 0.0), (R, -R, 0.0), -1),
    ("back_left", (-0.2, 0.2, 0.0), (R, R, 0.0), -1),
    ("up_1", (0.2, -0.2, 0.0), (0.0, 0.0, 1.0), 1),
    ("up_2", (0.2, 0.2, 0.0), (0.0, 0.0, 1.0), -1),
    ("up_3", (-0.2, -0.2, 0.0), (0.0, 0.0, 1.0), -1),
    ("up_4", (-0.2, 0.2, 0.0), (0.0, 0.0, 1.0), 1),
)
TAU_S = 0.02
M, ADDED, I_Z, ADDED_Z = 20.0, 10.0, 0.8, 0.2
I_X, ADDED_X, ARM_M = 0.5, 0.1, 0.05
LINEAR, QUADRATIC = (10.0, 12.0, 15.0, 0.3, 0.4, 2.0), (20.0, 25.0, 30.0, 0.0, 0.0, 3.0)


def build(tmp_path, thrusters=HOVER, name="simple", **changes):
    """A vehicle with one parameter set of round numbers."""
    numbers = {
        "mass": M,
        "inertia": (I_X, 0.6, I_Z),
        "volume": M / 1000.0,
        "arm": ARM_M,
        "added": (ADDED, ADDED, ADDED, ADDED_X, 0.1, ADDED_Z),
        "linear": LINEAR,
        "quadratic": QUADRATIC,
        **changes,
    }
    path = made_up.write(tmp_path / f"{name}.toml", thrusters, name)
    text = path.read_text()
    text = text[: text.index("[parameter_sets.")]
    text = text.replace('default_set = "blue_gazebo"', 'default_set = "round"')
    text = text.replace(
        "center_of_mass_m = [0.0, 0.0, 0.011]", "center_of_mass_m = [0.0, 0.0, 0.0]"
    )
    source = 'source = "round numbers"'
    for key in ("inertia", "added", "linear", "quadratic"):
        numbers[key] = list(numbers[key])
    text += f"""
[parameter_sets.round]
description = "round numbers"
[parameter_sets.round.rigid_body]
mass_kg = {numbers["mass"]}
inertia_kgm2 = {numbers["inertia"]}
{source}
[parameter_sets.round.buoyancy]
volume_m3 = {numbers["volume"]}
center_of_buoyancy_m = [0.0, 0.0, {numbers["arm"]}]
{source}
[parameter_sets.round.added_mass]
coefficients = {numbers["added"]}
{source}
[parameter_sets.round.damping]
linear = {numbers["linear"]}
quadratic = {numbers["quadratic"]}
{source}
"""
    path.write_text(text)
    return load_vehicle(str(path))


@pytest.fixture(scope="module")
def simple(tmp_path_factory):
    return build(tmp_path_factory.mktemp("simple"))


@pytest.fixture(scope="module")
def check(simple):
    return check_vehicle(simple)


def value(check, trial, quantity):
    (found,) = [m for m in check.measures if (m.trial, m.quantity) == (trial, quantity)]
    return found.value


def thrust_limits(config):
    thrust_n, _ = tables_at(load_thruster(config.rotor.model), 16.0)
    return float(thrust_n[0]), float(thrust_n[-1])


def wrench_of(config, command):
    """Force and moment of thrusts, from their positions and directions."""
    force, moment = np.zeros(3), np.zeros(3)
    for thruster, newton in zip(config.thrusters.layout, command, strict=True):
        push = newton * np.array(thruster.direction)
        force += push
        moment += np.cross(thruster.position_m, push)
    return force, moment


def balance(force, linear, quadratic):
    return brentq(lambda v: linear * v + quadratic * v * v - force, 0.0, 100.0)


# ---------------------------------------------------------------- speeds


def test_terminal_speeds_are_those_of_the_drag_balance(simple, check):
    reverse, forward = thrust_limits(simple)
    level = 2 * R * (forward - reverse)  # two of four run backward
    for trial, axis in (("surge ahead", 0), ("surge astern", 0), ("sway to port", 1)):
        expected = balance(level, LINEAR[axis], QUADRATIC[axis])
        assert value(check, trial, "terminal speed") == pytest.approx(expected, rel=2e-3)
    up = balance(4 * forward, LINEAR[2], QUADRATIC[2])
    down = balance(-4 * reverse, LINEAR[2], QUADRATIC[2])
    assert value(check, "heave up", "terminal speed") == pytest.approx(up, rel=2e-3)
    assert value(check, "heave down", "terminal speed") == pytest.approx(down, rel=2e-3)


def test_buoyancy_helps_up_and_hinders_down(tmp_path):
    config = build(tmp_path, volume=0.021)  # 1 kg beyond its mass
    check = check_vehicle(config, only=["heave"])
    reverse, forward = thrust_limits(config)
    up = balance(4 * forward + 9.81, LINEAR[2], QUADRATIC[2])
    down = balance(-4 * reverse - 9.81, LINEAR[2], QUADRATIC[2])
    assert value(check, "heave up", "terminal speed") == pytest.approx(up, rel=2e-3)
    assert value(check, "heave down", "terminal speed") == pytest.approx(down, rel=2e-3)


def test_turning_on_the_spot_is_the_balance_of_yaw(simple, check):
    command = build_actuators(simple, 16.0).push("yaw", 1)
    force, moment = wrench_of(simple, command)
    assert np.linalg.norm(force) < 1e-6 * moment[2]
    assert np.abs(moment[:2]).max() < 1e-6 * moment[2]
    expected = math.degrees(balance(moment[2], LINEAR[5], QUADRATIC[5]))
    assert value(check, "turning on the spot", "terminal speed") == pytest.approx(
        expected, rel=2e-3
    )


def test_speeds_rise_as_the_equation_of_motion_says(simple, check):
    reverse, forward = thrust_limits(simple)
    force = 2 * R * (forward - reverse)

    def motion(t, x):
        u = x[0]
        thrust = force * (1.0 - math.exp(-t / TAU_S))
        return [(thrust - LINEAR[0] * u - QUADRATIC[0] * u * abs(u)) / (M + ADDED)]

    limit = (1.0 - math.exp(-1.0)) * balance(force, LINEAR[0], QUADRATIC[0])
    reached = lambda t, x: x[0] - limit  # noqa: E731
    reached.terminal = True
    end = solve_ivp(motion, (0.0, 20.0), [0.0], events=reached, rtol=1e-8, max_step=0.01).t[-1]
    assert value(check, "surge ahead", "time to 63 %") == pytest.approx(end, abs=SAMPLE_S)


# ---------------------------------------------------------------- turning


def steady_turn(force, moment, added=(ADDED, ADDED)):
    """Surge, sway and yaw rate that solve the equations of a steady turn (Fossen 2021, ch. 6)."""
    a_x, a_y = added

    def residual(x):
        u, v, r = x
        drag = [LINEAR[i] * w + QUADRATIC[i] * w * abs(w) for i, w in ((0, u), (1, v), (5, r))]
        return [
            force - drag[0] + (M + a_y) * v * r,
            -drag[1] - (M + a_x) * u * r,
            moment - drag[2] - (a_y - a_x) * u * v,
        ]

    return fsolve(residual, [1.0, -0.1, 0.5])


@pytest.mark.parametrize(("side", "sign"), [("port", 1), ("starboard", -1)])
def test_a_steady_circle_solves_the_equations_of_motion(simple, check, side, sign):
    actuators, settings = build_actuators(simple, 16.0), TrialSettings()
    command = settings.approach * actuators.push("surge", 1)
    command = command + settings.steer * actuators.push("yaw", sign)
    force, moment = wrench_of(simple, command)
    u, v, r = steady_turn(force[0], abs(moment[2]))
    trial = f"turning circle to {side}"
    speed = math.hypot(u, v)
    assert value(check, trial, "steady yaw rate") == pytest.approx(math.degrees(r), rel=5e-3)
    assert value(check, trial, "steady speed") == pytest.approx(speed, rel=5e-3)
    assert value(check, trial, "steady diameter") == pytest.approx(2 * speed / r, rel=1e-2)
    drift = math.degrees(math.atan2(-v, u))
    assert value(check, trial, "drift angle") == pytest.approx(abs(drift), rel=1e-2)


def test_lengths_of_a_turn_onto_a_circle():
    """Straight on at 2 m/s, then a circle of 5 m: advance and transfer 5, tactical diameter 10."""
    time_s = np.arange(0.0, 60.0, SAMPLE_S)
    turned = np.clip(time_s - 20.0, 0.0, None) * 2.0 / 5.0
    along = np.minimum(time_s, 20.0) * 2.0
    x, y = along + 5.0 * np.sin(turned), 5.0 * (1.0 - np.cos(turned))
    zero = np.zeros_like(time_s)
    motion = TrialMotion(
        time_s=time_s,
        p=np.stack([x, y, zero], 1),
        q=np.stack([np.cos(turned / 2), zero, zero, np.sin(turned / 2)], 1),
        nu=np.stack([zero + 2.0, zero, zero, zero, zero, np.where(time_s > 20.0, 0.4, 0.0)], 1),
        steering=zero + 1.0,
    )
    got = {m.quantity: m.value for m in measures.measure_turn("circle", motion, 20.0)}
    expected = {
        "approach speed": 2.0,
        "advance": 5.0,
        "transfer": 5.0,
        "tactical diameter": 10.0,
        "time to 90 deg": math.pi / 2 / 0.4,
        "time to 180 deg": math.pi / 0.4,
        "steady diameter": 10.0,
        "steady yaw rate": math.degrees(0.4),
        "steady speed": 2.0,
        "drift angle": 0.0,
    }
    assert got == pytest.approx(expected, abs=5e-3)


def zigzag(moment, switch_rad):
    """First crossing, and the first two overshoots, of yaw alone with its damping and rotors.

    The steering is reversed at the first multiple of 10 ms, the step, after the crossing.
    """
    times, headings, sign, state, begin = [], [], 1.0, [0.0, 0.0, 0.0], 0.0
    for _ in range(3):

        def motion(_, x, sign=sign):
            drag = LINEAR[5] * x[1] + QUADRATIC[5] * x[1] * abs(x[1])
            return [x[1], (x[2] - drag) / (I_Z + ADDED_Z), (sign * moment - x[2]) / TAU_S]

        reversing = lambda t, x, sign=sign: sign * x[0] - switch_rad  # noqa: E731
        reversing.terminal, reversing.direction = True, 1.0
        leg = solve_ivp(
            motion, (begin, begin + 60.0), state, events=reversing, rtol=1e-8, max_step=0.01
        )
        times.append(leg.t[-1])
        late = math.ceil(leg.t[-1] / 0.01) * 0.01
        rest = solve_ivp(motion, (leg.t[-1], late), leg.y[:, -1], rtol=1e-8)
        headings.append(np.concatenate([leg.y[0], rest.y[0]]))
        begin, state, sign = late, rest.y[:, -1].tolist(), -sign
    overshoots = [headings[1].max() - switch_rad, -headings[2].min() - switch_rad]
    return times[0], [math.degrees(angle) for angle in overshoots]


@pytest.mark.parametrize("degrees", [10, 20])
def test_zigzags_are_those_of_yaw_alone(simple, check, degrees):
    """Equal added masses of surge and sway: nothing but steering and damping turns the vehicle."""
    command = TrialSettings().steer * build_actuators(simple, 16.0).push("yaw", 1)
    _, moment = wrench_of(simple, command)
    turning_s, overshoots = zigzag(moment[2], math.radians(degrees))
    trial = f"zig-zag {degrees}/{degrees}"
    assert value(check, trial, "initial turning time") == pytest.approx(turning_s, abs=0.02)
    for name, expected in zip(("first overshoot", "second overshoot"), overshoots, strict=True):
        assert value(check, trial, name) == pytest.approx(expected, abs=0.1)


def test_a_vehicle_without_moments_of_its_own_holds_its_course(check):
    (loop,) = [m for m in check.measures if m.quantity == "height of the loop, unsteered"]
    assert loop.note == "holds its course"
    assert loop.value < 0.05


def test_an_unstable_vehicle_turns_by_itself(tmp_path):
    """Eigenvalues of sway and yaw at the speed of the approach decide whether it does."""
    a_x, a_y = 2.0, 80.0
    config = build(
        tmp_path,
        added=(a_x, a_y, ADDED, ADDED_X, 0.1, ADDED_Z),
        linear=(10.0, 12.0, 15.0, 0.3, 0.4, 0.2),
    )
    result = check_vehicle(config, only=["spiral"])
    force, _ = wrench_of(config, 0.5 * build_actuators(config, 16.0).push("surge", 1))
    u = balance(force[0], LINEAR[0], QUADRATIC[0])
    mass = np.diag([M + a_y, I_Z + ADDED_Z])
    rates = np.array([[-LINEAR[1], -(M + a_x) * u], [-(a_y - a_x) * u, -0.2]])
    assert np.linalg.eigvals(np.linalg.solve(mass, rates)).real.max() > 0.1
    (loop,) = [m for m in result.measures if m.quantity == "height of the loop, unsteered"]
    assert loop.note == "turns by itself"
    assert loop.value > 1.0


# ---------------------------------------------------------------- stops and decay


def test_a_coasting_vehicle_reaches_as_far_as_linear_drag_lets_it(tmp_path):
    """(m + A) u / D, less what is left at 5 % of the speed, and the last thrust of the rotors."""
    config = build(tmp_path, quadratic=(0.0, 25.0, 30.0, 0.0, 0.0, 3.0))
    result = check_vehicle(config, only=["coasting"])
    force, _ = wrench_of(config, 0.5 * build_actuators(config, 16.0).push("surge", 1))
    speed = force[0] / LINEAR[0]
    assert value(result, "coasting stop", "approach speed") == pytest.approx(speed, rel=5e-3)
    reach = 0.95 * (M + ADDED) * speed / LINEAR[0] + force[0] * TAU_S / LINEAR[0]
    assert value(result, "coasting stop", "track reach") == pytest.approx(reach, rel=5e-3)
    time_s = (M + ADDED) / LINEAR[0] * math.log(20.0) + TAU_S
    assert value(result, "coasting stop", "time") == pytest.approx(time_s, rel=5e-3)


def test_a_crash_stop_is_that_of_the_equation_of_motion(simple, check):
    ahead, _ = wrench_of(simple, 0.5 * build_actuators(simple, 16.0).push("surge", 1))
    astern, _ = wrench_of(simple, 0.5 * build_actuators(simple, 16.0).push("surge", -1))
    speed = balance(ahead[0], LINEAR[0], QUADRATIC[0])

    def motion(_, x):
        u, thrust, _ = x
        drag = LINEAR[0] * u + QUADRATIC[0] * u * abs(u)
        return [(thrust - drag) / (M + ADDED), (astern[0] - thrust) / TAU_S, u]

    stopped = lambda t, x: x[0]  # noqa: E731
    stopped.terminal = True
    start = [speed, ahead[0], 0.0]
    end = solve_ivp(motion, (0.0, 20.0), start, events=stopped, rtol=1e-8, max_step=0.01)
    assert value(check, "crash stop", "time") == pytest.approx(end.t[-1], rel=1e-2)
    assert value(check, "crash stop", "track reach") == pytest.approx(end.y[2, -1], rel=3e-2)


@pytest.mark.parametrize(
    ("trial", "inertia", "damping"), [("roll", I_X + ADDED_X, 0.3), ("pitch", 0.6 + 0.1, 0.4)]
)
def test_decays_are_those_of_a_damped_pendulum(check, trial, inertia, damping):
    stiffness = 9.81 * M * ARM_M  # neutral: weight is buoyancy
    natural = math.sqrt(stiffness / inertia)
    ratio = damping / (2.0 * math.sqrt(stiffness * inertia))
    period = 2.0 * math.pi / (natural * math.sqrt(1.0 - ratio * ratio))
    # A pendulum of 10 degrees is slower by 1 + a^2 / 16, 0.2 %.
    assert value(check, f"{trial} decay", "period") == pytest.approx(period, rel=5e-3)
    assert value(check, f"{trial} decay", "damping ratio") == pytest.approx(ratio, rel=2e-2)


def test_the_decrement_of_a_sampled_decay():
    time_s = np.arange(0.0, 40.0, SAMPLE_S)
    ratio, natural = 0.15, 2.0
    damped = natural * math.sqrt(1.0 - ratio**2)
    # At rest at the start, as a vehicle is.
    angle = np.exp(-ratio * natural * time_s) * (
        np.cos(damped * time_s) + ratio * natural / damped * np.sin(damped * time_s)
    )
    got = {m.quantity: m.value for m in measures.measure_decay("roll", time_s, angle)}
    assert got["period"] == pytest.approx(2 * math.pi / damped, rel=1e-3)
    assert got["damping ratio"] == pytest.approx(ratio, rel=1e-3)


def test_an_overdamped_decay_has_no_period(tmp_path):
    config = build(tmp_path, linear=(10.0, 12.0, 15.0, 30.0, 0.4, 2.0))
    result = check_vehicle(config, only=["roll"])
    assert math.isnan(value(result, "roll decay", "period"))
    # Far from critical damping: the angle falls with D / K.
    expected = 30.0 / (9.81 * M * ARM_M)
    assert value(result, "roll decay", "time to 37 %") == pytest.approx(expected, rel=3e-2)


# ---------------------------------------------------------------- what a vehicle cannot do


@pytest.mark.parametrize(("factor", "tumbles"), [(0.6, False), (1.6, True)])
def test_a_vehicle_tumbles_above_the_speed_at_which_munk_moment_passes_righting(
    tmp_path, factor, tumbles
):
    """Level flight with way on is held while (A_z - A_x) u^2 is below rho g V z_b."""
    a_z = 80.0
    limit = math.sqrt(9.81 * M * ARM_M / (a_z - ADDED))
    speed = factor * limit
    drag = LINEAR[0] * speed + QUADRATIC[0] * speed * speed
    config = build(
        tmp_path,
        added=(ADDED, ADDED, a_z, ADDED_X, 0.1, ADDED_Z),
        linear=(*LINEAR[:2], 1.0, *LINEAR[3:]),
        quadratic=(*QUADRATIC[:2], 1.0, *QUADRATIC[3:]),
        volume=1.002 * M / 1000.0,  # rises slowly: something has to turn it first
    )
    push, _ = wrench_of(config, build_actuators(config, 16.0).push("surge", 1))
    settings = TrialSettings(approach=drag / push[0])
    result = check_vehicle(config, settings=settings, only=["coasting"])
    assert ("coasting stop" in result.left_out) == tumbles
    assert ("coasting stop" in result.motions) == (not tumbles)
    if tumbles:
        assert result.left_out["coasting stop"].startswith("tumbles")
        assert "--approach" in result.left_out["coasting stop"]
    else:
        assert 0.5 * limit < value(result, "coasting stop", "approach speed") < limit


def test_a_held_vehicle_does_not_tumble(tmp_path):
    """At a speed at which it would: the drag balance is that of surge alone."""
    added = (ADDED, ADDED, 80.0, ADDED_X, 0.1, ADDED_Z)
    config = build(tmp_path, added=added, arm=0.002, volume=1.002 * M / 1000.0)
    only = ["surge ahead", "roll"]
    assert "surge ahead" in check_vehicle(config, only=only).left_out
    held = check_vehicle(config, settings=TrialSettings(level=True), only=only)
    assert held.left_out == {"roll decay": "held by --level"}
    reverse, forward = thrust_limits(config)
    expected = balance(2 * R * (forward - reverse), LINEAR[0], QUADRATIC[0])
    assert value(held, "surge ahead", "terminal speed") == pytest.approx(expected, rel=2e-3)


def test_the_spiral_is_one_trial_that_is_left_out_whole(tmp_path):
    added = (ADDED, ADDED, 80.0, ADDED_X, 0.1, ADDED_Z)
    config = build(tmp_path, added=added, arm=0.002, volume=1.002 * M / 1000.0)
    result = check_vehicle(config, only=["spiral", "heave up"])
    assert set(result.left_out) == {"spiral"}
    assert {measure.trial for measure in result.measures} == {"heave up"}
    assert not result.spiral.size


def test_a_value_that_swings_is_not_steady():
    """Twenty whole swings in either half of the end: their means are equal."""
    time_s = np.arange(2000)
    swing = 1.0 + 0.1 * np.sin(2 * np.pi * time_s / 5)
    assert measures.average_end(swing) == (pytest.approx(1.0), "not steady")
    small = 1.0 + 0.001 * np.sin(2 * np.pi * time_s / 5)
    assert measures.average_end(small) == (pytest.approx(1.0), "")


def test_the_end_of_a_short_series_is_its_last_value():
    """A twentieth of three values is less than one of them."""
    assert measures.average_end(np.array([0.0, 5.0, 5.0])) == (5.0, "")


def test_a_planar_vehicle_is_held(tmp_path):
    config = load_vehicle("otter")
    result = check_vehicle(config, only=["heave", "roll", "pitch", "surge ahead"])
    held = ("heave up", "heave down", "roll decay", "pitch decay")
    assert result.left_out == dict.fromkeys(held, "held: the vehicle is planar")


def test_a_torpedo_steers_with_what_it_has(tmp_path):
    """A thruster across the stern is a rudder: it turns the vehicle along with a sway."""
    only = ["sway", "heave", "turning", "surge"]
    result = check_vehicle(build(tmp_path, made_up.TORPEDO, "torpedo"), only=only)
    assert set(result.left_out) == {
        "sway to port",
        "heave up",
        "heave down",
        "turning on the spot",
    }
    assert "alone" in result.left_out["turning on the spot"]
    # To port the stern is pushed to starboard: both circles are there and of either side.
    for side, sign in (("port", 1), ("starboard", -1)):
        motion = result.motions[f"turning circle to {side}"]
        assert sign * motion.nu[-1, 5] > 0.1


def test_a_propeller_alone_goes_ahead_and_stops(tmp_path):
    config = build(tmp_path, made_up.TORPEDO[:1], "propeller")
    only = ["surge", "turning", "zig-zag 10", "spiral", "coasting", "crash", "roll"]
    result = check_vehicle(config, only=only)
    done = {measure.trial for measure in result.measures}
    assert {"surge ahead", "coasting stop", "crash stop", "roll decay"} <= done
    for trial in ("turning circle to port", "zig-zag 10/10", "spiral"):
        assert result.left_out[trial] == "no actuator pushes in yaw"


def test_a_vehicle_that_nothing_rights_has_no_decay(tmp_path):
    result = check_vehicle(build(tmp_path, arm=0.0), only=["roll", "pitch", "heave up"])
    assert result.left_out == {
        "roll decay": "nothing rights it",
        "pitch decay": "nothing rights it",
    }


def test_an_unknown_trial_is_refused(simple):
    with pytest.raises(ConfigError, match="--only figure of eight"):
        check_vehicle(simple, only=["figure of eight"])


@pytest.mark.parametrize("flags", [{"steer": 0.0}, {"steer": 1.5}, {"approach": -1.0}])
def test_fractions_out_of_range_are_refused(flags):
    with pytest.raises(ConfigError, match=f"--{next(iter(flags))}"):
        TrialSettings(**flags)


def test_the_command_writes_table_and_figure(tmp_path, capsys):
    build(tmp_path)
    out = tmp_path / "trials"
    file = str(tmp_path / "simple.toml")
    main(["vehicle", "check", file, "--only", "turning", "roll", "--out", str(out)])
    assert "turning circle to port" in capsys.readouterr().out
    with (out / "table.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {"trial", "quantity", "value", "unit", "note"} == set(rows[0])
    (row,) = [
        row for row in rows if (row["trial"], row["quantity"]) == ("roll decay", "damping ratio")
    ]
    assert 0.05 < float(row["value"]) < 0.08
    assert (out / "figure.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(SystemExit):
        main(["vehicle", "check", "bluerov2", "--out", str(out)])
    assert "exists" in capsys.readouterr().err


def test_a_torpedo_with_fins_steers_by_its_rudder_and_does_not_hover():
    """The published coefficients of REMUS make it unstable on a straight line, by Fossen's C."""
    result = check_vehicle(
        load_vehicle("remus100"),
        settings=TrialSettings(approach=1.0, steer=1.0, density_kgpm3=1030.0),
        only=["heave", "turning", "sway", "spiral from port +0", "spiral from starboard +0"],
    )
    assert result.left_out == {
        "sway to port": "no actuator pushes in sway alone",
        "heave up": "no actuator pushes in heave alone",
        "heave down": "no actuator pushes in heave alone",
        "turning on the spot": "no actuator pushes in yaw alone",
    }
    values = {(row.trial, row.quantity): row for row in result.measures}
    for side, sign in (("port", 1.0), ("starboard", -1.0)):
        circle = f"turning circle to {side}"
        rate = np.radians(values[circle, "steady yaw rate"].value)
        diameter = 2.0 * values[circle, "steady speed"].value / rate
        assert values[circle, "steady diameter"].value == pytest.approx(diameter, rel=0.02)
        heading = result.motions[circle].yaw_rad
        assert sign * (heading[-1] - heading[result.execute_index]) > 2.0 * np.pi
    # Sums of body, fins and Munk's moment, in the frame of the thesis: x forward, y right.
    Y_v, Y_r, N_v, N_r, mass = -28.6, 5.22, -24.0, -2.0, 30.48
    assert Y_v * N_r - N_v * (Y_r - mass) < 0.0
    assert values["spiral", "height of the loop, unsteered"].note == "turns by itself"


def test_fins_push_by_the_dynamic_pressure_of_the_terminal_speed():
    """REMUS: Y_uudr = 9.64 kg/(m rad) in sea water, X_uu = -1.62 kg/m (Prestero 2001)."""
    config = load_vehicle("remus100")
    actuators = build_actuators(config, 16.0)
    _, forward = thrust_limits(config)
    speed = balance(forward, 0.0, 1.62)
    force = 9.64 * 1000.0 / 1030.0 * speed**2  # N per rad in fresh water
    rudder, stern_plane = actuators.effect[:, -2:].T
    np.testing.assert_allclose(rudder[:3], [0.0, force, 0.0], rtol=1e-2, atol=1e-6)
    np.testing.assert_allclose(stern_plane[:3], [0.0, 0.0, -force], rtol=1e-2, atol=1e-6)
    # 0.638 m behind the centre of mass.
    assert rudder[5] == pytest.approx(-0.638 * force, rel=1e-2)
    assert stern_plane[4] == pytest.approx(-0.638 * force, rel=1e-2)
    assert actuators.fins == 2
    np.testing.assert_allclose(
        [actuators.lower[-2:], actuators.upper[-2:]], [[-0.26] * 2, [0.26] * 2]
    )


def test_tanks_and_moving_masses_stay_in_the_middle():
    """The three of Sea-Wing are its last actuators, and push nowhere by themselves."""
    actuators = build_actuators(load_vehicle("seawing"), 16.0)
    assert actuators.fins >= 3
    for numbers in (actuators.lower, actuators.upper, *actuators.effect):
        np.testing.assert_array_equal(numbers[-3:], 0.0)
