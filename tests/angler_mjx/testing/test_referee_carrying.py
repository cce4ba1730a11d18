"""The referee's judgement of carrying and contact, on flights known in closed form."""

import numpy as np
import pytest
import zarr
from scipy.spatial.transform import Rotation

from angler_mjx.testing import referee

from .hand_made import DT_S, OUTCOMES, Ball, Flight, edit_array, edit_rows, row, write

STEPS, SPEED_MPS, TURN_RADPS = 100, 0.2, 0.1
START_M = np.array([-2.0, 0.0, -6.0])
OFFSETS_M = np.array([[1.0, 0.0, 0.4], [-1.0, 0.0, 0.4]])
TOLERANCE_M, TOLERANCE_DEG = 0.1, 2.0
TURN_DEG = float(np.degrees(TURN_RADPS * 4.0))
"""Of the body at its goal, which it would pass after 4 s."""
FAR_M = [START_M[0] + SPEED_MPS * 4.0, 0.0, -6.0]
PWM_W = 12.8
FORCE_N = 9.0


def first_arrival():
    """Return the control steps after which the body is at its goal, by distance and by angle."""
    time_s = DT_S * np.arange(STEPS + 1)
    near = np.abs(4.0 - time_s) * SPEED_MPS < TOLERANCE_M
    level = np.abs(4.0 - time_s) * TURN_RADPS < np.radians(TOLERANCE_DEG)
    return int(np.flatnonzero(near & level)[0])


ARRIVAL = first_arrival()


def build(ends, task=None, **more):
    """Return a flight in which a body moves and turns evenly, and two robots with it.

    Args:
        ends: outcome and last state of each robot.
        task: further keys of the table.
        more: of the flight.
    """
    time_s = DT_S * np.arange(STEPS + 1)
    turn = Rotation.from_rotvec(TURN_RADPS * time_s[:, None] * [0.0, 0.0, 1.0])
    body = START_M + SPEED_MPS * time_s[:, None] * [1.0, 0.0, 0.0]
    q = turn.as_quat(scalar_first=True)
    p = np.stack([body + turn.apply(offset) for offset in OFFSETS_M], axis=1)
    nu = np.zeros((STEPS + 1, 2, 6))
    nu[1:, :, 0] = SPEED_MPS
    attitude = np.repeat(q[:, None], 2, axis=1)
    outcome = np.zeros((STEPS + 1, 2), int)
    rows = []
    for robot, (name, end) in enumerate(ends):
        if name != "timeout":
            outcome[end:, robot] = OUTCOMES[name]
        if name not in ("timeout", "reached"):
            p[end:, robot], attitude[end:, robot] = p[end, robot], attitude[end, robot]
            nu[end + 1 :, robot] = 0.0
        ways = np.linalg.norm(np.diff(p[: end + 1, robot], axis=0), axis=1)
        rows.append(
            row(
                name,
                end * DT_S,
                p[end, robot],
                energy_j=8 * PWM_W * end * DT_S,
                path_length_m=float(np.sum(ways)),
                min_clearance_m=0.0,
                min_separation_m=0.0,
                passed_goal_early=False,
                impact_energy_j=0.0,
                contact_depth_m=0.0,
                grip_force_n=FORCE_N,
                internal_force_n=1.0,
                cargo_distance_m=float(abs(4.0 - DT_S * end) * SPEED_MPS),
                cargo_angle_rad=float(abs(4.0 - DT_S * end) * TURN_RADPS),
            )
        )
    table = {
        "type": "carry",
        "body": 0,
        "to_m": FAR_M,
        "turn_deg": TURN_DEG,
        "tolerance_m": TOLERANCE_M,
        "tolerance_deg": TOLERANCE_DEG,
        "break_force_n": 50.0,
        "hold": "hull",
        "hold_s": 0.0,
        "max_slip_m": 0.05,
        "closing_force_n": None,
        **(task or {}),
    }
    return Flight(
        p=p,
        nu=nu,
        q=attitude,
        pwm=np.full((STEPS, 2, 8), 1600.0),
        outcome=outcome,
        goal=p[-1],
        rows=rows,
        balls=(Ball(tuple(START_M), r_m=0.05, v_mps=(SPEED_MPS, 0.0, 0.0)),),
        obstacle_p=body[:, None],
        obstacle_q=q[:, None],
        task=table,
        config={"contacts": True, "contact": {"damage_energy_j": 10.0}},
        **more,
    )


WANTED = (
    "outcome",
    "end_time_s",
    "cargo_distance_m",
    "cargo_angle_rad",
    "grip_force_n",
    "internal_force_n",
    "grip",
    "impact_energy_j",
    "failure_pair",
    "record",
)


def disagreements(path):
    """Return the quantities of each robot that do not agree, less those that are no part of it."""
    verdict = referee.judge(path)
    found = {(one.robot, one.quantity) for one in verdict.differences if one.quantity in WANTED}
    return found, verdict


BOTH = [("reached", ARRIVAL)] * 2


def test_arrival_is_recomputed_from_the_poses_of_the_body(tmp_path):
    found, verdict = disagreements(write(tmp_path / "run", build(BOTH)))
    assert found == set()
    assert verdict.counts["outcome"].exact == 2
    for name in ("cargo_distance_m", "cargo_angle_rad", "grip"):
        assert verdict.counts[name].exact == 2
    for name in ("grip_force_n", "internal_force_n", "impact_energy_j"):
        assert verdict.counts[name].bounded == 2


@pytest.mark.parametrize("shift", [-1, 1])
def test_an_arrival_a_step_off_is_found(tmp_path, shift):
    late = [("reached", ARRIVAL + shift)] * 2
    found, _ = disagreements(write(tmp_path / "run", build(late)))
    assert {(0, "outcome"), (1, "outcome")} <= found


def test_the_body_has_to_stay_for_as_long_as_the_file_says(tmp_path):
    held = {"hold_s": 4 * DT_S}
    late = [("reached", ARRIVAL + 3)] * 2
    assert disagreements(write(tmp_path / "late", build(late, held)))[0] == set()
    assert (0, "outcome") in disagreements(write(tmp_path / "run", build(BOTH, held)))[0]


def test_the_body_of_a_timeout_has_never_been_at_its_goal(tmp_path):
    never = [("timeout", STEPS)] * 2
    missed = {"to_m": [FAR_M[0], 1.0, -6.0]}
    path = write(tmp_path / "never", build(never, missed))
    for robot in range(2):
        away = np.hypot(SPEED_MPS * (STEPS * DT_S - 4.0), 1.0)
        edit_rows(path, 0, robot, cargo_distance_m=float(away))
    assert disagreements(path)[0] == set()
    found, _ = disagreements(write(tmp_path / "run", build(never)))
    assert {(0, "outcome"), (1, "outcome")} <= found


@pytest.mark.parametrize(
    ("change", "quantity"),
    [
        ({"cargo_distance_m": 0.2}, "cargo_distance_m"),
        ({"cargo_angle_rad": 0.0}, "cargo_angle_rad"),
        ({"grip_force_n": 51.0}, "grip_force_n"),
        ({"internal_force_n": 20.0}, "internal_force_n"),
        ({"impact_energy_j": 11.0}, "impact_energy_j"),
        ({"failure_pair": "obstacle:0"}, "failure_pair"),
    ],
)
def test_results_that_cannot_be_are_found(tmp_path, change, quantity):
    path = write(tmp_path / "run", build(BOTH))
    edit_rows(path, 0, 1, **change)
    assert disagreements(path)[0] == {(1, quantity)}


def test_a_robot_that_lost_the_body_bore_more_than_its_grip(tmp_path):
    ends = [("dropped", 40), ("timeout", STEPS)]
    missed = {"to_m": [FAR_M[0], 1.0, -6.0]}
    path = write(tmp_path / "run", build(ends, missed))
    for robot, end in enumerate((40, STEPS)):
        away = np.hypot(SPEED_MPS * (end * DT_S - 4.0), 1.0)
        edit_rows(path, 0, robot, cargo_distance_m=float(away))
    found, verdict = disagreements(path)
    assert found == {(0, "grip_force_n")}
    edit_rows(path, 0, 0, grip_force_n=50.5)
    found, verdict = disagreements(path)
    assert found == set()
    assert (verdict.counts["outcome"].bounded, verdict.counts["outcome"].exact) == (1, 1)


def test_a_body_that_cannot_be_lost_is_not_dropped(tmp_path):
    path = write(tmp_path / "run", build([("dropped", 40)] * 2, {"break_force_n": None}))
    assert {(0, "outcome"), (1, "outcome")} <= disagreements(path)[0]


def test_a_body_that_slips_out_of_a_weld_is_found(tmp_path):
    path = write(tmp_path / "run", build(BOTH))
    edit_array(path, "p_m", (0, slice(30, 40), 1, 2), lambda z: z + 0.004)
    assert (1, "grip") in disagreements(path)[0]
    loose = {"closing_force_n": 40.0, "break_force_n": None}
    path = write(tmp_path / "jaws", build(BOTH, loose))
    edit_array(path, "p_m", (0, slice(30, 40), 1, 2), lambda z: z + 0.004)
    assert (1, "grip") not in disagreements(path)[0]


def test_forces_are_bounded_by_the_recorded_ones(tmp_path):
    path = write(tmp_path / "run", build(BOTH))
    wrench = np.zeros((1, STEPS, 2, 6), np.float32)
    wrench[0, 20, 0, 1] = FORCE_N + 1.0
    wrench[0, 20, 1, 4] = 100.0  # a moment is no force
    group = zarr.open_group(path / "trajectories.zarr", mode="r+")
    group.create_array("grips/wrench", data=wrench)
    assert disagreements(path)[0] == {(0, "grip_force_n")}


def test_sparse_samples_bound_the_outcome(tmp_path):
    path = write(tmp_path / "run", build(BOTH), every=4)
    found, verdict = disagreements(path)
    assert found == set()
    assert verdict.conclusion == "inconclusive"
    early = [("reached", 20)] * 2
    found, _ = disagreements(write(tmp_path / "early", build(early), every=4))
    assert (0, "outcome") in found


def test_a_touch_ends_nothing_where_bodies_push_each_other(tmp_path):
    """The robots fly through a ball, whose touch has to be in the results."""
    balls = (
        Ball(tuple(START_M), r_m=0.05, v_mps=(SPEED_MPS, 0.0, 0.0)),
        Ball(tuple(START_M + OFFSETS_M[0] + [0.3, 0.0, 0.0]), r_m=0.1),
    )
    flight = build(BOTH)
    p = np.stack([flight.obstacle_p[:, 0], np.tile(balls[1].p_m, (STEPS + 1, 1))], axis=1)
    q = np.stack([flight.obstacle_q[:, 0], np.tile([1.0, 0, 0, 0], (STEPS + 1, 1))], axis=1)
    flight = Flight(**{**vars(flight), "balls": balls, "obstacle_p": p, "obstacle_q": q})
    path = write(tmp_path / "run", flight)
    assert disagreements(path)[0] == {(0, "failure_pair")}
    edit_rows(path, 0, 0, failure_pair="obstacle:1", impact_speed_mps=0.2, impact_energy_j=1.0)
    assert disagreements(path)[0] == set()


def test_who_takes_hold_in_flight_brings_the_body_from_then_on(tmp_path):
    """Robot 0 comes down to the body in 1 s; robot 1 never closes its gripper."""
    fetched = {"approach": {"above_m": 1.0}}
    flight = build([("reached", ARRIVAL), ("timeout", STEPS)], fetched)
    down = np.clip(1.0 - 0.05 * np.arange(STEPS + 1), 0.0, None)
    flight.p[:, 0, 2] += down
    ways = np.linalg.norm(np.diff(flight.p[: ARRIVAL + 1, 0], axis=0), axis=1)
    flight.rows[0] |= {"path_length_m": float(np.sum(ways)), "gripped_s": 20 * DT_S}
    flight.rows[1] |= {"gripped_s": np.nan}
    path = write(tmp_path / "run", flight)
    assert disagreements(path)[0] == set()
    # It held the body before it was there.
    edit_rows(path, 0, 0, gripped_s=10 * DT_S)
    assert disagreements(path)[0] == {(0, "grip")}
    # It had not taken hold when it arrived.
    edit_rows(path, 0, 0, gripped_s=(ARRIVAL + 1) * DT_S)
    assert (0, "outcome") in disagreements(path)[0]
    edit_rows(path, 0, 0, gripped_s=20 * DT_S)
    # Who holds the body when it arrives is no timeout.
    edit_rows(path, 0, 1, gripped_s=20 * DT_S)
    assert (1, "outcome") in disagreements(path)[0]
