"""A survey and a delivery in a current as replay and bag show them, against what their runs hold.

What was seen when is worked out of the samples again, by no function of the simulator.
"""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from angler_mjx.report.interop import mcap
from angler_mjx.report.plotting import scene
from angler_mjx.report.video import task_marks
from angler_mjx.report.viewing import replay
from angler_mjx.runs.rollout import rollout
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.testing import referee
from angler_mjx.world.tasks.history import TaskHistory
from angler_mjx.world.tasks.spec import TaskSpec

rr = pytest.importorskip("rerun", reason="the extra `view` is not installed")

SCENARIO = """
schema_version = 1
name = "brief_survey"
worlds = 1
seed = 5
engine = "fused"
kernels = "xla"

[time]
horizon_s = 12.0
record_hz = 2.0

[world]
preset = "open"
shape = [10, 8, 5]
placement = "parallel"

[task]
type = "survey"
of = "floor"
half_angle_deg = 40.0
range_m = 5.0
altitude_m = 3.0
coverage = 0.9
viewpoints = 64

[[fleet]]
vehicle = "bluerov2"
parameter_set = "blue_gazebo"
count = 2

[[world.currents]]
type = "double_gyre"
peak_speed_mps = 0.1
period_s = 8.0
epsilon = 0.3
"""
LOOK_S = 0.5


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    path = tmp_path_factory.mktemp("survey") / "survey.toml"
    path.write_text(SCENARIO)
    return rollout(load_scenario(path), out=path.parent / "run", devices=1)


@pytest.fixture(scope="module")
def chunks(run):
    return _chunks(replay.write_replay(run, [0]))


@pytest.fixture(scope="module")
def bag(run):
    """Messages [(time in s, message)] by topic."""
    path = run.path / "survey.mcap"
    mcap.export_bag(run, path, [0])
    held = {}
    with AnyReader([path]) as reader:
        for connection, time, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            held.setdefault(connection.topic, []).append((1e-9 * time, message))
    return held


def _chunks(path):
    held = {}
    for chunk in rr.chunk.RrdReader(path).stream().to_chunks():
        held.setdefault(chunk.entity_path, []).append(chunk.to_record_batch())
    return held


def column(chunks, entity, name):
    """Values of a component, and their times in s; None where they hold at all times."""
    for batch in chunks[f"/world_0/space/{entity}"]:
        names = batch.schema.names
        if name in names:
            times = None
            if "time" in names:
                times = np.asarray(batch.column("time")).astype("timedelta64[ns]").astype(float)
            return batch.column(name).to_pylist(), None if times is None else 1e-9 * times
    raise KeyError(name)


def at(values, times, t):
    """The last value that was logged until then."""
    return values[int(np.searchsorted(times, t + 1e-6, side="right")) - 1]


def seen_by(run, t):
    """Cells of the floor that a robot has seen by then: a cone over an even floor, no rock."""
    stored = run.trajectories
    grid = stored["environment"]["grid"]
    origin, cell = np.asarray(grid["origin_m"][0]), float(grid["cell_m"][0])
    looks = np.asarray(stored["time_s"]) <= t + 1e-6
    p, q = np.asarray(stored["p_m"])[0, looks], np.asarray(stored["q"])[0, looks]
    nx, ny, _ = grid["occupied"].shape[1:]
    index = np.stack(np.meshgrid(np.arange(nx), np.arange(ny), [0], indexing="ij"), -1)
    middle = origin + cell * (index.reshape(-1, 3) + 0.5)
    w, x, y, z = np.moveaxis(q, -1, 0)
    down = -np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], -1)
    way = middle - p[..., None, :]
    length = np.linalg.norm(way, axis=-1)
    ahead = np.sum(way * down[..., None, :], axis=-1)
    sees = (length <= 5.0) & (ahead >= math.cos(math.radians(40.0)) * length)
    return {
        tuple(cell)
        for cell, seen in zip(index.reshape(-1, 3).tolist(), sees.any(axis=(0, 1)), strict=True)
        if seen and run.trajectories["task/cells"][0][tuple(cell)]
    }


def test_a_run_tells_when_cells_were_seen(run):
    stored = run.trajectories
    assert run.scenario.task.look_s == LOOK_S  # samples are looks
    seen_at_s = np.asarray(stored["task/seen_at_s"])[0]
    cells, share = np.asarray(stored["task/cells"])[0], np.asarray(stored["task/share"])[0]
    np.testing.assert_array_equal(np.isfinite(seen_at_s), cells == 2)
    counts = []
    for t, told in zip(np.asarray(stored["time_s"]), share, strict=True):
        found = {tuple(cell) for cell in np.argwhere(seen_at_s <= t + 1e-6).tolist()}
        assert found == seen_by(run, t)
        assert len(found) / np.sum(cells > 0) == pytest.approx(told)
        counts.append(len(found))
    assert len(set(counts)) > 8  # it goes on all the time


def test_the_referee_judges_the_survey_as_it_was_flown(run):
    """Samples are looks: cells, coverage and completion come out exactly."""
    verdict = referee.judge(run.path)
    assert [one.line() for one in verdict.differences] == []
    exact = {name: verdict.counts[name].exact for name in ("task_progress", "task_completed_s")}
    assert exact == {"task_progress": 2, "task_completed_s": 2}


@pytest.mark.parametrize("t", [0.0, 3.2, 7.5, 11.0])
def test_replay_and_bag_show_what_is_seen_at_a_time(run, chunks, bag, t):
    grid = run.trajectories["environment"]["grid"]
    origin, cell = np.asarray(grid["origin_m"][0]), float(grid["cell_m"][0])
    expected = seen_by(run, t)
    total = int(np.sum(np.asarray(run.trajectories["task/cells"]) > 0))

    (centres,), _ = column(chunks, "task/surface", "Boxes3D:centers")
    tint = at(*column(chunks, "task/surface", "Boxes3D:colors"), t)
    index = np.floor((np.array(centres) - origin) / cell).astype(int).tolist()
    assert len(index) == total
    by_color = {}
    for color, one in zip(tint, index, strict=True):
        by_color.setdefault(color, set()).add(tuple(one))
    seen = 0x5FD3B0FF
    assert by_color.get(seen, set()) == expected
    assert len(by_color) == 2
    text = f"{len(expected)} of {total} cells seen ("
    assert at(*column(chunks, "task/progress", "Points3D:labels"), t)[0].startswith(text)

    markers = {}
    for time, message in bag["/world_0/task"]:
        if time <= t + 1e-6:
            markers |= {(one.ns, one.id): one for one in message.markers}
    surface = markers["surface", 2]
    assert len(surface.points) == total
    points = np.array([[one.x, one.y, one.z] for one in surface.points])
    index = np.floor((points - origin) / cell).astype(int).tolist()
    green = {
        tuple(one) for one, color in zip(index, surface.colors, strict=True) if color.g > color.r
    }
    assert green == expected
    assert markers["progress", 0].text.startswith(text)
    assert not [one for one in bag["/world_0/scenery"][0][1].markers if one.ns == "goals"]


@pytest.mark.parametrize("t", [0.0, 3.2, 7.5])
def test_pictures_show_what_is_seen_at_a_time(run, t):
    shown = scene.read_scene(run, 0)
    marks = task_marks.build_marks(shown, np.array([11.0, t]))
    low, cell = shown.bounds_m[0], float(shown.environment.grid.cell_m)
    is_quad = marks.kind == task_marks.BOX
    rgba = marks.palette[marks.tint[1]]
    green = rgba[:, 1] > rgba[:, 0]
    index = np.floor((marks.position_m[1] - low) / cell).astype(int)
    assert np.sum(is_quad) == np.sum(np.asarray(run.trajectories["task/cells"]) > 0)
    assert {tuple(one) for one in index[is_quad & green].tolist()} == seen_by(run, t)
    np.testing.assert_allclose(np.sort(marks.size_m[is_quad])[:, 1:], 0.46 * cell)
    # Viewpoints that were visited have their robot's colour, the others are white.
    task = shown.task
    done = task.done_at_s[task.exists] <= task.time_s[task.time_s <= t + 1e-6][-1] + 1e-6
    np.testing.assert_array_equal((rgba[~is_quad] == 1.0).all(axis=1), ~done)


def test_arrows_are_the_water_at_the_height_of_the_fleet(run, chunks, bag):
    """The double gyre of Shadden et al. (2005), from its formula."""
    shown = scene.read_scene(run, 0)
    low, high = shown.bounds_m
    size = high[:2] - low[:2]
    origins, times = column(chunks, "flow", "Arrows3D:origins")
    vectors, _ = column(chunks, "flow", "Arrows3D:vectors")
    scales = []
    for k, (t, begin, way) in enumerate(zip(times, origins, vectors, strict=True)):
        begin, way = np.array(begin), np.array(way)
        middle = begin + 0.5 * way
        height = np.mean([robot.p_m[k, 2] for robot in shown.robots])
        np.testing.assert_allclose(middle[:, 2], height, atol=1e-4)
        x, y = (2 * (middle[:, 0] - low[0]) / size[0], (middle[:, 1] - low[1]) / size[1])
        a = 0.3 * np.sin(2 * np.pi * t / 8.0)
        f, rate = a * x**2 + (1 - 2 * a) * x, 2 * a * x + 1 - 2 * a
        u = -np.sin(np.pi * f) * np.cos(np.pi * y) / size[1]
        v = np.cos(np.pi * f) * np.sin(np.pi * y) * rate * 2 / size[0]
        flow = np.stack([u, v], axis=1)
        scale = np.sum(way[:, :2] * flow) / np.sum(flow * flow)
        np.testing.assert_allclose(way[:, :2], scale * flow, atol=2e-3 * np.abs(way).max())
        np.testing.assert_allclose(way[:, 2], 0.0, atol=1e-6)
        scales.append(scale)
    assert np.ptp(scales) < 1e-3 * np.mean(scales)  # one scale for the whole flight
    assert scales[0] > 0
    # The bag has the same places, and the velocities themselves: 4 s of the water's way.
    (t, first) = bag["/world_0/current"][0]
    points = np.array([[one.x, one.y, one.z] for one in first.markers[0].points]).reshape(-1, 2, 3)
    begin, way = np.array(origins[0]), np.array(vectors[0])
    np.testing.assert_allclose(points.mean(axis=1), begin + 0.5 * way, atol=1e-4)
    ratio = np.linalg.norm(points[:, 1] - points[:, 0]) / np.linalg.norm(way)
    np.testing.assert_allclose(points[:, 1] - points[:, 0], ratio * way, atol=1e-4)
    peak = np.linalg.norm(points[:, 1] - points[:, 0], axis=1).max() / 4.0
    told = column(chunks, "flow/speed", "Points3D:labels")[0][0][0]
    assert told == f"current, up to {peak:.2f} m/s"


DELIVERY = {
    "time": np.array([0.0, 1.0, 2.0, 3.0]),
    "carrying": [[-1, -1], [0, 1], [0, 1], [-1, -1]],
    "target": [[0, 1], [2, 3], [2, 3], [-1, 4 + 1]],
}
"""Robot 0 brings goods 0 at 3 s; robot 1 fails at 2.5 s with goods 1."""


@pytest.fixture
def delivery(scene, tmp_path, monkeypatch):
    """Chunks of the replay of a delivery made by hand."""
    time = DELIVERY["time"]
    count = len(time)
    task = TaskHistory(
        spec=TaskSpec(kind="deliver", jobs=2, robots=2, tolerance_m=0.5, period=1),
        time_s=time,
        position_m=np.arange(18.0).reshape(6, 3),
        exists=np.ones(2, bool),
        by=np.array([0, -1]),
        done_at_s=np.array([3.0, np.nan]),
        progress=np.array([0, 0, 0, 0.5]),
        did=np.array([[0, 0], [0, 0], [0, 0], [1, 0]]),
        target=np.array(DELIVERY["target"]),
        carrying=np.array(DELIVERY["carrying"]),
        ended_s=np.array([3.0, 2.5]),
        completed_s=np.nan,
    )
    made = replace(
        scene,
        time_s=time,
        obstacle_p_m=scene.obstacle_p_m[:count],
        obstacle_q=scene.obstacle_q[:count],
        world=0,
        task=task,
        robots=tuple(
            replace(
                robot,
                p_m=robot.p_m[:count],
                q=robot.q[:count],
                current_mps=robot.current_mps[:count],
                goal_m=np.full(3, np.nan),
                outcome=("reached", "collision_static")[robot.index],
                end_time_s=(3.0, 2.5)[robot.index],
            )
            for robot in scene.robots[:2]
        ),
    )
    monkeypatch.setattr(replay.scene, "read_scene", lambda run, world: made)

    scenario = SimpleNamespace(name="delivery", seed=7)
    path = replay.write_replay(SimpleNamespace(path=tmp_path, scenario=scenario), [0])
    return made, _chunks(path)


def test_goods_lie_travel_and_are_gone(delivery):
    made, chunks = delivery
    first, times = column(chunks, "task/goods/0", "Boxes3D:centers")
    second, later = column(chunks, "task/goods/1", "Boxes3D:centers")
    robots = [robot.p_m for robot in made.robots]
    below = [0.0, 0.0, -0.44]
    np.testing.assert_allclose(at(first, times, 0.0), [[0.0, 1.0, 2.0]])
    np.testing.assert_allclose(at(first, times, 1.0), [robots[0][1] + below], atol=1e-5)
    np.testing.assert_allclose(at(first, times, 2.0), [robots[0][2] + below], atol=1e-5)
    np.testing.assert_allclose(at(first, times, 3.0), [[6.0, 7.0, 8.0]])
    np.testing.assert_allclose(at(second, later, 2.0), [robots[1][2] + below], atol=1e-5)
    assert at(second, later, 3.0) == []  # lost with its robot


def test_pictures_show_goods_and_where_they_belong(delivery):
    """Of both robots' goods: boxes where they are, then flat boxes below their destinations."""
    made, _ = delivery
    marks = task_marks.build_marks(made, np.array([0.0, 1.4, 3.0]))
    below = [0.0, 0.0, -0.44]
    robots = [robot.p_m for robot in made.robots]
    first, second, end, _ = np.moveaxis(marks.position_m, 1, 0)
    np.testing.assert_allclose(
        first, [[0.0, 1.0, 2.0], robots[0][1] + below, [6.0, 7.0, 8.0]], atol=1e-5
    )
    np.testing.assert_allclose(second[1], robots[1][1] + below, atol=1e-5)
    assert np.isnan(second[2]).all()  # lost with its robot
    np.testing.assert_allclose(end, [[6.0, 7.0, 8.0 - 0.22]] * 3, atol=1e-5)
    assert set(marks.kind) == {task_marks.BOX}
    green = marks.palette[marks.tint][..., 1] > marks.palette[marks.tint][..., 0] + 0.2
    assert green.tolist() == [[False] * 4, [False] * 4, [True, False, True, False]]


def test_labels_and_table_say_what_robots_do(delivery):
    _, chunks = delivery
    labels, times = column(chunks, "robot_0/vehicle/label", "Points3D:labels")
    assert at(labels, times, 0.0) == ["0"]
    assert at(labels, times, 1.0) == ["0: brings goods 0"]
    assert at(labels, times, 3.0) == ["0: finished"]
    labels, times = column(chunks, "robot_1/vehicle/label", "Points3D:labels")
    assert at(labels, times, 2.0) == ["1: brings goods 1"]
    assert at(labels, times, 2.5) == ["1: hit rock or floor"]
    (batch,) = [one for one in chunks["/world_0/fleet"] if "time" in one.schema.names]
    (last,) = batch.column("TextDocument:text").to_pylist()[-1]
    assert "**1 of 2 goods brought, 0 on the way, 1 lost**" in last
    assert "| **0** | bluerov2_heavy | finished | 1 |" in last


def test_events_tell_what_became_of_goods(delivery):
    _, chunks = delivery
    told = []
    for batch in chunks["/world_0/events"]:
        told += [text for (text,) in batch.column("TextLog:text").to_pylist()]
    assert sorted(told) == [
        "1.0 s: goods 0 taken up by robot 0",
        "1.0 s: goods 1 taken up by robot 1",
        "2.5 s: robot 1 hit rock or floor (cell)",
        "3.0 s: goods 0 brought by robot 0",
        "3.0 s: goods 1 lost: robot 1 ended",
        "3.0 s: robot 0 finished",
    ]


def test_lines_lead_to_where_robots_are_to_go(delivery):
    made, chunks = delivery
    strips, times = column(chunks, "task/to/robot_0", "LineStrips3D:strips")
    np.testing.assert_allclose(
        at(strips, times, 1.0), [[made.robots[0].p_m[1], [6.0, 7.0, 8.0]]], atol=1e-5
    )
    assert at(strips, times, 3.0) == []
