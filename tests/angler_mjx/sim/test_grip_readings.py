"""What grips measure: against Newton's law of the held body, and as laws and policies see it."""

import itertools
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from angler_mjx.robot.control import allocation
from angler_mjx.robot.control.commands import BodyWrench
from angler_mjx.robot.vehicles.library import load_vehicle
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.cargo import read_grips
from angler_mjx.sim.physics.contact.grips import GripSpec, take_hold
from angler_mjx.sim.policy import Policy

from ..link_poses import locate_by_mujoco

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


ARMS = TABLE | {
    "task": {
        "type": "carry",
        "hold": "end_effector",
        "grips_m": [[-0.9, 0.0, 0.03], [1.0, -0.02, 0.0]],
        "to_m": [0.0, 2.0, -6.0],
        "turn_deg": 30.0,
    },
    "controller": {"stages": ["follow", "pose", "velocity", "link_wrench", "pseudo_inverse"]},
    "fleet": [{"vehicle": "bluerov2_heavy_alpha5", "parameter_set": "wu2018", "count": 2}],
}


def as_arrays(tree):
    """Return the arrays of the first world, on the host in double precision."""
    return jax.tree.map(lambda x: np.asarray(x[0], float), tree)


def turns(q):
    """Return the rotations of attitudes [..., 4]."""
    return Rotation.from_quat(q, scalar_first=True)


@cache
def fly(arms):
    """Return the constants of the body and the states of a flight by changing wrenches."""
    simulator = Simulator(Scenario.model_validate(ARMS if arms else TABLE))
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


@pytest.fixture(params=[False, True], ids=["hulls", "arms"])
def flight(request):
    """Return a flight of robots that hold the body by either."""
    return fly(request.param)


def momentum(body, now):
    """Return the linear and angular momentum of body and moved water, in W (Kirchhoff)."""
    mass = np.concatenate([np.full(3, body.mass_kg[0]), body.inertia_kgm2[0]]) + body.M_A[0]
    turn = turns(now.q[0])
    return turn.apply(mass[:3] * now.nu[0, :3]), turn.apply(mass[3:] * now.nu[0, 3:])


def test_measured_wrenches_move_the_body_as_newton_says(flight):
    """Change of momentum in each control step, less weight, buoyancy and drag, in W.

    Without the first: free bodies are stepped by their last two accelerations, and there is one.
    Moments are compared without the steps in which commands jump, whose means of forces and levers
    say less of the mean of their products.
    """
    body, states = flight
    states = states[1:]
    steady = np.arange(1, len(states)) % 8 != 0
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
    assert error[steady, 3:].max() < 0.01 * np.abs(want[:, 3:]).max()


def test_nothing_is_measured_at_the_start_and_the_weight_a_step_later(flight):
    _, states = flight
    np.testing.assert_array_equal(states[0][2].wrench, 0.0)
    is_rigid = states[0][1].joints is None
    # Servos of arms yield first.
    assert np.all(states[1 if is_rigid else 8][2].wrench[:, 2] < -1.0)


def locate_tips(vehicles):
    """Return the end effectors [R, 3], m in W, by MuJoCo's kinematics."""
    config = load_vehicle("bluerov2_heavy_alpha5")
    tip, out = config.end_effector, []
    for i in range(2):
        links = locate_by_mujoco(config, vehicles.p[i], vehicles.q[i], vehicles.joints.position[i])
        origin, turn = links[tip.link]
        out.append(origin + turn @ tip.position_m)
    return np.array(out)


def test_end_effectors_keep_to_their_points_of_the_body():
    """The grips of the file, [-0.9, 0, 0.03] and [1, -0.02, 0], in the frame of a pipe along x."""
    _, states = fly(True)
    moved = [np.ptp([now[1].joints.position for now in states], axis=0).max()]
    assert max(moved) > 1e-3
    for number, (obstacles, vehicles, _) in enumerate(states):
        at = turns(obstacles.q[0]).inv().apply(locate_tips(vehicles) - obstacles.p[0])
        start = np.array([[-0.9, 0.0, 0.03], [1.0, -0.02, 0.0]])
        want = turns(states[0][0].q[0]).inv().apply(start)
        np.testing.assert_allclose(at, want, atol=1e-4 if number == 0 else 2e-3)


def test_levers_and_centres_of_arms_are_those_of_the_posture():
    _, states = fly(True)
    # Those of a physics step before the end of the control step: things move by millimetres.
    for obstacles, vehicles, grips in states:
        turn = turns(vehicles.q).inv()
        lever = turn.apply(locate_tips(vehicles) - vehicles.p)
        np.testing.assert_allclose(grips.lever_m, lever, atol=5e-3)
        center = turn.apply(obstacles.p[0] - vehicles.p)
        np.testing.assert_allclose(grips.center_m, center, atol=5e-3)


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
    law = Path(__file__).with_name("echo_law.py")
    stages = ["follow", "pose", f"{law}:EchoLaw", "pseudo_inverse"]
    fly_echo(Simulator(Scenario.model_validate(TABLE | {"controller": {"stages": stages}})))


def test_a_policy_sees_what_was_measured_in_the_step_before():
    fly_echo(Simulator(Scenario.model_validate(TABLE), policy=EchoPolicy()))


def test_the_centre_of_the_body_is_where_the_grip_keeps_it():
    rng = np.random.default_rng(0)
    p, body_p = rng.normal(size=(3, 3)), rng.normal(size=(1, 3))
    q, body_q = Rotation.random(3, rng=1), Rotation.random(1, rng=2)
    wxyz = [jnp.asarray(x.as_quat(scalar_first=True), jnp.float32) for x in (q, body_q)]
    grips = take_hold(GripSpec(body=0), jnp.float32(p), wxyz[0], jnp.float32(body_p), wxyz[1])
    reading = read_grips(grips, None, jnp.int32(0))
    np.testing.assert_allclose(reading.center_m, q.inv().apply(body_p - p), atol=1e-5)
    np.testing.assert_array_equal(reading.wrench, 0.0)
