"""Place and time of a measurement, as shown beside the numbers of the page."""

import os
from typing import Any


def describe_host() -> dict[str, Any]:
    """Return versions, machine and commit of this process, and its rounding or test settings."""
    from angler_mjx.runs.provenance import describe_environment

    environment = describe_environment()
    machine = ("platform", "processor", "cpu_count", "backend", "device")
    keys = ("versions", "python", "xla_flags", "commit", *machine)
    return {
        **{name: environment[name] for name in keys},
        "ardusub": "ANGLER_ARDUSUB" in os.environ,
    }


def format_provenance(about: dict[str, Any]) -> str:
    """Return one sentence: place, date and commit of a measurement."""
    where = about["device"] if about["backend"] != "cpu" else about.get("processor") or "CPU"
    cores = f", {about['cpu_count']} cores" if about["backend"] == "cpu" else ""
    jax = about["versions"].get("jax")
    commit = str(about["commit"] or "unknown")
    changed = " and changes that were not committed" if commit.endswith("-changed") else ""
    flags = f", `XLA_FLAGS={about['xla_flags']}`" if about.get("xla_flags") else ""
    return (
        f"{about['at_utc'][:10]}, {where}{cores}, jax {jax}, "
        f"commit {commit.removesuffix('-changed')[:9]}{changed}{flags}"
    )
