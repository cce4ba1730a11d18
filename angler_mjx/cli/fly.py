"""`angler fly`: one scene, by a policy or by plans that are looked after, through a session."""

import sys
import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from angler_mjx.cli.shared.device import Device, choose, keep_all_programs
from angler_mjx.cli.sitl.run import Level, Source, prepare
from angler_mjx.cli.sitl.run import opener as real_autopilots
from angler_mjx.errors import ConfigError, RunError

_INTERRUPTED = 130
"""Exit code of a shell's command that Ctrl-C ended."""


def fly(
    scenario: Annotated[str, tyro.conf.Positional],
    planner: str | None = None,
    replan_hz: float | None = None,
    knows: str | None = None,
    order: Literal["auto", "free", "kept"] | None = None,
    policy: Literal["none", "mppi", "routes"] | None = None,
    session: Literal["sim", "sitl"] = "sim",
    out: Path | None = None,
    world: int = 0,
    seed: int | None = None,
    level: Level | None = None,
    source: Source | None = None,
    isolate: bool = False,
    ardusub: Path | None = None,
    device: Device = "cpu",
) -> None:
    """Fly one world step by step, planning anew, keeping order, or by a policy.

    Args:
        scenario: Name of a shipped scenario, or path of a scenario file (.toml).
        planner: That plans; the scenario's if left out.
        replan_hz: How often robots are planned for anew while they fly; 0: never.
        knows: What planners and policies are told of what moves, such as
            obstacles=observed,current=predicted; of what is not named, nothing. The scenario's if
            left out.
        order: Whether robots that are in time wait for those that are to pass a place before them.
        policy: That commands the robots instead of their plans; the scenario's if left out.
        session: What moves: the simulator, or real autopilots.
        out: Run folder to make, for figures, replays and exports.
        world: Index of the world.
        seed: Seed of the run; the scenario's if left out.
        level: For --session sitl, what is sent; guided (targets) if left out.
        source: For --session sitl, where ArduSub learns its position; vision if left out.
        isolate: For --session sitl, do it in a network namespace of its own.
        ardusub: For --session sitl, the ArduSub to run; else ANGLER_ARDUSUB, else the installed
            one.
        device: Where to compute.
    """
    given = {"level": level, "source": source, "ardusub": ardusub}
    named = [*(f for f, value in given.items() if value is not None), *["isolate"] * isolate]
    if session == "sim" and named:
        raise ConfigError(f"--{named[0]}: only real autopilots have that; add --session sitl")
    if session == "sitl":
        prepare(isolate=isolate, gcs=None)
    choose(device)
    keep_all_programs()
    from angler_mjx.cli.shared.inputs import (
        knows_given,
        planner_given,
        policy_given,
        scenario_to_fly,
    )
    from angler_mjx.planning.online import host_planner
    from angler_mjx.runs.session.flying import course
    from angler_mjx.runs.session.flying import fly as flying
    from angler_mjx.runs.session.online import OnlineFlyer
    from angler_mjx.runs.session.recording import SessionRecording
    from angler_mjx.runs.storage import folder
    from angler_mjx.scenario import notices
    from angler_mjx.teleop import opening
    from angler_mjx.teleop.signals import stoppable

    loaded = scenario_to_fly(
        scenario,
        seed=seed,
        planner=planner_given(planner, replan_hz=replan_hz, knows=knows_given(knows)),
        execution=None if order is None else {"order": order},
        policy=policy_given(policy, knows_given(knows)),
    )
    if not loaded.flown:
        raise ConfigError(
            "angler fly: the scenario plans nothing anew, keeps no order and names no policy; give "
            "--replan-hz, --order kept, --policy mppi or --policy routes (angler rollout flies "
            "plans as they are)"
        )
    for line in notices.lines(loaded, planned=loaded.task_spec() is None):
        print(line, file=sys.stderr)
    opener: opening.Opener = opening.simulated
    if session == "sitl":
        opener = real_autopilots(
            level=level or "guided", source=source or "vision", gcs=None, ardusub=ardusub
        )
    tell, begun = partial(print, file=sys.stderr), time.perf_counter()
    with ExitStack() as stack:
        recording = None
        if out is not None:
            recording = stack.enter_context(SessionRecording(out, loaded, world))
        logs = None if recording is None else recording.building / folder.ROBOTS
        scene = opener(loaded, world, logs, tell).session
        stack.callback(scene.close)
        stack.callback(host_planner.close)
        if recording is not None:
            recording.begin(scene)
        tell("compiling what commands the robots")
        flyer = OnlineFlyer(scene)
        compile_s = time.perf_counter() - begun

        def watch(seen: Any) -> None:
            if recording is not None:
                recording.after(seen)
            if round(seen.time_s / scene.dt_s) % round(10.0 / scene.dt_s) == 0:
                running = sum(status.outcome.name == "RUNNING" for status in seen.status)
                tell(f"{seen.time_s:.0f} s of {loaded.time.horizon_s:g} s, {running} running")

        stop = stack.enter_context(stoppable())
        flown = flying(scene, loaded.time.horizon_s, watch, flyer, lambda: stop.asked)
        stop.closing = True
        run = None if recording is None else recording.close(course(flown, compile_s))
    time_s, wall_s = flown.last.time_s, flown.wall_s
    pace = time_s / max(wall_s, 1e-9)
    print(f"{time_s:.2f} s of the scene in {wall_s:.2f} s ({pace:.1f} times real time)")
    for reason, count in host_planner.take_failures():
        print(f"planning in flight failed {count} times: {reason}", file=sys.stderr)
    for i, status in enumerate(flown.last.status):
        refused = f", refused: {status.refused}" if status.refused else ""
        print(f"robot_{i}: {status.outcome.name.lower()}{refused}")
    if run is not None:
        print(run.path)
    if flown.broken:
        kept = "nothing is kept" if run is None else f"what was flown until then is in {run.path}"
        if not stop.asked:
            raise RunError(f"{flown.broken}\n{kept}")
        print(f"angler: interrupted; {kept}", file=sys.stderr)
        sys.exit(_INTERRUPTED)
