"""Workloads of `angler bench`, and their medians compared with stored ones of the same card."""

import json
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

SIZES = {"dynamics": 65536}
"""Worlds in one call where they differ from `WORLDS`."""
WORLDS = 1024
COMPILED_SCENARIO = {"cpu": "open_water_current", "gpu": "reef_fleet"}
"""Scenario that ``compile`` compiles; its row is of all programs, with an empty cache."""
CPU_WORLDS = 2
"""Worlds on a CPU, where only the script itself is tested."""
MAX_LOSS = 0.10
"""Loss of a rate beyond which it counts as slower."""
HOST = ("processor", "cpu_count")
"""Properties of the host that compile seconds depend on beside the card."""
STORED = Path(__file__).parents[2] / "benchmarks" / "gpu_medians.json"


def measure_workload(workload: str) -> dict[str, Any]:
    """Measure one workload of `angler bench` to its end.

    Returns:
        The first row as a mapping, with the host's processor and number of cores.

    Raises:
        RuntimeError: the workload was refused.
    """
    import jax

    from angler_mjx.runs.provenance import describe_environment
    from angler_mjx.studies.speed.measured import measuring
    from angler_mjx.studies.speed.workloads import SpeedRequest, build_cases

    backend = jax.default_backend()
    is_cpu = backend == "cpu"
    worlds = CPU_WORLDS if is_cpu else SIZES.get(workload, WORLDS)
    robots = (1,) if is_cpu else ()
    with tempfile.TemporaryDirectory() as folder:
        request = SpeedRequest(
            workloads=(workload,),
            scenarios=(COMPILED_SCENARIO[backend],) if workload == "compile" else (),
            worlds=(worlds,),
            robots=robots,
            folder=Path(folder),
        )
        row, *_ = measuring.measure_cases(build_cases(request), lambda case: None)
    if row.refused is not None:
        raise RuntimeError(row.refused)
    about = describe_environment()
    return asdict(row) | {name: about[name] for name in HOST}


def run_to_end(workload: str) -> dict[str, np.ndarray]:
    """Run a workload to its end in parallel with others, without measuring its rate."""
    row = measure_workload(workload)
    return {"has_number": np.array([row["median"] > 0])}


def read_medians(device: str, path: Path = STORED) -> dict[str, dict[str, Any]]:
    """Read the medians of a card by workload; empty where none are stored."""
    if not path.is_file():
        return {}
    medians: dict[str, dict[str, Any]] = json.loads(path.read_text()).get(device, {})
    return medians


def write_medians(device: str, rows: dict[str, dict[str, Any]], path: Path = STORED) -> None:
    """Write medians of a card by workload, beside those of other cards and workloads."""
    medians = json.loads(path.read_text()) if path.is_file() else {}
    medians[device] = {**medians.get(device, {}), **rows}
    path.write_text(json.dumps(medians, indent=2, sort_keys=True) + "\n")


def judge_rate(row: dict[str, Any], reference: dict[str, Any] | None) -> tuple[str, str]:
    """Return a status, ``passed``, ``slower`` or ``skipped``, and its reason.

    Args:
        row: measured row.
        reference: stored row of the same card and workload, if any.
    """
    is_duration = row["unit"] == "s"
    rate = f"{row['median']:.1f} s" if is_duration else f"{row['median']:.3e} {row['unit']}"
    if reference is None:
        return "skipped", f"{rate}; no median of this card is stored: --store writes it"
    compared = ("worlds", "robots", "unit", *(HOST if is_duration else ()))
    different = [name for name in compared if row[name] != reference[name]]
    if different:
        return "skipped", f"{rate}; the stored median has another {', '.join(different)}"
    ratio = row["median"] / reference["median"]
    if is_duration:
        ratio = 1.0 / ratio
    stored = f"{reference['median']:.3e} ({reference['date']}, {reference['commit']})"
    comparison = f"{ratio:.3f} of the speed of {stored}"
    return ("slower" if ratio < 1.0 - MAX_LOSS else "passed"), f"{rate}, {comparison}"
