"""Random scenarios for the simulator: ``python -m tests.fuzz.simulator --worlds 10000 --seed 1``.

Each program (a scenario with its compiled engines) flies many worlds. What fails is made simpler as
long as it still fails, and lies in ``--out`` then as a scenario file that can be flown again:
``python -m tests.fuzz.simulator --case FILE``. The exit code is 1 if anything failed.
"""

import argparse
import os
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from . import cases
from .cases import Case

ENGINES = ("mjx", "fused")
JUDGED = 4
"""Worlds of a program that the referee judges, of every `JUDGED`-th program."""


@dataclass(kw_only=True)
class Found:
    """What came of one case; plain, so that it can come from another process."""

    number: int = -1
    about: str = ""
    worlds: int = 0
    robots: int = 0
    wall_s: float = 0.0
    outcomes: dict = field(default_factory=dict)
    """How many robots, by outcome, of all engines."""
    faults: list = field(default_factory=list)
    excused: list = field(default_factory=list)
    """Outcomes that rounding decided otherwise."""
    worst_energy: float = 0.0
    fastest_radps: float = 0.0
    judged: int = 0
    """Robots that the referee judged."""
    written: str = ""


def examine(case: Case, engines=ENGINES, *, tile: int) -> Found:
    """Fly a case by engines and look at everything.

    Args:
        case: to fly; if it names a world, only the tile with that world. The last engine's run is
            given to the referee.
        engines: one, or two to compare.
        tile: worlds in one call; the scenario's own if it has one.
    """
    import jax

    from angler_mjx.runs.simulator.simulator import Simulator

    from . import flying
    from .agreement import compare

    begun, found = time.perf_counter(), Found(about=case.scenario["description"])
    with tempfile.TemporaryDirectory() as place:
        scenarios = [case.load(Path(place), engine=engine) for engine in engines]
        tile = scenarios[0].tile or min(tile, scenarios[0].worlds)
        policy = flying.driver(case.signals)
        simulators = [Simulator(one, tile=tile, policy=policy) for one in scenarios]
        total = scenarios[0].worlds
        firsts = range(0, total, tile)
        if case.world is not None:
            firsts = [case.world - case.world % tile]
        for first in firsts:
            drawn, flights = simulators[0].worlds(first), []
            for simulator in simulators:
                worlds = drawn if simulator is simulators[0] else simulator.adopt(drawn)
                flights.append(flying.fly(simulator, worlds, first))
            for flight in flights:
                found.faults += flight.faults
                found.worst_energy = max(found.worst_energy, flight.worst_energy)
                found.fastest_radps = max(found.fastest_radps, flight.fastest_radps)
                _count(found, flight.tally.outcome)
            if len(flights) == 2:
                faults, excused = compare(*flights, bounds(simulators[0], drawn))
                found.faults += faults
                found.excused += excused
            found.worlds += tile
            found.robots += flights[0].tally.outcome.size
        if case.referee:
            _referee(case, Path(place), engines[-1], found)
    if case.world is not None:
        found.faults = [one for one in found.faults if one.world == case.world]
    jax.clear_caches()
    found.wall_s = time.perf_counter() - begun
    return found


def _count(found: Found, outcomes) -> None:
    from angler_mjx.sim.state import Outcome

    for k, count in zip(*np.unique(outcomes, return_counts=True), strict=True):
        name = Outcome(int(k)).name.lower()
        found.outcomes[name] = found.outcomes.get(name, 0) + int(count)


def bounds(simulator, worlds):
    """Where episodes of a tile end otherwise than by touch."""
    from .agreement import Bounds

    grid = worlds.environment.grid
    low = np.asarray(grid.origin_m[0], float)
    shape = np.asarray(grid.occupied.shape[1:])
    return Bounds(
        goal_m=np.asarray(worlds.environment.goal_m, float),
        low_m=low,
        high_m=low + shape * float(np.asarray(grid.cell_m).ravel()[0]),
        goal_tolerance_m=simulator.spec.goal_tolerance_m,
    )


def _referee(case: Case, place: Path, engine: str, found: Found) -> None:
    """Record a few worlds, and have the second judge look at them."""
    from angler_mjx.runs.rollout import rollout
    from angler_mjx.testing import referee

    from .flying import Fault, driver

    scenario = case.load(place, engine=engine, worlds=case.referee)
    rollout(scenario, out=place / "run", policy=driver(case.signals))
    verdict = referee.judge(place / "run")
    found.judged = verdict.robots
    found.faults += [
        Fault(kind="referee", world=one.world, robot=one.robot, said=one.line())
        for one in verdict.differences
        if one.result == "disagrees"
    ]


def shrink(case: Case, fault, engines, *, tile: int, tries: int) -> tuple[Case, list]:
    """The simplest case with a fault of that kind, within so many more programs.

    Returns:
        The case, with the world that fails, and its faults.
    """
    size = case.scenario.get("tile") or min(tile, case.scenario["worlds"])
    kept, faults = case.but(tile=size, worlds=fault.world + 1), [fault]
    judged = fault.world + 1 if fault.kind == "referee" else 0
    kept = replace(kept, world=fault.world, referee=judged)

    def still(one: Case):
        found = examine(one, engines, tile=size)
        return [other for other in found.faults if other.kind == fault.kind]

    first = [kept.but(tile=1), *cases.simpler(kept)]
    while tries > 0 and first:
        candidate, tries = first.pop(0), tries - 1
        if seen := still(candidate):
            kept, faults = candidate, seen
            first = cases.simpler(kept)
    return kept, faults


def program(number: int, given) -> Found:
    """One program of the campaign: drawn, flown, and made simpler where it fails."""
    case = cases.draw(given.seed, number, worlds=given.each, horizon_s=given.horizon_s)
    if given.referee and number % JUDGED == 0:
        case = replace(case, referee=JUDGED)
    found = examine(case, given.engines, tile=given.tile)
    found.number = number
    if found.faults:
        folder = given.out / f"{given.seed}-{number}"
        kept, faults = shrink(
            case, found.faults[0], given.engines, tile=given.tile, tries=given.shrink
        )
        why = "\n".join(one.line() for one in faults[:20])
        found.written = str(kept.write(folder, why))
    return found


def _given():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", type=int, default=1000, help="of all programs together")
    parser.add_argument("--programs", type=int, default=11, help="scenarios, compiled each")
    parser.add_argument("--first", type=int, default=0, help="number of the first program")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--engine", choices=[*ENGINES, "both"], default="both")
    parser.add_argument("--horizon-s", type=float, default=60.0)
    parser.add_argument("--tile", type=int, default=128, help="most worlds in one call")
    parser.add_argument("--workers", type=int, default=max(1, (os.cpu_count() or 2) // 2))
    parser.add_argument("--shrink", type=int, default=8, help="programs to try for a simpler case")
    parser.add_argument("--no-referee", dest="referee", action="store_false")
    parser.add_argument("--case", type=Path, help="fly this scenario file alone")
    parser.add_argument("--out", type=Path, default=Path("runs/fuzz-sim"))
    given = parser.parse_args()
    given.engines = ENGINES if given.engine == "both" else (given.engine,)
    given.each = -(-given.worlds // given.programs)
    return given


def row(found: Found) -> str:
    """A line of the table."""
    outcomes = ", ".join(f"{n} {name}" for name, n in sorted(found.outcomes.items()))
    return (
        f"{found.number:4} {found.about:32} {found.worlds:6} {found.robots:6} "
        f"{found.wall_s:6.1f} s "
        f"{found.worst_energy:6.3f} {found.fastest_radps:6.1f} {found.judged:4} "
        f"{len(found.excused):4} {len(found.faults):5}  {outcomes}"
    )


def main() -> None:
    """Fly a campaign, or one case."""
    given = _given()
    if given.case is not None:
        case = cases.read(given.case)
        every = examine(case, given.engines, tile=given.tile)
        _tell([every])
        sys.exit(bool(every.faults))
    numbers = range(given.first, given.first + given.programs)
    done = []
    # Forked, workers would share the threads of what is imported by now.
    with ProcessPoolExecutor(given.workers, get_context("spawn")) as pool:
        jobs = [pool.submit(program, number, given) for number in numbers]
        for job in as_completed(jobs):
            done.append(job.result())
            print(row(done[-1]), flush=True)
    _tell(sorted(done, key=lambda one: one.number))
    sys.exit(any(one.faults for one in done))


def _tell(done: list[Found]) -> None:
    print(
        "   # program                          worlds robots   wall energy  rad/s ref. round fault"
    )
    for found in done:
        print(row(found))
        for line in found.excused[:20]:
            print(f"       by rounding: {line}")
        for fault in found.faults[:20]:
            print(f"       {fault.line()}")
        if found.written:
            print(f"       fails when run: python -m tests.fuzz.simulator --case {found.written}")
    diverged = sum(one.outcomes.get("diverged", 0) for one in done)
    slowest = max(done, key=lambda one: one.wall_s)
    print(
        f"{sum(one.worlds for one in done)} worlds, {sum(one.robots for one in done)} robots, "
        f"{sum(len(one.faults) for one in done)} faults, {diverged} robots marked as diverged, "
        f"{sum(len(one.excused) for one in done)} ends decided by rounding; slowest program "
        f"{slowest.number}, {slowest.wall_s:.0f} s"
    )


if __name__ == "__main__":
    main()
