"""Steady glides in closed form: speeds, and the moment that the moving mass balances."""

import copy

import numpy as np
import pytest

from angler_mjx.robot.vehicles import glide, library
from angler_mjx.robot.vehicles.config import VehicleConfig

G, RHO = 9.81, 1025.0
WATER_M3 = 4e-4
WEIGHT_N = RHO * WATER_M3 * G
D_U, D_W, A_U, A_W = 8.0, 60.0, 2.0, 70.0
MASS_KG, CARRIED_KG = 65.28, 11.0
"""Of the glider and of the battery that moves along x."""
LEVEL = [0.0] * 6


def build(*, tank=(0.0, 0.0, 0.0), center_m=0.0, added=(A_U, A_U), products=None, masses=None):
    """The shipped glider with diagonal drag alone, its centre of mass at the origin."""
    data = library.load_vehicle("seawing").model_dump(mode="json")
    data["base"]["center_of_mass_m"] = [0.0, 0.0, 0.0]
    data["ballast"]["layout"][0]["position_m"] = tank
    if masses is not None:
        data["moving_masses"]["layout"] = masses
    chosen = data["parameter_sets"]["zhang2013"]
    chosen["buoyancy"]["center_of_buoyancy_m"] = [0.0, 0.0, center_m]
    chosen["added_mass"]["coefficients"] = [added[0], 50.0, added[1], 1.0, 8.0, 10.0]
    chosen["damping"] |= {
        "linear": LEVEL,
        "quadratic": [D_U, 50.0, D_W, 1.0, 10.0, 10.0],
        "products": products or {},
    }
    config = VehicleConfig.model_validate(data)
    return config, config.find_set(None)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("degrees", [15.0, 40.0])
def test_drag_along_each_axis_balances_the_weight_along_it(sign, degrees):
    pitch = -sign * np.radians(degrees)
    made = glide.solve_glide(*build(), sign * WATER_M3, pitch)
    u = np.sqrt(WEIGHT_N * np.sin(abs(pitch)) / D_U)
    w = -sign * np.sqrt(WEIGHT_N * np.cos(pitch) / D_W)
    np.testing.assert_allclose(made.velocity_mps, [u, w], rtol=1e-6)
    # Nothing turns it: equal added mass along both axes, all at the centre of mass.
    assert made.mass_m == pytest.approx(0.0, abs=1e-9)
    assert np.sign(made.vertical_mps) == -sign
    path = np.arctan2(made.vertical_mps, made.horizontal_mps)
    assert path == pytest.approx(pitch + np.arctan2(w, u))
    assert np.hypot(made.vertical_mps, made.horizontal_mps) == pytest.approx(np.hypot(u, w))


def test_the_mass_balances_each_moment_by_itself():
    pitch = -np.radians(30.0)
    sin, cos = np.sin(pitch), np.cos(pitch)
    u, w = np.sqrt(-WEIGHT_N * sin / D_U), -np.sqrt(WEIGHT_N * cos / D_W)
    per_metre = CARRIED_KG * G * cos

    def mass_m(**changes):
        return glide.solve_glide(*build(**changes), WATER_M3, pitch).mass_m

    # Water ahead and above of the centre of mass: its weight along x and z has these levers.
    x, z = 0.05, -0.03
    assert mass_m(tank=(x, 0.0, z)) == pytest.approx(WEIGHT_N * (z * sin - x * cos) / per_metre)
    # Buoyancy above it rights it, with the bow down: the mass is forward.
    h = 0.005
    righting = mass_m(center_m=h)
    assert righting == pytest.approx(-h * MASS_KG * G * sin / per_metre)
    assert righting > 0
    # Munk's moment, (Z_wdot - X_udot) u w.
    assert mass_m(added=(A_U, A_W)) == pytest.approx(-(A_W - A_U) * u * w / per_metre, rel=1e-6)
    assert mass_m(products={"M_uw": -20.0}) == pytest.approx(20.0 * u * w / per_metre, rel=1e-6)


def test_products_of_velocities_are_forces_along_their_axes():
    pitch = -np.radians(30.0)
    made = glide.solve_glide(*build(products={"X_ww": 30.0, "Z_uw": -100.0}), WATER_M3, pitch)
    u, w = made.velocity_mps
    assert -D_U * abs(u) * u + 30.0 * w * w == pytest.approx(WEIGHT_N * np.sin(pitch), rel=1e-6)
    assert -D_W * abs(w) * w - 100.0 * u * w == pytest.approx(WEIGHT_N * np.cos(pitch), rel=1e-6)


def test_no_glide_leads_astern_or_without_a_tank():
    assert glide.solve_glide(*build(), WATER_M3, np.radians(30.0)) is None
    config, chosen = build()
    for part in ("ballast", "moving_masses"):
        lacking = config.model_copy(update={part: None})
        assert glide.solve_glide(lacking, chosen, WATER_M3, -0.5) is None
        assert glide.best_glide(lacking, chosen) is None


def test_speeds_over_ground_are_turned_by_the_pitch():
    pitch, speed = 0.6, 0.5
    up, level = ([np.sin(pitch), np.cos(pitch)], [np.cos(pitch), -np.sin(pitch)])
    for direction, expected in ((up, (0.0, speed)), (level, (speed, 0.0))):
        made = glide.Glide(pitch_rad=pitch, velocity_mps=speed * np.array(direction), mass_m=0.0)
        assert (made.horizontal_mps, made.vertical_mps) == pytest.approx(expected, abs=1e-12)


def test_the_best_glide_is_the_fastest_over_ground_of_all_pitches():
    config, chosen = build()
    down, up = glide.best_glide(config, chosen)
    # Speed over ground by drag alone, at full and empty tank; finer than the pitches looked at.
    weight = RHO * config.tanks[0].limit_m3 * G
    pitch = np.radians(np.linspace(5.0, 65.0, 2001))
    u, w = np.sqrt(weight * np.sin(pitch) / D_U), np.sqrt(weight * np.cos(pitch) / D_W)
    level = u * np.cos(pitch) - w * np.sin(pitch)
    assert down.horizontal_mps == pytest.approx(level.max(), rel=2e-3)
    assert up.horizontal_mps == pytest.approx(down.horizontal_mps)
    assert -down.pitch_rad == pytest.approx(up.pitch_rad)
    assert up.pitch_rad == pytest.approx(pitch[level.argmax()], abs=np.radians(1.3))
    assert glide.slower_mps(down, up) == min(down.horizontal_mps, up.horizontal_mps)


def test_the_mass_of_an_axis_is_the_one_with_the_greatest_moment():
    data = library.load_vehicle("seawing").model_dump(mode="json")["moving_masses"]["layout"]
    light, far = (copy.deepcopy(data[0]) for _ in range(2))
    light |= {"name": "light", "mass_kg": 2.0, "limit_m": 0.1}
    far |= {"name": "far", "mass_kg": 4.0, "limit_m": 0.2, "axis": [-1.0, 0.0, 0.0]}
    config, _ = build(masses=[light, far, data[1], data[0]])
    assert [getattr(glide.find_mass(config, axis), "name", None) for axis in range(3)] == [
        "far",
        "battery_y",
        None,
    ]
