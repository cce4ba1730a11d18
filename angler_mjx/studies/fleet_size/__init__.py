"""How many robots a task takes: the smallest team that meets a deadline, with its interval."""
