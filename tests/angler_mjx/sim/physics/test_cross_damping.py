"""A vehicle with full damping matrices against numpy's textbook, in both engines' terms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx import frames
from angler_mjx.robot.vehicles import library, params
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.damping import largest_gain_w
from angler_mjx.sim.physics import step as physics
from angler_mjx.sim.physics.closed_form import ClosedForm
from angler_mjx.world.currents import Uniform, Vortices

from . import plants as plant_module
from . import textbook

FLOW_ENU = np.array([0.15, 0.1, -0.02])


@pytest.fixture(scope="module")
def coupled(x64):
    return plant_module.build([(plant_module.coupled(), "wu2018")])


@pytest.fixture(scope="module")
def truth(coupled):
    flow = frames.vector_enu_to_ned(FLOW_ENU)
    return textbook.Vehicle(*coupled.configs[0], lambda p: flow + 0 * p.real)


def flow_of(velocity):
    """A uniform current, and a vortex of no strength: the plants have programs for both alone."""
    still = Vortices(
        centre_m=jnp.array([[9.0, 9.0]]), circulation_m2ps=jnp.zeros(1), core_m=jnp.ones(1)
    )
    return Uniform(velocity_mps=jnp.asarray(velocity)), still


def test_accelerations(coupled, truth):
    k = 20
    p, q, nu = plant_module.random_states(1, (1, k))
    thrust = np.random.default_rng(2).uniform(-30, 30, (1, k, 8))
    current = flow_of(FLOW_ENU)
    theirs = [
        truth.acceleration(
            frames.vector_enu_to_ned(p[0, j]),
            frames.quaternion_enu_to_ned(q[0, j]),
            frames.body_flu_to_frd(nu[0, j]),
            thrust[0, j],
        )
        for j in range(k)
    ]
    ours = plant_module.accelerations(
        coupled.engine, coupled.body, coupled.params, p, q, nu, thrust, current
    )
    near = {"rtol": 1e-10, "atol": 1e-10}
    np.testing.assert_allclose(frames.body_flu_to_frd(np.asarray(ours))[0], theirs, **near)
    vehicle = plant_module.pick(coupled.params, 0)

    @jax.jit
    def closed(p, q, nu, thrust):
        state = physics.VehicleState(p=p, q=q, nu=nu, force_before=nu, thrust=thrust)
        engine = ClosedForm(gravity_mps2=9.81)
        M, force, _ = physics.smooth_force(
            engine, vehicle, vehicle, state, current, jnp.zeros(()), plant_module.WATER
        )
        return jnp.linalg.solve(M, force + vehicle.B @ thrust)

    fused = [closed(p[0, j], q[0, j], nu[0, j], thrust[0, j]) for j in range(k)]
    np.testing.assert_allclose(frames.body_flu_to_frd(np.asarray(fused)), theirs, **near)


def test_trajectories_converge_with_second_order(coupled, truth):
    commands = np.random.default_rng(3).uniform(-10, 12, (1, 5, 8))
    current = flow_of(FLOW_ENU)
    p, q = np.array([[0.0, 0.0, -9.0]]), np.array([[1.0, 0, 0, 0]])
    nu = np.array([[0.2, -0.1, 0.1, 0.3, -0.2, 0.4]])
    first = np.concatenate(
        [
            frames.vector_enu_to_ned(p[0]),
            frames.quaternion_enu_to_ned(q[0]),
            frames.body_flu_to_frd(nu[0]),
            np.zeros(8),
        ]
    )
    held_s = 4 * plant_module.ROW_S
    end = truth.solve(first, commands[0], held_s, rtol=1e-9)[-1]
    errors = []
    for dt in (0.01, 0.005):
        state = plant_module.start(coupled.params, p, q, nu)
        rows = np.repeat(commands, 4, axis=1)
        after = plant_module.rollout(
            coupled.engine, coupled.body, coupled.params, state, rows, current, dt=dt
        )
        ours = frames.body_flu_to_frd(np.asarray(after.nu)[0, 19])
        errors.append(np.linalg.norm(ours - end[7:13]))
    assert errors[0] < 2e-3
    assert errors[0] / errors[1] > 3.0


def test_diagonal_vehicles_have_no_cross_damping():
    vehicle = params.build_vehicle(library.load_vehicle("bluerov2_heavy"), None, 16.0)
    assert vehicle.cross_damping is None


def edit_damping(**tables):
    data = library.load_vehicle("bluerov2_heavy").model_dump()
    data["parameter_sets"]["wu2018"]["damping"].update(tables)
    return VehicleConfig.model_validate(data).parameter_sets["wu2018"].damping


def test_a_matrix_that_is_diagonal_is_its_diagonal():
    rows = np.diag([4.0, 6, 5, 1, 1, 1]).tolist()
    damping = edit_damping(linear=rows)
    assert damping.linear == (4.0, 6.0, 5.0, 1.0, 1.0, 1.0)
    assert not damping.couples_axes


def test_linear_damping_that_drives_is_refused():
    rows = np.diag([4.0, 6, 5, 1, 1, 1])
    rows[0, 1] = rows[1, 0] = 5.0  # 25 > 4 * 6
    with pytest.raises(ValueError, match="still water would drive"):
        edit_damping(linear=rows.tolist())


def test_derivatives_by_other_names_are_refused():
    with pytest.raises(ValueError, match=r"products\.Yuv"):
        edit_damping(products={"Yuv": 1.0})


def test_gain_of_quadratic_damping_shows():
    rows = np.diag([18.0, 21, 36, 1, 1, 1])
    assert largest_gain_w(edit_damping(quadratic=rows.tolist())) < 0
    rows[1, 0] = -200.0
    assert largest_gain_w(edit_damping(quadratic=rows.tolist())) > 10


def test_stacked_with_others_the_diagonal_vehicle_moves_the_same(x64):
    both = plant_module.build(
        [(library.load_vehicle("bluerov2_heavy"), "wu2018"), (plant_module.coupled(), "wu2018")]
    )
    alone = plant_module.build([(library.load_vehicle("bluerov2_heavy"), "wu2018")])
    ends = []
    for plants in (both, alone):
        n = len(plants)
        state = plant_module.start(
            plants.params, np.zeros((n, 3)) - 5, np.tile([1.0, 0, 0, 0], (n, 1)), np.ones((n, 6))
        )
        rows = np.full((n, 20, 8), 5.0)
        current = flow_of(np.zeros(3))
        after = plant_module.rollout(
            plants.engine, plants.body, plants.params, state, rows, current, dt=0.01
        )
        ends.append(np.asarray(after.nu)[0, -1])
    np.testing.assert_allclose(*ends, rtol=1e-9, atol=1e-12)
