"""Executables on disk: a program that was compiled before is neither traced nor lowered again.

JAX's own cache is keyed by the lowered program: it saves XLA's time, not Python's, which is 8 s of
10 s for `reef_fleet` on two processors. Executables here are keyed by what a trace depends on:
settings, vehicles, code of the packages, versions, device, flags. Code that was replaced in a
running process is not in that key. Executables are therefore stored for commands; a Python caller
enables them with ``ANGLER_STORED_PROGRAMS=1``.
"""

import hashlib
import os
import pickle
import platform
import re
import threading
from collections.abc import Hashable, Iterator
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

import jax
import jax.numpy as jnp
from jax.experimental import serialize_executable
from jax.sharding import Mesh

from angler_kernels.checked_file import read_checked, write_checked
from angler_mjx.runs.simulator.compile_cache import switch_cache
from angler_mjx.runs.simulator.shared_pause import SharedPause

SETTING = "ANGLER_STORED_PROGRAMS"
"""Environment variable; "0" stores nothing, "1" stores programs of Python callers too."""

MAX_BYTES = 4 << 30
"""Size of the folder beyond which the executables that were not used for longest are removed."""

PACKAGES = ("angler_mjx", "angler_kernels")
"""Packages whose code is traced."""
DISTRIBUTIONS = ("jax", "mujoco", "mujoco-mjx", "numpy")
COMPILERS = ("jaxlib", "jax-cuda12-plugin", "jax-cuda13-plugin")
UNTRACED_SETTINGS = (
    "jax_compilation_cache",
    "jax_persistent_cache",
    "jax_enable_compilation_cache",
    "jax_log_compiles",
    "jax_platforms",
)
"""Prefixes of JAX's settings that change no program; keys hold the devices themselves."""

_JAX_CACHE = SharedPause(lambda: bool(jax.config.jax_enable_compilation_cache), switch_cache)
"""JAX's own cache. What is read from there cannot be serialised: for a CPU it lacks its kernels."""

_enabled_by_command = False


def enable_stored_programs() -> None:
    """Store executables in this process; for commands, whose code nobody replaces."""
    global _enabled_by_command
    _enabled_by_command = True


def are_enabled() -> bool:
    """Return whether this process stores executables by `enable_stored_programs`."""
    return _enabled_by_command


@cache
def _find_lapack() -> None:
    """Have JAX look up LAPACK, which it does when it lowers the first program that calls it.

    A loaded executable that factorises a matrix on a CPU calls a null pointer otherwise.
    """
    jax.jit(jnp.linalg.cholesky).lower(jax.ShapeDtypeStruct((1, 1), jnp.float32))


@dataclass(frozen=True, kw_only=True)
class StoredProgram:
    """Executable in a file."""

    result: object
    """Tree of shapes and types of the results."""
    payload: bytes
    in_tree: jax.tree_util.PyTreeDef
    devices: tuple[jax.Device, ...]

    def load(self) -> jax.stages.Compiled:
        """Load the executable onto its devices.

        Raises:
            JaxRuntimeError: the device refuses it.
        """
        if self.devices[0].platform == "cpu":
            _find_lapack()
        executable: jax.stages.Compiled = serialize_executable.deserialize_and_load(
            self.payload,
            self.in_tree,
            jax.tree.structure(self.result),
            backend=self.devices[0].client,
            execution_devices=self.devices,
        )
        return executable


@dataclass(frozen=True, kw_only=True)
class ProgramStore:
    """Folder of executables, by content, and of the names of one set of programs for them."""

    folder: Path
    machine: str
    """Digest of devices, versions and flags: what an executable depends on beside its program."""
    key: str
    """Digest of that, and of all that the traces of the set depend on, beside the arguments."""
    devices: tuple[jax.Device, ...]

    def find(self, name: str, arguments: tuple[object, ...]) -> StoredProgram | None:
        """Return a stored program for arguments of these shapes; None where there is none.

        Args:
            name: of the program within its set.
            arguments: trees of arrays or shapes.
        """
        path = self._path(name, arguments)
        link = read_checked(path)
        if link is None:
            return None
        _mark_used(path)
        result, executable_name = pickle.loads(link)
        return self._read(executable_name, result, arguments)

    def compile(
        self, name: str, lowered: jax.stages.Lowered, arguments: tuple[object, ...]
    ) -> jax.stages.Compiled:
        """Load the executable of an equal program, or compile it; store it under this name too."""
        # JAX leaves out arguments that a program does not use, but still checks their shapes.
        digest = _digest(self.machine, lowered.as_text(), repr(_leaf_shapes(arguments)))
        executable_name = f"{digest}.executable"
        result = jax.tree.map(
            lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), lowered.out_info
        )
        stored = self._read(executable_name, result, arguments)
        executable = None if stored is None else load_stored(stored)
        if executable is None:
            with _JAX_CACHE.paused():
                executable = lowered.compile()
            if not self._write(executable_name, executable):
                return executable
        write_checked(self._path(name, arguments), pickle.dumps((result, executable_name)))
        remove_unused(self.folder, MAX_BYTES)
        return executable

    def _read(
        self, executable_name: str, result: object, arguments: tuple[object, ...]
    ) -> StoredProgram | None:
        path = self.folder / executable_name
        payload = read_checked(path)
        if payload is None:
            return None
        _mark_used(path)
        in_tree = jax.tree.structure((arguments, {}))
        return StoredProgram(result=result, payload=payload, in_tree=in_tree, devices=self.devices)

    def _write(self, executable_name: str, executable: jax.stages.Compiled) -> bool:
        """Store an executable; return whether JAX can serialise it and the folder be written."""
        try:
            payload, _, _ = serialize_executable.serialize(executable)
        except (ValueError, NotImplementedError):
            return False
        return write_checked(self.folder / executable_name, payload)

    def _path(self, name: str, arguments: tuple[object, ...]) -> Path:
        structure, shapes = jax.tree.structure(arguments), _leaf_shapes(arguments)
        # What the tree holds beside its leaves follows from the key: MuJoCo's arrays of a fleet.
        text = re.sub(r" at 0x[0-9a-f]+", "", str(structure))
        return self.folder / f"{_digest(self.key, name, text, repr(shapes))}.program"


def _leaf_shapes(arguments: tuple[object, ...]) -> list[tuple[tuple[int, ...], str]]:
    """Return shape and type of each array of arguments."""
    return [(leaf.shape, str(leaf.dtype)) for leaf in jax.tree.leaves(arguments)]


def load_stored(stored: StoredProgram) -> jax.stages.Compiled | None:
    """Load a stored program; None where its device refuses it."""
    try:
        return stored.load()
    except (jax.errors.JaxRuntimeError, ValueError):
        return None


def open_store(key: Hashable | None, mesh: Mesh) -> ProgramStore | None:
    """Return the store of a set of programs; None where none may be stored.

    Args:
        key: equal for sets of programs with equal traces; None where that is unknown.
        mesh: devices of the programs.
    """
    folder, text = _store_folder(), repr(key)
    # A representation with an address says nothing of what the object holds.
    if key is None or folder is None or " at 0x" in text:
        return None
    devices = tuple(mesh.devices.flat)
    cards, client = [(device.id, device.device_kind) for device in devices], devices[0].client
    flags = os.environ.get("XLA_FLAGS", "")
    versions = [_version(name) for name in COMPILERS]
    machine = _digest(repr(cards), client.platform_version, flags, repr(versions), _processor())
    return ProgramStore(
        folder=folder,
        machine=machine,
        key=_digest(machine, text, code_digest()),
        devices=devices,
    )


def trace_settings() -> tuple[str, ...]:
    """Return JAX's settings, but for those of caches and logs, which change no program."""
    return tuple(
        f"{name}={getattr(jax.config, name, None)!r}"
        for name in sorted(jax.config.values)
        if not name.startswith(UNTRACED_SETTINGS)
    )


def remove_unused(folder: Path, max_bytes: int) -> None:
    """Remove the files that were not used for longest until a folder is small enough."""
    files = sorted(_list_files(folder), reverse=True)
    total = 0
    for _, size, path in files:
        total += size
        if total > max_bytes:
            path.unlink(missing_ok=True)


def code_digest() -> str:
    """Return the digest of the traced code, of its data, and of the versions below it."""
    with _digest_lock:  # threads that begin together would each read all files
        return _code_digest()


_digest_lock = threading.Lock()


@cache
def _code_digest() -> str:
    digest = hashlib.sha256()
    for name in PACKAGES:
        spec = find_spec(name)
        for root in (spec and spec.submodule_search_locations) or ():
            for path in sorted(Path(root).rglob("*")):
                if path.is_file() and "__pycache__" not in path.parts:
                    content = hashlib.sha256(path.read_bytes()).hexdigest()
                    digest.update(f"{path.relative_to(root)} {content}\n".encode())
    for name in DISTRIBUTIONS:
        digest.update(f"{name} {_version(name)}\n".encode())
    return digest.hexdigest()


def _store_folder() -> Path | None:
    """Return the folder of executables, inside JAX's; None where they are not stored."""
    setting = os.environ.get(SETTING)
    folder = jax.config.jax_compilation_cache_dir
    is_enabled = setting == "1" or (_enabled_by_command and setting != "0")
    if not is_enabled or not folder or not jax.config.jax_enable_compilation_cache:
        return None
    return None if "://" in folder else Path(folder) / "programs"


@cache
def _processor() -> str:
    """Return the model and the instructions of the processor, where the system says them."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() + platform.machine()
    return "\n".join(sorted({line for line in lines if line.startswith(("model name", "flags"))}))


def _list_files(folder: Path) -> Iterator[tuple[float, int, Path]]:
    """Yield time of last use, bytes and path of each file; another process may remove some."""
    for path in folder.iterdir():
        try:
            status = path.stat()
        except OSError:
            continue
        yield status.st_mtime, status.st_size, path


def _mark_used(path: Path) -> None:
    try:
        os.utime(path)
    except OSError:  # a folder of somebody else
        return


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def _digest(*parts: str) -> str:
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()
