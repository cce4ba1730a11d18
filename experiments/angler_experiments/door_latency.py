"""Latency, loss and cost of `angler serve` over Zenoh: 50 Hz odometry and IMU of eight robots.

    python -m angler_experiments.door_latency docs/examples/ros2_fleet.toml

The door is a process of its own; this process listens as any client of Zenoh does. A message's
latency runs from the end of the step to its arrival, on the same clock. The cost of the door is the
CPU time of its process with listeners less that without.
"""

import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import tyro

READY_S = 120.0
TOPICS = ("*/odometry/**", "*/imu/data/**")


@dataclass(kw_only=True)
class Received:
    """Messages of one topic."""

    count: int = 0
    lost: int = 0
    last: int = 0
    latency_ms: list[float] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class Watched:
    """Door watched for a while."""

    topics: dict[str, Received]
    cpu: float
    """CPU time of the door, cores."""
    steps_per_s: float


def main(scenario: tyro.conf.Positional[Path], seconds: float = 60.0, rounds: int = 7) -> None:
    """Print rates, losses, latencies, CPU and speed.

    Args:
        scenario: scenario file.
        seconds: wall time of the real-time measurement.
        rounds: number of pairs of the comparison of speeds.
    """
    with open_door(scenario, "real") as (port, process, first_s):
        quiet = watch(port, process, seconds / 3, ())
        busy = watch(port, process, seconds, TOPICS)
    print(f"first message after {first_s:.1f} s")
    latency = np.concatenate([row.latency_ms for row in busy.topics.values()])
    counts = [row.count for row in busy.topics.values()]
    print(
        f"{len(counts)} topics, {sum(counts)} messages in {seconds:g} s, "
        f"{min(counts) / seconds:.1f} to {max(counts) / seconds:.1f} per s and topic, "
        f"{sum(row.lost for row in busy.topics.values())} lost"
    )
    median, high = np.percentile(latency, [50, 99])
    print(f"latency: median {median:.2f} ms, p99 {high:.2f} ms, max {latency.max():.1f} ms")
    print(f"CPU: {quiet.cpu:.3f} cores without listeners, {busy.cpu:.3f} with them")
    ratios = []
    with open_door(scenario, "max") as (port, process, _):
        for _ in range(rounds):
            alone = watch(port, process, 5.0, ())
            heard = watch(port, process, 5.0, TOPICS)
            ratios.append(heard.steps_per_s / alone.steps_per_s)
    print(
        f"speed with listeners over that without: median {np.median(ratios):.3f} of "
        f"{np.round(np.sort(ratios), 3).tolist()}"
    )


@contextmanager
def open_door(scenario: Path, pace: str) -> Iterator[tuple[int, psutil.Process, float]]:
    """Start a door; yields its port, its process, and the seconds to the first message."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    words = ["serve", str(scenario), "--backend", "zenoh", "--port", str(port), "--pace", pace]
    start_s = time.perf_counter()
    command = [sys.executable, "-m", "angler_mjx.cli.main", *words]
    door = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        wait_until_open(port, door)
        clocks: list[float] = []
        with connect(port) as session:
            session.declare_subscriber("0/clock/**", lambda _: clocks.append(time.perf_counter()))
            end_s = time.perf_counter() + READY_S
            while not clocks and time.perf_counter() < end_s and door.poll() is None:
                time.sleep(0.01)
        if not clocks:
            raise SystemExit(f"the door sent nothing within {READY_S:g} s")
        yield port, psutil.Process(door.pid), clocks[0] - start_s
    finally:
        door.terminate()
        door.wait(30)


def wait_until_open(port: int, door: subprocess.Popen[bytes]) -> None:
    """Wait until a port is open, or the door has ended."""
    while door.poll() is None:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.05)


def connect(port: int) -> Any:
    """Return a session of Zenoh, client of the door."""
    import zenoh

    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["tcp/127.0.0.1:{port}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(config)


def watch(port: int, process: psutil.Process, seconds: float, topics: tuple[str, ...]) -> Watched:
    """Listen for a while; the clock at both ends gives the number of steps."""
    rows: dict[str, Received] = {}

    def receive(sample: Any) -> None:
        now_ns = time.time_ns()
        count, sent_ns = struct.unpack_from("<qq", sample.attachment.to_bytes())
        row = rows.setdefault(str(sample.key_expr), Received())
        row.lost += count - row.last - 1 if row.last else 0
        row.last, row.count = count, row.count + 1
        row.latency_ms.append(1e-6 * (now_ns - sent_ns))

    with connect(port) as session:
        begin = read_clock(session)
        listeners = [session.declare_subscriber(f"0/{topic}", receive) for topic in topics]
        time.sleep(0.5)
        for row in rows.values():
            row.count, row.lost = 0, 0
            row.latency_ms.clear()
        before, start_s = process.cpu_times(), time.perf_counter()
        time.sleep(seconds)
        after, wall_s = process.cpu_times(), time.perf_counter() - start_s
        for listener in listeners:
            listener.undeclare()
        end = read_clock(session)
    spent = after.user + after.system - before.user - before.system
    steps_per_s = (end[0] - begin[0]) / (end[1] - begin[1])
    return Watched(topics=rows, cpu=spent / wall_s, steps_per_s=steps_per_s)


def read_clock(session: Any) -> tuple[float, float]:
    """Return the time of the scene, s, and the wall time of its arrival."""
    stamps: list[tuple[float, float]] = []

    def receive(sample: Any) -> None:
        sec, nanosec = struct.unpack_from("<iI", sample.payload.to_bytes(), 4)
        stamps.append((sec + 1e-9 * nanosec, time.perf_counter()))

    listener = session.declare_subscriber("0/clock/**", receive)
    while not stamps:
        time.sleep(0.001)
    listener.undeclare()
    return stamps[0]


if __name__ == "__main__":
    tyro.cli(main)
