"""Sessions over vehicles: arming, limits, take-over, losses, and what is recorded."""

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.robot.control.commands import BodyTwist, PoseTarget
from angler_mjx.runs.session.recording import RecordedCourse, SessionRecording
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.sim.state import Outcome
from angler_sitl.endpoints.limits import Fence
from angler_sitl.endpoints.losses import LossLimits
from angler_sitl.endpoints.session import LossError
from angler_sitl.scene.scenario_options import select_scenario

TARGET = "SET_POSITION_TARGET_LOCAL_NED"
MANUAL, ALT_HOLD, GUIDED, SURFACE, POSHOLD = 19, 2, 4, 9, 16


def pose(x, y, z, yaw=0.0):
    return PoseTarget(
        position_m=np.array([x, y, z], float), velocity_mps=np.zeros(3), yaw_rad=np.array(yaw)
    )


def twist(*nu):
    return BodyTwist(nu=np.array([*nu, *[0.0] * (6 - len(nu))]))


def run(session, seconds, commands=None):
    seen = session.step(commands)
    for _ in range(round(seconds / session.dt_s) - 1):
        seen = session.step()
    return seen


def test_nothing_moves_that_was_not_armed_on_purpose(launch, connect):
    vehicle = launch()
    session = connect()
    seen = run(session, 0.5, {0: twist(0.2)})
    refused = session.step({0: twist(0.2)}).status[0].refused
    assert "takes no commands, it is MANUAL, disarmed" in refused
    assert TARGET not in vehicle.heard
    assert "MANUAL_CONTROL" not in vehicle.heard
    assert not vehicle.armed
    assert vehicle.mode == MANUAL
    assert seen.truth is None
    np.testing.assert_allclose(seen.estimate.p[0], [0.0, 0.0, -3.0], atol=1e-4)
    session.finish()
    assert session.outcomes == {"robot_0": "not_flown"}
    assert session.end_note == ""
    assert not any(m.command == mav.MAV_CMD_DO_SET_MODE for m in vehicle.heard["COMMAND_LONG"])


def test_steps_keep_the_time_of_the_wall(launch, connect, clock):
    launch()
    session = connect()
    session.step()
    began = clock()
    run(session, 1.0)
    assert clock() - began == pytest.approx(1.0)

    times = [session.step().time_s for _ in range(3)]
    assert np.diff(times) == pytest.approx(session.dt_s)


def test_an_armed_robot_stays_then_follows_and_is_held_to_its_limits(launch, connect):
    vehicle = launch()
    session = connect(max_speed_mps=0.4, fence=Fence(lower_m=(-2, -2, -4), upper_m=(0.3, 2, -1)))
    session.arm()
    assert (vehicle.armed, vehicle.mode) == (True, GUIDED)
    run(session, 0.3)
    np.testing.assert_allclose(vehicle.position, [0.0, 0.0, 3.0], atol=0.02)
    start = vehicle.count(TARGET)
    run(session, 2.0, {0: pose(5.0, 0.0, -3.0)})
    targets = np.array([[m.x, m.y, m.z] for m in vehicle.heard[TARGET][start:]])
    assert len(targets) == 40
    # North, east, down: east of W is the second; never beyond the fence, never too fast.
    assert targets[:, 1].max() == pytest.approx(0.3, abs=1e-3)
    assert np.abs(np.diff(targets, axis=0)).max() <= 0.4 * session.dt_s + 1e-3
    assert vehicle.count("MANUAL_CONTROL") > 30
    counts = session.summarise()["changed_targets"]["robot_0"]
    assert counts["fence"] > 10
    assert counts["step"] > 10
    refused = session.step({0: twist(5.0)}).status[0].refused
    assert "5 m/s" in refused
    session.finish()
    assert vehicle.mode == POSHOLD
    assert session.outcomes == {"robot_0": "flown"}
    assert "robot_0 confirms: POSHOLD, armed" in session.end_note


@pytest.mark.parametrize(("action", "mode"), [("surface", SURFACE), ("disarm", GUIDED)])
def test_the_user_says_what_the_end_is(launch, connect, action, mode):
    vehicle = launch()
    session = connect(at_end=action)
    session.arm()
    run(session, 0.2)
    session.finish()
    assert vehicle.mode == mode
    assert vehicle.armed == (action != "disarm")


def test_a_lost_link_ends_the_targets_and_the_session(launch, connect, clock):
    vehicle, other = launch(sysid=1), launch(sysid=2, start=(3.0, 0.0, 3.0))
    session = connect(robots=2, losses=LossLimits(link_s=0.6))
    session.arm()
    run(session, 0.5, {0: pose(1.0, 0.0, -3.0)})
    vehicle.silent = True
    began = clock()
    with pytest.raises(LossError, match=r"link_lost: robot_0: no message for 0\.[67]") as raised:
        run(session, 5.0)
    # The time limit, and then up to 2 s in which the silent vehicle does not confirm.
    assert clock() - began == pytest.approx(0.6 + 2.0, abs=0.1)
    assert raised.value.kind == "link_lost"
    assert session.outcomes == {"robot_0": "link_lost", "robot_1": "flown"}
    assert "robot_1 confirms: POSHOLD" in session.end_note
    assert "robot_0 does not confirm" in session.end_note
    # It was commanded all the same: the way there may work.
    assert vehicle.mode == POSHOLD
    assert other.mode == POSHOLD
    counts = [vehicle.count(TARGET), other.count(TARGET)]
    clock.sleep(0.3)
    assert [vehicle.count(TARGET), other.count(TARGET)] == counts
    with pytest.raises(RunError, match="down"):
        session.step()


@pytest.mark.parametrize("fault", ["blind", "no_numbers", "frozen"])
def test_a_lost_position_is_held_by_depth_alone(launch, connect, fault):
    vehicle = launch()
    session = connect(losses=LossLimits(position_s=0.5))
    session.arm()
    run(session, 0.3)
    setattr(vehicle, fault, True)
    with pytest.raises(LossError, match="position_lost: robot_0: no good position for 0") as raised:
        run(session, 5.0)
    assert raised.value.kind == "position_lost"
    assert vehicle.mode == ALT_HOLD
    assert session.outcomes == {"robot_0": "position_lost"}


def test_gaps_shorter_than_the_limit_end_nothing(launch, connect):
    vehicle = launch()
    session = connect(losses=LossLimits(link_s=0.6, position_s=0.5))
    session.arm()
    run(session, 0.3)
    vehicle.silent = True
    run(session, 0.4)
    vehicle.silent = False
    seen = run(session, 1.0)
    assert "GUIDED, armed, EKF good" in seen.status[0].note


def test_a_link_that_is_lost_while_the_caller_stalls_is_a_loss_too(launch, connect, clock):
    vehicle = launch()
    session = connect(losses=LossLimits(link_s=0.6))
    session.arm()
    run(session, 0.3)
    clock.sleep(0.3)  # its last packets wait, and are as old as the loss when they are read
    vehicle.silent = True
    clock.sleep(0.7)
    with pytest.raises(LossError, match="link_lost: robot_0"):
        session.step()
    assert session.outcomes == {"robot_0": "link_lost"}
    assert vehicle.mode == POSHOLD


def test_an_autopilot_that_restarts_is_named(launch, connect):
    vehicle = launch()
    session = connect()
    session.arm()
    run(session, 0.2)
    vehicle.reboot()
    with pytest.raises(LossError, match="autopilot_restarted: robot_0"):
        run(session, 3.0)


def test_a_pilot_who_takes_over_is_not_disturbed_and_gives_back_without_a_jump(launch, connect):
    vehicle = launch()
    session = connect(max_speed_mps=0.4)
    session.arm()
    run(session, 0.5, {0: pose(4.0, 0.0, -3.0)})
    vehicle.mode = MANUAL
    run(session, 0.2)
    counts = vehicle.count(TARGET), vehicle.count("MANUAL_CONTROL")
    vehicle.position = [2.0, -1.0, 2.5]  # where the pilot goes
    seen = run(session, 0.5)
    assert (vehicle.count(TARGET), vehicle.count("MANUAL_CONTROL")) == counts
    assert "takes no commands" in session.step({0: twist(0.1)}).status[0].refused
    assert seen.status[0].note.startswith("MANUAL, armed")
    vehicle.mode = GUIDED
    run(session, 0.5)
    first = vehicle.heard[TARGET][counts[0]]
    np.testing.assert_allclose([first.x, first.y, first.z], [2.0, -1.0, 2.5], atol=0.02)
    np.testing.assert_allclose(vehicle.position, [2.0, -1.0, 2.5], atol=0.02)
    vehicle.mode = MANUAL
    run(session, 0.2)
    session.finish()
    assert vehicle.mode == MANUAL  # the pilot's
    assert session.end_note == ""


@pytest.mark.parametrize("depth_m", [8.0, 5.1])
def test_a_vehicle_more_than_a_metre_outside_the_fence_is_not_armed(launch, connect, depth_m):
    vehicle = launch(start=(0.0, 0.0, depth_m))
    session = connect(fence=Fence(lower_m=(-2, -2, -4), upper_m=(2, 2, 0)))
    with pytest.raises(ConfigError, match=r"robot_0: is at .* outside the fence.*nothing is armed"):
        session.arm()
    assert not vehicle.armed


def test_a_vehicle_less_than_a_metre_outside_the_fence_is_armed(launch, connect):
    vehicle = launch(start=(0.0, 0.0, 4.9))
    session = connect(fence=Fence(lower_m=(-2, -2, -4), upper_m=(2, 2, 0)))
    session.arm()
    assert vehicle.armed


def test_a_vehicle_that_falls_silent_before_it_is_armed_is_named(launch, connect, clock):
    vehicle, other = launch(sysid=1), launch(sysid=2, start=(3.0, 0.0, 3.0))
    session = connect(robots=2, losses=LossLimits(link_s=0.6))
    vehicle.silent = True
    clock.sleep(0.3)
    with pytest.raises(RunError, match=r"^robot_0: no message for \d\.\d s$"):
        session.arm()
    assert not vehicle.armed
    assert not other.armed


def test_the_limits_are_described_as_they_are_held(launch, connect):
    launch()
    limits = LossLimits(link_s=0.6, position_s=0.5)
    fence = Fence(lower_m=(-2, -3, -4), upper_m=(2, 3, 0))
    session = connect(max_speed_mps=0.4, fence=fence, losses=limits, at_end="surface")
    assert session.describe_limits() == (
        "held: speed of targets 0.4 m/s, fence x -2 to 2, y -3 to 3, z -4 to 0 m; surface at the "
        "end, after 0.6 s without messages, and after 0.5 s without a position"
    )


def test_the_fence_is_the_region_of_the_world_where_none_is_stated(launch, connect):
    launch()
    cube = [[-12.0, -12.0, -24.0], [12.0, 12.0, 0.0]]  # 24 m of open water
    assert connect().summarise()["fence_m"] == cube


def test_an_episode_begins_in_the_fence(launch, connect):
    vehicle = launch(start=(0.0, 0.0, -0.1))  # it floats, out of the world's water
    session = connect(max_speed_mps=0.5)
    assert run(session, 0.3).status[0].outcome is Outcome.RUNNING
    session.arm()
    seen = run(session, 1.5, {0: pose(0.0, 0.0, -0.4)})
    assert seen.status[0].outcome is Outcome.RUNNING
    np.testing.assert_allclose(seen.estimate.p[0], [0.0, 0.0, -0.4], atol=0.05)
    vehicle.stuck, vehicle.position = True, [0.0, 0.0, -0.3]
    seen = run(session, 0.2)
    assert seen.status[0].outcome is Outcome.OUT_OF_BOUNDS
    # The scenario's episode is over; the vehicle can still be commanded.
    assert session.step({0: pose(0.0, 0.0, -0.5)}).status[0].refused == ""


def test_an_episode_has_not_begun_before_the_vehicle_flies_inside_the_fence(launch, connect):
    vehicle = launch()
    session = connect()
    run(session, 0.2)  # inside, not armed
    vehicle.position = [0.0, 0.0, -0.6]  # lifted out of the water
    assert run(session, 0.3).status[0].outcome is Outcome.RUNNING
    session.arm()  # outside
    assert run(session, 0.3).status[0].outcome is Outcome.RUNNING
    vehicle.position = [0.0, 0.0, 0.5]
    assert run(session, 0.3).status[0].outcome is Outcome.RUNNING
    vehicle.stuck, vehicle.position = True, [0.0, 0.0, -0.6]
    assert run(session, 0.2).status[0].outcome is Outcome.OUT_OF_BOUNDS


def test_plans_are_resumed_from_where_the_robots_are(launch, connect):
    vehicle = launch()
    session = connect(max_speed_mps=0.5)
    session.arm()
    session.resume_plan(0)
    seen = run(session, 3.0)
    assert seen.status[0].command == "plan"
    assert vehicle.position[0] > 0.3  # the goal is north


def test_vehicles_cannot_be_reset(launch, connect):
    launch()
    with pytest.raises(RunError, match="cannot be reset"):
        connect().reset()


def test_a_flight_is_recorded_as_a_run(launch, connect, pool, tmp_path):
    vehicle = launch()
    scenario = select_scenario(load_scenario(pool), 1)
    with SessionRecording(tmp_path / "run", scenario, 0) as recording:
        session = connect(logs=recording.building / "robots")
        recording.begin(session)
        session.arm()
        for step in range(40):
            recording.after(session.step({0: pose(0.5, 0.0, -3.0)} if step == 0 else None))
        vehicle.silent = True
        with pytest.raises(LossError) as raised:
            run(session, 5.0)
        session.finish()
        course = RecordedCourse(
            steps=40, wall_s=2.0, compile_s=0.0, more={"vehicles": session.summarise()},
            interrupted=str(raised.value),
        )  # fmt: skip
        stored = recording.close(course)
    flown = np.asarray(stored.trajectories["p_m"])[0]
    assert flown.shape == (10, 1, 3)  # 2 s at 5 Hz
    assert flown[-1, 0, 0] > 0.3
    np.testing.assert_allclose(np.asarray(stored.trajectories["estimate/p_m"])[0], flown, atol=0.05)
    assert stored.summary["interrupted"].startswith("link_lost: robot_0")
    assert stored.summary["vehicles"]["outcomes"] == {"robot_0": "link_lost"}
    assert (stored.path / "robots" / "robot_0" / "mavlink.tlog").stat().st_size > 10_000
