"""The planner `auto`: grid for small teams, priority for larger ones."""

AUTO = "auto"
"""Value of ``planner.name`` that leaves the choice to the number of robots."""

AUTO_PLANNERS = ("grid", "priority")
"""Planners of small and of large teams."""

LARGE_TEAM = 8
"""Smallest team that priority plans; measured in `docs/reference/planners.md`."""


def choose_planner(robots: int) -> str:
    """Return the name of the planner of a team of ``robots``."""
    return AUTO_PLANNERS[robots >= LARGE_TEAM]
