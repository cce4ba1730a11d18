"""Hold the simulator against the recordings of the Hinsdale campaign.

    python -m angler_experiments.validate_hinsdale --data FOLDER --out runs/hinsdale

Reads the campaign's files, scores predictions without simulation, published parameter sets and an
identified set, and writes ``results.json`` and figures of all runs. Progress goes to stderr.
"""

import argparse
from pathlib import Path

from angler_experiments.validate_hinsdale.study import StudySettings, run_study
from angler_mjx.progress import ProgressLines


def main() -> None:
    """Run the study of the command line."""
    parser = argparse.ArgumentParser(description="The simulator against motion capture.")
    parser.add_argument("--data", type=Path, required=True, help="folder of the campaign's files")
    parser.add_argument("--out", type=Path, default=Path("runs/hinsdale"))
    parser.add_argument("--samples", type=int, default=100, help="bootstrap samples; 0: no fit")
    parser.add_argument("--iterations", type=int, default=12, help="steps of each fit")
    parser.add_argument("--refits", action="store_true", help="fit each sample anew; for a GPU")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    settings = StudySettings(
        samples=arguments.samples,
        iterations=arguments.iterations,
        refits=arguments.refits,
        seed=arguments.seed,
    )
    print(run_study(arguments.data, arguments.out, settings, ProgressLines()))


if __name__ == "__main__":
    main()
