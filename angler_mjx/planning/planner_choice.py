"""The planner `auto`: grid for small teams, priority for larger ones, carry for cargo."""

AUTO = "auto"
"""Value of ``planner.name`` that leaves the choice to the number of robots."""

AUTO_PLANNERS = ("grid", "priority")
"""Planners of small and of large teams."""

CARRY = "carry"
"""Planner of a team that carries one body."""

LARGE_TEAM = 8
"""Smallest team that priority plans; measured in `docs/reference/planners.md`."""


def choose_planner(robots: int, *, carries: bool = False) -> str:
    """Return the name of the planner of a team of ``robots``, which may carry one body."""
    if carries:
        return CARRY
    return AUTO_PLANNERS[robots >= LARGE_TEAM]
