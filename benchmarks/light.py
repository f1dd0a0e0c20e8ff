"""How light is the package? `python benchmarks/light.py [--check] [--runs 5]`.

Each figure of time is the median of several processes of their own, by the clock. --check, which CI runs, writes no
result; it fails if a count is above its limit, or if a package that is not needed is imported, never for a time.
"""

import argparse
import statistics
import subprocess
import sys
import time

import report
import size

#: What `import torchjoint` may not bring: they are imported where they are used.
FORBIDDEN = ("kornia", "matplotlib", "scipy", "open3d")
MOST_MODULES = 86
ROOT = report.HERE.parent

IMPORT = """
import time, torch
start = time.perf_counter()
import torchjoint
print(time.perf_counter() - start)
"""
MODULES = """
import sys, torch
before = set(sys.modules)
import torchjoint
{use}
print(*(name for name in sys.modules if name not in before))
"""
#: Prints the parameters that a run of the default reads, outside of the checks of the configuration itself.
PARAMETERS = """
import dataclasses, sys, torchjoint as tj
def stages(config):
    inner = [getattr(config, field.name) for field in dataclasses.fields(config)]
    return [config, *(stage for one in inner if dataclasses.is_dataclass(one) for stage in stages(one))]
def watched(stage):
    names = {f.name for f in dataclasses.fields(stage) if not dataclasses.is_dataclass(getattr(stage, f.name))}
    def read(self, name):
        reader = sys._getframe(1).f_globals["__name__"]
        if name in names and not reader.startswith(("torchjoint.config", "dataclasses", "copy")):
            found.add(f"{type(stage).__name__}.{name}")
        return object.__getattribute__(self, name)
    return read
scene = tj.synthetic.make_scene(0, "small").scene
config, found = tj.Config(), set()
kinds = {type(stage) for stage in stages(config)}
defaults = {kind: kind() for kind in kinds}
for kind in kinds:
    kind.__getattribute__ = watched(defaults[kind])
tj.JointSegmenter(config)(scene)
print(*sorted(found))
"""


def run(code: str) -> str:
    """What a new process with this code prints."""
    return subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, capture_output=True, text=True).stdout


def loaded(use: str = "") -> list[str]:
    """The modules that `import torchjoint` loads after `import torch`, and those that a line of code loads then."""
    return run(MODULES.format(use=use)).split()


def own(modules: list[str]) -> int:
    """How many of the modules are the package's."""
    return sum(name.split(".")[0] == "torchjoint" for name in modules)


def seconds_of_help() -> float:
    """Of `torchjoint --help`, with the start of Python."""
    start = time.perf_counter()
    run("import sys; from torchjoint.cli import main; sys.argv = ['torchjoint', '--help']; main()")
    return time.perf_counter() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--runs", type=int, default=5)
    arguments = parser.parse_args()
    modules, found = loaded(), size.sizes()
    of_segmenter = own(loaded("torchjoint.JointSegmenter"))
    of_python = [sum(values) for values in zip(*(one for name, one in found.items() if name != "C++"), strict=True)]
    unwanted = sorted({name.split(".")[0] for name in modules} & {*FORBIDDEN})
    rows = [
        [
            "`import torchjoint` after `import torch`, s",
            statistics.median(float(run(IMPORT)) for _ in range(arguments.runs)),
        ],
        ["`torchjoint --help`, s", statistics.median(seconds_of_help() for _ in range(arguments.runs))],
        ["own modules that `import torchjoint` loads", own(modules)],
        ["own modules once `torchjoint.JointSegmenter` is named", of_segmenter],
        [f"what it loads of {', '.join(FORBIDDEN)}", ", ".join(unwanted) or "nothing"],
        ["lines of Python code in `torchjoint/`, without blank ones, comments, docstrings", of_python[0]],
        ["files of Python in `torchjoint/`", of_python[1]],
        ["lines of C++", found["C++"][0]],
        ["parameters that the default reads in a small room", len(run(PARAMETERS).split())],
    ]
    table = report.Table({"what": 0, "figure": 3}, rows)
    if not arguments.check:
        report.save("light", [table], f"Times are medians of {arguments.runs} processes, by the clock.")
        return
    print(report.markdown(report.as_json(table)))
    problems = size.beyond(found)
    if of_segmenter > MOST_MODULES or unwanted:
        problems.append(f"expected at most {MOST_MODULES} own modules, none of {FORBIDDEN}")
    if problems:
        sys.exit("\n".join(problems))


if __name__ == "__main__":
    main()
