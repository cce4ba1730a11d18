"""Two autopilots that carry one pipe: sessions and missions, down to the run folder."""

import pyarrow.compute as pc
import pytest

from angler_mjx.runs.storage.folder import Run
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.state import Outcome
from angler_sitl.missions import mission
from angler_sitl.missions.mission import MissionSettings
from angler_sitl.session import SitlSession

from .scene.test_contact_scene import CARRIED
from .test_armed_session import Unwatched


@pytest.fixture(scope="module")
def scenario():
    time = {"horizon_s": 40.0, "record_hz": 5.0}
    return Scenario.model_validate(CARRIED | {"time": time})


def test_signals_of_our_controllers_carry_it(stand_in, scenario):
    """The stand-in passes the signals through, so this is the batch's flight at 400 Hz."""
    with SitlSession(
        scenario, level="thrusters", estimate="truth", binary=stand_in.path
    ) as session:
        for _ in range(round(25.0 / session.dt_s)):
            observation = session.step()
            if all(status.outcome is not Outcome.RUNNING for status in observation.status):
                break
        assert [status.outcome for status in observation.status] == [Outcome.REACHED] * 2
        error = session.inside().state.tally.cargo_error
    assert error.distance_m.max() < 0.1
    assert error.angle_rad.max() < 0.0873  # 5 degrees


@pytest.mark.sitl
def test_two_real_ardusubs_carry_it(ardusub, scenario, tmp_path):
    settings = MissionSettings(out=tmp_path / "run", binary=ardusub.path)
    _, made = mission.run_mission(scenario, settings, lambda _: None, Unwatched())
    episodes = Run(made.path).episodes
    assert episodes["outcome"].to_pylist() == ["reached", "reached"]
    assert pc.max(episodes["cargo_distance_m"]).as_py() < 0.1
    assert pc.max(episodes["cargo_angle_rad"]).as_py() < 0.0873
    # The pipe weighs 15 N in water: each grip bears its half and what moves it.
    assert 7.0 < pc.max(episodes["grip_force_n"]).as_py() < 30.0
