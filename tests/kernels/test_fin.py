"""Forces of fins by hand: lift and drag by the flow at the fin, the stall, and the servos."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels import fin

RHO, AREA, SLOPE, X = 1000.0, 0.02, 3.0, -0.6


@pytest.fixture(autouse=True)
def double():
    with jax.enable_x64(True):
        yield


def rudder(nu, delta, **changes):
    """Wrench of a rudder behind the origin: chord x, span z, normal y."""
    numbers = {
        "chord": jnp.array([[1.0, 0, 0, 0, 0, 0]]),
        "normal": jnp.array([[0.0, 1, 0, 0, 0, X]]),
        "area": jnp.array([AREA]),
        "lift_slope": jnp.array([SLOPE]),
        "zero_drag": jnp.array([0.02]),
        "induced_drag": jnp.array([0.1]),
        "plate_drag": jnp.array([1.2]),
        "stall": jnp.array([0.3]),
    }
    numbers |= {key: jnp.array([value]) for key, value in changes.items()}
    return np.asarray(
        fin.fin_wrench(
            **numbers, deflection=jnp.array([delta]), nu_r=jnp.asarray(nu, float), density=RHO
        )
    )


def test_a_deflected_rudder_turns_a_vehicle_that_moves_ahead():
    wrench = rudder([2.0, 0, 0, 0, 0, 0], 0.1)
    q = 0.5 * RHO * AREA * 4.0
    lift, drag = q * SLOPE * 0.1, q * (0.02 + 0.1 * 0.3**2)
    np.testing.assert_allclose(wrench, [-drag, lift, 0, 0, 0, X * lift], rtol=1e-9)


def test_drift_and_turning_are_flow_at_the_fin():
    # A stern that swings to the left at r = -0.5 rad/s: v at the fin is 0.3 m/s.
    wrench = rudder([2.0, 0, 0, 0, 0, -0.5], 0.0)
    alpha, square = -np.arctan2(0.3, 2.0), 2.0**2 + 0.3**2
    lift = 0.5 * RHO * AREA * square * SLOPE * alpha
    drag = 0.5 * RHO * AREA * square * (0.02 + 0.1 * (SLOPE * alpha) ** 2)
    cos, sin = 2.0 / np.sqrt(square), 0.3 / np.sqrt(square)
    expected = lift * cos - drag * sin
    np.testing.assert_allclose(wrench[[1, 5]], [expected, X * expected], rtol=1e-9)
    np.testing.assert_allclose(wrench[0], -lift * sin - drag * cos, rtol=1e-9)


def test_lift_falls_behind_the_stall_to_that_of_a_plate():
    def lift(delta):
        return rudder([1.0, 0, 0, 0, 0, 0], delta)[1] / (0.5 * RHO * AREA)

    assert lift(0.29) == pytest.approx(SLOPE * 0.29)
    assert lift(0.3 + 1e-9) == pytest.approx(lift(0.3 - 1e-9), rel=1e-6)
    assert lift(0.5) == pytest.approx(1.2 * np.sin(0.5) * np.cos(0.5))
    assert lift(0.5) < 0.6 * lift(0.3)
    across = rudder([1.0, 0, 0, 0, 0, 0], np.pi / 2)
    np.testing.assert_allclose(across[:2], [-0.5 * RHO * AREA * 1.22, 0.0], atol=1e-9)


def test_astern_the_plate_pushes_the_other_way():
    ahead, astern = (rudder([u, 0, 0, 0, 0, 0], 0.1)[1] for u in (1.0, -1.0))
    assert ahead > 0 > astern


def test_fins_take_energy_from_still_water_at_any_motion():
    rng = np.random.default_rng(0)
    for nu, delta in zip(rng.normal(size=(200, 6)), rng.uniform(-1, 1, 200), strict=True):
        assert rudder(nu, delta) @ nu <= 1e-12


def test_at_rest_there_is_neither_force_nor_a_derivative_that_is_none():
    def force(nu):
        return jnp.sum(
            fin.fin_wrench(
                chord=jnp.array([[1.0, 0, 0, 0, 0, 0]]),
                normal=jnp.array([[0.0, 1, 0, 0, 0, X]]),
                area=jnp.ones(1),
                lift_slope=jnp.ones(1),
                zero_drag=jnp.ones(1),
                induced_drag=jnp.ones(1),
                plate_drag=jnp.ones(1),
                stall=0.3 * jnp.ones(1),
                deflection=0.2 * jnp.ones(1),
                nu_r=nu,
                density=RHO,
            )
        )

    assert force(jnp.zeros(6)) == 0.0
    assert np.all(np.isfinite(jax.grad(force)(jnp.zeros(6))))


def test_servos_lag_and_have_a_fastest_rate():
    angle, tau, rate = jnp.zeros(2), jnp.array([0.1, 0.1]), jnp.array([100.0, 0.5])
    command = jnp.array([0.2, 0.2])
    turned = fin.turn_fins(angle, command, tau, rate, 0.05)
    np.testing.assert_allclose(turned, [0.2 * (1 - np.exp(-0.5)), 0.5 * 0.05], rtol=1e-12)
