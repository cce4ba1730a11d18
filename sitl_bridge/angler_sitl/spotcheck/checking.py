"""A spot check from a run folder to a report: pick, make again, fly, compare.

Each flight is written as it ends. What is interrupted is reported as far as it came, and goes on
where it stopped.
"""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

from angler_mjx.errors import ConfigError
from angler_mjx.robot.vehicles import library
from angler_mjx.runs.provenance import describe_environment
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.storage.folder import POLICY, Run
from angler_mjx.sim.state import World
from angler_sitl.firmware import binary as binaries
from angler_sitl.firmware import parameters as firmware
from angler_sitl.firmware.probe import identified
from angler_sitl.missions.choosing import speed_of
from angler_sitl.spotcheck import flight, flying, folder, page, picking, scenes
from angler_sitl.spotcheck.flight import RECORDED
from angler_sitl.spotcheck.flying import SpotcheckFlyer
from angler_sitl.spotcheck.picking import Pick
from angler_sitl.spotcheck.results import Key, SpotcheckResult, SpotcheckSettings


class SpotcheckProgress(Protocol):
    """Who is told how far it is."""

    def start(self, flights: int, done: int) -> None:
        """So many flights in all, so many done before."""
        ...

    def doing(self, what: str) -> None:
        """Something begins."""
        ...

    def at(self, share: float) -> None:
        """So much of the flight is done."""
        ...

    def flown(self) -> None:
        """A flight ended and was written."""
        ...


def check(
    run_path: Path,
    settings: SpotcheckSettings,
    out: Path,
    progress: SpotcheckProgress,
    *,
    resume: bool = False,
) -> SpotcheckResult:
    """Do a spot check and write its folder.

    Args:
        run_path: folder of a batch run with trajectories.
        settings: what is asked for.
        out: folder to make.
        progress: told how far it is.
        resume: go on with an interrupted one in ``out``.

    Returns:
        What was found; not complete after an interruption (Ctrl-C), and then as far as it came.

    Raises:
        ConfigError: no such run, one that a policy commanded, fewer worlds than asked for, no
            trajectories, a vehicle without a frame, no ArduSub, or a folder that cannot be used.
        RunError: a world cannot be made again, or an autopilot ended. What was flown stays.
    """
    found = plan(run_path, settings)
    if resume:
        found = _taken_up(found, folder.reopen(out, _asked(found)))
    else:
        folder.create(out)
    folder.write(out, _table(found))
    keys = _keys(found)
    left = [key for key in keys if not folder.flight_path(out, *key).is_file()]
    progress.start(len(keys), len(keys) - len(left))
    complete = False
    try:
        progress.doing("drawing the worlds again")
        worlds = scenes.draw(found.run.scenario, [pick.world for pick in found.picks])
        found = replace(found, likeness=_likeness(found, worlds))
        worlds = {index: scenes.planned(found.run, index, one) for index, one in worlds.items()}
        _fly_all(found, worlds, left, out, progress)
        complete = True
    except KeyboardInterrupt:
        if not found.likeness:
            raise
    found = replace(found, flights=_flights(found, out), complete=complete)
    page.write(out, found)
    folder.write(out, _table(found))
    return found


def load(run_path: Path, settings: SpotcheckSettings, out: Path) -> SpotcheckResult:
    """A spot check that was done before, whole or as far as it came.

    Args:
        run_path: folder of its run.
        settings: that it was asked with.
        out: its folder.

    Raises:
        ConfigError: there is none, it is damaged, or was asked something else.
    """
    found = plan(run_path, settings)
    table = folder.read(out)
    folder.require_asked(out, table, _asked(found))
    found = _taken_up(found, table)
    return replace(found, flights=_flights(found, out), complete=table["complete"])


def flies_plans(run: Run) -> bool:
    """Whether robots of a run flew plans, as autopilots can, and were not commanded otherwise."""
    return run.scenario.online or not (run.path / POLICY).exists()


def plan(run_path: Path, settings: SpotcheckSettings) -> SpotcheckResult:
    """What is to be done, with everything refused that can be before anything is computed.

    Raises:
        ConfigError: as in `check`.
    """
    run = Run(run_path)
    scenario = run.scenario
    if not flies_plans(run):
        raise ConfigError(
            f"{run.path / POLICY}: a policy commanded the robots of this run, and autopilots fly "
            "plans, not that; give a run of plans, flown as they are or made anew in flight"
        )
    _ = run.trajectories
    fleet = len(scenario.members())
    counts = tuple(dict.fromkeys(settings.robots)) or (fleet,)
    for count in counts:
        flying.crew(scenario, count)
    for entry in scenario.fleet:
        for level in settings.levels:
            firmware.for_vehicle(library.load(entry.vehicle), level, settings.source)
    if not settings.levels:
        raise ConfigError("--level: give guided, thrusters or both")
    speed_of(settings.speed)
    picks = picking.pick(
        run.episodes, settings.episodes, seed=settings.seed, stratify=settings.stratify
    )
    binary = identified(binaries.find(settings.binary))
    return SpotcheckResult(
        run=run,
        settings=settings,
        picks=picks,
        counts=counts,
        likeness={},
        autopilot=f"{binary.version}, sha256 {binary.sha256[:12]}",
        provenance=describe_environment(),
    )


def _asked(found: SpotcheckResult) -> dict[str, Any]:
    """All that the results depend on; another ArduSub flies otherwise."""
    asked = {"run": str(found.run.path), "ardusub": found.autopilot}
    return {**asked, **found.settings.asked()}


def _taken_up(found: SpotcheckResult, table: dict[str, Any]) -> SpotcheckResult:
    """With what an interrupted one knew; its worlds are those that it picked."""
    picks = tuple(Pick(**one) for one in table["picks"])
    return replace(found, picks=picks)


def _table(found: SpotcheckResult) -> dict[str, Any]:
    return {
        "asked": _asked(found),
        "complete": found.complete,
        "picks": [{"world": pick.world, "why": pick.why} for pick in found.picks],
        "likeness": {str(world): text for world, text in found.likeness.items()},
        "provenance": dict(found.provenance),
    }


def _keys(found: SpotcheckResult) -> list[Key]:
    """All flights, those of the batch simulator first."""
    names = (*found.settings.against, *found.settings.levels)
    return [
        (pick.world, name, count)
        for name in names
        for count in found.counts
        for pick in found.picks
    ]


def _likeness(found: SpotcheckResult, worlds: dict[int, World]) -> dict[int, str]:
    return {
        index: scenes.compare(found.run, index, world).text() for index, world in worlds.items()
    }


def _fly_all(
    found: SpotcheckResult,
    worlds: dict[int, World],
    keys: list[Key],
    out: Path,
    progress: SpotcheckProgress,
) -> None:
    """Fly; whoever flies is made once for all worlds with so many robots."""
    for count in found.counts:
        cut = _cut(found, worlds, count, progress)
        for name in (*found.settings.against, *found.settings.levels):
            now = [key for key in keys if key[1:] == (name, count)]
            if now:
                progress.doing(f"{name}, {count} robots: compiling")
                with _flyer(found, name, count) as flyer:
                    _fly(flyer, now, cut, out, progress)


def _cut(
    found: SpotcheckResult, worlds: dict[int, World], count: int, progress: SpotcheckProgress
) -> dict[int, World]:
    """The worlds with so many robots."""
    scenario = found.run.scenario
    if count == len(scenario.members()):
        return worlds
    progress.doing(f"{count} robots of {len(scenario.members())}")
    like = Simulator(scenes.one_world(flying.crew(scenario, count))).world_shape()
    return {index: scenes.cut(world, like, count) for index, world in worlds.items()}


def _flyer(found: SpotcheckResult, name: str, count: int) -> SpotcheckFlyer:
    """Whoever flies under this name."""
    settings, scenario = found.settings, flying.crew(found.run.scenario, count)
    for against in settings.against:
        if name == against:
            return flying.BatchFlyer(scenario, against)
    (level,) = (level for level in settings.levels if name == level)
    return flying.SitlFlyer(scenario, level, settings.source, settings.speed, settings.binary)


def _fly(
    flyer: SpotcheckFlyer,
    keys: Iterable[Key],
    worlds: dict[int, World],
    out: Path,
    progress: SpotcheckProgress,
) -> None:
    for key in keys:
        world, name, count = key
        progress.doing(f"{name}, {count} robots, world {world}")
        flown = flyer.fly(world, worlds[world], progress.at)
        flight.save(folder.flight_path(out, *key), flown)
        progress.flown()


def _flights(found: SpotcheckResult, out: Path) -> dict[Key, flight.SpotcheckFlight]:
    """All flights that are there, the recorded ones among them."""
    there: dict[Key, flight.SpotcheckFlight] = {}
    for pick in found.picks:
        for count in found.counts:
            there[pick.world, RECORDED, count] = flight.recorded(found.run, pick.world, count)
            for name in (*found.settings.against, *found.settings.levels):
                path = folder.flight_path(out, pick.world, name, count)
                if path.is_file():
                    there[pick.world, name, count] = flight.load(path)
    return there
