"""Emitted CUDA C as functions of this machine: the same C, compiled by its compiler.

Threads of a block are threads here, which wait for each other at barriers. Calls of kernels
within JAX programs run that way on the CPU, with results that hold junk before.
"""

import ctypes
import hashlib
import shutil
import subprocess
import threading
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from tempfile import mkdtemp

import jax
import numpy as np
import pytest
from jax.interpreters import mlir

from angler_kernels.cuda import kernel_call, nvrtc
from angler_kernels.cuda.emission import INSTRUCTIONS

HOST = """\
#include <cmath>
#include <cstdlib>
#include <cstring>
using namespace std;
#define DEVICE inline
#define __global__
#define __launch_bounds__(threads)
#define __restrict__
#define __shared__ static
struct Index { int x, y; };
static Index blockIdx, blockDim;
static thread_local Index threadIdx;
typedef _Float16 half_;
static float __int_as_float(int a) { float b; memcpy(&b, &a, 4); return b; }
static int __float_as_int(float a) { int b; memcpy(&b, &a, 4); return b; }
static int __popc(unsigned a) { return __builtin_popcount(a); }
static int __clz(int a) { return a == 0 ? 32 : __builtin_clz((unsigned)a); }
static float rsqrt(float a) { return 1.0f / sqrt(a); }
static float reciprocal_(float a) { return 1.0f / a; }
static float multiply_add_(float a, float b, float c) { return fmaf(a, b, c); }
void __syncthreads();
template <class T> T __shfl_xor_sync(unsigned, T value, int other) {
  static T of_threads[1024];
  of_threads[threadIdx.x] = value;
  __syncthreads();
  value = of_threads[threadIdx.x ^ other];
  __syncthreads();
  return value;
}
"""
"""What CUDA C has and this machine does not."""

OF_LANES = """
extern "C" void launch(int blocks, int rows, int threads, void** arrays) {{
  blockDim.x = threads;
  for (blockIdx.y = 0; blockIdx.y < rows; ++blockIdx.y)
    for (blockIdx.x = 0; blockIdx.x < blocks; ++blockIdx.x)
      for (threadIdx.x = 0; threadIdx.x < threads; ++threadIdx.x)
        kernel({arguments});
}}
"""
OF_BLOCKS = """
#include <barrier>
#include <thread>
#include <vector>
static barrier<>* together;
void __syncthreads() {{ together->arrive_and_wait(); }}
extern "C" void launch(int blocks, int threads, void** arrays) {{
  blockDim.x = threads;
  for (blockIdx.x = 0; blockIdx.x < blocks; ++blockIdx.x) {{
    barrier<> of_block(threads);
    together = &of_block;
    vector<thread> all;
    for (int k = 0; k < threads; ++k)
      all.emplace_back([=] {{ threadIdx.x = k; kernel({arguments}); }});
    for (thread& each : all) each.join();
  }}
}}
"""
"""Launches of the two kinds of kernels."""
OPTIONS = ("-O1", "-ffp-contract=off", "-fPIC", "-shared", "-w")


def compile_here(source):
    """Compile a source of `angler_kernels.cuda` and return its library."""
    compiler = shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("needs a C++ compiler")
    assert INSTRUCTIONS in source
    head = source.split('extern "C"', 1)[1].split(") {", 1)[0]
    lines = head.split("(\n", 1)[1].split(",\n")
    types = [line.strip().removeprefix("const ").split("*")[0].strip() for line in lines]
    arguments = ", ".join(f"({kind}*)arrays[{k}]" for k, kind in enumerate(types))
    is_block = "#define PROBLEM_OF_" in source
    launch = (OF_BLOCKS if is_block else OF_LANES).format(arguments=arguments)
    more = ("-std=c++20", "-pthread") if is_block else ()
    # Callbacks come from several threads, and the caches below would each be filled by two.
    with _LOCK:
        return _compile((compiler, *OPTIONS, *more), source.replace(INSTRUCTIONS, HOST) + launch)


_LOCK = threading.Lock()


@cache
def _folder():
    return Path(mkdtemp(prefix="cuda-on-cpu-"))


@cache
def _compile(command, text):
    name = hashlib.sha256(text.encode()).hexdigest()[:16]
    (_folder() / f"{name}.cpp").write_text(text)
    subprocess.run([*command, f"{name}.cpp", "-o", f"{name}.so"], cwd=_folder(), check=True)
    return ctypes.CDLL(_folder() / f"{name}.so")


def addresses(arrays):
    """Return the pointers of NumPy arrays."""
    return (ctypes.c_void_p * len(arrays))(*(x.ctypes.data for x in arrays))


def run_blocks(launch, *arrays):
    """Return the arrays that the blocks of a launch fill."""
    blocks = int(np.prod(launch.batch, dtype=int))
    read = [np.ascontiguousarray(x) for x in arrays]
    filled = [np.empty((*launch.batch, *x.shape), x.dtype) for x in launch.filled]
    for x in filled:
        x.view(np.uint8)[...] = 0xA5
    library = compile_here(launch.source.text)
    library.launch(blocks, launch.threads, addresses([*read, *filled]))
    return filled


def run_lanes(launch, *arrays):
    """Return the arrays that a launch of independent lanes changes."""
    read = [np.ascontiguousarray(x) for x in arrays[: launch.constants]]
    changed = [np.array(x) for x in arrays[launch.constants :]]
    library = compile_here(launch.source.text)
    library.launch(*launch.grid, launch.block, addresses([*read, *changed, *changed]))
    return changed


def _call_lanes_here(*arrays, launch):
    changed = arrays[launch.constants :]
    shapes = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in changed]
    return jax.pure_callback(partial(run_lanes, launch), shapes, *arrays)


def _call_here(*arrays, launch):
    shapes = [jax.ShapeDtypeStruct((*launch.batch, *x.shape), x.dtype) for x in launch.filled]
    return jax.pure_callback(partial(run_blocks, launch), shapes, *arrays)


for _primitive, _call in (
    (kernel_call._call_block_p, _call_here),
    (kernel_call._call_p, _call_lanes_here),
):
    mlir.register_lowering(_primitive, mlir.lower_fun(_call, multiple_results=True), platform="cpu")


@pytest.fixture
def compiled_sources(monkeypatch):
    """Sources that are compiled for a device that is not here, without NVRTC."""
    seen = []

    def begin(source, architecture, folder):
        seen.append(source.text)
        done = nvrtc.Future()
        done.set_result(f"// PTX {len(seen)}")
        return done

    monkeypatch.setattr(nvrtc, "begin_compilation", begin)
    monkeypatch.setattr(kernel_call, "_architecture", lambda: "compute_90")
    return seen


@dataclass(frozen=True)
class BlockForm:
    """Form in which a block kernel runs here."""

    interpret: bool

    def __call__(self, function, **options):
        """Return a function with ``interpret`` and options."""
        return partial(function, interpret=self.interpret, **options)


@pytest.fixture(params=["interpreted", "as C"])
def block_form(request):
    """Forms of a block kernel: its Python, and emitted C."""
    if request.param == "as C":
        request.getfixturevalue("compiled_sources")
    return BlockForm(request.param == "interpreted")


def needs_nvrtc():
    """Skip a test without NVRTC."""
    try:
        nvrtc.version()
    except nvrtc.CudaCompilerError as error:
        pytest.skip(str(error))
