"""Step one scene by hand: a robot by velocities, the others by their plans, and back to the plan.

The same interface drives real ArduSub processes (docs/how_to/sitl.md).
"""

import numpy as np

import angler_mjx as angler


def main(steps: int = 40) -> tuple[float, list[str]]:
    """Return how far [m] the commanded robot rose, and what each robot followed; then robot 0."""
    session = angler.BatchSession("open_water_current", world=1)
    before = session.reset()
    up = angler.BodyTwist(nu=np.array([0.0, 0.0, 0.2, 0.0, 0.0, 0.0]))  # m/s: forward, left, up

    seen = session.step({0: up})
    for _ in range(steps - 1):
        seen = session.step()  # the last command continues
    rose_m = float(seen.estimate.p[0, 2] - before.estimate.p[0, 2])

    commands = [status.command for status in seen.status]
    print(f"{rose_m:.2f} m up in {steps * session.dt_s:g} s; robots follow {commands}")
    session.resume_plan(0)
    commands.append(session.step().status[0].command)
    print(f"robot 0 then follows its {commands[-1]}")
    session.close()
    return rose_m, commands


if __name__ == "__main__":
    main()
