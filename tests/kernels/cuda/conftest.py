"""Emitted kernels as functions of this machine: the same C, compiled by its compiler."""

import ctypes
import shutil
import subprocess

import numpy as np
import pytest

from angler_kernels.cuda.emission import PRELUDE

HOST = """\
#include <cmath>
#include <cstring>
#include <cstdlib>
using namespace std;
#define __global__
#define __restrict__
struct Index { int x, y; };
static Index blockIdx, blockDim, threadIdx;
static float __int_as_float(int a) { float b; memcpy(&b, &a, 4); return b; }
static int __float_as_int(float a) { int b; memcpy(&b, &a, 4); return b; }
static int __popc(unsigned a) { return __builtin_popcount(a); }
static int __clz(int a) { return a == 0 ? 32 : __builtin_clz((unsigned)a); }
static float rsqrt(float a) { return 1.0f / sqrt(a); }
static float reciprocal_(float a) { return 1.0f / a; }
static float multiply_add_(float a, float b, float c) { return fmaf(a, b, c); }
template <class T> T max_(T a, T b) { return a != a ? a : b != b ? b : a > b ? a : b; }
template <class T> T min_(T a, T b) { return a != a ? a : b != b ? b : a < b ? a : b; }
template <class T> T sign_(T a) { return a > 0 ? T(1) : a < 0 ? T(-1) : a; }
"""
"""What CUDA C has and this machine does not."""

MAIN = """
extern "C" void launch(int blocks, int rows, int threads, void** arrays) {{
  blockDim.x = threads;
  for (blockIdx.y = 0; blockIdx.y < rows; ++blockIdx.y)
    for (blockIdx.x = 0; blockIdx.x < blocks; ++blockIdx.x)
      for (threadIdx.x = 0; threadIdx.x < threads; ++threadIdx.x)
        kernel({arguments});
}}
"""


@pytest.fixture(scope="session")
def compiler():
    path = shutil.which("g++") or shutil.which("clang++")
    if path is None:
        pytest.skip("needs a C++ compiler")
    return path


@pytest.fixture
def run_source(compiler, tmp_path):
    """Run an emitted kernel on NumPy arrays; written ones are changed in place."""

    def run(source, arrays, *, constants, blocks=1, rows=1, threads=1):
        assert source.startswith(PRELUDE)
        body = source.removeprefix(PRELUDE)
        pointers = [*arrays[:constants], *arrays[constants:], *arrays[constants:]]
        lines = body.split("(\n", 1)[1].split(") {", 1)[0].split(",\n")
        types = [line.strip().removeprefix("const ").split("*")[0].strip() for line in lines]
        arguments = ", ".join(f"({kind}*)arrays[{k}]" for k, kind in enumerate(types))
        library = tmp_path / f"kernel_{len(list(tmp_path.iterdir()))}.so"
        (tmp_path / "kernel.cpp").write_text(HOST + body + MAIN.format(arguments=arguments))
        command = [compiler, "-O1", "-ffp-contract=off", "-fPIC", "-shared", "-w"]
        subprocess.run([*command, "kernel.cpp", "-o", library], cwd=tmp_path, check=True)
        addresses = (ctypes.c_void_p * len(pointers))(*(x.ctypes.data for x in pointers))
        ctypes.CDLL(library).launch(blocks, rows, threads, addresses)

    return run


@pytest.fixture
def numbers():
    """Float32 numbers of all kinds."""
    rng = np.random.default_rng(0)
    special = [0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, np.nan, 1e-30, 3.4e38, 0.5, 1.5, 2.5]
    return np.concatenate([special, rng.normal(size=52) * 10.0 ** rng.integers(-3, 3, 52)]).astype(
        np.float32
    )
