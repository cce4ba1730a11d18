"""Planning of one world in this process, so that a debugger reaches the planner's code."""

from angler_mjx.errors import ConfigError
from angler_mjx.planning import answers
from angler_mjx.planning.planner import NoPlan, Path, PathShape
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.simulator.world_preparation import check_key_number
from angler_mjx.scenario.scenario import Scenario


def plan_in_process(scenario: Scenario, world: int) -> list[Path | NoPlan]:
    """Return the answer of a host planner in one world; its exceptions are not caught.

    There is no time limit.

    Args:
        scenario: scenario with a planner.
        world: index of the world.

    Raises:
        ConfigError: the planner runs on the device, or the world does not exist.
    """
    check_key_number("--debug", world)
    spec = scenario.planner.planner_spec()
    if not callable(getattr(spec.reference.load(), "plan", None)):
        raise ConfigError(
            f"--debug: planner {spec.reference.name} is part of the program that samples the "
            "worlds; only a class with plan(problem) can be debugged"
        )
    single_world = scenario.model_copy(update={"tile": 1})
    simulator = Simulator(single_world, paths=PathShape(points=2))
    problem = simulator.problems(world, 1)[0]
    return answers.check_paths(spec.make().plan(problem), problem, scenario.planner.points)
