"""What is recorded: the declarations. That engines give it is asked where they fly (`declared`)."""

from dataclasses import fields
from types import SimpleNamespace

import numpy as np

from angler_mjx.sim import record, step
from angler_mjx.sim.record import Sample


def test_every_field_of_a_sample_is_declared():
    declared = {one.path[0] for one in record.FIELDS}
    assert declared == {one.name for one in fields(Sample)}
    names = [one.about.array for one in record.FIELDS]
    assert len(set(names)) == len(names)


def test_phases_are_in_order_and_read_what_was_given_before():
    assert {one.about.phase for one in record.FIELDS} <= {*step.PHASES, "sample"}
    phases = (step.DECIDE, step.MOVE, step.OBSTACLES, step.JUDGE)
    assert tuple(phase.name for phase in phases) == step.PHASES[4:]
    constants = {"params", "command", "current", "flow", "goal_m", "contact", "finished"}
    constants |= {"fails_at_s", "approach", "corners", "joints", "grip", "actuators"}
    constants |= {"reaching", "impacts"}
    there = {"estimate", *(one.name for one in fields(step.RobotState))}
    for phase in (step.DECIDE, step.MOVE, step.JUDGE):
        assert {one.name for one in fields(phase.takes)} - constants <= there, phase.name
        there |= {one.name for one in fields(phase.gives)}


def test_what_is_kept_once_more_after_the_last_sample_is_the_state():
    names = {one.about.array for one in record.STATE_FIELDS}
    obstacles, joints = {"obstacle_p_m", "obstacle_q"}, {"joint_position", "joint_velocity"}
    assert names == {"p_m", "q", "nu", "outcome"} | obstacles | joints


def test_a_field_is_found_along_its_path():
    belief = SimpleNamespace(p=np.ones(3))
    inner = next(one for one in record.FIELDS if one.about.array == "estimate/p_m")
    assert inner.of(SimpleNamespace(belief=belief)) is belief.p
    assert inner.of(SimpleNamespace(belief=None)) is None
