"""Fixed split of the runs into those that identify parameters and those that judge them."""

from collections.abc import Sequence


def trajectory_of(stem: str) -> str:
    """Return the commanded trajectory of a run: its stem without repetition."""
    return stem.removeprefix("traj").removesuffix("-test").rsplit("-", 1)[0]


def training_stems(stems: Sequence[str]) -> list[str]:
    """Return the stems of the training half: every other trajectory, in the order of names.

    All runs of one trajectory are in one half, so that no motion of the arm is in both.
    """
    trajectories = sorted({trajectory_of(stem) for stem in stems})
    chosen = set(trajectories[::2])
    return [stem for stem in stems if trajectory_of(stem) in chosen]
