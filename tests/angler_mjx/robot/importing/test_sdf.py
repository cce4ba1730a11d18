"""SDF into vehicle files: frames, degrees, joints, added mass, includes, worlds, faults."""

import numpy as np
import pytest

from angler_mjx.errors import ConfigError

from .written import line_of

INERTIAL = """<inertial><mass>{mass}</mass><inertia><ixx>0.2</ixx><ixy>0</ixy><ixz>0</ixz>
  <iyy>0.25</iyy><iyz>0</iyz><izz>0.3</izz></inertia>{more}</inertial>"""

NOTHING = """<inertial><mass>0.001</mass><inertia><ixx>1e-6</ixx><ixy>0</ixy><ixz>0</ixz>
  <iyy>1e-6</iyy><iyz>0</iyz><izz>1e-6</izz></inertia></inertial>"""

BOX = """<collision name="hull"><geometry><box><size>0.4 0.3 0.1</size></box></geometry>
  </collision>"""


def model(*parts, mass=12.0, more="", pose="0 0 0 0 0 0", name="rov"):
    return f"""<model name="{name}"><link name="base_link"><pose>{pose}</pose>
      {INERTIAL.format(mass=mass, more=more)}{BOX}</link>{"".join(parts)}</model>"""


def thruster(n=1, pose="<pose>0.1 0 0 0 0 0</pose>", axis="<xyz>1 0 0</xyz>", more=""):
    return f"""
    <link name="prop_{n}">{pose}{NOTHING}</link>
    <joint name="prop_{n}_joint" type="revolute"><parent>base_link</parent><child>prop_{n}</child>
      <axis>{axis}</axis>{more}</joint>
    <plugin filename="gz-sim-thruster-system" name="gz::sim::systems::Thruster">
      <joint_name>prop_{n}_joint</joint_name>
      <thrust_coefficient>0.004</thrust_coefficient></plugin>"""


def sdf(*models, version="1.9"):
    return f'<?xml version="1.0"?>\n<sdf version="{version}">{"".join(models)}</sdf>\n'


def layout(made):
    return {row["name"]: row for row in made.table["thrusters"]["layout"]}


POSES = {
    "radians": ('<pose>0.1 0.2 0.3 0 -1.5707963267948966 0</pose>', [0.1, 0.2, 0.3], [0, 0, 1]),
    "degrees": ('<pose degrees="true">0.1 0 0 0 0 90</pose>', [0.1, 0, 0], [0, 1, 0]),
    "quaternion": (
        '<pose rotation_format="quat_xyzw">0 0 0.1 0 0 1 0</pose>', [0, 0, 0.1], [-1, 0, 0]
    ),
    "frame": ('<pose relative_to="tip">0.1 0 0 0 0 0</pose>', [0.5, 0.1, 0], [0, 1, 0]),
    "link": ('<pose relative_to="base_link">0 0.1 0 0 0 0</pose>', [0, 0.1, 0], [1, 0, 0]),
}  # fmt: skip
TIP = """<frame name="tip" attached_to="base_link"><pose relative_to="base_link">0.5 0 0
  0 0 1.5707963267948966</pose></frame>"""


@pytest.mark.parametrize("case", POSES)
def test_poses_of_all_kinds(bring, case):
    pose, position, direction = POSES[case]
    made = bring(sdf(model(thruster(pose=pose), TIP)), "rov.sdf")
    row = layout(made)["prop_1"]
    assert row["position_m"] == pytest.approx(position, abs=1e-9)
    assert row["direction"] == pytest.approx(direction, abs=1e-9)


def test_the_base_frame_is_that_of_the_root_link(bring):
    turned = "1 2 3 0 0 1.5707963267948966"
    made = bring(sdf(model(thruster(pose="<pose>1 2.1 3 0 0 0</pose>"), pose=turned)), "rov.sdf")
    row = layout(made)["prop_1"]
    # 0.1 m ahead of the link, which looks along y of the model; the thruster pushes along x there.
    assert row["position_m"] == pytest.approx([0.1, 0, 0], abs=1e-9)
    assert row["direction"] == pytest.approx([0, -1, 0], abs=1e-9)


@pytest.mark.parametrize(
    ("axis", "version", "direction"),
    [
        ("<xyz>0 1 0</xyz>", "1.9", [-1, 0, 0]),
        ('<xyz expressed_in="base_link">0 1 0</xyz>', "1.9", [0, 1, 0]),
        ('<xyz expressed_in="__model__">0 0 1</xyz>', "1.9", [0, 0, 1]),
        ("<xyz>0 1 0</xyz><use_parent_model_frame>1</use_parent_model_frame>", "1.6", [0, 1, 0]),
        ("<xyz>0 1 0</xyz>", "1.4", [0, 1, 0]),
    ],
)
def test_axes_are_in_their_frame(bring, axis, version, direction):
    pose = '<pose>0.1 0 0 0 0 1.5707963267948966</pose>'  # fmt: skip
    made = bring(sdf(model(thruster(pose=pose, axis=axis)), version=version), "rov.sdf")
    assert layout(made)["prop_1"]["direction"] == pytest.approx(direction, abs=1e-9)


def test_fluid_added_mass_is_positive_and_symmetric(bring):
    water = """<pose>0 0 -0.1 0 0 0</pose><fluid_added_mass><xx>5</xx><yy>9</yy><zz>13</zz>
      <pp>0.4</pp><qq>0.5</qq><rr>0.6</rr><xq>0.2</xq></fluid_added_mass>"""
    made = bring(sdf(model(thruster(), more=water)), "rov.sdf")
    added = np.array(made.numbers["added_mass"]["coefficients"])
    stated = np.diag([5, 9, 13, 0.4, 0.5, 0.6])
    stated[0, 4] = stated[4, 0] = 0.2
    center = np.array(made.table["base"]["center_of_mass_m"])
    velocity = np.array([0.3, -0.2, 0.5, 0.7, -0.4, 0.6])
    origin = np.concatenate([velocity[:3] + np.cross(velocity[3:], -center), velocity[3:]])
    assert velocity @ added @ velocity == pytest.approx(origin @ stated @ origin)
    assert made.noted("converted", "<fluid_added_mass>")


def test_added_mass_stands_in_one_of_link_and_plugin(bring):
    water = "<fluid_added_mass><xx>5</xx><yy>9</yy><zz>13</zz></fluid_added_mass>"
    plugin = """<plugin filename="gz-sim-hydrodynamics-system" name="h">
      <link_name>base_link</link_name><xU>-7</xU>{more}</plugin>"""
    made = bring(sdf(model(thruster(), plugin.format(more=""), more=water)), "rov.sdf")
    assert made.numbers["damping"]["linear"][0] == 7
    added = np.array(made.numbers["added_mass"]["coefficients"])
    assert np.diag(added)[:3] == pytest.approx([5, 9, 13])
    twice = plugin.format(more="<xDotU>-5</xDotU>")
    with pytest.raises(ConfigError, match="states added mass of 'base_link', and so does"):
        bring(sdf(model(thruster(), twice, more=water)), "rov.sdf")


def test_the_density_is_that_of_the_buoyancy_of_the_world(bring):
    world = f"""<sdf version="1.9"><world name="sea">
      <plugin filename="gz-sim-buoyancy-system" name="gz::sim::systems::Buoyancy">
      <uniform_fluid_density>1025</uniform_fluid_density></plugin>
      <light name="sun"/>{model(thruster())}
      <model name="rock"><static>true</static><link name="rock"/></model></world></sdf>"""
    made = bring(world, "sea.sdf")
    assert made.trim.density_kgpm3 == 1025
    assert made.trim.volume_m3 == pytest.approx(0.012)
    assert made.noted("dropped", "<light>")
    assert made.noted("dropped", "<model>")


def test_models_are_included_and_merged(bring):
    files = {
        "rov/model.sdf": sdf(model(thruster())),
        "rov/package.xml": "<package><name>rov</name></package>",
    }
    merged = sdf(
        '<model name="equipped"><include merge="true"><uri>rov</uri><pose degrees="true">'
        "0 0 5 0 0 90</pose></include><link name='lamp'><pose relative_to='base_link'>"
        f"0.2 0 0 0 0 0</pose>{INERTIAL.format(mass=4, more='')}</link>"
        "<joint name='j' type='fixed'><parent>base_link</parent><child>lamp</child></joint></model>"
    )
    made = bring(merged, "equipped.sdf", files=files)
    assert made.trim.mass_kg == pytest.approx(16.001)
    assert made.table["base"]["center_of_mass_m"][0] == pytest.approx(0.8 / 16, rel=1e-3)
    assert layout(made)["prop_1"]["position_m"] == pytest.approx([0.1, 0, 0], abs=1e-9)


def test_models_in_models_have_their_names_and_frames(bring):
    tray = f"""<model name="tray"><pose>0.2 0 0 0 0 1.5707963267948966</pose>
      <link name="plate"><pose>0.1 0 0 0 0 0</pose>{INERTIAL.format(mass=4, more="")}</link>
      <model name="cup"><pose>0 0 0.5 0 0 0</pose>
      <link name="base_link">{INERTIAL.format(mass=1, more="")}</link></model></model>
      <joint name="j" type="fixed"><parent>base_link</parent><child>tray::plate</child></joint>
      <joint name="k" type="fixed"><parent>base_link</parent><child>tray::cup::base_link</child>
      </joint>"""
    made = bring(sdf(model(thruster(), tray)), "rov.sdf")
    assert made.trim.mass_kg == pytest.approx(17.001)
    # The tray looks along y of the model: its plate is 0.1 m to the left of its origin.
    parts = [(4, np.array([0.2, 0.1, 0.0])), (1, np.array([0.2, 0.0, 0.5]))]
    parts.append((0.001, np.array([0.1, 0.0, 0.0])))
    center = sum(mass * point for mass, point in parts) / 17.001
    assert made.table["base"]["center_of_mass_m"] == pytest.approx(center)


def test_links_without_inertial_weigh_what_sdf_says(bring):
    bare = """<link name="tag"/><joint name="j" type="fixed"><parent>base_link</parent>
      <child>tag</child></joint>"""
    made = bring(sdf(model(thruster(), bare)), "rov.sdf")
    assert made.trim.mass_kg == pytest.approx(13.001)
    assert made.noted("assumed", "1 kg")


def test_fins_are_listed(bring):
    fin = f"""<link name="fin">{NOTHING}</link><joint name="fin_joint" type="revolute">
      <parent>base_link</parent><child>fin</child><axis><xyz>0 0 1</xyz>
      <limit><lower>-0.3</lower><upper>0.3</upper></limit></axis></joint>
      <plugin filename="gz-sim-lift-drag-system" name="gz::sim::systems::LiftDrag">
      <link_name>fin</link_name><area>0.02</area></plugin>"""
    made = bring(sdf(model(thruster(), fin)), "rov.sdf")
    assert "links" not in made.table
    assert made.noted("dropped", "lift and drag of a fin: it states no cla")
    assert made.noted("converted", "fin_joint")
    assert "fins" not in made.table


def test_fins_keep_lift_drag_and_limits(bring):
    fin = f"""<link name="fin"><pose>-0.5 0 0.1 0 0 0</pose>{NOTHING}</link>
      <joint name="fin_joint" type="revolute">
      <parent>base_link</parent><child>fin</child><axis><xyz>0 0 1</xyz>
      <limit><lower>-0.2</lower><upper>0.2</upper></limit></axis></joint>
      <plugin filename="gz-sim-lift-drag-system" name="gz::sim::systems::LiftDrag">
      <link_name>fin</link_name><area>0.02</area><a0>0</a0><cla>4.0</cla><cda>0.5</cda>
      <alpha_stall>0.25</alpha_stall><cp>0 0 0.05</cp>
      <forward>1 0 0</forward><upward>0 1 0</upward></plugin>"""
    made = bring(sdf(model(thruster(), fin)), "rov.sdf")
    (row,) = made.table["fins"]["layout"]
    assert row["position_m"] == pytest.approx([-0.5, 0, 0.15])
    # Lift at positive angles is to the left, so the foil turns right-handed about the way up.
    assert row["span"] == pytest.approx([0, 0, 1])
    assert (row["area_m2"], row["lift_slope_per_rad"]) == (0.02, 4.0)
    assert (row["limit_rad"], row["stall_rad"]) == (0.2, 0.25)
    # At the stall, C_L^2 / (pi e AR) is the file's 0.5 * 0.25.
    drag = (4.0 * 0.25) ** 2 / (np.pi * 0.9 * row["aspect_ratio"])
    assert drag == pytest.approx(0.125, rel=1e-5)
    assert made.noted("assumed", "do not push in sway, heave")


def test_a_fin_without_drag_has_that_of_an_aspect_ratio_of_three(bring):
    fin = f"""<link name="fin">{NOTHING}</link><joint name="fin_joint" type="fixed">
      <parent>base_link</parent><child>fin</child></joint>
      <plugin filename="gz-sim-lift-drag-system" name="gz::sim::systems::LiftDrag">
      <link_name>fin</link_name><area>0.02</area><cla>4.0</cla></plugin>"""
    made = bring(sdf(model(thruster(), fin)), "rov.sdf")
    (row,) = made.table["fins"]["layout"]
    assert row["aspect_ratio"] == pytest.approx(3.0)
    assert (row["limit_rad"], row["stall_rad"]) == (0.0, 0.3)
    # Gazebo's upward is z: positive angles of attack lift, about the way to the right.
    assert row["span"] == pytest.approx([0, -1, 0])
    assert made.noted("converted", "fin fin: drag assumed")


FAULTS = {
    "no model": (sdf(), "holds no <model>"),
    "two models": (sdf(model(thruster()), model(thruster(), name="b")), "2 models"),
    "frame": (sdf(model(thruster(pose='<pose relative_to="x">0 0 0 0 0 0</pose>'))), "frame 'x'"),
    "frame cycle": (
        sdf(model(thruster(pose='<pose relative_to="prop_1">0 0 0 0 0 0</pose>'))),
        "in a loop",
    ),
    "pose": (sdf(model(thruster(pose="<pose>1 2 3</pose>"))), "write 6 numbers"),
    "auto": (sdf(model(thruster())).replace("<inertial>", '<inertial auto="true">', 1), "auto"),
    "child": (sdf(model(thruster())).replace("<child>prop_1", "<child>prop_9"), "prop_9"),
    "joint": (sdf(model(thruster())).replace("_name>prop_1", "_name>prop_7"), "prop_7"),
    "include": (sdf('<model name="a"><include><uri>gone</uri></include></model>'), "'gone'"),
    "box": (sdf(model(thruster())).replace("<size>0.4 0.3 0.1</size>", ""), "lacks its size"),
    "flat": (sdf(model(thruster())).replace("0.4 0.3 0.1", "0.4 0.3 0"), "must be positive"),
    "mass": (sdf(model(thruster(), mass=-1)), "mass = -1"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_one_message(bring, fault):
    text, part = FAULTS[fault]
    with pytest.raises(ConfigError) as error:
        bring(text, "rov.sdf")
    assert part in str(error.value)
    assert "rov.sdf:" in str(error.value)
    assert "\n" not in str(error.value)


def test_unknown_keys_are_listed(bring):
    text = sdf(
        model(thruster(), "\n<gravity>1</gravity>\n<battery name='b'><volt>3</volt></battery>")
    )
    made = bring(text, "rov.sdf")
    assert made.noted("dropped", "<gravity> = '1'", f"rov.sdf:{line_of(text, '<gravity>')}]")
    assert made.noted("dropped", "<battery>")
