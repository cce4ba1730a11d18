"""A Ray cluster that somebody started: joining it, and leaving it as it was."""

import logging
import os
import re
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Any

from angler_mjx.errors import ConfigError, UnsupportedError, format_value
from angler_mjx.planning.host.cluster.versions import format_differences, installed_versions

HEALTH_TIMEOUT_S = 20.0
"""Within which a head has to answer."""

VERSION_TIMEOUT_S = 120.0
"""Within which a machine of the cluster has to say what is installed there."""

SHARED_PREFIXES = ("JAX_", "XLA_", "NUMBA_")
"""Beginnings of environment variables that may change plans, and are the same everywhere."""


class Cluster:
    """A cluster that this process has joined.

    Attributes:
        ray: the module.
        processors: of all its machines that take work.
    """

    ray: Any
    processors: int

    def __init__(self, address: str) -> None:
        """Joins it.

        A process is in one cluster at a time: who has called ``ray.init`` stays joined by `leave`.

        Args:
            address: HOST:PORT of its head.

        Raises:
            ConfigError: nobody answers there, or its machines have other versions installed.
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
        """Leaves it, unless somebody else had joined it before."""
        if self._has_joined:
            self._has_joined = False
            self.ray.shutdown()
            self._log_worker_deaths(True)

    def create_actor(self, actor_class: type, *arguments: Any) -> Any:
        """An actor that holds a processor, as soon as there is one.

        Args:
            actor_class: its class.
            arguments: what it is made of.
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
        """Compares what is installed.

        Raises:
            ConfigError: it differs.
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
        """Whether Ray prints of every process of the cluster that dies; it has no option for it."""
        self.ray._private.worker._worker_logs_enabled = is_enabled

    def _check_all_machines(self) -> None:
        """Asks every machine that takes work what is installed there."""
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
    """The module; under ``uv run`` it is not to copy the working directory to all machines."""
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
    """Asks a head for its health, in another process: Ray ends one that it cannot connect."""
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
    """Of what runs on the cluster: the same modules, and nothing on an accelerator.

    Places that are not on a machine are passed over there, and its own follow.
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
    """The last line of an exception's text, which says most where Ray repeats a traceback."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1] if lines else type(error).__name__
