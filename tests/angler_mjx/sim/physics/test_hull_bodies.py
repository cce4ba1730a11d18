"""Hulls of several bodies at the surface: restoring by waterplanes, in closed form."""

import tomllib
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from angler_mjx.errors import ConfigError
from angler_mjx.files import parse_model
from angler_mjx.robot.vehicles import library, params
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.sim.physics import step as physics
from angler_mjx.sim.physics.closed_form import ClosedForm
from angler_mjx.world.currents import Uniform

G, RHO = 9.81, 1000.0
SEA = physics.Water(density_kgpm3=RHO)
CLOSED = ClosedForm(gravity_mps2=G)
VOLUME, HEIGHT = 0.02, 0.3
X, Y = 0.6, 0.4
ONE = {"volume_m3": 4 * VOLUME, "center_m": [0.0, 0.0, 0.0], "height_m": HEIGHT}


def catamaran(**changes):
    """The tables of a vehicle of 40 kg with four floats, which float half."""
    text = library.locate_vehicle("bluerov2").read_text(encoding="utf-8")
    tables = tomllib.loads(text)
    name = tables["default_set"]
    chosen = tables["parameter_sets"][name]
    tables["parameter_sets"] = {name: chosen}
    chosen["rigid_body"] |= {"mass_kg": 40.0, "inertia_kgm2": [3.0, 6.0, 8.0]}
    chosen["added_mass"]["coefficients"] = [5.0, 20.0, 30.0, 2.0, 5.0, 4.0]
    chosen["damping"] |= {"linear": [9.0, 9.0, 1e-3, 1e-3, 1e-3, 1.0], "quadratic": [0.0] * 6}
    floats = [
        {"volume_m3": VOLUME, "center_m": [x, y, 0.0], "height_m": HEIGHT}
        for x in (-X, X)
        for y in (-Y, Y)
    ]
    chosen["buoyancy"] |= {
        "volume_m3": 4 * VOLUME,
        "center_of_buoyancy_m": [0.0, 0.0, 0.0],
        "bodies": floats,
    } | changes
    return tables


def build(tables):
    return params.build_vehicle(parse_model(VehicleConfig, tables, source="x.toml"), None, 16.0)


@pytest.fixture(scope="module")
def vehicle(x64):
    return build(catamaran())


@jax.jit
def bear(vehicle, p, q):
    """The wrench of still water on a vehicle at rest."""
    zero = jnp.zeros(3)
    return physics.base_wrench(vehicle, p, q, jnp.zeros(6), zero, zero, SEA)


def place(vehicle, z=0.0, rpy=(0.0, 0.0, 0.0)):
    q = Rotation.from_euler("xyz", rpy).as_quat(scalar_first=True)
    return np.asarray(bear(vehicle, jnp.array([0.0, 0.0, z]), jnp.asarray(q)))


def test_under_water_they_are_one_body(vehicle):
    whole = replace(vehicle, hull_bodies=None)
    for rpy in ((0.0, 0.0, 0.0), (0.4, -0.3, 1.0), (2.8, 1.2, 0.0)):
        np.testing.assert_allclose(
            place(vehicle, -2.0, rpy), place(whole, -2.0, rpy), rtol=0, atol=1e-10
        )
    np.testing.assert_array_equal(place(vehicle, 2.0), 0.0)


@pytest.mark.parametrize("angle", [0.01, 0.1, 0.3])
def test_roll_and_pitch_are_righted_by_the_waterplanes(vehicle, angle):
    # A float moves by y sin(phi), and bears rho g V / h more for each metre.
    stiffness = RHO * G * 4 * VOLUME / HEIGHT * np.sin(angle) * np.cos(angle)
    roll, pitch = place(vehicle, rpy=(angle, 0.0, 0.0)), place(vehicle, rpy=(0.0, angle, 0.0))
    if Y * np.sin(angle) < HEIGHT / 2:
        np.testing.assert_allclose(roll[3], -(Y**2) * stiffness, rtol=1e-9)
    if X * np.sin(angle) < HEIGHT / 2:
        np.testing.assert_allclose(pitch[4], -(X**2) * stiffness, rtol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(roll[:3]), RHO * G * 2 * VOLUME, rtol=1e-9)
    np.testing.assert_allclose(roll[4:], 0.0, atol=1e-9)


def test_a_float_in_the_air_bears_nothing(vehicle):
    # On its side: two floats at 0.4 m above the surface, two as far below it.
    wrench = place(vehicle, rpy=(np.pi / 2, 0.0, 0.0))
    np.testing.assert_allclose(np.linalg.norm(wrench[:3]), RHO * G * 2 * VOLUME, rtol=1e-9)
    np.testing.assert_allclose(wrench[3:], 0.0, atol=1e-6)  # they bear straight below
    wrench = place(vehicle, rpy=(1.2, 0.0, 0.0))
    lever = Y * np.cos(1.2)
    np.testing.assert_allclose(wrench[3], -RHO * G * 2 * VOLUME * lever, rtol=1e-9)


def test_one_body_has_no_waterplane(vehicle):
    whole = replace(vehicle, hull_bodies=None)
    np.testing.assert_allclose(place(whole, rpy=(0.1, 0.0, 0.0))[3], 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("axis", "inertia", "arm"), [(2, 40.0 + 30.0, 1.0), (3, 3.0 + 2.0, Y), (4, 6.0 + 5.0, X)]
)
def test_heave_roll_and_pitch_swing_with_their_period(vehicle, axis, inertia, arm):
    period_s = 2 * np.pi * np.sqrt(inertia / (RHO * G * 4 * VOLUME / HEIGHT * arm**2))
    dt = period_s / 400
    small = 1e-3
    p = jnp.array([0.0, 0.0, small if axis == 2 else 0.0])
    turn = np.zeros(3)
    if axis > 2:
        turn[axis - 3] = small
    q = jnp.asarray(Rotation.from_rotvec(turn).as_quat(scalar_first=True))
    current = (Uniform(velocity_mps=jnp.zeros(3)),)
    start = physics.reset(CLOSED, vehicle, vehicle, p, q, current, SEA)

    def one(state, _):
        after = physics.step(
            CLOSED, vehicle, vehicle, state, jnp.zeros(6), current, jnp.zeros(()), dt, SEA
        )
        return after, (after.p[2], after.q[1], after.q[2])

    _, motion = jax.lax.scan(one, start, length=400)
    swing = np.asarray(motion[axis - 2])
    # Half a period later it is on the other side, and after a whole one it is back.
    first = float(start.p[2] if axis == 2 else start.q[axis - 2])
    np.testing.assert_allclose(swing[199] / first, -1.0, atol=0.01)
    np.testing.assert_allclose(swing[-1] / first, 1.0, atol=0.01)


def test_other_vehicles_of_a_fleet_bear_as_before(vehicle):
    plain = params.build_vehicle(library.load_vehicle("bluerov2"), None, 16.0)
    fleet = params.stack_vehicles([plain, vehicle])
    members = [jax.tree.map(lambda leaf, i=i: leaf[i], fleet) for i in range(2)]
    for z in (-3.0, -0.02, 0.05):
        for rpy in ((0.0, 0.0, 0.0), (0.3, -0.2, 0.5)):
            np.testing.assert_array_equal(place(members[0], z, rpy), place(plain, z, rpy))
            np.testing.assert_array_equal(place(members[1], z, rpy), place(vehicle, z, rpy))
    alone = params.stack_vehicles([plain, plain])
    assert alone.hull_bodies is None


def test_varied_buoyancy_keeps_the_places_of_the_bodies(vehicle):
    config = parse_model(VehicleConfig, catamaran(), source="x.toml")
    chosen = config.find_set(None)
    moved = chosen.buoyancy.model_copy(
        update={"volume_m3": 0.1, "center_of_buoyancy_m": (0.1, 0.0, 0.02)}
    )
    changed = config.model_copy(
        update={
            "parameter_sets": {config.default_set: chosen.model_copy(update={"buoyancy": moved})}
        }
    )
    varied = params.build_vehicle(changed, None, 16.0)
    np.testing.assert_allclose(varied.hull_bodies.offset_m, vehicle.hull_bodies.offset_m)
    deep = place(varied, -3.0)
    np.testing.assert_allclose(deep, [0, 0, RHO * G * 0.1, 0, -RHO * G * 0.1 * 0.1, 0], atol=1e-9)


@pytest.mark.parametrize(
    ("changes", "parts"),
    [
        ({"volume_m3": 0.081}, ("bodies displace 0.08 m^3", "volume_m3 is 0.081")),
        (
            {"center_of_buoyancy_m": [0.0, 0.0, 0.01]},
            ("centre of the bodies is", "make them equal"),
        ),
        ({"bodies": [ONE | {"height_m": 0.0}]}, ("bodies", "height_m")),
        ({"bodies": [ONE | {"volume_m3": -1.0}]}, ("bodies", "volume_m3")),
    ],
)
def test_bodies_that_are_not_the_hull_are_refused(changes, parts):
    with pytest.raises(ConfigError) as raised:
        build(catamaran(**changes))
    assert all(part in str(raised.value) for part in parts)
