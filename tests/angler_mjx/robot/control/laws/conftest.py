"""One fleet of every flyable parameter set, and a way to fly any law on it.

The set `blue_ismc` of the six-thruster BlueROV2 is left out: it has no restoring moment and the
vehicle has no authority in pitch, so nothing holds it level.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels import quaternion, thruster
from angler_mjx.robot.control import allocation
from angler_mjx.robot.control.commands import BodyWrench, Estimate, PoseTarget, TrackingTarget
from angler_mjx.robot.vehicles import library, params
from angler_mjx.robot.vehicles.thrusters import PWM_LOW_US, PWM_STEP_US
from angler_mjx.sim.physics import step as physics
from angler_mjx.sim.physics.closed_form import ClosedForm
from angler_mjx.world.currents import Uniform

from ....compiling import quickly

KINDS = [
    ("bluerov2_heavy", "wu2018"),
    ("bluerov2_heavy", "von_benzon2022"),
    ("bluerov2_heavy", "blue_gazebo"),
    ("bluerov2", "blue_gazebo"),
]
CONTROL_S, PHYSICS_S, STEPS, N = 0.05, 0.01, 5, 600
DEEP = np.array([0.0, 0.0, -10.0])
WATER = physics.Water()
ENGINE = ClosedForm(gravity_mps2=9.81)


def targets(position, yaw):
    """Targets at rest at DEEP + position, [N] of them."""
    return TrackingTarget(
        position_m=np.tile(DEEP + position, (N, 1)),
        velocity_mps=np.zeros((N, 3)),
        acceleration_mps2=np.zeros((N, 3)),
        yaw_rad=np.full(N, float(yaw)),
        yaw_rate_radps=np.zeros(N),
        yaw_acceleration_radps2=np.zeros(N),
    )


def figure_of_eight(speed=0.5, size=2.0, rise_s=4.0):
    """A Gerono lemniscate at constant speed, after a start from rest; the nose along the path."""
    fine = np.linspace(0.0, 6 * np.pi, 60001)
    curve = np.stack([size * np.sin(fine), size * np.sin(fine) * np.cos(fine)], axis=1)
    way = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    # Five times finer than the control, for clean differences.
    h = CONTROL_S / 5
    t = np.arange(-10, 5 * N + 10) * h
    x = np.clip(t / rise_s, 0, 1)
    pace = speed * (10 * x**3 - 15 * x**4 + 6 * x**5)
    done = np.concatenate([[0], np.cumsum(0.5 * (pace[1:] + pace[:-1]) * h)])
    place = np.stack([np.interp(done, way, curve[:, i]) for i in (0, 1)] + [0 * t], axis=1)
    angle = np.interp(done, way, fine)
    yaw = np.unwrap(np.arctan2(np.cos(2 * angle), np.cos(angle)))
    smooth = np.ones(5) / 5

    def rate(y):
        return np.apply_along_axis(np.convolve, 0, np.gradient(y, h, axis=0), smooth, "same")

    def pick(y):
        return y[10 : 10 + 5 * N : 5]

    return TrackingTarget(
        position_m=pick(DEEP + place),
        velocity_mps=pick(rate(place)),
        acceleration_mps2=pick(rate(rate(place))),
        yaw_rad=pick(yaw),
        yaw_rate_radps=pick(rate(yaw)),
        yaw_acceleration_radps2=pick(rate(rate(yaw))),
    )


STEP, TURN, CURRENT, EIGHT = range(4)
CURRENT_MPS = 0.5


def scenarios():
    """Step of 2 m, step of 90 degrees, station in a current off the bow, figure of eight."""
    courses = [
        targets([1.2, 1.2, 1.06], 0.0),
        targets([0.0, 0.0, 0.0], np.pi / 2),
        targets([0.0, 0.0, 0.0], 0.0),
        figure_of_eight(),
    ]
    flows = np.zeros((4, 3))
    flows[CURRENT] = CURRENT_MPS * np.array([np.cos(0.7), np.sin(0.7), 0.0])
    yaws = np.array([course.yaw_rad[0] for course in courses])
    yaws[TURN] = 0.0
    return jax.tree.map(lambda *x: jnp.asarray(np.stack(x)), *courses), flows, yaws


def as_pose(target):
    return PoseTarget(
        position_m=target.position_m, velocity_mps=target.velocity_mps, yaw_rad=target.yaw_rad
    )


def estimate_of(state):
    return Estimate(p=state.p, q=state.q, nu=state.nu)


def build_robots():
    stacked = params.stack_vehicles(
        [params.build_vehicle(library.load_vehicle(name), chosen, 14.8) for name, chosen in KINDS]
    )
    return stacked, allocation.build_allocation(stacked)


@pytest.fixture(scope="session")
def robots():
    return build_robots()


class Flights:
    """What came of all sets [4] in all scenarios [4]; arrays [4 sets, 4 scenarios, N, ...]."""

    def __init__(self, p, q, nu, pwm, course):
        self.p, self.q, self.nu, self.pwm = (np.asarray(x) for x in (p, q, nu, pwm))
        self.error = np.linalg.norm(self.p - np.asarray(course.position_m), axis=-1)
        w, x, y, z = np.moveaxis(self.q, -1, 0)
        yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        turn = yaw - np.asarray(course.yaw_rad)
        self.off_deg = np.degrees(np.abs((turn + np.pi) % (2 * np.pi) - np.pi))
        self.tilt_deg = np.degrees(2 * np.arcsin(np.minimum(np.hypot(x, y), 1)))

    def steady(self, scenario, last=200):
        """Largest error of position, m, and of heading, deg, of each set over the last 10 s."""
        return (
            self.error[:, scenario, -last:].max(axis=-1),
            self.off_deg[:, scenario, -last:].max(axis=-1),
        )

    def settled_s(self, scenario, metres=0.05, degrees=2.0):
        """When each set comes within the limits for good; inf if never."""
        out = (self.error[:, scenario] > metres) | (self.off_deg[:, scenario] > degrees)
        last = np.where(out.any(-1), N - np.argmax(out[:, ::-1], axis=-1), 0)
        return np.where(last < N, last * CONTROL_S, np.inf)

    def rmse(self, scenario):
        return np.sqrt((self.error[:, scenario] ** 2).mean(axis=-1))

    def swing(self):
        """Largest standard deviation of velocity, by set, over the last 10 s of the first two."""
        return self.nu[:, :2, -200:].std(axis=2).max(axis=(1, 2))


@dataclass(frozen=True)
class Controller:
    """A law, or laws one above another, from a tracking target to a wrench or signals."""

    reset: Callable
    """(estimate) -> carry."""
    control: Callable
    """(gains, vehicle, carry, estimate, target, flow) -> (carry, wrench or PWM)."""
    gains: Any


@dataclass(frozen=True)
class Variant:
    """A flight of a controller."""

    controller: str
    gains: Any = None
    """Those of the controller if left out."""
    current_known: bool = False
    """It is told the current; otherwise it is told zero."""


def chosen(controllers, variant):
    """Which controller flies, the gains of all of them, and 1 where it is told the current."""
    gains = {name: controller.gains for name, controller in controllers.items()}
    gains[variant.controller] = variant.gains or gains[variant.controller]
    return list(controllers).index(variant.controller), gains, float(variant.current_known)


def signals(controllers, choice, vehicle, thrusters, carries, at, target, flow):
    """The memories of all controllers, and the PWM that the chosen one asks for."""
    which, gains, told = choice
    after, taus, pwms = {}, [], []
    for name, controller in controllers.items():
        after[name], out = controller.control(
            gains[name], vehicle, carries[name], at, target, told * flow
        )
        wrench = isinstance(out, BodyWrench)
        taus.append(out.tau if wrench else jnp.zeros(6))
        pwms.append(None if wrench else out.pwm_us)
    pwm = allocation.allocate(thrusters, BodyWrench(tau=jnp.stack(taus)[which])).pwm_us
    for i, own in enumerate(pwms):
        pwm = pwm if own is None else jnp.where(which == i, own, pwm)
    return after, pwm


def flight(controllers, choice, vehicle, thrusters, course, flow, yaw):
    """One flight of the chosen controller: p, q, nu, PWM [N, ...]."""
    current = (Uniform(velocity_mps=flow),)
    state = physics.reset(
        ENGINE, vehicle, vehicle, jnp.asarray(DEEP), quaternion.from_yaw(yaw), current, WATER
    )

    def act(pair, target):
        state, carries = pair
        at = estimate_of(state)
        carries, pwm = signals(controllers, choice, vehicle, thrusters, carries, at, target, flow)
        look = jax.vmap(thruster.lookup, (None, 0, None, None))
        thrust = look(vehicle.thrust_n, pwm, PWM_LOW_US, PWM_STEP_US)

        def advance(state, _):
            return physics.step(
                ENGINE, vehicle, vehicle, state, thrust, current, 0.0, PHYSICS_S, WATER
            ), None

        after, _ = jax.lax.scan(advance, state, length=STEPS)
        return (after, carries), (state.p, state.q, state.nu, pwm)

    begun = {name: made.reset(estimate_of(state)) for name, made in controllers.items()}
    return jax.lax.scan(act, (state, begun), course)[1]


def fly(robots, controllers, variants):
    """Fly variants on all sets through all scenarios; flights by the name of the variant.

    One program: each robot asks all controllers and does what its own one says, so that the physics
    is compiled once.
    """
    courses, flows, yaws = scenarios()
    choices = [chosen(controllers, variant) for variant in variants.values()]
    stacked = jax.tree.map(lambda *x: jnp.asarray(np.array(x)), *choices)
    over_courses = jax.vmap(partial(flight, controllers), (None, None, None, 0, 0, 0))
    over_sets = jax.vmap(over_courses, (None, 0, 0, None, None, None))
    over = quickly(jax.vmap(over_sets, (0, None, None, None, None, None)))
    flown = jax.device_get(over(stacked, *robots, courses, flows, yaws))
    return {
        name: Flights(*jax.tree.map(lambda leaf, i=i: leaf[i], flown), courses)
        for i, name in enumerate(variants)
    }


@pytest.fixture(scope="session")
def pool(robots):
    """What tests need of this file."""
    return SimpleNamespace(
        fly=partial(fly, robots),
        Controller=Controller,
        Variant=Variant,
        Flights=Flights,
        as_pose=as_pose,
        estimate_of=estimate_of,
        engine=ENGINE,
        water=WATER,
        deep=DEEP,
        kinds=KINDS,
        STEP=STEP,
        TURN=TURN,
        CURRENT=CURRENT,
        EIGHT=EIGHT,
    )


@pytest.fixture(scope="session")
def states(robots):
    """A moving, tilted robot of each kind: estimates, and targets for it."""
    rng = np.random.default_rng(7)
    q = rng.normal(size=(4, 4)) * 0.2 + np.array([1.0, 0, 0, 0.4])
    estimate = Estimate(
        p=jnp.asarray(DEEP + rng.normal(size=(4, 3))),
        q=jnp.asarray(q / np.linalg.norm(q, axis=1, keepdims=True)),
        nu=jnp.asarray(rng.normal(size=(4, 6)) * 0.4),
    )
    target = TrackingTarget(
        position_m=jnp.asarray(DEEP + rng.normal(size=(4, 3))),
        velocity_mps=jnp.asarray(rng.normal(size=(4, 3)) * 0.3),
        acceleration_mps2=jnp.asarray(rng.normal(size=(4, 3)) * 0.1),
        yaw_rad=jnp.asarray(rng.normal(size=4)),
        yaw_rate_radps=jnp.asarray(rng.normal(size=4) * 0.3),
        yaw_acceleration_radps2=jnp.asarray(rng.normal(size=4) * 0.1),
    )
    return estimate, target
