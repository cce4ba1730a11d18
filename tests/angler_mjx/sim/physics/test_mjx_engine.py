"""MJX with our terms against MuJoCo C with the same terms, and against Pinocchio."""

import subprocess
import sys
from dataclasses import dataclass
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from angler_mjx.robot.vehicles import library, mjcf
from angler_mjx.sim.physics import mjx_engine
from angler_mjx.sim.physics.closed_form import ClosedForm

from ...compiling import quickly
from . import plants as plant_module

K = 25


@pytest.fixture(scope="module")
def kicked(plants):
    """Random states of every plant, random wrenches, and what the engine makes of the states."""
    n = len(plants)
    states = plant_module.random_states(3, (n, K))
    wrench = np.random.default_rng(4).normal(size=(n, K, 6)) * [50, 50, 50, 5, 5, 5]

    def one(body, p, q, nu):
        return plants.engine.inertia_and_force(body, p, q, nu)

    many = jax.jit(jax.vmap(jax.vmap(one, (None, 0, 0, 0))))
    M_RB, force = (np.asarray(leaf) for leaf in many(plants.body, *states))
    return states, wrench, M_RB, force


def c_state(model, p, q, nu):
    """A MuJoCo C state with the given pose and body velocity, forward computed."""
    data = mujoco.MjData(model)
    data.qpos[:] = np.concatenate([p, q])
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, q)
    data.qvel[:] = np.concatenate([R.reshape(3, 3) @ nu[:3], nu[3:]])
    mujoco.mj_forward(model, data)
    return data


def c_jacobian(model, data):
    """J with nu = J qvel, and its rate, from MuJoCo's own world-frame Jacobians."""
    R = data.xmat[1].reshape(3, 3)
    turn = np.kron(np.eye(2), R.T)
    J, rate = np.zeros((6, 6)), np.zeros((6, 6))
    mujoco.mj_jacBody(model, data, J[:3], J[3:], 1)
    mujoco.mj_jacDot(model, data, rate[:3], rate[3:], data.xpos[1], 1)
    omega = R.T @ (J[3:] @ data.qvel)
    S = np.array([[0, -omega[2], omega[1]], [omega[2], 0, -omega[0]], [-omega[1], omega[0], 0]])
    return turn @ J, turn @ rate - np.kron(np.eye(2), S) @ turn @ J


def test_fields_against_mujoco_c(plants, kicked, deviation):
    (p, q, nu), wrench, M_RB, force = kicked
    M_A = np.asarray(plants.params.M_A)
    for i, model in enumerate(plants.models):
        for k in range(K):
            data = c_state(model, p[i, k], q[i, k], nu[i, k])
            full = np.zeros((6, 6))
            mujoco.mj_fullM(model, data, full)
            J, J_dot = c_jacobian(model, data)
            back = np.linalg.inv(J)
            # The same sums in float64 in another order, on numbers up to 1e2.
            near = {"rtol": 1e-11, "atol": 1e-11}
            np.testing.assert_allclose(J @ data.qvel, nu[i, k], **near)
            near["about"] = plants.names[i]
            deviation.close("mujoco.mass_matrix", M_RB[i, k], back.T @ full @ back, **near)
            bias = back.T @ (data.qfrc_bias - full @ back @ J_dot @ data.qvel)
            deviation.close("mujoco.bias", force[i, k], -bias, **near)
            # nu' = J v' + J' v: added mass joins as J^T M_A J on the left and J^T M_A J' v on the
            # right of C's equation in its own coordinates.
            total = full + J.T @ M_A[i] @ J
            right = J.T @ (wrench[i, k] - M_A[i] @ J_dot @ data.qvel) - data.qfrc_bias
            theirs = J @ np.linalg.solve(total, right) + J_dot @ data.qvel
            ours = np.linalg.solve(M_RB[i, k] + M_A[i], force[i, k] + wrench[i, k])
            deviation.close("mujoco.acceleration", ours, theirs, **near)


def test_forward_dynamics_of_mujoco_c_with_a_wrench_from_outside(plants, kicked, deviation):
    (p, q, nu), wrench, M_RB, force = kicked
    for i, model in enumerate(plants.models):
        data = c_state(model, p[i, 0], q[i, 0], nu[i, 0])
        R = data.xmat[1].reshape(3, 3)
        data.xfrc_applied[1] = np.concatenate([R @ wrench[i, 0, :3], R @ wrench[i, 0, 3:]])
        mujoco.mj_forward(model, data)
        J, J_dot = c_jacobian(model, data)
        ours = np.linalg.solve(M_RB[i, 0], force[i, 0] + wrench[i, 0])
        # float64 rounding on accelerations up to 1e2.
        theirs = J @ data.qacc + J_dot @ data.qvel
        deviation.close("mujoco.forward", theirs, ours, rtol=1e-11, atol=1e-11)


def test_rigid_body_against_pinocchio(plants, kicked, deviation):
    pinocchio = pytest.importorskip("pinocchio", reason="extra `plan` brings pinocchio")
    (p, q, nu), wrench, M_RB, force = kicked
    for i, (config, name) in enumerate(plants.configs):
        body = config.find_set(name).rigid_body
        model = pinocchio.Model()
        joint = model.addJoint(0, pinocchio.JointModelFreeFlyer(), pinocchio.SE3.Identity(), "base")
        inertia = pinocchio.Inertia(body.mass_kg, np.zeros(3), np.array(body.inertia_kgm2))
        model.appendBodyToJoint(joint, inertia, pinocchio.SE3.Identity())
        data = model.createData()
        for k in range(K):
            placed = np.concatenate([p[i, k], q[i, k, 1:], q[i, k, :1]])
            # A free flyer's velocity is nu there too, so both are in F; float64 rounding.
            upper = np.triu(pinocchio.crba(model, data, placed))
            near = {"rtol": 1e-11, "atol": 1e-11, "about": plants.names[i]}
            theirs = upper + np.triu(upper, 1).T
            deviation.close("pinocchio.mass_matrix", M_RB[i, k], theirs, **near)
            nu_dot = np.linalg.solve(M_RB[i, k], force[i, k] + wrench[i, k])
            inverse = pinocchio.rnea(model, data, placed, nu[i, k], nu_dot)
            near = {"rtol": 1e-11, "atol": 1e-10, "about": plants.names[i]}
            deviation.close("pinocchio.inverse_dynamics", inverse, wrench[i, k], **near)


def test_gravity_is_that_of_the_water(plants):
    """A `SimSpec` may say another one than MuJoCo's model: both engines take its."""
    state = [jnp.asarray(x[0, 0]) for x in plant_module.random_states(7, (1, 1))]
    body, vehicle = (plant_module.pick(x, -1) for x in (plants.body, plants.params))

    @quickly
    def both(gravity):
        ours = plants.engine.with_gravity(gravity).inertia_and_force(body, *state)
        return ours, ClosedForm(gravity_mps2=gravity).inertia_and_force(vehicle, *state)

    for gravity in (1.62, 9.81):
        for x, y in zip(*both(gravity), strict=True):
            # The same sums in another order, on numbers up to 1e2.
            np.testing.assert_allclose(x, y, rtol=1e-11, atol=1e-11)


def test_models_that_mjx_compiles_otherwise_are_refused(plants):
    """Numbers may differ, what is compiled in must not: here the integrator."""
    specs = [mjcf.to_spec(config, name, shapes=False) for config, name in plants.configs[:2]]
    specs[1].option.timestep = 0.5
    assert "opt.timestep" in mjx_engine.build_engine(specs)[1].fields
    specs[1].option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    with pytest.raises(ValueError, match=r"differ in MuJoCo's opt\.integrator.*fused"):
        mjx_engine.build_engine(specs)


def test_arrays_of_two_shapes_are_refused_by_name(plants, monkeypatch):
    """MuJoCo counts what its arrays hold, and the counts differ first; here they are left out."""

    @dataclass(frozen=True)
    class Uncounted:
        dof_damping: jax.Array

    sizes = iter([6, 7])
    module = SimpleNamespace(
        put_model=lambda model, device: Uncounted(dof_damping=jnp.zeros(next(sizes))),
        make_data=lambda model, device: None,
    )
    monkeypatch.setattr(mjx_engine, "import_mjx", lambda: module)
    specs = [mjcf.to_spec(config, name, shapes=False) for config, name in plants.configs[:2]]
    with pytest.raises(ValueError, match=r"differ in MuJoCo's dof_damping.*fused"):
        mjx_engine.build_engine(specs)


def test_every_field_in_which_models_differ_differs(plants):
    """Each variant's model, put together again, is the model that it would have alone."""
    specs = [mjcf.to_spec(config, name, shapes=False) for config, name in plants.configs]
    for i, spec in enumerate(specs):
        alone, nothing = mjx_engine.build_engine([spec])
        assert nothing.fields == {}
        mine = {name: leaf[i] for name, leaf in plants.body.fields.items()}
        found = plants.engine.model.tree_replace(mine)
        assert jax.tree.structure(found) == jax.tree.structure(alone.model)
        jax.tree.map(np.testing.assert_array_equal, found, alone.model)


def test_only_single_free_bodies_are_taken():
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body()
    body.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE)
    body.add_geom(size=[0.1, 0, 0])
    with pytest.raises(ValueError, match="one free body"):
        mjx_engine.build_engine([spec])


def test_models_stand_on_the_first_of_the_processes_own_devices(monkeypatch):
    spec = mjcf.to_spec(library.load_vehicle("bluerov2"), "blue_gazebo", shapes=False)
    own = jax.local_devices()[0]
    monkeypatch.setattr(jax, "local_devices", lambda: [own, "another one of this process"])
    engine, _ = mjx_engine.build_engine([spec])
    arrays = [leaf for leaf in jax.tree.leaves(engine) if isinstance(leaf, jax.Array)]
    assert {device for leaf in arrays for device in leaf.devices()} == {own}


def test_mjx_is_loaded_by_those_who_compute_with_it_alone():
    script = (
        "import sys\n"
        "from angler_mjx.scenario.scenario import load_scenario\n"
        "from angler_mjx.runs.simulator.simulator import Simulator\n"
        "engine = {'engine': 'fused', 'tile': 1}\n"
        "Simulator(load_scenario('open_water_current').model_copy(update=engine))\n"
        "sys.exit('mujoco.mjx' in sys.modules)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
