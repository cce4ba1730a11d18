"""`angler fly`: one scene through a session, by a policy or with plans updated in flight."""

import sys
import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from angler_mjx.cli.shared.device import Device, choose_device, keep_all_programs
from angler_mjx.cli.sitl.commands import CommandLevel, PositionSource
from angler_mjx.cli.sitl.run import build_opener as real_autopilots
from angler_mjx.cli.sitl.run import require_sitl
from angler_mjx.errors import ConfigError, RunError

if TYPE_CHECKING:
    from angler_mjx.runs.session.interface import Observation

_EXIT_INTERRUPTED = 130
"""Exit code of a shell command after Ctrl-C."""


def fly(
    scenario: Annotated[str, tyro.conf.Positional],
    planner: str | None = None,
    replan_hz: float | None = None,
    information: str | None = None,
    order: Literal["auto", "free", "kept"] | None = None,
    policy: str | None = None,
    session: Literal["sim", "sitl"] = "sim",
    out: Path | None = None,
    world: int = 0,
    seed: int | None = None,
    level: CommandLevel | None = None,
    source: PositionSource | None = None,
    isolate: bool = False,
    ardusub: Path | None = None,
    device: Device = "cpu",
) -> None:
    """Fly one world step by step: by a policy, with replanning, or in the order of passing.

    Args:
        scenario: Name of a shipped scenario, or path of a scenario file (.toml).
        planner: Planner; the scenario's if left out.
        replan_hz: Rate of replanning in flight; 0: none.
        information: Information level of planners and policies, such as
            obstacles=observed,current=predicted; nothing for a part that is not named. The
            scenario's if left out.
        order: Order of passing: free, kept (robots wait for those that pass a place before them by
            the plans), or auto.
        policy: Policy that commands the robots instead of their plans: none, mppi, routes, reach,
            or FILE.py:CLASS; the scenario's if left out.
        session: Vehicles: simulated, or real autopilots.
        out: Run folder to make, for figures, replays and exports.
        world: Index of the world.
        seed: Seed of the run; the scenario's if left out.
        level: For --session sitl, the command level; guided (targets) if left out.
        source: For --session sitl, the source of ArduSub's position; vision if left out.
        isolate: For --session sitl, run in a network namespace of its own.
        ardusub: For --session sitl, the ArduSub binary; if left out, that of ANGLER_ARDUSUB, else
            the installed one.
        device: Device to compute on.
    """
    sitl_flags = {"level": level, "source": source, "ardusub": ardusub}
    sitl_only = [
        *(f for f, value in sitl_flags.items() if value is not None),
        *["isolate"] * isolate,
    ]
    if session == "sim" and sitl_only:
        raise ConfigError(f"--{sitl_only[0]}: only real autopilots have that; add --session sitl")
    if session == "sitl":
        require_sitl(isolate=isolate, gcs=None)
    choose_device(device)
    keep_all_programs()
    from angler_mjx.cli.shared.inputs import (
        build_flyable_scenario,
        build_planner_table,
        build_policy_table,
        parse_information,
    )
    from angler_mjx.planning.online import host_replanner
    from angler_mjx.runs.session.online_policy import OnlineFlyer
    from angler_mjx.runs.session.recording import SessionRecording
    from angler_mjx.runs.session.session_flight import build_course
    from angler_mjx.runs.session.session_flight import fly_session as flying
    from angler_mjx.runs.storage import folder
    from angler_mjx.scenario import notices
    from angler_mjx.teleop import opening
    from angler_mjx.teleop.signals import stop_on_signal

    loaded = build_flyable_scenario(
        scenario,
        seed=seed,
        planner=build_planner_table(
            planner, replan_hz=replan_hz, information=parse_information(information)
        ),
        execution=None if order is None else {"order": order},
        policy=build_policy_table(policy, parse_information(information)),
    )
    if not loaded.flown:
        raise ConfigError(
            "angler fly: the scenario has no replanning, no order and no policy; give "
            "--replan-hz, --order kept, --policy mppi or --policy routes (angler rollout flies "
            "plans as they are)"
        )
    for line in notices.run_notices(loaded, uses_planner=loaded.task_spec() is None):
        print(line, file=sys.stderr)
    opener: opening.SessionOpener = opening.open_simulated
    if session == "sitl":
        opener = real_autopilots(
            level=level or "guided", source=source or "vision", gcs=None, ardusub=ardusub
        )
    report, start_s = partial(print, file=sys.stderr), time.perf_counter()
    with ExitStack() as stack:
        recording = None
        if out is not None:
            recording = stack.enter_context(SessionRecording(out, loaded, world))
        logs = None if recording is None else recording.building / folder.ROBOTS
        scene = opener(loaded, world, logs, report).session
        stack.callback(scene.close)
        stack.callback(host_replanner.close_workers)
        if recording is not None:
            recording.begin(scene)
        report("compiling what commands the robots")
        flyer = OnlineFlyer(scene, report=report)
        compile_s = time.perf_counter() - start_s

        def report_step(observation: "Observation") -> None:
            if recording is not None:
                recording.after(observation)
            if round(observation.time_s / scene.dt_s) % round(10.0 / scene.dt_s) == 0:
                running = sum(status.outcome.name == "RUNNING" for status in observation.status)
                report(
                    f"{observation.time_s:.0f} s of {loaded.time.horizon_s:g} s, {running} running"
                )

        stop = stack.enter_context(stop_on_signal())
        flight = flying(scene, loaded.time.horizon_s, report_step, flyer, lambda: stop.requested)
        stop.closing = True
        run = None if recording is None else recording.close(build_course(flight, compile_s))
    time_s, wall_s = flight.last.time_s, flight.wall_s
    pace = time_s / max(wall_s, 1e-9)
    print(f"{time_s:.2f} s of the scene in {wall_s:.2f} s ({pace:.1f} times real time)")
    for reason, count in host_replanner.take_failures():
        print(f"planning in flight failed {count} times: {reason}", file=sys.stderr)
    for i, status in enumerate(flight.last.status):
        refused = f", refused: {status.refused}" if status.refused else ""
        print(f"robot_{i}: {status.outcome.name.lower()}{refused}")
    if run is not None:
        print(run.path)
    if flight.broken:
        note = "nothing is kept" if run is None else f"what was flown until then is in {run.path}"
        if not stop.requested:
            raise RunError(f"{flight.broken}\n{note}")
        print(f"angler: interrupted; {note}", file=sys.stderr)
        sys.exit(_EXIT_INTERRUPTED)
