"""Fins of vehicle files: lift by hand, rows of actuators, signals, and what they turn."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.robot.vehicles import fins, library, params
from angler_mjx.robot.vehicles.config import VehicleConfig

TORPEDO = library.load_vehicle("remus100").model_dump(mode="json")
RUDDER, PLANE = range(2)


def with_fins(*layout, name="remus100"):
    """A vehicle with changed fins of the torpedo: (index, changes) for each."""
    made = [TORPEDO["fins"]["layout"][index] | changes for index, changes in layout]
    data = library.load_vehicle(name).model_dump(mode="json")
    return VehicleConfig.model_validate(data | {"fins": TORPEDO["fins"] | {"layout": made}})


def test_lift_of_an_aspect_ratio_is_hoerner_s():
    def slope(**changes):
        config = with_fins((RUDDER, {"lift_slope_per_rad": None} | changes))
        return config.fins.layout[0].lift_slope

    # 1 / (1 / 1.8 pi + 1 / 3 pi) = pi 1.8 3 / 4.8.
    assert slope(aspect_ratio=3.0) == pytest.approx(1.125 * math.pi)
    # Prestero (2001) finds 3.12 for the fins of the REMUS, of aspect ratio 2.21.
    assert slope(aspect_ratio=2.21) == pytest.approx(3.12, rel=0.01)
    # Long wings have nine tenths of a plate's 2 pi, short ones half pi by their aspect ratio.
    assert slope(aspect_ratio=1e6) == pytest.approx(1.8 * math.pi, rel=1e-5)
    assert slope(aspect_ratio=1e-3) == pytest.approx(math.pi * 1e-3, rel=1e-3)
    assert slope(aspect_ratio=3.0, lift_slope_per_rad=2.5) == 2.5


def test_rows_of_fins_stand_behind_those_of_thrusters():
    made = fins.build_fins(library.load_vehicle("remus100"))
    np.testing.assert_array_equal(made.is_fin, [False, True, True])
    np.testing.assert_allclose(made.area_m2, [0.0, 0.0133, 0.0133])
    np.testing.assert_allclose(made.limit_rad, [0.0, 0.26, 0.26])
    # C_D = C_L^2 / (pi 0.9 2.21).
    np.testing.assert_allclose(made.induced_drag[1:], 1.0 / (math.pi * 0.9 * 2.21), rtol=1e-6)
    # The rudder's force is to the left, 0.638 m behind and 0.0196 m above the centre of mass.
    np.testing.assert_allclose(made.normal[1], [0, 1, 0, -0.0196, 0, -0.638], atol=1e-7)
    np.testing.assert_allclose(made.chord[1], [1, 0, 0, 0, 0.0196, 0], atol=1e-7)
    # The planes turn about the way to the left: their force is downward, and lifts the bow.
    np.testing.assert_allclose(made.normal[2], [0, 0, -1, 0, -0.638, 0], atol=1e-7)
    assert fins.build_fins(library.load_vehicle("bluerov2")) is None


def test_signals_settle_at_their_part_of_the_limit():
    made = fins.build_fins(library.load_vehicle("remus100"))
    for pwm_us, part in ((900, -1), (1100, -1), (1300, -0.5), (1500, 0), (1800, 0.75), (2000, 1)):
        settled = fins.settled_deflection(made, jnp.full(3, float(pwm_us)))
        np.testing.assert_allclose(settled, [0.0, 0.26 * part, 0.26 * part], atol=1e-7)


def test_the_matrix_of_lift_is_area_by_slope_of_fins_that_move():
    config = with_fins((RUDDER, {}), (PLANE, {"limit_rad": 0.0}))
    lift_m2 = 0.0133 * 1.4074
    expected = np.zeros((6, 3))
    expected[[1, 3, 5], 1] = lift_m2 * np.array([1.0, -0.0196, -0.638])
    np.testing.assert_allclose(fins.fin_matrix(config), expected, atol=1e-8)
    np.testing.assert_array_equal(
        fins.fin_matrix(library.load_vehicle("bluerov2")), np.zeros((6, 6))
    )
    # Those of a fleet have a leading axis.
    made = fins.build_fins(config)
    fleet = fins.FinParams(
        **{name: jnp.stack([value, value]) for name, value in vars(made).items()}
    )
    np.testing.assert_allclose(fins.lift_matrix(fleet), [expected, expected], atol=1e-8)


TILTED = [0.0, 0.6, 0.8]


@pytest.mark.parametrize(
    ("layout", "steers"),
    [
        (((RUDDER, {}), (PLANE, {})), True),
        (((RUDDER, {}),), False),
        (((PLANE, {}),), False),
        (((RUDDER, {}), (PLANE, {"limit_rad": 0.0})), False),
        # Two that stand across each other turn about both axes, two along each other do not.
        (((RUDDER, {"span": TILTED}), (PLANE, {"span": [0.0, -0.8, 0.6]})), True),
        (((RUDDER, {"span": TILTED}), (PLANE, {"span": TILTED})), False),
    ],
)
def test_fins_steer_where_they_turn_in_pitch_and_yaw_each_alone(layout, steers):
    # The ROV flies by its thrusters, whatever its fins.
    config = with_fins(*layout, name="bluerov2_heavy")
    assert fins.steers_by_fins(config) is steers


def test_vehicles_without_fins_do_not_steer_by_them():
    assert not fins.steers_by_fins(library.load_vehicle("bluerov2_heavy"))


def test_vehicles_with_fins_and_no_heave_of_thrusters_climb_by_pitch():
    torpedo, rov, finned = (
        params.build_vehicle(config, None, 16.0)
        for config in (
            library.load_vehicle("remus100"),
            library.load_vehicle("bluerov2_heavy"),
            with_fins((RUDDER, {}), name="bluerov2_heavy"),
        )
    )
    assert [bool(fins.flies_by_fins(v)) for v in (torpedo, rov, finned)] == [True, False, False]


@pytest.mark.parametrize("orders", [1, 3])
def test_deflections_are_the_first_states_of_the_rows_of_fins(orders):
    made = fins.build_fins(library.load_vehicle("remus100"))
    # The thrust of the propeller, 5 N, is no deflection.
    states = np.array([5.0, 0.1, -0.05])
    if orders == 3:
        states = np.stack([states, np.full(3, 7.0), np.full(3, -7.0)])
    nu = jnp.array([1.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    wrench = fins.fin_wrench(made, jnp.asarray(states), nu, 1030.0)
    pressure_n = 0.5 * 1030.0 * 1.5**2 * 0.0133
    coefficient = 1.4074 * np.array([0.1, -0.05])
    rudder, plane = pressure_n * coefficient
    drag = np.sum(pressure_n * coefficient**2 / (math.pi * 0.9 * 2.21))
    # 0.638 m behind the centre of mass and 0.0196 m above it.
    moment = [-0.0196 * rudder, -0.0196 * drag - 0.638 * plane, -0.638 * rudder]
    np.testing.assert_allclose(wrench, [-drag, rudder, -plane, *moment], rtol=1e-4)
