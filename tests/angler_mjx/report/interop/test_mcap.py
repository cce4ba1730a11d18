"""A bag read back by an independent reader, with the definitions that the bag itself carries."""

from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from angler_mjx.cli.main import main
from angler_mjx.errors import ConfigError, RunError
from angler_mjx.report.interop import mcap
from angler_mjx.report.interop.ros_definitions import FIELDS, message_definition
from angler_mjx.robot.control.plans import PIECES
from angler_mjx.world.obstacles import BOX, CAPSULE, SPHERE, STATIC

WORLDS = (0, 1)


@pytest.fixture(scope="module")
def bag(run, tmp_path_factory):
    """Messages [(time_ns, message)] by topic, and the connections by topic."""
    path = tmp_path_factory.mktemp("bag") / "out.mcap"
    mcap.export_bag(run, path, WORLDS)
    return messages(path)


def messages(path):
    held, connections = {}, {}
    with AnyReader([path]) as reader:
        for connection, time, data in reader.messages():
            held.setdefault(connection.topic, []).append(
                (time, reader.deserialize(data, connection.msgtype))
            )
            connections[connection.topic] = connection
    return held, connections


@pytest.fixture(scope="module")
def stored(run):
    group = run.trajectories
    names = ("time_s", "p_m", "q", "nu", "pwm_us", "plan_m", "plan_time_s")
    return {name: np.asarray(group[name]) for name in (*names, "obstacle_p_m", "obstacle_q")}


def xyz(value):
    return [value.x, value.y, value.z]


def wxyz(value):
    return [value.w, value.x, value.y, value.z]


def seconds(stamp):
    return stamp.sec + 1e-9 * stamp.nanosec


@pytest.mark.parametrize("distribution", [Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY])
@pytest.mark.parametrize("name", FIELDS)
def test_definitions_are_those_of_ros(name, distribution):
    full = name.replace("/", "/msg/")
    known = get_typestore(distribution).fielddefs
    for each, (constants, fields) in get_types_from_msg(message_definition(name), full).items():
        assert fields == known[each][1]
        # Jazzy has one constant more, which changes no byte.
        assert set(constants) <= set(known[each][0])


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("robot", range(4))
def test_odometry_is_the_run(bag, stored, world, robot):
    held = bag[0][f"/world_{world}/robot_{robot}/odometry"]
    count = 100 if (world, robot) == (1, 2) else 301
    assert len(held) == count
    # Numbers are float32 in the run and float64 in the bag.
    poses = [message.pose.pose for _, message in held]
    twists = [message.twist.twist for _, message in held]
    rows = (world, slice(0, count), robot)
    np.testing.assert_array_equal([xyz(pose.position) for pose in poses], stored["p_m"][rows])
    np.testing.assert_array_equal([wxyz(pose.orientation) for pose in poses], stored["q"][rows])
    speed = [xyz(twist.linear) + xyz(twist.angular) for twist in twists]
    np.testing.assert_array_equal(speed, stored["nu"][rows])
    for time, message in held:
        assert message.header.frame_id == f"world_{world}"
        assert message.child_frame_id == f"world_{world}/robot_{robot}/base_link"
        assert time == message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        assert message.pose.covariance.shape == message.twist.covariance.shape == (36,)
        assert not message.pose.covariance.any()
        assert not message.twist.covariance.any()
    times = [seconds(message.header.stamp) for _, message in held]
    # Half a nanosecond.
    np.testing.assert_allclose(times, stored["time_s"][:count], atol=1e-9)


def test_frames_are_the_run_and_hang_together(bag, stored):
    (_, fixed), *more = bag[0]["/tf_static"]
    assert not more
    parents = {one.child_frame_id: one.header.frame_id for one in fixed.transforms}
    assert parents == {"world_0": "map", "world_1": "map"}
    for one in fixed.transforms:
        assert xyz(one.transform.translation) == [0, 0, 0]
        assert wxyz(one.transform.rotation) == [1, 0, 0, 0]
    k = 150
    now = round(float(stored["time_s"][k]) * 1e9)
    at = [one for time, message in bag[0]["/tf"] if time == now for one in message.transforms]
    assert len(at) == 7  # eight robots, one of them diverged
    for one in at:
        world, robot = (int(part.split("_")[1]) for part in one.child_frame_id.split("/")[:2])
        assert one.header.frame_id == f"world_{world}"
        place, turn = xyz(one.transform.translation), wxyz(one.transform.rotation)
        np.testing.assert_array_equal(place, stored["p_m"][world, k, robot])
        np.testing.assert_array_equal(turn, stored["q"][world, k, robot])


@pytest.mark.parametrize("world", WORLDS)
def test_plans_are_the_run_without_its_padding(bag, stored, world):
    for robot in range(4):
        root = f"/world_{world}/robot_{robot}"
        (time, plan), *more = bag[0][f"{root}/joint_trajectory"]
        assert not more
        assert time == 0
        assert list(plan.joint_names) == ["x", "y", "z"]
        want, when = stored["plan_m"][world, robot, :3], stored["plan_time_s"][world, robot, :3]
        np.testing.assert_array_equal([point.positions for point in plan.points], want)
        np.testing.assert_allclose(
            [seconds(point.time_from_start) for point in plan.points], when, atol=1e-9
        )
        assert all(point.velocities.size == 0 for point in plan.points)
        (_, path), *more = bag[0][f"{root}/plan"]
        assert not more
        assert path.header.frame_id == f"world_{world}"
        np.testing.assert_array_equal([xyz(one.pose.position) for one in path.poses], want)
        np.testing.assert_allclose(
            [seconds(one.header.stamp) for one in path.poses], when, atol=1e-9
        )


def test_plans_with_velocities_are_joint_trajectories(jointed, tmp_path):
    """What a reader of ROS makes of the message is the motion that was flown."""
    run, motion = jointed
    mcap.export_bag(run, tmp_path / "out.mcap", [0])
    held, _ = messages(tmp_path / "out.mcap")
    stored = run.trajectories
    for robot, degree in enumerate(motion["plan_degree"][0].tolist()):
        ((_, plan),) = held[f"/world_0/robot_{robot}/joint_trajectory"]
        assert list(plan.joint_names) == ["x", "y", "z", "yaw"]
        times = [seconds(point.time_from_start) for point in plan.points]
        places = np.array([point.positions for point in plan.points])
        rates = [point.velocities.tolist() for point in plan.points]
        place = np.column_stack([stored["plan_m"][0, robot], motion["plan_yaw_rad"][0, robot]])
        given = motion["plan_velocity"][0, robot]
        np.testing.assert_array_equal(places[[0, 1, -1]], place[:3])
        np.testing.assert_array_equal(rates[:2], given[:2])
        if degree[1] == 3:
            assert times == [0.0, 30.0, 60.0]
            np.testing.assert_array_equal(rates[2], given[2])
        else:  # a line after a cubic: its end has no velocity
            assert times == [0.0, 30.0, 60.0]
            assert rates[2] == []
        assert all(point.accelerations.size == 0 for point in plan.points)
        ((_, path),) = held[f"/world_0/robot_{robot}/plan"]
        assert len(path.poses) == 1 + 2 * PIECES


def test_thruster_signals_are_the_run(bag, stored):
    held = bag[0]["/world_1/robot_3/thruster_pwm_us"]
    np.testing.assert_array_equal([one.data for _, one in held], stored["pwm_us"][1, :, 3])
    assert held[0][1].layout.dim[0].label == "thruster_pwm_us"


def test_clock_is_simulated_time_from_0_and_messages_come_in_its_order(bag, stored):
    held = bag[0]["/clock"]
    times = [seconds(message.clock) for _, message in held]
    np.testing.assert_allclose(times, stored["time_s"], atol=1e-9)
    assert held[0][0] == 0
    for messages in bag[0].values():
        order = [time for time, _ in messages]
        assert order == sorted(order)


@pytest.mark.parametrize("world", WORLDS)
def test_scenery_is_the_cells_the_still_obstacles_and_the_goals(bag, scene_maker, world):
    environment = scene_maker(world).environment
    given, grid = environment.obstacles, environment.grid
    (_, scenery), *more = bag[0][f"/world_{world}/scenery"]
    assert not more
    (cells,) = [one for one in scenery.markers if one.ns == "cells"]
    assert cells.type == 6
    # The environment is stored as float32.
    np.testing.assert_allclose(xyz(cells.scale), [1.5] * 3)
    centers = grid.origin_m + 1.5 * (np.argwhere(grid.occupied) + 0.5)
    np.testing.assert_allclose([xyz(point) for point in cells.points], centers, atol=1e-5)
    still = np.flatnonzero(given.exists & (given.motion == STATIC))
    held = {one.id: one for one in scenery.markers if one.ns == "obstacles"}
    assert sorted(held) == still.tolist()
    for row, one in held.items():
        np.testing.assert_allclose(xyz(one.pose.position), given.p0[row], atol=1e-5)
    goals = [one for one in scenery.markers if one.ns == "goals"]
    np.testing.assert_allclose(
        [xyz(one.pose.position) for one in goals], environment.goal_m, atol=1e-5
    )


@pytest.mark.parametrize("world", WORLDS)
def test_moving_obstacles_have_their_shapes_and_places(bag, stored, scene_maker, world):
    given = scene_maker(world).environment.obstacles
    rows = np.flatnonzero(given.exists & (given.motion != STATIC))
    held = bag[0][f"/world_{world}/obstacles"]
    assert len(held) == 301
    markers = {one.id: one for one in held[200][1].markers if one.ns == "obstacles"}
    ends = {one.id: one for one in held[200][1].markers if one.ns == "capsule_ends"}
    assert sorted(markers) == rows.tolist()
    assert sorted(ends) == [row for row in rows if given.kind[row] == CAPSULE]
    for row, one in markers.items():
        a, b, c = given.size_m[row]
        kind, scale = {
            SPHERE: (2, [2 * a] * 3),
            BOX: (1, [2 * a, 2 * b, 2 * c]),
            CAPSULE: (3, [2 * a, 2 * a, 2 * b]),
        }[int(given.kind[row])]
        assert one.type == kind
        assert one.color.a == 1
        np.testing.assert_allclose(xyz(one.scale), scale, rtol=1e-6)
        np.testing.assert_array_equal(
            xyz(one.pose.position), stored["obstacle_p_m"][world, 200, row]
        )
        np.testing.assert_array_equal(
            wxyz(one.pose.orientation), stored["obstacle_q"][world, 200, row]
        )
        if row in ends:
            assert [abs(point.z) for point in ends[row].points] == pytest.approx([b, b])


def test_what_is_said_once_is_kept_for_late_listeners(bag):
    once = ("/tf_static", "/scenery", "/plan", "/joint_trajectory")
    for topic, connection in bag[1].items():
        kept = connection.ext.offered_qos_profiles[0].durability == QosDurability.TRANSIENT_LOCAL
        assert kept == topic.endswith(once)


def test_an_older_bag_is_replaced_only_on_demand(run, tmp_path):
    path = tmp_path / "out.mcap"
    path.write_text("old")
    with pytest.raises(ConfigError, match="--force"):
        mcap.export_bag(run, path, [0])
    assert path.read_text() == "old"
    mcap.export_bag(run, path, [0], force=True)
    assert path.stat().st_size > 10_000
    assert list(tmp_path.iterdir()) == [path]


class _Stopped(KeyboardInterrupt):
    """Ctrl-C, but not one that ends the tests."""


def test_an_interrupt_leaves_nothing_behind(run, tmp_path):
    def stop(done, total):
        if done == 5:
            assert total == 301
            raise _Stopped

    with pytest.raises(_Stopped):
        mcap.export_bag(run, tmp_path / "out.mcap", [0], progress=stop)
    assert not list(tmp_path.iterdir())


def test_a_full_disk_is_said_and_leaves_nothing_behind(run, tmp_path):
    def full(done, total):
        raise OSError(28, "No space left on device")

    with pytest.raises(RunError, match="No space left"):
        mcap.export_bag(run, tmp_path / "out.mcap", [0], progress=full)
    assert not list(tmp_path.iterdir())


FAULTS = {
    "no such world": (["--worlds", "0,7"], ["--worlds 7", "worlds 0 to 1"]),
    "not numbers": (["--worlds", "0;1"], ["--worlds '0;1'", "0,3"]),
    "none": (["--worlds", ""], ["--worlds"]),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_command_says_what_is_wrong(run, tmp_path, capsys, fault):
    flags, words = FAULTS[fault]
    with pytest.raises(SystemExit) as left:
        main(["export", str(run.path), "--mcap", str(tmp_path / "new" / "out.mcap"), *flags])
    assert left.value.code == 2
    shown = capsys.readouterr().err
    for word in words:
        assert word in shown
    assert not list(tmp_path.iterdir())


def test_command_says_where_a_bag_cannot_be_written(run, tmp_path, capsys):
    wall = tmp_path / "wall"
    wall.write_text("a file where a folder is wanted")
    with pytest.raises(SystemExit) as left:
        main(["export", str(run.path), "--mcap", str(wall / "out.mcap")])
    assert left.value.code == 2
    assert "cannot be written" in capsys.readouterr().err


def test_command_takes_the_worst_and_a_good_world_if_none_is_named(run, tmp_path, capsys):
    path = tmp_path / "new" / "out.mcap"
    main(["export", str(run.path), "--mcap", str(path)])
    assert Path(capsys.readouterr().out.strip()) == path
    with AnyReader([path]) as reader:
        assert {"/world_0/scenery", "/world_1/scenery"} & set(reader.topics)
