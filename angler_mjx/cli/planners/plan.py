"""`angler plan`: plan the worlds of a scenario into a file of plans."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from angler_mjx.cli.shared.device import Device, choose_device, keep_all_programs
from angler_mjx.errors import ConfigError

if TYPE_CHECKING:
    from angler_mjx.scenario.scenario import Scenario


def plan(
    scenario: Annotated[str | None, tyro.conf.Positional] = None,
    planner: str | None = None,
    information: str | None = None,
    worlds: int | None = None,
    seed: int | None = None,
    out: Path | None = None,
    workers: int | None = None,
    deadline_s: float | None = None,
    points: int | None = None,
    resume: bool = False,
    debug: int | None = None,
    device: Device | None = None,
    list_: Annotated[bool, tyro.conf.arg(name="list")] = False,
) -> None:
    """Plan the worlds of a scenario into a file; angler rollout --plans flies it.

    Args:
        scenario: Name of a shipped scenario, or path of a scenario file (.toml).
        planner: Planner of --list, or FILE.py:CLASS; the scenario's if left out.
        information: Information level of the planner, such as obstacles=observed,current=predicted;
            nothing for a part that is not named. The scenario's if left out.
        worlds: Number of worlds; the scenario's if left out.
        seed: Seed of the worlds; the scenario's if left out.
        out: File of plans to make; plans/NAME.zarr if left out.
        workers: Number of planning processes, for planners on the host; one for each processor if
            left out.
        deadline_s: Wall-clock limit for each world, s; the scenario's if left out.
        points: Max number of waypoints of a path; the scenario's if left out.
        resume: Continue an interrupted file.
        debug: Index of one world to plan alone, in this process: the planner's exception ends the
            command with its traceback, breakpoint() and python -m pdb work, nothing is written.
        device: Device to sample the worlds on; JAX's choice if left out.
        list_: List the planners, and exit.
    """
    choose_device(device)
    keep_all_programs()
    from angler_mjx.cli.shared.inputs import (
        build_flyable_scenario,
        build_planner_table,
        parse_information,
        require_plans,
        require_positive,
    )
    from angler_mjx.planning import register
    from angler_mjx.planning.planner_choice import AUTO

    if list_:
        print("\n".join([AUTO, *register.planner_names()]))
        return
    if scenario is None:
        raise ConfigError("angler plan: name a scenario; angler scenarios lists those that ship")
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    from angler_mjx.runs.simulator.simulator import Simulator
    from angler_mjx.runs.storage.planning_summary import reason_lines as planned_lines
    from angler_mjx.runs.storage.plans import write as plan_writer
    from angler_mjx.runs.storage.plans.read import summarise_plan_file
    from angler_mjx.scenario import notices

    table = {
        **(build_planner_table(planner, information=parse_information(information)) or {}),
        "deadline_s": deadline_s,
        "points": points,
    }
    planner_table = {key: value for key, value in table.items() if value is not None}
    loaded = build_flyable_scenario(
        scenario, worlds=worlds, seed=seed, planner=planner_table or None
    )
    if line := notices.planner_notice(loaded):
        print(line, file=sys.stderr)
    if debug is not None:
        _print_plans(loaded, debug)
        return
    out_path = out or Path("plans") / f"{loaded.name}.zarr"
    count = require_positive("workers", workers)
    simulator = Simulator(loaded, workers=count)
    robots = len(loaded.members())
    columns = ("worlds", BarColumn(), MofNCompleteColumn(), "{task.fields[found]}")
    with Progress(*columns, TimeRemainingColumn(), console=Console(stderr=True)) as bar:
        task = bar.add_task("worlds", total=loaded.worlds, found="")

        def advance(done: int, planned: int) -> None:
            bar.update(task, completed=done, found=f"{planned} paths")

        try:
            planned = plan_writer.plan_worlds(
                out_path, loaded, simulator, resume=resume, advance=advance
            )
        except KeyboardInterrupt:
            bar.stop()
            print(f"interrupted: go on with --resume --out {out_path}", file=sys.stderr)
            sys.exit(130)
        finally:
            simulator.close()
    planning = summarise_plan_file(out_path)
    for line in planned_lines(planning):
        print(line)
    print(f"{planned} of {loaded.worlds * robots} robots have a path")
    print(out_path)
    require_plans(planning, f"planner {loaded.planner.name}")


def _print_plans(scenario: "Scenario", world: int) -> None:
    """Plan one world in this process, and print the plan of each robot."""
    from angler_mjx.planning.planner import NoPlan
    from angler_mjx.runs.simulator import debugging

    for robot, path in enumerate(debugging.plan_in_process(scenario, world)):
        if isinstance(path, NoPlan):
            print(f"robot {robot}: no path: {path.reason}")
        else:
            print(f"robot {robot}: {len(path.time_s)} points, ends at {path.time_s[-1]:.1f} s")


def write_problems(
    scenario: Annotated[str, tyro.conf.Positional],
    worlds: int | None = None,
    seed: int | None = None,
    information: str | None = None,
    raw: bool = False,
    out: Path | None = None,
    device: Device | None = None,
) -> None:
    """Write the planning problems of a scenario's worlds to a Zarr file, for any planner.

    Args:
        scenario: Name of a shipped scenario, or path of a scenario file (.toml).
        information: Information level of the problems, such as
            obstacles=observed,current=predicted; nothing for a part that is not named. The
            scenario's if left out.
        raw: Write plain little-endian numbers, one file for each array of a world, for programs
            without a Zarr library.
        worlds: Number of worlds; the scenario's if left out.
        seed: Seed of the worlds; the scenario's if left out.
        out: File to make; problems/NAME.zarr if left out.
        device: Device to sample the worlds on; JAX's choice if left out.
    """
    choose_device(device)
    keep_all_programs()
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    from angler_mjx.cli.shared.inputs import build_planner_table, build_scenario, parse_information
    from angler_mjx.planning.planner import PathShape
    from angler_mjx.runs.simulator.simulator import Simulator
    from angler_mjx.runs.storage.plans import problems as store

    planner = build_planner_table(None, information=parse_information(information))
    loaded = build_scenario(scenario, worlds=worlds, seed=seed, planner=planner)
    out_path = out or Path("problems") / f"{loaded.name}.zarr"
    simulator = Simulator(loaded, paths=PathShape(points=2))
    columns = ("worlds", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("worlds", total=loaded.worlds)
        store.write_problems(
            out_path, simulator, lambda done: bar.update(task, completed=done), raw=raw
        )
    print(out_path)
