"""Publication of a session's messages in a thread of its own, beside the steps of the scene."""

import queue
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from angler_mjx.errors import RunError
from angler_mjx.report.interop import ros_messages as ros
from angler_mjx.report.interop.ros_encoding import find_encoder
from angler_mjx.runs.session.batch_session import SessionInternals
from angler_mjx.serve.backends.interface import Backend, Topic
from angler_mjx.serve.messages import Build, SceneMessages
from angler_mjx.serve.scene_view import SceneView

SWITCH_S = 5e-4
"""Time after which a thread of Python lets another run; by default it is ten times as long, which
messages would wait for."""
BACKLOG = 4
"""Number of steps that may wait for their publication; the next one waits."""


@dataclass(frozen=True, kw_only=True)
class _Reset:
    internals: SessionInternals
    seed: int
    view: SceneView


@dataclass(frozen=True, kw_only=True)
class _Step:
    view: SceneView
    notes: Sequence[dict[str, str]]


class Publisher:
    """Thread that turns views of the scene into messages, where anybody listens.

    Attributes:
        busy_s: CPU time of the thread.
        sent: number of messages handed to transports.
    """

    def __init__(
        self, messages: SceneMessages, topics: Sequence[Topic], backends: Sequence[Backend]
    ) -> None:
        """Declare the topics and start.

        Args:
            messages: builder of messages.
            topics: all topics that are published.
            backends: transports.
        """
        self._messages, self._backends = messages, backends
        self._kinds = {topic.name: topic.message for topic in topics}
        for backend in backends:
            for topic in topics:
                backend.declare_topic(topic)
        self._queue: queue.Queue[_Reset | _Step | None] = queue.Queue(BACKLOG)
        self._fault: BaseException | None = None
        self.busy_s, self.sent = 0.0, 0
        sys.setswitchinterval(SWITCH_S)
        self._thread = threading.Thread(target=self._work, name="publisher", daemon=True)
        self._thread.start()

    def reset(self, internals: SessionInternals, seed: int, view: SceneView) -> None:
        """Publish a scene at its reset: static messages as well."""
        self._put(_Reset(internals=internals, seed=seed, view=view))

    def step(self, view: SceneView, notes: Sequence[dict[str, str]]) -> None:
        """Publish a scene after a step."""
        self._put(_Step(view=view, notes=notes))

    def flush(self) -> None:
        """Wait until everything is handed to the transports.

        Raises:
            RunError: publication failed.
        """
        self._queue.join()
        self._require_sound()

    def publish(self, name: str, message: ros.Message, time_s: float) -> None:
        """Publish a message of a declared topic at once, in the calling thread."""
        self._send(name, message, ros.to_nanoseconds(time_s), time.time_ns())

    def close(self) -> None:
        """Publish what waits and end the thread."""
        self._queue.put(None)
        self._thread.join(timeout=5.0)

    def _put(self, item: _Reset | _Step) -> None:
        self._require_sound()
        self._queue.put(item)

    def _require_sound(self) -> None:
        if self._fault is not None:
            raise RunError(f"publication failed: {self._fault!r}") from self._fault

    def _work(self) -> None:
        while (item := self._queue.get()) is not None:
            try:
                if self._fault is None:
                    self._process(item)
            except BaseException as error:  # reported by the main thread
                self._fault = error
            finally:
                self._queue.task_done()
            self.busy_s = time.thread_time()

    def _process(self, item: _Reset | _Step) -> None:
        notes: Sequence[dict[str, str]]
        if isinstance(item, _Reset):
            self._messages.reset(item.internals, item.seed, item.view)
            notes = [{} for _ in item.view.observation.status]
            self._publish_all(self._messages.build_static(), item.view)
        else:
            notes = item.notes
        self._publish_all(self._messages.build_step(item.view, notes), item.view)

    def _publish_all(self, builders: Iterator[tuple[str, Build]], view: SceneView) -> None:
        time_ns = ros.to_nanoseconds(view.observation.time_s)
        for name, build in builders:
            wanting = [backend for backend in self._backends if backend.is_wanted(name)]
            if wanting and (message := build()) is not None:
                self._send(name, message, time_ns, view.wall_ns, wanting)

    def _send(
        self,
        name: str,
        message: ros.Message,
        time_ns: int,
        wall_ns: int,
        backends: Sequence[Backend] | None = None,
    ) -> None:
        data = bytes(find_encoder(self._kinds[name])(message))
        for backend in self._backends if backends is None else backends:
            backend.publish(name, data, time_ns, wall_ns)
            self.sent += 1
