"""What the learned planner is worth: whole flights in worlds that nobody learned from.

    python -m angler_experiments.learned_planner.evaluate arrivals --worlds 128
    python -m angler_experiments.learned_planner.evaluate samples --worlds 128
    python -m angler_experiments.learned_planner.evaluate curve --out runs/curve

Rows: ``straight`` flies the straight line; ``drawn`` the first way that the network draws, not
checked; ``learned`` is the planner as it comes; ``noise`` is the same repair of smooth noise
instead of the network's ways, so that what is learned can be told from what is repaired; ``grid``
and ``priority`` search.
"""

import tyro

from angler_experiments.learned_planner.evaluate.arrivals import evaluate_arrivals, evaluate_samples
from angler_experiments.learned_planner.evaluate.curve import evaluate_curve

tyro.extras.subcommand_cli_from_dict(
    {"arrivals": evaluate_arrivals, "curve": evaluate_curve, "samples": evaluate_samples}
)
