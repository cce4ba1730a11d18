"""Bag of ROS 2 messages in the MCAP format, complete for ROS 2 and Foxglove."""

from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Self

from mcap.well_known import SchemaEncoding
from mcap.writer import Writer

from angler_mjx.report.interop.ros_definitions import message_definition
from angler_mjx.report.interop.ros_encoding import Encoder, find_encoder

_KEEP_LAST, _RELIABLE, _TRANSIENT_LOCAL, _VOLATILE, _AUTOMATIC = 1, 1, 1, 2, 1
"""Values of ``rmw_qos_profile_t``; as numbers every ROS 2 since Humble reads them."""

_FOREVER = "{sec: 9223372036, nsec: 854775807}"


class Bag:
    """Writer of messages, each a table of its fields; missing fields are 0 or empty.

    The writer of ``mcap-ros2-support`` cannot mark topics as latched for late listeners.
    """

    def __init__(self, path: Path) -> None:
        """Open a new file; an existing one is overwritten."""
        self._file = path.open("wb")
        self._writer = Writer(self._file)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, tuple[int, Encoder]] = {}
        self._writer.start(profile="ros2", library="angler-mjx")

    def __enter__(self) -> Self:
        """Start writing and return the bag itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the file, with its index unless an error occurred."""
        try:
            if kind is None:
                self._writer.finish()
        finally:
            self._file.close()

    def declare_topic(self, name: str, message: str, *, latched: bool = False) -> None:
        """Declare a topic, before its first message.

        Args:
            name: of the topic.
            message: package/Name.
            latched: whether late listeners receive the last message too.
        """
        if message not in self._schemas:
            text, full = message_definition(message), message.replace("/", "/msg/")
            self._schemas[message] = self._writer.register_schema(
                full, SchemaEncoding.ROS2, text.encode()
            )
        channel = self._writer.register_channel(
            topic=name,
            message_encoding="cdr",
            schema_id=self._schemas[message],
            metadata={"offered_qos_profiles": _qos_profile(latched=latched)},
        )
        self._channels[name] = channel, find_encoder(message)

    def write(self, topic: str, time_ns: int, message: Mapping[str, object]) -> None:
        """Write a message.

        Args:
            topic: declared before.
            time_ns: time of sending, ns.
            message: its fields.
        """
        channel, encode = self._channels[topic]
        self._writer.add_message(
            channel_id=channel, log_time=time_ns, publish_time=time_ns, data=encode(message)
        )


def _qos_profile(*, latched: bool) -> str:
    """Return a topic's quality of service, as rosbag2 writes it beside a channel."""
    return "\n".join(
        [
            f"- history: {_KEEP_LAST}",
            f"  depth: {1 if latched else 10}",
            f"  reliability: {_RELIABLE}",
            f"  durability: {_TRANSIENT_LOCAL if latched else _VOLATILE}",
            f"  deadline: {_FOREVER}",
            f"  lifespan: {_FOREVER}",
            f"  liveliness: {_AUTOMATIC}",
            f"  liveliness_lease_duration: {_FOREVER}",
            "  avoid_ros_namespace_conventions: false",
        ]
    )
