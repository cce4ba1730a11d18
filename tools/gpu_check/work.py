"""Computation in a separate process: ``python -m tools.gpu_check.work NAME OUT``."""

import importlib
import json
import sys
from pathlib import Path

NEEDED = ("mujoco.mjx", "pytest")
"""Modules that only some checks import: a machine without them is refused before the first
check."""


def main(name: str, out: Path) -> None:
    """Compute a check on JAX's default device, or describe that device.

    Args:
        name: name of a check, ``rate/WORKLOAD``, or ``about``.
        out: file to write: arrays of a check (.npz), JSON of the others.
    """
    if name == "about":
        for module in NEEDED:
            importlib.import_module(module)
        from angler_mjx.runs.provenance import describe_environment
        from angler_mjx.studies.speed.roofline import read_driver_version

        out.write_text(json.dumps({**describe_environment(), "driver": read_driver_version()}))
        return
    if name.startswith("rate/"):
        from tools.gpu_check.workloads import measure_workload

        out.write_text(json.dumps(measure_workload(name.removeprefix("rate/"))))
        return
    import numpy as np

    from tools.gpu_check.checks import CHECKS

    np.savez(out, **CHECKS[name].run())


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
