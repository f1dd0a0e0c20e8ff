"""Outputs for benchmarks/fuzz.py: whatever stands at OUT or beside it, or comes while a run works, others lose nothing.

A case puts files of a user at OUT, and below names that runs use, with markers that no run or another one wrote. Then a
run writes OUT, a file or a folder. Meanwhile something appears at OUT or changes there, the run's lock is removed, or a
second run writes OUT; and the run may be killed before any step on a file, and started again. What the run did not see
at OUT when it began, with leave to replace it, must be where it was; and OUT must be one thing, as a whole.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
from fuzz_files import FindingError

from torchjoint.results.output_folder import COMPLETE, PLACING, output_folder
from torchjoint.runtime.outputs import SOURCE, WRITTEN, LostError, Output, write_sealed

#: The files of a result, and of a run that makes it.
NAMES = ("run.yaml", "points.ply", "images/0.png", "images/1.png")
#: Names that runs have used, or use, beside OUT and in it.
BESIDE = ("out.partial", ".out.replaced", ".partial-0123456789abcdef", "out.tiles", "out.partial.txt", ".placing")
#: Steps on files, as Python tells them.
STEPS = {"os.rename", "os.link", "os.remove", "os.rmdir", "os.mkdir", "shutil.rmtree", "open"}
#: Most steps before a kill.
MOST = 60

#: What happens beside a run: it gets the paths of OUT and of the run's lock.
Meanwhile = Callable[[Path, Path], None]


def write(folder: Path, text: str, names: tuple[str, ...] = NAMES) -> None:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


def texts(folder: Path) -> dict[Path, str]:
    files = [path for path in folder.rglob("*") if path.is_file() and path.name != WRITTEN]
    return {path: path.read_text() for path in files}


def run(out: Path, kind: str, text: str, overwrite: bool, meanwhile: Meanwhile) -> None:
    """Writes OUT, as `segment` writes a result, and as `label` writes a file or a folder."""
    lock = out.with_name(".out.lock")
    if kind == "result":
        with output_folder(out, text, key=text, overwrite=overwrite) as partial:
            if partial is not None:
                write(partial, text)
                meanwhile(out, lock)
        return
    with Output(out, overwrite=overwrite).written() as path:
        write(path, text) if kind == "folder" else path.write_text(text)
        meanwhile(out, lock)


def late(out: Path, kind: str, name: str) -> None:
    """A user's file appears at OUT or in it, in place of what was there."""
    with suppress(NotADirectoryError, IsADirectoryError):
        write(out, f"mine {name}", (name,)) if kind != "file" else out.write_text(f"mine {name}")


def killed(work: Callable[[], None], folder: Path, steps: int) -> None:
    """Works in a process of its own, which ends, as by kill -9, before a step on a file of the folder."""
    process = os.fork()
    if process:
        os.waitpid(process, 0)
        return
    left = [steps]

    def hook(event: str, arguments: tuple[object, ...]) -> None:
        if event in STEPS and str(arguments[0]).startswith(str(folder)):
            left[0] -= 1
            if left[0] < 0:
                os._exit(9)

    try:
        sys.addaudithook(hook)
        work()
    finally:
        os._exit(0)


def plant(root: Path, rng: np.random.Generator) -> None:
    """Files of a user, and markers: of nobody, with the seal of another folder, or right but in a folder of a user."""
    for name in BESIDE:
        if rng.random() < 0.3:
            write(root / name, f"mine {name}", ("thesis.tex",))
            for marker in (SOURCE, COMPLETE, PLACING):
                if rng.random() < 0.4:
                    sealed = root / ("elsewhere" if rng.random() < 0.8 else ".")
                    sealed.mkdir(exist_ok=True)
                    write_sealed(sealed / marker, ("first", '["first", [["", 0, 0]]]', "")[rng.integers(3)])
                    os.rename(sealed / marker, root / name / marker)
    if rng.random() < 0.1:
        (root / ".out.lock").write_text("mine")


def output_case(index: int, seed: int, folder: Path) -> str:
    """One output; returns how it ended."""
    rng = np.random.default_rng([seed, 3, index])
    root = folder / "case"
    shutil.rmtree(root, ignore_errors=True)
    root.mkdir()
    out, kind = root / "out", ("result", "result", "folder", "file")[rng.integers(4)]
    before, overwrite = ("nothing", "earlier", "a user's")[rng.integers(3)], bool(rng.integers(2))
    plant(root, rng)
    if before != "nothing":
        names = NAMES if before == "earlier" else ("thesis.tex",)
        write(out, "earlier", names) if kind != "file" else out.write_text("earlier")
    mine = texts(root)
    # Commands check what is in a folder before they make an Output; leave to replace it is leave for all of it.
    if overwrite and (before == "earlier" or kind != "result"):
        mine = {path: text for path, text in mine.items() if out not in (path, *path.parents)}
    name = ("mine.txt", "edits.json", "run.yaml", "points.ply")[rng.integers(4)]
    events: dict[str, Meanwhile] = {
        "nothing": lambda out, lock: None,
        "appears": lambda out, lock: late(out, kind, name),
        "lock removed": lambda out, lock: unlock(lock),
        "two runs": lambda out, lock: second(out, kind, overwrite),
        "two runs, lock removed": lambda out, lock: (unlock(lock), second(out, kind, overwrite))[1],
    }
    event = list(events)[rng.integers(len(events))]
    is_killed, ended = rng.random() < 0.5, "whole"
    if is_killed:
        killed(lambda: run(out, kind, "first", overwrite, events[event]), root, int(rng.integers(MOST)))
    try:
        run(out, kind, "first", overwrite, events["nothing" if is_killed else event])
    except (FileExistsError, LostError) as error:
        ended = f"refused: {type(error).__name__}"
    if event == "appears" and not is_killed:
        written = out if kind == "file" else out / name
        is_there = written.is_file() and written.read_text() == f"mine {name}"
        if ended == "whole" or (ended == "refused: ChangedError" and not is_there):
            raise FindingError(f"outputs: {kind}, {before}, {name}: what appeared is gone, or the run did not say so")
    check(root, out, mine, kind, f"{kind}, {before}, {event}, killed {is_killed}, {ended}")
    return f"outputs: {ended}"


def unlock(lock: Path) -> None:
    """Removes the lock of a run."""
    if lock.is_file() and not lock.stat().st_size:
        lock.unlink()


def second(out: Path, kind: str, overwrite: bool) -> None:
    """Another run writes OUT; it may be refused."""
    with suppress(FileExistsError):
        run(out, kind, "second", overwrite, lambda out, lock: None)


def check(root: Path, out: Path, mine: dict[Path, str], kind: str, what: str) -> None:
    """Nothing of others is lost, and OUT is of one run or of a user, as a whole."""
    found = texts(root)
    for path, text in mine.items():
        if found.get(path) != text:
            raise FindingError(f"outputs: {what}: {path.relative_to(root)} is lost or changed")
    made = {text for path, text in found.items() if out in (path, *path.parents) and not text.startswith("mine")}
    if len(made - {""}) > 1:
        raise FindingError(f"outputs: {what}: OUT is a mixture of {', '.join(sorted(made))}")
    if kind != "file" and made & {"first", "second"} and not all((out / name).is_file() for name in NAMES):
        raise FindingError(f"outputs: {what}: OUT is not whole")
