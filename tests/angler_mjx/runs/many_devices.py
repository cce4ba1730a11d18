"""Runs the same scenario on some devices; a process of its own, for they are forced.

Arguments: scenario file, folder for the runs, numbers of devices.
"""

import gc
import sys
from pathlib import Path

from angler_mjx.errors import ConfigError
from angler_mjx.runs.rollout import rollout
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import load_scenario


def main(scenario_file, out, counts):
    gc.set_threshold(100_000, 20, 20)  # tracing makes millions of objects that stay
    scenario = load_scenario(scenario_file)
    for devices in counts:
        simulator = Simulator(scenario, devices=devices)
        rollout(scenario, out=out / f"{devices}_devices", chunk=100, simulator=simulator)
    try:
        Simulator(scenario, devices=9)
    except ConfigError as error:
        print(error, file=sys.stderr)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), [int(n) for n in sys.argv[3:]])
