"""Torpedoes on their way: lines are held by rudder and stern planes, missed goals are met again."""

import jax
import numpy as np
import pytest
from pydantic import ValidationError

from angler_mjx.robot.control import allocation
from angler_mjx.robot.control.commands import BodyWrench, ThrusterPwm
from angler_mjx.robot.vehicles import library, params
from angler_mjx.runs.session.batch_session import BatchSession
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.state import Outcome

SPEED = 1.5
START, GOAL = np.array([-50.0, -20.0, -30.0]), np.array([50.0, 20.0, -10.0])
FLIGHT = {
    "name": "line",
    "engine": "fused",
    "worlds": 1,
    "tile": 1,
    "goal_tolerance_m": 2.0,
    "time": {"horizon_s": 100.0, "record_hz": 5.0},
    "water": {"density_kgpm3": 1030.0},
    "controller": {"name": "los"},
    "world": {
        "preset": "open",
        "shape": [12, 12, 4],
        "cell_m": 10.0,
        "placement": "given",
        "start_m": [START.tolist()],
        "goal_m": [GOAL.tolist()],
    },
    "fleet": [{"vehicle": "remus100", "cruise_speed_mps": SPEED}],
}


def fly(**changes):
    """Positions [T, 3] of one robot, its signals [T, 3], and its last outcome and time."""
    simulator = Simulator(Scenario.model_validate({**FLIGHT, **changes}))
    worlds = simulator.worlds(first=0, seed=0)
    state = simulator.reset(worlds)
    parts = []
    while sum(map(len, parts)) < 500:
        state, samples = simulator.segment(worlds, state)
        parts.append(
            np.concatenate([np.asarray(samples.p), np.asarray(samples.pwm_us)], 3)[0, :, 0]
        )
    p, pwm = np.split(np.concatenate(parts), 2, axis=1)
    tally = jax.device_get(state.tally)
    return p, pwm, Outcome(int(tally.outcome[0, 0])), float(tally.end_time_s[0, 0])


def test_a_line_that_climbs_is_held():
    p, pwm, outcome, end_s = fly()
    assert outcome == Outcome.REACHED
    p, pwm = p[: int(5 * end_s)], pwm[: int(5 * end_s)]
    line = (GOAL - START) / np.linalg.norm(GOAL - START)
    along = (p - START) @ line
    across = np.linalg.norm(p - START - along[:, None] * line, axis=1)
    # It starts at rest and level, and sinks until there is way on.
    assert across[along > 25.0].max() < 1.0
    speed = np.linalg.norm(np.diff(p[100:], axis=0), axis=1) * 5.0
    assert np.abs(speed - SPEED).max() < 0.1
    # Settled fins are not at their ends.
    assert np.abs(pwm[150:, 1:] - 1500.0).max() < 300.0
    length = np.linalg.norm(GOAL - START) - 2.0
    assert end_s == pytest.approx(length / SPEED, rel=0.1)


def test_a_goal_beside_the_bow_is_met_on_the_way_back():
    """Nearer than the radius of a turn, in a current: it is passed by, and met after a loop."""
    start, goal = [0.0, 0.0, -20.0], [8.0, 0.0, -20.0]
    world = {**FLIGHT["world"], "start_m": [start], "goal_m": [goal]}
    current = {"currents": [{"type": "uniform", "velocity_mps": [0.0, 0.4, 0.0]}]}
    p, _, outcome, end_s = fly(world={**world, **current}, goal_tolerance_m=1.0)
    assert outcome == Outcome.REACHED
    away = np.linalg.norm(p[: int(5 * end_s)] - goal, axis=1)
    first = int(np.argmin(away[:100]))
    assert away[first] > 2.0
    assert away[first:].max() > 12.0


def test_controllers_that_hover_are_refused_by_name():
    with pytest.raises(ValidationError, match=r"'cascade' steers by thrust.*'remus100'.*los"):
        Scenario.model_validate({**FLIGHT, "controller": {"name": "cascade"}})


def test_fins_are_deflected_by_moment_over_dynamic_pressure():
    fleet = params.stack_vehicles(
        [params.build_vehicle(library.load_vehicle("remus100"), None, 16)]
    )
    fins = jax.tree.map(lambda leaf: leaf[0], allocation.build_allocation(fleet).fins)
    still = ThrusterPwm(pwm_us=np.full(3, 1500.0))
    yaw = BodyWrench(tau=np.array([0, 0, 0, 0, 0, 1.0]))

    def rudder_us(speed):
        pwm = allocation.deflect_fins(fins, yaw, np.float32(speed), 1030.0, still).pwm_us
        assert pwm[0] == 1500.0
        assert pwm[2] == pytest.approx(1500.0, abs=1e-3)
        return float(pwm[1]) - 1500.0

    # N = -0.638 Y, Y = 9.64 u^2 delta at 1030 kg/m^3; positive deflections push to the left.
    delta = -1.0 / (0.638 * 9.64 * 2.0**2)
    assert rudder_us(2.0) == pytest.approx(400.0 * delta / 0.26, rel=1e-3)
    assert rudder_us(-2.0) == pytest.approx(-rudder_us(2.0), rel=1e-5)
    assert rudder_us(0.0) == 0.0
    assert abs(rudder_us(0.02)) < abs(rudder_us(0.2))


def test_a_session_names_fins_behind_thrusters_and_knows_their_turn():
    info = BatchSession(Scenario.model_validate(FLIGHT)).robots[0]
    assert info.thrusters == ("propeller", "rudder", "stern_plane")
    # Full rudder at 2.57 m/s against N_rr alone.
    moment = 0.638 * 9.64 * 2.57**2 * 0.26
    assert info.max_turn_radps == pytest.approx(np.sqrt(moment / 94.0), rel=0.01)
