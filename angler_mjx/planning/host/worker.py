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
from pathlib import Path

from angler_mjx.errors import AnglerError, described
from angler_mjx.planning.answers import Answer, answer, failed
from angler_mjx.planning.host.processes.ending import end_with
from angler_mjx.planning.planner import Planner
from angler_mjx.planning.problem import Problem
from angler_mjx.planning.register import PlannerSpec


@dataclass
class _Kept:
    """A planner that was made here."""

    planner: Planner
    most_points: int
    file: Path | None
    """Of its class, where it is one of a user's."""
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
            wire.send(("done", failed(problem.robots, "error", described(error, made.file), 0.0)))
            return
        made.warm, warm_up_s = None, time.perf_counter() - begin
    wire.send(("began",))
    given = _planned(made, problem)
    if warm_up_s:
        given.extras["warm_up_s"] = warm_up_s
    wire.send(("done", given))


def _made(made_of: bytes) -> _Kept | _Refused:
    file = None
    try:
        spec: PlannerSpec = pickle.loads(made_of)
        file = spec.reference.file
        planner = spec.make()
        return _Kept(planner, spec.most_points, file, getattr(planner, "warm_up", None))
    except AnglerError as error:
        return _Refused(error)
    except BaseException as error:
        return _Refused(described(error, file))


def _planned(kept: _Kept, problem: Problem) -> Answer:
    begin = time.perf_counter()
    try:
        paths = kept.planner.plan(problem)
    except BaseException as error:
        why = described(error, kept.file)
        return failed(problem.robots, "error", why, time.perf_counter() - begin)
    planning_s = time.perf_counter() - begin
    extras, progress = (getattr(kept.planner, name, None) for name in ("extras", "progress"))
    return answer(paths, problem, planning_s, extras, kept.most_points, progress)
