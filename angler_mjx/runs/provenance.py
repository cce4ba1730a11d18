"""Provenance of results: versions, device, machine, commit and command of this process."""

import os
import platform
import resource
import shlex
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import jax

from angler_mjx._version import __version__
from angler_mjx.errors import ConfigError
from angler_mjx.runs.storage import folder
from angler_mjx.runs.storage.atomic_files import write_json
from angler_mjx.runs.storage.parallel import cpu_count
from angler_mjx.runs.storage.read_errors import read_table
from angler_mjx.sim import policy as policies
from angler_mjx.sim.policy import Policy


def describe_environment() -> dict[str, Any]:
    """Return versions, device, machine, commit and command of this process."""
    packages = ("jax", "jaxlib", "mujoco", "mujoco-mjx", "numpy", "zarr", "pyarrow")
    device = jax.devices()[0]
    return {
        "versions": {
            "angler-mjx": __version__,
            **{name: _package_version(name) for name in packages},
        },
        "python": platform.python_version(),
        "platform": platform.platform(),
        "processor": processor_name(),
        "cpu_count": cpu_count(),
        "xla_flags": os.environ.get("XLA_FLAGS", ""),
        "backend": device.platform,
        "device": device.device_kind,
        "device_count": jax.device_count(),
        "commit": _read_commit(),
        "command": shlex.join(["angler", *sys.argv[1:]]),
    }


def processor_name() -> str:
    """Return the model name of the processor; empty where the system does not say."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            lines = [line for line in file if line.startswith("model name")]
    except OSError:
        return ""
    return lines[0].partition(":")[2].strip() if lines else ""


def peak_memory_bytes() -> int:
    """Return the largest resident size of this process so far, bytes of host memory."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _package_version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _read_commit() -> str | None:
    """Return the commit of this checkout, marked if changed; None outside a checkout.

    ``ANGLER_COMMIT`` stands for it where it is set: a copied tree has no history.
    """
    if commit_override := os.environ.get("ANGLER_COMMIT"):
        return commit_override
    git = ["git", "-C", str(Path(__file__).parent)]
    try:
        commit = subprocess.run(
            [*git, "rev-parse", "HEAD"], capture_output=True, text=True, check=True, timeout=10
        ).stdout.strip()
        changed_files = subprocess.run(
            [*git, "status", "--porcelain", "--untracked-files=no"],
            capture_output=True,
            text=True,
            check=True,
            timeout=10,
        ).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return None
    return f"{commit}-changed" if changed_files else commit


def write_policy(building: Path, policy: Policy | None) -> None:
    """Say in a new run which policy commands its robots, if one does."""
    if policy is not None:
        write_json(building / folder.POLICY, policies.describe_policy(policy))


def require_policy(building: Path, policy: Policy | None) -> None:
    """Refuse to go on with a run under another policy than its own.

    Raises:
        ConfigError: it was begun with another one, or what says so is damaged.
    """
    path = building / folder.POLICY
    stored = read_table(path) if path.exists() else None
    current = None if policy is None else policies.describe_policy(policy)
    if stored != current:
        stored_class, current_class = (
            "no policy" if description is None else str(description.get("class"))
            for description in (stored, current)
        )
        suffix = " of other numbers" if stored_class == current_class else ""
        raise ConfigError(
            f"{path}: the run was begun with {stored_class} and is to go on with "
            f"{current_class}{suffix}; "
            "give the policy that it was begun with"
        )
