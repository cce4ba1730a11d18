"""Vehicles on a clock of the tests, and sessions over them."""

import functools
import socket

import pytest

from angler_sitl.endpoints.session import EndpointSession, EndpointSettings
from angler_sitl.endpoints.vehicles import VehicleFleet
from angler_sitl.scene.scene import AutopilotScene

from .fake_vehicle import FakeVehicle, PlayedClock

SCENE = """
schema_version = 1
name = "pool"
seed = 3

[time]
horizon_s = 600.0
record_hz = 5.0

[world]
preset = "open"
depth_m = 0.0
placement = "given"
start_m = [[0.0, 0.0, -3.0], [0.0, 3.0, -3.0]]
goal_m = [[0.0, 6.0, -3.0], [6.0, 3.0, -3.0]]

[[fleet]]
vehicle = "bluerov2_heavy"
count = 2
"""


@pytest.fixture(scope="session")
def pool(tmp_path_factory):
    path = tmp_path_factory.mktemp("pool") / "pool.toml"
    path.write_text(SCENE)
    return path


@pytest.fixture
def port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture
def clock(monkeypatch):
    """The clock of the vehicles and of those who command them."""
    played = PlayedClock()
    fleet = functools.partial(VehicleFleet, clock=played, sleep=played.sleep)
    monkeypatch.setattr("angler_sitl.endpoints.connection.VehicleFleet", fleet)
    return played


@pytest.fixture
def launch(port, clock):
    """A function: a vehicle that sends to the port."""

    def start(sysid=1, **options):
        clock.vehicles.append(FakeVehicle(port, clock, sysid, **options))
        return clock.vehicles[-1]

    yield start
    for vehicle in clock.vehicles:
        vehicle.close()


@pytest.fixture(scope="session")
def compiled(pool):
    """Scenes that were compiled, by number of robots."""
    scenes = {}

    def find(scenario, *, world):
        count = len(scenario.members())
        if count not in scenes:
            scenes[count] = AutopilotScene(scenario, world=world)
        scenes[count].reset()
        return scenes[count]

    return find


@pytest.fixture
def connect(pool, port, compiled, clock, monkeypatch):
    """A function: a session over the vehicles at the port."""
    monkeypatch.setattr("angler_sitl.endpoints.session.AutopilotScene", compiled)
    sessions = []

    def open_session(robots=1, logs=None, **settings):
        chosen = EndpointSettings(endpoints=[f"udp:127.0.0.1:{port}"], **settings)
        sessions.append(EndpointSession(pool, chosen, robots=robots, logs=logs))
        return sessions[-1]

    yield open_session
    for session in sessions:
        session.finish()
