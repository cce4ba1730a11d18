"""UUV Simulator's xacro and YAML: frames, signs, order, volumes, allocation matrices."""

import numpy as np
import pytest

from angler_mjx.errors import ConfigError

SNIPPETS = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:property name="d2r" value="${pi / 180}"/>
  <xacro:macro name="thruster" params="ns id *origin tau:=0.05">
    <joint name="${ns}/thruster_${id}_joint" type="continuous">
      <xacro:insert_block name="origin"/> <axis xyz="1 0 0"/>
      <parent link="${ns}/base_link"/> <child link="${ns}/thruster_${id}"/>
    </joint>
    <link name="${ns}/thruster_${id}">
      <collision><geometry><cylinder length="0.000001" radius="0.000001"/></geometry></collision>
    </link>
    <gazebo>
      <plugin name="${ns}_${id}_model" filename="libuuv_thruster_ros_plugin.so">
        <linkName>${ns}/thruster_${id}</linkName>
        <jointName>${ns}/thruster_${id}_joint</jointName>
        <thrusterID>${id}</thrusterID>
        <dynamics><type>FirstOrder</type><timeConstant>${tau}</timeConstant></dynamics>
        <conversion><type>Basic</type><rotorConstant>0.0003</rotorConstant></conversion>
      </plugin>
    </gazebo>
  </xacro:macro>
</robot>
"""

ROBOT = """<robot name="ray" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="namespace" default="ray"/>
  <xacro:property name="ns" value="$(arg namespace)"/>
  <xacro:include filename="snippets.xacro"/>
  <link name="${ns}/base_link">
    <inertial><mass value="100"/>
      <inertia ixx="9" ixy="0" ixz="0" iyy="12" iyz="0" izz="15"/></inertial>
  </link>
  <gazebo>
    <plugin name="water" filename="libuuv_underwater_object_ros_plugin.so">
      <fluid_density>1028.0</fluid_density>
      <link name="${ns}/base_link">
        <neutrally_buoyant>0</neutrally_buoyant>
        <volume>0.1</volume>
        <box><length>1.2</length><width>0.8</width><height>0.5</height></box>
        <center_of_buoyancy>0.01 0.02 0.05</center_of_buoyancy>
        <hydrodynamic_model>
          <type>fossen</type>
          <added_mass>ADDED</added_mass>
          <linear_damping>-70 -75 -80 -20 -25 -30</linear_damping>
          <quadratic_damping>-700 -750 -800 -200 -250 -300</quadratic_damping>
        </hydrodynamic_model>
      </link>
    </plugin>
  </gazebo>
  <xacro:thruster ns="${ns}" id="1">
    <origin xyz="0.4 -0.3 0" rpy="0 0 ${45 * d2r}"/></xacro:thruster>
  <xacro:thruster ns="${ns}" id="0">
    <origin xyz="0 0.2 0.1" rpy="0 ${-90 * d2r} 0"/></xacro:thruster>
</robot>
"""

ADDED = np.diag([60.0, 70, 90, 5, 6, 7])
"""In x forward, y right, z down; the coupling of sway with roll is read in both halves."""
ADDED[0, 1] = ADDED[1, 0] = 3
ADDED[1, 3] = ADDED[3, 1] = 2
ADDED[0, 4] = ADDED[4, 0] = -4


@pytest.fixture
def ray(bring):
    def ray(change=lambda text: text, **options):
        added = "\n".join(" ".join(map(str, row)) for row in ADDED)
        text = change(ROBOT.replace("ADDED", added))
        return bring(text, "ray.xacro", files={"snippets.xacro": SNIPPETS}, **options)

    return ray


def test_added_mass_is_turned_from_y_right_z_down(ray):
    added = np.array(ray().numbers["added_mass"]["coefficients"])
    # Water that is pushed with the same velocity holds the same energy in both axes.
    down = np.array([0.3, -0.2, 0.5, 0.7, -0.4, 0.6])
    turn = np.diag([1.0, -1.0, -1.0])
    up = np.concatenate([turn @ down[:3], turn @ down[3:]])
    assert up @ added @ up == pytest.approx(down @ ADDED @ down)
    assert added[0, 1] == -3
    assert added[0, 4] == 4
    assert ray().noted("converted", "y right, z down")


def test_damping_is_negated_and_volume_and_density_are_those_of_the_file(ray):
    made = ray()
    assert made.numbers["damping"]["linear"] == [70, 75, 80, 20, 25, 30]
    assert made.numbers["damping"]["quadratic"] == [700, 750, 800, 200, 250, 300]
    assert made.numbers["buoyancy"]["volume_m3"] == 0.1
    assert made.numbers["buoyancy"]["center_of_buoyancy_m"] == [0.01, 0.02, 0.05]
    assert made.trim.density_kgpm3 == 1028
    fresh = ray(density=1000.0)
    assert fresh.noted("converted", "+2.800 kg there, +0.000 kg at 1000")


def add_floats(text):
    """Two floats above the base, each a link with a volume of its own."""
    links, water = "", ""
    for side, y in (("left", 0.3), ("right", -0.3)):
        links += f"""<link name="ray/{side}"><inertial><mass value="2"/>
            <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
          <joint name="ray/{side}_joint" type="fixed"><origin xyz="0 {y} 0.2"/>
            <parent link="ray/base_link"/><child link="ray/{side}"/></joint>"""
        water += f"""<link name="ray/{side}"><volume>0.01</volume>
            <center_of_buoyancy>0 0 0.1</center_of_buoyancy></link>"""
    begin, end = (
        '  <gazebo>\n    <plugin name="water"',
        "    </plugin>\n  </gazebo>\n  <xacro:thruster",
    )
    assert begin in text
    assert end in text
    return text.replace(begin, links + begin).replace(end, water + end)


def test_links_with_volumes_leave_the_water_by_themselves(ray):
    made = ray(add_floats)
    buoyancy = made.numbers["buoyancy"]
    assert buoyancy["volume_m3"] == pytest.approx(0.12)
    center = np.array(made.table["base"]["center_of_mass_m"])
    np.testing.assert_allclose(center, [0.0, 0.0, 2 * 2 * 0.2 / 104], atol=1e-5)
    base, left, right = buoyancy["bodies"]
    np.testing.assert_allclose(base["center_m"], np.array([0.01, 0.02, 0.05]) - center, atol=1e-5)
    np.testing.assert_allclose(left["center_m"], np.array([0.0, 0.3, 0.3]) - center, atol=1e-5)
    np.testing.assert_allclose(right["center_m"], np.array([0.0, -0.3, 0.3]) - center, atol=1e-5)
    assert [body["volume_m3"] for body in (base, left, right)] == [0.1, 0.01, 0.01]
    # 10 l are a ball of 0.267 m.
    assert left["height_m"] == pytest.approx(0.2673, abs=1e-4)
    assert made.noted("assumed", "3 volumes leave the water by themselves")
    assert "bodies" not in ray().numbers["buoyancy"]


def full_damping(coupling):
    """Change the linear damping to a matrix with surge by heave, and quadratic sway by yaw."""
    linear, quadratic = (
        np.diag([-70.0, -75, -80, -20, -25, -30]),
        np.diag([-700.0, -750, -800, -200, -250, -300]),
    )
    linear[0, 2] = coupling
    quadratic[1, 5] = -40.0

    def change(text):
        for before, matrix in (
            ("-70 -75 -80 -20 -25 -30", linear),
            ("-700 -750 -800 -200 -250 -300", quadratic),
        ):
            assert before in text
            text = text.replace(before, "\n".join(" ".join(map(str, row)) for row in matrix))
        return text

    return change


def test_damping_between_axes_is_turned_and_kept(ray):
    damping = ray(full_damping(-10.0)).numbers["damping"]
    linear, quadratic = np.array(damping["linear"]), np.array(damping["quadratic"])
    # In x forward, y right, z down -10 w pushes back along x; up, w has the other sign.
    assert linear[0, 2] == -10.0
    assert linear[2, 0] == 0.0
    assert np.diag(linear).tolist() == [70, 75, 80, 20, 25, 30]
    # Sway and yaw both change their sign.
    assert quadratic[1, 5] == 40.0


def test_linear_damping_that_drives_is_dropped(ray):
    made = ray(full_damping(-1000.0))
    assert made.numbers["damping"]["linear"] == [70, 75, 80, 20, 25, 30]
    assert made.noted("dropped", "still water would drive")


def test_thrusters_are_in_the_order_of_their_numbers(ray):
    made = ray()
    first, second = made.table["thrusters"]["layout"]
    assert (first["name"], second["name"]) == ("thruster_0", "thruster_1")
    assert first["direction"] == pytest.approx([0, 0, 1], abs=1e-9)
    assert second["direction"] == pytest.approx([0.5**0.5, 0.5**0.5, 0])
    assert made.table["rotor"]["lag"]["time_constant_s"] == 0.05
    assert made.noted("dropped", "rotorConstant = 0.0003")
    assert made.noted("dropped", "below 1 mm")


def test_the_hull_is_the_box_of_the_file(ray):
    made = ray()
    assert made.noted("assumed", "hull: the box of the file")
    ends = np.array([c[k] for c in made.table["hull"]["capsules"] for k in ("from_m", "to_m")])
    radius = made.table["hull"]["capsules"][0]["radius_m"]
    assert np.abs(ends).max(axis=0) + radius == pytest.approx([0.6, 0.4, 0.25])


@pytest.mark.parametrize(
    ("before", "after", "part"),
    [
        ("-70 -75", "-70", "holds 5 numbers"),
        ('name="${ns}/base_link">\n        <neutral', 'name="hull">\n        <neutral', "no such"),
        ("<volume>0.1", "<volume>-0.1", "must be positive"),
        ("<fluid_density>1028.0", "<fluid_density>1.0", "density 1"),
        ("3 70", "9 70", "differ; make the matrix symmetric"),
        (" 70.0 ", " -70.0 ", "negative"),
    ],
)
def test_faults(ray, before, after, part):
    def change(text):
        text = text.replace("3.0 70.0", "3 70.0") if before == "3 70" else text
        assert before in text
        return text.replace(before, after, 1)

    with pytest.raises(ConfigError, match=part) as error:
        ray(change)
    assert ".xacro:" in str(error.value)


def test_other_models_of_water_are_listed(ray):
    made = ray(lambda text: text.replace("<type>fossen", "<type>sphere"))
    assert made.noted("dropped", "type 'sphere'")
    assert made.noted("assumed", "added mass")


MATRIX = """tam:
- [0.0, 0.70710678]
- [0.0, 0.70710678]
- [1.0, 0.0]
- [0.2, 0.0]
- [0.0, 0.0]
- [0.0, 0.49497475]
thruster_manager:
  max_thrust: 2000.0
wobble: 1
"""


def test_an_allocation_matrix_is_compared(ray, tmp_path):
    path = tmp_path / "TAM.yaml"
    path.write_text(MATRIX)
    made = ray(yaml=[path])
    assert made.noted("converted", "tam", "within")
    assert made.noted("dropped", "max_thrust = 2000.0")
    assert made.noted("dropped", "wobble = 1", "TAM.yaml:10]")
    path.write_text(MATRIX.replace("0.2, 0.0", "-0.2, 0.0"))
    with pytest.raises(ConfigError, match=r"tam\[3\]\[0\] = -0.2, but thruster thruster_0 gives"):
        ray(yaml=[path])


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("tam: [[1, 2]]", "6 rows of 2"),
        ("tam: [a, b", "YAML"),
        ("other: 1", "neither tam"),
        ("tam: &a [1]\nb: *a", "aliases"),
        ("tam: !!python/object/apply:os.system ['true']", "YAML"),
    ],
)
def test_a_bad_yaml_is_one_message(ray, tmp_path, text, part):
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=part) as error:
        ray(yaml=[path])
    assert "bad.yaml" in str(error.value)
    assert "\n" not in str(error.value)


BASIC = "<conversion><type>Basic</type><rotorConstant>0.0003</rotorConstant></conversion>"


def converting(text, more=""):
    """Change the conversion of all thrusters."""
    files = {"snippets.xacro": SNIPPETS.replace(BASIC, text + more)}
    assert files["snippets.xacro"] != SNIPPETS or text == BASIC
    return files


def curves_of(made):
    return [
        np.array([row["curve"]["pwm_us"], row["curve"]["thrust_n"]])
        for row in made.table["thrusters"]["layout"]
    ]


@pytest.fixture
def convert(bring):
    def convert(text, more=""):
        added = "\n".join(" ".join(map(str, row)) for row in ADDED)
        return bring(ROBOT.replace("ADDED", added), "ray.xacro", files=converting(text, more))

    return convert


def test_a_basic_conversion_is_a_parabola_between_the_limits_of_the_command(convert):
    made = convert(BASIC, "<clampMin>-200</clampMin><clampMax>300</clampMax>")
    for pwm, thrust in curves_of(made):
        assert thrust[pwm == 1900] == pytest.approx(0.0003 * 300**2)
        assert thrust[pwm == 1700] == pytest.approx(0.0003 * 150**2)
        assert thrust[pwm == 1500] == 0.0
        assert thrust[pwm == 1300] == pytest.approx(-0.0003 * 100**2)
        assert thrust[pwm == 1100] == pytest.approx(-0.0003 * 200**2)
    assert made.noted("converted", "rotorConstant = 0.0003")


def test_gain_efficiencies_and_limits_of_thrust_count(convert):
    more = """<clampMin>-100</clampMin><clampMax>100</clampMax><gain>2</gain>
      <propeller_efficiency>0.5</propeller_efficiency><thrust_efficiency>0.8</thrust_efficiency>
      <thrustMax>1.5</thrustMax><thrustMin>-10</thrustMin>"""
    pwm, thrust = curves_of(convert(BASIC, more))[0]
    assert thrust[pwm == 1900] == 1.5
    assert thrust[pwm == 1700] == pytest.approx(0.8 * 0.0003 * 50**2)
    assert thrust[pwm == 1100] == pytest.approx(-0.8 * 0.0003 * 100**2)


@pytest.mark.parametrize("efficiency", [-0.5, 1.5])
def test_efficiencies_beyond_one_are_one_as_in_uuv_simulator(convert, efficiency):
    more = f"""<clampMin>-100</clampMin><clampMax>100</clampMax>
      <propeller_efficiency>{efficiency}</propeller_efficiency>
      <thrust_efficiency>{efficiency}</thrust_efficiency>"""
    pwm, thrust = curves_of(convert(BASIC, more))[0]
    assert thrust[pwm == 1900] == pytest.approx(0.0003 * 100**2)
    assert thrust[pwm == 1100] == pytest.approx(-0.0003 * 100**2)


def test_bessa_has_a_dead_band(convert):
    text = """<conversion><type>Bessa</type><rotorConstantL>0.002</rotorConstantL>
      <rotorConstantR>0.003</rotorConstantR><deltaL>-400</deltaL><deltaR>900</deltaR></conversion>"""
    pwm, thrust = curves_of(convert(text, "<clampMin>-100</clampMin><clampMax>100</clampMax>"))[0]
    assert thrust[pwm == 1900] == pytest.approx(0.003 * (100**2 - 900))
    assert thrust[pwm == 1600] == 0.0  # a command of 25: its square is below 900
    assert thrust[pwm == 1400] == pytest.approx(-0.002 * (25**2 - 400))
    assert thrust[pwm == 1100] == pytest.approx(-0.002 * (100**2 - 400))


def test_a_table_ends_at_its_points(convert):
    text = """<conversion><type>LinearInterp</type><inputValues>20 -10 0</inputValues>
      <outputValues>60 -8 0</outputValues></conversion>"""
    pwm, thrust = curves_of(convert(text))[0]
    assert thrust[pwm == 1900] == 60.0
    assert thrust[pwm == 1700] == 30.0
    assert thrust[pwm == 1300] == -4.0
    assert thrust[pwm == 1100] == -8.0


@pytest.mark.parametrize(
    ("text", "more", "reason"),
    [
        (BASIC, "", "clampMin and clampMax below and above 0 are not stated"),
        (BASIC, "<clampMin>0</clampMin><clampMax>9</clampMax>", "below and above 0"),
        (BASIC.replace("Basic", "Cubic"), "<clampMin>-9</clampMin><clampMax>9</clampMax>", "type"),
        (
            BASIC.replace("0.0003", "-1"),
            "<clampMin>-9</clampMin><clampMax>9</clampMax>",
            "does not rise",
        ),
    ],
)
def test_conversions_that_say_too_little_are_listed(convert, text, more, reason):
    made = convert(text, more)
    assert all("curve" not in row for row in made.table["thrusters"]["layout"])
    assert made.noted("dropped", reason)
