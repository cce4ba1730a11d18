"""Names and hashes of ROS 2 types on the wire: messages, services and actions.

A hash is that of REP 2011 (``RIHS01``): SHA-256 of a type's fields and of all types in them. Nodes
of ROS 2 with ``rmw_zenoh_cpp`` meet by it.
"""

import hashlib
import json
import re
from functools import cache
from typing import Any

from angler_mjx.report.interop.ros_definitions import FIELDS

EMPTY_FIELD = "uint8 structure_needs_at_least_one_member"
"""Field of a message without fields, on the wire and in hashes."""

SERVICES: dict[str, tuple[str, str]] = {
    "std_srvs/Trigger": (EMPTY_FIELD, "bool success\nstring message"),
    "std_srvs/SetBool": ("bool data", "bool success\nstring message"),
    "rcl_interfaces/SetParameters": (
        "rcl_interfaces/Parameter[] parameters",
        "rcl_interfaces/SetParametersResult[] results",
    ),
    "action_msgs/CancelGoal": (
        "action_msgs/GoalInfo goal_info",
        "int8 ERROR_NONE=0\nint8 ERROR_REJECTED=1\nint8 ERROR_UNKNOWN_GOAL_ID=2\n"
        "int8 ERROR_GOAL_TERMINATED=3\nint8 return_code\naction_msgs/GoalInfo[] goals_canceling",
    ),
    "control_msgs/FollowJointTrajectory_SendGoal": (
        "unique_identifier_msgs/UUID goal_id\ncontrol_msgs/FollowJointTrajectory_Goal goal",
        "bool accepted\nbuiltin_interfaces/Time stamp",
    ),
    "control_msgs/FollowJointTrajectory_GetResult": (
        "unique_identifier_msgs/UUID goal_id",
        "int8 status\ncontrol_msgs/FollowJointTrajectory_Result result",
    ),
}
"""Fields of request and response of each service, by package and name."""

MORE_FIELDS: dict[str, str] = {
    "sensor_msgs/Range": (
        "uint8 ULTRASOUND=0\nuint8 INFRARED=1\nstd_msgs/Header header\nuint8 radiation_type\n"
        "float32 field_of_view\nfloat32 min_range\nfloat32 max_range\nfloat32 range\n"
        "float32 variance"
    ),
    "rcl_interfaces/ParameterValue": (
        "uint8 type\nbool bool_value\nint64 integer_value\nfloat64 double_value\n"
        "string string_value\nbyte[] byte_array_value\nbool[] bool_array_value\n"
        "int64[] integer_array_value\nfloat64[] double_array_value\nstring[] string_array_value"
    ),
    "rcl_interfaces/Parameter": "string name\nrcl_interfaces/ParameterValue value",
    "rcl_interfaces/SetParametersResult": "bool successful\nstring reason",
    "service_msgs/ServiceEventInfo": (
        "uint8 event_type\nbuiltin_interfaces/Time stamp\nchar[16] client_gid\n"
        "int64 sequence_number"
    ),
    "control_msgs/JointTolerance": (
        "string name\nfloat64 position\nfloat64 velocity\nfloat64 acceleration"
    ),
    "control_msgs/JointComponentTolerance": (
        "uint16 X_AXIS=1\nuint16 Y_AXIS=2\nuint16 Z_AXIS=3\nuint16 TRANSLATION=4\n"
        "uint16 ROTATION=5\nstring joint_name\nuint16 component\nfloat64 position\n"
        "float64 velocity\nfloat64 acceleration"
    ),
    "control_msgs/FollowJointTrajectory_Goal": (
        "trajectory_msgs/JointTrajectory trajectory\n"
        "trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory\n"
        "control_msgs/JointTolerance[] path_tolerance\n"
        "control_msgs/JointComponentTolerance[] component_path_tolerance\n"
        "control_msgs/JointTolerance[] goal_tolerance\n"
        "control_msgs/JointComponentTolerance[] component_goal_tolerance\n"
        "builtin_interfaces/Duration goal_time_tolerance"
    ),
    "control_msgs/FollowJointTrajectory_Result": (
        "int32 SUCCESSFUL=0\nint32 INVALID_GOAL=-1\nint32 INVALID_JOINTS=-2\n"
        "int32 OLD_HEADER_TIMESTAMP=-3\nint32 PATH_TOLERANCE_VIOLATED=-4\n"
        "int32 GOAL_TOLERANCE_VIOLATED=-5\nint32 error_code\nstring error_string"
    ),
    "control_msgs/FollowJointTrajectory_Feedback": (
        "std_msgs/Header header\nstring[] joint_names\n"
        "trajectory_msgs/JointTrajectoryPoint desired\n"
        "trajectory_msgs/JointTrajectoryPoint actual\n"
        "trajectory_msgs/JointTrajectoryPoint error\n"
        "string[] multi_dof_joint_names\n"
        "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_desired\n"
        "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_actual\n"
        "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error"
    ),
    "control_msgs/FollowJointTrajectory_FeedbackMessage": (
        "unique_identifier_msgs/UUID goal_id\ncontrol_msgs/FollowJointTrajectory_Feedback feedback"
    ),
}
"""Fields of what services and actions consist of, and of ``Range`` as it is since ROS 2 Iron."""

ALL_FIELDS = {
    **FIELDS,
    **MORE_FIELDS,
    **{
        f"{service}_{part}": text
        for service, parts in SERVICES.items()
        for part, text in zip(("Request", "Response"), parts, strict=True)
    },
}
"""Fields of each type, by package and name."""

_TYPE_IDS = {
    "int8": 2,
    "uint8": 3,
    "int16": 4,
    "uint16": 5,
    "int32": 6,
    "uint32": 7,
    "int64": 8,
    "uint64": 9,
    "float32": 10,
    "float64": 11,
    "char": 3,
    "bool": 15,
    "byte": 16,
    "string": 17,
}
"""Numbers of ``type_description_interfaces/FieldType``; a char of a .msg file is a uint8."""
_NESTED, _ARRAY, _BOUNDED, _UNBOUNDED = 1, 48, 96, 144


def full_name(name: str) -> str:
    """Return the name of a type with its kind, as in ``nav_msgs/msg/Odometry``.

    Args:
        name: package/Name.
    """
    package, _, short = name.partition("/")
    if "FollowJointTrajectory" in short:
        kind = "action"
    elif name in SERVICES or (short.rpartition("_")[0] and f"{package}/{_stem(short)}" in SERVICES):
        kind = "srv"
    else:
        kind = "msg"
    return f"{package}/{kind}/{short}"


def dds_name(name: str) -> str:
    """Return the name of a type on the wire, as in ``nav_msgs::msg::dds_::Odometry_``."""
    package, kind, short = full_name(name).split("/")
    return f"{package}::{kind}::dds_::{short}_"


@cache
def type_hash(name: str) -> str:
    """Return the hash of a message or service by package/Name, as in ``RIHS01_3cc9...``."""
    if name in SERVICES:
        top = _describe(name, _service_fields(name))
        pending = [field["type"]["nested_type_name"] for field in top["fields"]]
    else:
        top, pending = _describe_named(name)
    referenced: dict[str, dict[str, Any]] = {}
    while pending:
        nested = pending.pop()
        if nested not in referenced:
            described, more = _describe_named(_short_name(nested))
            referenced[nested] = described
            pending += more
    whole = {
        "type_description": top,
        "referenced_type_descriptions": [referenced[key] for key in sorted(referenced)],
    }
    text = json.dumps(
        whole, skipkeys=False, ensure_ascii=True, separators=(", ", ": "), sort_keys=False
    )
    return f"RIHS01_{hashlib.sha256(text.encode()).hexdigest()}"


def _stem(short: str) -> str:
    return re.sub(r"_(Request|Response|Event)$", "", short)


def _short_name(full: str) -> str:
    package, _, short = full.split("/")
    return f"{package}/{short}"


def _service_fields(name: str) -> list[tuple[str, str]]:
    return [
        ("request_message", f"{name}_Request"),
        ("response_message", f"{name}_Response"),
        ("event_message", f"{name}_Event"),
    ]


def _message_fields(name: str) -> list[tuple[str, str]]:
    """Return names and types of a message's fields, without constants and defaults."""
    if name.endswith("_Event"):
        service = name.removesuffix("_Event")
        return [
            ("info", "service_msgs/ServiceEventInfo"),
            ("request", f"{service}_Request[<=1]"),
            ("response", f"{service}_Response[<=1]"),
        ]
    rows = [line.split()[:2] for line in ALL_FIELDS[name].splitlines() if "=" not in line]
    return [(field, kind) for kind, field in rows]


def _describe_named(name: str) -> tuple[dict[str, Any], list[str]]:
    """Return the description of a type, and the full names of the types in it."""
    described = _describe(name, _message_fields(name))
    nested = [field["type"]["nested_type_name"] for field in described["fields"]]
    return described, [full for full in nested if full]


def _describe(name: str, fields: list[tuple[str, str]]) -> dict[str, Any]:
    described = [{"name": field, "type": _field_type(kind)} for field, kind in fields]
    return {"type_name": full_name(name), "fields": described}


def _field_type(kind: str) -> dict[str, object]:
    match = re.fullmatch(r"([\w/]+)(?:\[(<=)?(\d*)\])?", kind)
    if match is None:
        raise ValueError(f"{kind}: no type of a field")
    base, bounded, size = match[1], match[2], match[3]
    is_nested = "/" in base
    offset = 0
    if size is not None:
        offset = _BOUNDED if bounded else _ARRAY if size else _UNBOUNDED
    return {
        "type_id": (_NESTED if is_nested else _TYPE_IDS[base]) + offset,
        "capacity": int(size) if size else 0,
        "string_capacity": 0,
        "nested_type_name": full_name(base) if is_nested else "",
    }
