"""The inside of a worker process: makes a planner, and has it plan what comes down the pipe.

The planner is anybody's code. Whatever it raises is its failure on that problem, and no more.
Only `angler_mjx.planning.host.workers` starts it. A message is a pickled tuple that begins with a
word: up goes ``ready`` (or ``cannot`` and why not), then for each problem ``began``, when the
planner is asked, and ``done`` with the answer.
"""

import pickle
import signal
import time
from multiprocessing.connection import Connection

from angler_mjx.planning.answers import Answer, answer, failed
from angler_mjx.planning.host.processes.ending import end_with
from angler_mjx.planning.planner import Planner
from angler_mjx.planning.problem import Problem
from angler_mjx.planning.register import PlannerSpec

CHARACTERS = 300
"""Of an exception's text that are told."""


def main(pipe: int, watch: int) -> None:
    """Works until there is nobody left to work for.

    Args:
        pipe: descriptor of the socket to the pool.
        watch: descriptor of a pipe that ends with the pool's process.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with(watch)
    with Connection(pipe) as wire:
        try:
            spec: PlannerSpec = wire.recv()
            try:
                planner = spec.make()
            except BaseException as error:
                wire.send(("cannot", told(error)))
                return
            wire.send(("ready",))
            _serve(wire, planner, spec.most_points)
        except (EOFError, BrokenPipeError, ConnectionResetError):
            return


def told(error: BaseException) -> str:
    """Type and text of an exception, for a table."""
    text = " ".join(str(error).split())
    name = type(error).__name__
    return f"{name}: {text[:CHARACTERS]}" if text else name


def _serve(wire: Connection, planner: Planner, most_points: int) -> None:
    warm = getattr(planner, "warm_up", None)
    while True:
        problem: Problem = pickle.loads(wire.recv_bytes())
        warm_up_s = 0.0
        if warm is not None:
            begin = time.perf_counter()
            try:
                warm(problem)
            except BaseException as error:
                wire.send(("began",))
                wire.send(("done", failed(problem.robots, "error", told(error), 0.0)))
                continue
            warm, warm_up_s = None, time.perf_counter() - begin
        wire.send(("began",))
        given = _planned(planner, problem, most_points)
        if warm_up_s:
            given.extras["warm_up_s"] = warm_up_s
        wire.send(("done", given))


def _planned(planner: Planner, problem: Problem, most_points: int) -> Answer:
    begin = time.perf_counter()
    try:
        paths = planner.plan(problem)
    except BaseException as error:
        return failed(problem.robots, "error", told(error), time.perf_counter() - begin)
    planning_s = time.perf_counter() - begin
    extras, progress = (getattr(planner, name, None) for name in ("extras", "progress"))
    return answer(paths, problem, planning_s, extras, most_points, progress)
