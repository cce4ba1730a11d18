"""`angler rollout`, and figures of its run folder."""

import json
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from angler_mjx.cli.shared.device import (
    Device,
    Kernels,
    choose_device,
    join_processes,
    keep_all_programs,
)
from angler_mjx.errors import ConfigError, UnsupportedError

if TYPE_CHECKING:
    from angler_mjx.runs.storage.folder import Run


def rollout(
    scenario: Annotated[str, tyro.conf.Positional],
    worlds: int | None = None,
    seed: int | None = None,
    out: Path | None = None,
    engine: Literal["mjx", "fused"] | None = None,
    kernels: Kernels | None = None,
    device: Device | None = None,
    devices: int | None = None,
    tile: int | None = None,
    chunk: int | None = None,
    record_hz: float | None = None,
    resume: bool = False,
    distributed: bool = False,
    coordinator: str | None = None,
    processes: int | None = None,
    process: int | None = None,
    planner: str | None = None,
    replan_hz: float | None = None,
    information: str | None = None,
    order: Literal["auto", "free", "kept"] | None = None,
    policy: str | None = None,
    workers: int | None = None,
    plans: Path | None = None,
    figures: bool = True,
    json: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> None:
    """Run a scenario in many worlds at once and write a run folder.

    Args:
        scenario: Name of a shipped scenario, or path of a scenario file (.toml).
        worlds: Number of worlds; the scenario's if left out.
        seed: Seed of the run; the scenario's if left out.
        out: Run folder to make; runs/NAME if left out.
        engine: Physics engine; the scenario's if left out. fused is faster, for rigid vehicles.
        kernels: Compiler of the fused engine; if left out, cuda on a GPU, else xla. triton
            means cuda, until 1.0.
        device: Device to compute on; JAX's choice if left out.
        devices: Number of devices to spread the worlds over; all available if left out. Changes no
            byte of the results.
        tile: Worlds in one device call; part of the results' bytes.
        chunk: Finished worlds held in memory until they are written; sized from free memory if left
            out.
        record_hz: Rate of the stored trajectories; 0 stores none.
        resume: Continue an interrupted run in the same folder.
        distributed: Share the run with other processes, here or on other hosts; each is started
            with the same arguments and sees the same run folder.
        coordinator: Address of process 0, HOST:PORT; detected under Slurm and Open MPI.
        processes: Number of processes; detected under Slurm and Open MPI.
        process: Index of this process, from 0; detected under Slurm and Open MPI.
        planner: Planner of the robots' paths: one of angler plan --list, or FILE.py:CLASS; the
            scenario's if left out.
        replan_hz: Rate of replanning in flight; 0: none.
        information: Information level of planners and policies, such as
            obstacles=observed,current=predicted; nothing for a part that is not named. The
            scenario's if left out.
        order: Order of passing: free, kept (robots wait for those that pass a place before them by
            the plans), or auto.
        policy: Policy that commands the robots instead of their plans: none, mppi, routes, reach,
            or FILE.py:CLASS; the scenario's if left out. Its settings stand in the scenario's
            [policy.NAME] or [policy.CLASS].
        workers: Number of planning processes, for planners on the host; one for each processor if
            left out. Changes no byte of the results.
        plans: File of plans to fly (of angler plan or another program), instead of a planner's.
        figures: Plot figures and write a replay at the end.
        json: Print one JSON object instead of the table.
    """
    choose_device(device, distributed=distributed)
    keep_all_programs()
    process_group = join_processes(
        device,
        distributed=distributed,
        coordinator=coordinator,
        processes=processes,
        process=process,
    )
    from angler_mjx.cli.shared.inputs import (
        build_flyable_scenario,
        build_planner_table,
        build_policy_table,
        build_scenario,
        format_flag,
        parse_information,
        require_plans,
        require_positive,
    )
    from angler_mjx.cli.shared.progress import ProgressBar
    from angler_mjx.runs import rollout as runs

    flag_values = {
        "worlds": worlds,
        "seed": seed,
        "engine": engine,
        "kernels": kernels,
        "tile": tile,
        "planner": build_planner_table(
            planner, replan_hz=replan_hz, information=parse_information(information)
        ),
        "execution": None if order is None else {"order": order},
        "policy": build_policy_table(policy, parse_information(information)),
    }
    if planner is not None and plans is not None:
        raise ConfigError("--planner and --plans: give one of them; plans are made already")
    overrides: dict[str, object] = {
        key: value for key, value in flag_values.items() if value is not None
    }
    if record_hz is not None:
        overrides["time"] = {"record_hz": record_hz}
    if resume and overrides:
        override_keys = [
            key if x == "name" else x
            for key, value in overrides.items()
            for x in (value if isinstance(value, dict) else [key])
        ]
        flags = ", ".join(dict.fromkeys(map(format_flag, override_keys)))
        raise ConfigError(f"--resume takes everything from the run folder; leave out {flags}")
    loaded = build_scenario(scenario) if resume else build_flyable_scenario(scenario, **overrides)
    out_path = out or Path("runs") / loaded.name
    with ProgressBar(quiet=json or process_group.index > 0) as bar:
        fly = partial(runs.resume if resume else runs.rollout, scenario=loaded)
        run = fly(
            out=out_path,
            chunk=chunk,
            progress=bar,
            devices=devices,
            processes=process_group,
            workers=require_positive("workers", workers),
            plans=plans,
        )
    process_group.leave()
    if process_group.index == 0:
        if figures:
            _write_figures(run)
        _print_summary(run, as_json=json)
    if not run.summary["complete"]:
        sys.exit(130)
    source = f"planner {run.scenario.planner.name}" if plans is None else f"--plans {plans}"
    require_plans(run.summary["planning"], source)


def figures(
    run: Annotated[Path, tyro.conf.Positional],
    beside: Path | None = None,
    world: int | None = None,
    robot: int | None = None,
    at: tuple[float, ...] = (),
) -> None:
    """Plot the figures of a run folder again and write its replay.

    Args:
        run: Run folder.
        beside: Run folder of the same worlds with other flights: plot instead the surroundings of
            one robot in both, at a few times.
        world: With --beside: index of the world; a world with different outcomes if left out.
        robot: With --beside: index of the robot; a robot with different outcomes if left out.
        at: With --beside: times, s; some before the robot's first failure if left out.

    Raises:
        ConfigError: the runs are not of the same worlds, or lack the data to plot.
    """
    from angler_mjx.runs.storage.folder import FIGURES, Run

    if beside is None:
        if world is not None or robot is not None or at:
            raise ConfigError("--world, --robot and --at: choose what is drawn with --beside RUN")
        _write_figures(Run(run))
        print(run / "figures")
        return
    from angler_mjx.report.plotting import style
    from angler_mjx.report.viewing.maps import comparison
    from angler_mjx.report.viewing.maps import comparison_map as pictures

    pair = comparison.read_comparison([Run(run), Run(beside)], world, robot, at)
    name = f"beside_world_{pair.scenes[0].world}_robot_{pair.robot}.png"
    print(style.save_figure(pictures.plot_comparison(pair), run / FIGURES / name, palette=128))


def _write_figures(run: "Run") -> None:
    """Write the figures and replay of a run; print any missing requirements."""
    from angler_mjx.report.viewing import figures as drawing
    from angler_mjx.report.viewing import replay as viewer

    drawing.plot_figures(run)
    if run.scenario.time.record_hz == 0:
        print("no maps and no replay: the run stored no trajectories", file=sys.stderr)
        return
    try:
        viewer.write_replay(run)
    except UnsupportedError as error:
        print(error, file=sys.stderr)


def _format_count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def _format_task(task: dict[str, Any]) -> str:
    """Return a line with the results of the tasks of the worlds."""
    rate, duration = task["completed"], task["completed_s"]
    completed = (
        f"task completed in {rate['count']} worlds, {100 * rate['rate']:.1f} % "
        f"(95 %: {100 * rate['low']:.1f} to {100 * rate['high']:.1f} %)"
    )
    if duration["mean"] is None:
        return f"{completed}; on average {100 * task['progress']:.1f} % of it was done"
    spread = ""
    if duration["interval"] is not None:
        spread = " (95 %: {:.0f} to {:.0f} s)".format(*duration["interval"])
    return f"{completed}, after {duration['mean']:.0f} s on average{spread}"


def _print_summary(run: "Run", *, as_json: bool) -> None:
    """Print the end of a run: one JSON object, or the table and the path of the run folder."""
    summary = run.summary
    if as_json:
        print(json.dumps(summary))
        return
    from rich.console import Console

    from angler_mjx.cli.shared.text_table import build_text_table as text_table
    from angler_mjx.runs.storage import planning_summary

    table = text_table(
        "outcome",
        "robots",
        "rate",
        "95 % interval, by world",
        title=f"{summary['scenario']}: {summary['worlds_done']} worlds, {summary['robots']} robots",
    )
    planning = summary["planning"]
    has_plan = {} if planning is None else {"with a plan": planning["robots"]}
    for part in (has_plan, summary["outcomes"]):
        for name, row in part.items():
            interval = f"{100 * row['low']:.1f} to {100 * row['high']:.1f} %"
            table.add_row(name, str(row["count"]), f"{100 * row['rate']:.1f} %", interval)
        table.add_section()
    kinds = text_table("vehicle / parameter set", "robots", "reached", "95 % interval")
    for name, row in summary["by_vehicle"].items():
        reached = row["reached"]
        interval = f"{100 * reached['low']:.1f} to {100 * reached['high']:.1f} %"
        kinds.add_row(name, str(row["robots"]), f"{100 * reached['rate']:.1f} %", interval)
    console = Console()
    if "task" in summary:
        console.print(_format_task(summary["task"]), highlight=False)
    console.print(table)
    early = planning_summary.early_lines(summary.get("passed_goal_early", 0))
    for line in (*planning_summary.reason_lines(planning), *early):
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    console.print(kinds)
    timing, arrival = summary["timing"], summary["time_to_goal_s"]["p50"]
    label, time = "arrived", "time to goal"
    if "task" in summary:
        label, time = "did its part", "time of a robot's part"
    median = f"no robot {label}" if arrival is None else f"median {time} {arrival:.0f} s"
    console.print(
        f"{median}; {timing['vehicle_steps_per_s']:.2e} vehicle-steps/s on "
        f"{_format_count(summary['devices'], 'device')}, "
        f"{timing['simulate_s']:.1f} s simulating, {timing['compile_s']:.1f} s compiling",
        highlight=False,
    )
    if not summary["complete"]:
        console.print("interrupted: go on with --resume")
    print(run.path)
