"""Evaluation of the learned planner by whole flights in worlds outside the training set.

    python -m angler_experiments.learned_planner.evaluate arrivals --worlds 128
    python -m angler_experiments.learned_planner.evaluate samples --worlds 128
    python -m angler_experiments.learned_planner.evaluate curve --out runs/curve

Rows: ``straight`` flies the straight line; ``drawn`` the first path that the network samples,
unchecked; ``learned`` is the shipped planner; ``noise`` repairs smooth noise instead of the
network's paths, to separate learning from repair; ``grid`` and ``priority`` search.
"""

import tyro

from angler_experiments.learned_planner.evaluate.arrivals import evaluate_arrivals, evaluate_samples
from angler_experiments.learned_planner.evaluate.curve import evaluate_curve

tyro.extras.subcommand_cli_from_dict(
    {"arrivals": evaluate_arrivals, "curve": evaluate_curve, "samples": evaluate_samples}
)
