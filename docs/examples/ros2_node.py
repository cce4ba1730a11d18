"""Drive eight robots over ROS 2: each flies a circle, and turns up or down at its depth."""

import math
import sys
from functools import partial

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.node import Node

ROBOTS, SPEED_MPS, TURN_RADPS, PERIOD_S = 8, 0.3, 0.25, 0.05


class CircleFleet(Node):
    """Node that reads the odometry of each robot and sends its velocity."""

    def __init__(self, robots: int) -> None:
        super().__init__("circle_fleet")
        self.depths, self.z = {}, {}
        self.velocity = []
        for i in range(robots):
            root = f"/robot_{i}"
            self.velocity.append(self.create_publisher(Twist, f"{root}/cmd_vel", 10))
            self.create_subscription(Odometry, f"{root}/odometry", partial(self.see, i), 10)
        self.create_timer(PERIOD_S, self.command)

    def see(self, i: int, odometry: Odometry) -> None:
        """Keep the height of a robot; the first one is where it stays."""
        self.z[i] = odometry.pose.pose.position.z
        self.depths.setdefault(i, self.z[i])

    def command(self) -> None:
        """Send a velocity to each robot that was seen: forward, round, and back to its depth."""
        for i, z in self.z.items():
            twist = Twist()
            twist.linear.x = SPEED_MPS
            twist.linear.z = max(-0.1, min(0.1, self.depths[i] - z))
            twist.angular.z = math.copysign(TURN_RADPS, i % 2 - 0.5)
            self.velocity[i].publish(twist)


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(CircleFleet(int(sys.argv[1]) if len(sys.argv) > 1 else ROBOTS))
