"""Topics and services over Zenoh, in the format of ``rmw_zenoh_cpp``.

The process is the router that nodes with ``RMW_IMPLEMENTATION=rmw_zenoh_cpp`` connect to; without
ROS, any client of Zenoh reads the same keys. Multicast is off.
"""

import os
import secrets
import struct
import time
from typing import Any

from angler_mjx.errors import ConfigError, UnsupportedError
from angler_mjx.report.interop.ros_types import dds_name, type_hash
from angler_mjx.serve.backends.interface import NODE, Answer, Receive, Reply, Service, Topic

DEFAULT_PORT = 7447
"""Port at which ``rmw_zenoh_cpp`` expects its router."""

_QOS, _LATCHED_QOS = "::,10:,:,:,,", ":1:,1:,:,:,,"
"""Quality of service in liveliness tokens: keep the last 10, or the last for late listeners."""
_NODE_ID = 0
_BATCHES = 16
"""Batches of 64 KiB that wait for a listener, the most that Zenoh allows: two seconds of odometry
and IMU of eight robots at 50 Hz. What comes when they are full is lost."""


class ZenohBackend:
    """Router with the topics of one node."""

    def __init__(self, address: str, port: int, domain: int | None = None) -> None:
        """Listen.

        Args:
            address: of the interface to listen at.
            port: of TCP.
            domain: number of the ROS domain; that of ``ROS_DOMAIN_ID``, or 0, if left out.

        Raises:
            ConfigError: the address or port cannot be used.
            UnsupportedError: Zenoh is not installed.
        """
        try:
            import zenoh
        except ImportError as error:
            raise UnsupportedError(
                "--backend zenoh needs eclipse-zenoh: pip install 'angler-mjx[live]'"
            ) from error
        self._zenoh = zenoh
        self.address, self.missing = f"tcp/{address}:{port}", ()
        config = zenoh.Config()
        config.insert_json5("mode", '"router"')
        config.insert_json5("listen/endpoints", f'["{self.address}"]')
        config.insert_json5("scouting/multicast/enabled", "false")
        config.insert_json5("transport/link/tx/queue/size/data", str(_BATCHES))
        try:
            self._session: Any = zenoh.open(config)
        except zenoh.ZError as error:
            reason = "is in use" if "in use" in str(error) else f"cannot be used: {error}"
            raise ConfigError(
                f"--port {port}: {self.address} {reason}; give another --port, and end the other "
                "door if there is one"
            ) from error
        self._domain = int(os.environ.get("ROS_DOMAIN_ID") or 0) if domain is None else domain
        self._zid = str(self._session.zid())
        self._publishers: dict[str, _Publisher] = {}
        self._entities = 0
        self._kept: list[Any] = [
            self._session.liveliness().declare_token(
                f"@ros2_lv/{self._domain}/{self._zid}/{_NODE_ID}/{_NODE_ID}/NN/%/%/{NODE}"
            )
        ]

    def declare_topic(self, topic: Topic) -> None:
        """See `Backend.declare_topic`."""
        key = self._declare_entity("MP", topic.name, topic.message, latched=topic.latched)
        self._publishers[topic.name] = _Publisher(self._zenoh, self._session, key, topic)

    def is_wanted(self, name: str) -> bool:
        """See `Backend.is_wanted`."""
        return self._publishers[name].is_wanted

    def publish(self, name: str, data: bytes, time_ns: int, wall_ns: int) -> None:
        """See `Backend.publish`."""
        self._publishers[name].put(data, wall_ns)

    def subscribe(self, topic: Topic, receive: Receive) -> None:
        """See `Backend.subscribe`."""
        key = self._declare_entity("MS", topic.name, topic.message)
        self._kept.append(
            self._session.declare_subscriber(key, lambda sample: receive(sample.payload.to_bytes()))
        )

    def serve(self, service: Service, answer: Answer) -> None:
        """See `Backend.serve`."""
        key = self._declare_entity("SS", service.name, service.kind)

        def handle(query: Any) -> None:
            payload = b"" if query.payload is None else query.payload.to_bytes()
            answer(payload, _build_reply(query, key))

        self._kept.append(self._session.declare_queryable(key, handle, complete=True))

    def close(self) -> None:
        """See `Backend.close`."""
        self._session.close()

    def _declare_entity(self, letters: str, name: str, kind: str, *, latched: bool = False) -> str:
        """Declare an entity of the ROS graph, and return its key."""
        self._entities += 1
        type_name, digest = dds_name(kind), type_hash(kind)
        mangled, qos = name.replace("/", "%"), _LATCHED_QOS if latched else _QOS
        self._kept.append(
            self._session.liveliness().declare_token(
                f"@ros2_lv/{self._domain}/{self._zid}/{_NODE_ID}/{self._entities}/{letters}/%/%/"
                f"{NODE}/{mangled}/{type_name}/{digest}/{qos}"
            )
        )
        return f"{self._domain}/{name.lstrip('/')}/{type_name}/{digest}"


class _Publisher:
    """Publisher of one topic, with the attachments of ``rmw_zenoh_cpp``."""

    def __init__(self, zenoh: Any, session: Any, key: str, topic: Topic) -> None:
        self._count, self._gid, self._latched = 0, secrets.token_bytes(16), topic.latched
        # A listener that does not read is left behind; it never holds the scene up.
        options = {"congestion_control": zenoh.CongestionControl.DROP}
        self._matched = False
        if topic.latched:
            import zenoh.ext

            cache = zenoh.ext.CacheConfig(max_samples=1)
            self._publisher = zenoh.ext.declare_advanced_publisher(
                session, key, cache=cache, publisher_detection=True, **options
            )
            return
        self._publisher = session.declare_publisher(key, **options)
        self._listener = self._publisher.declare_matching_listener(self._match)

    @property
    def is_wanted(self) -> bool:
        return self._latched or self._matched

    def put(self, data: bytes, wall_ns: int) -> None:
        self._count += 1
        self._publisher.put(data, attachment=_build_attachment(self._count, wall_ns, self._gid))

    def _match(self, status: Any) -> None:
        self._matched = status.matching


def _build_attachment(count: int, wall_ns: int, gid: bytes) -> bytes:
    return struct.pack("<qqB", count, wall_ns, len(gid)) + gid


def _build_reply(query: Any, key: str) -> Reply:
    """Return the reply to a query, with the number and the sender of the request."""
    request = b"" if query.attachment is None else query.attachment.to_bytes()
    number = struct.unpack_from("<q", request)[0] if len(request) >= struct.calcsize("<q") else 0
    gid = request[17:] if len(request) > 17 else bytes(16)

    def reply(data: bytes) -> None:
        with query:  # its end reaches the client
            query.reply(key, data, attachment=_build_attachment(number, time.time_ns(), gid))

    return reply
