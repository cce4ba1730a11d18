"""Topics and services of a ROS 2 node, where rclpy can be imported.

Messages travel as the bytes of the project's encoder. Types that the installation of ROS lacks are
left out.
"""

import fcntl
import os
import tempfile
import threading
import time
from importlib import import_module
from pathlib import Path
from typing import Any, TextIO

from angler_mjx.errors import ConfigError, UnsupportedError
from angler_mjx.report.interop.ros_types import full_name
from angler_mjx.serve.backends.interface import ACTION, NODE, Answer, Receive, Service, Topic

PROFILE = "FASTDDS_DEFAULT_PROFILES_FILE"
_DISCOVERY_S = 1.0
"""Wall time to find a door on another machine; one on this machine holds the lock."""
_OPTIONAL = (
    "tf2_msgs/TFMessage",
    "visualization_msgs/MarkerArray",
    "diagnostic_msgs/DiagnosticArray",
    "sensor_msgs/Range",
    "std_srvs/Trigger",
    "std_srvs/SetBool",
    "rcl_interfaces/SetParameters",
    f"{ACTION}_SendGoal",
)
"""Types that some installations lack."""


class RclpyBackend:
    """Node of ROS 2."""

    def __init__(self, *, is_local: bool = True) -> None:
        """Start the node.

        Args:
            is_local: whether only nodes of this machine can find it.

        Raises:
            ConfigError: there is such a node already.
            UnsupportedError: rclpy cannot be imported.
        """
        try:
            import rclpy
            from rclpy.callback_groups import ReentrantCallbackGroup
            from rclpy.executors import SingleThreadedExecutor
        except ImportError as error:
            raise UnsupportedError(
                f"--backend rclpy needs an installation of ROS 2 in this Python: {error}"
            ) from error
        middleware = rclpy.get_rmw_implementation_identifier()
        if is_local:
            _keep_local(middleware)
        self._domain = os.environ.get("ROS_DOMAIN_ID") or "0"
        self._lock = _lock_domain(self._domain)
        self._context = rclpy.Context()
        self._context.init()
        self._node: Any = rclpy.create_node(
            NODE, context=self._context, start_parameter_services=False
        )
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        # Requests that wait, such as that of a result, hold up no other.
        self._group = ReentrantCallbackGroup()
        self._publishers: dict[str, Any] = {}
        self.missing: tuple[str, ...] = self._list_missing()
        self._require_alone()
        reach = "this machine alone" if is_local else "the network"
        self.address = f"ROS 2 node /{NODE}, domain {self._domain}, {middleware}, {reach}"
        self._thread = threading.Thread(target=self._spin, name="rclpy", daemon=True)
        self._thread.start()

    def declare_topic(self, topic: Topic) -> None:
        """See `Backend.declare_topic`."""
        kind = _find_class(topic.message)
        if kind is not None:
            profile = self._quality(latched=topic.latched)
            self._publishers[topic.name] = self._node.create_publisher(kind, topic.name, profile)

    def is_wanted(self, name: str) -> bool:
        """See `Backend.is_wanted`."""
        publisher = self._publishers.get(name)
        return publisher is not None and (
            publisher.qos_profile.durability == self._latched_durability()
            or publisher.get_subscription_count() > 0
        )

    def publish(self, name: str, data: bytes, time_ns: int, wall_ns: int) -> None:
        """See `Backend.publish`."""
        publisher = self._publishers.get(name)
        if publisher is not None and self._context.ok():
            publisher.publish(data)

    def subscribe(self, topic: Topic, receive: Receive) -> None:
        """See `Backend.subscribe`."""
        kind = _find_class(topic.message)
        if kind is not None:
            profile = self._quality(latched=False)
            self._node.create_subscription(kind, topic.name, receive, profile, raw=True)

    def serve(self, service: Service, answer: Answer) -> None:
        """See `Backend.serve`."""
        from rclpy.serialization import deserialize_message, serialize_message
        from rclpy.task import Future

        kind = _find_class(service.kind)
        if kind is None:
            return

        async def handle(request: Any, _: Any) -> Any:
            answered = Future(executor=self._executor)

            def reply(data: bytes) -> None:
                answered.set_result(data)
                self._executor.wake()

            answer(serialize_message(request), reply)
            return deserialize_message(await answered, kind.Response)

        self._node.create_service(kind, service.name, handle, callback_group=self._group)

    def close(self) -> None:
        """See `Backend.close`."""
        self._executor.shutdown(timeout_sec=2.0)
        self._node.destroy_node()
        self._context.try_shutdown()
        self._thread.join(timeout=2.0)
        self._lock.close()

    def _spin(self) -> None:
        from rclpy.executors import ExternalShutdownException

        try:
            self._executor.spin()
        except ExternalShutdownException:
            return

    def _list_missing(self) -> tuple[str, ...]:
        missing = [kind for kind in _OPTIONAL if _find_class(kind) is None]
        return tuple(ACTION if kind == f"{ACTION}_SendGoal" else kind for kind in missing)

    def _require_alone(self) -> None:
        """Refuse to start beside a node of the same name, whose topics would be mixed."""
        end_s = time.monotonic() + _DISCOVERY_S
        while time.monotonic() < end_s:
            if self._node.get_node_names().count(NODE) > 1:
                self._close_node()
                raise _build_fault(self._domain)
            time.sleep(0.05)

    def _close_node(self) -> None:
        """Close a node that does not spin."""
        self._node.destroy_node()
        self._context.try_shutdown()
        self._lock.close()

    def _latched_durability(self) -> Any:
        from rclpy.qos import DurabilityPolicy

        return DurabilityPolicy.TRANSIENT_LOCAL

    def _quality(self, *, latched: bool) -> Any:
        from rclpy.qos import QoSProfile

        if latched:
            return QoSProfile(depth=1, durability=self._latched_durability())
        return QoSProfile(depth=10)


def _lock_domain(domain: str) -> TextIO:
    """Return a file that is locked until it is closed: discovery may take seconds.

    Raises:
        ConfigError: another door holds it.
    """
    path = Path(tempfile.gettempdir()) / f"angler-serve-{os.getuid()}-{domain}.lock"
    file = path.open("w")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        file.close()
        raise _build_fault(domain) from error
    return file


def _build_fault(domain: str) -> ConfigError:
    return ConfigError(
        f"there is a ROS 2 node /{NODE} in domain {domain} already: end that door, or set another "
        "ROS_DOMAIN_ID"
    )


def _keep_local(middleware: str) -> None:
    """Let only nodes of this machine find ours, unless the environment says otherwise.

    The discovery range ``LOCALHOST`` leaves sockets of Fast DDS at all interfaces; a profile does
    not.
    """
    ours = str(Path(__file__).parent / "profiles" / "loopback.xml")
    is_fast = middleware.startswith("rmw_fastrtps")
    if not is_fast or os.environ.setdefault(PROFILE, ours) != ours:
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


def _find_class(name: str) -> Any:
    """Return the class of a message or service; None if this installation lacks it."""
    package, kind, short = full_name(name).split("/")
    try:
        module = import_module(f"{package}.{kind}")
    except ImportError:
        return None
    action, _, part = short.rpartition("_")
    if kind == "action" and part in ("SendGoal", "GetResult"):
        return getattr(getattr(module, action).Impl, f"{part}Service", None)
    if kind == "action" and part == "FeedbackMessage":
        return getattr(module, action).Impl.FeedbackMessage
    return getattr(module, short, None)
