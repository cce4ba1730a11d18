"""The MuJoCo model: what a reader of the exported XML gets."""

import subprocess
import sys

import mujoco
import numpy as np
import pytest

from angler_mjx.robot.vehicles.drive import wrench_matrix
from angler_mjx.robot.vehicles.library import list_rovs, load_vehicle
from angler_mjx.robot.vehicles.mjcf import to_spec, to_xml


@pytest.fixture(scope="module", params=list_rovs())
def vehicle(request):
    config = load_vehicle(request.param)
    return config, mujoco.MjModel.from_xml_string(to_xml(config, "blue_gazebo"))


def test_mass_and_inertia_survive_the_file(vehicle):
    config, model = vehicle
    body = config.find_set("blue_gazebo").rigid_body
    assert model.nq == 7 + len(config.joints)
    assert model.body_mass[1] == pytest.approx(body.mass_kg, rel=1e-6)  # XML has six digits
    np.testing.assert_array_equal(model.body_ipos[1], 0)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    axes = data.ximat[1].reshape(3, 3)
    np.testing.assert_allclose(
        axes @ np.diag(model.body_inertia[1]) @ axes.T, body.inertia_kgm2, atol=1e-6
    )


def test_full_inertia_keeps_its_products(vehicle):
    config, _ = vehicle
    data = config.model_dump()
    inertia = [[0.26, 0.01, -0.02], [0.01, 0.23, 0.03], [-0.02, 0.03, 0.37]]
    data["parameter_sets"]["blue_gazebo"]["rigid_body"]["inertia_kgm2"] = inertia
    model = to_spec(type(config).model_validate(data), "blue_gazebo").compile()
    state = mujoco.MjData(model)
    mujoco.mj_forward(model, state)
    axes = state.ximat[1].reshape(3, 3)
    # float64 eigen-decomposition.
    np.testing.assert_allclose(axes @ np.diag(model.body_inertia[1]) @ axes.T, inertia, atol=1e-12)


def test_sites_reproduce_the_wrench_matrix(vehicle):
    config, model = vehicle
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert model.nsite == len(config.thrusters.layout)
    force = data.site_xmat.reshape(-1, 3, 3)[:, :, 2]
    wrench = np.concatenate([force, np.cross(data.site_xpos, force)], axis=1).T
    # Six digits in the XML, on numbers up to 1.
    np.testing.assert_allclose(wrench, wrench_matrix(config), atol=3e-6)


def test_nothing_touches_and_no_fluid_is_set(vehicle):
    _, model = vehicle
    assert not model.geom_contype.any()
    assert not model.geom_conaffinity.any()
    assert model.opt.density == 0
    assert model.opt.viscosity == 0
    assert not model.geom_fluid.any()
    assert model.opt.disableflags == 0


def test_it_falls_freely_in_c_without_a_warning(vehicle):
    config, model = vehicle
    if config.joints:
        pytest.skip("joints that nothing holds: MuJoCo's own step is not that accurate")
    data = mujoco.MjData(model)
    mujoco.mj_resetData(model, data)
    data.qvel[3:] = [0.3, -0.5, 0.7]
    for _ in range(500):
        mujoco.mj_step(model, data)
    assert not any(warning.number for warning in data.warning)
    assert np.all(np.isfinite(data.qpos))
    # Constant acceleration: the velocity is exact up to rounding.
    assert data.qvel[2] == pytest.approx(-9.81 * data.time, rel=1e-9)


def test_a_warning_of_mujoco_is_logged_and_not_written_into_the_working_folder(tmp_path):
    # A process of its own: the handler is the process's.
    code = (
        "import mujoco\n"
        "from angler_mjx.robot.vehicles import mjcf\n"
        "model = mujoco.MjModel.from_xml_string('<mujoco><worldbody><body><freejoint/>"
        '<geom size=".1"/></body></worldbody></mujoco>\')\n'
        "data = mujoco.MjData(model)\n"
        "data.qpos[0] = float('nan')\n"
        "mujoco.mj_step(model, data)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert "MuJoCo: Nan, Inf or huge value in QPOS" in done.stderr
    assert list(tmp_path.iterdir()) == []
