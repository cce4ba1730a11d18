"""ROS 2 messages as tables of their fields, from arrays in the frames of this project.

Nothing is rotated: ROS's world frame (REP 103: x east, y north, z up) is W, and its body frame
(x forward, y left, z up) is F. Only a quaternion's scalar moves from first to last.
"""

from collections.abc import Sequence

import numpy as np

from angler_mjx.robot.control.commands.joint_goal import JointGoal

type Message = dict[str, object]
"""Fields by name; missing fields are 0 or empty."""

NANO = 1_000_000_000

CUBE, SPHERE, CYLINDER, LINE_LIST, CUBE_LIST, SPHERE_LIST, TEXT = 1, 2, 3, 5, 6, 7, 9
"""Kinds of ``visualization_msgs/Marker``."""


def to_nanoseconds(time_s: float) -> int:
    """Convert a time to whole nanoseconds."""
    return round(time_s * NANO)


def make_stamp(time_s: float) -> Message:
    """Return a time as ``builtin_interfaces/Time`` or ``Duration``."""
    sec, nanosec = divmod(to_nanoseconds(time_s), NANO)
    return {"sec": sec, "nanosec": nanosec}


def make_header(time_s: float, frame: str) -> Message:
    """Return a ``std_msgs/Header``."""
    return {"stamp": make_stamp(time_s), "frame_id": frame}


def make_vector(values: np.ndarray) -> Message:
    """Return [3] as ``geometry_msgs/Point`` or ``Vector3``."""
    return dict(zip("xyz", values.tolist(), strict=True))


def make_quaternion(q: np.ndarray) -> Message:
    """Return [4] wxyz as ``geometry_msgs/Quaternion``."""
    return dict(zip("wxyz", q.tolist(), strict=True))


def make_pose(p: np.ndarray, q: np.ndarray | None = None) -> Message:
    """Return position [3] and attitude [4] wxyz as ``geometry_msgs/Pose``; default level."""
    level: Message = {"w": 1.0}
    return {"position": make_vector(p), "orientation": level if q is None else make_quaternion(q)}


def make_odometry(
    time_s: float, frame: str, child: str, p: np.ndarray, q: np.ndarray, nu: np.ndarray
) -> Message:
    """Return a robot's true motion as ``nav_msgs/Odometry``: covariances are 0.

    Args:
        time_s: of the sample.
        frame: of the pose.
        child: of the velocity, the robot's own.
        p: [3] m in W.
        q: [4] F to W.
        nu: [6] velocity over ground in F.
    """
    twist = {"linear": make_vector(nu[:3]), "angular": make_vector(nu[3:])}
    return {
        "header": make_header(time_s, frame),
        "child_frame_id": child,
        "pose": {"pose": make_pose(p, q), "covariance": [0.0] * 36},
        "twist": {"twist": twist, "covariance": [0.0] * 36},
    }


def make_transform(
    time_s: float, frame: str, child: str, p: np.ndarray, q: np.ndarray | None = None
) -> Message:
    """Return the pose of a child frame as ``geometry_msgs/TransformStamped``."""
    turn: Message = {"w": 1.0} if q is None else make_quaternion(q)
    return {
        "header": make_header(time_s, frame),
        "child_frame_id": child,
        "transform": {"translation": make_vector(p), "rotation": turn},
    }


def make_joint_state(
    time_s: float, names: Sequence[str], position: np.ndarray, velocity: np.ndarray
) -> Message:
    """Return positions [J] and speeds [J] of joints as ``sensor_msgs/JointState``."""
    return {
        "header": make_header(time_s, ""),
        "name": list(names),
        "position": position.tolist(),
        "velocity": velocity.tolist(),
        "effort": [],
    }


def make_path(frame: str, time_s: np.ndarray, points_m: np.ndarray) -> Message:
    """Return way-points [n, 3] at times [n] as ``nav_msgs/Path``."""
    poses = [
        {"header": make_header(float(t), frame), "pose": make_pose(p)}
        for t, p in zip(time_s, points_m, strict=True)
    ]
    return {"header": make_header(0.0, frame), "poses": poses}


def joint_trajectory(goal: JointGoal, frame: str = "") -> Message:
    """Return a goal as ``trajectory_msgs/JointTrajectory``."""
    return {
        "header": make_header(goal.stamp_s, frame),
        "joint_names": list(goal.joint_names),
        "points": [
            {
                "positions": list(point.positions),
                "velocities": list(point.velocities),
                "accelerations": list(point.accelerations),
                "effort": [],
                "time_from_start": make_stamp(point.time_s),
            }
            for point in goal.points
        ],
    }


def thruster_pwm(pwm_us: np.ndarray) -> Message:
    """Return signals [n] of a robot's thrusters, us, as ``std_msgs/UInt16MultiArray``."""
    size = pwm_us.size
    return {
        "layout": {"dim": [{"label": "thruster_pwm_us", "size": size, "stride": size}]},
        "data": pwm_us.tolist(),
    }


def make_marker(
    head: Message,
    name: str,
    index: int,
    kind: int,
    pose: Message,
    scale_m: Sequence[float],
    rgba: Sequence[float],
    points_m: np.ndarray | None = None,
    colors: np.ndarray | None = None,
    text: str = "",
) -> Message:
    """Return a ``visualization_msgs/Marker`` that stays until it is replaced.

    Args:
        head: its header.
        name: its namespace.
        index: its number in the namespace.
        kind: one of the kinds above.
        pose: its pose.
        scale_m: [3] size, or that of each point's body; of lines the first is their width, of text
            the last its height.
        rgba: [4] colour.
        points_m: [n, 3] of a list, in the frame of the pose.
        colors: [n, 4] of its points, if they differ.
        text: of TEXT, which faces the viewer and moves with its frame.
    """
    return {
        "header": head,
        "ns": name,
        "id": index,
        "type": kind,
        "pose": pose,
        "scale": dict(zip("xyz", map(float, scale_m), strict=True)),
        "color": dict(zip("rgba", rgba, strict=True)),
        "frame_locked": kind == TEXT,
        "points": [] if points_m is None else [make_vector(point) for point in points_m],
        "colors": []
        if colors is None
        else [dict(zip("rgba", row, strict=True)) for row in colors.tolist()],
        "text": text,
    }
