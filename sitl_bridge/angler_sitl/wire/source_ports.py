"""Every autopilot calls from a port of its own: looked at before the first is answered.

The firmware leaves the number to the kernel and lets others have the same one (SO_REUSEADDR). Any
two autopilots of a machine, of one fleet or of two, so share it once in 28,232 times (as many ports
Linux gives by default), and two of sixteen once in 235 starts. What is sent to it reaches the
younger alone; the elder waits for ever.
"""

import select
import socket
import time

from angler_mjx.errors import RunError
from angler_sitl.firmware.process import AutopilotProcess
from angler_sitl.firmware.sockets import count_receivers

WAIT_S = 10.0
"""For the first packets of all; one that sends none is told of by the lock-step."""

_POLL_S, _MAX_STARTS = 0.1, 5


def restart_shared_ports(instances: list[AutopilotProcess]) -> None:
    """Start anew those that share their port, in place; they have done nothing yet.

    Args:
        instances: Just started; nobody has answered them.

    Raises:
        RunError: one of them shares its port each time.
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
    """Port that the first packet came from, which stays where it is; None if none comes in time."""
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
