"""Compilation to PTX: NVRTC itself where it is installed, and the folder of what was compiled."""

import os
import threading

import pytest

from angler_kernels.cuda import nvrtc
from angler_kernels.cuda.nvrtc import FAST_DIVISION, KernelSource

TEXT = 'extern "C" __global__ void kernel(float* x) { x[threadIdx.x] *= 2.0f; }\n'
SOURCE = KernelSource(TEXT)


def has_nvrtc():
    try:
        nvrtc.version()
    except nvrtc.CudaCompilerError:
        return False
    return True


needs_nvrtc = pytest.mark.skipif(not has_nvrtc(), reason="needs NVRTC (nvidia-cuda-nvrtc)")


@pytest.fixture
def compiled(monkeypatch):
    """Sources that were compiled, in order; compiling one takes no NVRTC."""
    sources = []

    def compile_source(source, architecture):
        sources.append(source)
        return f"// {architecture}\n{source.text}"

    monkeypatch.setattr(nvrtc, "compile_source", compile_source)
    monkeypatch.setattr(nvrtc, "version", lambda: (13, 0))
    nvrtc.forget()
    yield sources
    nvrtc.forget()


@needs_nvrtc
def test_a_source_becomes_ptx_of_its_architecture():
    ptx = nvrtc.compile_source(SOURCE, "compute_90")
    assert ".target sm_90" in ptx
    assert ".entry kernel(" in ptx
    assert "\0" not in ptx


@needs_nvrtc
def test_products_and_sums_are_not_fused():
    source = KernelSource(TEXT.replace("x[threadIdx.x] *= 2.0f", "x[0] = x[1] * x[2] + x[3]"))
    ptx = nvrtc.compile_source(source, "compute_90")
    assert "mul.f32" in ptx or "mul.rn.f32" in ptx
    assert "fma" not in ptx


@needs_nvrtc
def test_divisions_are_exact_unless_a_source_says_otherwise():
    text = TEXT.replace("x[threadIdx.x] *= 2.0f", "x[0] = x[1] / x[2] + sqrtf(x[3])")
    exact = nvrtc.compile_source(KernelSource(text), "compute_90")
    fast = nvrtc.compile_source(KernelSource(text, FAST_DIVISION), "compute_90")
    for name in ("div.rn.f32", "sqrt.rn.f32"):
        assert name in exact
    for name in ("div.full.ftz.f32", "sqrt.approx.ftz.f32"):
        assert name in fast


@pytest.mark.parametrize(
    ("driver", "package"),
    [((12, 8), "nvidia-cuda-nvrtc-cu12==12.8.*"), ((13, 0), "nvidia-cuda-nvrtc==13.0.*")],
)
def test_a_compiler_newer_than_the_driver_is_refused(monkeypatch, driver, package):
    """Its PTX would not load, and the driver says so only when a program runs."""
    monkeypatch.setattr(nvrtc, "version", lambda: (13, 1))
    monkeypatch.setattr(nvrtc, "_driver_version", lambda: driver)
    version = f"{driver[0]}.{driver[1]}"
    with pytest.raises(nvrtc.CudaCompilerError, match=rf"13\.1 is newer .* {version} ") as error:
        nvrtc.load_or_compile(SOURCE, "compute_90", None)
    assert package in str(error.value)
    for newest in ((13, 1), (13, 2), (14, 0), None):
        monkeypatch.setattr(nvrtc, "_driver_version", lambda newest=newest: newest)
        nvrtc.require_driver()


@needs_nvrtc
def test_a_source_that_is_no_c_is_refused_with_the_compilers_first_line():
    with pytest.raises(nvrtc.CudaCompilerError, match=r"^NVRTC: kernel\.cu\(1\): error: "):
        nvrtc.compile_source(KernelSource("nonsense"), "compute_90")


def test_without_nvrtc_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setattr(nvrtc, "_find_libraries", lambda: iter(["/nowhere/libnvrtc.so.13"]))
    nvrtc._library.cache_clear()
    try:
        with pytest.raises(nvrtc.CudaCompilerError, match=r"pip install 'jax\[cuda13\]'"):
            nvrtc.version()
    finally:
        nvrtc._library.cache_clear()


def test_a_source_is_compiled_once_for_each_architecture(compiled, tmp_path):
    first = [nvrtc.begin_compilation(SOURCE, "compute_90", tmp_path) for _ in range(3)]
    other = nvrtc.begin_compilation(SOURCE, "compute_80", tmp_path)
    assert {x.result() for x in first} == {f"// compute_90\n{TEXT}"}
    assert other.result().startswith("// compute_80")
    assert len(compiled) == 2
    nvrtc.forget()
    assert nvrtc.begin_compilation(SOURCE, "compute_90", tmp_path).result() == first[0].result()
    assert len(compiled) == 2, "kept in the folder"
    assert len(list(tmp_path.iterdir())) == 2


def test_another_source_or_compiler_is_compiled_anew(compiled, tmp_path, monkeypatch):
    nvrtc.load_or_compile(SOURCE, "compute_90", tmp_path)
    nvrtc.load_or_compile(KernelSource(TEXT + "\n"), "compute_90", tmp_path)
    monkeypatch.setattr(nvrtc, "version", lambda: (13, 1))
    nvrtc.load_or_compile(SOURCE, "compute_90", tmp_path)
    assert len(compiled) == 3


@pytest.mark.parametrize(
    "damage", [lambda x: x[:-1], lambda x: x + b"x", lambda x: b"", lambda x: x[40:]]
)
def test_a_damaged_file_is_compiled_again_and_mended(compiled, tmp_path, damage):
    right = nvrtc.load_or_compile(SOURCE, "compute_90", tmp_path)
    (path,) = tmp_path.iterdir()
    whole = path.read_bytes()
    path.write_bytes(damage(whole))
    assert nvrtc.load_or_compile(SOURCE, "compute_90", tmp_path) == right
    assert path.read_bytes() == whole
    assert len(compiled) == 2


def test_a_folder_that_cannot_be_made_is_none(compiled, tmp_path):
    (tmp_path / "file").write_text("")
    folder = tmp_path / "file" / "ptx"
    assert nvrtc.load_or_compile(SOURCE, "compute_90", folder).endswith(TEXT)
    assert nvrtc.load_or_compile(SOURCE, "compute_90", None).endswith(TEXT)
    assert len(compiled) == 2


def test_a_full_disk_leaves_nothing_half_written(compiled, tmp_path, monkeypatch):
    def fail(*_):
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr("pathlib.Path.replace", fail)
    assert nvrtc.load_or_compile(SOURCE, "compute_90", tmp_path).endswith(TEXT)
    assert not list(tmp_path.iterdir())


def test_many_threads_write_one_file(compiled, tmp_path):
    results = []
    threads = [
        threading.Thread(
            target=lambda: results.append(nvrtc.load_or_compile(SOURCE, "compute_90", tmp_path))
        )
        for _ in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(set(results)) == 1
    assert len(list(tmp_path.iterdir())) == 1
