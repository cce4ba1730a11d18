"""Unique source ports of the autopilots, checked before the first reply.

The firmware leaves the number to the kernel and lets others have the same one (SO_REUSEADDR). Any
two autopilots of a machine, of one fleet or of two, so share it once in 28,232 times (the number of
Linux's default ports), and two of sixteen once in 235 starts. Packets sent to it reach the younger
autopilot alone; the elder waits for ever.
"""

import select
import socket
import time

from angler_mjx.errors import RunError
from angler_sitl.firmware.process import AutopilotProcess
from angler_sitl.firmware.sockets import count_receivers

WAIT_S = 10.0
"""Time limit of the first packets; the lock-step reports an autopilot that sends none."""

_POLL_S, _MAX_STARTS = 0.1, 5


def restart_shared_ports(instances: list[AutopilotProcess]) -> None:
    """Restart autopilots that share their port, in place; they have done nothing yet.

    Args:
        instances: Just started; no reply was sent yet.

    Raises:
        RunError: an autopilot shares its port each time.
    """
    deadline_s = time.perf_counter() + WAIT_S
    for i, instance in enumerate(instances):
        for _ in range(_MAX_STARTS):
            port = _find_source_port(instance, deadline_s)
            if port is None or count_receivers(instance.pid, port) < 2:
                break
            instances[i] = instance = _restart(instance)
            deadline_s = time.perf_counter() + WAIT_S
        else:
            raise RunError(
                f"{instance.launch.name}: the port that its ArduSub sends from is another "
                f"program's too, {_MAX_STARTS} times in a row; end programs that hold many UDP "
                "ports"
            )


def _find_source_port(instance: AutopilotProcess, deadline_s: float) -> int | None:
    """Return the source port of the first packet, still queued; None if none comes in time."""
    fdm = instance.launch.ports.fdm
    while instance.fault() is None:
        if select.select([fdm], [], [], _POLL_S)[0]:
            return int(fdm.recvfrom(1, socket.MSG_PEEK)[1][1])
        if time.perf_counter() > deadline_s:
            break
    return None


def _restart(instance: AutopilotProcess) -> AutopilotProcess:
    instance.kill()
    fdm = instance.launch.ports.fdm
    while select.select([fdm], [], [], 0)[0]:
        fdm.recv(1)
    return AutopilotProcess(instance.launch)
