"""`angler tune`: gains tuned on thousands of flights."""

import sys
from pathlib import Path
from typing import Annotated, Literal

import tyro

from angler_mjx.cli.shared.device import Device, choose_device
from angler_mjx.cli.shared.progress import ProgressBar


def tune(
    scenario: Annotated[str, tyro.conf.Positional],
    controller: str,
    objective: Literal["ise", "energy", "robust"],
    out: Path | None = None,
    rollouts: int = 480,
    generations: int = 40,
    seed: int = 0,
    method: Literal["gradient", "cma"] | None = None,
    resume: bool = False,
    device: Device | None = None,
) -> None:
    """Tune the gains of a controller on the robots of a scenario.

    Steps, station keeping and a figure of eight are flown in open water, in sampled currents, with
    masses that differ from the model. The folder holds gains.toml, a table for scenarios, a report
    with figures and, for ardusub, parameter files for ground stations.

    Args:
        scenario: Name of a shipped scenario, or path of a scenario file (.toml).
        controller: Name of the controller, as in scenarios.
        objective: ise (error of pose), energy (error of pose and energy per distance), or robust
            (worst tenth, failures and oscillation).
        out: Folder to make; runs/tune-CONTROLLER-OBJECTIVE if left out.
        rollouts: Flights of each candidate; the same number of others is held out.
        generations: Generations of the search: 8 or more candidates each for cma, one for gradient.
        seed: Seed of the flights and of the search.
        method: Search method; if left out, gradient for ise and energy of controllers that do not
            switch, else cma.
        resume: Continue an interrupted tuning in the same folder, with the same arguments.
        device: Device to compute on; JAX's choice if left out.
    """
    choose_device(device)
    from angler_mjx.scenario.scenario import load_scenario
    from angler_mjx.studies.tuning import problem
    from angler_mjx.studies.tuning import tune as tuning

    loaded = load_scenario(scenario)
    problem.spec_of(loaded, controller)
    settings = problem.TuningSettings(
        scenario=loaded,
        controller=controller,
        objective=objective,
        method=method or problem.method_of(objective, controller),
        rollouts=rollouts,
        generations=generations,
        seed=seed,
    )
    out_path = out or Path("runs") / f"tune-{controller}-{objective}"
    with ProgressBar() as bar:
        result = tuning.tune(settings, out_path, bar, resume=resume)
    print(
        f"objective, 1 before: {result.train.cost:.3f} on the flights tuned on, "
        f"{result.held_out.cost:.3f} on others"
    )
    for knob, value in zip(result.problem.knobs, result.turns, strict=True):
        for name, before, after in zip(knob.gains, knob.start, knob.values(value), strict=True):
            print(f"  {knob.stage}.{name}: {before:g} -> {after:g}")
    print(out_path)
    if not result.complete:
        print("interrupted: go on with --resume", file=sys.stderr)
        sys.exit(130)
