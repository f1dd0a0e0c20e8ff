"""What holds for every operator: errors, torch.compile, opcheck, the GIL; and that the package lists its folders."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import threading
import time
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import torch
from reference import Operator, operators
from reference.arguments import EDGES, NAN, NEIGHBORS, POINTS, SINK, SOURCE, VALUES, changed
from torch import Tensor

from torchjoint import ops
from torchjoint.ops import felzenszwalb, fit_normals, min_cut, neighbor_edges
from torchjoint.ops._call import call

ROOT = Path(__file__).parents[2]
OPERATORS = operators()
every_operator = pytest.mark.parametrize("op", OPERATORS, ids=[op.name for op in OPERATORS])
LONG = [op for op in OPERATORS if op.long_call is not None]
every_long_operator = pytest.mark.parametrize("op", LONG, ids=[op.name for op in LONG])


def test_every_source_file_is_an_operator() -> None:
    sources = {path.stem for path in (ROOT / "torchjoint" / "csrc").glob("*.cpp")} - {"module"}
    assert sources == {op.name for op in OPERATORS}
    assert set(ops.__all__) <= sources


@pytest.mark.parametrize(
    ("op", "change", "error", "message"), [(op, *refused) for op in OPERATORS for refused in op.errors]
)
def test_errors_name_the_argument(op: Operator, change: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=re.escape(message)) as caught:
        op.function(**op.example | change)
    assert ".cpp" not in str(caught.value)


#: What an exception of C++ becomes without the wrapper; from torch 2.15 on the second.
REFUSED = (ValueError, RuntimeError)


@pytest.mark.parametrize(
    ("message", "error"),
    [
        ("edge_index: expected node numbers in [0, 4), got 9 at edge 2", ValueError),
        ("std::bad_alloc", MemoryError),
        ("[enforce fail at alloc_cpu.cpp:121] data. DefaultCPUAllocator: not enough memory", MemoryError),
        ('torch_call_dispatcher( "aten::new_empty", ...) API call failed at ops.h, line 939', MemoryError),
        ("expected scalar type Long but found Float", RuntimeError),
    ],
)
def test_errors_have_the_same_types_with_every_torch(
    message: str, error: type[Exception], monkeypatch: pytest.MonkeyPatch
) -> None:
    class OfTorch215:
        _schema = torch.ops.torchjoint.felzenszwalb.default._schema

        def __call__(self, *arguments: object) -> None:
            raise RuntimeError(message)

    monkeypatch.setattr(torch.ops.torchjoint.felzenszwalb, "default", OfTorch215())
    with pytest.raises(error) as caught:
        call("felzenszwalb", EDGES)
    assert type(caught.value) is error


@every_operator
def test_every_wrapper_translates_errors(op: Operator, monkeypatch: pytest.MonkeyPatch) -> None:
    schema = op.kernel._schema

    class Refusing:
        """As every kernel refuses an argument with torch 2.15."""

        _schema = schema

        def __call__(self, *arguments: object) -> None:
            raise RuntimeError(f"{self._schema.arguments[0].name}: wrong")

    monkeypatch.setattr(getattr(torch.ops.torchjoint, op.name), "default", Refusing())
    with pytest.raises(ValueError, match=": wrong"):
        op.function(**op.example)


@pytest.mark.parametrize(("op", "change"), [(op, change) for op in OPERATORS for change in op.refused])
def test_kernels_called_directly_refuse_what_the_wrappers_do(op: Operator, change: dict[str, Any]) -> None:
    with pytest.raises(REFUSED, match="expected"):
        op.kernel(**op.example | change)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_opcheck(dtype: torch.dtype) -> None:
    values, source, sink = VALUES.to(dtype), SOURCE.to(dtype), SINK.to(dtype)
    for operator, arguments in (
        (torch.ops.torchjoint.felzenszwalb.default, (EDGES, values, 4, 1.0, 2)),
        (torch.ops.torchjoint.min_cut.default, (EDGES, values, source, sink)),
        (torch.ops.torchjoint.neighbor_edges.default, (NEIGHBORS,)),
        (torch.ops.torchjoint.fit_normals.default, (POINTS.to(dtype), NEIGHBORS.int())),
    ):
        results = torch.library.opcheck(operator, arguments)
        assert results
        assert set(results.values()) == {"SUCCESS"}


@every_operator
def test_opcheck_of_every_operator(op: Operator) -> None:
    results = torch.library.opcheck(op.kernel, tuple(op.example.values()))
    assert results
    assert set(results.values()) == {"SUCCESS"}


@every_operator
def test_no_gradient_flows(op: Operator) -> None:
    with_grad = {
        name: value.clone().requires_grad_() if isinstance(value, Tensor) and value.is_floating_point() else value
        for name, value in op.example.items()
    }
    results = op.function(**with_grad)
    for result in results if isinstance(results, tuple) else (results,):
        assert not isinstance(result, Tensor) or not result.requires_grad


#: The first traces as the other does and writes no C++.
BACKENDS = ["aot_eager", pytest.param("inductor", marks=pytest.mark.slow)]


@pytest.mark.filterwarnings("ignore")  # the compiler's own
@pytest.mark.parametrize("backend", BACKENDS)
def test_compile_without_graph_breaks(backend: str) -> None:
    @torch.compile(fullgraph=True, dynamic=True, backend=backend)
    def compiled(
        edge_index: Tensor, weight: Tensor, source: Tensor, sink: Tensor, scale: float
    ) -> tuple[Tensor, Tensor, Tensor]:
        labels = felzenszwalb(edge_index, weight * 2, source.shape[0], scale, 1)
        side, flow = min_cut(edge_index, weight + 1, source, sink)
        return labels + 1, ~side, flow * 2

    for num_nodes, scale in ((4, 1.0), (9, 0.5), (30, 2.0)):
        generator = torch.Generator().manual_seed(num_nodes)
        edges = torch.randint(num_nodes, (2, 3 * num_nodes), generator=generator)
        weight, source = torch.rand(2, 3 * num_nodes, generator=generator)
        source, sink = source[:num_nodes] * 9, source[-num_nodes:] * 9
        labels, other_side, flow = compiled(edges, weight, source, sink, scale)
        side, expected_flow = min_cut(edges, weight + 1, source, sink)
        assert torch.equal(labels, felzenszwalb(edges, weight * 2, num_nodes, scale, 1) + 1)
        assert torch.equal(other_side, ~side)
        assert torch.equal(flow, expected_flow * 2)

    with pytest.raises(REFUSED, match=re.escape("expected node numbers in [0, 30), got 99 at edge 0")):
        compiled(changed(edges, 99, 0, 0), weight, source, sink, scale)
    first = r"capacity: expected finite numbers >= 0, got nan at edge 0|weight: expected no NaN, got NaN at edge 0"
    with pytest.raises(REFUSED, match=first):  # whichever operator the backend runs first
        compiled(edges, changed(weight, NAN, 0), source, sink, scale)


@pytest.mark.filterwarnings("ignore")  # the compiler's own
@pytest.mark.parametrize("backend", BACKENDS)
def test_neighbours_compile_without_graph_breaks(backend: str) -> None:
    def weigh(points: Tensor, neighbors: Tensor) -> tuple[Tensor, Tensor]:
        edges = neighbor_edges(neighbors)  # their number depends on the values
        normals = fit_normals(points * 2, neighbors)
        return edges + 1, (normals[edges[0]] * normals[edges[1]]).sum(dim=1)

    with torch._dynamo.config.patch(capture_dynamic_output_shape_ops=True):
        compiled = torch.compile(weigh, fullgraph=True, dynamic=True, backend=backend)
        for num_points in (5, 12, 40):
            generator = torch.Generator().manual_seed(num_points)
            points = torch.rand(num_points, 3, generator=generator)
            neighbors = torch.randint(num_points, (num_points, 4), generator=generator)
            torch.testing.assert_close(compiled(points, neighbors), weigh(points, neighbors))


@every_long_operator
def test_gil_is_released(op: Operator) -> None:
    """While one thread is inside the operator, another one runs Python, and so may be inside it, too."""
    assert op.long_call is not None
    call = op.long_call()

    def ticks_inside() -> int:
        inside: list[float] = []

        def timed() -> None:
            start = time.perf_counter()
            call()
            inside.extend((start, time.perf_counter()))

        thread = threading.Thread(target=timed)
        ticks = []
        thread.start()
        while thread.is_alive():
            ticks.append(time.perf_counter())
            time.sleep(0.001)
        start, end = inside
        margin = (end - start) / 4
        return sum(start + margin < tick < end - margin for tick in ticks)

    # With the GIL held no tick ever falls into the call, except perhaps at its very ends; without, one may be unlucky.
    assert any(ticks_inside() >= 3 for _ in range(20))


@every_long_operator
def test_two_threads_at_once_give_the_same_results(op: Operator) -> None:
    assert op.long_call is not None
    call = op.long_call(share=0.2)
    expected = call()
    with ThreadPoolExecutor(2) as pool:
        for result in pool.map(lambda _: call(), range(2)):
            torch.testing.assert_close(result, expected, rtol=0, atol=0)


@pytest.mark.slow
def test_memory_does_not_grow() -> None:
    """Hundreds of calls of each operator leave no more behind than as many did before."""
    code = """
import gc, os, sys, torch
sys.path.insert(0, "tests")
from reference import operators
torch.set_num_threads(1)
def resident_memory():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
def calls(times):
    for _ in range(times):
        for op in operators():
            op.function(**op.example | large.get(op.name, {}))
            try:
                op.function(**op.example | {next(iter(op.example)): None})
            except (TypeError, RuntimeError):
                pass
    gc.collect()
    return resident_memory()
edges, weight = torch.randint(900, (2, 4000)), torch.rand(4000)
graph = {"edge_index": edges, "weight": weight, "num_nodes": 900}
large = {op.name: graph for op in operators() if graph.keys() <= op.example.keys()}
before = calls(400)
print(calls(400) - before)
"""
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert int(result.stdout) < 2**20  # a leak of one of the graphs would be 6 MB or more


@pytest.mark.slow
def test_a_source_folder_without_binary_says_what_to_type(tmp_path: Path) -> None:
    """As after `git clone`, where Python finds the folder before an installed package."""
    checkout = tmp_path / "my checkout"
    left_out = shutil.ignore_patterns("_C*", "csrc", "models", "__pycache__")
    shutil.copytree(ROOT / "torchjoint", checkout / "torchjoint", ignore=left_out)
    shutil.copy(ROOT / "pyproject.toml", checkout)
    # An editable install, as the tests' own, would lend its binary.
    code = """
import sys
sys.meta_path[:] = [finder for finder in sys.meta_path if "Editable" not in getattr(finder, "__name__", "")]
import torchjoint.ops
"""
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=checkout)
    assert result.returncode != 0
    error = result.stderr.strip().splitlines()[-1]
    assert error.startswith(f"ImportError: this is the source folder of torchjoint, {checkout / 'torchjoint'}, and it ")
    assert "Leave the checkout (cd ..)" in error
    assert re.search(rf"pip install -e ['\"]?{re.escape(str(checkout))}['\"]?$", error)


@pytest.mark.slow
def test_missing_binary_is_explained() -> None:
    code = "import sys; sys.modules['torchjoint._C'] = None\nimport torchjoint.ops"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert result.returncode != 0
    assert "ImportError: the compiled extension torchjoint._C is missing or does not load" in result.stderr


def test_every_folder_is_packaged() -> None:
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    found = {".".join(path.parent.relative_to(ROOT).parts) for path in (ROOT / "torchjoint").rglob("__init__.py")}
    assert found | {"torchjoint.configs"} == set(listed)


LITTLE = """
import resource, torch
from torchjoint import ops
points = torch.rand(300_000, 3)
ops.nearest_neighbors(points[:100], 3)
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + 20_000_000, resource.RLIM_INFINITY))
no_edges = torch.empty(2, 0, dtype=torch.int64)
for call in (lambda: ops.nearest_neighbors(points, 2000), lambda: ops.connected_components(no_edges, 10**9)):
    try:
        call()
    except MemoryError:  # first of torch's allocator, then of C++
        print("refused")
"""


@pytest.mark.skipif(sys.platform != "linux", reason="limits of the address space are Linux's")
@pytest.mark.slow
def test_an_allocation_that_fails_is_a_memory_error() -> None:
    done = subprocess.run([sys.executable, "-c", LITTLE], capture_output=True, text=True, check=True)
    assert done.stdout == "refused\n" * 2
