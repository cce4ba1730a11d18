"""A transport in memory, a door in a thread, and CDR written and read without the package."""

import contextlib
import struct
import threading
from collections import defaultdict
from types import SimpleNamespace

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from angler_mjx.serve.door import Door, DoorSettings

TYPES = get_typestore(Stores.ROS2_JAZZY)
HEADER = b"\x00\x01\x00\x00"
TRIGGER = HEADER + b"\x00"
ANSWER_S = 20.0

MORE = {
    "rcl_interfaces/msg/Request": "rcl_interfaces/Parameter[] parameters",
    "control_msgs/msg/JointTolerance": (
        "string name\nfloat64 position\nfloat64 velocity\nfloat64 acceleration"
    ),
    "control_msgs/msg/JointComponentTolerance": (
        "string joint_name\nuint16 component\nfloat64 position\nfloat64 velocity\n"
        "float64 acceleration"
    ),
    "control_msgs/msg/SendRequest": """
unique_identifier_msgs/UUID goal_id
trajectory_msgs/JointTrajectory trajectory
trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory
control_msgs/JointTolerance[] path_tolerance
control_msgs/JointComponentTolerance[] component_path_tolerance
control_msgs/JointTolerance[] goal_tolerance
control_msgs/JointComponentTolerance[] component_goal_tolerance
builtin_interfaces/Duration goal_time_tolerance""",
    "control_msgs/msg/SendResponse": "bool accepted\nbuiltin_interfaces/Time stamp",
    "control_msgs/msg/ResultResponse": "int8 status\nint32 error_code\nstring error_string",
    "control_msgs/msg/CancelResponse": ("int8 return_code\naction_msgs/GoalInfo[] goals_canceling"),
    "control_msgs/msg/Feedback": """
unique_identifier_msgs/UUID goal_id
std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint desired
trajectory_msgs/JointTrajectoryPoint actual
trajectory_msgs/JointTrajectoryPoint error
string[] multi_dof_joint_names
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_desired
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_actual
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error""",
}
for name, text in MORE.items():
    TYPES.register(get_types_from_msg(text, name))


def twist(*nu):
    """CDR of a geometry_msgs/Twist."""
    return HEADER + struct.pack("<6d", *nu, *[0.0] * (6 - len(nu)))


def read_answer(data):
    """Success and message of a std_srvs/Trigger or SetBool."""
    (size,) = struct.unpack_from("<I", data, 8)
    return bool(data[4]), data[12 : 12 + size - 1].decode()


def set_parameter(name, kind, value):
    """CDR of a rcl_interfaces/SetParameters request with an integer."""
    types, empty = TYPES.types, [np.zeros(0, kind) for kind in ("u1", "?", "i8", "f8")]
    inner = types["rcl_interfaces/msg/ParameterValue"](kind, False, value, 0.0, "", *empty, [])
    parameter = types["rcl_interfaces/msg/Parameter"](name, inner)
    request = types["rcl_interfaces/msg/Request"]([parameter])
    return bytes(TYPES.serialize_cdr(request, "rcl_interfaces/msg/Request"))


def trajectory(names, rows, *, times, stamp_s=0.0):
    """A trajectory_msgs/JointTrajectory."""
    make = TYPES.types
    empty = np.zeros(0)
    points = [
        make["trajectory_msgs/msg/JointTrajectoryPoint"](
            positions=np.array(row, float),
            velocities=empty,
            accelerations=empty,
            effort=empty,
            time_from_start=make["builtin_interfaces/msg/Duration"](int(t), int(t % 1 * 1e9)),
        )
        for row, t in zip(rows, times, strict=True)
    ]
    stamp = make["builtin_interfaces/msg/Time"](int(stamp_s), 0)
    header = make["std_msgs/msg/Header"](stamp=stamp, frame_id="")
    return make["trajectory_msgs/msg/JointTrajectory"](header, list(names), points)


def trajectory_bytes(*args, **kwargs):
    return bytes(
        TYPES.serialize_cdr(trajectory(*args, **kwargs), "trajectory_msgs/msg/JointTrajectory")
    )


class MemoryBackend:
    """A `Backend` that keeps all messages."""

    address, missing = "memory", ()

    def __init__(self):
        self.kinds, self.services, self.receivers = {}, {}, {}
        self.sent, self.wanted = defaultdict(list), None

    def declare_topic(self, topic):
        self.kinds[topic.name] = topic

    def is_wanted(self, name):
        return self.wanted is None or name in self.wanted

    def publish(self, name, data, time_ns, wall_ns):
        self.sent[name].append((time_ns, data))

    def subscribe(self, topic, receive):
        self.receivers[topic.name] = receive

    def serve(self, service, answer):
        self.services[service.name] = answer

    def close(self):
        pass

    def begin_call(self, name, data=TRIGGER):
        """Send a request; returns its answer in a box, and an event that says that it is there."""
        box, event = [], threading.Event()

        def reply(answer):
            box.append(answer)
            event.set()

        self.services[name](data, reply)
        return box, event

    def call(self, name, data=TRIGGER):
        box, event = self.begin_call(name, data)
        assert event.wait(ANSWER_S), f"{name}: no answer"
        return box[0]

    def step(self, count=1):
        for _ in range(count):
            success, text = read_answer(self.call("/step"))
            assert success, text

    def read(self, name):
        """All messages of a topic, decoded by rosbags."""
        package, _, short = self.kinds[name].message.partition("/")
        full = f"{package}/msg/{short}"
        return [TYPES.deserialize_cdr(data, full) for _, data in self.sent[name]]

    def diagnostics(self, robot=0):
        status = self.read("/diagnostics")[-1].status[robot]
        return {pair.key: pair.value for pair in status.values}


@contextlib.contextmanager
def served(session, scenario, seed=None, backends=None, **settings):
    """A door in a thread, with a transport in memory; ends when left."""
    session.reset(seed)
    backend, reports, stop = MemoryBackend(), [], SimpleNamespace(requested=False)
    door = Door(
        session,
        scenario,
        [backend] if backends is None else backends,
        DoorSettings(**{"pace": "step", **settings}),
        reports.append,
    )
    results = []
    thread = threading.Thread(target=lambda: results.append(door.run(stop)), daemon=True)
    thread.start()
    try:
        yield SimpleNamespace(
            backend=backend, reports=reports, results=results, thread=thread, stop=stop
        )
    finally:
        stop.requested = True
        thread.join(ANSWER_S)
        assert not thread.is_alive(), "the door hangs"
