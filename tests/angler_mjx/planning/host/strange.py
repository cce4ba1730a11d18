"""A planner that does what the problem's seed says, for tests of the workers."""

import ctypes
import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from angler_mjx.planning.planner import NoPlan, way_points

WAYS = (
    "straight",
    "throws",
    "exits",
    "hangs",
    "holds",
    "segfaults",
    "late",
    "partial",
    "slow",
)


class Strange:
    @dataclass(frozen=True)
    class Settings:
        folder: str = "."
        slow_s: float = 1.0

    def __init__(self, settings):
        self.settings = settings
        self.extras = {}

    def plan(self, problem):
        return getattr(self, WAYS[int(problem.seed)])(problem)

    def straight(self, problem):
        self.extras = {"seed": int(problem.seed), "text": "no number"}
        team = problem.team
        length = np.linalg.norm(team.goal_m - team.start_m, axis=1)
        ends = length / team.cruise_speed_mps
        return [
            way_points([0, end], [a, b])
            for end, a, b in zip(ends, team.start_m, team.goal_m, strict=True)
        ]

    def throws(self, problem):
        raise ValueError("no such reef\nhere")

    def exits(self, problem):
        raise SystemExit(3)

    def hangs(self, problem):
        while True:
            time.sleep(0.01)

    def holds(self, problem):
        """Without letting any other thread of Python run."""
        Path(self.settings.folder, "holds").touch()
        ctypes.PyDLL(None).sleep(600)

    def segfaults(self, problem):
        os.kill(os.getpid(), signal.SIGSEGV)

    def late(self, problem):
        time.sleep(1.2 * problem.deadline_s)
        return self.straight(problem)

    def partial(self, problem):
        return [*self.straight(problem)[:-1], NoPlan("too far")]

    def slow(self, problem):
        Path(self.settings.folder, "slow").touch()
        time.sleep(self.settings.slow_s)
        return self.straight(problem)


class Counts:
    """How often this one was warmed up and asked."""

    def __init__(self):
        self.extras = {"warmed": 0, "asked": 0}

    def warm_up(self, problem):
        self.extras["warmed"] += 1
        time.sleep(0.01)

    def plan(self, problem):
        self.extras["asked"] += 1
        return [NoPlan("counted")] * problem.robots


class Unmade:
    def __init__(self):
        raise RuntimeError("no licence")
