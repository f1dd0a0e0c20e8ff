"""Many recordings: each has its result, or the reason why not; what is done is skipped."""

import csv
import importlib
import io
import itertools
import os
import shutil
import sys
import time
import warnings
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import nullcontext, suppress
from functools import partial
from pathlib import Path

import joblib
import pytest
import torch
from folder_files import write_scans

import torchjoint as tj
from torchjoint.datasets.files.ply import write_cloud
from torchjoint.engine import Engine
from torchjoint.recordings import find_recordings, segment_recording
from torchjoint.runtime.files import write_text
from torchjoint.runtime.foreign_files import csv_text
from torchjoint.runtime.outputs import lock
from torchjoint.scene.scene import voxel_subsample


class HereExecutor(Executor):
    """Runs its tasks at once, in this process."""

    def __init__(self):
        self.started, self._max_workers = 0, 1

    def submit(self, function, /, *arguments):
        self.started += 1
        future, threads = Future(), torch.get_num_threads()
        future.set_result(function(*arguments))
        torch.set_num_threads(threads)
        return future


@pytest.fixture(scope="module")
def scans(scene_of, tmp_path_factory):
    folder = write_scans(tmp_path_factory.mktemp("scans") / "scans", scene_of(2))
    (folder / "b" / "cloud.ply").write_text("no cloud")
    return folder


def table(file):
    with file.open() as stream:
        return {row["scene"]: row for row in csv.DictReader(stream)}


QUICK = tj.Config().set(["boundary.detector=gradient"])


@pytest.fixture(scope="module")
def done(scans, tmp_path_factory):
    out = tmp_path_factory.mktemp("batch") / "out"
    report = tj.batch(
        scans,
        out,
        engine=HereExecutor(),
        config=QUICK,
        options=tj.RecordingOptions(max_frames=1, thin=0.2, up=(0, 0, 1)),
    )
    return out, report


def test_a_failure_stops_no_other(done, scans):
    out, report = done
    assert list(report.failures) == ["b"]
    assert "cloud.ply: not a PLY file" in report.failures["b"]
    assert table(out / "failures.csv")["b"]["reason"] == report.failures["b"]
    assert sorted(path.name for path in out.iterdir()) == ["a", "batch.yaml", "c", "failures.csv", "summary.csv"]
    rows = table(out / "summary.csv")
    assert list(rows) == ["a", "c"]
    result = tj.load_result(out / "a")
    assert int(rows["a"]["points"]) == len(result.points) == report.reports["a"].points
    assert (rows["a"]["frames"], int(rows["a"]["segments"])) == ("1", int(result.points.max()) + 1)
    assert float(rows["a"]["seconds: segment"]) > 0
    assert float(rows["a"]["peak_memory_mb"]) > 10


def test_the_workers_of_a_machine_share_its_memory(scans, tmp_path, monkeypatch):
    budgets = []

    def segment(*arguments, memory, **options):
        budgets.append(memory)
        raise ValueError("enough")

    monkeypatch.setattr(tj.recordings.one_scene, "segment_recording", segment)
    monkeypatch.setattr("torchjoint.recordings.one_scene.as_bytes", lambda memory: 12_000 if memory is None else memory)
    for on_machine in (1, 4, None):  # None: a cluster; its machines may run a task on each core
        tj.batch(scans / "a", tmp_path, engine=Engine("here", HereExecutor(), lambda: 1, 1, on_machine))
    assert budgets == [12_000, 3_000, 12_000 // joblib.cpu_count()]


def test_threads_keep_each_warning_with_its_recording(tmp_path, monkeypatch):
    """Recordings with wrong poses had results, others their warnings; then no warning was shown any more."""

    def segment(path, *_, **__):
        with tj.recordings.segment._poses_must_fit():
            time.sleep(0.05 * " abcd".index(path.name))  # the first ends while the others work
            warnings.warn(path.name, tj.PoseWarning, stacklevel=1)

    monkeypatch.setattr(tj.recordings.one_scene, "segment_recording", segment)
    for name in "abcd":
        (tmp_path / name).mkdir()
    before = warnings.showwarning, [*warnings.filters]
    with ThreadPoolExecutor(4) as threads:
        report = tj.batch([tmp_path / name for name in "abcd"], tmp_path / "out", engine=threads)
    told = "; --ignore-poses segments it all the same"
    assert report.failures == {name: name + told for name in "abcd"}
    assert (warnings.showwarning, [*warnings.filters]) == before


def test_what_is_done_is_skipped(done, scans):
    out, _ = done
    before, engine = (out / "summary.csv").read_text(), HereExecutor()
    again = tj.batch(
        scans, out, engine=engine, config=QUICK, options=tj.RecordingOptions(max_frames=1, thin=0.2, up=(0, 0, 1))
    )
    assert engine.started == 1  # b, once more
    assert again.skipped == ("a", "c")
    assert list(again.failures) == ["b"]
    assert (out / "summary.csv").read_text() == before


def test_a_result_that_others_write_meanwhile_is_no_success(done, scans, tmp_path):
    """A result of other parameters, which `segment` wrote while the batch worked, counted as one of the batch."""

    class LateExecutor(HereExecutor):
        def submit(self, *arguments):
            shutil.copytree(done[0] / "a", tmp_path / "a")
            return super().submit(*arguments)

    report = tj.batch(scans / "a", tmp_path, engine=LateExecutor(), config=QUICK)
    assert not report.reports
    assert "got that of" in report.failures["a"]
    assert "other options or models" in report.failures["a"]


def test_a_table_tells_of_lost_files_and_what_was_told(scene_of, tmp_path):
    cloud = write_scans(tmp_path / "scans", scene_of(2)) / "a" / "cloud.ply"
    cloud.write_bytes(cloud.read_bytes().replace(b"element", b"comment unit: mm\nelement", 1))
    options = tj.RecordingOptions(max_frames=1, thin=0.2, up=(0, 0, 1))
    out, scans = tmp_path / "out", tmp_path / "scans"
    call = partial(tj.batch, out=out, engine=HereExecutor(), config=QUICK, options=options)
    first = call(scans / "a").reports["a"].warnings
    assert first
    (out / "a" / "points.ply").unlink()
    for _ in range(2):
        assert call(scans / "a").reports["a"].warnings == (*first, "points.ply is missing in the result")
    row = table(out / "summary.csv")["a"]
    assert list(call(scans / "c").reports) == ["c"]  # a batch of another scene
    assert table(out / "summary.csv") | {"c": None} == {"a": row, "c": None}
    most = csv.field_size_limit(3)  # a cell of more characters, such as many warnings, is an error of Python's reader
    try:
        assert list(call(scans / "a").reports) == ["a"]
    finally:
        csv.field_size_limit(most)


def test_other_parameters_are_not_mixed(done, scans):
    with pytest.raises(ValueError, match=r"out: expected the parameters of .*batch\.yaml"):
        tj.batch(scans, done[0], engine=HereExecutor(), config=QUICK)
    with pytest.raises(FileExistsError, match="a is the result of one recording"):
        tj.batch(scans, done[0] / "a", engine=HereExecutor())
    with lock(done[0] / ".batch.lock", ""), pytest.raises(FileExistsError, match="another batch is writing"):
        tj.batch(scans, done[0], engine=HereExecutor())


def test_a_file_of_parameters_is_no_config(scans, tmp_path):
    with pytest.raises(TypeError, match=r"config: expected a Config, got str; Config\.from_yaml reads a file"):
        tj.batch(scans, tmp_path / "out", engine=HereExecutor(), config="mine.yaml")
    assert not (tmp_path / "out").exists()


def test_a_model_that_was_trained_anew_is_another_parameter(tmp_path):
    """The results of the earlier model were taken for done."""
    model, scans = tmp_path / "mine.npz", tmp_path / "scans"
    scans.mkdir()
    (scans / "a.ply").write_text("no cloud")
    config = tj.Config().set([f"point_segments.method={model}"])
    for content in (b"one", b"two"):
        model.write_bytes(content)
        with pytest.raises(ValueError, match="expected the parameters of") if content == b"two" else nullcontext():
            tj.batch(scans / "a.ply", tmp_path / "out", engine=HereExecutor(), config=config)


@pytest.mark.parametrize("name", ["batch.yaml", "summary.csv", "failures.csv"])
@pytest.mark.parametrize("overwrite", [False, True])
def test_tables_of_others_stay(scans, tmp_path, name, overwrite):
    (tmp_path / name).write_text("precious: 1")
    with pytest.raises(
        FileExistsError, match=rf"{name}: is (of no|not as a) batch.*; move it, or choose another folder"
    ):
        tj.batch(scans, tmp_path, engine=HereExecutor(), overwrite=overwrite)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_text() == "precious: 1"


def test_notes_in_a_table_stay(scans, tmp_path, monkeypatch):
    """A user writes a column into the table, between two batches or while one works."""
    segment, options = (
        tj.recordings.one_scene.segment_recording,
        tj.RecordingOptions(max_frames=1, thin=0.2, up=(0, 0, 1)),
    )
    batch = partial(tj.batch, scans / "a", tmp_path, engine=HereExecutor(), config=QUICK, options=options)
    assert batch().reports
    assert batch().skipped == ("a",)  # its own table is known
    kept = tmp_path / "summary.csv"

    def late(*arguments, **others):
        kept.write_text("mine")
        return segment(*arguments, **others)

    monkeypatch.setattr(tj.recordings.one_scene, "segment_recording", late)
    with pytest.warns(UserWarning, match=r"summary\.csv: is not as a batch wrote it, and is kept"):
        assert batch(overwrite=True).reports
    with pytest.raises(FileExistsError, match=r"summary\.csv: is not as a batch wrote it"):
        batch(overwrite=True)
    assert kept.read_text() == "mine"


def test_a_kill_between_the_files_of_a_batch(scans, tmp_path, monkeypatch):
    options = tj.RecordingOptions(max_frames=1, thin=0.2, up=(0, 0, 1))
    batch = partial(tj.batch, out=tmp_path, engine=HereExecutor(), config=QUICK, options=options)
    batch(scans / "a")
    for scene, count in itertools.product([scans / "c", scans / "b", scans], range(1, 4)):
        left = [*range(count)]

        def write(path, text, left=left):
            if not left:
                raise KeyboardInterrupt
            left.pop()
            write_text(path, text)

        monkeypatch.setattr(importlib.import_module("torchjoint.recordings.batch"), "write_text", write)
        with suppress(KeyboardInterrupt):
            batch(scene)
    monkeypatch.undo()
    assert list(batch(scans).failures) == ["b"]
    assert list(table(tmp_path / "summary.csv")) == ["a", "c"]


def test_the_command(done, scans, run, capsys):
    options = ["-o", done[0], "--max-frames", 1, "--thin", 0.2, "--up", 0, 0, 1, "--set", "boundary.detector=gradient"]
    run("batch", scans / "a", scans / "c", *options)  # nothing to do: no worker starts
    text = capsys.readouterr().out
    assert "0 segmented, 2 were done before, 0 failed" in text
    assert list(table(done[0] / "failures.csv")) == ["b"]  # of an earlier batch
    with pytest.raises(SystemExit, match=r"engine: expected loky, dask or ray .*, got 'slurm'"):
        run("batch", scans / "b", *options, "--engine", "slurm")


def test_the_exit_code_of_the_command_tells_of_failures(done, scans, run, capsys, monkeypatch):
    out, report = done
    monkeypatch.setattr(importlib.import_module("torchjoint.cli.batch"), "run_batch", lambda *_, **__: report)
    with pytest.raises(SystemExit) as ended:
        run("batch", scans, "-o", out)
    assert ended.value.code == 1
    text = capsys.readouterr().out
    assert "2 segmented, 0 were done before, 1 failed" in text
    assert report.failures["b"] in text


def test_the_command_chooses_topics(scans, tmp_path, run, monkeypatch):
    given = []
    monkeypatch.setattr(
        importlib.import_module("torchjoint.cli.batch"), "run_batch", lambda *_, options, **__: given.append(options)
    )
    monkeypatch.setattr(importlib.import_module("torchjoint.cli.batch"), "_print", lambda report: sys.exit("printed"))
    chosen = ["--topics", "color=/front/image", "info=/front/info", "--time-limit", 0.1]
    with pytest.raises(SystemExit, match="printed"):
        run("batch", scans / "a", "-o", tmp_path / "out", *chosen)
    topics = (("color", "/front/image"), ("info", "/front/info"))
    assert given == [tj.RecordingOptions(topics=topics, time_limit=0.1)]
    with pytest.raises(SystemExit, match=r"--topics: expected ROLE=TOPIC, such as .*, got 'color'"):
        run("batch", scans / "a", "-o", tmp_path / "out", "--topics", "color")


class TestScenes:
    def test_patterns_data_sets_and_lists(self, scans, tmp_path):
        assert find_recordings(scans / "a") == {"a": scans / "a"}
        assert list(find_recordings(scans)) == ["a", "b", "c"]
        (scans / "notes.txt").write_text(f"# two of them\na\n\n{scans}/[c]\n")
        assert list(find_recordings(scans / "notes.txt")) == ["a", "c"]
        assert list(find_recordings(f"{scans}/*")) == ["a", "b", "c"]  # not notes.txt
        assert list(find_recordings([f"{scans}/*", scans / "a"])) == ["a", "b", "c"]
        (tmp_path / "cloud.txt").write_text("0.5, 1e-3 -2 255\n")
        assert find_recordings(tmp_path / "cloud.txt") == {"cloud": tmp_path / "cloud.txt"}

    def test_names(self, scans, tmp_path):
        (tmp_path / "more").mkdir()
        (tmp_path / "more" / "a").symlink_to(scans / "a")
        assert list(find_recordings([scans / "a", tmp_path / "more" / "a"])) == ["scans-a", "more-a"]
        assert find_recordings(tmp_path / "gone") == {"gone": tmp_path / "gone"}
        with pytest.raises(ValueError, match=r"scenes: .*/x\* matches no recording"):
            find_recordings(str(tmp_path / "x*"))
        with pytest.raises(ValueError, match="at least one recording"):
            find_recordings([])

    def test_names_that_are_nearly_the_same(self, tmp_path, monkeypatch):
        """Two files of one name, two names that a disk takes for one, and one recording by two paths."""
        monkeypatch.chdir(tmp_path)
        for name in ("a.ply", "a.las", "Room", "room"):
            Path(name).touch()
        assert list(find_recordings(["a.ply", "a.las"])) == ["a.ply", "a.las"]
        assert find_recordings(["a.ply", tmp_path / "a.ply"]) == {"a": tmp_path / "a.ply"}
        assert list(find_recordings(["a.ply", tmp_path / ".." / tmp_path.name / "a.ply"])) == ["a"]
        assert len({name.casefold() for name in find_recordings(["Room", "room"])}) == 2
        for name in ("x-y/z.ply", "x/y-z.ply"):
            Path(name).parent.mkdir()
            Path(name).touch()
        assert len(find_recordings(["x-y/z.ply", "x/y-z.ply"])) == 2

    def test_a_folder_whose_name_looks_like_a_pattern(self, scans, tmp_path):
        (tmp_path / "[2024] x").mkdir()
        (tmp_path / "[2024] x" / "kitchen").symlink_to(scans / "a")
        (tmp_path / "[2024] x" / "list.txt").write_text("k*\n")
        assert list(find_recordings(tmp_path / "[2024] x" / "list.txt")) == ["kitchen"]

    def test_the_results_among_the_recordings_are_none(self, scans, tmp_path):
        (tmp_path / "a").symlink_to(scans / "a")
        for _ in range(2):
            report = tj.batch(f"{tmp_path}/*", tmp_path / "out", engine=HereExecutor(), config=QUICK)
            assert (list(report.reports), report.failures) == (["a"], {})

    def test_a_lost_one_hides_no_other(self, scans, tmp_path):
        (tmp_path / "a").symlink_to(scans / "a")
        for lost in ("b", "c.txt"):
            (tmp_path / lost).symlink_to("nowhere")
        assert list(find_recordings(f"{tmp_path}/*")) == ["a", "b"]
        assert list(find_recordings([*sorted(tmp_path.iterdir())])) == ["a", "b", "c.txt"]
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "a").symlink_to("nowhere")
        report = tj.batch([tmp_path / "a", tmp_path / "b"], tmp_path / "out", engine=HereExecutor(), config=QUICK)
        assert list(report.failures) == ["a", "b"]
        assert "a is a link to nowhere" in report.failures["a"]


def test_tables_that_cannot_be_written(scans, tmp_path):
    """The results are there all the same, the report is whole, and a warning tells."""
    out = tmp_path / "out"
    (out / "summary.csv").mkdir(parents=True)
    with pytest.warns(UserWarning, match=r"summary.csv and failures.csv could not be written"):
        report = tj.batch(
            scans / "a",
            out,
            engine=HereExecutor(),
            config=QUICK,
            options=tj.RecordingOptions(max_frames=1, thin=0.2, up=(0, 0, 1)),
        )
    assert list(report.reports) == ["a"]
    assert len(tj.load_result(out / "a").points) == report.reports["a"].points


class TestOrigin:
    """A result that is there is taken only if it is what this batch would make."""

    OPTIONS = tj.RecordingOptions(max_frames=1, thin=0.2, up=(0, 0, 1))

    @pytest.fixture
    def kitchens(self, tmp_path):
        """Two clouds of the same name."""
        for day in ("day1", "day2"):
            (tmp_path / day / "scans").mkdir(parents=True)
            points = torch.rand(300, 3, generator=torch.Generator().manual_seed(int(day[-1])))
            write_cloud(tmp_path / day / "scans" / "kitchen.ply", points)
        return [tmp_path / day / "scans" / "kitchen.ply" for day in ("day1", "day2")]

    def batch(self, scenes, out, config=QUICK, **options):
        return tj.batch(scenes, out, engine=HereExecutor(), config=config, options=self.OPTIONS, **options)

    def test_another_recording_of_the_same_name(self, kitchens, tmp_path):
        day1, day2 = kitchens
        assert list(self.batch(day1, tmp_path / "out").reports) == ["kitchen"]
        report = self.batch(day2, tmp_path / "out")
        assert report.skipped == ()
        reason = report.failures["kitchen"]
        assert f"expected the result of {day2}, got that of {day1}; other scene, fingerprint; choose another" in reason
        both = self.batch(kitchens, tmp_path / "out")  # the first keeps its folder: no third one is left
        assert both.skipped == ("kitchen",)
        assert list(both.reports) == ["kitchen", "day2-scans-kitchen"]
        folders = sorted(path.name for path in (tmp_path / "out").iterdir() if path.is_dir())
        assert folders == ["day2-scans-kitchen", "kitchen"]
        for name, path in (("kitchen", day1), ("day2-scans-kitchen", day2)):
            assert torch.equal(tj.load_result(tmp_path / "out" / name).scene.points, tj.load_scene(path).select_points(
                voxel_subsample(tj.load_scene(path).points, 0.2)).points)  # fmt: skip

    def test_a_recording_that_once_had_a_longer_name(self, kitchens, tmp_path):
        self.batch(kitchens, tmp_path / "out")
        for day, path in zip(("day1", "day2"), kitchens, strict=True):
            report = self.batch(path, tmp_path / "out")
            assert (report.skipped, report.failures) == ((f"{day}-scans-kitchen",), {})

    def test_changed_files(self, kitchens, tmp_path):
        self.batch(kitchens[0], tmp_path / "out")
        write_cloud(kitchens[0], torch.rand(200, 3))
        assert "other fingerprint; choose" in self.batch(kitchens[0], tmp_path / "out").failures["kitchen"]
        assert self.batch(kitchens[0], tmp_path / "out", overwrite=True).reports["kitchen"].frames == 0
        assert self.batch(kitchens[0], tmp_path / "out").skipped == ("kitchen",)

    @pytest.mark.parametrize("change", [Path.unlink, lambda file: os.truncate(file, 99)])
    def test_a_result_that_is_not_whole(self, kitchens, tmp_path, change):
        self.batch(kitchens[0], tmp_path / "out")
        change(file := tmp_path / "out" / "kitchen" / "hierarchy.npz")
        report = self.batch(kitchens[0], tmp_path / "out")
        assert (report.reports, report.skipped) == ({}, ())
        assert report.failures["kitchen"].startswith(f"{file}: ")

    def test_other_parameters_or_version(self, kitchens, tmp_path):
        out = tmp_path / "out"
        segment_recording(kitchens[0], out / "kitchen", QUICK.set(["visibility.footprint=0.4"]), self.OPTIONS)
        assert "other config; choose" in self.batch(kitchens[0], out).failures["kitchen"]
        record = (out / "kitchen" / "run.yaml").read_text()
        (out / "kitchen" / "run.yaml").write_text(record.replace("torchjoint: ", "torchjoint: 9."))
        assert "other version, config; choose" in self.batch(kitchens[0], out).failures["kitchen"]

    def test_a_batch_with_other_options_that_was_killed(self, kitchens, tmp_path, monkeypatch):
        """Its parameters were those of the record, the results those of the batch before."""
        out = tmp_path / "out"
        tj.batch(kitchens[0], out, engine=HereExecutor(), config=QUICK)

        def killed(*_):
            raise KeyboardInterrupt

        monkeypatch.setattr(importlib.import_module("torchjoint.recordings.batch"), "_sorted_out", killed)
        with pytest.raises(KeyboardInterrupt):
            self.batch(kitchens[0], out, overwrite=True)
        monkeypatch.undo()
        assert "other options or models; choose" in self.batch(kitchens[0], out).failures["kitchen"]

    def test_results_beside_a_recording_do_not_change_it(self, scans, tmp_path):
        scene = shutil.copytree(scans / "a", tmp_path / "a")
        self.batch(scene, scene / "results")
        assert self.batch(scene, scene / "results").skipped == ("a",)
        self.batch(scene, tmp_path / "out")
        shutil.rmtree(scene)  # it may be in an archive now
        assert self.batch(scene, tmp_path / "out").skipped == ("a",)

    def test_names_that_the_batch_needs_itself(self, kitchens, tmp_path):
        names = ("batch.yaml", "summary.csv", "failures.csv", "x", "x.partial", "=cmd|' calc'!A0", ".x.lock")
        scenes = [shutil.copy(kitchens[0], tmp_path / f"{name}.ply") for name in names]
        report = self.batch(scenes, tmp_path / "out")
        assert len(report.reports) == len(names)
        assert len(table(tmp_path / "out" / "summary.csv")) == len(names)
        assert not [name for name in table(tmp_path / "out" / "summary.csv") if name.startswith("=")]
        assert {name: tj.load_result(tmp_path / "out" / name).points.shape for name in report.reports}
        assert len(self.batch(scenes, tmp_path / "out").skipped) == len(names)

    def test_a_list_that_names_itself(self, tmp_path):
        (tmp_path / "one.txt").write_text("two.txt\n")
        (tmp_path / "two.txt").write_text("./one.txt\n")
        with pytest.raises(ValueError, match=r"scenes: expected a list of recordings, got .*/one.txt, which names its"):
            find_recordings(tmp_path / "one.txt")


def test_cells_are_no_formulas():
    assert csv_text([("=1+1", "@x", "-5", "＝1", 7)]) == "'=1+1,'@x,'-5,'＝1,7\n"
    assert csv_text([("a\x1b[2J", "b\0", "c\x9b", "ü\u200f\t")]) == "a\\x1b[2J,b\\x00,c\\x9b,ü\u200f\t\n"
    assert list(csv.reader(io.StringIO(csv_text([("a\rb", "c\r\n")]), newline=""))) == [["a\nb", "c\n"]]
    others = csv_text([("a", "b;=1", "c\t@x", 'd;"=1', "e\n+1", "semi-detached; -1 = 0")])
    assert others == """a,b;'=1,c\t'@x,"d;""'=1","e\n'+1",semi-detached; -1 = 0\n"""
