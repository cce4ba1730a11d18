"""Names and types of the topics, services and actions of a session.

Names are those of MAVROS, ros2_control and Blue where these have one. Each robot has a namespace of
its name, ``/robot_0``.
"""

from collections.abc import Sequence

from angler_mjx.runs.session.interface import RobotInfo
from angler_mjx.serve.backends.interface import ACTION, NODE, Service, Topic

MAP_FRAME = "map"
TRAJECTORY_CONTROLLER = "joint_trajectory_controller"


_WORLD = (
    ("clock", "rosgraph_msgs/Clock", False),
    ("tf", "tf2_msgs/TFMessage", False),
    ("scenery", "visualization_msgs/MarkerArray", True),
    ("obstacles", "visualization_msgs/MarkerArray", False),
    ("diagnostics", "diagnostic_msgs/DiagnosticArray", False),
)
_ROBOT = (
    ("odometry", "nav_msgs/Odometry", False),
    ("local_position/odom", "nav_msgs/Odometry", False),
    ("imu/data", "sensor_msgs/Imu", False),
    ("imu/static_pressure", "sensor_msgs/FluidPressure", False),
    ("dvl/twist", "geometry_msgs/TwistWithCovarianceStamped", False),
    ("dvl/range", "sensor_msgs/Range", False),
    ("battery", "sensor_msgs/BatteryState", False),
    ("joint_states", "sensor_msgs/JointState", False),
    ("thruster_pwm_us", "std_msgs/UInt16MultiArray", False),
    ("clearance", "sensor_msgs/Range", False),
    ("current", "geometry_msgs/Vector3Stamped", False),
    ("goal", "geometry_msgs/PoseStamped", True),
    ("plan", "nav_msgs/Path", True),
)

SIMULATED = frozenset(
    ("imu/data", "imu/static_pressure", "dvl/twist", "dvl/range", "battery", "current")
)
"""Topics of a robot that only a simulation can give."""

SERVICES = (
    Service(name="/reset", kind="std_srvs/Trigger"),
    Service(name="/pause", kind="std_srvs/SetBool"),
    Service(name="/step", kind="std_srvs/Trigger"),
    Service(name=f"/{NODE}/set_parameters", kind="rcl_interfaces/SetParameters"),
)


def list_published(robots: Sequence[RobotInfo], *, has_instruments: bool = True) -> list[Topic]:
    """Return the topics that a session publishes, without those of actions.

    Args:
        robots: of the session.
        has_instruments: whether instruments, batteries and currents are simulated.
    """
    topics = [
        Topic(name=f"/{name}", message=message, latched=latched)
        for name, message, latched in _WORLD
    ]
    for robot in robots:
        topics += [
            Topic(name=f"/{robot.name}/{name}", message=message, latched=latched)
            for name, message, latched in _ROBOT
            if has_instruments or name not in SIMULATED
        ]
    return topics


def velocity_topic(robot: RobotInfo) -> Topic:
    """Return the topic of a robot's velocity over ground, in its body frame."""
    return Topic(name=f"/{robot.name}/cmd_vel", message="geometry_msgs/Twist")


def trajectory_topic(robot: RobotInfo) -> Topic:
    """Return the topic of a robot's JointTrajectories."""
    return Topic(
        name=f"/{robot.name}/{TRAJECTORY_CONTROLLER}/joint_trajectory",
        message="trajectory_msgs/JointTrajectory",
    )


def thruster_topic(robot: RobotInfo) -> Topic:
    """Return the topic of a robot's thruster signals, us."""
    return Topic(
        name=f"/{robot.name}/thruster_controller/commands", message="std_msgs/Float64MultiArray"
    )


def action_name(robot: RobotInfo) -> str:
    """Return the name of a robot's action FollowJointTrajectory."""
    return f"/{robot.name}/{TRAJECTORY_CONTROLLER}/follow_joint_trajectory"


def action_services(robot: RobotInfo) -> dict[str, Service]:
    """Return the services of a robot's action, by short name."""
    root = f"{action_name(robot)}/_action"
    return {
        "send_goal": Service(name=f"{root}/send_goal", kind=f"{ACTION}_SendGoal"),
        "cancel_goal": Service(name=f"{root}/cancel_goal", kind="action_msgs/CancelGoal"),
        "get_result": Service(name=f"{root}/get_result", kind=f"{ACTION}_GetResult"),
    }


def action_topics(robot: RobotInfo) -> dict[str, Topic]:
    """Return the topics of a robot's action, by short name."""
    root = f"{action_name(robot)}/_action"
    return {
        "feedback": Topic(name=f"{root}/feedback", message=f"{ACTION}_FeedbackMessage"),
        "status": Topic(name=f"{root}/status", message="action_msgs/GoalStatusArray", latched=True),
    }
