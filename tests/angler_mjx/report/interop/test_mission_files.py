"""Missions of ground stations: what items mean, what is named, and files that others read."""

import json
import math
import random
from types import SimpleNamespace

import numpy as np
import pytest

from angler_mjx.cli.main import main
from angler_mjx.errors import ConfigError
from angler_mjx.report.interop.mission_files import export_mission as exporting
from angler_mjx.report.interop.mission_files import items as mission_items
from angler_mjx.report.interop.mission_files import speed_profile
from angler_mjx.report.interop.mission_files.import_mission import (
    import_missions,
    read_limits,
    read_mission,
)
from angler_mjx.report.interop.mission_files.route import VehicleLimits
from angler_mjx.robot.control.commands import joint_goal
from angler_mjx.robot.control.commands.joint_trajectory import VEHICLE_JOINTS
from angler_mjx.robot.control.plans import joints_at
from angler_mjx.robot.importing.notes import Notes
from angler_mjx.scenario.scenario import load_scenario

HOME = (47.6, -122.3)
# Lengths of 0.0001 degrees at 47.6 N on WGS84: 111,182.4 m and 75,200.6 m a degree, by the series
# 111132.92 - 559.82 cos 2p + 1.175 cos 4p - 0.0023 cos 6p and
# 111412.84 cos p - 93.5 cos 3p + 0.118 cos 5p (National Geospatial-Intelligence Agency).
NORTH_M, EAST_M = 11.118, 7.520


def item(command, params, frame=3, **more):
    return {
        "autoContinue": True,
        "command": command,
        "frame": frame,
        "params": params,
        "type": "SimpleItem",
        **more,
    }


def waypoint(north, east, altitude, hold=0, **more):
    params = [hold, 0, 0, None, HOME[0] + 1e-4 * north, HOME[1] + 1e-4 * east, altitude]
    return item(16, params, **more)


def jump(target, count):
    return item(177, [target, count, 0, 0, 0, 0, 0], frame=2)


def speed(mps):
    return item(178, [1, mps, -1, 0, 0, 0, 0], frame=2)


def plan(items, **more):
    return {
        "fileType": "Plan",
        "geoFence": {"circles": [], "polygons": [], "version": 2},
        "groundStation": "QGroundControl",
        "mission": {
            "cruiseSpeed": 15,
            "firmwareType": 3,
            "hoverSpeed": 5,
            "items": items,
            "plannedHomePosition": [*HOME, 0],
            "vehicleType": 12,
            "version": 2,
            **more,
        },
        "rallyPoints": {"points": [], "version": 2},
        "version": 1,
    }


@pytest.fixture
def write(tmp_path):
    def write(content, name="dive.plan"):
        path = tmp_path / name
        path.write_text(content if isinstance(content, str) else json.dumps(content))
        return path

    return write


def import_mission(path, **options):
    """The import of one mission: of its robot and of its scenario."""
    imported = import_missions([path], **options)
    (mission,) = imported.missions
    return SimpleNamespace(**(vars(imported) | vars(mission)))


def positions(imported):
    return [stop.position_m for stop in imported.route]


def shuffle(value, numbers):
    """The same JSON with the keys of all objects in another order."""
    if isinstance(value, dict):
        keys = list(value)
        numbers.shuffle(keys)
        return {key: shuffle(value[key], numbers) for key in keys}
    return [shuffle(entry, numbers) for entry in value] if isinstance(value, list) else value


# ---------------------------------------------------------------- what items mean


def test_waypoints_lie_where_the_globe_says(write):
    imported = import_mission(write(plan([waypoint(1, 2, -4), waypoint(-3, 0, -6)])))
    expected = [(2 * EAST_M, NORTH_M, -4.0), (0.0, -3 * NORTH_M, -6.0)]
    for got, want in zip(positions(imported), expected, strict=True):
        assert got == pytest.approx(want, abs=5e-3)


def test_the_order_of_keys_does_not_matter(write):
    content = plan([speed(0.4), waypoint(1, 0, -4, hold=3), waypoint(1, 1, -4)])
    first = import_mission(write(content))
    for seed in range(5):
        again = import_mission(write(shuffle(content, random.Random(seed))))
        assert [(s.position_m, s.speed_mps, s.hold_s) for s in again.route] == [
            (s.position_m, s.speed_mps, s.hold_s) for s in first.route
        ]


def test_nan_and_null_are_numbers_left_out(write):
    text = json.dumps(plan([waypoint(1, 0, -4)]))
    assert "null" in text
    with_nan = import_mission(write(text.replace("null", "NaN")))
    assert positions(with_nan) == positions(import_mission(write(text)))


def test_speeds_act_on_the_legs_after_them(write):
    items = [speed(0.4), waypoint(1, 0, -4), speed(0.25), waypoint(2, 0, -4), waypoint(3, 0, -4)]
    imported = import_mission(write(plan(items)))
    assert [stop.speed_mps for stop in imported.route] == [0.4, 0.25, 0.25]


def test_speeds_beyond_the_vehicle_are_snapped_and_named(write):
    imported = import_mission(write(plan([speed(5.0), waypoint(1, 0, -4)])))
    assert imported.route[0].speed_mps < 1.0
    assert any("DO_CHANGE_SPEED: 5 m/s" in str(note) for note in imported.notes)


def test_loiters_hold_and_the_endless_one_is_the_last(write):
    loiter = item(19, [12, 0, 0, None, HOME[0], HOME[1] + 1e-4, -4])
    endless = item(17, [0, 0, 0, None, HOME[0], HOME[1] + 2e-4, -4])
    items = [waypoint(0, 1, -4, hold=2), loiter, endless, waypoint(5, 5, -4)]
    imported = import_mission(write(plan(items)))
    assert [stop.hold_s for stop in imported.route] == [2.0, 12.0, math.inf]
    assert any("1 items after NAV_LOITER_UNLIM" in str(note) for note in imported.notes)
    # The second leg is none, so the loiter adds its 12 s alone.
    arrivals, ends = imported.planned.arrivals_s, imported.planned.ends_s
    assert arrivals[1] - ends[0] == pytest.approx(0.0, abs=1e-9)
    assert ends[1] - arrivals[1] == pytest.approx(12.0)


def test_a_delay_prolongs_the_stay_before_it(write):
    delay = item(93, [7, 0, 0, 0, 0, 0, 0], frame=2)
    imported = import_mission(write(plan([waypoint(1, 0, -4, hold=1), delay, waypoint(2, 0, -4)])))
    assert [stop.hold_s for stop in imported.route] == [8.0, 0.0]


def test_jumps_repeat_what_is_between(write):
    items = [waypoint(1, 0, -4), waypoint(2, 0, -4), jump(1, 2), waypoint(3, 0, -4)]
    imported = import_mission(write(plan(items)))
    assert [stop.item.number for stop in imported.route] == [1, 2, 1, 2, 1, 2, 4]


def test_jumps_of_plans_name_the_ids_of_items(write):
    items = [waypoint(1, 0, -4, doJumpId=7), waypoint(2, 0, -4, doJumpId=9), jump(9, 1)]
    imported = import_mission(write(plan(items)))
    assert [stop.item.number for stop in imported.route] == [1, 2, 2]


def test_altitude_nought_and_position_nought_keep_what_is(write):
    here = item(16, [0, 0, 0, None, 0, 0, -6])
    imported = import_mission(write(plan([waypoint(1, 0, -4), waypoint(2, 0, 0), here])))
    z = [position[2] for position in positions(imported)]
    assert z == [-4.0, -4.0, -6.0]
    assert positions(imported)[2][:2] == positions(imported)[1][:2]
    assert any("altitude 0 keeps the depth" in str(note) for note in imported.notes)


def test_altitudes_above_sea_level_count_from_the_surface(write):
    content = plan([waypoint(1, 0, 196.0, frame=0)], plannedHomePosition=[*HOME, 200.0])
    imported = import_mission(write(content))
    assert positions(imported)[0][2] == pytest.approx(-4.0)
    assert any("above sea level" in str(note) for note in imported.notes)


def test_a_heading_holds_for_one_leg(write):
    yaw = item(115, [90, 0, 0, 0, 0, 0, 0], frame=2)  # east
    imported = import_mission(write(plan([waypoint(2, 0, -4), yaw, waypoint(4, 0, -4)])))
    assert [stop.yaw_rad for stop in imported.route] == [None, 0.0]
    points = imported.planned.goal.points
    assert points[-1].positions[3] % (2 * math.pi) == pytest.approx(0.0, abs=1e-9)


def test_a_vertical_leg_keeps_the_heading(write):
    imported = import_mission(write(plan([waypoint(2, 0, -4), waypoint(2, 0, -7)])))
    points = imported.planned.goal.points
    np.testing.assert_allclose([point.positions[3] for point in points], math.pi / 2, atol=1e-6)


def test_home_and_the_surface_end_below_it(write):
    returning = item(20, [0] * 7, frame=2)
    landing = item(21, [0, 0, 0, 0, 0, 0, 0])
    imported = import_mission(write(plan([waypoint(1, 0, -4), landing, returning])))
    assert positions(imported)[1] == (*positions(imported)[0][:2], -0.5)
    assert positions(imported)[2] == pytest.approx((0.0, 0.0, -0.5), abs=1e-6)
    kinds = [note.kind for note in imported.notes if "surface" in str(note)]
    assert kinds.count("snapped") == 2


def test_circles_keep_their_radius_and_direction(write):
    circle = item(18, [2, 0, 6.0, None, HOME[0], HOME[1] + 4e-4, -5])
    imported = import_mission(write(plan([waypoint(0, 1, -5), circle])))
    trajectory = joint_goal.build_trajectory(
        imported.planned.goal,
        joints=VEHICLE_JOINTS,
        position=imported.planned.goal.points[0].positions,
    )
    begin, end = imported.planned.arrivals_s[1], imported.planned.ends_s[1]
    times = np.linspace(begin, end, 2000)
    p = np.asarray(joints_at(trajectory, times).position)
    offset = p[:, :2] - (4 * EAST_M, 0.0)
    assert np.abs(np.hypot(*offset.T) - 6.0).max() < 5e-3
    angle = np.unwrap(np.arctan2(offset[:, 1], offset[:, 0]))
    assert angle[-1] - angle[0] == pytest.approx(-2 * 2 * math.pi, abs=1e-3)  # clockwise
    # 2 degrees a second (CIRCLE_RATE): 360 s, and what starting and stopping takes.
    assert 360.0 < end - begin < 365.0


@pytest.mark.parametrize(("north", "east"), [(3, -4), (0, 0)])
def test_circles_begin_at_the_edge_that_is_nearest_or_south_of_their_middle(write, north, east):
    center = [HOME[0] + 2e-4, HOME[1] + 1e-4]
    circle = item(18, [1, 0, 6.0, None, *center, -5])
    imported = import_mission(write(plan([waypoint(2 + north, 1 + east, -5), circle])))
    middle = np.array([EAST_M, 2 * NORTH_M])
    outward = np.array([east * EAST_M, north * NORTH_M]) if north else np.array([0.0, -1.0])
    edge = [*(middle + 6.0 * outward / np.hypot(*outward)), -5.0]
    assert positions(imported)[1] == pytest.approx(edge, abs=5e-3)
    # The line to the circle ends where the circle begins and ends.
    times = (imported.planned.arrivals_s[1], imported.planned.ends_s[1])
    points = imported.planned.goal.points
    for end_s in times:
        nearest = min(points, key=lambda point: abs(point.time_s - end_s))
        assert nearest.time_s == pytest.approx(end_s, abs=1e-5)
        assert nearest.positions[:3] == pytest.approx(edge, abs=5e-3)


def test_items_of_surveys_are_flown_and_other_complex_items_named(write):
    survey = {
        "type": "ComplexItem",
        "complexItemType": "survey",
        "angle": 30,
        "polygon": [],
        "TransectStyleComplexItem": {
            "CameraCalc": {},
            "Items": [waypoint(1, 0, -4), waypoint(2, 0, -4)],
            "version": 1,
        },
    }
    structure = {"type": "ComplexItem", "complexItemType": "StructureScan", "polygon": []}
    imported = import_mission(write(plan([survey, structure, waypoint(3, 0, -4)])))
    assert len(imported.route) == 3
    (note,) = [str(n) for n in imported.notes if "StructureScan" in str(n)]
    assert "mission.items[1]" in note


def test_what_is_not_understood_is_named(write):
    content = plan([item(22, [0, 0, 0, None, *HOME, -3]), waypoint(1, 0, -4, wingFlaps=3)])
    content["geoFence"]["polygons"] = [{"polygon": []}]
    content["rallyPoints"]["points"] = [[*HOME, 0.0], [*HOME, 1.0]]
    content["mission"]["items"].append(item(42000, [0] * 7, frame=2))
    content["future"] = 1
    notes = "\n".join(map(str, import_mission(write(content)).notes))
    for part in (
        "NAV_TAKEOFF: not flown here [dive.plan: mission.items[0]]",
        "'wingFlaps'",
        "command 42000",
        "geoFence.polygons: 1, not checked [dive.plan: geoFence.polygons]",
        "rallyPoints.points: 2, not checked",
        "'future'",
    ):
        assert part in notes


def test_names_are_those_of_mavlink():
    mavlink = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")
    frames, commands = mavlink.enums["MAV_FRAME"], mavlink.enums["MAV_CMD"]
    for number, name in mission_items.FRAME_NAMES.items():
        assert frames[number].name == name
    for number, name in mission_items.COMMAND_NAMES.items():
        assert commands[number].name == f"MAV_CMD_{name}"


@pytest.mark.parametrize("parameters", [4, 7])
def test_positions_of_old_plans_stand_in_their_coordinate(write, parameters):
    old = item(16, [3, 0, 0, 0, 1, 2, 3][:parameters])
    old["coordinate"] = [HOME[0] + 1e-4, HOME[1] + 2e-4, -4]
    imported = import_mission(write(plan([old])))
    assert positions(imported)[0] == pytest.approx((2 * EAST_M, NORTH_M, -4.0), abs=5e-3)
    assert imported.route[0].hold_s == 3.0
    assert not any("coordinate" in str(note) for note in imported.notes)


# ---------------------------------------------------------------- way-point files

WPL = """QGC WPL 110
# written by hand
0\t1\t0\t16\t0\t0\t0\t0\t47.6\t-122.3\t0\t1
1 0 2 178 1 0.3 -1 0 0 0 0 1

2\t0\t3\t16\t4.0\t0\t0\tnan\t47.6001\t-122.3\t-5.0\t1  # hold
3\t0\t3\t16\t0\t0\t0\t0\t47.6001\t-122.2999\t-5.0\t1
"""


def test_waypoint_files_are_those_of_plans(write):
    from_text = import_mission(write(WPL, "dive.waypoints"))
    items = [speed(0.3), waypoint(1, 0, -5, hold=4), waypoint(1, 1, -5)]
    from_plan = import_mission(write(plan(items)))
    for a, b in zip(from_text.route, from_plan.route, strict=True):
        assert a.position_m == pytest.approx(b.position_m, abs=1e-6)
        assert (a.speed_mps, a.hold_s) == (b.speed_mps, b.hold_s)


def test_pymavlink_reads_the_same_waypoints(write):
    mavwp = pytest.importorskip("pymavlink.mavwp")
    path = write(WPL, "dive.waypoints")
    loader = mavwp.MAVWPLoader()
    loader.load(str(write(WPL.replace("  # hold", ""), "plain.waypoints")))
    ours = read_mission(path, Notes()).items
    assert loader.count() == len(ours) + 1
    for i, mission_item in enumerate(ours, 1):
        theirs = loader.wp(i)
        assert (theirs.command, theirs.frame) == (mission_item.command, mission_item.frame)
        assert theirs.param1 == pytest.approx(mission_item.parameter(1))
        got = (mission_item.latitude_deg, mission_item.longitude_deg, mission_item.altitude_m)
        assert (theirs.x, theirs.y, theirs.z) == pytest.approx(got)


@pytest.mark.parametrize("altitude", [0.0, 12.5])
def test_line_nought_is_home_with_its_altitude(write, altitude):
    text = WPL.replace("47.6\t-122.3\t0\t1", f"47.6\t-122.3\t{altitude}\t1")
    mission = read_mission(write(text, "dive.waypoints"), Notes())
    assert (mission.home.latitude_deg, mission.home.longitude_deg) == HOME
    assert mission.home.altitude_m == altitude
    assert [entry.number for entry in mission.items] == [1, 2, 3]


def test_files_of_more_than_16_mib_are_no_waypoints(write):
    path = write(WPL, "dive.waypoints")
    text = WPL + "#" * (2**24 - len(WPL))
    path.write_text(text)
    assert len(read_mission(path, Notes()).items) == 3
    path.write_text(text + "#")
    with pytest.raises(ConfigError, match="more than 16 MiB"):
        read_mission(path, Notes())


# ---------------------------------------------------------------- fleets


def test_each_robot_has_its_mission_in_the_world_of_the_first_home(write, tmp_path):
    west = [HOME[0], HOME[1] - 1e-3]
    a = write(plan([speed(0.4), waypoint(2, 0, -4, hold=3)]), "a.plan")
    b = write(plan([speed(0.3), waypoint(1, -10, -6)], plannedHomePosition=[*west, 0]), "b.plan")
    out = tmp_path / "both.toml"
    main(["mission", "import", str(a), str(b), "--worlds", "2", "--out", str(out)])
    scenario = load_scenario(out)
    np.testing.assert_allclose(scenario.world.start_m[1], [-10 * EAST_M, 0, -0.5], atol=2e-2)
    np.testing.assert_allclose(scenario.world.goal_m[0], [0, 2 * NORTH_M, -4], atol=2e-2)
    np.testing.assert_allclose(scenario.world.goal_m[1], [-10 * EAST_M, NORTH_M, -6.0], atol=2e-2)
    # Cruise speeds are those along the paths, whose horizontal parts are 0.4 and 0.3 m/s.
    level = [2 * NORTH_M, NORTH_M]
    drops = [3.5, 5.5]
    for entry, mps, flat, drop in zip(scenario.fleet, (0.4, 0.3), level, drops, strict=True):
        assert entry.cruise_speed_mps == pytest.approx(
            mps * math.hypot(flat, drop) / flat, rel=0.01
        )
    (first, _), (second, end) = (
        exporting.read_path(tmp_path / "both.zarr", 1, robot) for robot in (0, 1)
    )
    assert first[-1] > second[-1] > 30.0
    np.testing.assert_allclose(end[-1], scenario.world.goal_m[1], atol=1e-3)


def test_robots_from_one_home_start_apart(write):
    paths = [write(plan([waypoint(2, i, -4)]), f"{i}.plan") for i in range(3)]
    imported = import_missions(paths)
    start = np.array(imported.scenario.world.start_m)
    gaps = np.linalg.norm(start[:, None] - start, axis=-1)[np.triu_indices(3, 1)]
    assert gaps.min() > 1.5  # a BlueROV2 is 0.57 m wide
    assert gaps.min() < 2.5
    said = [str(note) for note in imported.notes]
    assert any(text.startswith("assumed: 1.plan: the vehicle starts") for text in said)
    assert sum("m east of where another one starts" in text for text in said) == 2
    assert not any("below home" in text for text in said if "2.plan" in text)


def test_a_home_away_from_w_is_named(write):
    west = [HOME[0], HOME[1] - 1e-3]
    a = write(plan([waypoint(2, 0, -4)]), "a.plan")
    b = write(plan([waypoint(1, -10, -6)], plannedHomePosition=[*west, 0]), "b.plan")
    notes = [str(note) for note in import_missions([a, b]).notes]
    (note,) = [text for text in notes if "home is at" in text]
    assert note.startswith(f"converted: b.plan: home is at ({-10 * EAST_M:.1f}, ")
    # The third starts at the first's home, which is that of W.
    same = import_missions([b, a, b]).notes
    assert [str(note) for note in same if "home is at" in str(note)] == [
        f"converted: a.plan: home is at ({10 * EAST_M:.1f}, 0.0) m of W"
    ]


def test_a_tour_is_of_one_mission(write):
    paths = [write(plan([waypoint(2, i, -4)]), f"{i}.plan") for i in range(2)]
    with pytest.raises(ConfigError, match="--kind tour: 2 files"):
        import_missions(paths, kind="tour")


# ---------------------------------------------------------------- bad input


def broken(change):
    content = plan([waypoint(1, 0, -4), waypoint(2, 0, -4)])
    change(content["mission"]["items"][1], content)
    return content


BAD_PLANS = {
    "terrain": (lambda i, c: i.update(frame=10), ("items[1]", "GLOBAL_TERRAIN_ALT", "frame 3")),
    "local": (lambda i, c: i.update(frame=1), ("items[1]", "LOCAL_NED", "frame 3")),
    "above": (
        lambda i, c: i["params"].__setitem__(6, 30),
        ("items[1]", "30 m", "negative altitudes"),
    ),
    "latitude": (
        lambda i, c: i["params"].__setitem__(4, 91.5),
        ("items[1]", "latitude = 91.5", "within"),
    ),
    "text": (lambda i, c: i["params"].__setitem__(0, "5"), ("params[0] = '5'", "number or null")),
    "short": (lambda i, c: i["params"].pop(), ("items[1].params", "7 numbers")),
    "command": (lambda i, c: i.pop("command"), ("items[1].command", "whole number")),
    "type": (lambda i, c: i.update(type="Item"), ("items[1].type = 'Item'", "SimpleItem")),
    "hold": (lambda i, c: i["params"].__setitem__(0, -2), ("items[1]", "-2 s", "0 or more")),
    "kind": (lambda i, c: c.update(fileType="Mission"), ("fileType = 'Mission'", ".plan")),
    "version": (lambda i, c: c.update(version=9), ("version = 9", "version 1")),
    "list": (lambda i, c: c["mission"].update(items={}), ("mission.items", "a list")),
    "home": (
        lambda i, c: c["mission"].update(plannedHomePosition=[1]),
        ("plannedHomePosition", "latitude, longitude"),
    ),
    "fence": (
        lambda i, c: c["geoFence"].update(circles=3),
        ("geoFence.circles = 3", "must be a list"),
    ),
    "rally": (
        lambda i, c: c["rallyPoints"].update(points="abc"),
        ("rallyPoints.points = 'abc'", "must be a list"),
    ),
    "endless": (lambda i, c: c["mission"]["items"].append(jump(1, -1)), ("items[2]", "-1 times")),
    "nowhere": (lambda i, c: c["mission"]["items"].append(jump(8, 1)), ("items[2]", "1 to 3")),
    "empty": (lambda i, c: c["mission"].update(items=[speed(1.0)]), ("NAV_WAYPOINT",)),
    "turns": (
        lambda i, c: i.update(command=18, params=[0, 0, 5, 0, *HOME, -4]),
        ("items[1]", "0 turns", "1 to 40"),
    ),
}


@pytest.mark.parametrize("name", BAD_PLANS)
def test_a_fault_of_a_plan_is_one_message_with_its_key_and_remedy(write, name):
    change, parts = BAD_PLANS[name]
    path = write(broken(change))
    with pytest.raises(ConfigError) as raised:
        import_mission(path)
    message = str(raised.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    for part in parts:
        assert part in message


BAD_LINES = {
    "terrain": ("3\t0\t3\t16", "3\t0\t10\t16", (":7", "GLOBAL_TERRAIN_ALT", "frame 3")),
    "word": ("4.0", "four", (":6", "param1 = 'four'", "a number")),
    "columns": ("\t-5.0\t1  # hold", "\t-5.0", (":6", "11 columns", "autocontinue")),
    "number": ("3\t0\t3", "5\t0\t3", (":7", "number = 5", "must be 3")),
    "header": ("QGC WPL 110", "QGC WPL 200", (":1: 'QGC WPL 200'", "must be QGC WPL 110")),
    "frame": ("3\t0\t3\t16", "3\t0\t3.5\t16", (":7", "frame = 3.5", "whole number")),
}


@pytest.mark.parametrize("name", BAD_LINES)
def test_a_fault_of_a_line_is_one_message_with_its_number_and_remedy(write, name):
    old, new, parts = BAD_LINES[name]
    assert old in WPL
    path = write(WPL.replace(old, new), "dive.waypoints")
    with pytest.raises(ConfigError) as raised:
        import_mission(path)
    message = str(raised.value)
    assert message.startswith(str(path))
    for part in parts:
        assert part in message


def test_a_file_that_is_not_there_is_one_message(tmp_path):
    with pytest.raises(ConfigError, match=r"gone\.plan: cannot be read"):
        import_mission(tmp_path / "gone.plan")


def test_horizons_are_a_day_at_most(write):
    leg_s = import_mission(write(plan([waypoint(1, 0, -4)]))).planned.duration_s
    # Twice the plan and a minute.
    hold_s = (86_400 - 60) / 2 - leg_s
    longest = import_mission(write(plan([waypoint(1, 0, -4, hold=hold_s - 0.1)])))
    assert longest.scenario.time.horizon_s == 86_400
    with pytest.raises(ConfigError, match="86400 s at most"):
        import_mission(write(plan([waypoint(1, 0, -4, hold=hold_s + 0.1)])))


def test_a_mission_without_home_needs_an_origin(write):
    path = write(plan([waypoint(1, 0, -4)], plannedHomePosition=None))
    with pytest.raises(ConfigError, match="--origin"):
        import_mission(path)


@pytest.mark.parametrize("text", ["47.6", "a,b", "95,0", "1,2,3,4", "nan,0"])
def test_an_origin_off_the_globe_is_refused(write, capsys, text):
    with pytest.raises(SystemExit):
        main(["mission", "import", str(write(plan([waypoint(1, 0, -4)]))), f"--origin={text}"])
    assert "--origin" in capsys.readouterr().err


# ---------------------------------------------------------------- speeds and times


@pytest.mark.parametrize(
    ("length", "limits"),
    [
        (10.0, (0.5, 2.5, 1.0)),  # the acceleration is not reached
        (10.0, (0.5, 0.2, 1.0)),  # it is
        (0.2, (0.5, 2.5, 1.0)),  # the speed is not reached
        (1.0, (2.0, 0.3, 1.0)),  # the acceleration is, the speed is not
        (10.0, (0.5, 1.0, 1.0)),  # ArduSub's climbs
        (3.0, (0.5, 2.0, 4.0)),  # another jerk than 1, without and with the acceleration reached
        (3.0, (0.5, 1.0, 4.0)),
    ],
)
def test_profiles_keep_their_limits_and_take_no_longer(length, limits):
    speed, acceleration, jerk = limits
    profile = speed_profile.plan_speed(length, *limits)
    times = np.linspace(0.0, profile.duration_s, 40_001)
    s, v = np.array([profile.sample(t) for t in times]).T
    dt = times[1] - times[0]
    a = np.diff(v) / dt
    assert s[-1] == pytest.approx(length, rel=1e-9)
    assert abs(v[-1]) < 1e-9
    assert v.max() <= speed * (1 + 1e-9)
    assert np.abs(a).max() <= acceleration * (1 + 1e-6)
    assert np.abs(np.diff(a) / dt).max() <= jerk * (1 + 1e-3)
    np.testing.assert_allclose(np.gradient(s, times)[5:-5], v[5:-5], atol=1e-4)
    # One of the limits holds all the time, but for the instants at which phases change.
    bound = (
        (v[1:-1] > speed * (1 - 1e-6))
        | (np.abs(a[1:]) > acceleration * (1 - 1e-4))
        | (np.abs(np.diff(a) / dt) > jerk * (1 - 1e-2))
    )
    assert bound.mean() > 0.99


def test_a_long_leg_takes_the_time_of_the_closed_form(write):
    """L / v + 2 sqrt(v / j): the jerk of ArduSub's defaults decides, not its acceleration."""
    imported = import_mission(write(plan([speed(0.4), waypoint(0, 1, -0.5), waypoint(0, 9, -0.5)])))
    leg = imported.planned.arrivals_s[1] - imported.planned.ends_s[0]
    assert leg == pytest.approx(8 * EAST_M / 0.4 + 2 * math.sqrt(0.4 / 1.0), abs=0.02)


def test_the_horizontal_part_has_the_speed_and_the_vertical_its_limit(write):
    path = write(plan([speed(0.4), waypoint(1, 0, -5), waypoint(0, 0, -5.5)]))
    planned = import_mission(path, limits=VehicleLimits(speed_down_mps=0.1)).planned
    time = np.array([point.time_s for point in planned.goal.points])
    velocity = np.array([point.velocities[:3] for point in planned.goal.points])
    first = velocity[time < planned.arrivals_s[0] - 1e-6]
    # 4.5 m down and 11.1 m north: the dive is the slower part.
    assert np.abs(first[:, 2]).max() == pytest.approx(0.1, rel=1e-6)
    second = velocity[time > planned.ends_s[0] + 1e-6]
    assert np.hypot(*second[:, :2].T).max() == pytest.approx(0.4, rel=1e-6)


def test_parameters_of_the_vehicle_count():
    read = {"WPNAV_SPEED": 40.0, "WPNAV_JERK": 0.5, "WPNAV_RADIUS": 100.0, "OTHER": 1.0}
    limits = read_limits(read, VehicleLimits())
    assert (limits.speed_mps, limits.jerk_mps3, limits.radius_m) == (0.4, 0.5, 1.0)
    with pytest.raises(ConfigError, match="WPNAV_SPEED = 0"):
        read_limits({"WPNAV_SPEED": 0.0}, VehicleLimits())


def test_parameters_have_the_units_of_ardusub():
    """cm/s, cm/s^2, m/s^3, cm and degrees a second, as in ArduPilot's list of parameters."""
    read = {
        "WPNAV_SPEED": 40.0,
        "WPNAV_SPEED_UP": 30.0,
        "WPNAV_SPEED_DN": 20.0,
        "WPNAV_ACCEL": 150.0,
        "WPNAV_ACCEL_Z": 70.0,
        "WPNAV_JERK": 0.5,
        "WPNAV_RADIUS": 120.0,
        "CIRCLE_RADIUS": 800.0,
        "CIRCLE_RATE": -3.0,
    }
    limits = read_limits(read, VehicleLimits())
    assert (limits.speed_mps, limits.speed_up_mps, limits.speed_down_mps) == (0.4, 0.3, 0.2)
    assert (limits.acceleration_mps2, limits.acceleration_z_mps2) == pytest.approx((1.5, 0.7))
    assert (limits.jerk_mps3, limits.radius_m, limits.circle_radius_m) == (0.5, 1.2, 8.0)
    assert limits.circle_rate_radps == pytest.approx(math.pi / 60)


@pytest.mark.parametrize("text", ["WPNAV_SPEED,25\n", "1\t1\tWPNAV_SPEED\t25.0\t9\n"])
def test_parameter_files_of_both_ground_stations_set_the_speed(write, tmp_path, text):
    path, file = write(plan([waypoint(3, 0, -4)])), write(text, "mine.param")
    out = tmp_path / "a.toml"
    main(["mission", "import", str(path), "--parameters", str(file), "--out", str(out)])
    # 33.4 m level and 3.5 m down: the horizontal part makes 0.25 m/s.
    level, whole = 3 * NORTH_M, math.hypot(3 * NORTH_M, 3.5)
    cruise = load_scenario(out).fleet[0].cruise_speed_mps
    assert cruise == pytest.approx(0.25 * whole / level, abs=2e-4)


# ---------------------------------------------------------------- scenarios, and back


def test_a_tour_visits_the_stops_in_order(write, tmp_path):
    items = [waypoint(1, 0, -4, hold=5), waypoint(1, 1, -4)]
    out = tmp_path / "tour.toml"
    main(["mission", "import", str(write(plan(items))), "--kind", "tour", "--out", str(out)])
    task = load_scenario(tmp_path / "tour.toml").task
    assert (task.type, task.shared, task.ordered) == ("tour", False, True)
    assert len(task.positions_m) == 2
    assert load_scenario(tmp_path / "tour.toml").world.start_m[0][2] == -1.5  # a cell and a half
    assert "dropped: NAV_WAYPOINT: tours do not wait" in (tmp_path / "tour.toml").read_text()
    assert not (tmp_path / "tour.zarr").exists()


def test_a_tour_names_each_thing_that_it_leaves_out(write):
    yaw = item(115, [90, 0, 0, 0, 0, 0, 0], frame=2)
    circle = item(18, [2, 0, 6.0, None, HOME[0], HOME[1] + 4e-4, -5])
    items = [waypoint(1, 0, -4, hold=5), yaw, waypoint(2, 0, -4), circle, waypoint(3, 0, -4)]
    plain = [waypoint(1, 0, -4), waypoint(2, 0, -4)]
    causes = ("do not wait", "set no headings", "do not circle", "changes of speed")

    def dropped(content):
        notes = import_mission(write(plan(content)), kind="tour").notes
        lines = [str(note) for note in notes if note.kind == "dropped"]
        return [[line for line in lines if cause in line] for cause in causes]

    wait, heading, circles, speeds = dropped([*items, speed(0.2), waypoint(4, 0, -4)])
    assert "mission.items[0]" in wait[0]
    assert "mission.items[2]" in heading[0]
    assert "mission.items[3]" in circles[0]
    assert [len(lines) for lines in (wait, heading, circles, speeds)] == [1, 1, 1, 1]
    assert dropped(plain) == [[], [], [], []]


def export(source, out, *flags):
    origin = f"--origin={HOME[0]},{HOME[1]}"
    main(["mission", "export", str(source), origin, "--out", str(out), *flags])


@pytest.mark.parametrize("suffix", ["plan", "waypoints"])
def test_an_exported_mission_comes_back(write, tmp_path, suffix):
    items = [
        speed(0.4),
        waypoint(1, 0, -4, hold=6),
        waypoint(1, 2, -7),
        speed(0.25),
        waypoint(-1, 2, -3, hold=9),
        waypoint(-1, -1, -3),
    ]
    first = import_mission(write(plan(items)))
    main(["mission", "import", str(write(plan(items))), "--out", str(tmp_path / "a.toml")])
    out = tmp_path / f"back.{suffix}"
    export(tmp_path / "a.zarr", out)
    again = import_mission(out)
    assert len(again.route) == len(first.route)
    for a, b in zip(first.route, again.route, strict=True):
        assert b.position_m == pytest.approx(a.position_m, abs=0.02)
        assert b.speed_mps == pytest.approx(a.speed_mps, abs=0.011)
        assert b.hold_s == a.hold_s
    assert again.planned.duration_s == pytest.approx(first.planned.duration_s, rel=0.02)


def test_exported_files_are_read_by_others(tmp_path):
    mavwp = pytest.importorskip("pymavlink.mavwp")
    time_s = np.array([0.0, 10.0, 15.0, 40.0])
    position_m = np.array([[0.0, 0, -2], [4, 0, -2], [4, 0, -2], [4, 10, -3]])
    origin = exporting.GeodeticOrigin(latitude_deg=HOME[0], longitude_deg=HOME[1])
    items = exporting.build_items(exporting.build_waypoints(time_s, position_m), origin)
    path = tmp_path / "out.waypoints"
    path.write_text(exporting.format_waypoints(items, origin))
    loader = mavwp.MAVWPLoader()
    loader.load(str(path))
    rows = [(loader.wp(i).command, loader.wp(i).frame) for i in range(loader.count())]
    # Home, the start is below it; 0.4 m/s to a hold of 5 s, and 0.4 m/s on: one speed is enough.
    assert rows == [(16, 0), (178, 2), (16, 3), (16, 3)]
    assert loader.wp(1).param2 == pytest.approx(0.4)
    assert loader.wp(2).param1 == 5.0
    assert loader.wp(2).y - HOME[1] == pytest.approx(4e-4 / EAST_M, rel=1e-3)
    assert loader.wp(3).x - HOME[0] == pytest.approx(10e-4 / NORTH_M, rel=1e-3)
    assert loader.wp(3).z == pytest.approx(-3.0)
    table = json.loads(exporting.format_plan(items, origin))
    assert table["fileType"] == "Plan"
    assert {entry["type"] for entry in table["mission"]["items"]} == {"SimpleItem"}
    assert all(len(entry["params"]) == 7 for entry in table["mission"]["items"])


@pytest.mark.parametrize(("east_m", "count"), [(0.9, 1), (-0.9, 1), (1.1, 2)])
def test_a_start_within_a_metre_of_home_is_no_waypoint(east_m, count):
    position_m = np.array([[east_m, 0.0, -2.0], [20.0, 0.0, -2.0]])
    origin = exporting.GeodeticOrigin(latitude_deg=HOME[0], longitude_deg=HOME[1])
    waypoints = exporting.build_waypoints(np.array([0.0, 60.0]), position_m)
    commands = [entry.command for entry in exporting.build_items(waypoints, origin)]
    assert commands.count(16) == count


def test_speeds_of_exports_are_horizontal_and_vertical_legs_have_none():
    position_m = np.array([[0.0, 0, -2], [6, 0, -10], [6, 0, -2]])
    _, slope, rise = exporting.build_waypoints(np.array([0.0, 20.0, 40.0]), position_m)
    assert slope.speed_mps == pytest.approx(0.3)
    assert rise.speed_mps is None


def test_a_trajectory_that_begins_late_rests_at_its_first_point(write):
    points = [
        {"positions": [1.0, 2.0, -3.0], "time_from_start": {"sec": 2}},
        {"positions": [5.0, 2.0, -3.0], "time_from_start": {"sec": 10}},
    ]
    trajectory = {"joint_names": ["x", "y", "z"], "points": points}
    path = write({"schema_version": 1, "robots": [{"robot": 0, "trajectory": trajectory}]})
    time_s, position_m = exporting.read_path(path, 0, 0)
    assert time_s[0] == 0.0
    np.testing.assert_allclose(position_m[time_s <= 2.0], [[1, 2, -3]] * np.sum(time_s <= 2.0))
    np.testing.assert_allclose(position_m[-1], [5, 2, -3])


def test_bent_paths_are_exported_within_the_deviation():
    angle = np.linspace(0.0, math.pi, 400)
    position_m = np.stack([8 * np.cos(angle), 8 * np.sin(angle), -3 - angle], axis=1)
    waypoints = exporting.build_waypoints(np.linspace(0.0, 60.0, 400), position_m)
    corners = np.array([waypoint.position_m for waypoint in waypoints])
    assert 8 < len(corners) < 40
    begin, line = corners[:-1], np.diff(corners, axis=0)
    for point in position_m:
        s = np.clip(np.sum((point - begin) * line, 1) / np.sum(line**2, 1), 0, 1)
        assert np.linalg.norm(begin + s[:, None] * line - point, axis=1).min() < 0.0501


@pytest.mark.parametrize(
    ("flags", "part"),
    [
        (["--robot", "3"], "--robot 3"),
        (["--world", "2"], "--world 2"),
        (["--origin=x"], "--origin"),
    ],
)
def test_exports_that_cannot_be_are_refused(write, tmp_path, capsys, flags, part):
    path = write(plan([waypoint(1, 0, -4)]))
    main(["mission", "import", str(path), "--out", str(tmp_path / "a.toml")])
    with pytest.raises(SystemExit):
        export(tmp_path / "a.zarr", tmp_path / "b.plan", *flags)
    assert part in capsys.readouterr().err
    assert not (tmp_path / "b.plan").exists()
