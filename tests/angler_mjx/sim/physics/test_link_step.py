"""One step of a vehicle with links: its forces, and the implicit equation that it solves."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels import rigid_body
from angler_mjx.robot.vehicles import library
from angler_mjx.sim.physics import rotors
from angler_mjx.sim.physics import step as physics
from angler_mjx.world.currents import Uniform

from ...compiling import quickly
from . import armed as arms
from .plants import WATER

DT = 0.01


@pytest.fixture(scope="module")
def shipped(x64):
    return arms.build(library.load_vehicle(arms.SHIPPED), "von_benzon2022")


@pytest.fixture(scope="module")
def free(shipped):
    """The vehicle with joints that nothing drives or rubs."""
    none = jnp.zeros(shipped.count)
    names = ("stiffness", "damping", "viscous_friction", "coulomb_friction")
    links = replace(shipped.params.links, **dict.fromkeys(names, none))
    return replace(shipped.params, links=links)


def make_state(vehicle, change):
    """Return a moving vehicle with its arm half way, and what it keeps of the step before."""
    links, rng = vehicle.links, np.random.default_rng(7)
    n = 6 + links.home.size
    return physics.VehicleState(
        p=jnp.array([0.3, -0.2, -5.0]),
        q=jnp.asarray(np.array([0.9, 0.2, -0.3, 0.1]) / np.sqrt(0.95)),
        nu=jnp.array([0.4, -0.2, 0.1, 0.3, -0.2, 0.4]),
        force_before=jnp.asarray(0.1 * rng.normal(size=n)),
        thrust=jnp.zeros(vehicle.B.shape[1]),
        joints=arms.motion(0.5 * (links.lower + links.upper), 0.01 * rng.normal(size=n - 6)),
        change=change,
    )


@pytest.mark.parametrize("has_change", [False, True])
def test_a_step_solves_its_equation(shipped, free, has_change):
    """M change = 1.5 dt f - 0.5 dt f_before - 0.5 M change_before + dt tau + 0.5 dt (new - old
    damping)."""
    n, flow = 6 + shipped.count, jnp.array([0.2, -0.1, 0.05])
    before = 0.01 * jnp.cos(jnp.arange(float(n)))
    state = make_state(free, before if has_change else None)
    command = jnp.linspace(-5.0, 5.0, free.B.shape[1])

    @quickly
    def evaluate(state):
        current, zero = (Uniform(velocity_mps=flow),), jnp.zeros(())
        after = physics.step(
            shipped.engine, shipped.body, free, state, command, current, zero, DT, WATER
        )
        forces = physics.join_forces(free, state, flow, jnp.zeros(3), WATER)
        damping = physics.change_damping(free, forces, after.change, WATER)
        _, thrust = rotors.advance_rotors(free, state.thrust, command, DT)
        return after, forces.M, forces.force, damping, rigid_body.matrix_times(free.B, thrust)

    after, M, force, damping, wrench = evaluate(state)
    right = DT * (1.5 * force - 0.5 * state.force_before + 0.5 * damping)
    right = right.at[:6].add(DT * wrench)
    if has_change:
        right = right - 0.5 * M @ before
    scale = np.max(np.abs(right))
    assert scale > 1e-3
    np.testing.assert_allclose(M @ after.change, right, atol=1e-7 * scale)
    np.testing.assert_allclose(after.nu, state.nu + after.change[:6], atol=1e-15)
    expected = force + damping - M @ after.change / DT
    np.testing.assert_allclose(after.force_before, expected, atol=1e-9 * np.max(np.abs(force)))
