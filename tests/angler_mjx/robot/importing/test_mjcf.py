"""MJCF into vehicle files: thrusters at sites, buoyancy, arms, our exported files, faults."""

import mujoco
import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.robot.importing.import_vehicle import import_vehicle
from angler_mjx.robot.vehicles.drive import wrench_matrix
from angler_mjx.robot.vehicles.library import load_vehicle
from angler_mjx.robot.vehicles.mjcf import to_xml

from .written import line_of

FILE = """<mujoco model="seal">
  <compiler angle="degree"/>
  <option density="1025" viscosity="0.001" timestep="0.005"/>
  <default><default class="prop">
    <general gear="0 0 2 0 0 0" ctrlrange="-10 20"/>
  </default></default>
  <worldbody>
    <light pos="0 0 3"/>
    <body name="seal" gravcomp="1.05" pos="0 0 2" euler="0 0 90">
      <freejoint/>
      <inertial pos="0 0 -0.02" mass="12" diaginertia="0.2 0.25 0.3"/>
      <geom name="hull" type="box" size="0.2 0.15 0.05" friction="1 0 0"/>
      <site name="t1" pos="0.1 0.1 0"/>
      <site name="t2" pos="-0.1 0.1 0" euler="0 90 0"/>
      <body name="lead" pos="0.4 0 0">
        <geom type="sphere" size="0.02" mass="4"/>
      </body>
      <body name="fore" pos="0.2 0 0">
        <joint name="elbow" axis="0 1 0" range="-30 60" damping="0.1" actuatorfrcrange="-8 8"/>
        <inertial pos="0.1 0 0" mass="0.5" diaginertia="0.0003 0.002 0.002"/>
        <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.02"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <general name="first" class="prop" site="t1" gear="-1 0 0 0 0 0.01"/>
    <general name="second" class="prop" site="t2" dyntype="filter" dynprm="0.08"/>
    <position name="arm" joint="elbow" kp="4"/>
  </actuator>
</mujoco>
"""


@pytest.fixture
def seal(bring):
    return lambda text=FILE, **options: bring(text, "seal.xml", **options)


def test_bodies_and_thrusters(seal):
    made = seal()
    assert made.trim.mass_kg == pytest.approx(16.5)
    center = (12 * np.array([0, 0, -0.02]) + 4 * np.array([0.4, 0, 0])) / 16
    assert made.table["base"]["center_of_mass_m"] == pytest.approx(center)
    first, second = made.table["thrusters"]["layout"]
    assert first["direction"] == pytest.approx([-1, 0, 0], abs=1e-9)
    assert first["position_m"] == pytest.approx([0.1, 0.1, 0])
    # The default pushes along z of the site, which 90 degrees about y turn to x.
    assert second["direction"] == pytest.approx([1, 0, 0], abs=1e-9)
    assert made.table["rotor"]["lag"]["time_constant_s"] == 0.08
    assert made.noted("converted", "-10 N, 20 N")
    # The control of -10 to 20 times the gear, 1 of the first and 2 of the second.
    limited = [row["curve"]["thrust_n"] for row in (first, second)]
    assert [(min(row), max(row)) for row in limited] == [(-10.0, 20.0), (-20.0, 40.0)]
    assert made.noted("converted", "-20 N, 40 N")
    assert made.noted("dropped", "reaction torque")


def test_masses_by_mujoco_are_listed_with_their_bodies(seal):
    (note,) = seal().noted("converted", "bodies without <inertial>")
    assert note.endswith(f"seal.xml:{line_of(FILE, 'name="lead"')}]")
    assert note.count("seal.xml") == 1


@pytest.mark.parametrize(
    ("more", "direction", "ends"),
    [
        ('forcerange="-4 6"', [-1, 0, 0], (-4.0, 6.0)),
        ('forcerange="-40 6"', [-1, 0, 0], (-10.0, 6.0)),
        # The force is the gain times the control, and the gear turns it: -0.5 of -10 to 20.
        ('gainprm="-0.5"', [1, 0, 0], (-5.0, 10.0)),
        ('gainprm="-0.5" forcerange="-4 3"', [1, 0, 0], (-3.0, 4.0)),
    ],
)
def test_gain_and_limits_of_force_count(seal, more, direction, ends):
    made = seal(FILE.replace('gear="-1 0 0 0 0 0.01"', f'gear="-1 0 0 0 0 0" {more}'))
    first, _ = made.table["thrusters"]["layout"]
    assert first["direction"] == pytest.approx(direction, abs=1e-9)
    thrust = first["curve"]["thrust_n"]
    assert (thrust[0], thrust[-1]) == ends
    assert made.noted("converted", f"{ends[0]:g} N, {ends[1]:g} N")


def test_forces_of_actuators_are_those_of_mujoco(seal):
    """Force along x of the body at the ends of the control, as MuJoCo itself makes it."""
    text = FILE.replace(
        'gear="-1 0 0 0 0 0.01"', 'gear="-2 0 0 0 0 0" gainprm="-0.5" forcerange="-4 3"'
    )
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    forces = []
    for control in (-10.0, 20.0):
        data.ctrl[0] = control
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fwdActuation(model, data)
        turned = data.xmat[1].reshape(3, 3).T @ data.qfrc_actuator[:3]
        forces.append(turned[0])
    first, _ = seal(text).table["thrusters"]["layout"]
    assert first["direction"] == pytest.approx([1, 0, 0], abs=1e-9)
    assert (first["curve"]["thrust_n"][0], first["curve"]["thrust_n"][-1]) == pytest.approx(forces)


def test_gravity_compensation_is_buoyancy(seal):
    made = seal()
    assert made.trim.density_kgpm3 == 1025
    volume = made.numbers["buoyancy"]["volume_m3"]
    assert volume * 1025 == pytest.approx(1.05 * 12)
    assert made.noted("converted", "gravcomp", f"seal.xml:{line_of(FILE, 'gravcomp')}]")


def test_a_hinge_with_limits_is_an_arm(seal):
    made = seal()
    (link,), (joint,) = made.table["links"], made.table["joints"]
    assert link["position_m"] == pytest.approx([0.2, 0, 0])
    assert joint["axis"] == [0, 1, 0]
    assert np.degrees([joint["lower"], joint["upper"]]) == pytest.approx([-30, 60])
    assert joint["actuator"]["max_effort"] == 8
    (cylinder,) = link["water"]["cylinders"]
    assert cylinder["radius_m"] == pytest.approx(0.02)
    ends = sorted([cylinder["from_m"][0], cylinder["to_m"][0]])
    assert ends == pytest.approx([-0.02, 0.22])


def test_what_is_not_taken_over_is_listed_by_name(seal):
    made = seal()
    assert made.noted("dropped", "fluid forces")
    assert made.noted("dropped", "<light>", f"seal.xml:{line_of(FILE, '<light')}]")
    assert made.noted("dropped", "attribute friction")
    assert made.noted("dropped", "attribute timestep")
    assert made.noted("dropped", "attribute viscosity")
    assert made.noted("dropped", "actuator arm")
    assert made.noted("assumed", "added mass")


@pytest.mark.parametrize("name", ["bluerov2", "bluerov2_heavy"])
def test_a_vehicle_that_we_exported_comes_back(name, tmp_path):
    shipped = load_vehicle(name)
    path = tmp_path / "rov.xml"
    path.write_text(to_xml(shipped, None))
    (tmp_path / "rov.toml").write_text(import_vehicle(path, "t200").text)
    made = load_vehicle(str(tmp_path / "rov.toml"))
    body, again = shipped.find_set(None).rigid_body, made.find_set(None).rigid_body
    assert again.mass_kg == pytest.approx(body.mass_kg)
    assert np.array(again.inertia_kgm2) == pytest.approx(np.array(body.inertia_kgm2), abs=1e-6)
    assert wrench_matrix(made) == pytest.approx(wrench_matrix(shipped), abs=1e-6)


def test_air_is_no_water(seal):
    made = seal(FILE.replace('density="1025"', 'density="1.2"'))
    assert made.trim.density_kgpm3 == 1000
    assert made.noted("dropped", "density 1.2")


FAULTS = {
    "syntax": (lambda t: t.replace('mass="12"', 'mass="twelve"'), "MuJoCo cannot compile"),
    "nan": (lambda t: t.replace('mass="12"', 'mass="nan"'), "finite"),
    "no base": (lambda t: t.replace("<freejoint/>", ""), "0 bodies have a free joint"),
    "axis": (lambda t: t.replace("-1 0 0 0 0 0.01", "0 0 0 0 0 1"), "along no axis"),
    "site": (lambda t: t.replace('site="t1"', 'site="t9"'), "t9"),
    "limits": (lambda t: t.replace(' range="-30 60"', ""), "has no limits"),
    "two joints": (
        lambda t: t.replace('<joint name="elbow"', '<joint axis="1 0 0"/><joint name="elbow"'),
        "2 joints",
    ),
    "mesh": (
        lambda t: t.replace("<worldbody>", '<asset><mesh file="m.stl"/></asset><worldbody>'),
        "m.stl",
    ),
    "outside": (
        lambda t: t.replace("<worldbody>", '<include file="/etc/passwd"/><worldbody>'),
        "lies outside",
    ),
    "cycle": (lambda t: t.replace("<worldbody>", '<include file="seal.xml"/><worldbody>'), "cycle"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_one_message(seal, fault):
    change, part = FAULTS[fault]
    with pytest.raises(ConfigError) as error:
        seal(change(FILE))
    assert part in str(error.value)
    assert "seal.xml" in str(error.value)
    assert "\n" not in str(error.value)
