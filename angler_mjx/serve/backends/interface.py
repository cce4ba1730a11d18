"""Interface of transports: bytes of topics and services, whatever carries them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

NODE = "angler"
"""Name of the node."""
ACTION = "control_msgs/FollowJointTrajectory"
"""Type of the robots' action."""


@dataclass(frozen=True, kw_only=True)
class Topic:
    """Topic of one type."""

    name: str
    message: str
    """package/Name."""
    latched: bool = False
    """Whether late listeners receive the last message."""


@dataclass(frozen=True, kw_only=True)
class Service:
    """Service of one type."""

    name: str
    kind: str
    """package/Name."""


type Receive = Callable[[bytes], None]
"""Receiver of a message's bytes, called in a thread of the transport."""

type Reply = Callable[[bytes], None]
"""Sender of the answer to a request, once, from any thread."""

type Answer = Callable[[bytes, Reply], None]
"""Receiver of a request's bytes and its reply, called in a thread of the transport."""


class Backend(Protocol):
    """Open transport."""

    @property
    def address(self) -> str:
        """Return where it can be reached, for a person."""
        ...

    @property
    def missing(self) -> tuple[str, ...]:
        """Return the names of types that it has not, whose topics and services it leaves out."""
        ...

    def declare_topic(self, topic: Topic) -> None:
        """Declare a topic before its first message."""
        ...

    def is_wanted(self, name: str) -> bool:
        """Return whether a message of a declared topic has a listener, now or later."""
        ...

    def publish(self, name: str, data: bytes, time_ns: int, wall_ns: int) -> None:
        """Send a message without waiting for slow listeners.

        Args:
            name: declared topic.
            data: CDR with its header.
            time_ns: time of the scene.
            wall_ns: wall time at which the content was valid, since 1970.
        """
        ...

    def subscribe(self, topic: Topic, receive: Receive) -> None:
        """Receive the messages of a topic."""
        ...

    def serve(self, service: Service, answer: Answer) -> None:
        """Answer the requests of a service."""
        ...

    def close(self) -> None:
        """Close all sockets."""
        ...
