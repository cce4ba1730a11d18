"""A planner that learned from plans: flow matching draws ways, closed forms choose among them."""
