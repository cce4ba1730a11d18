"""Connection to a Ray cluster that a user started, and the versions on its machines."""

import hashlib
import logging
import os
import re
import subprocess
import sys
import sysconfig
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from angler_mjx.errors import ConfigError, UnsupportedError, format_value

if TYPE_CHECKING:
    from ray.actor import ActorHandle

HEALTH_TIMEOUT_S = 20.0
"""Time limit [s] of the answer of a head."""

VERSION_TIMEOUT_S = 120.0
"""Time limit [s] of a machine's answer with its versions."""

PACKAGE_FOLDER = Path(__file__).parents[3]
"""Folder of the package."""

LIBRARIES = ("numpy", "jax", "jaxlib", "ompl", "numba", "coal", "pin")
"""Distributions of which another version may give other plans."""

SHARED_PREFIXES = ("JAX_", "XLA_", "NUMBA_")
"""Beginnings of environment variables that may change plans; all machines receive them."""


class Cluster:
    """A cluster that this process has joined.

    Attributes:
        ray: the module.
        processors: of all its machines that take work.
    """

    ray: ModuleType
    processors: int

    def __init__(self, address: str) -> None:
        """Join the cluster.

        A process is in one cluster at a time; one that the process had joined before stays joined.

        Args:
            address: HOST:PORT of its head.

        Raises:
            ConfigError: no head answers, or its machines have other versions installed.
            UnsupportedError: Ray is not installed.
        """
        self._address = address
        self._has_joined = False
        self._versions = installed_versions()
        self.ray = _import_ray()
        self._join()
        try:
            self.processors = int(self.ray.cluster_resources().get("CPU", 0))
            self._environment = {"env_vars": _actor_environment()}
            self._check_all_machines()
        except BaseException:
            self.leave()
            raise

    def leave(self) -> None:
        """Leave the cluster, unless the process had joined it before."""
        if self._has_joined:
            self._has_joined = False
            self.ray.shutdown()
            self._log_worker_deaths(True)

    def create_actor(self, actor_class: type, *arguments: object) -> "ActorHandle":
        """Return an actor that will hold a processor, as soon as one is free.

        Args:
            actor_class: its class.
            arguments: of its constructor.
        """
        remote_class = self.ray.remote(
            num_cpus=1,
            max_restarts=0,
            max_task_retries=0,
            max_concurrency=2,
            scheduling_strategy="SPREAD",
            runtime_env=self._environment,
        )(actor_class)
        return remote_class.remote(*arguments)

    def check_versions(self, versions: dict[str, str], machine: str) -> None:
        """Compare versions with those of this machine.

        Raises:
            ConfigError: they differ.
        """
        differing = format_differences(versions, self._versions)
        if differing:
            raise ConfigError(
                f"{machine} of the Ray cluster at {self._address} would plan with other versions: "
                f"{differing}; install the same on all machines"
            )

    def _join(self) -> None:
        address, ray = self._address, self.ray
        if not re.fullmatch(r"[^\s/:]+:\d{1,5}", address):
            raise ConfigError(
                f"{format_value(address)} is no address of a Ray cluster; give HOST:PORT as "
                "`ray start --head` prints it"
            )
        if ray.is_initialized():
            joined = ray.get_runtime_context().gcs_address
            if joined != address:
                raise ConfigError(
                    f"this process is in the Ray cluster at {joined}, not {address}; give that "
                    "address, or leave it by ray.shutdown() first"
                )
            return
        _check_health(address)
        try:
            ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
        except (OSError, RuntimeError, ValueError, ray.exceptions.RayError) as error:
            ray.shutdown()
            raise ConfigError(
                f"the Ray cluster at {address} cannot be joined from here: {_last_line(error)}"
            ) from error
        self._has_joined = True
        self._log_worker_deaths(False)

    def _log_worker_deaths(self, is_enabled: bool) -> None:
        """Set whether Ray prints the death of every process; Ray has no option for it."""
        self.ray._private.worker._worker_logs_enabled = is_enabled

    def _check_all_machines(self) -> None:
        """Check the versions of every machine that takes work."""
        ray = self.ray
        strategies = ray.util.scheduling_strategies
        pending = {}
        for node in ray.nodes():
            if node["Alive"] and node["Resources"].get("CPU", 0) > 0:
                strategy = strategies.NodeAffinitySchedulingStrategy(node["NodeID"], soft=False)
                remote = ray.remote(num_cpus=0, max_retries=0, runtime_env=self._environment)(
                    installed_versions
                ).options(scheduling_strategy=strategy)
                pending[f"machine {node['NodeManagerAddress']}"] = remote.remote()
        if not pending:
            raise ConfigError(f"no machine of the Ray cluster at {self._address} has a processor")
        for machine, answer in pending.items():
            try:
                self.check_versions(ray.get(answer, timeout=VERSION_TIMEOUT_S), machine)
            except ray.exceptions.RayError as error:
                raise ConfigError(
                    f"{machine} of the Ray cluster at {self._address} cannot plan; "
                    f"install angler-mjx there as it is here: {_last_line(error)}"
                ) from error


def _import_ray() -> Any:
    """Return the module; under ``uv run`` it must not copy the working directory to machines."""
    os.environ.setdefault("RAY_ENABLE_UV_RUN_RUNTIME_ENV", "0")
    try:
        import ray
        import ray.util.scheduling_strategies
    except ModuleNotFoundError as error:
        raise UnsupportedError(
            f"planning on a cluster needs {error.name}: pip install 'angler-mjx[ray]'"
        ) from error
    return ray


def _check_health(address: str) -> None:
    """Check a head's health in another process, as Ray ends a process that it cannot connect."""
    command = [sys.executable, "-m", "ray.scripts.scripts", "health-check", "--address", address]
    path = os.pathsep.join(entry or os.getcwd() for entry in sys.path)
    try:
        completed = subprocess.run(
            command,
            env={**os.environ, "PYTHONPATH": path},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=HEALTH_TIMEOUT_S,
            check=False,
        )
        if completed.returncode == 0:
            return
        reason = (
            completed.stderr.decode(errors="replace").strip().splitlines() or ["it is not well"]
        )[-1]
    except subprocess.TimeoutExpired:
        reason = f"nothing came within {HEALTH_TIMEOUT_S:g} s"
    raise ConfigError(
        f"no Ray cluster answers at {address} ({reason}); start one by `ray start --head`, and "
        "give "
        "the address that it prints"
    )


def _actor_environment() -> dict[str, str]:
    """Return the environment of actors: this process's modules, and no accelerator.

    A machine skips paths that it does not have; its own paths follow.
    """
    library_folders = [
        sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")
    ]
    path = [
        entry
        for entry in (entry or os.getcwd() for entry in sys.path)
        if Path(entry).is_dir()
        and not any(Path(entry).is_relative_to(folder) for folder in library_folders)
    ]
    shared = {name: value for name, value in os.environ.items() if name.startswith(SHARED_PREFIXES)}
    return {
        "XLA_FLAGS": "",
        **shared,
        "JAX_PLATFORMS": "cpu",
        "PYTHONPATH": os.pathsep.join([*path, "${PYTHONPATH}"]),
    }


def _last_line(error: BaseException) -> str:
    """Return the last line of an exception's text, the useful one where Ray repeats a traceback."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1] if lines else type(error).__name__


def installed_versions() -> dict[str, str]:
    """Return versions by name; that of this package holds a digest of its files too."""
    digest = hashlib.sha256()
    for file in sorted(PACKAGE_FOLDER.rglob("*.py")):
        digest.update(str(file.relative_to(PACKAGE_FOLDER)).encode() + b"\0" + file.read_bytes())
    package_version = f"{_installed_version('angler-mjx')} ({digest.hexdigest()[:12]})"
    return {"angler_mjx": package_version, **{name: _installed_version(name) for name in LIBRARIES}}


def format_differences(remote: dict[str, str], local: dict[str, str]) -> str:
    """Return the differences for a message; empty if there are none."""
    return "; ".join(
        f"{name} {remote.get(name, 'missing')} there, {local_version} here"
        for name, local_version in local.items()
        if remote.get(name) != local_version
    )


def _installed_version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "missing"
