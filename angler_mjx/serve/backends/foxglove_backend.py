"""Topics and services over the WebSocket of Foxglove, for people who look; clients may publish."""

import json
import threading
import time
from collections.abc import Callable
from typing import Any, cast

from angler_mjx.errors import ConfigError, UnsupportedError
from angler_mjx.report.interop.ros_definitions import message_definition
from angler_mjx.report.interop.ros_encoding import find_encoder
from angler_mjx.report.interop.ros_types import ALL_FIELDS, full_name
from angler_mjx.serve.backends.interface import ACTION, Answer, Receive, Service, Topic

_ANSWER_S = 60.0
"""Maximum wall time of a service."""
_LATCH_S = 0.1
"""Wall time from a subscription to the messages that late listeners receive."""


class FoxgloveBackend:
    """Server of the WebSocket."""

    def __init__(self, address: str, port: int) -> None:
        """Listen.

        Args:
            address: of the interface to listen at.
            port: of TCP.

        Raises:
            ConfigError: the address or port cannot be used.
            UnsupportedError: foxglove-sdk is not installed.
        """
        try:
            import foxglove
        except ImportError as error:
            raise UnsupportedError(
                "--foxglove needs foxglove-sdk: pip install 'angler-mjx[live]'"
            ) from error
        self._foxglove, self._context = foxglove, foxglove.Context()
        self._listener = _Listener(self._send_latched)
        try:
            self._server = foxglove.start_server(
                name="angler",
                host=address,
                port=port,
                capabilities=[
                    foxglove.Capability.ClientPublish,
                    foxglove.Capability.Services,
                    foxglove.Capability.Time,
                ],
                server_listener=cast(Any, self._listener),  # without parameters and graphs
                supported_encodings=["cdr", "json"],
                context=self._context,
            )
        except Exception as error:  # the library has no type for it
            raise ConfigError(
                f"--foxglove-port {port}: ws://{address}:{port} cannot be used: {error}; give "
                "another --foxglove-port, and end the other door if there is one"
            ) from error
        self.address = f"ws://{address}:{port}"
        self.missing: tuple[str, ...] = (ACTION,)
        self._channels: dict[str, Any] = {}
        self._latched: dict[str, bytes | None] = {}

    def declare_topic(self, topic: Topic) -> None:
        """See `Backend.declare_topic`."""
        self._channels[topic.name] = self._foxglove.Channel(
            topic.name,
            schema=self._build_schema(topic.message),
            message_encoding="cdr",
            context=self._context,
        )
        if topic.latched:
            self._latched[topic.name] = None

    def is_wanted(self, name: str) -> bool:
        """See `Backend.is_wanted`."""
        return name in self._latched or bool(self._channels[name].has_sinks())

    def publish(self, name: str, data: bytes, time_ns: int, wall_ns: int) -> None:
        """See `Backend.publish`."""
        if name == "/clock":
            self._server.broadcast_time(time_ns)
        if name in self._latched:
            self._latched[name] = data
        self._channels[name].log(data, log_time=time_ns)

    def subscribe(self, topic: Topic, receive: Receive) -> None:
        """See `Backend.subscribe`."""
        self._listener.receivers[topic.name] = (topic.message, receive)

    def serve(self, service: Service, answer: Answer) -> None:
        """See `Backend.serve`."""

        def handle(request: Any) -> bytes:
            answered, box = threading.Event(), [b""]

            def reply(data: bytes) -> None:
                box[0] = data
                answered.set()

            answer(request.payload, reply)
            if not answered.wait(_ANSWER_S):
                raise TimeoutError(f"{service.name}: no answer within {_ANSWER_S:g} s")
            return box[0]

        parts = {
            part: self._foxglove.MessageSchema(
                encoding="cdr", schema=self._build_schema(f"{service.kind}_{part.capitalize()}")
            )
            for part in ("request", "response")
        }
        schema = self._foxglove.ServiceSchema(full_name(service.kind), **parts)
        self._server.add_services(
            [self._foxglove.Service(service.name, schema=schema, handler=handle)]
        )

    def close(self) -> None:
        """See `Backend.close`."""
        self._server.stop()

    def _build_schema(self, name: str) -> Any:
        return self._foxglove.Schema(
            name=full_name(name),
            encoding="ros2msg",
            data=message_definition(name, ALL_FIELDS).encode(),
        )

    def _send_latched(self, name: str) -> None:
        """Send the last message of a topic to a listener that has just subscribed."""
        if (data := self._latched.get(name)) is None:
            return

        def send() -> None:
            time.sleep(_LATCH_S)
            self._channels[name].log(data, log_time=0)

        threading.Thread(target=send, daemon=True).start()


class _Listener:
    """Receiver of what clients publish: CDR, or JSON with the fields of the message."""

    def __init__(self, subscribed: Callable[[str], None]) -> None:
        self.receivers: dict[str, tuple[str, Receive]] = {}
        self._subscribed = subscribed
        self._channels: dict[tuple[int, int], tuple[str, str]] = {}

    def on_subscribe(self, client: Any, channel: Any) -> None:
        self._subscribed(channel.topic)

    def on_unsubscribe(self, client: Any, channel: Any) -> None:
        pass

    def on_client_advertise(self, client: Any, channel: Any) -> None:
        self._channels[client.id, channel.id] = (channel.topic, channel.encoding)

    def on_client_unadvertise(self, client: Any, client_channel_id: int) -> None:
        self._channels.pop((client.id, client_channel_id), None)

    def on_message_data(self, client: Any, client_channel_id: int, data: bytes) -> None:
        topic, encoding = self._channels.get((client.id, client_channel_id), ("", ""))
        if topic not in self.receivers:
            return
        message, receive = self.receivers[topic]
        receive(_encode_json(message, data) if encoding == "json" else data)


def _encode_json(message: str, data: bytes) -> bytes:
    """Return JSON as CDR; bytes that no decoder takes if it is no such message."""
    try:
        return bytes(find_encoder(message)(json.loads(data)))
    except Exception:  # refused and counted as any other message
        return b""
