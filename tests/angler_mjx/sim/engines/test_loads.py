"""Loads: what a robot weighs and how it sinks with one, against equations solved here in numpy."""

from dataclasses import dataclass, field, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.robot.control.commands import ThrusterPwm
from angler_mjx.robot.vehicles import library
from angler_mjx.robot.vehicles.load import Load
from angler_mjx.sim import fleet, world_phases
from angler_mjx.sim.engines.lanes.engine import FusedEngine
from angler_mjx.sim.fleet import Member, Variant
from angler_mjx.sim.policy import Policy
from angler_mjx.sim.world_phases import TaskOutput
from angler_mjx.world.tasks.spec import TaskSpec

from ...compiling import quickly

STEPS, DT_S = 80, 0.05
SETS = ("blue_ismc", "blue_gazebo", "blue_ismc")
TAKES_AT, PUTS_AT = np.array([0, 40, 1000]), np.array([1000, 60, 1000])
"""Control steps from and to which each robot carries its load."""
LOAD = Load(
    mass_kg=3.0,
    volume_m3=0.0012,
    drag_area_m2=(0.02, 0.03, 0.05),
    added_mass_kg=(0.4, 0.5, 0.6),
    density_kgpm3=1020.0,
)
TASK = TaskSpec(kind="tour", jobs=1, robots=len(SETS), tolerance_m=0.5, period=1)
DENSITY, GRAVITY = 1000.0, 9.81
NEUTRAL_US = 1490.0
"""With the masses in kg added the thrusters stand still: their dead band is 1472 to 1528 us."""


def work(context, state, modem, estimate):
    """Robots take up and put down when they are to."""
    loaded = (context.number >= TAKES_AT) & (context.number < PUTS_AT)
    return TaskOutput(loaded=loaded, finished=jnp.zeros(len(SETS), bool))


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class SaysMass(Policy):
    """Signals that say how heavy the robots are known to be."""

    period: int = field(default=1, metadata={"static": True})

    def act(self, carry, known, key, step):
        vehicle = known.params.vehicle
        us = NEUTRAL_US + vehicle.mass_kg[:, None] * jnp.ones(vehicle.thruster_exists.shape)
        return carry, ThrusterPwm(pwm_us=us)


def members(sets=SETS):
    kinds = [Variant(vehicle="bluerov2", parameter_set=one, battery_v=16.0) for one in sets]
    return [Member(variants=(kind,), weights=(1.0,), cruise_speed_mps=0.5) for kind in kinds]


@pytest.fixture(scope="module")
def sunk(scenes):
    """Samples of every control step of one world of still, open water."""
    build, *_, obstacles = scenes
    scene = build(1, members=members(), config=obstacles["none"])
    environment = scene.worlds.environment
    starts = np.array([[-2.0, 0.0, -6.0], [0.0, 0.0, -6.0], [2.0, 0.0, -6.0]])
    worlds = replace(
        scene.worlds,
        environment=replace(
            environment,
            start_m=jnp.asarray(starts[None], environment.start_m.dtype),
            current=(),
            grid=replace(environment.grid, occupied=jnp.zeros_like(environment.grid.occupied)),
        ),
        policy_key=jnp.zeros((1, 2), jnp.uint32),
    )
    kinds = fleet.build_fleet(members(), multibody=False, load=LOAD)
    spec, policy = replace(scene.spec, task=TASK), SaysMass()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(world_phases, "advance_task", work)
        engine = FusedEngine()
        start = quickly(partial(engine.reset, scene.spec, policy=policy))(kinds, worlds)
        run = partial(engine.segment, spec, n_sample=STEPS, steps_per_sample=1, policy=policy)
        return jax.device_get(quickly(run)(kinds, worlds, start)[1])


def heave(parameter_set):
    """Mass, volume, added mass, linear and quadratic damping in heave, without and with load."""
    given = library.load_vehicle("bluerov2").parameter_sets[parameter_set]
    own = np.array(
        [
            given.rigid_body.mass_kg,
            given.buoyancy.volume_m3,
            given.added_mass.coefficients[2][2],
            given.damping.linear[2],
            given.damping.quadratic[2],
        ]
    )
    # Morison's drag of the load: half the density of its water times Cd A.
    return own, own + np.array([3.0, 0.0012, 0.6, 0.0, 0.5 * 1020.0 * 0.05])


def accelerated(numbers, w):
    mass, volume, added, linear, quadratic = numbers
    lift = (DENSITY * volume - mass) * GRAVITY
    return (lift - linear * w - quadratic * abs(w) * w) / (mass + added)


def solved(robot, parts=20):
    """Depth [m] and speed [m/s] at the beginning of every control step, by Runge and Kutta."""
    own, laden = heave(SETS[robot])
    z, w, states, dt = -6.0, 0.0, [], DT_S / parts
    for step in range(STEPS):
        states.append((z, w))
        numbers = laden if TAKES_AT[robot] <= step < PUTS_AT[robot] else own
        for _ in range(parts):
            a = accelerated(numbers, w)
            b = accelerated(numbers, w + dt / 2 * a)
            c = accelerated(numbers, w + dt / 2 * b)
            d = accelerated(numbers, w + dt * c)
            z += dt * w + dt**2 / 6 * (a + b + c)
            w += dt / 6 * (a + 2 * b + 2 * c + d)
    return np.array(states).T


@pytest.mark.parametrize("robot", range(len(SETS)))
def test_a_robot_sinks_as_the_added_weight_says(sunk, robot):
    z, w = solved(robot)
    # The formula takes half of the force of the step before: where 18 N come or go, half a step of
    # 10 ms goes without them, 7 mm/s of 13 kg. Who carries nothing is within rounding.
    same = PUTS_AT[robot] == TAKES_AT[robot]
    np.testing.assert_allclose(sunk.nu[0, :, robot, 2], w, atol=1e-6 if same else 7e-3)
    np.testing.assert_allclose(sunk.p[0, :, robot, 2], z, atol=1e-5 if same else 4e-3)
    assert abs(sunk.nu[0, :, robot, [0, 1, 3, 4, 5]]).max() < 1e-5


def test_with_its_load_it_comes_to_rest_at_the_terminal_speed(sunk):
    """Of ``linear w + quadratic w^2 = weight``, by hand."""
    _, (mass, volume, _, linear, quadratic) = heave("blue_ismc")
    weight = (mass - DENSITY * volume) * GRAVITY
    speed = (np.sqrt(linear**2 + 4 * quadratic * weight) - linear) / (2 * quadratic)
    assert 0.4 < speed < 0.6
    np.testing.assert_allclose(sunk.nu[0, -1, 0, 2], -speed, rtol=5e-4)


def test_velocity_is_continuous_when_a_load_is_taken_and_put_down(sunk):
    """Nothing pushes harder than the weight of the load in water, 18 N, on 10 kg and its drag."""
    jump = abs(np.diff(sunk.nu[0, :, 1, 2]))
    assert jump.max() < 3.0 * DT_S
    assert jump[TAKES_AT[1] - 1] < 1e-3  # it floated, as good as at rest
    assert jump[TAKES_AT[1]] > 0.03


def test_controllers_and_policies_know_of_the_load(sunk):
    told_kg = sunk.pwm_us[0, :, :, 0] - NEUTRAL_US
    mass = np.array([10.0, 10.012, 10.0])
    step = np.arange(STEPS)[:, None]
    loaded = (step >= TAKES_AT) & (step < PUTS_AT)
    np.testing.assert_allclose(told_kg, mass + 3.0 * loaded, atol=2e-4)


def test_a_fleet_that_carries_nothing_is_as_it_was():
    plain, able = (fleet.build_fleet(members(), multibody=False, load=x) for x in (None, LOAD))
    assert not plain.can_carry
    assert able.can_carry
    for ours, theirs in zip(
        jax.tree.leaves(plain.control), jax.tree.leaves(able.control), strict=True
    ):
        assert len(theirs) == 2 * len(ours) == 4
        np.testing.assert_array_equal(ours, theirs[:2])
    key = jax.random.key(3)
    for ours, theirs in zip(
        jax.tree.leaves(fleet.sample_variants(plain, key)),
        jax.tree.leaves(fleet.sample_variants(able, key)),
        strict=True,
    ):
        np.testing.assert_array_equal(ours, theirs)
    np.testing.assert_array_equal(fleet.radius_bound(plain), fleet.radius_bound(able))


def test_a_load_is_slowed_down_to_what_its_drag_leaves():
    """60 % of the terminal speed in surge, which falls as the root of the drag where that is all
    quadratic."""
    bulky = replace(LOAD, drag_area_m2=(1.0, 0.0, 0.0))
    fast = [replace(one, cruise_speed_mps=10.0) for one in members(("blue_gazebo",))]
    light, heavy = np.asarray(fleet.build_fleet(fast, multibody=False, load=bulky).cruise_mps)[0]
    np.testing.assert_allclose(heavy / light, np.sqrt(33.8 / (33.8 + 510.0)), rtol=1e-5)
