"""One autopilot process: its folder, its command line, its end.

The process runs in its own folder (it writes eeprom.bin, logs/ and terrain/ there) and in its own
session (Ctrl-C is for us, we end it), with its output in a file. The kernel kills it when we die:
PR_SET_PDEATHSIG is set by a small Python program that then becomes the autopilot by exec. A
``preexec_fn`` is not used, because code between fork and exec can deadlock when other threads hold
a lock, and JAX has many. The program also checks that its parent is still there, so a parent that
died before the request leaves no process behind either.

It becomes a batch process: woken by a reply, it does not take the core of the process that still
has to answer others.

The kernel watches the thread that started the process, not the program: an `AutopilotProcess` must
be created by a thread that outlives it.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from angler_mjx.errors import RunError
from angler_sitl.firmware import parameters
from angler_sitl.firmware.binary import Binary
from angler_sitl.wire.ports import LOOPBACK, Ports, port_number

HOME_LAT_DEG, HOME_LON_DEG = 47.6, -122.3
"""Position of W's origin on the globe: any in the sea but 0, 0, which SITL takes as none."""

LOG_NAME = "ardusub.log"
PARAMETERS_NAME = "angler.parm"

_GRACE_S = 0.2
"""Time for a clean exit, which an autopilot waiting for physics cannot use."""

_HELPER = """
import ctypes, os, signal, sys
parent, program = int(sys.argv[1]), sys.argv[2]
PR_SET_PDEATHSIG = 1
if ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0):
    sys.exit("prctl: " + os.strerror(ctypes.get_errno()))
if os.getppid() != parent:
    sys.exit("the program that started this one has ended")
try:
    os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
except OSError as error:  # it is slower then, and nothing else
    print("not a batch process:", error.strerror, flush=True)
try:
    os.execv(program, sys.argv[2:])
except OSError as error:
    sys.exit(f"{program}: cannot be run ({error.strerror})")
"""


@dataclass(frozen=True, kw_only=True)
class LaunchSpec:
    """Launch settings of one autopilot.

    Attributes:
        binary: The ArduSub to run.
        folder: Its own folder; created if missing.
        name: Its name in messages, as in robot_0.
        sysid: MAVLink system number, 1 to 254.
        ports: Sockets of `ports.allocate_ports`.
        parameters: Values by firmware name, as of `parameters.for_vehicle`.
        home_deg: Latitude and longitude of W's origin, where its GPS starts.
    """

    binary: Binary
    folder: Path
    name: str
    sysid: int
    ports: Ports
    parameters: Mapping[str, float]
    home_deg: tuple[float, float] = (HOME_LAT_DEG, HOME_LON_DEG)

    def command_line(self) -> list[str]:
        """Return the command line, the program's path first.

        Home's altitude is 0, else its depth sensor is wrong; all serial lines but two are off, else
        they listen on all interfaces; ``--wipe`` because saved values of an earlier run win. No
        ``--speedup``: the replies to its packets set the pace.
        """
        ports = self.ports
        # SITL's own Vicon is a device on a serial line of its own.
        vicon = ["--serial5", "sim:vicon:"] if "SIM_VICON_TMASK" in self.parameters else []
        return [
            str(self.binary.path.resolve()),
            *("--model", f"JSON:{LOOPBACK}"),
            *("--sysid", str(self.sysid)),
            *("--home", f"{self.home_deg[0]:.9g},{self.home_deg[1]:.9g},0,0"),
            *("--defaults", PARAMETERS_NAME),
            "--wipe",
            *("--serial0", f"udpclient:{LOOPBACK}:{port_number(ports.mavlink)}"),
            *("--serial1", f"udpclient:{LOOPBACK}:{port_number(ports.vision)}"),
            *("--serial2", "none:"),
            *("--sim-port-out", str(port_number(ports.fdm))),
            *("--rc-in-port", str(ports.rc_port)),
            *vicon,
        ]


class AutopilotProcess:
    """One running autopilot; a context manager that leaves no process behind."""

    def __init__(self, launch: LaunchSpec) -> None:
        """Start the process.

        Raises:
            RunError: its folder cannot be written, or no process can be started.
        """
        self.launch = launch
        self._killed = False
        self._log = launch.folder / LOG_NAME
        try:
            launch.folder.mkdir(parents=True, exist_ok=True)
            parameters.write_parameters(launch.folder / PARAMETERS_NAME, launch.parameters)
            with self._log.open("wb") as log:
                self._process = subprocess.Popen(
                    # -I and -S: nothing of the user's Python is loaded, and it is quick.
                    [sys.executable, "-ISc", _HELPER, str(os.getpid()), *launch.command_line()],
                    cwd=launch.folder,
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,
                )
        except OSError as error:
            raise RunError(
                f"{launch.name}: its ArduSub cannot be started in {launch.folder} ({error})"
            ) from error
        self.pid = self._process.pid

    def fault(self) -> str | None:
        """Return the cause of its end, with its log tail; None while it runs or after `kill`."""
        code = self._process.poll()
        if code is None or self._killed:
            return None
        ended = f"with exit code {code}" if code >= 0 else f"by {_signal_name(-code)}"
        last_lines = self._format_last_lines()
        return f"{self.launch.name}: its ArduSub (pid {self.pid}) ended {ended}{last_lines}"

    def condition(self) -> str:
        """Return the activity of a running process, for the report of a hang."""
        activity = {
            "R": "is busy",
            "S": "waits",
            "D": "waits for the disk",
            "T": "was stopped",
            "t": "is being debugged",
        }.get(_read_state(self.pid), "has ended")
        last_lines = self._format_last_lines()
        return f"{self.launch.name}: its ArduSub (pid {self.pid}) {activity}{last_lines}"

    def read_log_tail(self, lines: int = 5) -> list[str]:
        """Return the last lines of its output."""
        try:
            with self._log.open("rb") as log:
                log.seek(0, os.SEEK_END)
                log.seek(max(0, log.tell() - 16_384))
                text = log.read().decode(errors="replace")
        except OSError:
            return []
        return [line.rstrip() for line in text.splitlines() if line.strip()][-lines:]

    def kill(self) -> None:
        """Kill the process and reap it; a second call has no effect.

        An autopilot waiting for physics only records SIGTERM, so SIGKILL follows.
        """
        kill_processes([self])

    def __enter__(self) -> Self:
        """Return the context manager itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Kill the process."""
        self.kill()

    def _format_last_lines(self) -> str:
        lines = self.read_log_tail()
        if not lines:
            return "; it printed nothing"
        return "; its last lines:" + "".join(f"\n    {line}" for line in lines)


def kill_processes(instances: list[AutopilotProcess]) -> None:
    """Kill autopilots with one grace period for all."""
    # Popen signals only a child that it has not reaped, so a reused number is never hit.
    for instance in instances:
        instance._killed = instance._killed or instance._process.poll() is None
        instance._process.terminate()
    end = time.monotonic() + _GRACE_S
    while time.monotonic() < end and any(
        instance._process.poll() is None for instance in instances
    ):
        time.sleep(0.005)
    for instance in instances:
        instance._process.kill()
    for instance in instances:
        instance._process.wait()


def _signal_name(number_: int) -> str:
    try:
        return signal.Signals(number_).name
    except ValueError:
        return f"signal {number_}"


def _read_state(pid: int) -> str:
    try:
        text = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return ""
    # The second field is the name in brackets and may hold anything, brackets too.
    return text.rpartition(")")[2].split()[0]
