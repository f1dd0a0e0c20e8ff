"""Random inputs to the compiled operators, and damaged files to all readers: nothing may crash, or be silently wrong.

    python benchmarks/fuzz.py --operators 1000000 --files 100000 --results 10000 --outputs 10000 --foreign 10000
        --state fuzz.json

* Operators get arguments that are right, with random changes of values, shapes, dtypes and strides: through the
  wrappers and through ``torch.ops``. An error must be a clear one; a result must be that of the slow twin, if there is
  one.
* Files are the samples of tests/samples, clouds, and the state and result of a run; bytes are cut, flipped and
  replaced. A reader must raise a clear error, or read what can be right (benchmarks/fuzz_files.py).
* Files are replaced by dead links, pipes, devices, EPS and bombs (benchmarks/fuzz_foreign.py).
* Results are tampered with, as are corrections and names of frames (benchmarks/fuzz_results.py).
* Outputs are written where others have files, markers or locks, where something appears meanwhile, by two runs at once,
  and by runs that are killed (benchmarks/fuzz_outputs.py).

Case i depends on the seed and on i alone. The work is done in a process of its own; if it dies, the case is a finding,
and the work goes on behind it. With --state an interrupted campaign goes on where it was. .ci/sanitize runs it, too.
"""

from __future__ import annotations

import argparse
import inspect
import json
import math
import multiprocessing
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from fuzz_files import FindingError, file_case, make_samples
from fuzz_foreign import Foreign, foreign_case
from fuzz_outputs import output_case
from fuzz_results import Results, result_case

from torchjoint.runtime.files import write_text

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

#: Cases between two saves of the state.
BLOCK = 500

#: What an operator may raise; torch.ops also has its own errors of types and shapes.
CLEAR = (ValueError, TypeError)
DTYPES = (torch.float32, torch.float64, torch.int32, torch.int64, torch.uint8, torch.bool, torch.float16)
#: Operators whose result is not unique for odd inputs (the normal of points on a line); tests/ops judges them.
AMBIGUOUS = ("fit_normals", "region_planes")
ODD = (math.nan, math.inf, -math.inf, -0.0, 0.0, 1e30, -1e30, 1e-40, 1.0)


def changed_tensor(value: torch.Tensor, rng: np.random.Generator, values_only: bool) -> torch.Tensor:
    """A tensor with other values, and perhaps of another shape, dtype or layout."""
    value, kind = value.clone(), rng.integers(3 if values_only else 8)
    flat = value.view(-1)
    if kind == 0 and len(flat):  # shuffled
        return flat[torch.from_numpy(rng.permutation(len(flat)))].view(value.shape)
    if kind == 1 and len(flat):  # one other value
        place = int(rng.integers(len(flat)))
        if value.is_floating_point():
            flat[place] = float(rng.choice(ODD)) if rng.integers(2) else float(rng.normal())
        elif value.dtype == torch.bool:
            flat[place] = not flat[place]
        elif value.dtype == torch.uint8:
            flat[place] = int(rng.integers(256))
        else:
            flat[place] = int(rng.integers(-2, 5)) if rng.integers(8) else int(rng.choice([2**31 - 1, -(2**31), 100]))
        return value
    if kind == 2 and value.is_floating_point():
        return torch.from_numpy(rng.normal(size=tuple(value.shape))).to(value.dtype).abs()
    if kind == 3:
        return value.to(DTYPES[rng.integers(len(DTYPES))])
    if kind == 4 and value.ndim:  # fewer, more or no rows
        rows = int(rng.integers(0, 2 * len(value) + 1))
        return value[torch.from_numpy(rng.integers(0, max(len(value), 1), rows))] if len(value) else value
    if kind == 5 and value.ndim:
        return value.transpose(0, -1)
    if kind == 6:
        return torch.stack([value, value], -1)[..., 0]  # the same values, with gaps between them
    return value[None] if kind == 7 else value


def changed_number(value: float, rng: np.random.Generator, values_only: bool) -> Any:
    if isinstance(value, (bool, int)):
        return int(rng.integers(0, 6)) if values_only else int(rng.choice([-1, 0, 1, 2**31, 2**62, 7]))
    return float(rng.uniform(0, 3)) if values_only else float(rng.choice(ODD))


def operator_case(index: int, seed: int) -> str:
    """One call of an operator; returns how it ended."""
    from reference import operators

    rng = np.random.default_rng([seed, index])
    known = operators()
    operator = known[rng.integers(len(known))]
    # Copies, as an operator may change its arguments, and several threads call this at once.
    arguments, values_only = copies(operator.example), bool(rng.integers(2))
    for name, value in arguments.items():
        if rng.random() < 0.4:
            change = changed_tensor if isinstance(value, torch.Tensor) else changed_number
            arguments[name] = change(value, rng, values_only)
    if rng.random() < 0.3:
        try:
            operator.kernel(*arguments.values())
        except (*CLEAR, RuntimeError, NotImplementedError, IndexError):
            return "torch.ops: error"
        return "torch.ops: result"
    given = copies(arguments)
    try:
        result = operator.function(**arguments)
    except CLEAR as error:
        if not str(error):
            raise FindingError("an error without words") from error
        return "wrapper: error"
    twin = operator.twin
    if operator.name in AMBIGUOUS or twin is None or set(inspect.signature(twin).parameters) < set(arguments):
        return "wrapper: result, without a twin"
    compare(operator.name, result, twin(**given))
    compare(operator.name, *(tuple(values.values()) for values in (arguments, given)))
    return "wrapper: result of the twin"


def copies(arguments: dict[str, Any]) -> dict[str, Any]:
    return {name: value.clone() if isinstance(value, torch.Tensor) else value for name, value in arguments.items()}


def compare(operator: str, result: Any, expected: Any) -> None:
    pairs = zip(
        result if isinstance(result, tuple) else (result,),
        expected if isinstance(expected, tuple) else (expected,),
        strict=True,
    )
    for one, other in pairs:
        if isinstance(one, torch.Tensor):
            if one.is_floating_point():
                if not torch.allclose(one, other.to(one.dtype), equal_nan=True, rtol=1e-4, atol=1e-5):
                    raise FindingError(f"{operator}: {one} instead of {other}")
            elif not torch.equal(one, other.to(one.dtype)):
                raise FindingError(f"{operator}: {one} instead of {other}")
        elif isinstance(one, (list, tuple)):
            compare(operator, tuple(one), tuple(other))
        elif one is not other and not math.isclose(one, other, rel_tol=1e-6, abs_tol=1e-9):
            raise FindingError(f"{operator}: {one} instead of {other}")


#: What makes the samples of a kind of cases, and what does one of them.
KINDS: dict[str, tuple[Callable[[Path], Any], Callable[[int, int, Any], str]]] = {
    "operators": (lambda _: None, lambda index, seed, _: operator_case(index, seed)),
    "files": (make_samples, file_case),
    "results": (Results, result_case),
    "outputs": (lambda folder: folder, output_case),
    "foreign": (Foreign, foreign_case),
}


def worker(begin: int, end: int, seed: int, kind: str, place: Any, connection: Any) -> None:
    """Does the cases from `begin` to `end`; `place` is the case that is being done."""
    torch.set_num_threads(1)
    counts: Counter[str] = Counter()
    findings: list[str] = []
    folder = Path(tempfile.mkdtemp())
    try:
        make, case = KINDS[kind]
        made = make(folder)
        for index in range(begin, end):
            place.value = index
            try:
                counts[case(index, seed, made)] += 1
            except Exception as error:
                findings.append(f"{kind} {index}: {type(error).__name__}: {str(error)[:300]}")
            if (index + 1 - begin) % BLOCK == 0 or index + 1 == end:
                connection.send((index + 1, dict(counts), findings))
                counts, findings = Counter(), []
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def blocks(begin: int, end: int, seed: int, kind: str) -> Iterator[tuple[int, dict[str, int], list[str]]]:
    """Does the cases in processes of their own; yields how far it is, counts and findings."""
    context = multiprocessing.get_context("spawn")
    while begin < end:
        place, (ours, theirs) = context.Value("q", begin), context.Pipe(duplex=False)
        process = context.Process(target=worker, args=(begin, end, seed, kind, place, theirs))
        process.start()
        theirs.close()
        try:
            while True:
                begin, counts, findings = ours.recv()
                yield begin, counts, findings
        except EOFError:
            process.join()
        if process.exitcode:
            yield place.value + 1, {}, [f"{kind} {place.value}: the process died ({process.exitcode})"]
            begin = place.value + 1


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--operators", type=int, default=1_000_000)
    parser.add_argument("--files", type=int, default=100_000)
    parser.add_argument("--results", type=int, default=10_000)
    parser.add_argument("--outputs", type=int, default=10_000)
    parser.add_argument("--foreign", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--state", type=Path)
    arguments = parser.parse_args()
    state: dict[str, Any] = {
        "operators": 0,
        "files": 0,
        "results": 0,
        "outputs": 0,
        "foreign": 0,
        "counts": {},
        "findings": [],
        "seed": arguments.seed,
    }
    if arguments.state is not None and arguments.state.is_file():
        state |= json.loads(arguments.state.read_text())
        if state["seed"] != arguments.seed:
            sys.exit(f"{arguments.state}: of seed {state['seed']}")
    for kind in KINDS:
        for done, counts, findings in blocks(state[kind], getattr(arguments, kind), arguments.seed, kind):
            state[kind] = done
            for name, count in counts.items():
                state["counts"][name] = state["counts"].get(name, 0) + count
            state["findings"] += findings
            for finding in findings:
                print(finding, flush=True)
            if arguments.state is not None:
                write_text(arguments.state, json.dumps(state, indent=1))
    found = len(state["findings"])
    print(f"{state['operators']} inputs of operators, {state['files']} damaged files, ", end="")
    print(
        f"{state['results']} tampered results, {state['outputs']} outputs, {state['foreign']} foreign files, ", end=""
    )
    print(f"{found} findings")
    for name, count in sorted(state["counts"].items()):
        print(f"  {name}: {count}")
    sys.exit(1 if state["findings"] else 0)


if __name__ == "__main__":
    main()
