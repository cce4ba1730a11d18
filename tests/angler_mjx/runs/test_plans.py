"""Plans from the host and from files, flown: by worker processes, by a script, damaged, others'."""

import json
import os
import re
import shutil
import subprocess
import sys
from collections import Counter
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import zarr

from angler_mjx.cli.main import main
from angler_mjx.errors import ConfigError, RunError
from angler_mjx.planning.planner import PathShape
from angler_mjx.progress import Progress
from angler_mjx.runs.rollout import resume, rollout
from angler_mjx.runs.simulator.host_planning import planning_status
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.storage.plans import problems
from angler_mjx.runs.storage.plans import write as plan_writer
from angler_mjx.runs.storage.plans.read import open_plans, summarise_plan_file
from angler_mjx.sim.information import Information
from angler_mjx.world.currents import UniformConfig

DOCS = Path(__file__).parents[3] / "docs"
TEN_LINES, _, SCRIPT = (
    block
    for page in ("tutorials/own_planner.md", "reference/plan_files.md")
    for block in re.findall(r"```python\n(.*?)```", (DOCS / page).read_text(), re.S)
)
LAME = '''

class Lame(Straight):
    """8 m of the way, that is, within the horizon; and two worlds end otherwise."""

    def plan(self, problem):
        paths = [
            way_points([0, 16], [a, a + (b - a) * 16 / path.time_s[1]])
            for path in super().plan(problem)
            for a, b in [path.position_m]
        ]
        if problem.name.world == 0:
            raise ValueError("no idea")
        if problem.name.world == 1:
            paths[0].position_m[1] = float("nan")
        return paths
'''


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    file = tmp_path_factory.mktemp("planners") / "straight.py"
    file.write_text(TEN_LINES + LAME)
    return file


@pytest.fixture(scope="module")
def asked(scenario, file):
    """The small scenario, still, planned by the file's class."""
    planner = scenario.planner.model_copy(update={"name": f"{file}:Lame", "points": 32})
    return scenario.model_copy(update={"planner": planner})


@pytest.fixture(scope="module")
def simulator(asked):
    simulator = Simulator(asked, workers=1)
    yield simulator
    simulator.close()


@pytest.fixture(scope="module")
def flown(asked, simulator, tmp_path_factory):
    return rollout(asked, out=tmp_path_factory.mktemp("runs") / "hosted", simulator=simulator)


@pytest.fixture(scope="module")
def planned(asked, simulator, tmp_path_factory):
    path = tmp_path_factory.mktemp("plans") / "plans.zarr"
    plan_writer.plan_worlds(path, asked, simulator)
    return path


@pytest.fixture(scope="module")
def given(asked):
    """A simulator that is given its paths."""
    return Simulator(asked, paths=PathShape(points=32))


def without_time(run):
    return run.episodes.drop(["planning_s"])


def test_rows_say_how_each_robot_was_planned(flown, asked):
    rows = flown.episodes.to_pylist()
    by_world = {}
    for row in rows:
        by_world.setdefault(row["world"], []).append(row)
    assert all(row["plan_status"] == "error" for row in by_world[0])
    raised = by_world[0][0]["plan_reason"]
    # The line of the file at which the planner raised.
    line = 1 + (TEN_LINES + LAME).split("\n").index('            raise ValueError("no idea")')
    assert raised == f"ValueError: no idea (straight.py:{line})"
    assert all(row["plan_reason"] == raised for row in by_world[0])
    assert by_world[1][0]["plan_reason"] == "has NaN or infinite points at point 1"
    assert not by_world[1][0]["planned"]
    assert by_world[1][1]["planned"]
    assert by_world[1][0]["plan_status"] == "partial"
    for row in by_world[2]:
        assert (row["plan_status"], row["plan_reason"]) == ("planned", None)
        assert row["planning_s"] >= 0.0
        straight = row["plan_length_m"]
        assert row["plan_end_s"] == pytest.approx(straight / 0.5, rel=1e-4)
        assert row["late_s"] is None
    inputs = json.loads((flown.path / "inputs" / "inputs.json").read_text())
    assert "planner" in {one["role"] for one in inputs["files"]}


def test_a_run_says_how_many_were_planned_and_why_others_were_not(flown, asked):
    rows = flown.episodes.to_pylist()
    without = [row for row in rows if not row["planned"]]
    planning = flown.summary["planning"]
    assert planning["robots"]["count"] == len(rows) - len(without)
    assert planning["robots"]["rate"] == pytest.approx(1 - len(without) / len(rows))
    assert planning["worlds"]["error"] == 1
    counted = {one["reason"]: (one["robots"], one["worlds"]) for one in planning["reasons"]}
    told = Counter(row["plan_reason"] for row in without)
    assert sum(robots for robots, _ in counted.values()) == len(without)
    raised = next(reason for reason in told if "no idea" in reason)
    assert counted[raised] == (told[raised], 1)
    log = (flown.path / "run.log").read_text()
    assert f"world 0 has no plan: {raised}" in log
    robots = len(asked.members())
    assert f"no plan for {robots} robots in 1 world: {raised}" in log


def test_what_is_known_of_moving_obstacles(asked, flown):
    """Truth is where they went in the flight; less is known of the rest."""
    went = flown.trajectories["obstacle_p_m"][:]  # [world, sample, obstacle, xyz], at 2 Hz
    # One program draws the worlds; the scenario's own level is the one that no argument names.
    simulator = Simulator(with_knowledge(asked, "truth"), paths=PathShape(points=2))
    seen = {
        level: simulator.problems(0, 2, information=information)
        for level, information in (
            ("nothing", Information()),
            ("observed", Information(obstacles="observed")),
            ("truth", None),
        )
    }
    for world in range(2):
        nothing, observed, truth = (seen[level][world].obstacles for level in seen)
        assert truth.time_s[1] == pytest.approx(0.5)
        at = range(went.shape[1])
        where = np.moveaxis(truth.p_m, 0, 1)[at]  # [time, obstacle, xyz]
        # The same motion by another program: float32 over 20 s.
        np.testing.assert_allclose(where, went[world], atol=2e-4)
        assert truth.exists.all()
        assert observed.exists.all()
        assert not nothing.exists[nothing.moves].any()
        for told in (nothing.velocity_mps, nothing.p_m, nothing.half_size_m, nothing.radius_m):
            assert not told[nothing.moves].any()
        np.testing.assert_array_equal(observed.time_s, [0.0])
        np.testing.assert_allclose(observed.p_m[:, 0], went[world, 0], atol=1e-6)
        speed = (truth.p_m[:, 1] - truth.p_m[:, 0]) / 0.5
        np.testing.assert_allclose(observed.velocity_mps, speed, atol=0.05)


def test_only_worlds_of_the_run_are_planned(simulator):
    drawn = simulator.begin([4], counts=[1])
    assert list(drawn.tickets) == [0]
    worlds, notes = simulator.finish(drawn)
    assert list(np.asarray(worlds.planned).any(axis=1)) == [True, False]
    assert list(notes.status) == ["planned", "none"]


def test_who_takes_worlds_alone_is_warned_of_a_planner_that_raised(simulator):
    with pytest.warns(RuntimeWarning, match=r"world 0 has no plan: ValueError: no idea \(straight"):
        simulator.worlds(0)


def test_a_world_of_which_some_are_planned_is_partial():
    found = np.array([[True, True], [True, False], [False, False], [False, False]])
    counted = ["planned", "partial", "none", "none"]
    assert list(planning_status(found)) == counted
    assert list(
        planning_status(found, np.array(["planned", "planned", "", "timeout"], object))
    ) == [
        *counted[:3],
        "timeout",
    ]


def with_knowledge(scenario, level):
    information = scenario.planner.information.model_copy(update={"obstacles": level})
    return scenario.model_copy(
        update={"planner": scenario.planner.model_copy(update={"information": information})}
    )


def test_a_file_of_plans_flies_as_the_planner_did(asked, flown, planned, given, tmp_path):
    run = rollout(asked, out=tmp_path / "filed", simulator=given, plans=planned)
    assert without_time(run).equals(without_time(flown))


def test_planning_goes_on_where_it_was_interrupted(asked, simulator, planned, tmp_path):
    whole = open_plans(planned, asked)
    path = tmp_path / "plans.zarr"

    def stop(done, planned):
        if done:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        plan_writer.plan_worlds(path, asked, simulator, advance=stop)
    with pytest.raises(ConfigError, match="an unfinished file of plans lies in"):
        plan_writer.plan_worlds(path, asked, simulator)
    begun = []
    plan_writer.plan_worlds(
        path, asked, simulator, resume=True, advance=lambda done, planned: begun.append(done)
    )
    assert begun[0] > 0
    again = open_plans(path, asked)
    for name in ("points", "time_s", "position_m", "reason", "status"):
        np.testing.assert_array_equal(again.group[name][:], whole.group[name][:])


def test_a_script_that_does_not_know_this_package(asked, given, tmp_path):
    problems.write_problems(tmp_path / "problems.zarr", given)
    script = tmp_path / "script.py"
    script.write_text("import sys\nsys.modules['angler_mjx'] = None\n" + SCRIPT)
    bare = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    subprocess.run([sys.executable, script], check=True, cwd=tmp_path, env=bare)
    plans = open_plans(tmp_path / "plans.zarr", asked)
    worlds = given.worlds(0)
    start, goal = np.asarray(worlds.environment.start_m), np.asarray(worlds.environment.goal_m)
    np.testing.assert_array_equal(plans.group["position_m"][:2, :, 0], start)
    np.testing.assert_array_equal(plans.group["position_m"][:2, :, 1], goal)
    path, notes = plans.of([0], worlds, given)
    far = np.linalg.norm(goal - start, axis=-1) > 0.5 * asked.time.horizon_s
    np.testing.assert_array_equal(path.found, ~far)
    assert set(notes.reason[far]) == {"ends after the horizon"}


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda group: group.attrs.update(seed=99), "plans for seed 99"),
        (lambda group: group.attrs.update(digest="0" * 64),
         r"other problems \(digest '000000000000', not \w{12}\): .* differ from those of the "
         "scenario 'small' that the plans were made for$"),
        (lambda group: [group.attrs.update(digest="0" * 64), group.attrs.__delitem__("scenario")],
         "differ from those of the problems that the plans were made for$"),
        (lambda group: group.attrs.__delitem__("seed"), "lacks the attribute seed; copy it"),
        (lambda group: group.attrs.__delitem__("digest"), "lacks the attribute digest; copy it"),
        (lambda group: group.attrs.update(schema_version=7), "holds no plans of schema version 1"),
        (lambda group: group.create_array("points", data=np.zeros((9, 1), "i4"), overwrite=True),
         "do not fit each other"),
        (lambda group: group.__delitem__("position_m"), "must be an array of 4 dimensions"),
    ],
)  # fmt: skip
def test_plans_of_something_else_are_refused(asked, planned, tmp_path, spoil, said):
    path = tmp_path / "plans.zarr"
    shutil.copytree(planned, path)
    spoil(zarr.open_group(path, mode="r+"))
    with pytest.raises(ConfigError, match=said):
        open_plans(path, asked)


FAULTS = {
    "has too few or too many points": lambda g: g["points"].__setitem__((2, 0), 99),
    "has NaN or infinite numbers": lambda g: g["position_m"].__setitem__((2, 0, 1), np.nan),
    "does not begin at 0 s": lambda g: g["time_s"].__setitem__((2, 0, 0), 1.0),
    "begins elsewhere": lambda g: g["position_m"].__setitem__((2, 0, 0), 0.0),
    "goes back in time": lambda g: g["time_s"].__setitem__((2, 0, 1), -1.0),
    "is faster than its cruise speed, or jumps": lambda g: g["time_s"].__setitem__((2, 0, 1), 0.1),
    "ends after the horizon": lambda g: g["time_s"].__setitem__((2, 0, 1), 1e4),
    "no path": lambda g: g["points"].__setitem__((2, 0), 0),
}


def test_a_path_that_cannot_be_flown_is_none_with_its_reason(asked, given, planned, tmp_path):
    worlds = given.worlds(2)
    for i, (reason, spoil) in enumerate(FAULTS.items()):
        path = shutil.copytree(planned, tmp_path / f"{i}.zarr")
        spoil(zarr.open_group(path, mode="r+"))
        found, notes = open_plans(path, asked).of([2], worlds, given)
        assert notes.reason[0, 0] == reason
        assert not found.found[0, 0]
        assert found.found[0, 1:].all()
        np.testing.assert_array_equal(
            found.position_m[0, 0], found.position_m[0, 0, :1].repeat(32, 0)
        )


@pytest.mark.parametrize(
    ("name", "point", "is_fault"),
    [
        ("yaw_rad", 0, True),
        ("velocity", 1, True),
        ("acceleration", 1, True),
        ("yaw_rad", -1, False),
    ],
)
def test_headings_and_velocities_must_be_numbers_too(
    asked, given, planned, tmp_path, name, point, is_fault
):
    """What follows a path's points is not read."""
    path = shutil.copytree(planned, tmp_path / "plans.zarr")
    group = zarr.open_group(path, mode="r+")
    shape = group["time_s"].shape
    assert group["points"][2, 0] < shape[2]
    for array, width in (("yaw_rad", ()), ("velocity", (4,)), ("acceleration", (4,))):
        values = np.zeros((*shape, *width), "f4")
        values[2, 0, point] = np.inf if array == name else 0.0
        group.create_array(array, data=values)
    found, notes = open_plans(path, asked).of([2], given.worlds(2), given)
    assert notes.reason[0, 0] == ("has NaN or infinite numbers" if is_fault else "")
    assert found.found[0, 0] != is_fault
    assert found.found[0, 1:].all()


@pytest.fixture(scope="module")
def waters(asked):
    """Simulators of the worlds without and with a current, that are given their paths."""

    def simulator(*currents):
        world = asked.world.model_copy(update={"currents": currents})
        return Simulator(asked.model_copy(update={"world": world}), paths=PathShape(points=32))

    return {"still": simulator(), "moving": simulator(UniformConfig(velocity_mps=(0.2, 0, 0)))}


@pytest.mark.parametrize(
    ("water", "attributes", "speed_ratio", "reason"),
    [
        ("still", {}, 1.0, ""),
        ("still", {}, 1.5, "is faster than its cruise speed, or jumps"),
        ("moving", {}, 1.5, ""),
        ("moving", {}, 100.0, "is faster than its cruise speed, or jumps"),
        ("moving", {"speed_limit": "ground"}, 1.5, "is faster than its cruise speed, or jumps"),
        ("moving", {"speed_limit": "ground"}, 1.0, ""),
    ],
)
def test_a_path_may_be_faster_over_ground_where_water_moves(
    waters, planned, tmp_path, water, attributes, speed_ratio, reason
):
    carried = waters[water]
    path = shutil.copytree(planned, tmp_path / "plans.zarr")
    group = zarr.open_group(path, mode="r+")
    group.attrs.update(digest=carried.scenario.digest(), **attributes)
    group["time_s"][2, 0] = group["time_s"][2, 0] / speed_ratio
    found, notes = open_plans(path, carried.scenario).of([2], carried.worlds(2), carried)
    assert notes.reason[0, 0] == reason
    assert found.found[0, 0] == (reason == "")


def test_a_speed_limit_that_is_none_is_refused(asked, planned, tmp_path):
    path = shutil.copytree(planned, tmp_path / "plans.zarr")
    zarr.open_group(path, mode="r+").attrs["speed_limit"] = "water"
    with pytest.raises(ConfigError, match="speed_limit is 'water'; must be \"ground\" or left out"):
        open_plans(path, asked)


def test_a_world_that_is_not_planned_yet_is_named(asked, given, planned, tmp_path):
    path = shutil.copytree(planned, tmp_path / "plans.zarr")
    zarr.open_group(path, mode="r+")["points"][2] = -1
    with pytest.raises(ConfigError, match="world 2 is not planned"):
        open_plans(path, asked).of([2], given.worlds(2), given)


def test_a_run_goes_on_with_its_own_plans(asked, given, planned, flown, tmp_path):
    path = shutil.copytree(planned, tmp_path / "plans.zarr")

    class Stopping(Progress):
        def advance(self, worlds, steps):
            raise KeyboardInterrupt

    out = tmp_path / "run"
    with pytest.raises(RunError, match="interrupted before the first tile"):
        rollout(asked, out=out, simulator=given, plans=path, progress=Stopping())
    once = Once()
    rollout(asked, out=out, simulator=given, plans=path, progress=once)
    group = zarr.open_group(path, mode="r+")
    before = group["time_s"][3, 0, 1]
    group["time_s"][3, 0, 1] = before + 1.0
    with pytest.raises(ConfigError, match="is not the file of plans with which the run began"):
        resume(out, simulator=given)
    group["time_s"][3, 0, 1] = before
    assert without_time(resume(out, simulator=given)).equals(without_time(flown))


def test_a_run_goes_on_with_the_planner_that_it_began_with(asked, simulator, flown, file, tmp_path):
    out, said, text = tmp_path / "run", [], file.read_text()
    rollout(asked, out=out, simulator=simulator, progress=Once())
    progress = Once()
    progress.done, progress.report = float("-inf"), said.append
    file.write_text("edited while the run was interrupted: no Python\n")
    try:
        assert without_time(resume(out, workers=1, progress=progress)).equals(without_time(flown))
    finally:
        file.write_text(text)
    assert "inputs/planners/straight.py:Lame" in said[0]


class Once(Progress):
    """Interrupts in the second tile."""

    def __init__(self):
        self.done = 0.0

    def advance(self, worlds, steps):
        self.done += worlds
        if self.done > 2.0:
            raise KeyboardInterrupt


RAISES = """

class Raises:
    def plan(self, problem):
        return self.paths[problem.name.world]
"""


def test_a_command_whose_planner_raises_in_every_world_fails_and_names_the_line(
    scenario_file, tmp_path, capsys
):
    file = tmp_path / "raises.py"
    file.write_text(RAISES)
    planner = f"{file}:Raises"
    words = ["plan", str(scenario_file), "--planner", planner, "--worlds", "2", "--workers", "1"]
    with pytest.raises(SystemExit) as end:
        main([*words, "--out", str(tmp_path / "plans.zarr")])
    assert end.value.code == 2
    said = capsys.readouterr()
    raised = "AttributeError: 'Raises' object has no attribute 'paths' (raises.py:5)"
    assert f"angler: planner {planner} planned none of 2 worlds: {raised}; " in said.err
    assert f"in 2 worlds: {raised}\n" in said.out
    # What was planned is there all the same.
    assert summarise_plan_file(tmp_path / "plans.zarr")["worlds"] == {"error": 2}
    # In one world alone, in this process, the exception comes as it is.
    with pytest.raises(AttributeError, match="paths") as caught:
        main([*words, "--debug", "1"])
    assert caught.traceback[-1].path == file
    with pytest.raises(SystemExit) as end:
        main(["plan", str(scenario_file), "--planner", "grid", "--debug", "0"])
    assert end.value.code == 2


def widened(source, path, points):
    """A file of the same plans whose arrays hold more points; what is behind a path is noise."""
    old, new = zarr.open_group(source, mode="r"), zarr.open_group(path, mode="w")
    new.attrs.update(dict(old.attrs))
    rng = np.random.default_rng(1)
    for name, array in old.arrays():
        rows = np.asarray(array[:])
        if name in ("time_s", "position_m"):
            shape = list(rows.shape)
            shape[2] = points - rows.shape[2]
            rows = np.concatenate([rows, rng.normal(size=shape).astype(np.float32)], axis=2)
        new.create_array(name, data=rows)
    return path


def test_files_of_other_widths_are_flown_by_one_program_to_the_same_bytes(
    asked, given, planned, flown, tmp_path
):
    narrow = zarr.open_group(planned, mode="r")
    count = int(np.max(narrow["points"][:]))
    cut = tmp_path / "cut.zarr"
    shutil.copytree(planned, cut)
    group = zarr.open_group(cut, mode="r+")
    for name in ("time_s", "position_m"):
        group.create_array(name, data=np.asarray(narrow[name][:])[:, :, :count], overwrite=True)
    wide = widened(cut, tmp_path / "wide.zarr", 29)
    assert open_plans(cut, asked).shape == open_plans(wide, asked).shape == given.paths
    # `given` has compiled its programs: a file of another shape would be refused.
    for path in (cut, wide):
        run = rollout(asked, out=tmp_path / f"run_{path.stem}", simulator=given, plans=path)
        assert without_time(run).equals(without_time(flown))


def test_files_may_have_more_points_than_planners(asked, planned, tmp_path):
    widths = {points: open_plans(widened(planned, tmp_path / f"{points}.zarr", points), asked)
              for points in (33, 100, 1024)}  # fmt: skip
    assert {n: plans.shape.points for n, plans in widths.items()} == {33: 64, 100: 128, 1024: 1024}
    with pytest.raises(ConfigError, match="paths of 1025 points; must be 2 to 1024"):
        open_plans(widened(planned, tmp_path / "over.zarr", 1025), asked)


def problems_of(simulator, count):
    """Return the problems of the first worlds, tile by tile."""
    tile = simulator.tile
    return [
        problem
        for first in range(0, count, tile)
        for problem in simulator.problems(first, min(tile, count - first))
    ]


SHORTEST = DOCS / "examples" / "shortest.cpp"


@pytest.mark.skipif(shutil.which("c++") is None, reason="there is no C++ compiler (c++)")
def test_a_planner_in_cpp_without_dependencies(asked, given, tmp_path):
    binary, made = tmp_path / "shortest", tmp_path / "plans.zarr"
    problems.write_problems(tmp_path / "problems.zarr", given, raw=True)
    flags = ["-O2", "-std=c++17", "-Wall", "-Wextra", "-Werror"]
    subprocess.run(["c++", *flags, "-o", binary, SHORTEST], check=True)
    said = subprocess.run(
        [binary, tmp_path / "problems.zarr", made], check=True, capture_output=True, text=True
    ).stdout
    group = zarr.open_group(made, mode="r")
    points = np.asarray(group["points"][:])
    assert said == f"{int(np.sum(points > 0))} of {points.size} robots have a path\n"
    assert np.any(points > 0)
    run = rollout(asked, out=tmp_path / "run", simulator=given, plans=made)
    rows = run.episodes.to_pylist()
    assert [row["planned"] for row in rows] == (points.reshape(-1) > 0).tolist()
    assert {row["plan_reason"] for row in rows} <= {None, "no path"}
    # Its paths lead to the goals, and no sphere about the hull meets rock on the way.
    for world, problem in enumerate(problems_of(given, len(points))):
        grid = problem.grid
        low = grid.origin_m + grid.cell_m * np.argwhere(grid.occupied)
        for robot in np.flatnonzero(points[world] > 0):
            way = group["position_m"][world, robot][: points[world, robot]]
            np.testing.assert_allclose(way[-1], problem.team.goal_m[robot], atol=1e-5)
            dense = np.concatenate([np.linspace(a, b, 50) for a, b in pairwise(way)])
            beside = np.maximum(low - dense[:, None], dense[:, None] - low - grid.cell_m)
            gap = np.linalg.norm(np.maximum(beside, 0.0), axis=-1)
            assert not low.size or gap.min() >= problem.team.radius_m[robot]


def test_a_raw_file_of_problems_holds_the_numbers_that_any_zarr_reader_sees(given, tmp_path):
    path = tmp_path / "problems.zarr"
    problems.write_problems(path, given, raw=True)
    group, wanted = zarr.open_group(path, mode="r"), problems_of(given, 4)
    named = [name for name, node in group.members(max_depth=None) if isinstance(node, zarr.Array)]
    for name in named:
        array = group[name]
        assert set(array.attrs) == {"unit", "description"}
        assert len(array.metadata.dimension_names) == array.ndim
        for world in (0, array.shape[0] - 1):
            file = path.joinpath(*name.split("/"), "c", str(world), *["0"] * (array.ndim - 1))
            read = np.frombuffer(file.read_bytes(), array.dtype.newbyteorder("<"))
            np.testing.assert_array_equal(read.reshape(array.shape[1:]), array[world])
    for world, problem in enumerate(wanted):
        np.testing.assert_array_equal(group["grid/occupied"][world], problem.grid.occupied)
        np.testing.assert_array_equal(group["team/power_w"][world], problem.team.power_w)
        half = problem.obstacles.half_size_m
        np.testing.assert_array_equal(group["obstacles/half_size_m"][world], half)
    units = {name: group[name].attrs["unit"] for name in named}
    assert units["team/power_w"] == "W"
    assert units["team/acceleration_mps2"] == "m/s^2"
    planner = given.scenario.planner
    about = dict(group.attrs)
    assert (about["margin_m"], about["max_points"]) == (planner.margin_m, planner.points)
    assert about["information"] == {"obstacles": "nothing", "current": "nothing"}
