"""One world planned in this process, so that a debugger reaches the planner's code."""

from angler_mjx.errors import ConfigError
from angler_mjx.planning import answers
from angler_mjx.planning.planner import NoPlan, Path, PathShape
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.simulator.world_preparation import check_key_number
from angler_mjx.scenario.scenario import Scenario


def plan_in_process(scenario: Scenario, world: int) -> list[Path | NoPlan]:
    """Return what a planner of the host answers in one world; nothing it raises is caught.

    No deadline ends it.

    Args:
        scenario: with its planner.
        world: index.

    Raises:
        ConfigError: the planner is one of the device, or there is no such world.
    """
    check_key_number("--debug", world)
    spec = scenario.planner.planner_spec()
    if spec.reference.on_device or not callable(getattr(spec.reference.load(), "plan", None)):
        raise ConfigError(
            f"--debug: planner {spec.reference.name} is part of the program that samples the "
            "worlds; only a class with plan(problem) can be debugged"
        )
    single_world = scenario.model_copy(update={"tile": 1})
    simulator = Simulator(single_world, paths=PathShape(points=2))
    problem = simulator.problems(world, 1)[0]
    return answers.check_paths(spec.make().plan(problem), problem, scenario.planner.points)
