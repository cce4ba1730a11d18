"""Commands about planners: plans, problems, and planners against each other."""
