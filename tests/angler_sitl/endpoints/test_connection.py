"""Connections: who is heard, who is refused by name, and where everybody is."""

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.frames import GeodeticOrigin
from angler_sitl.endpoints import connection
from angler_sitl.endpoints.addresses import list_addresses
from angler_sitl.endpoints.connection import locate_fleet, open_fleet

from .fake_vehicle import LAT_E7, LON_E7

DT = 0.05
DEG = 1e-7


@pytest.fixture
def reach(port, clock):
    """A function: the vehicles at the port, open."""
    fleets = []

    def open_port(robots=1, sysids=(), logs=None):
        addresses = list_addresses([f"udp:127.0.0.1:{port}"], sysids, robots)
        fleets.append(open_fleet(addresses, dt_s=DT, logs=logs))
        return fleets[-1]

    yield open_port
    for fleet in fleets:
        fleet.close()


@pytest.fixture
def impatient(monkeypatch):
    monkeypatch.setattr(connection, "HEARTBEAT_TIMEOUT_S", 1.0)
    monkeypatch.setattr(connection, "POSITION_TIMEOUT_S", 1.5)


@pytest.mark.parametrize(
    ("kind", "autopilot", "names"),
    [
        (mav.MAV_TYPE_QUADROTOR, 3, "MAV_TYPE_QUADROTOR with MAV_AUTOPILOT_ARDUPILOTMEGA"),
        (mav.MAV_TYPE_SUBMARINE, 12, "MAV_TYPE_SUBMARINE with MAV_AUTOPILOT_PX4"),
        (mav.MAV_TYPE_GCS, 8, "MAV_TYPE_GCS with MAV_AUTOPILOT_INVALID"),
        (250, 250, "MAV_TYPE 250 with MAV_AUTOPILOT 250"),
    ],
)
def test_anything_but_ardusub_is_refused_by_name(launch, reach, kind, autopilot, names):
    vehicle = launch(kind=kind, autopilot=autopilot)
    with pytest.raises(RunError, match=f"robot_0: system 1 at udp:.* is a {names}"):
        reach()
    assert not vehicle.heard.get("COMMAND_LONG")


def test_silence_names_what_was_heard(launch, reach, port, impatient):
    with pytest.raises(RunError, match=f"no heartbeat of system 1 at udp:127.0.0.1:{port}.*noth"):
        reach()
    launch(sysid=7)
    with pytest.raises(RunError, match="heard: systems 7; name it with --system-id"):
        reach()


def test_a_vehicle_without_a_position_is_named(launch, reach, impatient):
    vehicle = launch()
    vehicle.blind = True
    fleet = reach()
    with pytest.raises(RunError, match=r"robot_0: has no position.*EKF bad"):
        locate_fleet(fleet, None)


def test_a_filter_without_an_origin_receives_the_users(launch, reach, impatient):
    vehicle = launch()
    vehicle.origin = False
    fleet = reach()
    with pytest.raises(RunError, match="GPS_GLOBAL_ORIGIN"):
        locate_fleet(fleet, None)
    assert vehicle.count("SET_GPS_GLOBAL_ORIGIN") == 0
    locate_fleet(fleet, GeodeticOrigin(latitude_deg=47.6, longitude_deg=-122.3))
    assert vehicle.heard["SET_GPS_GLOBAL_ORIGIN"][0].latitude == LAT_E7


def test_two_vehicles_on_one_port_are_in_one_world(launch, reach, tmp_path):
    launch(sysid=1, start=(1.0, 2.0, 3.0))
    launch(sysid=5, start=(1.0, 2.0, 3.0), lon=LON_E7 + 1_000)  # its filter began farther east
    fleet = reach(2, (1, 5), tmp_path)
    locate_fleet(fleet, None)
    first, second = fleet.estimate_motion().p
    np.testing.assert_allclose(first, [2.0, 1.0, -3.0], atol=1e-4)
    # A degree of longitude has 111,320 m times the cosine of the latitude, to 0.3 %.
    east_m = 1_000 * DEG * 111_320 * np.cos(np.radians(47.6))
    np.testing.assert_allclose(second - first, [east_m, 0.0, 0.0], atol=0.01 * east_m)
    assert [report.sysid for report in fleet.report()] == [1, 5]
    fleet.close()
    assert all((tmp_path / f"robot_{i}" / "mavlink.tlog").stat().st_size > 1000 for i in (0, 1))


def test_nothing_is_armed_and_no_mode_is_changed_by_connecting(launch, reach):
    vehicle = launch()
    fleet = reach()
    locate_fleet(fleet, None)
    commands = {message.command for message in vehicle.heard["COMMAND_LONG"]}
    assert commands <= {mav.MAV_CMD_SET_MESSAGE_INTERVAL, mav.MAV_CMD_REQUEST_MESSAGE}
    assert "SET_POSITION_TARGET_LOCAL_NED" not in vehicle.heard
    assert "SET_MODE" not in vehicle.heard
    assert "MANUAL_CONTROL" not in vehicle.heard


def test_a_vehicle_that_refuses_to_arm_says_why_and_all_are_disarmed(launch, reach, monkeypatch):
    monkeypatch.setattr("angler_sitl.endpoints.vehicles.ARM_TIMEOUT_S", 1.5)
    willing, unwilling = launch(sysid=1), launch(sysid=2)
    unwilling.refuses = {mav.MAV_CMD_COMPONENT_ARM_DISARM}
    fleet = reach(2)
    locate_fleet(fleet, None)
    with pytest.raises(RunError, match=r"robot_1: refuses to arm.*water in the hull"):
        fleet.arm([0, 1])
    fleet.wait()
    fleet.wait()
    assert not willing.armed


@pytest.mark.parametrize(
    ("endpoints", "sysids", "robots", "fault"),
    [
        (["udp:h:1", "udp:h:2"], (), 3, "2 endpoints for 3 robots"),
        (["udp:h:1"], (1,), 2, "1 numbers for 2 robots"),
        (["udp:h:1"], (0, 1), 2, "--system-id 0"),
        (["udp:h:1"], (1, 255), 2, "--system-id 255"),
        (["udp:h:1"], (3, 3), 2, "system 3 is there twice"),
        (["udp:h:1", "udp:h:1"], (), 2, "system 1 is there twice"),
    ],
)
def test_addresses_that_contradict_are_refused(endpoints, sysids, robots, fault):
    with pytest.raises(ConfigError, match=fault):
        list_addresses(endpoints, sysids, robots)


def test_numbers_are_1_on_endpoints_of_their_own_and_count_on_a_common_one():
    common = list_addresses(["udp:h:1"], (), 3)
    assert [address.sysid for address in common] == [1, 2, 3]
    separate = list_addresses(["udp:h:1", "udp:h:2"], (), 2)
    assert [address.sysid for address in separate] == [1, 1]
