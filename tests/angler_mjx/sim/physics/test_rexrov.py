"""RexROV: the published allocation matrix, and its motion against numpy's textbook."""

import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx import frames
from angler_mjx.robot.vehicles import library
from angler_mjx.robot.vehicles.drive import wrench_matrix
from angler_mjx.world.currents import Uniform, Vortices

from . import plants as plant_module
from . import textbook

TAM = [
    [0.15974268848446743, 0.15974268848446743, -0.1597424266785477, -0.1597424266785477,
     0.7071068613706476, 0.7071068613706476, -0.7071065406341925, -0.7071065406341925],
    [-0.2136101154609486, 0.2136101154609486, -0.21360976537047976, 0.21360976537047976,
     0.7071067010024383, -0.7071067010024383, 0.7071070217388206, -0.7071070217388206],
    [0.9637701967007046, 0.9637701967007046, 0.9637703176884092, 0.9637703176884092,
     0.0, 0.0, 0.0, 0.0],
    [0.4352320257020549, -0.4352320257020549, 0.43523188102298654, -0.43523188102298654,
     -0.09121676442931455, 0.09121676442931455, -0.09121680580430785, 0.09121680580430785],
    [0.9430934973994073, 0.9430934973994073, -0.9430934667380183, -0.9430934667380183,
     0.09121678511681354, 0.09121678511681354, -0.09121674374181084, -0.09121674374181084],
    [0.13688862492470316, -0.13688862492470316, -0.1368884005748274, 0.1368884005748274,
     -0.6487987634902757, 0.6487987634902757, 0.6487987335687417, -0.6487987335687417],
]  # fmt: skip
"""UUV Simulator (bfb40cb), uuv_thruster_manager/config/rexrov/TAM.yaml."""
FLOW_ENU = np.array([0.3, -0.2, 0.1])


def test_the_wrench_matrix_is_the_published_one():
    np.testing.assert_allclose(wrench_matrix(library.load_vehicle("rexrov")), TAM, atol=1e-6)


@pytest.fixture(scope="module")
def plants(x64):
    return plant_module.build([(library.load_vehicle("rexrov"), "berg2012")])


def test_accelerations(plants):
    k = 20
    flow = frames.vector_enu_to_ned(FLOW_ENU)
    truth = textbook.Vehicle(*plants.configs[0], lambda p: flow + 0 * p.real)
    p, q, nu = plant_module.random_states(1, (1, k))
    thrust = np.random.default_rng(2).uniform(-2000, 2000, (1, k, 8))
    still = Vortices(
        centre_m=jnp.array([[9.0, 9.0]]), circulation_m2ps=jnp.zeros(1), core_m=jnp.ones(1)
    )
    current = (Uniform(velocity_mps=jnp.asarray(FLOW_ENU)), still)
    ours = plant_module.accelerations(
        plants.engine, plants.body, plants.params, p, q, nu, thrust, current
    )
    theirs = [
        truth.acceleration(
            frames.vector_enu_to_ned(p[0, j]),
            frames.quaternion_enu_to_ned(q[0, j]),
            frames.body_flu_to_frd(nu[0, j]),
            thrust[0, j],
        )
        for j in range(k)
    ]
    ours = frames.body_flu_to_frd(np.asarray(ours))[0]
    np.testing.assert_allclose(ours, theirs, rtol=1e-10, atol=1e-10)


def test_added_mass_holds_the_published_energy():
    """M_A of the thesis is for x forward, y right, z down: the same motion has the same energy."""
    coefficients = np.array(library.load_vehicle("rexrov").find_set(None).added_mass.coefficients)
    surge_with_heave_down = np.array([1.0, 0, 1.0, 0, 0, 0])
    energy = surge_with_heave_down * [1, -1, -1, 1, -1, -1]
    assert energy @ coefficients @ energy == pytest.approx(779.79 + 3659.9 - 2 * 103.32)
