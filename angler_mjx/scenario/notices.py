"""Lines at the start of a run: choices by auto, and steering without obstacle information."""

from angler_mjx.scenario.scenario import Scenario


def run_notices(
    scenario: Scenario, *, uses_planner: bool = True, is_commanded: bool = False
) -> list[str]:
    """Return the lines that a run of a scenario prints at its start.

    Args:
        scenario: of the run.
        uses_planner: whether the scenario's planner makes the plans.
        is_commanded: whether a policy of the caller commands the robots.
    """
    notices = [
        planner_notice(scenario) if uses_planner else None,
        None if is_commanded else order_notice(scenario),
        missing_information_notice(scenario),
    ]
    return [line for line in notices if line]


def planner_notice(scenario: Scenario) -> str | None:
    """Return a line on the planner that auto resolved to; None where the file names one."""
    if not scenario.planner.by_auto:
        return None
    return f"planner: {scenario.planner.title(sum(entry.count for entry in scenario.fleet))}"


def order_notice(scenario: Scenario) -> str | None:
    """Return a line on the order of passing where auto keeps it; None where it does not."""
    if not scenario.keeps_order_by_auto:
        return None
    return f"order: kept (auto: {sum(entry.count for entry in scenario.fleet)} robots)"


def missing_information_notice(scenario: Scenario) -> str | None:
    """Return a line on a scenario that steers in flight without information about moving obstacles.

    Args:
        scenario: of a run that begins.

    Returns:
        One line for a policy, or for plans made anew in flight; None where nothing moves, nothing
        steers in flight, or moving obstacles are known.
    """
    replan_hz, policy = scenario.planner.replan_hz, scenario.policy
    if policy.name != "none":
        information = policy.information or scenario.planner.information
        subject = f"policy {policy.title} flies blind"
    elif replan_hz > 0.0:
        information, subject = (
            scenario.planner.information,
            f"planner.replan_hz = {replan_hz:g} plans blind",
        )
    else:
        return None
    if information.obstacles != "nothing" or not scenario.obstacles_move:
        return None
    return (
        f"{subject}: it has no information about obstacles that move; "
        "add --information obstacles=observed"
    )
