"""Barrier between N autopilots and one scene: all autopilots get a reply, then the next step.

An autopilot sends a servo packet and waits for one reply; the reply's time becomes its clock. The
scene steps when all have sent, so no clock is ever more than a step ahead of another, and after
each step all agree. The autopilots do not pace themselves; a requested speed is kept here, once for
all of them.

A pulse's width is known at its end, and a pulse takes most of a step: the scene's step needs the
pulse widths of the packets before. The step runs while the autopilots work at their next packets,
so the reply to a packet is ready when it arrives.

Wall time is used for two things alone: that pace, and an autopilot that sends no more packets.
"""

import os
import socket
import struct
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from angler_mjx.errors import RunError
from angler_sitl.scene.motion import N_PULSES
from angler_sitl.scene.scene import AutopilotScene
from angler_sitl.wire import packets

POLL_S = 0.1
"""Wait for a silent autopilot before each check whether it still runs."""

RESEND_S = 1.0
"""An autopilot that waits sends the same packet again after 1.1 s of wall time."""

_MAX_LATENESS_S = 0.1
"""Max lag behind the pace that is caught up; a larger one is dropped."""

type Address = tuple[str, int]

_NO_ADDRESS: Address = ("", 0)


@dataclass(kw_only=True)
class LockStepTimes:
    """Wall time of the barriers by cause, s."""

    barriers: int = 0
    waiting_s: float = 0.0
    """Waiting for servo packets, and reading them: autopilot time beyond the scene's step."""
    physics_s: float = 0.0
    replies_s: float = 0.0
    """Writing and sending replies."""
    pacing_s: float = 0.0


class LockStep:
    """Lock-step of N autopilots and their scene.

    Attributes:
        pwm: int32 [N, 16] pulse widths of the last packet of each, us.
        lost: the lost autopilots, and why; only with ``on_crash = "hold"``.
        speed: simulated over wall time; None for as fast as possible. May be changed.
        spent: wall time by cause.
    """

    def __init__(
        self,
        sockets: Sequence[socket.socket],
        scene: AutopilotScene,
        *,
        names: Sequence[str],
        fault: Callable[[int], str | None],
        condition: Callable[[int], str] | None = None,
        speed: float | None = None,
        hang_s: float = 10.0,
        on_crash: Literal["end", "hold"] = "end",
    ) -> None:
        """Take over the sockets.

        Args:
            sockets: bound socket of each autopilot for its servo packets.
            scene: of the same number of vehicles.
            names: of the vehicles.
            fault: cause of an autopilot's end, by its index; None while it runs.
            condition: activity of an autopilot that runs but sends no packets.
            speed: simulated over wall time; None for as fast as possible.
            hang_s: wall time without a packet after which a running autopilot counts as hanging.
            on_crash: whether the loss of an autopilot ends the run, or only its vehicle's thrust.
        """
        self.pwm: NDArray[np.int32] = np.zeros((len(sockets), N_PULSES), np.int32)
        self.lost: dict[int, str] = {}
        self.speed, self.spent = speed, LockStepTimes()
        self._sockets, self._scene, self._names = list(sockets), scene, list(names)
        self._fault, self._condition, self._hang_s = fault, condition, hang_s
        self._on_crash = on_crash
        self._alive = list(range(len(self._sockets)))
        self._source: list[Address] = [_NO_ADDRESS] * len(self._sockets)
        self._frame = [-1] * len(self._sockets)
        self._text = [b""] * len(self._sockets)
        self._next = list(self._text)
        self._buffer = memoryview(bytearray(2 * packets.MAX_SERVO_BYTES))
        # With a core for each autopilot and for us, polling is quicker than being woken.
        self._spins = speed is None and len(self._sockets) < len(os.sched_getaffinity(0))
        self._pace_from_s, self._pace_time_s = time.perf_counter(), scene.time_s
        # Long ago: packets that gathered before the first reply are repeats of the first.
        self._answered_s = [-np.inf] * len(self._sockets)
        for bound_socket in self._sockets:
            # Blocking with the kernel's own time limit: Python's would cost a poll a packet.
            bound_socket.setblocking(True)
            limit = struct.pack("ll", 0, round(1e6 * POLL_S))
            bound_socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, limit)

    @property
    def time_s(self) -> float:
        """Clock of the scene and of all autopilots."""
        return self._scene.time_s

    def set_speed(self, speed: float | None) -> None:
        """Set the max speed, times real time; None for as fast as possible."""
        self.speed = speed
        self._pace_from_s, self._pace_time_s = time.perf_counter(), self._scene.time_s

    def advance(self, steps: int) -> None:
        """Advance the scene by a number of steps.

        Raises:
            RunError: an autopilot ended, hangs or restarted, naming it; or a state is not finite.
                With ``on_crash = "hold"`` only when none is left.
        """
        for _ in range(steps):
            self._run_barrier()

    def _run_barrier(self) -> None:
        start_s = time.perf_counter()
        rows = self._scene.step(self.pwm).numbers.tolist()
        stepped_s = time.perf_counter()
        time_s = self._scene.time_s
        for i in self._alive:
            self._next[i] = packets.write_state(self._names[i], time_s, rows[i])
        written_s = time.perf_counter()
        self._sleep_until_due(written_s)
        sent_s = paced_s = time.perf_counter()
        sending_s = 0.0
        for i in tuple(self._alive):
            self._wait_for_packet(i)
            packet_time_s = sent_s = time.perf_counter()
            if i not in self.lost:
                self._send_reply(i, packet_time_s)
                sent_s = time.perf_counter()
                sending_s += sent_s - packet_time_s
        times = self.spent
        times.barriers += 1
        times.physics_s += stepped_s - start_s
        times.pacing_s += paced_s - written_s
        times.replies_s += written_s - stepped_s + sending_s
        times.waiting_s += sent_s - paced_s - sending_s

    def _send_reply(self, i: int, now_s: float) -> None:
        """Send the reply to the last packet of an autopilot."""
        if now_s - self._answered_s[i] > RESEND_S:
            self._forget_repeats(i)
        self._text[i] = text = self._next[i]
        self._sockets[i].sendto(text, self._source[i])
        self._answered_s[i] = now_s

    def _wait_for_packet(self, i: int) -> None:
        """Wait for the next servo packet of an autopilot."""
        start_s = time.perf_counter()
        while i not in self.lost:
            try:
                size, source = self._receive(self._sockets[i])
            except BlockingIOError:
                self._handle_silence(i, time.perf_counter() - start_s)
                continue
            packet = packets.read_servo(self._buffer[:size])
            if packet is None:
                continue
            frame, pulses = packet
            if source != self._source[i] != _NO_ADDRESS:
                self._handle_new_address(i, frame, source)
            elif frame > self._frame[i]:
                self._source[i], self._frame[i] = source, frame
                self.pwm[i] = pulses
                return
            elif frame == self._frame[i]:
                # The reply was lost: it is sent again, and the clock stays right.
                self._sockets[i].sendto(self._text[i], source)
            else:
                self._drop_autopilot(i, self._format_reboot(i))

    def _receive(self, bound_socket: socket.socket) -> tuple[int, Address]:
        """Return a packet and its source; BlockingIOError if none comes for `POLL_S`."""
        if self._spins:
            deadline_s = time.perf_counter() + POLL_S
            while time.perf_counter() < deadline_s:
                try:
                    return bound_socket.recvfrom_into(self._buffer, 0, socket.MSG_DONTWAIT)
                except BlockingIOError:
                    os.sched_yield()  # other threads waiting for this core go first
        return bound_socket.recvfrom_into(self._buffer)

    def _handle_silence(self, i: int, waited_s: float) -> None:
        fault = self._fault(i)
        if fault is not None:
            self._drop_autopilot(i, fault)
        elif waited_s > self._hang_s:
            activity = "" if self._condition is None else f"; {self._condition(i)}"
            self._drop_autopilot(
                i,
                f"{self._names[i]}: its autopilot hangs: it runs, but has sent no servo packet for "
                f"{waited_s:.1f} s{activity}",
            )

    def _handle_new_address(self, i: int, frame: int, source: Address) -> None:
        """Handle a packet from a new address."""
        if frame <= self._frame[i]:
            self._drop_autopilot(i, self._format_reboot(i))
            return
        raise RunError(
            f"{self._names[i]}: servo packets come from two programs, ports {self._source[i][1]} "
            f"and {source[1]}; end the one that is not ours"
        )

    def _format_reboot(self, i: int) -> str:
        return (
            f"{self._names[i]}: its autopilot began anew (a reboot) at {self._scene.time_s:.2f} s; "
            "it is disarmed and knows nothing of before"
        )

    def _drop_autopilot(self, i: int, reason: str) -> None:
        if self._on_crash == "end":
            raise RunError(reason)
        self.lost[i] = reason
        self.pwm[i] = 0
        self._alive.remove(i)
        if not self._alive:
            raise RunError("no autopilot is left: " + "; ".join(self.lost.values()))

    def _forget_repeats(self, i: int) -> None:
        """Drop repeated packets: one reply is due, not one for each."""
        try:
            while True:
                self._sockets[i].recv_into(self._buffer, 0, socket.MSG_DONTWAIT)
        except BlockingIOError:
            pass

    def _sleep_until_due(self, now_s: float) -> None:
        """Sleep until the step is due."""
        if self.speed is None:
            return
        early = self._pace_from_s + (self._scene.time_s - self._pace_time_s) / self.speed - now_s
        if early > 0:
            time.sleep(early)
        if not -_MAX_LATENESS_S < early < 1.0:
            self._pace_from_s, self._pace_time_s = now_s, self._scene.time_s
