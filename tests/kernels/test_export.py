"""Kernels for callers without Python: what is written, and a program in C++ that includes it."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from evqr_kernels import export

EXAMPLE = Path(__file__).parents[2] / "examples" / "without_python" / "deposit.cpp"
DRIVER = """
#include <stddef.h>
typedef int CUresult; typedef int CUdevice; typedef unsigned long long CUdeviceptr;
typedef struct c *CUcontext; typedef struct m *CUmodule; typedef struct f *CUfunction;
typedef struct s *CUstream;
enum { CUDA_SUCCESS = 0 };
CUresult cuInit(unsigned); CUresult cuDeviceGet(CUdevice *, int); CUresult cuCtxSetCurrent(CUcontext);
CUresult cuDevicePrimaryCtxRetain(CUcontext *, CUdevice); CUresult cuModuleLoad(CUmodule *, const char *);
CUresult cuModuleGetFunction(CUfunction *, CUmodule, const char *);
CUresult cuMemAlloc(CUdeviceptr *, size_t);
CUresult cuMemcpyHtoD(CUdeviceptr, const void *, size_t);
CUresult cuMemsetD8(CUdeviceptr, unsigned char, size_t);
CUresult cuMemcpyDtoH(void *, CUdeviceptr, size_t);
CUresult cuLaunchKernel(CUfunction, unsigned, unsigned, unsigned, unsigned, unsigned, unsigned, unsigned,
                        CUstream, void **, void **);
"""
"""As much of the driver's header as the example uses: types and declarations."""


def test_files_and_header(tmp_path, capsys):
    """PTX, which needs no assembler; the example compiles with the header."""
    assert export.main([str(tmp_path), "--arch", "sm_80", "--ptx", "--op", "deposit_events"]) == 0
    assert "1 launches of 1 operations for sm_80" in capsys.readouterr().out
    header = (tmp_path / "evqr_kernels.h").read_text()
    ((file, entry),) = re.findall(r'"deposit_events", "([^"]+)",\s+"([^"]+)"', header)
    ptx = (tmp_path / file).read_text()
    assert f".entry {entry}(" in ptx.replace("\n", "")
    parameters = re.search(rf"\.entry {entry}\((.*?)\)", ptx, re.DOTALL)
    # the bounds, and 56 bytes an array
    assert parameters and len(re.findall(r"\.b8 \S+\[56\]", parameters.group(1))) == 8
    if not shutil.which("g++"):
        pytest.skip("no g++ is installed")
    (tmp_path / "cuda.h").write_text(f'extern "C" {{{DRIVER}}}')
    command = ["g++", "-std=c++17", "-Wall", "-Werror", "-fsyntax-only", f"-I{tmp_path}", str(EXAMPLE)]
    subprocess.run(command, check=True)
    sizes = 'static_assert(sizeof(evqr_array) == 56 && sizeof(evqr_bounds_1) == 24, "as kernels have them");'
    subprocess.run(
        ["g++", "-fsyntax-only", f"-I{tmp_path}", "-x", "c++", "-"],
        input=f'#include "evqr_kernels.h"\n{sizes}\n', text=True, check=True,
    )  # fmt: skip


def test_an_architecture_that_is_none(capsys):
    with pytest.raises(SystemExit):
        export.main(["nowhere", "--arch", "hopper"])
    assert "--arch must be like sm_90, got hopper" in capsys.readouterr().err
