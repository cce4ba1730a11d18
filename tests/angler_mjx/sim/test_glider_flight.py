"""Gliders on their way: a line is held by a sawtooth in depth, judged again by the referee."""

import jax
import jax.numpy as jnp
import numpy as np
import pyarrow.parquet as pq
import pytest
import zarr
from pydantic import ValidationError

from angler_mjx.robot.control.commands import Estimate
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.laws import glide
from angler_mjx.robot.vehicles import library, params
from angler_mjx.runs.rollout import rollout
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.testing import referee

START, GOAL = np.array([-60.0, -20.0, -30.0]), np.array([40.0, 30.0, -30.0])
FLIGHT = {
    "name": "line",
    "engine": "fused",
    "worlds": 1,
    "tile": 1,
    "goal_tolerance_m": 4.0,
    "time": {"horizon_s": 400.0, "record_hz": 5.0, "physics_dt_s": 0.04, "control_dt_s": 0.2},
    "water": {"density_kgpm3": 1025.0},
    "controller": {"name": "glide"},
    "world": {
        "preset": "open",
        "shape": [12, 12, 4],
        "cell_m": 20.0,
        "placement": "given",
        "start_m": [START.tolist()],
        "goal_m": [GOAL.tolist()],
    },
    "fleet": [{"vehicle": "seawing", "cruise_speed_mps": 0.3}],
}


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    folder = tmp_path_factory.mktemp("glide") / "run"
    rollout(Scenario.model_validate(FLIGHT), out=folder)
    return folder


def test_a_line_is_held_by_a_sawtooth(flown):
    row = pq.read_table(flown / "episodes.parquet").to_pylist()[0]
    assert row["outcome"] == "reached"
    group = zarr.open_group(flown / "trajectories.zarr", mode="r")
    names = [name for name, _ in group.arrays()]
    (p_name,) = [name for name in names if name.endswith("p_m") and "obstacle" not in name]
    p = np.asarray(group[p_name])[0, : int(5 * row["time_to_goal_s"]), 0]
    line = (GOAL - START)[:2] / np.linalg.norm((GOAL - START)[:2])
    across = (p[:, :2] - START[:2]) @ [-line[1], line[0]]
    assert np.abs(across).max() < 0.5
    # Down first, and up and down again, over the band, which narrows at the end.
    turns = np.flatnonzero(np.diff(np.sign(np.diff(p[::5, 2]))))
    assert len(turns) >= 3
    assert np.ptp(p[:, 2]) > 1.5 * 8.0
    assert np.abs(p[:, 2] - START[2]).max() < 8.0 + 2.0
    # A steady glide goes over ground at 0.4 to 0.5 m/s; a litre at 40 W and 40 ml/s is a stroke.
    ahead = np.linalg.norm(p[-1, :2] - p[200, :2]) / (0.2 * (len(p) - 201))
    assert 0.3 < ahead < 0.55
    assert 500.0 * len(turns) < row["energy_j"] < 2000.0 * (len(turns) + 1)


def test_the_referee_recomputes_it(flown):
    verdict = referee.judge(flown)
    assert [one.line() for one in verdict.differences if one.result == "disagrees"] == []
    assert verdict.counts["outcome"].exact == 1
    assert verdict.counts["energy_j"].largest < 1e-3


def test_controllers_and_vehicles_that_do_not_fit_are_refused_by_name():
    with pytest.raises(ValidationError, match=r"'cascade' needs thrust.*'seawing'.*glide"):
        Scenario.model_validate({**FLIGHT, "controller": {"name": "cascade"}})
    fleet = [{"vehicle": "bluerov2_heavy"}]
    with pytest.raises(ValidationError, match=r"'glide' flies vehicles without thrust.*heavy"):
        Scenario.model_validate({**FLIGHT, "fleet": fleet})


def signals(position, yaw_rad, *, sinks):
    """Signals of the tank, the battery along and the battery aside, on a line to the east."""
    vehicle = params.build_vehicle(library.load_vehicle("seawing"), None, 16.0)
    estimate = Estimate(
        p=jnp.asarray(position),
        q=jnp.array([np.cos(yaw_rad / 2), 0.0, 0.0, np.sin(yaw_rad / 2)]),
        nu=jnp.array([0.4, 0.0, 0.0, 0.0, 0.0, 0.0]),
    )
    path = Trajectory(
        time_s=jnp.array([0.0, 1000.0, 1000.0]),
        position_m=jnp.array([[0.0, 0.0, -30.0], [400.0, 0.0, -30.0], [400.0, 0.0, -30.0]]),
        found=jnp.array(True),
    )
    carry = glide.GlideCarry(
        segment=jnp.zeros((), jnp.int32), sinks=jnp.asarray(sinks), integral=jnp.zeros(())
    )
    gains = glide.GlideGains()
    step = jax.jit(glide.step, static_argnums=(5, 6, 7))
    carry, pwm = step(gains, vehicle, carry, estimate, path, 0.1, 1025.0, 9.81)
    return bool(carry.sinks), np.asarray(pwm.pwm_us) - 1500.0


def test_it_changes_over_at_the_ends_of_its_band():
    for depth, before, after in (
        (-37.0, True, True),
        (-38.5, True, False),
        (-25.0, False, False),
        (-21.5, False, True),
    ):
        sinks, pwm = signals([100.0, 0.0, depth], 0.0, sinks=before)
        assert sinks == after
        # Sinking its tank fills and its battery runs ahead; rising the other way round.
        assert pwm[0] == (400.0 if after else -400.0)
        assert np.sign(pwm[1]) == np.sign(pwm[0])
    # Two metres before the end the band is a metre.
    assert not signals([398.0, 0.0, -31.5], 0.0, sinks=True)[0]
    # It does not rise on purpose above six metres, even of a path that is there.
    assert signals([100.0, 0.0, -5.0], 0.0, sinks=False)[0]


@pytest.mark.parametrize("sinks", [True, False])
def test_the_battery_goes_to_the_other_side_of_the_turn(sinks):
    """As the paper's spiral: to the left it turns the glider to the right."""
    assert signals([100.0, 0.0, -30.0], 0.3, sinks=sinks)[1][2] > 0.0
    assert signals([100.0, 0.0, -30.0], -0.3, sinks=sinks)[1][2] < 0.0
    # Left of the path it turns to the right.
    assert signals([100.0, 20.0, -30.0], 0.0, sinks=sinks)[1][2] > 0.0
