"""FollowJointTrajectory: accepted and rejected goals, feedback, results, cancelling, tolerances."""

import struct

import numpy as np
import pytest

from .memory_backend import HEADER, TYPES, served, trajectory

ROOT = "/robot_0/joint_trajectory_controller/follow_joint_trajectory/_action"
NAMES = ("x", "y", "z", "yaw")
START = (-3.0, -2.0, -4.0, 0.0)
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6


def uuid(number):
    return bytes([number] * 16)


def send(
    backend,
    number,
    rows,
    times,
    *,
    names=NAMES,
    goal=(),
    path=(),
    goal_time_s=0,
    stamp_s=0,
    goal_components=(),
    path_components=(),
):
    """Send a goal; returns whether it is accepted."""
    make = TYPES.types
    component = make["control_msgs/msg/JointComponentTolerance"]
    tolerance = make["control_msgs/msg/JointTolerance"]
    header = make["std_msgs/msg/Header"](make["builtin_interfaces/msg/Time"](0, 0), "")
    request = make["control_msgs/msg/SendRequest"](
        goal_id=make["unique_identifier_msgs/msg/UUID"](np.frombuffer(uuid(number), "u1")),
        trajectory=trajectory(names, rows, times=times, stamp_s=stamp_s),
        multi_dof_trajectory=make["trajectory_msgs/msg/MultiDOFJointTrajectory"](header, [], []),
        path_tolerance=[tolerance(name, value, 0.0, 0.0) for name, value in path],
        component_path_tolerance=[component(x, 0, 0.1, 0.0, 0.0) for x in path_components],
        goal_tolerance=[tolerance(name, value, 0.0, 0.0) for name, value in goal],
        component_goal_tolerance=[component(x, 0, 0.1, 0.0, 0.0) for x in goal_components],
        goal_time_tolerance=make["builtin_interfaces/msg/Duration"](goal_time_s, 0),
    )
    data = bytes(TYPES.serialize_cdr(request, "control_msgs/msg/SendRequest"))
    answer = backend.call(f"{ROOT}/send_goal", data)
    return TYPES.deserialize_cdr(answer, "control_msgs/msg/SendResponse").accepted


def begin_result(backend, number):
    return backend.begin_call(f"{ROOT}/get_result", HEADER + uuid(number))


def read_result(box):
    return TYPES.deserialize_cdr(box[0], "control_msgs/msg/ResultResponse")


def cancel(backend, identity):
    data = HEADER + identity + struct.pack("<iI", 0, 0)
    answer = backend.call(f"{ROOT}/cancel_goal", data)
    return TYPES.deserialize_cdr(answer, "control_msgs/msg/CancelResponse")


def step_until(backend, event, limit=600):
    for _ in range(limit):
        if event.is_set():
            return
        backend.step()
    raise AssertionError("no result")


def position(backend):
    p = backend.read("/robot_0/odometry")[-1].pose.pose.position
    return np.array([p.x, p.y, p.z])


def test_a_goal_is_reached_with_feedback(session, scene):
    target = (-2.0, -2.0, -4.2, 0.5)
    with served(session, scene) as door:
        backend = door.backend
        assert send(backend, 1, [target], [5.0])
        box, event = begin_result(backend, 1)
        step_until(backend, event)
        assert read_result(box).status == SUCCEEDED
        assert read_result(box).error_code == 0
        np.testing.assert_allclose(position(backend), target[:3], atol=0.16)
        (late, there) = begin_result(backend, 1)  # a result stays
        assert there.wait(10)
        assert read_result(late).status == SUCCEEDED
        statuses = [message.status_list[0].status for message in _status(backend)]
        assert statuses == [1, 2, SUCCEEDED]
        feedback = [
            TYPES.deserialize_cdr(data, "control_msgs/msg/Feedback")
            for _, data in backend.sent[f"{ROOT}/feedback"]
        ]
    assert len(feedback) >= 100  # each step of 5 s
    for message in feedback:
        assert bytes(message.goal_id.uuid) == uuid(1)
        assert message.joint_names == list(NAMES)
        error = message.desired.positions - message.actual.positions
        np.testing.assert_allclose(message.error.positions, error)
        error = message.desired.velocities - message.actual.velocities
        np.testing.assert_allclose(message.error.velocities, error)
    along = [message.desired.positions[0] for message in feedback]
    assert along[0] < -2.9
    assert along[-1] == pytest.approx(-2.0, abs=0.01)
    assert np.all(np.diff(along) > -1e-6)


def test_errors_of_the_heading_are_less_than_half_a_turn(session, scene):
    """The reference passes 180 degrees; the measured heading then counts from -180."""
    with served(session, scene) as door:
        backend = door.backend
        here = START[:3]
        assert send(backend, 1, [(*here, 2.0), (*here, 3.6)], [3.0, 6.0])
        for _ in range(130):  # 6.5 s
            backend.step()
        feedback = [
            TYPES.deserialize_cdr(data, "control_msgs/msg/Feedback")
            for _, data in backend.sent[f"{ROOT}/feedback"]
        ]
    yaw = NAMES.index("yaw")
    pairs = [(m.desired.positions[yaw] - m.actual.positions[yaw], m) for m in feedback]
    assert max(apart for apart, _ in pairs) > np.pi
    for apart, message in pairs:
        error = message.error.positions[yaw]
        assert abs(error) < 1.0
        assert np.cos(error - apart) == pytest.approx(1.0)


def _status(backend):
    return [
        TYPES.deserialize_cdr(data, "action_msgs/msg/GoalStatusArray")
        for _, data in backend.sent[f"{ROOT}/status"]
    ]


def test_the_reference_is_the_guidances_target_until_the_last_point(session, scene):
    with served(session, scene) as door:
        backend = door.backend
        assert send(backend, 1, [(-2.7, *START[1:]), (-2.2, *START[1:])], [1.0, 3.0])
        for _ in range(58):  # 2.9 s
            backend.step()
            _, data = backend.sent[f"{ROOT}/feedback"][-1]
            desired = TYPES.deserialize_cdr(data, "control_msgs/msg/Feedback").desired.positions
            np.testing.assert_array_equal(desired[:3], session.observe().target_m[0])


def test_cancelled_the_robot_stays_where_it_is(session, scene):
    with served(session, scene) as door:
        backend = door.backend
        assert send(backend, 1, [(1.0, *START[1:])], [12.0])
        box, event = begin_result(backend, 1)
        backend.step(60)
        assert not event.is_set()
        answer = cancel(backend, uuid(1))
        assert answer.return_code == 0
        assert [bytes(info.goal_id.uuid) for info in answer.goals_canceling] == [uuid(1)]
        assert event.wait(10)
        assert read_result(box).status == CANCELED
        held = position(backend)
        backend.step(100)
        assert np.linalg.norm(position(backend) - held) < 0.3
        assert cancel(backend, uuid(1)).return_code == 3  # it has ended
        assert cancel(backend, uuid(9)).return_code == 2  # there is none
        assert cancel(backend, bytes(16)).return_code == 0  # all of none


def test_a_new_goal_replaces_the_last_and_a_velocity_any(session, scene):
    from .memory_backend import twist

    with served(session, scene) as door:
        backend = door.backend
        assert send(backend, 1, [(-2.0, *START[1:])], [5.0])
        first, replaced = begin_result(backend, 1)
        backend.step(10)
        assert send(backend, 2, [(-2.5, *START[1:])], [5.0])
        assert replaced.wait(10)
        assert read_result(first).status == CANCELED
        second, ended = begin_result(backend, 2)
        backend.step(10)
        backend.receivers["/robot_0/cmd_vel"](twist(0.1))
        backend.step()
        assert ended.wait(10)
        assert (read_result(second).status, "BodyTwist" in read_result(second).error_string) == (
            CANCELED,
            True,
        )


def test_a_goal_of_the_future_waits_for_its_time(session, scene):
    with served(session, scene) as door:
        backend = door.backend
        backend.call("/step")
        assert send(backend, 1, [(-2.0, *START[1:])], [4.0], stamp_s=1)
        box, event = begin_result(backend, 1)
        backend.step(18)
        assert (backend.diagnostics()["command"], event.is_set()) == ("plan", False)
        step_until(backend, event)
        assert read_result(box).status == SUCCEEDED, read_result(box).error_string
        assert backend.read("/clock")[-1].clock.sec >= 5


def test_what_cannot_be_followed_is_rejected(session, scene):
    wrong = {
        "an unknown joint": dict(names=("x", "knee"), rows=[START[:2]], times=[2.0]),
        "too fast": dict(rows=[(50.0, *START[1:])], times=[1.0]),
        "no points": dict(rows=[], times=[]),
        "a tolerance of another joint": dict(rows=[START], times=[2.0], goal=[("knee", 1.0)]),
        "a component on the way": dict(rows=[START], times=[2.0], path_components=["base"]),
        "a component at the end": dict(rows=[START], times=[2.0], goal_components=["base"]),
        "a negative tolerance": dict(rows=[START], times=[2.0], path=[("x", -2.0)]),
    }
    with served(session, scene) as door:
        backend = door.backend
        for count, (name, goal) in enumerate(wrong.items(), 1):
            assert not send(backend, count, **goal), name
            backend.step()
            assert backend.diagnostics()["refused_messages"] == str(count), name
        assert backend.diagnostics()["command"] == "plan"
        box, there = begin_result(backend, 1)
        assert there.wait(10)
        assert read_result(box).status == 0  # unknown
        box, there = backend.begin_call(f"{ROOT}/get_result", b"\x00")
        assert there.wait(10)
        assert send(backend, 20, [START], [2.0])
        assert not send(backend, 20, [START], [2.0])  # its number is taken
    (result,) = door.results
    assert result.refused == len(wrong) + 2


def test_tolerances_of_the_goal_are_judged(session, scene):
    """The water at 0.11 m/s pushes: nobody keeps a path to a millimetre, nor its end."""
    for path, goal, code in (([("x", 1e-3)], [], -4), ([], [("y", 1e-5)], -5)):
        with served(session, scene) as door:
            backend = door.backend
            ahead = (-2.0, *START[1:])
            assert send(backend, 1, [ahead], [4.0], path=path, goal=goal, goal_time_s=1)
            box, event = begin_result(backend, 1)
            step_until(backend, event)
            result = read_result(box)
            assert (result.status, result.error_code) == (ABORTED, code)
            assert (path or goal)[0][0] in result.error_string
            held = position(backend)
            backend.step(60)
            assert np.linalg.norm(position(backend) - held) < 0.4


def test_a_reset_and_the_end_answer_those_who_wait(session, scene):
    with served(session, scene) as door:
        backend = door.backend
        send(backend, 1, [START], [9.0])
        first, reset = begin_result(backend, 1)
        backend.step()
        backend.call("/reset")
        assert reset.wait(10)
        assert read_result(first).status == ABORTED
        send(backend, 2, [START], [9.0])
        last, ended = begin_result(backend, 2)
        backend.step()
    assert ended.wait(10)
    assert read_result(last).status == ABORTED
