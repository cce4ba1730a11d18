"""What is fed with wrong inputs: each reader, valid inputs to begin with, and what may be raised.

`angler` writes MCAP and reads none, so there is no reader of that here.
"""

import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from angler_mjx.errors import AnglerError
from angler_mjx.files import FaultyError, parse_model, validate_model
from angler_mjx.report.interop import joint_trajectory_file
from angler_mjx.report.interop.mission_files.import_mission import import_missions
from angler_mjx.robot.importing.import_vehicle import import_vehicle
from angler_mjx.robot.vehicles import library, mjcf
from angler_mjx.robot.vehicles.thrusters import tables_at
from angler_mjx.scenario.fleet_entry import FleetEntry
from angler_mjx.scenario.scenario import Scenario, load_scenario, shipped_scenarios
from angler_mjx.studies.benchmark import problem_settings
from angler_mjx.studies.speed import compare, rows
from angler_mjx.studies.speed.chart import format_table
from angler_mjx.teleop import script
from angler_mjx.teleop.terminal import parse_keys
from angler_sitl.firmware import parameters
from angler_sitl.missions import ground_station
from angler_sitl.wire import packets
from angler_sitl.wire.link import MavlinkLink, dialect

ROOT = Path(__file__).parents[2]
DATA = ROOT / "angler_mjx" / "robot" / "vehicles" / "data"

GAINS = b"""# gains as angler tune writes them
schema_version = 1
name = "tuned"

[world]
preset = "open"

[controller]
name = "pid"

[controller.gains.pid_velocity]
velocity_per_s = 2.5
rate_per_s = 4.0

[[fleet]]
vehicle = "bluerov2"
battery_v = 14.8
thruster_health = { thruster_1 = 0.5 }
estimate = "ekf"

[fleet.sensors.usbl]
fitted = true
period_s = 2.0

[[world.obstacles.explicit]]
type = "box"
position_m = [1.0, 2.0, -5.0]
size_m = [1.0, 1.0, 1.0]
motion = { type = "circle", radius_m = 2.0, period_s = 30.0, axis = [0.0, 0.0, 1.0] }
"""
BENCHMARK = b"""
schema_version = 1
name = "mine"
scenario = "reef_fleet"
presets = ["reef"]
teams = [1, 4]
seeds = [11]
problems = 3
deadline_s = 1.0
close_after = 2
set.engine = "fused"
set.fleet = [{ vehicle = "bluerov2", count = 2 }]

[[information]]
obstacles = "nothing"

[[scene]]
name = "still"
set.world.currents = []
set.world.obstacles.dynamic.count = 0

[[planner]]
name = "grid"
settings = { start_hold_s = 10.0 }

[[planner]]
name = "grid"
label = "other"
information = { obstacles = "nothing", current = "nothing" }
"""
PARAMETERS = b"# tuned\nPSC_POSXY_P,1.25\nATC_RAT_YAW_P 0.18 # for people\nSERVO1_TRIM,1500\n"
KEYS = b"# drive\n0.5 i\n1-3.5 u\n4 <tab>\n4.5 <space>\n5 Q\n"
TRAJECTORY = json.dumps(
    {
        "schema_version": 1,
        "robots": [
            {
                "robot": 0,
                "trajectory": {
                    "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
                    "joint_names": ["x", "y", "z", "yaw"],
                    "points": [
                        {
                            "positions": [1.0, 2.0, -3.0, 0.0],
                            "velocities": [0.0, 0.0, 0.0, 0.0],
                            "time_from_start": {"sec": t, "nanosec": 500},
                        }
                        for t in (0, 4)
                    ],
                },
            }
        ],
    },
    indent=1,
).encode()
XACRO = b"""<robot name="ray" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:arg name="mass" default="10"/> <xacro:property name="r" value="${2 * pi / 8}"/>
<xacro:macro name="thruster" params="id y:=0 *origin **more"><link name="thruster_${id}"/>
<joint name="t_${id}" type="fixed"><parent link="base_link"/><child link="thruster_${id}"/>
<xacro:insert_block name="origin"/></joint><xacro:insert_block name="more"/></xacro:macro>
<link name="base_link"><inertial><mass value="$(arg mass)"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="${1 + len('a')}" iyz="0" izz="2"/></inertial></link>
<xacro:if value="${1 &lt; 2}"><xacro:thruster id="1"><origin xyz="0 0.1 0" rpy="0 0 ${r}"/>
<more/></xacro:thruster></xacro:if>
<gazebo><plugin name="w" filename="libuuv_underwater_object_ros_plugin.so">
<fluid_density>1028</fluid_density><link name="base_link"><volume>0.01</volume>
<box><length>1</length><width>0.5</width><height>0.2</height></box><hydrodynamic_model>
<type>fossen</type><added_mass>4 5 6 1 1 1</added_mass><linear_damping>-1 -2 -3 -1 -1 -1
</linear_damping></hydrodynamic_model></link></plugin></gazebo></robot>
"""
SDF = b"""<sdf version="1.9"><model name="rov"><frame name="f">
<pose degrees="true">0 0 1 0 0 90</pose></frame><link name="base_link"><inertial><mass>12</mass>
<inertia><ixx>1</ixx><ixy>0</ixy>
<ixz>0</ixz><iyy>1</iyy><iyz>0</iyz><izz>1</izz></inertia><fluid_added_mass><xx>5</xx>
</fluid_added_mass></inertial><collision name="c"><geometry><box><size>0.4 0.3 0.1</size></box>
</geometry></collision></link><link name="prop"><pose relative_to="f">0.1 0 0 0 0 0</pose>
<inertial><mass>0.1</mass></inertial></link><joint name="j" type="revolute"><parent>base_link
</parent><child>prop</child><axis><xyz expressed_in="f">1 0 0</xyz></axis></joint>
<plugin filename="gz-sim-thruster-system" name="t"><joint_name>j</joint_name></plugin>
<plugin filename="gz-sim-hydrodynamics-system" name="h"><link_name>base_link</link_name><xU>-4</xU>
<yVabsV>-9</yVabsV><zWW>-3</zWW></plugin></model></sdf>
"""
MJCF = b"""<mujoco model="seal"><option density="1025"/><worldbody><body name="seal" gravcomp="1">
<freejoint/><inertial pos="0 0 0" mass="12" diaginertia="0.2 0.25 0.3"/>
<geom type="box" size="0.2 0.15 0.05"/><site name="t1" pos="0.1 0.1 0"/><body name="fore">
<joint name="elbow" axis="0 1 0" range="-30 60"/><geom type="capsule" fromto="0 0 0 0.2 0 0"
size="0.02"/></body></body></worldbody><actuator><general name="first" site="t1"
gear="-1 0 0 0 0 0" ctrlrange="-1 2"/></actuator></mujoco>
"""
PULSES = range(1500, 1532)


def _scenario(path):
    loaded = load_scenario(path)
    loaded.members()
    again = parse_model(Scenario, json.loads(loaded.model_dump_json()), source="again")
    assert again == loaded


def _benchmark(path):
    found = problem_settings.read_benchmark(path)
    resolved = json.loads(json.dumps(found.resolved()))
    again = problem_settings.rebuild_benchmark(path.parent, resolved, {})
    assert [str(one) for one in again.settings] == [str(one) for one in found.settings]
    assert again.resolved()["problems"] == resolved["problems"]


def _vehicle(path):
    config = library.load_vehicle(str(path))
    try:
        validate_model(FleetEntry, {"vehicle": str(path)})
    except FaultyError:
        return
    for name in config.parameter_sets:
        mjcf.to_spec(config, name, shapes=False).compile()
    mjcf.to_xml(config, None)


def _foreign(path):
    made = import_vehicle(path, "t200")
    target = path.with_suffix(".toml")
    target.write_text(made.text, encoding="utf-8")
    _vehicle(target)


def _thruster(path):
    made = library.load_thruster(str(path))
    for share in (0.0, 0.3, 1.0):
        low, high = made.voltage_v[0], made.voltage_v[-1]
        tables_at(made, low + share * (high - low))


def _trajectory(path):
    goals = joint_trajectory_file.read_trajectories(path, robots=2)
    joint_trajectory_file.write_trajectories(path.with_suffix(".again"), goals, force=True)
    assert joint_trajectory_file.read_trajectories(path.with_suffix(".again")) == goals


def _keys(path):
    timed = script.load_keys(path)
    script.save_keys(path.with_suffix(".again"), timed[:1000])
    parse_keys(path.read_bytes().decode("utf-8", "replace"))


def _rows(path):
    if compare.select_latest(rows.read_rows(path)):
        format_table(path)


class _Datagram:
    """A socket that one datagram has come to."""

    def __init__(self, data):
        self._waiting = [data]

    def setblocking(self, _):
        pass

    def recvfrom(self, most):
        if not self._waiting:
            raise BlockingIOError
        return self._waiting.pop()[:most], ("127.0.0.1", 9)

    def sendto(self, data, _):
        return len(data)


def _mavlink(path):
    link = MavlinkLink(_Datagram(path.read_bytes()), name="robot_0", sysid=1)
    link.tick(0.0)
    link.tick(2.0)
    assert link.format_last_texts().isprintable() or "\n" not in link.format_last_texts(100)


def _servo(path):
    data = path.read_bytes()
    found = packets.read_servo(data)
    assert found is None or (len(data) in (40, 72) and len(found[1]) == 16)


def _address(path):
    ground_station.parse_address(path.read_bytes().decode("utf-8", "replace"))


def _mavlink_inputs():
    codec = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    messages = (
        dialect.MAVLink_heartbeat_message(12, 3, 128, 4, 4, 3),
        dialect.MAVLink_statustext_message(4, b"PreArm: depth sensor"),
        dialect.MAVLink_param_value_message(b"PSC_POSXY_P", 1.0, 9, 700, 12),
        dialect.MAVLink_command_ack_message(400, 0),
    )
    packed = [bytes(message.pack(codec)) for message in messages]
    return (*packed, b"".join(packed))


@dataclass(frozen=True)
class Reader:
    """One reader."""

    name: str
    inputs: tuple[bytes, ...]
    read: Any
    """Called with the path of a file."""
    end: str = ".toml"
    allowed: tuple[type[Exception], ...] = (AnglerError,)


WAYPOINTS = b"""QGC WPL 110
0\t1\t0\t16\t0\t0\t0\t0\t47.6\t-122.3\t0\t1
1\t0\t2\t178\t1\t0.3\t-1\t0\t0\t0\t0\t1
2\t0\t3\t18\t1\t0\t5\t0\t47.6001\t-122.3\t-5\t1
3\t0\t3\t16\t0\t0\t0\t0\t47.6001\t-122.2999\t-5\t1
4\t0\t2\t177\t2\t1\t0\t0\t0\t0\t0\t1
"""


def _files(folder, end=".toml"):
    return tuple(path.read_bytes() for path in sorted(folder.glob(f"*{end}")))


READERS = {
    reader.name: reader
    for reader in (
        Reader(
            "scenario", (*(p.read_bytes() for p in shipped_scenarios().values()), GAINS), _scenario
        ),
        Reader("benchmark", (BENCHMARK,), _benchmark),
        Reader("vehicle", _files(DATA), _vehicle),
        Reader("thruster", _files(DATA / "thrusters"), _thruster),
        Reader(
            "foreign vehicle",
            (XACRO, SDF, MJCF, (ROOT / "docs/examples/otter.urdf").read_bytes()),
            _foreign,
            ".xml",
        ),
        Reader("trajectory", (TRAJECTORY,), _trajectory, ".json"),
        Reader(
            "mission",
            ((ROOT / "docs/examples/dive.plan").read_bytes(), WAYPOINTS),
            lambda path: import_missions([path]),
            ".plan",
        ),
        Reader(
            "parameters", (PARAMETERS,), lambda path: parameters.read_parameters(path), ".param"
        ),
        Reader("keys", (KEYS,), _keys, ".keys"),
        Reader(
            "rows",
            tuple((ROOT / "benchmarks" / "results.jsonl").read_bytes().splitlines(True)[-9:]),
            _rows,
            ".jsonl",
        ),
        Reader(
            "servo",
            (
                struct.pack("<HHI16H", 18458, 400, 70_000, *PULSES[:16]),
                struct.pack("<HHI32H", 29569, 400, 70_001, *PULSES),
            ),
            _servo,
            ".bin",
            (),
        ),
        Reader("mavlink", _mavlink_inputs(), _mavlink, ".bin", ()),
        Reader("address", (b"udp:127.0.0.1:14550",), _address, ".txt"),
    )
}


def try_one(reader, data, path):
    """Feed one input; what is raised beside the reader's own errors goes through."""
    path.write_bytes(data)
    try:
        reader.read(path)
    except reader.allowed as error:
        message = str(error)
        # A line for each fault and each way of writing it down; no more than a screen or two.
        assert len(message) < 20_000, f"a message of {len(message)} characters"
        assert all(char == "\n" or char.isprintable() for char in message), "control characters"
