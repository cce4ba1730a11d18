"""Results in order, interruptions, and the end of processes."""

import math
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from angler_mjx.errors import RunError
from angler_mjx.runs.storage import parallel

WAIT_S = 30.0


def test_results_come_in_the_order_of_their_arguments():
    numbers = list(range(2, 40))
    expected = [math.factorial(number) for number in numbers]
    assert list(parallel.map_in_order(math.factorial, numbers, None)) == expected
    with parallel.open_processes(2, "math") as pool:
        assert list(parallel.map_in_order(math.factorial, numbers, pool)) == expected
        with pytest.raises(ValueError, match="not defined for negative"):
            list(parallel.map_in_order(math.factorial, [1, -1, 2], pool))


def test_few_processes_are_none():
    for count in (0, 1):
        with parallel.open_processes(count, "math") as pool:
            assert pool is None


def test_few_arguments_are_taken_ahead_and_none_after_an_end(monkeypatch):
    monkeypatch.setattr(parallel, "MAX_PENDING", 3)
    taken = []
    with ThreadPoolExecutor(2) as pool:
        results = parallel.map_in_order(abs, (taken.append(i) or i for i in range(100)), pool)
        assert next(results) == 0
        assert taken == [0, 1, 2, 3]
        results.close()
    assert taken == [0, 1, 2, 3]


def test_a_killed_process_is_said():
    killed = pytest.raises(RunError, match="a process of the pool was killed")
    with parallel.open_processes(2, "math") as pool, killed:
        list(parallel.map_in_order(os._exit, [1], pool))


def interrupt_after_one(pool):
    for _ in parallel.map_in_order(time.sleep, [0.1] * 200, pool):
        raise KeyboardInterrupt


def test_an_interruption_waits_for_what_is_in_work_alone():
    begin_s = time.monotonic()
    interrupted = pytest.raises(KeyboardInterrupt)
    with interrupted, parallel.open_processes(2, "math") as pool:
        interrupt_after_one(pool)
    assert not multiprocessing.active_children()
    assert time.monotonic() - begin_s < 200 * 0.1 / 2


PARENT = """
import os, time
from angler_mjx.runs.storage import parallel
with parallel.open_processes(2, "math") as pool:
    print(pool.submit(os.getpid).result(), flush=True)
    time.sleep(600)
"""


def is_alive(process):
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def test_processes_end_with_a_killed_parent():
    with subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE) as parent:
        child = int(parent.stdout.readline())
        assert is_alive(child)
        parent.send_signal(signal.SIGKILL)
    end_s = time.monotonic() + WAIT_S
    while (alive := is_alive(child)) and time.monotonic() < end_s:
        time.sleep(0.05)
    assert not alive
