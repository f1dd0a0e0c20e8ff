"""A result is there as a whole or not at all, wherever the run that makes it is killed; and only one run makes it."""

import errno
import json
import os
import re
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import pytest

from torchjoint.results import output_folder as module
from torchjoint.results.output_folder import STATE, output_folder, own_files
from torchjoint.runtime import outputs
from torchjoint.runtime.files import file_checksum

NEW = {"run.yaml": "new", "images/0.png": "new image", "points.ply": "new points"}
OLD = {"run.yaml": "old", "images/0.png": "old image", "images/1.png": "old image", "hierarchy.npz": "old levels"}
STEPS = {"os.rename", "os.link", "os.remove", "os.rmdir", "os.mkdir", "shutil.rmtree", "open"}


def write(folder, files):
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


def content(folder):
    return {str(p.relative_to(folder)): p.read_text() for p in folder.rglob("*") if p.is_file()}


def run(out, key="key", source="source", files=NEW, overwrite=True, inputs=(), meanwhile=lambda partial: None):
    """One run, beside which something happens; returns whether it had something to do."""
    with output_folder(out, source, key=key, overwrite=overwrite, inputs=inputs) as partial:
        if partial is None:
            return False
        (partial / STATE).mkdir(exist_ok=True)
        (partial / STATE / "sums.pt").write_text("state")
        write(partial, files)
        meanwhile(partial)
    return True


class Killed:
    """An audit hook that ends the process, as kill -9 does, before its n-th step on files below a folder."""

    def __init__(self, folder, steps):
        self.folder, self.left = str(folder), steps

    def __call__(self, event, arguments):
        if event in STEPS and str(arguments[0]).startswith(self.folder):
            if self.left == 0:
                os._exit(9)
            self.left -= 1


def killed_run(out, steps, is_fixed):
    """A run in a process of its own that is killed before a step; False if it ended before."""
    process = os.fork()
    if process == 0:
        code = 1
        try:
            if is_fixed:
                outputs.is_fixed = lambda path: True
            sys.addaudithook(Killed(out.parent, steps))
            run(out)
            code = 0
        finally:
            os._exit(code)
    code = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    assert code in (0, 9)
    return code == 9


@pytest.fixture(scope="module")
def kill():
    """Calls :func:`killed_run` in a small process, which forks many times as fast as that of the tests."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        yield lambda *arguments: pool.submit(killed_run, *arguments).result()


@pytest.fixture(params=["renamed", "mount point"])
def out(request, tmp_path, monkeypatch):
    folder = tmp_path / "o" / "out"
    folder.parent.mkdir()
    if request.param == "mount point":
        folder.mkdir()
        monkeypatch.setattr(outputs, "is_fixed", lambda path: True)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("before", [{}, OLD])
def test_killed_before_every_step(out, before, kill):
    """The next run finishes what was begun, and leaves nothing but the result."""
    steps = 0
    while True:
        module.shutil.rmtree(out, ignore_errors=True)
        out.mkdir()
        write(out, before)
        if not kill(out, steps, outputs.is_fixed(out)):
            break
        run(out)
        assert content(out) == NEW, steps
        assert list(out.parent.iterdir()) == [out], steps
        steps += 1
    assert steps > 15
    assert content(out) == NEW


@pytest.mark.slow
def test_killed_again_while_it_finishes(out, kill):
    steps = 0
    while True:
        module.shutil.rmtree(out, ignore_errors=True)
        write(out, OLD)
        if not kill(out, steps, outputs.is_fixed(out)):
            break
        for more in (1, 3, 5):
            kill(out, more, outputs.is_fixed(out))
        run(out)
        assert content(out) == NEW, steps
        assert list(out.parent.iterdir()) == [out], steps
        steps += 1
    assert steps > 15
    assert content(out) == NEW


def completed(out, overwrite=False):
    """A run that was killed after its last file."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_place", lambda *arguments: None)
        run(out, overwrite=overwrite)


def test_a_complete_result_is_not_computed_again(tmp_path):
    completed(tmp_path / "out")
    assert not run(tmp_path / "out", overwrite=False)
    assert content(tmp_path / "out") == NEW


def test_a_completed_run_replaces_what_it_was_to_replace(tmp_path):
    write(tmp_path / "out", OLD)
    completed(tmp_path / "out", overwrite=True)
    assert not run(tmp_path / "out", overwrite=False)
    assert content(tmp_path / "out") == NEW


def test_a_completed_run_stays_without_overwrite(tmp_path):
    """Its place has been taken meanwhile: nothing is lost."""
    out = tmp_path / "out"
    completed(out)
    write(out, OLD)
    with pytest.raises(FileExistsError, match="out: exists already"):
        run(out, overwrite=False)
    assert content(out) == OLD
    assert run(out, key="other")
    assert content(out) == NEW


def test_two_runs_at_once(out):
    with output_folder(out, "source", overwrite=True) as partial:
        write(partial, NEW)
        with pytest.raises(FileExistsError, match="out: another run is writing this result; wait for it"):
            run(out)
    assert content(out) == NEW
    assert run(out, overwrite=True)


def test_a_mount_point_keeps_what_is_not_ours(tmp_path, monkeypatch):
    monkeypatch.setattr(outputs, "is_fixed", lambda path: True)
    out = tmp_path / "out"
    write(out, {"thesis.tex": "precious"})
    with pytest.raises(FileExistsError, match=r"which has a run\.yaml"):
        run(out)
    assert content(out) == {"thesis.tex": "precious"}


def test_mount_points_and_read_only_folders_are_known(tmp_path, monkeypatch):
    assert outputs.is_fixed(module.Path("/dev/shm"))  # a mount point on every Linux
    assert not outputs.is_fixed(tmp_path)
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    assert outputs.is_fixed(tmp_path)


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").touch()
    expected = f"-o: {tmp_path / 'file' / 'a' / 'out'}: its folder cannot be made: Not a directory"
    with pytest.raises(NotADirectoryError, match=re.escape(expected)):
        run(tmp_path / "file" / "a" / "out")


def test_own_files_are_all_that_a_run_writes(out):
    seen = set()
    with output_folder(out, "source", overwrite=True) as partial:
        write(partial, NEW)
        seen.update(out.parent.iterdir(), out.iterdir() if out.exists() else ())
    assert seen <= own_files(out)


def test_corrections_by_hand_are_not_overwritten(tmp_path):
    out = tmp_path / "out"
    assert run(out)
    (out / "edits.json").write_text("by hand")
    with pytest.raises(FileExistsError, match=r"edits\.json: has corrections by hand; move or delete it"):
        run(out, overwrite=True, key="other")
    assert (out / "edits.json").read_text() == "by hand"


def manifest_of(out):
    names = {"files": "images/0.png", "shown": "points.ply"}
    entries = {of: {name: [(out / name).stat().st_size, file_checksum(out / name)]} for of, name in names.items()}
    return json.dumps(entries)


@pytest.mark.parametrize("name", ["images/0.png", "points.ply"])
def test_a_file_that_a_user_changed_is_not_overwritten(tmp_path, name):
    out = tmp_path / "out"
    assert run(out)
    write(out, {"manifest.json": manifest_of(out)})
    write(out, {name: "by hand"})
    with pytest.raises(ValueError, match=rf"{name}: is not as the run wrote it; move or delete it"):
        run(out, overwrite=True, key="other")
    assert content(out)[name] == "by hand"
    (out / name).unlink()
    assert run(out, overwrite=True, key="other")


@pytest.mark.parametrize("name", ["", "images"])
def test_a_read_only_folder_in_it_is_told_before_the_work(tmp_path, monkeypatch, name):
    out, access = tmp_path / "out", os.access
    assert run(out)
    monkeypatch.setattr(os, "access", lambda path, mode: access(path, mode) and path != out / name)
    with pytest.raises(PermissionError, match=rf"{out / name}: is read-only; its files cannot be replaced"):
        run(out, overwrite=True, key="other", meanwhile=lambda partial: pytest.fail("worked"))


@pytest.mark.parametrize("has_manifest", [False, True])
@pytest.mark.parametrize(
    "name", ["images/mine/a.png", "images/notes.txt", "images/.notes.md", "pieces/a.npz", "images/7.png"]
)
def test_what_a_user_put_into_its_folders_is_not_overwritten(tmp_path, name, has_manifest):
    out = tmp_path / "out"
    assert run(out)
    write(out, {name: "mine"} | ({"manifest.json": manifest_of(out)} if has_manifest else {}))
    if name != "images/7.png" or has_manifest:
        place = "images/mine" if "mine" in name else name
        with pytest.raises(FileExistsError, match=rf"out/{place}: is of no result of torchjoint; move or delete it"):
            run(out, overwrite=True, key="other")
        assert (out / name).read_text() == "mine"
        (out / name).unlink()
    (out / "images" / "mine").rmdir() if "mine" in name else None
    assert run(out, overwrite=True, key="third")


@pytest.mark.parametrize("name", ["notes.txt", "mine/chair.ply", "images.zip", ".git/config", ".notes.md"])
def test_what_a_user_put_into_a_result_is_not_overwritten(tmp_path, name):
    out = tmp_path / "out"
    assert run(out)
    write(out, {name: "mine", ".DS_Store": "of the system"})
    with pytest.raises(FileExistsError, match=rf"{name.split('/')[0]}: is of no result of torchjoint; move or delete"):
        run(out, overwrite=True, key="other")
    assert (out / name).read_text() == "mine"


def test_what_appears_while_a_run_works_stays(tmp_path):
    """Also an earlier result, which would be replaced if it had been there at the start."""
    out = tmp_path / "out"
    with pytest.raises(FileExistsError, match="out: was made or changed while this run worked, and is kept"):
        run(out, meanwhile=lambda partial: write(out, OLD))
    assert content(out) == OLD
    os.rename(out, tmp_path / "mine")
    assert not run(out, overwrite=False)  # the result has waited
    assert content(out) == NEW
    assert content(tmp_path / "mine") == OLD


@pytest.mark.parametrize("name", ["mine.txt", "edits.json", "run.yaml", "images/0.png"])
def test_what_changes_in_a_result_while_a_run_works_stays(out, name):
    write(out, OLD)
    with pytest.raises(FileExistsError, match=f"{name}: was made or changed while this run worked, and is kept"):
        run(out, meanwhile=lambda partial: write(out, {name: "by hand"}))
    assert (out / name).read_text() == "by hand"
    (out / name).unlink()
    write(out, OLD)
    assert not run(out)
    assert content(out) == NEW
    assert list(out.parent.iterdir()) == [out]


def test_what_appears_in_the_last_moment_stays(out, monkeypatch):
    """After the last check: the moves themselves replace nothing, and what was moved comes back or waits."""
    write(out, OLD)
    move = outputs.move_new

    def late(source, target):
        if target.name in ("out", "points.ply"):
            write(out, {"points.ply": "by hand"})
        move(source, target)

    monkeypatch.setattr(outputs, "move_new", late)
    with pytest.raises(FileExistsError, match="was made or changed while this run worked, and is kept"):
        run(out)
    assert (out / "points.ply").read_text() == "by hand"
    monkeypatch.undo()
    kept = content(out.parent)
    assert set(OLD.values()) | set(NEW.values()) <= set(kept.values())


@pytest.mark.parametrize("markers", [("placing.txt", "complete.txt"), ("complete.txt",), ("source.txt",)])
@pytest.mark.parametrize("overwrite", [True, False])
def test_planted_markers_delete_nothing(tmp_path, markers, overwrite):
    """A folder that was unpacked beside OUT, or is left of something else."""
    photos, planted = tmp_path / "photos", {"x.png": "theirs"}
    write(photos, {"wedding.jpg": "precious", "run.yaml": ""})
    text = f"torchjoint {photos.stat().st_ino}\n"
    for name in markers:
        planted[name] = f'{text}["key", [["", 0, 0]]]'
    write(tmp_path / "photos.partial", planted)
    before = content(tmp_path)
    with pytest.raises(
        FileExistsError,
        match=r"photos(: exists already|/wedding.jpg: is of no result|\.partial: expected the folder of an earlier)",
    ):
        run(photos, overwrite=overwrite)
    assert content(tmp_path) == before


def test_names_beside_a_result_are_not_touched(tmp_path):
    mine = {".out.replaced/thesis.tex": "precious", ".out.lock": "", ".placing.txt": "mine"}
    write(tmp_path, mine)
    write(tmp_path / "out", OLD | {"complete.txt": "key"})
    assert run(tmp_path / "out")
    assert content(tmp_path / "out") == NEW
    assert (tmp_path / ".out.replaced" / "thesis.tex").read_text() == "precious"


def test_a_copy_of_an_interrupted_run_is_not_used(tmp_path):
    completed(tmp_path / "out")
    module.shutil.copytree(tmp_path / "out.partial", tmp_path / "two.partial")
    with pytest.raises(FileExistsError, match=r"two\.partial: expected the folder of an earlier run; move it"):
        run(tmp_path / "two")
    assert content(tmp_path / "two.partial") == content(tmp_path / "out.partial")


def lock_of(out):
    return next(path for path in own_files(out) if path.name.endswith(".lock"))


def test_a_lock_that_was_removed(out):
    """Two runs then work in one folder: the first one says why its files are gone, and spoils nothing."""

    def meanwhile(partial):
        lock_of(out).unlink()
        assert run(out, source="other")
        (partial / "points.ply").write_text("half")

    with pytest.raises(OSError, match=r"\.lock: was removed while this run worked; another run may have taken"):
        run(out, meanwhile=meanwhile)
    assert content(out) == NEW


def test_a_lock_of_another_run_stays(out):
    def meanwhile(partial):
        lock_of(out).unlink()
        lock_of(out).touch()

    with pytest.raises(OSError, match=r"\.lock: was removed while this run worked"):
        run(out, meanwhile=meanwhile)
    assert lock_of(out).exists()


@pytest.mark.parametrize("given", ["out", "out/recording", "link"])
def test_a_result_is_not_its_input(tmp_path, given):
    write(tmp_path / "out", OLD | {"recording/a.png": "pixels"})
    (tmp_path / "link").symlink_to("out/recording")
    before = content(tmp_path / "out")
    expected = r"-o: expected (another path than the input's|a folder that does not contain)"
    with pytest.raises(ValueError, match=expected):
        run(tmp_path / "out", inputs=(tmp_path / given,))
    assert content(tmp_path / "out") == before


def test_corrections_that_come_after_the_check_stay(out, monkeypatch):
    write(out, OLD)
    check = module._check_replaceable

    def late(*arguments):
        check(*arguments)
        write(out, {"edits.json": "by hand"})

    monkeypatch.setattr(module, "_check_replaceable", late)
    with pytest.raises(FileExistsError, match=r"edits\.json: was made or changed while this run worked"):
        run(out)
    assert content(out).items() >= {**OLD, "edits.json": "by hand"}.items()


def test_a_lock_of_another_program_is_kept(tmp_path):
    run(tmp_path / "out")
    (tmp_path / "out" / ".other.lock").touch()
    run(tmp_path / "out", key="second")
    (tmp_path / "out" / ".other.lock").write_text("mine")
    with pytest.raises(FileExistsError, match=r"\.other\.lock: is of no result of torchjoint"):
        run(tmp_path / "out", key="third")
    assert (tmp_path / "out" / ".other.lock").read_text() == "mine"


@pytest.mark.parametrize("named", [None, "/elsewhere"])
def test_a_full_disk_is_told_with_the_folder(tmp_path, named):
    def fill(partial):
        raise OSError(errno.EFBIG, "File too large", named)

    with pytest.raises(OSError, match="File too large") as raised:
        run(tmp_path / "out", meanwhile=fill)
    assert raised.value.filename == (named or str(tmp_path / "out.partial"))
