"""Lines that a run begins with: planner and order by auto, and who steers without information."""

from angler_mjx.scenario.scenario import Scenario


def lines(scenario: Scenario, *, planned: bool = True, commanded: bool = False) -> list[str]:
    """Return the lines that a run of a scenario begins with.

    Args:
        scenario: of the run.
        planned: whether the scenario's planner makes the plans.
        commanded: whether a policy of the caller's commands the robots.
    """
    said = [
        planner(scenario) if planned else None,
        None if commanded else order(scenario),
        blind(scenario),
    ]
    return [line for line in said if line]


def planner(scenario: Scenario) -> str | None:
    """Return a line on the planner that auto resolved to; None where the file names one."""
    if not scenario.planner.by_auto:
        return None
    return f"planner: {scenario.planner.title(sum(entry.count for entry in scenario.fleet))}"


def order(scenario: Scenario) -> str | None:
    """Return a line on the order of passing where auto keeps it; None where it does not."""
    if not scenario.keeps_order_by_auto:
        return None
    return f"order: kept (auto: {sum(entry.count for entry in scenario.fleet)} robots)"


def blind(scenario: Scenario) -> str | None:
    """Return a line on a scenario that steers in flight without information about moving obstacles.

    Args:
        scenario: of a run that begins.

    Returns:
        One line for a policy, or for plans made anew in flight; None where nothing moves, nothing
        steers in flight, or moving obstacles are known.
    """
    replan_hz, policy = scenario.planner.replan_hz, scenario.policy
    if policy.name != "none":
        knows = policy.knows or scenario.planner.knows
        who = f"policy {policy.name} flies blind"
    elif replan_hz > 0.0:
        knows, who = scenario.planner.knows, f"planner.replan_hz = {replan_hz:g} plans blind"
    else:
        return None
    if knows.obstacles != "nothing" or not scenario.obstacles_move:
        return None
    return f"{who}: it has no information about obstacles that move; add --knows obstacles=observed"
