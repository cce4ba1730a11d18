"""Listen to a fleet over ROS 2: positions, clearances, and who came too near to rock.

In a first terminal: angler serve docs/examples/ros2_fleet.toml
"""

import math
import sys
from functools import partial

import rclpy
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import Range

NEAR_M = 0.5


class Listener(Node):
    """Node that keeps the last position [m], in W, and the least clearance [m] of each robot."""

    def __init__(self, robots: int) -> None:
        super().__init__("fleet_listener")
        self.position_m: dict[int, tuple[float, float, float]] = {}
        self.least_m = [math.inf] * robots
        for i in range(robots):
            root = f"/robot_{i}"
            self.create_subscription(Odometry, f"{root}/odometry", partial(self.see, i), 10)
            self.create_subscription(Range, f"{root}/clearance", partial(self.measure, i), 10)
        self.create_timer(1.0, self.report)

    def see(self, i: int, odometry: Odometry) -> None:
        """Keep the position of a robot."""
        p = odometry.pose.pose.position
        self.position_m[i] = (p.x, p.y, p.z)

    def measure(self, i: int, clearance: Range) -> None:
        """Keep the least clearance of a robot, and say so where it is small."""
        if clearance.range < min(NEAR_M, self.least_m[i]):
            self.get_logger().warning(f"robot {i}: {clearance.range:.2f} m from rock")
        self.least_m[i] = min(self.least_m[i], clearance.range)

    def report(self) -> None:
        """Log positions, once a second."""
        for i, (x, y, z) in sorted(self.position_m.items()):
            self.get_logger().info(f"robot {i}: {x:.1f} {y:.1f} {z:.1f} m")


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(Listener(int(sys.argv[1]) if len(sys.argv) > 1 else 8))
