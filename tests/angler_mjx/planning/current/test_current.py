"""Ways in known currents, against closed forms and against extremals that share nothing with them.

Read in the horizontal plane of an open box of 16 x 16 x 4 cells; one program for all cases.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_experiments.currents.zermelo import shoot_min_time_s, uniform_min_time_s
from angler_mjx.errors import ConfigError
from angler_mjx.planning import build_problem
from angler_mjx.planning.current.motion_cost import NO_PATH_COST, cost_and_speed, power_model
from angler_mjx.planning.current.planner import CurrentSettings, plan_paths
from angler_mjx.planning.path_search.robot_search import PathSearchConfig, required_layers
from angler_mjx.runs.simulator.world_preparation import check_planner
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.sim import fleet
from angler_mjx.sim.fleet import Member, Variant
from angler_mjx.sim.information import CurrentInformation
from angler_mjx.world.currents import DoubleGyre, Rankine, Uniform

from ...compiling import thoroughly
from ..problems import problem

CRUISE = 0.5
HEAVY = Variant(vehicle="bluerov2_heavy", parameter_set="wu2018", battery_v=16.0)
CENTRE = np.array([8.0, 8.0])
CORE_M = 3.0


SIDE_M = 16.0


def flow(uniform=(0.0, 0.0, 0.0), circulation=0.0, stream=0.0):
    """A uniform current, a vortex in the middle, and the double gyre that stands still."""
    return CurrentInformation(
        components=(
            Uniform(velocity_mps=jnp.array(uniform, jnp.float32)),
            Rankine(
                centre_m=jnp.array([CENTRE], jnp.float32),
                circulation_m2ps=jnp.array([circulation], jnp.float32),
                core_m=jnp.array([CORE_M], jnp.float32),
            ),
            DoubleGyre(
                lo_m=jnp.zeros(2),
                extent_m=jnp.full(2, SIDE_M),
                stream_m2ps=jnp.float32(stream),
                epsilon=jnp.float32(0.0),
                period_s=jnp.float32(60.0),
            ),
        ),
        stays=True,
    )


CONFIG = PathSearchConfig(horizon_s=200.0, n_point=32, n_layer=required_layers(200.0, CRUISE, 1.0))


def alone(asked, current, limited=False):
    """Paths [1, 2] of one problem."""
    whole = replace(asked, current=current, seed=jnp.uint32(0), horizon_s=CONFIG.horizon_s)
    problems = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], whole)
    settings = CurrentSettings(least="time", limit_ground_speed=limited)
    return plan_paths(problems, settings, CONFIG)


@pytest.fixture(scope="module")
def planned():
    """A function of starts, goals [2, 3] and a current that gives the paths of two robots."""

    run = thoroughly(alone)

    def of(starts, goals, current):
        asked = problem(starts, goals, cells=16)
        return jax.tree.map(lambda leaf: np.asarray(leaf[0]), run(asked, current))

    return of


def test_a_robot_in_a_uniform_current_takes_zermelos_time(planned):
    """The first goes with the current, the second against and across it, between cells' centres."""
    starts, goals = [[2.5, 2.5, 4.5], [13.2, 9.8, 8.3]], [[13.5, 5.5, 4.5], [3.1, 12.2, 8.3]]
    paths = planned(starts, goals, flow(uniform=(0.25, 0.1, 0.0)))
    assert paths.found.all()
    for robot in range(2):
        ideal = uniform_min_time_s(
            np.array([0.25, 0.1]), np.array(starts[robot][:2]), np.array(goals[robot][:2]), CRUISE
        )
        assert ideal * 0.999 < paths.time_s[robot, -1] < 1.02 * ideal


def test_the_cruise_speed_limits_the_speed_over_ground_if_it_is_set_so(planned):
    """The first robot is carried along, the second swims against the current."""
    starts, goals = [[2.5, 2.5, 4.5], [13.2, 9.8, 8.3]], [[13.5, 5.5, 4.5], [3.1, 12.2, 8.3]]
    water = flow(uniform=(0.25, 0.1, 0.0))
    free = planned(starts, goals, water)
    run = thoroughly(partial(alone, limited=True))
    limited = jax.tree.map(
        lambda leaf: np.asarray(leaf[0]), run(problem(starts, goals, cells=16), water)
    )
    assert limited.found.all()

    def fastest_mps(paths):
        length = np.linalg.norm(np.diff(paths.position_m, axis=1), axis=-1)
        span = np.diff(paths.time_s, axis=1)
        return np.max(length / np.maximum(span, 1e-6), axis=1, where=span > 1e-3, initial=0.0)

    assert fastest_mps(free)[0] > 1.3 * CRUISE
    np.testing.assert_allclose(fastest_mps(limited)[0], CRUISE, rtol=1e-3)
    line_s = np.linalg.norm(np.subtract(goals, starts)[0]) / CRUISE
    assert 0.999 * line_s < limited.time_s[0, -1] < 1.02 * line_s
    # Who is slower than that is not concerned.
    assert fastest_mps(free)[1] < CRUISE
    np.testing.assert_allclose(limited.time_s[1, -1], free.time_s[1, -1], rtol=0.01)


def vortex(xy, t):
    """Peak 0.45 m/s at the rim."""
    away = np.asarray(xy) - CENTRE
    r = np.linalg.norm(away, axis=-1, keepdims=True)
    per_m = 0.45 * CORE_M * np.where(r < CORE_M, 1.0 / CORE_M**2, 1.0 / r**2)
    return per_m * np.stack([-away[..., 1], away[..., 0]], axis=-1)


def gyres(xy, t):
    """Shadden's, in a square: 0.3 m/s up and down the walls, half of it along the ends."""
    x, y = np.pi * np.asarray(xy)[..., 0] / 8.0, np.pi * np.asarray(xy)[..., 1] / 16.0
    return np.stack([-0.15 * np.sin(x) * np.cos(y), 0.3 * np.cos(x) * np.sin(y)], axis=-1)


WATERS = {
    "vortex": (vortex, {"circulation": 2.0 * np.pi * CORE_M * 0.45}),
    "gyres": (gyres, {"stream": 0.3 * SIDE_M / (2.0 * np.pi)}),
}


def through(water, start, goal):
    """Time along the line at the cruise speed through the water, s."""
    line = np.linspace(start, goal, 400)[:, :2]
    step = np.diff(line, axis=0)
    length = np.linalg.norm(step, axis=1)
    c = water(0.5 * (line[1:] + line[:-1]), 0.0)
    along = np.sum(c * step, axis=1) / length
    return np.sum(length / (along + np.sqrt(CRUISE**2 - (np.sum(c * c, axis=1) - along**2))))


@pytest.mark.parametrize(
    "name", ["vortex", pytest.param("gyres", marks=pytest.mark.nightly(by="vortex"))]
)
def test_a_robot_bends_its_way_to_the_least_time(planned, name):
    """Both ways across; straight lines take longer by more than the way may miss the least."""
    water, strengths = WATERS[name]
    starts, goals = [[2.5, 7.5, 4.5], [13.5, 8.5, 8.5]], [[13.5, 7.5, 4.5], [2.5, 9.5, 8.5]]
    paths = planned(starts, goals, flow(**strengths))
    assert paths.found.all()
    for robot in range(2):
        start, goal = np.array(starts[robot]), np.array(goals[robot])
        ideal = shoot_min_time_s(
            water,
            start[:2],
            goal[:2],
            CRUISE,
            ((0.0, 0.0), (SIDE_M, SIDE_M)),
            horizon_s=40.0,
            step_s=0.2,
            headings=180,
        )
        assert ideal * 0.995 < paths.time_s[robot, -1] < 1.02 * ideal
        assert through(water, start, goal) > 1.02 * ideal


@pytest.mark.nightly(
    by="tests/angler_mjx/planning/current/test_current.py::"
    "test_a_robot_bends_its_way_to_the_least_time"
)
def test_a_robot_that_knows_how_the_water_will_move_takes_the_least_time_in_it():
    """Gyres that sway by a quarter of their size within a minute, between random places."""

    def swaying(xy, t):
        x, y = np.asarray(xy)[..., 0] / 8.0, np.asarray(xy)[..., 1] / 16.0
        sway = 0.25 * np.sin(2.0 * np.pi * t / 60.0)
        bent, slope = sway * x * x + (1.0 - 2.0 * sway) * x, 2.0 * sway * x + 1.0 - 2.0 * sway
        along = -0.15 * np.sin(np.pi * bent) * np.cos(np.pi * y)
        return np.stack([along, 0.3 * slope * np.cos(np.pi * bent) * np.sin(np.pi * y)], axis=-1)

    gyre = DoubleGyre(
        lo_m=jnp.zeros(2),
        extent_m=jnp.full(2, SIDE_M),
        stream_m2ps=jnp.float32(0.3 * SIDE_M / (2.0 * np.pi)),
        epsilon=jnp.float32(0.25),
        period_s=jnp.float32(60.0),
    )
    run = thoroughly(alone)
    draw, ratios = np.random.default_rng(5), []
    for _ in range(12):
        a, b = draw.uniform(2.0, 14.0, (2, 2))
        if np.linalg.norm(a - b) < 6.0:
            continue
        asked = problem([[*a, 4.5], [*b, 8.5]], [[*b, 4.5], [*a, 8.5]], cells=16)
        paths = run(asked, CurrentInformation(components=(gyre,), stays=False))
        assert np.asarray(paths.found).all()
        for robot, (start, goal) in enumerate(((a, b), (b, a))):
            bounds = ((0.0, 0.0), (SIDE_M, SIDE_M))
            ideal = shoot_min_time_s(
                swaying, start, goal, CRUISE, bounds, horizon_s=60.0, step_s=0.2, headings=180
            )
            ratios.append(float(paths.time_s[0, robot, -1]) / ideal)
    assert len(ratios) > 10
    # One in twenty goes round the other side of a gyre.
    assert np.median(ratios) < 1.002
    assert max(ratios) < 1.1
    assert min(ratios) > 0.995


def places(paths, times):
    """[robot, time, 3]."""
    axes = [[np.interp(times, t, p[:, k]) for k in range(3)] for t, p in zip(*paths, strict=True)]
    return np.moveaxis(np.array(axes), 1, 2)


def test_robots_whose_ways_cross_never_meet(planned):
    """At once they would be in the middle together; one sets off later."""
    starts, goals = [[2.5, 8.5, 8.5], [8.5, 2.5, 8.5]], [[13.5, 8.5, 8.5], [8.5, 13.5, 8.5]]
    paths = planned(starts, goals, flow())
    assert paths.found.all()
    assert sorted(paths.time_s[:, 1])[0] == 0.0 < sorted(paths.time_s[:, 1])[1]
    where = places((paths.time_s, paths.position_m), np.linspace(0.0, 60.0, 6001))
    assert np.linalg.norm(where[0] - where[1], axis=-1).min() > 2 * 0.3 + CONFIG.margin_m - 1e-3
    np.testing.assert_allclose(where[:, -1], goals, atol=1e-3)


def test_robots_that_no_time_suits_make_way_for_each_other(planned):
    """Head on along one line: each has to pass where the other stands, whenever it sets off."""
    starts, goals = [[2.5, 8.5, 8.5], [13.5, 8.5, 8.5]], [[13.5, 8.5, 8.5], [2.5, 8.5, 8.5]]
    paths = planned(starts, goals, flow())
    assert paths.found.all()
    where = places((paths.time_s, paths.position_m), np.linspace(0.0, 200.0, 20001))
    assert np.linalg.norm(where[0] - where[1], axis=-1).min() > 2 * 0.3 + CONFIG.margin_m - 1e-3
    np.testing.assert_allclose(where[:, 0], starts, atol=1e-3)
    np.testing.assert_allclose(where[:, -1], goals, atol=1e-3)


def one(least, hotel=0.0):
    speed = np.linspace(0.0, 1.5, 9)
    power = np.broadcast_to(hotel + 80.0 * speed**3, (3, 9))
    return power_model(
        jnp.float32(CRUISE), jnp.full(3, 1.5), jnp.asarray(power, jnp.float32), 0.7, least
    )


def test_pace_is_the_triangle_of_zermelo():
    rng = np.random.default_rng(3)
    d = rng.normal(size=(500, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    c = 0.2 * rng.normal(size=(500, 3))
    cost, speed = jax.vmap(partial(cost_and_speed, one("time")))(jnp.asarray(d), jnp.asarray(c))
    swum = np.linalg.norm(np.asarray(speed)[:, None] * d - c, axis=1)
    goes = np.asarray(cost) < NO_PATH_COST
    assert goes.sum() > 400
    np.testing.assert_allclose(swum[goes], CRUISE, rtol=1e-4)
    np.testing.assert_allclose(np.asarray(cost)[goes], CRUISE / np.asarray(speed)[goes], rtol=1e-5)


def test_in_still_water_the_cruise_speed_costs_least():
    cost, speed = cost_and_speed(one("energy"), jnp.array([1.0, 0.0, 0.0]), jnp.zeros(3))
    np.testing.assert_allclose([cost, speed], [1.0, CRUISE], rtol=1e-3)
    # With the water less is spent on a metre, against it more.
    with_it, _ = cost_and_speed(
        one("energy"), jnp.array([1.0, 0.0, 0.0]), jnp.array([0.2, 0.0, 0.0])
    )
    against, _ = cost_and_speed(
        one("energy"), jnp.array([1.0, 0.0, 0.0]), jnp.array([-0.2, 0.0, 0.0])
    )
    assert with_it < 0.8 < 1.3 < against


def test_no_speed_is_counted_on_where_the_water_cannot_be_overcome():
    cost, speed = cost_and_speed(
        one("energy"), jnp.array([1.0, 0.0, 0.0]), jnp.array([-2.0, 0.0, 0.0])
    )
    assert cost == NO_PATH_COST
    np.testing.assert_allclose(speed, 0.1 * CRUISE, rtol=1e-6)


def test_powers_are_those_of_thrusters_against_drag():
    """A Heavy, in NumPy: least squares thrusts, read in the table of thrusts and powers."""
    members = [Member(variants=(HEAVY,), weights=(1.0,), cruise_speed_mps=CRUISE)]
    control = fleet.build_fleet(members).control
    here = jnp.zeros((1, 3))
    told = build_problem.build_team(control, here, jnp.zeros(1), here)
    vehicle = jax.tree.map(lambda leaf: np.asarray(leaf[0], np.float64), control.vehicle)
    for axis in range(3):
        for step, speed in enumerate(np.linspace(0.0, vehicle.terminal_speed_mps[axis], 9)):
            force = np.zeros(6)
            force[axis] = vehicle.D_l[axis] * speed + vehicle.D_q[axis] * speed**2
            thrust = np.linalg.lstsq(vehicle.B, force, rcond=1e-2)[0]
            watts = np.interp(thrust, vehicle.thrust_n, vehicle.power_w).sum()
            np.testing.assert_allclose(told.power_w[0, axis, step], watts, rtol=2e-3, atol=0.5)


def test_too_few_points_are_refused():
    scenario = load_scenario("reef_fleet", worlds=1, planner={"name": "current", "points": 2})
    with pytest.raises(ConfigError, match=r"planner\.points = 2.*at least 4"):
        check_planner(scenario)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"least": "money"}, 'must be "energy" or "time"'),
        ({"effort": 2.0}, "must be 0.1 to 1"),
        ({"budget": -1}, "0 to 10000"),
    ],
)
def test_settings_that_are_none_are_refused(settings, said):
    with pytest.raises(ValueError, match=said):
        CurrentSettings(**settings)
