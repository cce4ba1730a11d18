"""Life of an autopilot process: its folder, its ends told apart, and nothing left behind."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from angler_sitl.firmware import process, sockets
from angler_sitl.firmware.binary import Binary
from angler_sitl.firmware.process import AutopilotProcess, LaunchSpec, kill_processes
from angler_sitl.wire.ports import allocate_ports

STATE = (
    '\n{{"timestamp":{:.4f},"imu":{{"gyro":[0,0,0],"accel_body":[0,0,-9.81]}},"position":[0,0,0],'
    '"quaternion":[1,0,0,0],"velocity":[0,0,0],"no_time_sync":1}}\n'
)
PATIENCE_S = 20.0
"""Wall time after which a test gives up; what it waits for takes a fraction of a second."""


def launch_of(binary, ports, folder, **changed):
    given = {"name": "robot_3", "sysid": 4, "parameters": {}, **changed}
    return LaunchSpec(binary=binary, folder=folder, ports=ports, **given)


def answer(ports, steps, patience_s=PATIENCE_S):
    """Answer so many servo packets; False if one does not come."""
    ports.fdm.settimeout(patience_s)
    for i in range(steps):
        try:
            _, peer = ports.fdm.recvfrom(256)
        except TimeoutError:
            return False
        ports.fdm.sendto(STATE.format((i + 1) / 400).encode(), peer)
    return True


def wait_for(happened):
    end = time.monotonic() + PATIENCE_S
    while not happened():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_runs_in_its_own_folder_and_session(stand_in, ports, tmp_path):
    folder = tmp_path / "robots" / "robot_3"
    launch = launch_of(stand_in, ports, folder, parameters={"FRAME_CONFIG": 2.0})
    with AutopilotProcess(launch) as instance:
        assert answer(ports, 10)
        assert instance.fault() is None
        # Its own session: Ctrl-C in the terminal is for us alone.
        assert os.getsid(instance.pid) == instance.pid
        made = {path.name for path in folder.iterdir()}
        assert {"eeprom.bin", process.LOG_NAME, process.PARAMETERS_NAME} <= made
        assert "Starting sketch 'ArduSub'" in instance.read_log_tail()
        assert len(instance.read_log_tail(1)) == 1
    assert not psutil.pid_exists(instance.pid)
    assert instance.fault() is None
    instance.kill()


def test_its_end_is_told_with_name_cause_and_last_words(stand_in, ports, tmp_path):
    launch = launch_of(stand_in, ports, tmp_path, parameters={"STANDIN_EXIT_S": 0.05})
    with AutopilotProcess(launch) as instance:
        wait_for(lambda: not answer(ports, 100, 0.1) and instance.fault())
        told = instance.fault()
    assert told.startswith("robot_3: ")
    assert "exit code 3" in told
    assert told.endswith("told to end")
    # It ended by itself: having been told to end it afterwards changes nothing about that.
    assert instance.fault() == told


def test_killed_by_somebody_else(stand_in, ports, tmp_path):
    with AutopilotProcess(launch_of(stand_in, ports, tmp_path)) as instance:
        assert answer(ports, 10)
        os.kill(instance.pid, signal.SIGKILL)
        wait_for(instance.fault)
        assert f"pid {instance.pid}) ended by SIGKILL" in instance.fault()


def test_a_state_that_is_not_finite_kills_it(stand_in, ports, tmp_path):
    with AutopilotProcess(launch_of(stand_in, ports, tmp_path)) as instance:
        _, peer = ports.fdm.recvfrom(256)
        ports.fdm.sendto(STATE.format(0.1).replace("-9.81", "NaN").encode(), peer)
        wait_for(instance.fault)
        assert "SIGABRT" in instance.fault()
        assert "Floating point exception" in instance.fault()


@pytest.mark.parametrize("how", ["stopped", "hangs"])
def test_a_hang_is_no_end(stand_in, ports, tmp_path, how):
    hangs = {"STANDIN_HANG_S": 0.05}
    with AutopilotProcess(launch_of(stand_in, ports, tmp_path, parameters=hangs)) as instance:
        assert answer(ports, 5)
        if how == "stopped":
            os.kill(instance.pid, signal.SIGSTOP)
        # One that waits asks again after 1.1 s.
        assert not answer(ports, 100, 1.5)
        assert instance.fault() is None
        assert {"stopped": "was stopped", "hangs": "waits"}[how] in instance.condition()
    assert not psutil.pid_exists(instance.pid)


def test_term_is_only_noted_while_it_waits_so_more_is_done(stand_in, ports, tmp_path):
    with AutopilotProcess(launch_of(stand_in, ports, tmp_path)) as instance:
        assert answer(ports, 10)
        ports.fdm.settimeout(PATIENCE_S)
        first = ports.fdm.recv(256)
        os.kill(instance.pid, signal.SIGTERM)
        # It asks again after 1.1 s, alive, because nobody answered.
        assert ports.fdm.recv(256) == first
        assert instance.fault() is None
    assert not psutil.pid_exists(instance.pid)


def test_a_program_that_cannot_be_run(ports, tmp_path):
    nothing = tmp_path / "nothing"
    nothing.write_text("no program")
    nothing.chmod(0o755)
    binary = Binary(path=nothing, version="", sha256="")
    with AutopilotProcess(launch_of(binary, ports, tmp_path / "run")) as instance:
        wait_for(instance.fault)
        assert "cannot be run (Exec format error)" in instance.fault()


def test_nothing_outlives_a_program_that_is_killed(stand_in, tmp_path):
    script = (
        "import os, sys, time\n"
        "from pathlib import Path\n"
        "from angler_sitl.firmware.binary import Binary\n"
        "from angler_sitl.wire.ports import allocate_ports\n"
        "from angler_sitl.firmware.process import AutopilotProcess, LaunchSpec\n"
        "binary = Binary(path=Path(sys.argv[1]), version='', sha256='')\n"
        "for i, ports in enumerate(allocate_ports(2)):\n"
        "    folder = Path(sys.argv[2]) / str(i)\n"
        "    launch = LaunchSpec(binary=binary, folder=folder, name='r', sysid=1 + i, "
        "ports=ports, parameters={})\n"
        "    one = AutopilotProcess(launch)\n"
        "    ports.fdm.recv(256)\n"
        "    print(one.pid, flush=True)\n"
        "time.sleep(60)\n"
    )
    command = [sys.executable, "-c", script, str(stand_in.path), str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as parent:
        pids = [int(parent.stdout.readline()) for _ in range(2)]
        assert all(psutil.pid_exists(pid) for pid in pids)
        parent.kill()
        parent.wait()
        # Killed by the kernel although they wait for physics that will never answer.
        wait_for(lambda: not any(map(psutil.pid_exists, pids)))


def test_a_parent_that_is_gone_already_is_noticed():
    # 1 is nobody's parent here but the system's.
    command = [sys.executable, "-ISc", process._HELPER, "1", "/bin/echo", "ran"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode != 0
    assert "has ended" in done.stderr
    assert done.stdout == ""


def cycles(binary, folder, count):
    """Start, step and end an autopilot so many times; our memory after each, bytes."""
    used = []
    for _ in range(count):
        (ports,) = allocate_ports(1)
        with AutopilotProcess(launch_of(binary, ports, folder)):
            assert answer(ports, 5)
        ports.close()
        used.append(psutil.Process().memory_info().rss)
    return used


def counts():
    """Numbers of child processes, of which other tests may have started some, and of open files."""
    here = psutil.Process()
    return len(here.children(recursive=True)), here.num_fds()


def test_start_and_stop_again_and_again(stand_in, tmp_path):
    before = counts()
    cycles(stand_in, tmp_path, 5)
    assert counts() == before


@pytest.mark.sitl
def test_a_hundred_starts_of_the_real_one(ardusub, tmp_path):
    before = counts()
    used = cycles(ardusub, tmp_path, 100)
    assert counts() == before
    # A leak of what a start holds (sockets' objects, its log's text: above 20 kB) would be 1.6 MB
    # in 80 starts; the allocator's own steps are of 0.1 to 0.3 MB.
    assert used[-1] - used[19] < 1_000_000


@pytest.mark.sitl
def test_a_fleet_ends_at_once_and_opens_one_socket_each(ardusub, tmp_path):
    fleet = allocate_ports(3)
    instances = [
        AutopilotProcess(launch_of(ardusub, ports, tmp_path / str(i), sysid=1 + i))
        for i, ports in enumerate(fleet)
    ]
    for ports in fleet:
        assert answer(ports, 1000)
    for one in instances:
        # State packets come by this one; that for radio control found its port taken.
        (reachable,) = (s for s in sockets.list_sockets(one.pid) if not s.is_loopback)
        assert reachable.protocol == "udp"
        assert Path(f"{one.launch.folder}/eeprom.bin").stat().st_size == 16384
    kill_processes(instances)
    assert not any(psutil.pid_exists(one.pid) for one in instances)
    for ports in fleet:
        ports.close()
