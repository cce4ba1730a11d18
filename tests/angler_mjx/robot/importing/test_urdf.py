"""URDF into vehicle files: weights, directions of thrusters, the list, refused files."""

import re
import struct

import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.robot.importing.import_vehicle import import_vehicle
from angler_mjx.robot.vehicles.damping import damping_wrench
from angler_mjx.robot.vehicles.library import load_thruster, load_vehicle
from angler_mjx.robot.vehicles.params import build_vehicle
from angler_mjx.robot.vehicles.thrusters import PWM_GRID_US, tables_at

from .written import hydrodynamics, line_of, robot, thruster

FULL = {
    "xDotU": -5, "yDotV": -9, "zDotW": -13, "kDotP": -0.1, "mDotQ": -0.2, "nDotR": -0.3,
    "xU": -4, "yV": -6, "zW": -5, "kP": -0.1, "mQ": -0.1, "nR": -0.1,
    "xUabsU": -30, "yVabsV": -50, "zWabsW": -80, "kPabsP": -1, "mQabsQ": -1, "nRabsR": -1,
}  # fmt: skip


def test_links_on_fixed_joints_weigh_as_one_body(bring):
    weight = """
      <link name="tray"><inertial><origin xyz="0 0 -0.1"/><mass value="4"/>
        <inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial></link>
      <joint name="tray_joint" type="fixed"><parent link="base_link"/><child link="tray"/>
        <origin xyz="0.3 0 0" rpy="0 1.5707963267948966 0"/></joint>"""
    made = bring(robot(weight))
    # The tray's mass hangs 0.1 m along its own -z, which points along -x of the base.
    center = 4 * np.array([0.2, 0, 0]) / 16
    assert made.table["base"]["center_of_mass_m"] == pytest.approx(center)
    assert made.numbers["rigid_body"]["mass_kg"] == 16
    # Two points 0.2 m apart have the reduced mass 3 kg: 3 * 0.04 about y and z.
    assert made.numbers["rigid_body"]["inertia_kgm2"] == pytest.approx([0.2, 0.37, 0.42])


def test_a_turned_inertia_follows_its_origin(bring):
    text = robot().replace("<inertial>", '<inertial><origin rpy="0 0 1.5707963267948966"/>')
    made = bring(text)
    assert made.numbers["rigid_body"]["inertia_kgm2"] == pytest.approx([0.25, 0.2, 0.3])


def test_a_massless_root_may_carry_the_water(bring):
    root = """<link name="base_footprint"/>
      <joint name="foot" type="fixed"><parent link="base_footprint"/><child link="base_link"/>
      <origin xyz="0 0 0.25"/></joint>"""
    made = bring(robot(root, hydrodynamics("base_footprint", **FULL)))
    assert made.table["base"]["center_of_mass_m"] == pytest.approx([0, 0, 0.25])
    added = np.array(made.numbers["added_mass"]["coefficients"])
    # Turning about the centre of mass moves the origin, 0.25 m below it.
    assert added[3, 3] == pytest.approx(0.1 + 9 * 0.25**2)
    assert added[4, 4] == pytest.approx(0.2 + 5 * 0.25**2)
    # Kinetic energy of the water at any velocity is that at the origin of the plugin's link.
    velocity = np.array([0.3, -0.2, 0.5, 0.7, -0.4, 0.6])
    origin = velocity[:3] + np.cross(velocity[3:], [0, 0, -0.25])
    energy = np.array([5, 9, 13, 0.1, 0.2, 0.3]) @ np.concatenate([origin, velocity[3:]]) ** 2
    assert velocity @ added @ velocity == pytest.approx(energy)
    assert made.noted("converted", "moved from the origin of base_footprint")
    assert made.noted("assumed", "damping acts at the centre of mass")


def test_a_vehicle_that_rests_tilted_is_listed(bring):
    """6 kg 0.1 m ahead of a neutral box of 12 kg hang its nose down."""
    weight = """
      <link name="camera"><inertial><mass value="6"/></inertial></link>
      <joint name="mount" type="fixed"><parent link="base_link"/><child link="camera"/>
        <origin xyz="0.1 0 -0.1"/></joint>"""
    made = bring(robot(weight))
    ahead, below = 0.1 * 6 / 18, 0.1 * 6 / 18  # of the centre of mass, from that of the box
    pitch = np.degrees(np.arctan2(ahead, below))
    assert made.noted("assumed", f"a roll of 0 and a pitch of {pitch:.0f} degrees")
    assert not bring(robot(weight.replace("0.1 0 -0.1", "0 0 -0.1"))).noted("assumed", "a roll of")


def test_visuals_have_the_colours_of_their_materials(bring):
    shape = "<visual><geometry><sphere radius='0.1'/></geometry>{}</visual>"
    texts = (
        "<material name='red'><color rgba='1 0 0 1'/></material>",
        "<material name='red'/>",
        "<material name='blue'/>",
        "",
    )
    link = f"<link name='balls'>{''.join(shape.format(text) for text in texts)}</link>"
    joint = (
        """<joint name="fix" type="fixed"><parent link="base_link"/><child link="balls"/></joint>"""
    )
    blue = '<material name="blue"><color rgba="0 0 1 0.5"/></material>'
    made = bring(robot(link, joint, blue))
    colors = [tuple(shape["rgba"]) for shape in made.table["visual"]["shapes"]]
    assert colors == [(1, 0, 0, 1), (1, 0, 0, 1), (0, 0, 1, 0.5), (0.5, 0.55, 0.6, 1)]
    assert not made.noted("dropped", "material")


def test_visuals_below_a_millimetre_are_listed(bring):
    shape = "<visual><geometry><sphere radius='{}'/></geometry></visual>"
    radii = (0.0005, 0.1, 0.002)
    link = f"<link name='balls'>{''.join(map(shape.format, radii))}</link>"
    joint = (
        """<joint name="f" type="fixed"><parent link="base_link"/><child link="balls"/></joint>"""
    )
    made = bring(robot(link, joint))
    assert [ball["radius_m"] for ball in made.table["visual"]["shapes"]] == [0.1, 0.002]
    assert len(made.noted("dropped", "visual shapes below 1 mm")) == 1


def test_visual_boxes_lie_along_the_axes(bring):
    box = "<visual><origin rpy='{}'/><geometry><box size='0.1 0.2 0.3'/></geometry></visual>"
    turns = ("0 0 0", "0 0 1.5707963267948966", "0.3 0 0", "0 0.01 0")
    link = f"<link name='boxes'>{''.join(map(box.format, turns))}</link>"
    joint = (
        """<joint name="f" type="fixed"><parent link="base_link"/><child link="boxes"/></joint>"""
    )
    made = bring(robot(link, joint))
    sizes = [shape["size_m"] for shape in made.table["visual"]["shapes"]]
    # The last is turned by half a degree: its edges differ from the axes by 5e-5.
    np.testing.assert_allclose(sizes, [[0.1, 0.2, 0.3], [0.2, 0.1, 0.3], [0.1, 0.2, 0.3]])
    assert len(made.noted("dropped", "visual boxes that are turned")) == 1


def test_a_hull_without_shapes_is_a_ball_of_its_weight(bring):
    text = robot().replace('<box size="0.4 0.3 0.1"/>', '<sphere radius="0.0001"/>')
    made = bring(text, density=1025.0)
    (ball,) = made.table["hull"]["capsules"]
    assert 4 / 3 * np.pi * ball["radius_m"] ** 3 * 1025.0 == pytest.approx(12.0)
    assert made.noted("assumed", "no collision shape is read", "a ball of 0.141 m")
    assert made.noted("dropped", "collision shapes below 1 mm")


def test_links_without_mass_add_nothing(bring):
    joint = """<joint name="{0}" type="fixed"><parent link="base_link"/><child link="{0}"/>
      <origin xyz="1 0 0"/></joint>"""
    heavy = """<link name="sticker"><inertial><mass value="0"/>
      <inertia ixx="5" ixy="0" ixz="0" iyy="5" iyz="0" izz="5"/></inertial></link>"""
    made = bring(robot(heavy, "<link name='frame'/>", *map(joint.format, ("sticker", "frame"))))
    alone = bring(robot())
    assert made.numbers["rigid_body"] | {"source": ""} == alone.numbers["rigid_body"] | {
        "source": ""
    }
    assert made.table["base"]["center_of_mass_m"] == [0, 0, 0]
    assert made.noted("dropped", "inertia of link sticker, which has no mass")
    assert made.noted("converted", "links without mass: frames only")
    assert not alone.noted("dropped", "inertia of link")


def test_derivatives_of_gazebo_become_positive(bring):
    made = bring(robot(hydrodynamics(**FULL)))
    assert made.numbers["added_mass"]["coefficients"] == [5, 9, 13, 0.1, 0.2, 0.3]
    assert made.numbers["damping"]["linear"] == [4, 6, 5, 0.1, 0.1, 0.1]
    assert made.numbers["damping"]["quadratic"] == [30, 50, 80, 1, 1, 1]
    assert made.noted("converted", "negated")


def test_cross_terms_and_signs_are_listed_by_name(bring):
    text = robot(hydrodynamics(**FULL, xVabsU=-3, yR=-2, xDotQ=-0.1, mDotU=-0.1, zWW=-2))
    text = text.replace("<xU>-4<", "<xU>4<")
    made = bring(text)
    assert made.noted("dropped", "<xVabsU> = -3", f"rov.urdf:{line_of(text, '<xVabsU>')}")
    # Its symmetric part with yV = -6 and nR = -0.1 is not definite.
    assert made.noted("dropped", "linear damping <yR>", "still water would drive")
    assert made.noted("assumed", "<xU> = 4 is positive")
    assert made.noted("converted", "<zWW> = -2 has no absolute value")
    assert made.numbers["damping"]["linear"][0] == 4
    assert made.numbers["damping"]["quadratic"][2] == 82
    assert made.numbers["added_mass"]["coefficients"][0][4] == 0.1


MIXED = {
    "xV": -0.5,
    "nV": 0.3,
    "xVabsV": -3,
    "nVabsV": 2,
    "yUV": -7,
    "yVU": -2,
    "mUW": 4,
    "zQQ": 1.5,
}


def test_cross_terms_of_gazebo_make_the_same_force(bring, tmp_path):
    """Force i is the sum of lin_ij v_j, abs_ijk v_j |v_k| and quad_ijk v_j v_k."""
    bring(robot(hydrodynamics(**FULL, **MIXED)))
    made = import_vehicle(tmp_path / "rov.urdf", "t200")
    (tmp_path / "made.toml").write_text(made.text)
    params = build_vehicle(load_vehicle(str(tmp_path / "made.toml")), None, 16.0)
    rng = np.random.default_rng(0)
    for nu in rng.uniform(-2, 2, (20, 6)):
        force = np.zeros(6)
        for key, value in (FULL | MIXED).items():
            if "Dot" in key:
                continue
            first, *rest = [nu["UVWPQR".index(letter)] for letter in key[1:] if letter.isupper()]
            factor = first * (abs(rest[0]) if "abs" in key else rest[0]) if rest else first
            force["xyzkmn".index(key[0])] += value * factor
        np.testing.assert_allclose(damping_wrench(params, nu), force, rtol=2e-5, atol=1e-4)


def test_products_of_a_turned_link_are_dropped(bring):
    root = """<link name="water"/>
      <joint name="fix" type="fixed"><parent link="base_link"/><child link="water"/>
      <origin rpy="0 0 1.5707963267948966"/></joint>"""
    made = bring(robot(root, hydrodynamics("water", **FULL, yUV=-7)))
    assert made.noted("dropped", "Y_uv = -7", "turned")
    assert "products" not in made.numbers["damping"]


def test_what_the_plugin_leaves_out_is_named(bring):
    made = bring(robot(hydrodynamics(xUabsU=-30, xU=-1)))
    assert made.noted("assumed", "yDotV")
    assert made.noted("assumed", "quadratic damping in sway, heave, roll, pitch, yaw")
    assert made.numbers["damping"]["quadratic"][0] == 30
    # Half rho A of the box, 0.4 x 0.1 m from the side; capsules make it no smaller.
    assert made.numbers["damping"]["quadratic"][1] == pytest.approx(20, rel=0.2)


def test_a_ball_without_water_has_half_its_displaced_mass(bring):
    text = robot().replace('<box size="0.4 0.3 0.1"/>', '<sphere radius="0.142"/>')
    made = bring(text)
    volume = 4 / 3 * np.pi * 0.142**3
    assert made.numbers["buoyancy"]["volume_m3"] == pytest.approx(volume)
    added = made.numbers["added_mass"]["coefficients"]
    assert added == pytest.approx([500 * volume] * 3 + [0] * 3, rel=0.02, abs=1e-3)
    assert made.noted("assumed", "added mass: that of an ellipsoid")


@pytest.mark.parametrize(
    ("rpy", "axis", "direction", "is_snapped"),
    [
        ("0 0 0.785", "1 0 0", [0.5**0.5, 0.5**0.5, 0], True),
        ("0 1.571 0", "1 0 0", [0, 0, -1], True),
        ("0 0 0.7853981633974483", "0 2 0", [-(0.5**0.5), 0.5**0.5, 0], False),
        ("0 0 0.8", "1 0 0", [np.cos(0.8), np.sin(0.8), 0], False),
    ],
)
def test_directions_are_snapped_where_angles_were_rounded(bring, rpy, axis, direction, is_snapped):
    made = bring(robot(thruster(2, rpy=rpy, axis=axis)))
    layout = {row["name"]: row for row in made.table["thrusters"]["layout"]}
    assert layout["thruster_2"]["direction"] == pytest.approx(direction, abs=1e-12)
    assert bool(made.noted("snapped", "thruster_2")) is is_snapped


def test_a_fixed_thruster_pushes_along_x_of_its_link(bring):
    made = bring(robot(thruster(2, type="fixed", rpy="0 -1.5707963267948966 0")))
    assert made.table["thrusters"]["layout"][1]["direction"] == pytest.approx([0, 0, 1], abs=1e-12)
    assert made.noted("assumed", "x axis of their link")


def test_thrusters_of_plugins_have_spin_and_limits(bring):
    plugin = """<gazebo><plugin filename="gz-sim-thruster-system" name="gz::sim::systems::Thruster">
      <joint_name>thruster_1_joint</joint_name><thrust_coefficient>-0.02</thrust_coefficient>
      <max_thrust_cmd>900</max_thrust_cmd></plugin></gazebo>"""
    made = bring(robot(thruster(2), plugin))
    (row,) = made.table["thrusters"]["layout"]
    assert row["spin"] == -1
    assert made.noted("dropped", "900 N", "t200")
    assert made.noted("dropped", "thruster_2_joint", "no plugin")
    limits = "<max_thrust_cmd>20</max_thrust_cmd><min_thrust_cmd>-6</min_thrust_cmd>"
    cut = bring(robot(plugin.replace("<max_thrust_cmd>900</max_thrust_cmd>", limits)))
    (row,) = cut.table["thrusters"]["layout"]
    thrust_n, _ = tables_at(load_thruster("t200"), 16.0)
    expected = np.clip(np.interp(row["curve"]["pwm_us"], PWM_GRID_US, thrust_n), -6.0, 20.0)
    assert row["curve"]["thrust_n"] == pytest.approx(expected, abs=1e-4)
    assert cut.noted("converted", "-6 N, 20 N")


def test_unknown_elements_and_attributes_are_listed_with_their_lines(bring):
    text = robot("\n<sonar range='9'/>", hydrodynamics(**FULL, wobble=3))
    text = text.replace('<mass value="12.0"/>', '<mass value="12.0" unit="kg"/>')
    made = bring(text)
    assert made.noted("dropped", "<sonar>", f"rov.urdf:{line_of(text, '<sonar')}]")
    assert made.noted("dropped", "<wobble> = '3'")
    assert made.noted("dropped", "attribute unit = 'kg' of <mass>")


def test_a_mesh_is_the_box_around_it(bring, tmp_path):
    corners = np.array([[0, 0, 0], [2, 0, 0], [0, 1, 0.5]], np.float32)
    record = np.zeros(3, np.float32).tobytes() + corners.tobytes() + b"\0\0"
    (tmp_path / "hull.stl").write_bytes(b" " * 80 + struct.pack("<I", 1) + record)
    mesh = '<mesh filename="hull.stl" scale="0.2 0.3 0.4"/>'
    made = bring(robot().replace('<box size="0.4 0.3 0.1"/>', mesh))
    # 0.4 x 0.3 x 0.2 m about (0.2, 0.15, 0.1): 24 l, twice the weight, so the vehicle is neutral.
    assert made.numbers["buoyancy"]["volume_m3"] == pytest.approx(0.012)
    center = made.numbers["buoyancy"]["center_of_buoyancy_m"]
    assert center == pytest.approx([0.2, 0.15, 0.1])
    assert made.noted("converted", "hull.stl")
    assert made.noted("assumed", "2 times the weight")


def test_the_hull_covers_its_box(bring):
    made = bring(robot())
    capsules = made.table["hull"]["capsules"]
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (500, 3)) * [0.2, 0.15, 0.05]
    points = points[np.max(np.abs(points / [0.2, 0.15, 0.05]), axis=1) < 0.75]
    for point in points:
        assert min(_distance(point, capsule) for capsule in capsules) < 0.01
    for capsule in capsules:
        ends = np.abs([capsule["from_m"], capsule["to_m"]]) + capsule["radius_m"]
        assert np.all(ends <= np.array([0.2, 0.15, 0.05]) + 1e-9)


def _distance(point, capsule):
    a, b = np.array(capsule["from_m"]), np.array(capsule["to_m"])
    t = np.clip((point - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return np.linalg.norm(point - a - t * (b - a)) - capsule["radius_m"]


def test_joints_with_limits_become_an_arm(bring):
    arm = """
      <link name="upper"><inertial><origin xyz="0 0 -0.1"/><mass value="0.5"/>
        <inertia ixx="0.002" ixy="0" ixz="0" iyy="0.002" iyz="0" izz="0.0003"/></inertial>
        <collision><origin xyz="0 0 -0.1"/>
        <geometry><cylinder radius="0.02" length="0.2"/></geometry></collision></link>
      <joint name="shoulder" type="revolute"><parent link="base_link"/><child link="upper"/>
        <origin xyz="0.1 0 -0.05" rpy="0 0 1"/><axis xyz="0 3 0"/>
        <limit lower="0.2" upper="1.5" effort="9" velocity="0.5"/></joint>"""
    made = bring(robot(arm))
    (link,), (joint,) = made.table["links"], made.table["joints"]
    assert made.numbers["rigid_body"]["mass_kg"] == 12
    assert link["rigid_body"]["mass_kg"] == 0.5
    assert link["rpy_rad"] == pytest.approx([0, 0, 1])
    assert link["buoyancy"]["volume_m3"] == pytest.approx(np.pi * 0.02**2 * 0.2)
    assert joint["axis"] == [0, 1, 0]
    assert (joint["lower"], joint["upper"], joint["home"]) == (0.2, 1.5, 0.2)
    assert joint["actuator"]["max_effort"] == 9
    assert made.noted("assumed", "home of joint shoulder")


def chain(count, name="joint_{}", limit='lower="-1" upper="1" effort="9" velocity="0.5"'):
    """An arm of so many links, each on the one before."""
    text = ""
    for i in range(count):
        parent = f"arm_{i - 1}" if i else "base_link"
        text += f"""<link name="arm_{i}"><inertial><mass value="0.5"/>
          <inertia ixx="0.002" ixy="0" ixz="0" iyy="0.002" iyz="0" izz="0.002"/></inertial></link>
          <joint name="{name.format(i)}" type="revolute"><parent link="{parent}"/>
          <child link="arm_{i}"/><axis xyz="0 0 1"/><limit {limit}/></joint>"""
    return text


def test_arms_have_six_joints_at_most(bring):
    assert len(bring(robot(chain(6))).table["joints"]) == 6
    with pytest.raises(ConfigError, match=r"joint 'joint_6'.* hold 6 joints, this file has 7"):
        bring(robot(chain(7)))


@pytest.mark.parametrize("count", [16, 17])
def test_shapes_of_a_link_beyond_sixteen_are_listed(bring, count):
    shape = """<collision><origin xyz="{} 0 0"/><geometry><cylinder radius="0.01" length="0.1"/>
      </geometry></collision>"""
    shapes = "".join(shape.format(0.05 * i) for i in range(count))
    made = bring(robot(chain(1).replace("</inertial></link>", f"</inertial>{shapes}</link>")))
    (link,) = made.table["links"]
    assert len(link["capsules"]) == len(link["water"]["cylinders"]) == 16
    assert bool(made.noted("dropped", "capsules of a link after the first 16")) is (count > 16)
    assert bool(made.noted("dropped", "drag and added mass of the shapes")) is (count > 16)


@pytest.mark.parametrize(("name", "grips"), [("left_gripper_{}", True), ("elbow_{}", False)])
def test_joints_of_grippers_are_known_by_their_names(bring, name, grips):
    made = bring(robot(chain(1, name)))
    (joint,) = made.table["joints"]
    assert joint.get("is_gripper", False) is grips
    assert bool(made.noted("assumed", "a gripper's, by its name")) is grips


@pytest.mark.parametrize(
    ("limit", "speed", "effort"),
    [
        ('effort="9" velocity="0.25"', 0.25, 9.0),
        ('effort="0" velocity="0"', 0.5, 10.0),
        ("", 0.5, 10.0),
        ('effort="1e6" velocity="0.25"', 0.25, 1e4),
    ],
)
def test_servos_have_the_limits_of_the_file_or_named_ones(bring, limit, speed, effort):
    made = bring(robot(chain(1, limit=f'lower="-1" upper="1" {limit}')))
    servo = made.table["joints"][0]["actuator"]
    assert (servo["max_speed"], servo["max_effort"]) == (speed, effort)
    # A revolute servo of the shipped arm: full effort at 1 / 4.5 rad, damped with 0.25 s.
    assert servo["stiffness"] == pytest.approx(4.5 * effort)
    assert servo["damping"] == pytest.approx(0.25 * 4.5 * effort)
    assert bool(made.noted("assumed", "effort of joints that state none")) is (effort == 10.0)
    assert bool(made.noted("assumed", "speed of joints that state none")) is (speed == 0.5)
    assert bool(made.noted("converted", "effort 1e+06")) is (effort == 1e4)


def test_a_joint_that_follows_another_is_fixed(bring):
    jaw = """<link name="jaw"/><joint name="jaw_joint" type="revolute"><parent link="base_link"/>
      <child link="jaw"/><limit lower="0" upper="1" effort="1" velocity="1"/>
      <mimic joint="other" multiplier="-1"/></joint>"""
    made = bring(robot(jaw))
    assert "joints" not in made.table
    assert made.noted("dropped", "jaw_joint follows other")


FAULTS = {
    "xml": (lambda t: t.replace("</robot>", "</robt>"), "not well-formed XML"),
    "doctype": (lambda t: t.replace("<robot", "<!DOCTYPE a>\n<robot", 1), "DOCTYPE"),
    "encoding": (lambda t: t.replace('"1.0"', '"1.0" encoding="none"'), "unknown encoding"),
    "mass zero": (lambda t: t.replace('mass value="12.0"', 'mass value="0"'), "have no mass"),
    "mass negative": (lambda t: t.replace('mass value="12.0"', 'mass value="-3"'), "mass = -3"),
    "inertia": (lambda t: t.replace('izz="0.3"', 'izz="0.9"'), "0.2, 0.25, 0.9"),
    "inertia zero": (
        lambda t: re.sub('i(..)="0.[0-9]+"', r'i\1="0"', t),
        "inertia of zero",
    ),
    "number": (lambda t: t.replace('ixx="0.2"', 'ixx="0,2x"'), "'0,2x'"),
    "nan": (lambda t: t.replace('ixx="0.2"', 'ixx="nan"'), "finite"),
    "axis": (lambda t: t.replace('axis xyz="1 0 0"', 'axis xyz="0 0 0"'), "length zero"),
    "parent": (lambda t: t.replace('parent link="base_link"', 'parent link="hull"'), "'hull'"),
    "type": (lambda t: t.replace("continuous", "hinge"), "'hinge'"),
    "no thruster": (lambda t: t.replace("thruster_", "wheel_"), "no thruster"),
    "mesh": (
        lambda t: t.replace('<box size="0.4 0.3 0.1"/>', '<mesh filename="none.stl"/>'),
        "none.stl",
    ),
    "outside": (
        lambda t: t.replace('<box size="0.4 0.3 0.1"/>', '<mesh filename="../../../etc/x.stl"/>'),
        "outside",
    ),
    "twice": (lambda t: t.replace("</robot>", '<link name="thruster_1"/></robot>'), "twice"),
    "empty": (lambda t: "<robot name='a'/>", "no thruster"),
    "root": (lambda t: "<world/>", "<world>"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_one_message_with_file_and_remedy(bring, fault):
    change, part = FAULTS[fault]
    with pytest.raises(ConfigError) as error:
        bring(change(robot()))
    text = str(error.value)
    assert part in text
    assert "\n" not in text
    assert re.search(r"rov\.urdf(:\d+)?: ", text)


@pytest.mark.parametrize("kind", ["continuous", "revolute", "floating"])
def test_a_joint_without_limits_is_refused(bring, kind):
    text = robot(
        f'<link name="pan"/>\n<joint name="pan_joint" type="{kind}"><parent link="base_link"/>'
        '<child link="pan"/></joint>'
    )
    line = line_of(text, '<joint name="pan')
    with pytest.raises(ConfigError, match=f"rov.urdf:{line}: .*make it fixed"):
        bring(text)


def test_two_plugins_that_differ_are_refused_and_equal_ones_listed(bring):
    first, other = hydrodynamics(**FULL), hydrodynamics(**FULL | {"xU": -5})
    with pytest.raises(ConfigError, match="contradicts the hydrodynamics of 'base_link'"):
        bring(robot(first, other))
    assert bring(robot(first, first)).noted("dropped", "second hydrodynamics")


@pytest.mark.parametrize("joint", ["nowhere", ""])
def test_a_thruster_on_nothing_is_refused(bring, joint):
    plugin = (
        '<gazebo><plugin filename="gz-sim-thruster-system" name="t">\n'
        f"<joint_name>{joint}</joint_name></plugin></gazebo>"
    )
    text = robot(plugin)
    with pytest.raises(
        ConfigError, match=f"rov.urdf:{line_of(text, '<joint_name>')}.*no such joint"
    ):
        bring(text)


def test_density_of_the_user_is_compared_with_that_of_the_file(bring):
    text = robot(hydrodynamics(**FULL, water_density=1025))
    made = bring(text, density=1000.0)
    assert made.trim.density_kgpm3 == 1000
    # The box displaces 12 l.
    assert made.noted("converted", "+0.300 kg there, +0.000 kg at 1000")
    assert bring(text).trim.density_kgpm3 == 1025
