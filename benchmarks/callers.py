"""Calls the operators from several Python threads at once: each result must be that of a single caller.

    python benchmarks/callers.py --cases 2000 --threads 4

The inputs are those of benchmarks/fuzz.py, right ones and wrong ones. `.ci/sanitize PYTHON thread` runs it under the
thread sanitizer, which finds unguarded shared memory even where nothing goes wrong. Each operation runs in one thread:
the sanitizer does not see how OpenMP, which is not compiled with it, makes threads wait for each other.
"""

from __future__ import annotations

import argparse
import threading
from concurrent.futures import ThreadPoolExecutor

import torch
from fuzz import operator_case


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=2000)
    parser.add_argument("--threads", type=int, default=4)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    expected = [operator_case(case, arguments.seed) for case in range(arguments.cases)]
    start = threading.Barrier(arguments.threads)

    def caller(_: int) -> list[str]:
        start.wait()
        return [operator_case(case, arguments.seed) for case in range(arguments.cases)]  # all at the same case

    with ThreadPoolExecutor(arguments.threads) as pool:
        for found in pool.map(caller, range(arguments.threads)):
            assert found == expected
    print(f"{arguments.cases} inputs of operators from {arguments.threads} threads at once: as from one")


if __name__ == "__main__":
    main()
