"""What grips measure: against Newton's law of the held body, and as laws and policies see it."""

import itertools
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from angler_mjx.robot.control import allocation
from angler_mjx.robot.control.commands import BodyTwist, BodyWrench
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.cargo import read_grips
from angler_mjx.sim.physics.contact.grips import GripSpec, take_hold
from angler_mjx.sim.policy import Policy

G, WATER, DT = 9.80665, 1000.0, 0.05
TABLE = {
    "name": "held",
    "engine": "mjx",
    "contacts": True,
    "worlds": 1,
    "tile": 1,
    "time": {"horizon_s": 10.0, "record_hz": 1.0, "physics_dt_s": 0.005},
    "task": {
        "type": "carry",
        "grips_m": [[-0.9, 0.1, 0.55], [1.0, 0.0, 0.6]],
        "to_m": [0.0, 2.0, -6.0],
    },
    "world": {
        "preset": "open",
        "shape": [8, 8, 6],
        "obstacles": {
            "explicit": [
                {
                    "type": "capsule",
                    "radius_m": 0.05,
                    "length_m": 2.0,
                    "position_m": [-1.0, -1.0, -6.0],
                    "rpy_deg": [0.0, 90.0, 0.0],
                    "mass_kg": 18.5,
                    "motion": {"type": "drift"},
                }
            ]
        },
    },
    "fleet": [{"vehicle": "bluerov2_heavy", "parameter_set": "wu2018", "count": 2}],
}


def as_arrays(tree):
    """Return the arrays of the first world, on the host in double precision."""
    return jax.tree.map(lambda x: np.asarray(x[0], float), tree)


def turns(q):
    """Return the rotations of attitudes [..., 4]."""
    return Rotation.from_quat(q, scalar_first=True)


@pytest.fixture(scope="module")
def flight():
    """Return the constants of the body and the states of a flight by changing wrenches."""
    simulator = Simulator(Scenario.model_validate(TABLE))
    worlds, rng = simulator.worlds(), np.random.default_rng(2)
    state = simulator.reset(worlds)
    states = [(as_arrays(state.obstacles), as_arrays(state.vehicles), as_arrays(state.grips))]
    tau = np.zeros((1, 2, 6), np.float32)
    for i in range(40):
        if i % 8 == 0:
            tau = rng.normal(size=(1, 2, 6)) * [15.0, 15.0, 15.0, 1.0, 1.0, 1.0]
            tau[..., 2] += 8.0
        state, _ = simulator.step(worlds, state, BodyWrench(tau=jnp.asarray(tau, jnp.float32)))
        states.append(
            (as_arrays(state.obstacles), as_arrays(state.vehicles), as_arrays(state.grips))
        )
    return as_arrays(worlds.environment.obstacles), states


def momentum(body, now):
    """Return the linear and angular momentum of body and moved water, in W (Kirchhoff)."""
    mass = np.concatenate([np.full(3, body.mass_kg[0]), body.inertia_kgm2[0]]) + body.M_A[0]
    turn = turns(now.q[0])
    return turn.apply(mass[:3] * now.nu[0, :3]), turn.apply(mass[3:] * now.nu[0, 3:])


def test_measured_wrenches_move_the_body_as_newton_says(flight):
    """Change of momentum in each control step, less weight, buoyancy and drag, in W.

    Without the first: free bodies are stepped by their last two accelerations, and there is one.
    """
    body, states = flight
    states = states[1:]
    found, want = [], []
    for (before, robots, _), (after, robots_after, grips) in itertools.pairwise(states):
        begin, end = momentum(body, before), momentum(body, after)
        P = (begin[0] + end[0]) / 2
        dP, dL = (end[0] - begin[0]) / DT, (end[1] - begin[1]) / DT
        turn = turns((before.q[0] + after.q[0]) / 2)
        nu = (before.nu[0] + after.nu[0]) / 2
        v = turn.apply(nu[:3])
        speed, rate = np.linalg.norm(nu[:3]), np.linalg.norm(nu[3:])
        D = (body.D_l[0] + body.D_q[0] * np.repeat([speed, rate], 3)) * nu
        lift = np.array([0.0, 0.0, (WATER * body.volume_m3[0] - body.mass_kg[0]) * G])
        force = dP - lift + turn.apply(D[:3])
        moment = dL + np.cross(v, P) + turn.apply(D[3:])
        want.append([*force, *moment])
        by_grips = np.zeros(6)
        for i in range(2):
            f, m = (
                turns((robots.q[i] + robots_after.q[i]) / 2).apply(-part)
                for part in np.split(grips.wrench[i], 2)
            )
            arm = (robots.p[i] + robots_after.p[i] - before.p[0] - after.p[0]) / 2
            by_grips += [*f, *(np.cross(arm, f) + m)]
        found.append(by_grips)
    found, want = np.array(found), np.array(want)
    assert np.abs(want[:, :3]).max() > 10.0
    assert np.abs(want[:, 3:]).max() > 3.0
    error = np.abs(found - want)
    assert error[:, :3].max() < 0.01 * np.abs(want[:, :3]).max()
    assert error[:, 3:].max() < 0.01 * np.abs(want[:, 3:]).max()


def test_nothing_is_measured_at_the_start_and_the_weight_a_step_later(flight):
    _, states = flight
    np.testing.assert_array_equal(states[0][2].wrench, 0.0)
    assert np.all(states[1][2].wrench[:, 2] < -1.0)


class EchoLaw:
    """A control law that commands what the grip measures."""

    takes, gives, wants_grip = (BodyTwist,), BodyWrench, True

    def step(self, gains, memory, inputs, command):
        return memory, BodyWrench(tau=inputs.estimate.grip.wrench)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class EchoPolicy(Policy):
    """A policy that commands what grips measure."""

    def act(self, carry, inputs, key, step):
        return carry, BodyWrench(tau=inputs.grip.wrench)


def fly_echo(simulator):
    """Check that signals of each step are those of the wrench of the step before."""
    worlds = simulator.worlds()
    state = simulator.reset(worlds)
    params = simulator.add_parameters(worlds).control
    for _ in range(4):
        signals = jax.vmap(jax.vmap(allocation.allocate))(
            params.allocation, BodyWrench(tau=state.grips.wrench)
        )
        state, sample = simulator.step(worlds, state)
        np.testing.assert_allclose(sample.pwm_us, signals.pwm_us, rtol=1e-5)
    assert np.ptp(signals.pwm_us) > 20.0


def test_a_law_sees_what_was_measured_in_the_step_before():
    stages = ["follow", "pose", f"{__file__}:EchoLaw", "pseudo_inverse"]
    fly_echo(Simulator(Scenario.model_validate(TABLE | {"controller": {"stages": stages}})))


def test_a_policy_sees_what_was_measured_in_the_step_before():
    fly_echo(Simulator(Scenario.model_validate(TABLE), policy=EchoPolicy()))


def test_the_centre_of_the_body_is_where_the_grip_keeps_it():
    rng = np.random.default_rng(0)
    p, body_p = rng.normal(size=(3, 3)), rng.normal(size=(1, 3))
    q, body_q = Rotation.random(3, rng=1), Rotation.random(1, rng=2)
    wxyz = [jnp.asarray(x.as_quat(scalar_first=True), jnp.float32) for x in (q, body_q)]
    grips = take_hold(GripSpec(body=0), jnp.float32(p), wxyz[0], jnp.float32(body_p), wxyz[1])
    np.testing.assert_allclose(read_grips(grips).center_m, q.inv().apply(body_p - p), atol=1e-5)
    np.testing.assert_array_equal(read_grips(grips).wrench, 0.0)
