"""The pool over Ray, on a real cluster that is started here on this machine."""

import importlib.util
import os
import pickle
import signal
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.planning import register
from angler_mjx.planning.host.cluster import connection
from angler_mjx.planning.host.cluster.ray_workers import RayWorkers
from angler_mjx.planning.host.workers import Workers
from angler_mjx.planning.register import PlannerSpec

from ..problems import problem
from .strange import WAYS

pytestmark = [
    pytest.mark.nightly(by="test_workers.py and test_cluster.py, beside it"),
    pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="needs the extra ray: Ray"),
]

STRANGE = Path(__file__).with_name("strange.py")


@contextmanager
def node(*options):
    """One machine of a cluster, and its end with all that it started."""
    command = [sys.executable, "-m", "ray.scripts.scripts", "start", *options, "--block"]
    started = subprocess.Popen(
        [*command, "--disable-usage-stats"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=environment(),
        start_new_session=True,
    )
    try:
        yield started
    finally:
        family = descendants(started.pid)
        started.terminate()
        try:
            started.wait(timeout=30)
        except subprocess.TimeoutExpired:
            started.kill()
        for one in family:
            if one.is_running():
                one.kill()
        psutil.wait_procs(family, timeout=30)


@pytest.fixture(scope="module")
def head():
    """Process id of a head, and its address."""
    # Paths of sockets are short: Ray's do not fit into pytest's folders.
    with tempfile.TemporaryDirectory(prefix="ray_", ignore_cleanup_errors=True) as folder:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        options = (f"--port={port}", "--num-cpus=2", "--include-dashboard=false")
        options = (*options, "--node-ip-address=127.0.0.1", f"--temp-dir={folder}")
        with node("--head", *options) as started:
            wait_for(lambda: answers(port))
            yield started.pid, f"127.0.0.1:{port}"


@pytest.fixture(scope="module")
def address(head):
    return head[1]


@pytest.fixture
def folder(tmp_path):
    return tmp_path


@pytest.fixture
def strange(folder):
    return made("Strange", folder=str(folder))


def test_plans_are_those_of_this_machine(address, strange, tmp_path):
    pytest.importorskip("ompl", reason="needs the extra plan: OMPL")
    ompl = PlannerSpec(reference=register.find("RRTConnect"), settings={"range_m": 2.0})
    wall = (5, slice(0, 7), slice(None))
    asked = [(problem(rock=[wall], seed=seed, deadline_s=5.0), ompl) for seed in range(6)]
    asked += [(ask("straight", starts=[(2, 2, z)]), strange) for z in (1, 2, 3)]
    asked += [(ask(way), strange) for way in ("throws", "segfaults", "partial")]
    asked += [(ask("late", deadline_s=0.2), strange), (ask("hangs", deadline_s=0.2), strange)]
    asked += [(ask("straight"), made("Unmade"))]
    got = []
    for pool in (Workers(None, 2), RayWorkers(address)):
        with pool:
            assert pool.count == 2
            tickets = [pool.submit(*one) for one in asked]
            answers = dict(pool.completed(tickets))
            got.append([answers[ticket] for ticket in tickets])
    assert [answer.status for answer in got[1]] == [
        *["planned"] * 9, "error", "died", "none", "timeout", "timeout", "error",
    ]  # fmt: skip
    for here, there in zip(*got, strict=True):
        assert there.status == here.status
        if there.status != "timeout":
            assert there.reason == here.reason
        for one, other in zip(here.paths, there.paths, strict=True):
            assert type(one) is type(other)
            if there.status == "planned":
                assert other.time_s.tobytes() == one.time_s.tobytes()
                assert other.position_m.tobytes() == one.position_m.tobytes()
                assert other.position_m.flags.writeable


def test_an_actor_that_is_killed_costs_its_problem_one_try(address, strange, folder):
    with RayWorkers(address, 1, strange) as pool:
        ticket = pool.submit(ask("slow"))
        after = [pool.submit(ask("straight")) for _ in range(3)]
        wait_for((folder / "slow").exists)
        (pid,) = pool.pids()
        planners = descendants(pid)
        os.kill(pid, signal.SIGKILL)
        assert {answer.status for _, answer in pool.completed([ticket, *after])} == {"planned"}
        assert pool.pids() != [pid]
        wait_for(lambda: not any(one.is_running() for one in planners))
        os.kill(pool.pids()[0], signal.SIGKILL)
        time.sleep(1.0)
        assert pool.take(pool.submit(ask("straight"))).status == "planned"
        twice = pool.submit(ask("slow"))
        for _ in range(2):
            (folder / "slow").unlink()
            wait_for((folder / "slow").exists)
            os.kill(pool.pids()[0], signal.SIGKILL)
        answer = pool.take(twice)
        assert answer.status == "died"
        assert answer.reason.startswith("its actor died, 2 times: The actor died")


def test_a_machine_that_is_lost_costs_no_answer(address, folder):
    slow = made("Strange", folder=str(folder), slow_s=8.0)
    with node(f"--address={address}", "--node-ip-address=127.0.0.2", "--num-cpus=1") as second:
        wait_for(lambda: processors(address) == 3)
        with RayWorkers(address, planner=slow) as pool:
            assert pool.count == 3
            wait_for(lambda: len(pool.pids()) == 3)
            tickets = [pool.submit(ask("slow")) for _ in range(3)]
            time.sleep(2.0)
            lost = [one for one in descendants(second.pid) if one.is_running()]
            assert any(one.pid in pool.pids() for one in lost)
            for one in lost:
                if one.is_running():
                    one.kill()
            assert [answer.status for _, answer in pool.completed(tickets)] == ["planned"] * 3


def test_a_file_goes_along_to_where_it_is_not(address, folder):
    busy = made("Strange", folder=str(folder), slow_s=3.0)
    file = folder / "copied.py"
    file.write_bytes(STRANGE.read_bytes())
    copied = PlannerSpec(reference=register.find(f"{file}:Strange"))
    with RayWorkers(address, 1) as pool:
        first, then = pool.submit(ask("slow"), busy), pool.submit(ask("straight"), copied)
        file.unlink()
        assert pool.take(first).status == "planned"
        assert pool.take(then).status == "planned"


def test_a_pool_whose_own_planner_cannot_be_made_says_so(address):
    with RayWorkers(address, 1, made("Unmade")) as pool:
        ticket = pool.submit(ask("straight"))
        with pytest.raises(RunError, match="RuntimeError: no licence"):
            pool.take(ticket)


def test_what_cannot_be_joined_is_said(address, monkeypatch):
    for wrong in ("local", "auto", "ray://127.0.0.1:1", ""):
        with pytest.raises(ConfigError, match="HOST:PORT"):
            RayWorkers(wrong)
    with pytest.raises(ConfigError, match="2 processors; it cannot hold 3"):
        RayWorkers(address, 3)
    monkeypatch.setattr(connection, "LIBRARIES", (*connection.LIBRARIES, "pytest"))
    with pytest.raises(ConfigError, match=r"versions: pytest missing there, \d"):
        RayWorkers(address)
    monkeypatch.setattr(connection, "HEALTH_TIMEOUT_S", 3.0)
    begin = time.monotonic()
    with pytest.raises(ConfigError, match=r"no Ray cluster answers at 127\.0\.0\.1:9 "):
        RayWorkers("127.0.0.1:9")
    assert time.monotonic() - begin < 10.0


PARENT = """
import pickle, sys
from angler_mjx.planning.host.cluster.ray_workers import RayWorkers
address, spec, problem = pickle.loads(sys.stdin.buffer.read())
with RayWorkers(address, 1, spec) as pool:
    pool.take(pool.submit(problem))
"""


@pytest.mark.parametrize("by", [signal.SIGKILL, signal.SIGINT])
def test_all_ends_with_the_process_that_joined(head, strange, folder, by):
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env=environment(),
    )
    with parent.stdin as said:
        said.write(pickle.dumps((head[1], strange, ask("holds", deadline_s=600.0))))
    wait_for((folder / "holds").exists)
    planners = planning(head[0])
    assert planners
    parent.send_signal(by)
    with parent.stdout:
        told = parent.stdout.read().decode()
    parent.wait(timeout=60)
    wait_for(lambda: not any(one.is_running() for one in planners))
    if by == signal.SIGINT:
        assert told.rstrip().endswith("KeyboardInterrupt")
        assert told.count("Traceback") == 1
    else:
        assert told == ""


def ask(way, **kwargs):
    kwargs.setdefault("deadline_s", 20.0)
    return problem(seed=WAYS.index(way), **kwargs)


def made(name, **settings):
    return PlannerSpec(reference=register.find(f"{STRANGE}:{name}"), settings=settings)


def planning(head):
    """Processes of planners that belong to a cluster."""
    return [
        one
        for one in descendants(head)
        if "angler_mjx.planning.host.worker" in " ".join(one.cmdline())
    ]


def descendants(pid):
    try:
        return psutil.Process(pid).children(recursive=True)
    except psutil.NoSuchProcess:
        return []


def processors(address):
    told = subprocess.run(
        [sys.executable, "-c", f"""
import ray
ray.init(address={address!r}, log_to_driver=False, logging_level="ERROR")
print(ray.cluster_resources()["CPU"])
"""],
        capture_output=True, text=True, env=environment(), check=False,
    )  # fmt: skip
    return float(told.stdout.split()[-1]) if told.stdout.strip() else 0.0


def answers(port):
    with socket.socket() as asked:
        return asked.connect_ex(("127.0.0.1", port)) == 0


def environment():
    return {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}


def wait_for(holds, within_s=90.0):
    end = time.monotonic() + within_s
    while not holds():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.05)
