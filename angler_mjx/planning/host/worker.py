"""The inside of a worker process: makes planners, and has them plan what comes down the pipe.

A planner is anybody's code. Whatever it raises is its failure on that problem, and no more.
Only `angler_mjx.planning.host.processes` starts it. Down come the pool's own planner (or None),
then for each problem its planner and the problem, pickled. A message up is a pickled tuple that
begins with a word: ``ready`` (or ``cannot`` and why not), then for each problem ``began``, when the
planner is asked, and ``done`` with the answer.
"""

import pickle
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection

from angler_mjx.planning.answers import Answer, answer, failed
from angler_mjx.planning.host.processes.ending import end_with
from angler_mjx.planning.planner import Planner
from angler_mjx.planning.problem import Problem
from angler_mjx.planning.register import PlannerSpec

CHARACTERS = 300
"""Of an exception's text that are told."""


@dataclass
class _Kept:
    """A planner that was made here."""

    planner: Planner
    most_points: int
    warm: Callable[[Problem], object] | None
    """Until it was called."""


class _Refused(str):
    """Why a planner cannot be made."""


def main(pipe: int, watch: int) -> None:
    """Works until there is nobody left to work for.

    Args:
        pipe: descriptor of the socket to the pool.
        watch: descriptor of a pipe that ends with the pool's process.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with(watch)
    kept: dict[bytes, _Kept | _Refused] = {}
    with Connection(pipe) as wire:
        try:
            own = wire.recv_bytes()
            if own != pickle.dumps(None):
                kept[own] = made = _made(own)
                if isinstance(made, _Refused):
                    wire.send(("cannot", str(made)))
                    return
            wire.send(("ready",))
            while True:
                _serve(wire, kept)
        except (EOFError, BrokenPipeError, ConnectionResetError):
            return


def told(error: BaseException) -> str:
    """Type and text of an exception, for a table."""
    text = " ".join(str(error).split())
    name = type(error).__name__
    return f"{name}: {text[:CHARACTERS]}" if text else name


def _serve(wire: Connection, kept: dict[bytes, _Kept | _Refused]) -> None:
    """Answers one problem."""
    made_of = wire.recv_bytes()
    problem: Problem = pickle.loads(wire.recv_bytes())
    if made_of not in kept:
        kept[made_of] = _made(made_of)
    made = kept[made_of]
    if isinstance(made, _Refused):
        why = f"the planner cannot be made: {made}"
        wire.send(("began",))
        wire.send(("done", failed(problem.robots, "error", why, 0.0)))
        return
    warm_up_s = 0.0
    if made.warm is not None:
        begin = time.perf_counter()
        try:
            made.warm(problem)
        except BaseException as error:
            wire.send(("began",))
            wire.send(("done", failed(problem.robots, "error", told(error), 0.0)))
            return
        made.warm, warm_up_s = None, time.perf_counter() - begin
    wire.send(("began",))
    given = _planned(made.planner, problem, made.most_points)
    if warm_up_s:
        given.extras["warm_up_s"] = warm_up_s
    wire.send(("done", given))


def _made(made_of: bytes) -> _Kept | _Refused:
    try:
        spec: PlannerSpec = pickle.loads(made_of)
        planner = spec.make()
        return _Kept(planner, spec.most_points, getattr(planner, "warm_up", None))
    except BaseException as error:
        return _Refused(told(error))


def _planned(planner: Planner, problem: Problem, most_points: int) -> Answer:
    begin = time.perf_counter()
    try:
        paths = planner.plan(problem)
    except BaseException as error:
        return failed(problem.robots, "error", told(error), time.perf_counter() - begin)
    planning_s = time.perf_counter() - begin
    extras, progress = (getattr(planner, name, None) for name in ("extras", "progress"))
    return answer(paths, problem, planning_s, extras, most_points, progress)
