"""The simulator in ENU and FLU against the textbook in NED and FRD."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx import frames
from angler_mjx.world.currents import Uniform, Vortices

from . import plants as plant_module
from . import textbook

UNIFORM_ENU = np.array([0.15, 0.1, -0.02])
CENTRE_ENU = np.array([1.0, 0.5])
# Greatest speed 0.5 m/s at 1.3 m from the axis.
CIRCULATION, CORE = 5.2, 1.2
ROWS_HELD, N_COMMAND = 5, 8
HOLD_S = ROWS_HELD * plant_module.ROW_S


@pytest.fixture(scope="module")
def current(x64):
    return (
        Uniform(velocity_mps=jnp.asarray(UNIFORM_ENU)),
        Vortices(
            centre_m=jnp.asarray(CENTRE_ENU)[None],
            circulation_m2ps=jnp.array([CIRCULATION]),
            core_m=jnp.array([CORE]),
        ),
    )


@pytest.fixture(scope="module")
def vehicles(plants):
    # Seen from above the vortex turns against the clock; with down as the third axis that is a
    # negative turn.
    flow = textbook.uniform_and_vortex(
        frames.vector_enu_to_ned(UNIFORM_ENU), CENTRE_ENU[::-1], -CIRCULATION, CORE
    )
    return [textbook.Vehicle(config, name, flow) for config, name in plants.configs]


def commands_of(plants):
    rng = np.random.default_rng(8)
    exists = np.asarray(plants.params.thruster_exists)[:, None, :]
    # Up to a third of full thrust: attitudes turn over, speeds reach 1 m/s.
    return rng.uniform(-12, 15, (len(plants), N_COMMAND, exists.shape[-1])) * exists


def test_accelerations_at_random_states(plants, current, vehicles, deviation):
    n, k = len(plants), 40
    p, q, nu = plant_module.random_states(1, (n, k))
    exists = np.asarray(plants.params.thruster_exists)
    thrust = np.random.default_rng(2).uniform(-40, 50, (n, k, exists.shape[1])) * exists[:, None]
    ours = plant_module.accelerations(
        plants.engine, plants.body, plants.params, p, q, nu, thrust, current
    )
    ours = frames.body_flu_to_frd(np.asarray(ours))
    p, q = frames.vector_enu_to_ned(p), frames.quaternion_enu_to_ned(q)
    nu = frames.body_flu_to_frd(nu)
    for i, vehicle in enumerate(vehicles):
        n_t = vehicle.T.shape[1]
        theirs = [
            vehicle.acceleration(p[i, j], q[i, j], nu[i, j], thrust[i, j, :n_t]) for j in range(k)
        ]
        # Two orders of summation in float64 on accelerations up to 100 m/s^2 and rad/s^2.
        near = {"rtol": 1e-11, "atol": 1e-11, "about": plants.names[i]}
        deviation.close("textbook.acceleration", ours[i], theirs, **near)


def simulate(plants, current, dt):
    n = len(plants)
    p = np.tile([0.0, 0.0, -9.0], (n, 1))
    q = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    nu = np.tile([0.2, -0.1, 0.1, 0.3, -0.2, 0.4], (n, 1))
    state = plant_module.start(plants.params, p, q, nu)
    after = plant_module.rollout(
        plants.engine,
        plants.body,
        plants.params,
        state,
        np.repeat(commands_of(plants), ROWS_HELD, axis=1),
        current,
        dt=dt,
    )
    ends = slice(ROWS_HELD - 1, ROWS_HELD * N_COMMAND, ROWS_HELD)
    after = jax.tree.map(lambda leaf: leaf[:, ends], after)
    return (
        frames.vector_enu_to_ned(np.asarray(after.p)),
        frames.quaternion_enu_to_ned(np.asarray(after.q)),
        frames.body_flu_to_frd(np.asarray(after.nu)),
    )


def test_whole_trajectories_in_a_current(plants, current, vehicles, deviation):
    coarse, fine = simulate(plants, current, 0.01), simulate(plants, current, 0.005)
    commands = commands_of(plants)
    first = np.concatenate(
        [
            frames.vector_enu_to_ned(np.array([0.0, 0.0, -9.0])),
            frames.quaternion_enu_to_ned(np.array([1.0, 0, 0, 0])),
            frames.body_flu_to_frd(np.array([0.2, -0.1, 0.1, 0.3, -0.2, 0.4])),
        ]
    )
    for i, vehicle in enumerate(vehicles):
        n_t = vehicle.T.shape[1]
        state = np.concatenate([first, np.zeros(n_t)])
        # To 1e-8, a thousandth of what the extrapolated steps leave.
        truth = vehicle.solve(state, commands[i, :, :n_t], HOLD_S, rtol=1e-8)
        truth = truth[:, :3], truth[:, 3:7], truth[:, 7:13]
        for name, true, rough, good in zip("pq\u03bd", truth, coarse, fine, strict=True):
            message = f"{plants.names[i]} {name}"
            error = np.abs(rough[i] - true).max()
            # 10 ms steps: p within millimetres, q and nu alike.
            kind = {"p": "position", "q": "attitude", "\u03bd": "velocity"}[name]
            bound = 0.02 if kind == "velocity" else 0.004
            deviation(f"textbook.trajectory_{kind}", error, bound, about=message)
            # The scheme is of second order: half the step, a quarter of the error (the third-order
            # part makes it a little more) ...
            share = np.abs(good[i] - true).max() / error
            deviation("textbook.trajectory_halved", share, 1 / 3.3, about=message)
            # ... and what extrapolation leaves is of third order, 0.01 s times the rates (5 1/s).
            limit = (4 * good[i] - rough[i]) / 3
            left = np.abs(limit - true).max() / error
            deviation("textbook.trajectory_extrapolated", left, 0.1, about=message)
