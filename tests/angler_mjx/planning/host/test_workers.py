"""Worker processes outlive what planners do in them."""

import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Future
from pathlib import Path

import numpy as np
import psutil
import pytest

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.planning import register
from angler_mjx.planning.answers import failed_answer
from angler_mjx.planning.host.pool import Job, Pool, Runner
from angler_mjx.planning.host.workers import Workers
from angler_mjx.planning.planner import NoPlan
from angler_mjx.planning.register import PlannerSpec

from ..problems import problem
from .strange import WAYS

STRANGE = str(Path(__file__).with_name("strange.py"))


def ask(way, **kwargs):
    kwargs.setdefault("deadline_s", 10.0)
    return problem(seed=WAYS.index(way), **kwargs)


def two(way, **kwargs):
    return ask(way, starts=[(2, 2, 2), (2, 6, 2)], goals=[(8, 2, 2), (8, 6, 2)], **kwargs)


def made(name, **settings):
    return PlannerSpec(reference=register.find(f"{STRANGE}:{name}"), settings=settings)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("strange")


@pytest.fixture(scope="module")
def spec(folder):
    return made("Strange", folder=str(folder))


@pytest.fixture(scope="module")
def workers(spec):
    with Workers(spec, 1) as pool:
        yield pool


def test_what_a_planner_does_is_the_failure_of_its_own_problem(workers, folder):
    ways = {
        "straight": two("straight"),
        "throws": two("throws"),
        "exits": two("exits"),
        "holds": two("holds", deadline_s=0.2),
        "late": two("late", deadline_s=0.2),
        "segfaults": two("segfaults"),
        "partial": two("partial"),
        "straight again": two("straight"),
    }
    tickets = {way: workers.submit(asked) for way, asked in ways.items()}
    got = {way: workers.take(ticket) for way, ticket in reversed(tickets.items())}

    assert {way: answer.status for way, answer in got.items()} == {
        "straight": "planned",
        "throws": "error",
        "exits": "error",
        "holds": "timeout",
        "late": "timeout",
        "segfaults": "died",
        "partial": "partial",
        "straight again": "planned",
    }
    assert got["throws"].reason == "ValueError: no such reef here (strange.py:51)"
    assert got["exits"].reason == "SystemExit: 3 (strange.py:54)"
    assert "SIGSEGV" in got["segfaults"].reason
    assert got["partial"].reason == "robot 1: too far"
    assert got["late"].reason.startswith("the planner missed its deadline of 0.2 s (took 0.24")
    assert 0.22 < got["holds"].planning_s < 5.0
    for way in ("throws", "holds", "segfaults"):
        assert got[way].paths == [NoPlan(got[way].reason)] * 2
    path = got["straight again"].paths[1]
    np.testing.assert_array_equal(path.position_m, np.float32([[2, 6, 2], [8, 6, 2]]))
    assert got["straight"].extras == {"seed": WAYS.index("straight")}


def test_a_worker_that_somebody_kills_loses_only_its_run(workers, folder):
    (folder / "slow").unlink(missing_ok=True)
    ticket, after = workers.submit(ask("slow")), workers.submit(ask("straight"))
    wait_for((folder / "slow").exists)
    before = workers.pids()
    os.kill(before[0], signal.SIGKILL)
    assert workers.take(ticket).status == "planned"
    assert workers.take(after).status == "planned"
    assert workers.pids() != before


def test_a_ticket_is_taken_once(workers):
    ticket = workers.submit(ask("straight"))
    workers.take(ticket)
    with pytest.raises(RunError, match="taken before"):
        workers.take(ticket)


def test_a_process_keeps_each_planner_that_it_met(workers):
    counts = made("Counts")
    asked = [counts, None, counts, made("Strange", slow_s=2.0), counts]
    tickets = [workers.submit(ask("straight"), planner) for planner in asked]
    got = [workers.take(ticket) for ticket in tickets]
    assert [answer.status for answer in got] == ["none", "planned", "none", "planned", "none"]
    first, second, third = (got[i].extras for i in (0, 2, 4))
    assert first.pop("warm_up_s") >= 0.01
    assert (first, second, third) == tuple({"warmed": 1, "asked": n} for n in (1, 2, 3))


def test_a_given_planner_that_cannot_be_made_is_an_answer_and_the_pool_goes_on(workers):
    before = workers.pids()
    planners = [made("Unmade"), made("Nowhere"), made("Strange", speed=1), None, made("Unmade")]
    tickets = [workers.submit(two("straight"), planner) for planner in planners]
    got = [workers.take(ticket) for ticket in tickets]
    assert [answer.status for answer in got] == ["error", "error", "error", "planned", "error"]
    unmade = "the planner cannot be made: RuntimeError: no licence (strange.py:98)"
    assert got[0].reason == unmade == got[4].reason
    assert "holds no 'Nowhere'" in got[1].reason
    assert "speed" in got[2].reason
    assert got[0].paths == [NoPlan(got[0].reason)] * 2
    assert workers.pids() == before


def test_answers_come_as_they_are_done(workers):
    slow, *rest = [workers.submit(ask(way)) for way in ("slow", "straight", "throws")]
    got = list(workers.completed([*rest[::-1], slow]))
    assert [ticket for ticket, _ in got] == [slow, *rest]
    assert [answer.status for _, answer in got] == ["planned", "planned", "error"]
    with pytest.raises(RunError, match="taken before"):
        workers.take(slow)


def test_problems_are_handed_in_as_answers_are_taken(workers):
    drawn = []

    def tickets():
        for i in range(5):
            drawn.append(i)
            yield workers.submit(ask("straight"))

    got = workers.completed(tickets(), ahead=2)
    next(got)
    assert drawn == [0, 1, 2]
    assert len(list(got)) == 4


def test_a_pool_without_a_planner_plans_with_those_that_it_is_given():
    with Workers(None, 1) as pool:
        with pytest.raises(ConfigError, match="no planner"):
            pool.submit(ask("straight"))
        assert pool.take(pool.submit(ask("straight"), made("Strange"))).status == "planned"


@pytest.mark.parametrize(
    ("spec", "says"),
    [
        (made("Unmade"), "RuntimeError: no licence"),
        pytest.param(
            made("Nowhere"),
            "Nowhere",
            marks=pytest.mark.nightly(by="the one beside it"),
        ),
    ],
)
def test_a_planner_that_cannot_be_made_is_said_so(spec, says):
    with Workers(spec, 1) as pool:
        ticket = pool.submit(ask("straight"))
        with pytest.raises(RunError, match=says):
            pool.take(ticket)
        later = pool.submit(ask("straight"))
        with pytest.raises(RunError, match=says):
            pool.take(later)


def test_there_is_at_least_one_worker(spec):
    with pytest.raises(ConfigError, match="at least 1"):
        Workers(spec, 0)


def test_a_closed_pool_tells_who_waits(spec):
    pool = Workers(spec, 1)
    ticket = pool.submit(ask("hangs", deadline_s=60.0))
    pool.close()
    with pytest.raises(RunError, match="closed"):
        pool.take(ticket)
    with pytest.raises(RunError, match="closed"):
        pool.submit(ask("straight"))


class IdleRunner(Runner):
    """A runner without a process."""

    def ready(self):
        pass

    def kill(self):
        pass

    def end(self):
        pass


class FirstRunner(IdleRunner):
    """After a problem it finds that the pool has closed for all, and that it cannot go on."""

    has_answered = False

    def answer(self, job):
        self.has_answered = True
        return failed_answer(job.robots, "error", "", 0.0)

    def ready(self):
        while self.has_answered:
            if self.pool.closing and self.pool._jobs.qsize() == 3:
                raise RunError("closed")
            time.sleep(0.001)


class LastRunner(IdleRunner):
    """Its problem takes until the first runner has ended."""

    def answer(self, job):
        self.pool.runners[0].join()
        return failed_answer(job.robots, "error", "", 0.0)


def test_a_runner_that_cannot_go_on_leaves_the_end_of_the_pool_to_the_others():
    pool = Pool(None, 3)
    pool.begin([FirstRunner(pool), LastRunner(pool), LastRunner(pool)])
    jobs = [Job(b"", b"", 1, 1.0, Future()) for _ in range(3)]
    for job in jobs:
        pool.put(job)
    while not pool.runners[0].has_answered:
        time.sleep(0.001)
    closing = threading.Thread(target=pool.close, daemon=True)
    closing.start()
    closing.join(20.0)
    assert not closing.is_alive()
    assert all(job.answer.done() for job in jobs)


HELD = """
import ctypes, os, sys
from angler_mjx.planning.host.worker import end_with
end_with(int(sys.argv[1]))
print("held", flush=True)
ctypes.PyDLL(None).sleep(600)
"""


def test_a_process_ends_with_a_pipe_though_it_holds_the_interpreter():
    watch, alive = os.pipe()
    with subprocess.Popen(
        [sys.executable, "-c", HELD, str(watch)],
        stdout=subprocess.PIPE,
        env=environment(),
        pass_fds=[watch],
        start_new_session=True,
    ) as held:
        os.close(watch)
        assert held.stdout.readline() == b"held\n"
        assert held.poll() is None
        os.close(alive)
        assert held.wait(timeout=60) == -signal.SIGIO


PARENT = """
import pickle, sys
from angler_mjx.planning.host.workers import Workers
spec, problem = pickle.loads(sys.stdin.buffer.read())
with Workers(spec, 1) as pool:
    ticket = pool.submit(problem)
    while not pool.pids(): pass
    print(*pool.pids(), flush=True)
    pool.take(ticket)
"""


@pytest.mark.nightly(by="test_a_process_ends_with_a_pipe, test_a_closed_pool_tells_who_waits")
@pytest.mark.parametrize("by", [signal.SIGKILL, signal.SIGINT])
def test_workers_end_with_their_parent_though_they_hold_the_interpreter(spec, folder, by):
    (folder / "holds").unlink(missing_ok=True)
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=environment(),
    )
    with parent.stdin as said:
        said.write(pickle.dumps((spec, ask("holds", deadline_s=600.0))))
    (pid,) = [int(pid) for pid in parent.stdout.readline().split()]
    wait_for((folder / "holds").exists)
    parent.send_signal(by)
    parent.wait(timeout=30)
    parent.stdout.close()
    wait_for(lambda: not psutil.pid_exists(pid))


@pytest.mark.nightly(by="test_ompl.py")
def test_ompl_plans_the_same_in_any_worker():
    pytest.importorskip("ompl", reason="needs the extra plan: OMPL")
    spec = PlannerSpec(reference=register.find("RRTConnect"), settings={"range_m": 2.0})
    wall = (5, slice(0, 7), slice(None))
    asked = [problem(rock=[wall], seed=seed, deadline_s=5.0) for seed in range(6)]
    answers = []
    for count in (1, 2):
        with Workers(spec, count) as pool:
            tickets = [pool.submit(one) for one in asked]
            answers.append([pool.take(ticket) for ticket in tickets])
    for one, other in zip(*answers, strict=True):
        assert one.status == "planned"
        np.testing.assert_array_equal(one.paths[0].position_m, other.paths[0].position_m)
    assert answers[0][0].extras["warm_up_s"] > 0
    assert "warm_up_s" not in answers[0][1].extras


def environment():
    return {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}


def wait_for(holds, within_s=60.0):
    end = time.monotonic() + within_s
    while not holds():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)
