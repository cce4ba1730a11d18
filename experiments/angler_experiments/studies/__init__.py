"""Studies that ship: how many robots a task takes."""
