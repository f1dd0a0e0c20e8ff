"""What the workers of an engine do, and what they get over. They are started once for all tests."""

import subprocess
import warnings

import pytest
import torch
from deadly_batches import CONFIG, ENGINES, OPTIONS, assert_complete, make_known, undisturbed
from folder_files import write_scans
from las_town import town, write_las

import torchjoint as tj
from torchjoint.engine import open_engine
from torchjoint.recordings.segment import run
from torchjoint.results.checkpoint import Checkpoint
from torchjoint.tiles import superpoints_of_files
from torchjoint.tiles.run import HERE

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning", "ignore::FutureWarning"),
]


@pytest.fixture(scope="module")
def scans(scene_of, tmp_path_factory):
    return write_scans(tmp_path_factory.mktemp("scans") / "scans", scene_of(2))


@pytest.fixture(scope="module")
def expected(scans, tmp_path_factory):
    return undisturbed(scans, tmp_path_factory.mktemp("expected"))


@pytest.fixture(scope="module")
def deaths(tmp_path_factory):
    """The folder of the deaths to come, which the workers of all tests know."""
    folder = tmp_path_factory.mktemp("deaths")
    with pytest.MonkeyPatch.context() as patch:
        make_known(folder, patch)
        yield folder


@pytest.fixture(scope="module", params=ENGINES)
def engine(request, deaths):
    with open_engine(request.param) as engine:
        yield engine


def test_a_worker_is_killed_and_one_has_too_little_memory(engine, scans, deaths, expected, tmp_path):
    out = tmp_path / "out"
    (deaths / "kill").touch()
    (deaths / "memory").touch()
    first = tj.batch(scans, out, engine=engine, config=CONFIG, options=OPTIONS, allow_import=True)
    assert list(deaths.iterdir()) == []  # both have come
    (failed,) = first.failures  # the scene of the killed worker went on where it was
    assert "out of memory" in first.failures[failed]
    again = tj.batch(scans, out, engine=engine, config=CONFIG, options=OPTIONS, allow_import=True)
    assert sorted(again.skipped) == sorted(set(expected) - {failed})
    assert_complete(out, expected)


def test_a_full_disk(engine, scans, deaths, expected, tmp_path):
    """Scenes fail with a clear reason; after making room the command goes on."""
    disk = tmp_path / "disk"
    disk.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=700k", "tmpfs", disk]
    mounted = subprocess.run(command, capture_output=True, check=False)
    if mounted.returncode:
        pytest.skip(f"needs the right to mount a small tmpfs: {mounted.stderr.decode().strip()}")
    try:
        out = disk / "out"
        with warnings.catch_warnings():  # whether there is room for the tables depends on what was written last
            warnings.filterwarnings("ignore", ".*could not be written: the disk is full")
            first = tj.batch(scans, out, engine=engine, config=CONFIG, options=OPTIONS, allow_import=True)
        assert first.failures
        assert all("the disk is full" in reason for reason in first.failures.values())
        subprocess.run(["mount", "-o", "remount,size=200m", disk], check=True)
        again = tj.batch(scans, out, engine=engine, config=CONFIG, options=OPTIONS, allow_import=True)
        assert again.failures == {}
        assert_complete(out, expected)
    finally:
        subprocess.run(["umount", disk], check=True)


def test_one_recording_over_many_workers(engine, scene_of, tmp_path):
    scene, config = scene_of(2).scene, tj.Config().set(["boundary.detector=gradient"])
    whole, checkpoint = tj.JointSegmenter(config)(scene), Checkpoint(tmp_path / "state", "key")
    result = run(tj.JointSegmenter(config), scene, checkpoint, engine=engine)
    assert torch.equal(result.points, whole.points)
    assert result.names == whole.names
    for labels, others in zip(result.images, whole.images, strict=True):
        assert torch.equal(labels, others)


def test_tiles_of_a_cloud(engine, tmp_path):
    cloud = write_las(tmp_path / "town.laz", town(8_000, 12))
    superpoints_of_files(cloud, tmp_path / "here.las", tile=7, buffer=1, engine=HERE)
    superpoints_of_files(cloud, tmp_path / "there.las", tile=7, buffer=1, engine=engine)
    assert (tmp_path / "here.las").read_bytes() == (tmp_path / "there.las").read_bytes()
