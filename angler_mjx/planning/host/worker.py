"""Main program of a worker process: makes planners and plans the problems that it receives.

Any exception of a planner is its answer to that problem. Only `process.WorkerProcess` starts this
program. It sends the pool's own planner (or None), then for each problem its planner and the
problem, pickled. It receives pickled tuples that begin with a word: ``ready`` (or ``cannot`` and
the reason), then for each problem ``began``, when the planner starts, and ``done`` with the answer.
"""

import fcntl
import os
import pickle
import select
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

from angler_mjx.errors import AnglerError, describe_error
from angler_mjx.planning.answers import Answer, check_answer, failed_answer
from angler_mjx.planning.planner import Planner
from angler_mjx.planning.problem import Problem
from angler_mjx.planning.register import PlannerSpec


@dataclass
class _LoadedPlanner:
    """A planner that this process made."""

    planner: Planner
    max_points: int
    file: Path | None
    """File of its class; None of a module."""
    warm: Callable[[Problem], object] | None
    """Its ``warm_up``; None without, and after the call."""


class _LoadFailure(str):
    """Reason why a planner cannot be made."""


def end_with(watch: int) -> None:
    """Let the kernel end this process's group when the other end of a pipe is closed.

    A thread that watched the pipe would wait for the interpreter, which a planner may hold without
    end; the default action of the kernel's signal (SIGIO) needs no interpreter.

    Args:
        watch: descriptor of a pipe's reading end, to which nothing is ever written.
    """
    fcntl.fcntl(watch, fcntl.F_SETOWN, -os.getpgrp())
    fcntl.fcntl(watch, fcntl.F_SETFL, fcntl.fcntl(watch, fcntl.F_GETFL) | os.O_ASYNC)
    if select.select([watch], [], [], 0.0)[0]:
        sys.exit(1)


def main(pipe: int, watch: int) -> None:
    """Plan until the pool closes its end of the pipe.

    Args:
        pipe: descriptor of the socket to the pool.
        watch: descriptor of a pipe that ends with the pool's process.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with(watch)
    planners: dict[bytes, _LoadedPlanner | _LoadFailure] = {}
    with Connection(pipe) as connection:
        try:
            packed_planner = connection.recv_bytes()
            if packed_planner != pickle.dumps(None):
                planners[packed_planner] = planner = _load_planner(packed_planner)
                if isinstance(planner, _LoadFailure):
                    connection.send(("cannot", str(planner)))
                    return
            connection.send(("ready",))
            while True:
                _serve_problem(connection, planners)
        except (EOFError, BrokenPipeError, ConnectionResetError):
            return


def _serve_problem(
    connection: Connection, planners: dict[bytes, _LoadedPlanner | _LoadFailure]
) -> None:
    """Receive one problem and send its answer."""
    packed_planner = connection.recv_bytes()
    problem: Problem = pickle.loads(connection.recv_bytes())
    if packed_planner not in planners:
        planners[packed_planner] = _load_planner(packed_planner)
    planner = planners[packed_planner]
    if isinstance(planner, _LoadFailure):
        reason = f"the planner cannot be made: {planner}"
        connection.send(("began",))
        connection.send(("done", failed_answer(problem.robots, "error", reason, 0.0)))
        return
    warm_up_s = 0.0
    if planner.warm is not None:
        begin = time.perf_counter()
        try:
            planner.warm(problem)
        except BaseException as error:
            connection.send(("began",))
            reason = describe_error(error, planner.file)
            connection.send(("done", failed_answer(problem.robots, "error", reason, 0.0)))
            return
        planner.warm, warm_up_s = None, time.perf_counter() - begin
    connection.send(("began",))
    result = _run_planner(planner, problem)
    if warm_up_s:
        result.extras["warm_up_s"] = warm_up_s
    connection.send(("done", result))


def _load_planner(packed_planner: bytes) -> _LoadedPlanner | _LoadFailure:
    file = None
    try:
        spec: PlannerSpec = pickle.loads(packed_planner)
        file = spec.reference.file
        planner = spec.make()
        return _LoadedPlanner(planner, spec.max_points, file, getattr(planner, "warm_up", None))
    except AnglerError as error:
        return _LoadFailure(error)
    except BaseException as error:
        return _LoadFailure(describe_error(error, file))


def _run_planner(loaded: _LoadedPlanner, problem: Problem) -> Answer:
    begin = time.perf_counter()
    try:
        paths = loaded.planner.plan(problem)
    except BaseException as error:
        reason = describe_error(error, loaded.file)
        return failed_answer(problem.robots, "error", reason, time.perf_counter() - begin)
    planning_s = time.perf_counter() - begin
    extras, progress = (getattr(loaded.planner, name, None) for name in ("extras", "progress"))
    return check_answer(paths, problem, planning_s, extras, loaded.max_points, progress)
