"""Ways in known currents, against closed forms and against extremals that share nothing with them.

Read in the horizontal plane of an open box of 16 x 16 x 4 cells; one program for all cases.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_experiments.currents.yardstick import least_time_s, uniform_least_time_s
from angler_mjx.errors import ConfigError
from angler_mjx.planning.current.pace import NO_WAY, pace, swimmer
from angler_mjx.planning.current.planner import CurrentConfig, CurrentSettings, plan
from angler_mjx.planning.online.planners import _environment
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.sim.knowledge import KnownCurrent
from angler_mjx.simulator.on_device import device_planner
from angler_mjx.world.currents import Rankine, Uniform

from ..problems import no_obstacles, problem

CRUISE = 0.5
CENTRE = np.array([8.0, 8.0])
CORE_M = 3.0


def flow(uniform, circulation):
    """A uniform current, and a vortex in the middle."""
    return KnownCurrent(
        components=(
            Uniform(velocity_mps=jnp.array(uniform, jnp.float32)),
            Rankine(
                centre_m=jnp.array([CENTRE], jnp.float32),
                circulation_m2ps=jnp.array([circulation], jnp.float32),
                core_m=jnp.array([CORE_M], jnp.float32),
            ),
        ),
        stays=True,
    )


CONFIG = CurrentConfig(
    settings=CurrentSettings(least="time"),
    horizon_s=200.0,
    margin_m=0.1,
    n_point=32,
    foresees=False,
)


@pytest.fixture(scope="module")
def planned():
    """A function of starts, goals [2, 3] and a current that gives the paths of two robots."""

    @jax.jit
    def run(asked, current):
        return plan(
            jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], _environment(asked)),
            jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], asked.team),
            jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], current),
            jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], no_obstacles()),
            CONFIG,
        )

    def of(starts, goals, current):
        asked = problem(starts, goals, cells=16)
        return jax.tree.map(lambda leaf: np.asarray(leaf[0]), run(asked, current))

    return of


def test_a_robot_in_a_uniform_current_takes_zermelos_time(planned):
    """The first goes with the current, the second against and across it."""
    starts, goals = [[2.5, 2.5, 4.5], [13.5, 9.5, 8.5]], [[13.5, 5.5, 4.5], [3.5, 12.5, 8.5]]
    paths = planned(starts, goals, flow([0.25, 0.1, 0.0], 0.0))
    assert paths.found.all()
    for robot in range(2):
        ideal = uniform_least_time_s(
            np.array([0.25, 0.1]), np.array(starts[robot][:2]), np.array(goals[robot][:2]), CRUISE
        )
        assert ideal * 0.999 < paths.time_s[robot, -1] < 1.02 * ideal


def test_a_robot_goes_around_a_vortex_in_the_least_time(planned):
    """Both ways across it: one is helped by going round, the other has to go round."""
    circulation = 2.0 * np.pi * CORE_M * 0.45

    def around(xy, t):
        away = np.asarray(xy) - CENTRE
        r = np.linalg.norm(away, axis=-1, keepdims=True)
        swirl = circulation / (2.0 * np.pi) * np.where(r < CORE_M, 1.0 / CORE_M**2, 1.0 / r**2)
        return swirl * np.stack([-away[..., 1], away[..., 0]], axis=-1)

    starts, goals = [[2.5, 7.5, 4.5], [13.5, 8.5, 8.5]], [[13.5, 7.5, 4.5], [2.5, 9.5, 8.5]]
    paths = planned(starts, goals, flow([0.0, 0.0, 0.0], circulation))
    assert paths.found.all()
    for robot in range(2):
        ideal = least_time_s(
            around,
            np.array(starts[robot][:2]),
            np.array(goals[robot][:2]),
            CRUISE,
            ((0.0, 0.0), (16.0, 16.0)),
            horizon_s=60.0,
        )
        assert ideal * 0.99 < paths.time_s[robot, -1] < 1.02 * ideal
        # Straight through it would have taken longer.
        straight = np.linspace(starts[robot], goals[robot], 400)
        d = np.diff(straight, axis=0)
        length = np.linalg.norm(d, axis=1)
        c = around(0.5 * (straight[1:] + straight[:-1])[:, :2], 0.0)
        along = np.sum(c * d[:, :2], axis=1) / length
        across = np.sum(c * c, axis=1) - along**2
        with np.errstate(invalid="ignore"):
            through = np.sum(length / (along + np.sqrt(CRUISE**2 - across)))
        assert not through < paths.time_s[robot, -1]


def test_robots_that_change_places_never_meet(planned):
    starts, goals = [[2.5, 8.5, 8.5], [13.5, 8.5, 8.5]], [[13.5, 8.5, 8.5], [2.5, 8.5, 8.5]]
    paths = planned(starts, goals, flow([0.0, 0.0, 0.0], 0.0))
    if not paths.found.all():
        # Who cannot go stands at its start, and the other must not come there.
        assert not paths.found.any() or np.ptp(paths.position_m[~paths.found], axis=1).max() == 0
    times = np.linspace(0.0, 80.0, 4001)
    places = [
        np.stack([np.interp(times, paths.time_s[i], paths.position_m[i][:, k]) for k in range(3)])
        for i in range(2)
    ]
    assert np.linalg.norm(places[0] - places[1], axis=0).min() > 2 * 0.3


def one(least, hotel=0.0):
    speed = np.linspace(0.0, 1.5, 9)
    power = np.broadcast_to(hotel + 80.0 * speed**3, (3, 9))
    return swimmer(
        jnp.float32(CRUISE), jnp.full(3, 1.5), jnp.asarray(power, jnp.float32), 0.7, least
    )


def test_pace_is_the_triangle_of_zermelo():
    rng = np.random.default_rng(3)
    d = rng.normal(size=(500, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    c = 0.2 * rng.normal(size=(500, 3))
    cost, speed = jax.vmap(partial(pace, one("time")))(jnp.asarray(d), jnp.asarray(c))
    swum = np.linalg.norm(np.asarray(speed)[:, None] * d - c, axis=1)
    goes = np.asarray(cost) < NO_WAY
    assert goes.sum() > 400
    np.testing.assert_allclose(swum[goes], CRUISE, rtol=1e-4)
    np.testing.assert_allclose(np.asarray(cost)[goes], CRUISE / np.asarray(speed)[goes], rtol=1e-5)


def test_in_still_water_the_cruise_speed_costs_least():
    cost, speed = pace(one("energy"), jnp.array([1.0, 0.0, 0.0]), jnp.zeros(3))
    np.testing.assert_allclose([cost, speed], [1.0, CRUISE], rtol=1e-3)
    # With the water less is spent on a metre, against it more.
    with_it, _ = pace(one("energy"), jnp.array([1.0, 0.0, 0.0]), jnp.array([0.2, 0.0, 0.0]))
    against, _ = pace(one("energy"), jnp.array([1.0, 0.0, 0.0]), jnp.array([-0.2, 0.0, 0.0]))
    assert with_it < 0.8 < 1.3 < against


def test_too_few_points_are_refused():
    scenario = load_scenario("reef_fleet", worlds=1, planner={"name": "current", "points": 2})
    with pytest.raises(ConfigError, match=r"planner\.points = 2.*at least 4"):
        device_planner(scenario, scenario.planner.chosen())


@pytest.mark.parametrize(
    ("settings", "said"),
    [({"least": "money"}, 'must be "energy" or "time"'), ({"effort": 2.0}, "must be 0.1 to 1")],
)
def test_settings_that_are_none_are_refused(settings, said):
    with pytest.raises(ValueError, match=said):
        CurrentSettings(**settings)
