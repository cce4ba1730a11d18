"""Control laws of users' files: flown on both engines, refused with the reason."""

from pathlib import Path

import jax
import numpy as np
import pytest

from angler_mjx.cli.main import main
from angler_mjx.errors import ConfigError
from angler_mjx.robot.control import stages
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.storage.folder import Run, read_scenario
from angler_mjx.scenario.scenario import load_scenario

LAW = """
from dataclasses import dataclass

import jax.numpy as jnp

from angler_mjx.robot.control.commands import BodyTwist, BodyWrench
from angler_mjx.robot.control.laws import velocity

@dataclass(frozen=True)
class VelocityGains:
    velocity_per_s: float = velocity.VelocityGains().velocity_per_s
    rate_per_s: float = velocity.VelocityGains().rate_per_s

class Copied:
    takes, gives, Gains = (BodyTwist,), BodyWrench, VelocityGains

    def reset(self, estimate):
        return velocity.reset(estimate)

    def step(self, gains, carry, inputs, command):
        made = velocity.VelocityGains(**vars(gains))
        return velocity.step(
            made, inputs.params.vehicle_model, carry, inputs.estimate, command, inputs.dt,
            inputs.density, inputs.gravity,
        )

class Summing:
    takes, gives = (BodyTwist,), BodyWrench

    def step(self, gains, carry, inputs, command):
        return carry, BodyWrench(tau=jnp.cumsum(command.nu))

class Sorting(Summing):
    def step(self, gains, carry, inputs, command):
        return carry, BodyWrench(tau=jnp.sort(command.nu))

class Solving(Summing):
    def step(self, gains, carry, inputs, command):
        mass = inputs.params.vehicle_model.M_A
        return carry, BodyWrench(tau=jnp.linalg.solve(mass, command.nu))

class Empty:
    pass

class Guess(Summing):
    gives = float

class Needy(Summing):
    @dataclass
    class Gains:
        slope: float
"""

SCENARIO = """
schema_version = 1
name = "mine"
engine = "{engine}"
worlds = 1
tile = 1

[time]
horizon_s = 60.0

[world]
preset = "open"
placement = "random"

[[fleet]]
vehicle = "bluerov2_heavy"
parameter_set = "wu2018"

[controller]
stages = ["follow", "pose", "{law}", "pseudo_inverse"]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("laws")
    (path / "laws").mkdir()
    (path / "laws" / "mine.py").write_text(LAW)
    return path


def write(folder, law, engine="fused", gains=""):
    text = SCENARIO.format(engine=engine, law=law) + gains
    file = folder / f"{law.rpartition(':')[2]}_{engine}.toml"
    file.write_text(text)
    return file


@pytest.fixture(scope="module")
def worlds(folder):
    """The same for all laws and engines: compiled once."""
    return Simulator(load_scenario(write(folder, "velocity"))).worlds()


@pytest.mark.parametrize("engine", ["fused", "mjx"])
def test_a_law_that_copies_one_flies_as_it(folder, worlds, engine):
    flown = []
    for law in ("velocity", "laws/mine.py:Copied"):
        simulator = Simulator(load_scenario(write(folder, law, engine)))
        state, sample = simulator.segment(worlds, simulator.reset(worlds))
        assert np.linalg.norm(state.vehicles.nu) > 0.05
        flown.append((state.vehicles, sample.pwm_us))
    jax.tree.map(np.testing.assert_array_equal, *flown)


def test_a_run_keeps_the_law_that_it_was_flown_with(folder, tmp_path):
    scenario, out = write(folder, "laws/mine.py:Copied"), tmp_path / "run"
    main(["rollout", str(scenario), "--out", str(out), "--no-figures"])
    assert Run(out).summary["complete"]
    file = folder / "laws" / "mine.py"
    file.write_text(LAW.replace("class Copied", "class Renamed"))
    try:
        (name,) = (x for x in read_scenario(out).controller.stages if x.endswith(":Copied"))
    finally:
        file.write_text(LAW)
    assert name.startswith(str(out))
    assert read_scenario(out).controller.title == "follow+pose+Copied+pseudo_inverse"


def test_gains_stand_under_the_name_of_the_class(folder):
    gains = "[controller.gains.Copied]\nrate_per_s = 3.0\n"
    scenario = load_scenario(write(folder, "laws/mine.py:Copied", gains=gains))
    _, made = scenario.controller.stack()
    assert made[2].rate_per_s == 3.0
    assert jax.tree.leaves(made[2])[1] == 3.0
    with pytest.raises(ConfigError, match=r"gains\.Copied\.slope = 1: unknown gain"):
        load_scenario(
            write(
                folder, "laws/mine.py:Copied", gains=gains.replace("rate_per_s = 3.0", "slope = 1")
            )
        )


@pytest.mark.parametrize(
    ("law", "operation"), [("Summing", "cumsum"), ("Sorting", "sort"), ("Solving", "lu")]
)
def test_an_operation_that_the_fused_engine_has_no_rule_for_is_named(folder, law, operation):
    simulator = Simulator(load_scenario(write(folder, f"laws/mine.py:{law}")))
    message = rf"mine\.py:\d+.*no rule for {operation}; take engine = \"mjx\""
    with pytest.raises(ConfigError, match=message):
        simulator.compile()
    other = Simulator(load_scenario(write(folder, f"laws/mine.py:{law}", "mjx")))
    worlds = other.world_shape()
    jax.eval_shape(lambda worlds: other.step(worlds, other.reset(worlds)), worlds)


def test_the_law_of_contributing_flies(folder, worlds):
    text = (Path(__file__).parents[4] / "CONTRIBUTING.md").read_text()
    code = text.partition("## Add a control law")[2].partition("```python\n")[2]
    (folder / "laws" / "damped.py").write_text(code.partition("```")[0])
    gains = "gains = { Damped = { slope_ns_per_m = 60.0 } }\n"
    assert gains in text
    simulator = Simulator(load_scenario(write(folder, "laws/damped.py:Damped", gains=gains)))
    state, _ = simulator.step(worlds, simulator.reset(worlds))
    assert np.all(np.isfinite(state.carry.stages[2]))
    assert simulator.spec.gains[2].slope_ns_per_m == 60.0


@pytest.mark.parametrize(
    ("law", "reason"),
    [
        ("laws/mine.py:Absent", "holds no class 'Absent'"),
        ("laws/none.py:Law", "cannot be read"),
        ("laws/mine.py:Empty", "has no takes and no gives and no step"),
        ("laws/mine.py:Guess", "gives <class 'float'>, which is no command"),
        ("laws/mine.py:Needy", "each of its Gains has to have a default"),
        ("nowhere", "unknown 'nowhere'; there is follow, .* FILE.py:CLASS"),
    ],
)
def test_what_is_no_law_is_refused(folder, law, reason):
    with pytest.raises(ConfigError, match=reason):
        load_scenario(write(folder, law))


def test_a_law_is_loaded_once_for_each_text(folder):
    name = f"{folder}/laws/mine.py:Copied"
    assert stages.find_stage(name) is stages.find_stage(name)
    file = folder / "laws" / "mine.py"
    before = stages.find_stage(name)
    file.write_text(LAW + "\n# edited\n")
    assert stages.find_stage(name) is not before
    file.write_text(LAW)
    assert stages.find_stage(name) is before
