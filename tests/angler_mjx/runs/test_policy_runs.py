"""Runs that a policy flies: from the simulator to the run folder, and on after an interruption."""

import json
import shutil
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.progress import Progress
from angler_mjx.robot.control.commands import Estimate, ThrusterPwm
from angler_mjx.runs.folder_setup import require_same_scenario
from angler_mjx.runs.rollout import resume, rollout
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.storage.folder import Run
from angler_mjx.runs.storage.output_lock import partial_path
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.sim.policy import Policy

SCENARIO = """
schema_version = 1
name = "signals"
worlds = 3
seed = 3
tile = 1

[time]
horizon_s = 2.0
record_hz = 5.0

[world]
preset = "open"
placement = "parallel"

[[fleet]]
vehicle = "bluerov2"
parameter_set = "blue_gazebo"
count = 2
"""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Signals(Policy):
    """Signals that tell robots apart, and worlds by their keys."""

    pwm_us: Any = 1520.0

    def reset(self, known, key):
        return jnp.round(100.0 * jax.random.uniform(key))

    def act(self, carry, known, key, step):
        robots, thrusters = known.goal_m.shape[0], known.params.vehicle.B.shape[-1]
        each = self.pwm_us + carry + jnp.arange(robots)[:, None]
        return carry, ThrusterPwm(pwm_us=jnp.broadcast_to(each, (robots, thrusters)))


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Hears(Policy):
    """Commands what no stage takes."""

    def act(self, carry, known, key, step):
        belief = known.belief
        return carry, Estimate(p=belief.p, q=belief.q, nu=belief.nu)


@pytest.fixture(scope="module")
def scenario(tmp_path_factory):
    path = tmp_path_factory.mktemp("scenario") / "signals.toml"
    path.write_text(SCENARIO)
    return load_scenario(path)


@pytest.fixture(scope="module")
def simulator(scenario):
    return Simulator(scenario, policy=Signals())


@pytest.fixture(scope="module")
def run(scenario, simulator, tmp_path_factory):
    return rollout(scenario, out=tmp_path_factory.mktemp("runs") / "run", simulator=simulator)


def luck(run):
    """[world] what each world's key drew."""
    keys = (jax.random.fold_in(jax.random.key(3), world) for world in range(3))
    of_policy = (jax.random.fold_in(jax.random.fold_in(key, 3), 2**32 - 1) for key in keys)
    return np.round([100.0 * float(jax.random.uniform(key)) for key in of_policy])


def test_worlds_of_a_run_draw_from_their_own_keys(run):
    pwm = np.asarray(run.trajectories["pwm_us"][:, :, :, 0])
    wanted = 1520 + luck(run)[:, None, None] + np.arange(2)
    np.testing.assert_array_equal(pwm, np.broadcast_to(wanted, pwm.shape))
    assert len(set(luck(run))) == 3


def test_the_run_says_which_policy_it_had(run):
    said = json.loads((run.path / "policy.json").read_text())
    assert said["class"].endswith("test_policy_runs.Signals")
    assert len(said["sha256"]) == 64


class Stopping(Progress):
    """Interrupts after the first tile."""

    def advance(self, worlds, vehicle_steps):
        self.seen = getattr(self, "seen", 0.0) + worlds
        if self.seen > 1.5:
            raise KeyboardInterrupt


def test_an_interrupted_run_goes_on_with_its_policy_alone(scenario, simulator, run, tmp_path):
    out = tmp_path / "run"
    half = rollout(scenario, out=out, simulator=simulator, progress=Stopping())
    assert not half.summary["complete"]
    text = (out / "policy.json").read_text()
    other = Simulator(scenario, policy=Signals(pwm_us=1530.0))
    with pytest.raises(ConfigError, match=r"policy\.json.*Signals of other numbers"):
        resume(out, simulator=other)
    assert Run(out).summary == half.summary  # what is refused keeps its name
    assert not partial_path(out).exists()
    (out / "policy.json").write_text(text[:20])
    with pytest.raises(ConfigError, match=r"policy\.json: cannot be read"):
        resume(out, simulator=simulator)
    (out / "policy.json").write_text(text)
    whole = resume(out, simulator=simulator)
    np.testing.assert_array_equal(
        np.asarray(whole.trajectories["p_m"]), np.asarray(run.trajectories["p_m"])
    )
    shutil.rmtree(out)


@pytest.mark.parametrize(
    "flags",
    [
        {"planner": {"replan_hz": 1.0, "information": {"obstacles": "observed"}}},
        {"planner": {"name": "priority"}},
        {"execution": {"order": "kept"}},
        {"policy": {"name": "mppi"}},
        {"time": {"record_hz": 1.0}},
    ],
    ids=str,
)
def test_a_run_that_flags_began_is_not_taken_for_an_edited_scenario(flags, tmp_path):
    file = tmp_path / "signals.toml"
    file.write_text(SCENARIO.replace("horizon_s = 2.0", "horizon_s = 3.0"))
    begun = load_scenario(file, **flags)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "config.json").write_text(begun.model_dump_json())
    require_same_scenario(tmp_path / "run", load_scenario(file))
    for edited in ({"goal_tolerance_m": 0.1}, {"planner": {"margin_m": 0.2}}):
        with pytest.raises(ConfigError, match=f"was edited since.*{next(iter(edited))}"):
            require_same_scenario(tmp_path / "run", load_scenario(file, **edited))


def test_other_numbers_are_flown_without_compiling(simulator):
    worlds = simulator.worlds(0)
    _, sample = simulator.segment(worlds, simulator.reset(worlds))
    compiled = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, *_, **__: compiled.append(event) if "backend_compile" in event else None
    )
    _, louder = simulator.segment(
        worlds, simulator.reset(worlds), policy=Signals(pwm_us=np.float32(1540.0))
    )
    assert compiled == []
    np.testing.assert_allclose(louder.pwm_us - sample.pwm_us, 20.0)


def test_another_kind_of_policy_is_refused(simulator, scenario):
    worlds = simulator.worlds(0)
    with pytest.raises(ConfigError, match="policy Hears: is made otherwise"):
        simulator.reset(worlds, policy=Hears())
    with pytest.raises(ConfigError, match="policy Signals: the simulator was made without one"):
        Simulator(scenario).reset(worlds, policy=Signals())


def test_a_command_that_no_stage_takes_is_refused_and_leaves_nothing(scenario, tmp_path):
    with pytest.raises(ConfigError, match="policy Hears: command Estimate: no stage"):
        rollout(scenario, out=tmp_path / "run", policy=Hears())
    assert list(tmp_path.iterdir()) == []
