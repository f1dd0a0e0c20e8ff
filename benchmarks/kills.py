"""Kills `torchjoint segment` at random times, and checks that starting it again always ends with the same files.

A recording without a cloud is segmented: fusion, frames, step 6, writing, and in every second round the replacement of
an earlier result. Each run is killed (SIGKILL) in a random stage, and again with a chance of one half, until a last run
is left to end. All files must then be those of a run that nobody disturbed, byte for byte (except for the seconds in
run.yaml), and nothing else may be left beside them but a user's files, which were there before.

    python benchmarks/kills.py --kills 100 --state kills.json

With --state an interrupted campaign goes on where it was; kills are counted when their result has ended well. The
package is imported once, and each run is a fork (of a process that has run nothing of it: a fork of threads may hang).
Prints how often which stage was hit.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

from torchjoint.cli import main
from torchjoint.results.output_folder import COMPLETE, PLACING
from torchjoint.runtime.files import write_text

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

STAGES = ["starting, or ended", "fusing", "frames", "step 6", "writing", "replacing"]
#: Files of a user beside OUT, below names that runs have used for themselves.
MINE = (".out.replaced/thesis.tex", ".partial-mine", "complete.txt")
OPTIONS = ["--voxel-size", "0.1", "--set", "boundary.detector=gradient"]


def forked(work: Callable[[], None], log: Path) -> int:
    """Starts work in a process of its own."""
    process = os.fork()
    if process:
        return process
    code = 1
    try:
        with log.open("ab") as stream:
            os.dup2(stream.fileno(), 1)
            os.dup2(stream.fileno(), 2)
        work()
        code = 0
    except SystemExit as error:
        print(error)
    finally:
        sys.stdout.flush()
        os._exit(code)


def segment(recording: Path, out: Path, log: Path, *more: str) -> int:
    def work() -> None:
        sys.argv = ["torchjoint", "segment", str(recording), "-o", str(out), *more, *OPTIONS]
        main()

    return forked(work, log)


def must_end(process: int, log: Path) -> None:
    code = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    if code:
        sys.exit(f"a run ended with {code}:\n{log.read_text(errors='replace')[-2000:]}")


def make_recording(folder: Path) -> None:
    from dataclasses import replace

    from folder_files import write_folder

    import torchjoint as tj

    made = tj.synthetic.make_scene(seed=4)
    frames = [replace(frame, name="") for frame in made.scene.frames] * 2
    write_folder(folder, replace(made, scene=replace(made.scene, frames=frames, truth=None)), cloud=False)


def contents(out: Path) -> dict[str, bytes]:
    """The files of a result; run.yaml without the seconds."""
    files = {str(path.relative_to(out)): path.read_bytes() for path in sorted(out.rglob("*")) if path.is_file()}
    record = yaml.safe_load(files["run.yaml"])
    del record["seconds"], record["thread_seconds"]
    return files | {"run.yaml": yaml.safe_dump(record).encode()}


def stage(out: Path) -> str:
    """What a run was doing when it was killed."""
    partial = out.with_name(f"{out.name}.partial")
    if (partial / COMPLETE).is_file() or (partial / PLACING).is_file() or (out / COMPLETE).is_file():
        return "replacing"
    if not partial.is_dir():
        return STAGES[0]
    if (partial / "points.ply").is_file():
        return "writing"
    if not list(partial.glob("cloud-*.ply")):
        return "fusing"
    saved = len(list((partial / "state" / "frames").glob("observation-*.pt")))
    return "frames" if saved < 12 else "step 6"


def kill(process: int, out: Path, seconds: float, rng: random.Random) -> bool:
    """Kills a run soon after a random stage has begun; False if it had ended before.

    Times that are uniform over the run would nearly all fall into the longest stage; with a logarithm that is uniform,
    from a ten-thousandth of a quarter of the run on, stages of milliseconds are hit, too.
    """
    wanted, end = rng.randrange(len(STAGES)), time.monotonic() + 20 * seconds
    while STAGES.index(stage(out)) < wanted and time.monotonic() < end:
        if os.waitid(os.P_PID, process, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None:
            break
        time.sleep(0.001)
    time.sleep(10 ** -rng.uniform(0, 4) * seconds / 4)
    os.kill(process, signal.SIGKILL)
    return os.waitpid(process, 0)[1] == signal.SIGKILL


def kill_and_end(folder: Path, again: bool, most: int, seconds: float, rng: random.Random) -> Counter[str]:
    """Kills the runs of one result, at most so often, and lets a last one end; returns what they were doing."""
    recording, out, log, hit = folder / "recording", folder / "results" / "out", folder / "log.txt", Counter[str]()
    shutil.rmtree(out.parent, ignore_errors=True)
    for name in MINE:
        (out.parent / name).parent.mkdir(parents=True, exist_ok=True)
        (out.parent / name).write_text("mine")
    if again:
        shutil.copytree(folder / "earlier", out)
    while sum(hit.values()) < most:
        process = segment(recording, out, log, "--overwrite")
        if not kill(process, out, seconds, rng):
            break
        hit[stage(out)] += 1
        if rng.random() < 0.5:
            break
    must_end(segment(recording, out, log, "--overwrite"), log)
    if contents(out) != contents(folder / "expected"):
        sys.exit(f"after kills while {', '.join(hit)} the result differs")
    if {path.name for path in out.parent.iterdir()} != {"out", *(name.split("/")[0] for name in MINE)}:
        sys.exit(f"left behind: {sorted(path.name for path in out.parent.iterdir())}")
    if any((out.parent / name).read_text() != "mine" for name in MINE):
        sys.exit(f"after kills while {', '.join(hit)} the files of the user differ")
    return hit


def main_() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--state", type=Path)
    arguments = parser.parse_args()
    state: dict[str, Any] = {"results": 0, "kills": {}}
    if arguments.state is not None and arguments.state.is_file():
        state = json.loads(arguments.state.read_text())
    hit = Counter[str](state["kills"])
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        recording, log = folder / "recording", folder / "log.txt"
        must_end(forked(lambda: make_recording(recording), log), log)
        must_end(segment(recording, folder / "expected", log), log)
        must_end(segment(recording, folder / "earlier", log, "--max-frames", "2"), log)
        start = time.monotonic()
        must_end(segment(recording, folder / "again", log), log)
        seconds = time.monotonic() - start
        print(f"a run takes {seconds:.1f} s", flush=True)
        if contents(folder / "again") != contents(folder / "expected"):
            sys.exit("two runs that nobody disturbed differ")
        while sum(hit.values()) < arguments.kills:
            rng = random.Random(f"{arguments.seed} {state['results']}")
            hit += kill_and_end(folder, state["results"] % 2 == 0, arguments.kills - sum(hit.values()), seconds, rng)
            state = {"results": state["results"] + 1, "kills": dict(hit)}
            if arguments.state is not None:
                write_text(arguments.state, json.dumps(state, indent=1))
        number = len(contents(folder / "expected"))
    print(f"{sum(hit.values())} kills in {state['results']} results, each of which ended with the same {number} files")
    for name, count in hit.most_common():
        print(f"  while {name}: {count}")


if __name__ == "__main__":
    main_()
