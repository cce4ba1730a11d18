"""The shipped BlueROV2 Heavy, described as blue describes it, is imported back."""

import numpy as np
import pytest

from angler_mjx.robot.importing.import_vehicle import import_vehicle
from angler_mjx.robot.vehicles.drive import wrench_matrix
from angler_mjx.robot.vehicles.library import load_vehicle
from angler_mjx.robot.vehicles.properties import describe_vehicle

SHIPPED = load_vehicle("bluerov2_heavy")
PROPELLER_KG, PROPELLER_KGM2 = 0.002, 0.001


def describe():
    """A massless root, a hull, propellers on turned frames with angles of three digits, drag."""
    rows = []
    for i, row in enumerate(SHIPPED.thrusters.layout):
        x, y, z = row.direction
        # The propeller pushes against z of its frame: down, or turned twice about rounded angles.
        yaw = np.arctan2(-y, -x)
        rpy = "0 0 0" if z else f"0 1.571 {round(float(yaw), 3):g}"
        rows.append(
            f'<xacro:prop id="{i + 1}" sign="{row.spin}"><origin rpy="{rpy}" '
            f'xyz="{" ".join(map(str, row.position_m))}"/></xacro:prop>'
        )
    return HEAD + "\n".join(rows) + "</robot>"


HEAD = """<robot name="heavy" xmlns:xacro="http://ros.org/wiki/xacro">
<xacro:macro name="prop" params="id sign *origin">
  <link name="prop${id}"><inertial><mass value="0.002"/>
    <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"/></inertial></link>
  <joint name="prop${id}_joint" type="continuous"><xacro:insert_block name="origin"/>
    <parent link="hull"/><child link="prop${id}"/><axis xyz="0 0 -1"/></joint>
  <gazebo><plugin filename="gz-sim-thruster-system" name="gz::sim::systems::Thruster">
    <joint_name>prop${id}_joint</joint_name>
    <thrust_coefficient>${sign * 0.02}</thrust_coefficient></plugin></gazebo>
</xacro:macro>
<link name="root"/>
<joint name="root_joint" type="fixed"><parent link="root"/><child link="hull"/></joint>
<link name="hull"><inertial><origin xyz="0 0 0.011"/><mass value="13.0"/>
  <inertia ixx="0.26" ixy="0" ixz="0" iyy="0.23" iyz="0" izz="0.37"/></inertial>
  <collision><origin xyz="0 0 0.06"/><geometry><box size="0.457 0.575 0.05"/></geometry>
  </collision></link>
<gazebo><plugin filename="gz-sim-hydrodynamics-system" name="gz::sim::systems::Hydrodynamics">
  <link_name>root</link_name><xUabsU>-58.42</xUabsU><yVabsV>-55.137</yVabsV>
  <zWabsW>-124.818</zWabsW><kPabsP>-4</kPabsP><mQabsQ>-4</mQabsQ><nRabsR>-4</nRabsR>
</plugin></gazebo>
"""


@pytest.fixture(scope="module")
def heavy(tmp_path_factory):
    folder = tmp_path_factory.mktemp("heavy")
    (folder / "heavy.xacro").write_text(describe())
    made = import_vehicle(folder / "heavy.xacro", "t200")
    (folder / "heavy.toml").write_text(made.text)
    return load_vehicle(str(folder / "heavy.toml")), [str(note) for note in made.notes]


def test_thrusters_are_those_of_the_shipped_file(heavy):
    config, notes = heavy
    for made, row in zip(config.thrusters.layout, SHIPPED.thrusters.layout, strict=True):
        assert made.position_m == pytest.approx(row.position_m)
        assert made.direction == pytest.approx(row.direction, abs=1e-12)
        assert made.spin == row.spin
    assert sum("snapped: direction" in note for note in notes) == 4
    # Its text rounds the propellers away, which move the centre of mass by a hundredth of a mm.
    assert wrench_matrix(config) == pytest.approx(wrench_matrix(SHIPPED), abs=5e-5)


def test_numbers_are_those_of_the_shipped_set(heavy):
    made, shipped = heavy[0].find_set(None), SHIPPED.find_set("blue_gazebo")
    assert made.rigid_body.mass_kg == pytest.approx(shipped.rigid_body.mass_kg)
    assert made.buoyancy.volume_m3 == pytest.approx(shipped.buoyancy.volume_m3)
    offset = np.subtract(made.buoyancy.center_of_buoyancy_m, shipped.buoyancy.center_of_buoyancy_m)
    assert np.abs(offset).max() < 1e-4
    assert made.damping.quadratic == shipped.damping.quadratic
    assert np.all(np.array(made.added_mass.coefficients) == 0)
    # The shipped inertia is that of the base alone: propellers add their own and their distance.
    distance = [
        np.square(np.subtract(row.position_m, SHIPPED.base.center_of_mass_m))
        for row in SHIPPED.thrusters.layout
    ]
    for axis in range(3):
        about = sum(square.sum() - square[axis] for square in distance)
        more = 8 * PROPELLER_KGM2 + PROPELLER_KG * about
        assert made.rigid_body.inertia_kgm2[axis][axis] == pytest.approx(
            shipped.rigid_body.inertia_kgm2[axis][axis] + more, abs=1e-5
        )


def test_terminal_speeds_are_those_of_the_shipped_set(heavy):
    made = describe_vehicle(heavy[0], None, 16.0).terminal_speed_mps
    shipped = describe_vehicle(SHIPPED, "blue_gazebo", 16.0).terminal_speed_mps
    assert made == pytest.approx(shipped, rel=1e-4)
