"""The check of what kernels need on a GPU: it finds every kernel, and complains of what it should."""

import ast
import importlib.util
import json
from dataclasses import replace
from pathlib import Path

import pytest
import warp as wp

from evqr_kernels import SplatConfig
from evqr_kernels.warp_backend.splat_strips import strip_columns

from .test_style import FILES, decorated

SCRIPT = Path(__file__).parents[2] / "perf" / "portability.py"
spec = importlib.util.spec_from_file_location("portability", SCRIPT)
portability = importlib.util.module_from_spec(spec)
spec.loader.exec_module(portability)

SETTINGS = {
    "budgets": {"float32": {"registers": 64, "stack": 0, "local": 0, "shared": 1024}},
    "atomics": {"float32": {"scatter": 2}},
    "shared": {"float32": {"block": 4096}},
    "barriers": {"float32": {"block": 3}},
    "matrices": {"kernels": ["matrix"], "float32": 96},
    "exceptions": {"file_? wide float32": {"registers": 70, "reason": "it is wide"}},
}
PLAIN = portability.Usage("file_4", "plain", "float32", 90, registers=64)
DUMP = """
 Function make_one__locals__one_cuda_kernel_forward:
  REG:40 STACK:16 SHARED:2048 LOCAL:0
\t\tFunction : make_one__locals__one_cuda_kernel_forward
        /*1490*/    REDG.E.ADD.F32.FTZ.RN.STRONG.GPU desc[UR16][R14.64], R27 ;
        /*1491*/    STL.64 [R1+0x1b8], RZ ;
        /*1492*/    LDL R2, [R1] ;
        /*1493*/    REDUX.SUM UR4, R2 ;
        /*1494*/    BAR.SYNC.DEFER_BLOCKING 0x0 ;
"""


def test_every_kernel_is_found():
    in_sources = {
        kernel.name
        for file in FILES
        if file.parent.name == "warp_backend"
        for kernel in decorated(ast.parse(file.read_text()), "kernel")
    }
    settings = json.loads(SCRIPT.with_suffix(".json").read_text())
    modules = portability.build(wp.float32, settings["variants"], {})
    built = {kernel.func.__name__ for module in modules for kernel in module.kernels.values()}
    assert built | settings["cpu_only"].keys() == in_sources


@pytest.mark.parametrize("file", ["splat", "splat_adjoint"])
def test_splats_are_built_as_gpus_run_them(file):
    variants = json.loads(SCRIPT.with_suffix(".json").read_text())["variants"][file]
    assert {SplatConfig(**variant["cfg"]).epsilon_px for variant in variants} == {0.8, 1.0, 2.0, 4.0}
    for variant in variants:
        assert variant["columns"] == strip_columns(SplatConfig(**variant["cfg"]), 10_000)


@pytest.mark.parametrize(
    ("row", "complaint"),
    [
        (PLAIN, None),
        (replace(PLAIN, registers=65), "file_4 plain float32 sm_90: 65 registers, the budget is 64"),
        (replace(PLAIN, stack=8), "file_4 plain float32 sm_90: 8 stack, the budget is 0"),
        (replace(PLAIN, local=1), "file_4 plain float32 sm_90: 1 local, the budget is 0"),
        (replace(PLAIN, atomics=1), "file_4 plain float32 sm_90: 1 atomics, the budget is 0"),
        (replace(PLAIN, kernel="scatter", atomics=2), None),
        (replace(PLAIN, shared=1024), None),  # which Warp takes itself
        (replace(PLAIN, kernel="block", shared=4096, barriers=3), None),
        (replace(PLAIN, barriers=1), "file_4 plain float32 sm_90: 1 barriers, the budget is 0"),
        (
            replace(PLAIN, kernel="block", shared=4097),
            "file_4 block float32 sm_90: 4097 shared, the budget is 4096",
        ),
        (replace(PLAIN, kernel="matrix", registers=96), None),
        (
            replace(PLAIN, kernel="matrix", registers=97),
            "file_4 matrix float32 sm_90: 97 registers, the budget is 96",
        ),
        (replace(PLAIN, kernel="wide", registers=70), None),
        (
            replace(PLAIN, kernel="wide", registers=71),
            "file_4 wide float32 sm_90: 71 registers, the budget is 70",
        ),
        (replace(PLAIN, kernel="wide"), "file_? wide float32: the exception is not needed any more"),
    ],
)
def test_budgets(row, complaint):
    assert portability.complaints([row], SETTINGS) == ([complaint] if complaint else [])


def test_what_the_disassembler_says_is_read(monkeypatch, tmp_path):
    answers = iter(DUMP.partition("\t\t")[::2])

    class Done:
        def __init__(self, *_, **__):
            self.stdout = next(answers)

    monkeypatch.setattr(portability, "cuobjdump", lambda: "cuobjdump")
    monkeypatch.setattr(portability.subprocess, "run", Done)
    (usage,) = portability.usages(tmp_path, "file", "float32", 90)
    assert usage == portability.Usage("file", "one", "float32", 90, 40, 16, 2, 1, 2048, 1)
