"""``angler mission``: missions of ground stations as scenarios and plans, and back."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from angler_mjx.errors import ConfigError


def import_mission(
    files: Annotated[tuple[Path, ...], tyro.conf.Positional],
    origin: str | None = None,
    kind: Literal["plan", "tour"] = "plan",
    vehicle: str = "bluerov2_heavy",
    parameters: Path | None = None,
    worlds: int = 1,
    out: Path | None = None,
    plans: Path | None = None,
) -> None:
    """Import missions of QGroundControl, Mission Planner or MAVProxy; list what differs from them.

    Args:
        files: Mission file of each robot: .plan, or way-points in the format QGC WPL 110.
        origin: Latitude, longitude and, if not 0, the altitude of the water's surface at the origin
            of the world, as in --origin=47.6,-122.3; the first mission's home if left out.
        kind: Plans with the missions' speeds and holds, in a file beside the scenario; or a tour
            of one mission whose paths a planner finds.
        vehicle: Name of a shipped vehicle, or path of a vehicle file; of all robots.
        parameters: File with the vehicle's parameters (.param or .params), for WPNAV_SPEED and the
            like; ArduSub's defaults if left out.
        worlds: Number of worlds of the scenario.
        out: Scenario file to write; must not exist. NAME.toml here if left out.
        plans: File of plans to write, for angler rollout --plans; as --out with .zarr if left out.
    """
    from angler_mjx.cli.shared.inputs import require_positive
    from angler_mjx.cli.shared.origin import parse_origin
    from angler_mjx.report.interop.mission_files import import_mission as importing
    from angler_mjx.report.interop.mission_files.route import VehicleLimits
    from angler_mjx.runs.storage.atomic_files import replace_file, require_free

    require_positive("--worlds", worlds)
    if not files:
        raise ConfigError("no mission file; give one for each robot")
    limits = VehicleLimits()
    if parameters is not None:
        from angler_sitl.firmware.parameters import read_parameters

        limits = importing.read_limits(read_parameters(parameters), limits)
    imported = importing.import_missions(
        files,
        origin=None if origin is None else parse_origin(origin),
        kind=kind,
        vehicle=vehicle,
        worlds=worlds,
        limits=limits,
    )
    target = Path(f"{imported.scenario.name}.toml") if out is None else out
    plan_file = plans or target.with_suffix(".zarr")
    if kind == "tour" and plans is not None:
        raise ConfigError(f"--plans {plans}: a tour has none; leave it out, or give --kind plan")
    require_free(target, flag="--out")
    if kind == "plan":
        importing.write_plans(plan_file, imported)
    with replace_file(target, flag="--out") as writing:
        writing.write_text(imported.text, encoding="utf-8")
    for note in imported.notes:
        print(note)
    for mission in imported.missions:
        of_file = f"{mission.mission.file.name}: " if len(files) > 1 else ""
        print(f"{of_file}{len(mission.route)} stops, {mission.planned.duration_s:.1f} s")
    print(target)
    if kind == "plan":
        print(plan_file)


def export_mission(
    source: Annotated[Path, tyro.conf.Positional],
    out: Path,
    origin: str,
    format_: Annotated[Literal["plan", "waypoints"] | None, tyro.conf.arg(name="format")] = None,
    world: int = 0,
    robot: int = 0,
    force: bool = False,
) -> None:
    """Write the plan of a robot as a mission of QGroundControl or Mission Planner.

    Args:
        source: Run folder, file of plans (.zarr), or JSON file of JointTrajectories.
        out: Mission file to write.
        origin: Latitude and longitude of the origin of the world, which becomes home, as in
            --origin=47.6,-122.3.
        format_: plan (QGroundControl) or waypoints (QGC WPL 110); by the name of --out if left out:
            .plan or another.
        world: Index of the world.
        robot: Index of the robot.
        force: Replace an older file.
    """
    from angler_mjx.cli.shared.origin import parse_origin
    from angler_mjx.report.interop.mission_files import export_mission as exporting
    from angler_mjx.runs.storage.atomic_files import replace_file

    home = parse_origin(origin)
    time_s, position_m = exporting.read_path(source, world, robot)
    items = exporting.build_items(exporting.build_waypoints(time_s, position_m), home)
    chosen = format_ or ("plan" if out.suffix == ".plan" else "waypoints")
    format_items = exporting.format_plan if chosen == "plan" else exporting.format_waypoints
    with replace_file(out, flag="--out", force=force) as writing:
        writing.write_text(format_items(items, home), encoding="utf-8")
    print(f"{len(items)} items; ArduSub stops at each way-point and heads along the legs")
    print(out)
