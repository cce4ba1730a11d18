"""CUDA C to PTX by NVRTC: side by side, once for each source, and kept in a folder by content.

NVRTC comes with JAX's CUDA packages. PTX is compiled for the device by its driver, which keeps a
cache of its own.
"""

import ctypes
import hashlib
import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from ctypes.util import find_library
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from angler_kernels.checked_file import read_checked, write_checked

OPTIONS = ("-fmad=false", "-default-device", "-w")
"""Options of every compilation; products and sums are fused only where a kernel says so."""

FAST_DIVISION = ("-prec-div=false", "-prec-sqrt=false", "-ftz=true")
"""Options for divisions within 2 ulp and square roots within 1 ulp, where subnormals are 0: a
tenth faster."""

MAX_THREADS = 16
"""Maximum number of sources that are compiled side by side."""


class CudaCompilerError(RuntimeError):
    """NVRTC is not installed, refuses a kernel, or is newer than the driver."""


@dataclass(frozen=True)
class KernelSource:
    """CUDA C of a kernel, and how it is compiled."""

    text: str
    options: tuple[str, ...] = ()
    """Options beside `OPTIONS`."""


_pool = ThreadPoolExecutor(min(MAX_THREADS, os.cpu_count() or 1), thread_name_prefix="nvrtc")
_begun: dict[tuple[KernelSource, str], Future[str]] = {}
_lock = threading.Lock()


def begin_compilation(source: KernelSource, architecture: str, folder: Path | None) -> Future[str]:
    """Begin to compile a source, unless that was done before.

    Args:
        source: kernel to compile.
        architecture: of the device, like ``compute_90``.
        folder: where PTX is kept and looked for; None to keep none.

    Returns:
        PTX to come, or a `CudaCompilerError`.
    """
    key = (source, architecture)
    with _lock:
        if key not in _begun:
            _begun[key] = _pool.submit(load_or_compile, source, architecture, folder)
        return _begun[key]


def forget() -> None:
    """Forget what was compiled in this process."""
    with _lock:
        _begun.clear()


def load_or_compile(source: KernelSource, architecture: str, folder: Path | None) -> str:
    """Return the PTX of a source, from a folder where it is there and whole.

    A folder that cannot be read or written is none, and a damaged file is compiled again.

    Raises:
        CudaCompilerError: NVRTC is not installed, refuses the source, or is newer than the driver.
    """
    require_driver()
    if folder is None:
        return compile_source(source, architecture)
    options = [*OPTIONS, *source.options]
    text = "\0".join([source.text, architecture, *options, str(version())])
    path = folder / f"{hashlib.sha256(text.encode()).hexdigest()}.ptx"
    kept = read_checked(path)
    if kept is not None:
        return kept.decode()
    ptx = compile_source(source, architecture)
    write_checked(path, ptx.encode())
    return ptx


def compile_source(source: KernelSource, architecture: str) -> str:
    """Compile CUDA C to PTX.

    Raises:
        CudaCompilerError: NVRTC is not installed, or refuses the source; says its first line.
    """
    nvrtc, program = _library(), ctypes.c_void_p()
    nvrtc.nvrtcCreateProgram(
        ctypes.byref(program), source.text.encode(), b"kernel.cu", 0, None, None
    )
    try:
        options = [f"--gpu-architecture={architecture}", *OPTIONS, *source.options]
        values = (ctypes.c_char_p * len(options))(*(option.encode() for option in options))
        if nvrtc.nvrtcCompileProgram(program, len(options), values) != 0:
            log = _read(nvrtc.nvrtcGetProgramLogSize, nvrtc.nvrtcGetProgramLog, program)
            raise CudaCompilerError(f"NVRTC: {(log.strip() or 'no message').splitlines()[0]}")
        return _read(nvrtc.nvrtcGetPTXSize, nvrtc.nvrtcGetPTX, program)
    finally:
        nvrtc.nvrtcDestroyProgram(ctypes.byref(program))


def version() -> tuple[int, int]:
    """Return the version of NVRTC.

    Raises:
        CudaCompilerError: it is not installed.
    """
    major, minor = ctypes.c_int(), ctypes.c_int()
    _library().nvrtcVersion(ctypes.byref(major), ctypes.byref(minor))
    return major.value, minor.value


def require_driver() -> None:
    """Check that the device's driver can load the PTX of this NVRTC.

    Raises:
        CudaCompilerError: NVRTC is newer than the driver, or not installed.
    """
    ours, supported = version(), _driver_version()
    if supported is not None and ours > supported:
        text, limit = (f"{major}.{minor}" for major, minor in (ours, supported))
        package = "nvidia-cuda-nvrtc" + ("-cu12" if supported < (13, 0) else "")
        raise CudaCompilerError(
            f"NVRTC {text} is newer than the CUDA version {limit} of the driver, which cannot load "
            f"its PTX: update the driver, or pip install '{package}=={limit}.*'"
        )


@cache
def _driver_version() -> tuple[int, int] | None:
    """Return the newest version of CUDA that the driver supports; None without a driver."""
    try:
        driver = ctypes.CDLL("libcuda.so.1")
    except OSError:
        return None
    number = ctypes.c_int()
    if driver.cuDriverGetVersion(ctypes.byref(number)) != 0:
        return None
    return number.value // 1000, number.value % 1000 // 10


def _read(size_of: Callable[..., int], read: Callable[..., int], program: ctypes.c_void_p) -> str:
    size = ctypes.c_size_t()
    size_of(program, ctypes.byref(size))
    buffer = ctypes.create_string_buffer(size.value)
    read(program, buffer)
    return buffer.value.decode(errors="replace")


@cache
def _library() -> ctypes.CDLL:
    for path in _find_libraries():
        try:
            return ctypes.CDLL(path)
        except OSError:
            continue
    raise CudaCompilerError("NVRTC is not installed; pip install 'jax[cuda13]' brings it")


def _find_libraries() -> Iterator[str]:
    """Yield paths of NVRTC: of Python packages, of a CUDA toolkit, of the system."""
    packages = find_spec("nvidia")
    roots = packages.submodule_search_locations if packages else None
    for root in roots or ():
        yield from sorted(str(path) for path in Path(root).glob("*/lib/libnvrtc.so.*"))
    toolkit = Path(os.environ.get("CUDA_HOME") or "/usr/local/cuda")
    yield from sorted(str(path) for path in toolkit.glob("lib64/libnvrtc.so.*"))
    system = find_library("nvrtc")
    if system:
        yield system
