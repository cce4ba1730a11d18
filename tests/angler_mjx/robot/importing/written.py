"""Files of vehicles as others write them, in small."""

LINK = """
  <link name="base_link">
    <inertial>
      <mass value="{mass}"/>
      <inertia ixx="0.2" ixy="0" ixz="0" iyy="0.25" iyz="0" izz="0.3"/>
    </inertial>
    <collision><geometry><box size="0.4 0.3 0.1"/></geometry></collision>
  </link>
"""

THRUSTER = """
  <link name="thruster_{n}"/>
  <joint name="thruster_{n}_joint" type="{type}">
    <parent link="base_link"/> <child link="thruster_{n}"/>
    <origin xyz="{xyz}" rpy="{rpy}"/>
    <axis xyz="{axis}"/>
  </joint>
"""


def thruster(n=1, type="continuous", xyz="0.1 0 0", rpy="0 0 0", axis="1 0 0"):
    return THRUSTER.format(n=n, type=type, xyz=xyz, rpy=rpy, axis=axis)


def robot(*parts, mass=12.0, name="rov"):
    """A URDF file of a box with one thruster and further parts."""
    body = LINK.format(mass=mass) + thruster() + "".join(parts)
    return f'<?xml version="1.0"?>\n<robot name="{name}">{body}</robot>\n'


def hydrodynamics(link="base_link", **numbers):
    rows = "".join(f"\n      <{key}>{value}</{key}>" for key, value in numbers.items())
    return f"""
  <gazebo>
    <plugin filename="gz-sim-hydrodynamics-system" name="gz::sim::systems::Hydrodynamics">
      <link_name>{link}</link_name>{rows}
    </plugin>
  </gazebo>
"""


def line_of(text, part):
    """Number of the line that holds a part first."""
    return text[: text.index(part)].count("\n") + 1
