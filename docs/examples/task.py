"""Give the team one task: look at a reef until most of it has been seen; compare two team sizes.

Tasks: survey, tour, delivery, carrying (docs/reference/tasks.md).
"""

from pathlib import Path

import angler_mjx as angler


def main(out: Path = Path("runs"), seconds: float = 30.0) -> dict[int, float]:
    """Return the mean fraction of the reef that teams of three and of four have seen."""
    seen = {}
    for robots in (3, 4):
        scenario = angler.load_scenario(
            "reef_survey",
            worlds=4,
            engine="fused",
            fleet=[{"vehicle": "bluerov2_heavy", "count": robots}],
            time={"horizon_s": seconds},
        )
        run = angler.rollout(scenario, out=out / f"survey_{robots}")
        progress = run.episodes["task_progress"].to_numpy()  # a row of each robot, of its world
        seen[robots] = float(progress.mean())
        print(f"{robots} robots: {seen[robots]:.0%} seen in {seconds:g} s")
    return seen


if __name__ == "__main__":
    main()
