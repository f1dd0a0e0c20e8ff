"""The state of a run on disk: any damage is noticed, and short runs are saved, too."""

import errno
import shutil

import pytest
import torch

import torchjoint as tj
from torchjoint.results import checkpoint as module
from torchjoint.results.checkpoint import Checkpoint, run_key
from torchjoint.runtime.store import read_values, write_values


@pytest.fixture(scope="module")
def segmenter(scene_of):
    made = tj.JointSegmenter(tj.Config().set(["point_segments.method=paper", "boundary.detector=gradient"]))
    scene = scene_of(3).scene
    made.reset(scene.points, scene.colors)
    made.update(scene.frames[:2])
    return made


def saved(folder, segmenter):
    Checkpoint(folder, "key").save(segmenter.state, now=True)
    return Checkpoint(folder, "key")


def test_what_is_saved_is_loaded(tmp_path, segmenter):
    state = saved(tmp_path / "state", segmenter).load()
    assert torch.equal(state.overlap_sum, segmenter.state.overlap_sum)
    assert torch.equal(state.observations[1].image, segmenter.state.observations[1].image)


def test_every_flipped_bit_is_noticed(tmp_path, segmenter):
    """Without checksums all of 199 flipped bits of the sums were loaded as other numbers."""
    checkpoint = saved(tmp_path / "state", segmenter)
    generator = torch.Generator().manual_seed(0)
    for name in ("sums.pt", "observation-000001.pt"):
        file = tmp_path / "state" / name
        whole = file.read_bytes()
        for place in torch.randint(len(whole), (20,), generator=generator).tolist():
            spoiled = bytearray(whole)
            spoiled[place] ^= 16
            file.write_bytes(bytes(spoiled))
            with pytest.warns(UserWarning, match="state: damaged, starting again"):
                assert checkpoint.load() is None
        file.write_bytes(whole)
    assert checkpoint.load() is not None


@pytest.mark.parametrize("name", ["sums.pt", "observation-000001.pt"])
def test_a_whole_file_of_another_run_is_noticed(tmp_path, segmenter, name):
    checkpoint = saved(tmp_path / "state", segmenter)
    Checkpoint(tmp_path / "other", "other key").save(segmenter.state, now=True)
    shutil.copy(tmp_path / "other" / name, tmp_path / "state" / name)
    with pytest.warns(UserWarning, match=f"starting again .*{name} is of another run"):
        assert checkpoint.load() is None


@pytest.mark.parametrize("change", [{"name": 5}, {"row": "uint8"}])
def test_an_observation_with_values_of_other_types(tmp_path, segmenter, change):
    checkpoint, file = saved(tmp_path / "state", segmenter), tmp_path / "state" / "observation-000000.pt"
    values = read_values(file)
    if "row" in change:
        values["parts"]["row"]["dtype"] = change["row"]
    write_values(file, values | {key: value for key, value in change.items() if key == "name"})
    with pytest.warns(UserWarning, match="state: damaged, starting again"):
        assert checkpoint.load() is None


def test_another_version_of_the_files_is_not_read(tmp_path, segmenter, monkeypatch):
    saved(tmp_path / "state", segmenter)
    monkeypatch.setattr(module, "FORMAT", module.FORMAT + 1)
    assert Checkpoint(tmp_path / "state", "key").load() is None


def test_a_short_run_is_saved(tmp_path, segmenter):
    checkpoint = Checkpoint(tmp_path / "state", "key")
    checkpoint.save(segmenter.state)  # at the default interval
    assert len(Checkpoint(tmp_path / "state", "key").load().observations) == 2


def test_saving_takes_a_small_share_of_the_time(tmp_path, segmenter, monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: clock[0])
    writes = []

    def slow_write(path, values):
        clock[0] += 0.5
        writes.append(path.name)

    monkeypatch.setattr(module, "write_values", slow_write)
    checkpoint = Checkpoint(tmp_path / "state", "key")
    for _ in range(1000):
        clock[0] += 0.1
        checkpoint.save(segmenter.state)
    assert 4 <= writes.count("sums.pt") <= 11  # of 100 s


def test_a_full_disk_leaves_the_last_state(tmp_path, segmenter, monkeypatch):
    checkpoint = saved(tmp_path / "state", segmenter)
    before = {file.name: file.read_bytes() for file in (tmp_path / "state").iterdir()}
    write_bytes = module.Path.write_bytes

    def full(path, data):
        write_bytes(path, data[: len(data) // 2])
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    monkeypatch.setattr(module.Path, "write_bytes", full)
    with pytest.raises(OSError, match="No space left"):
        checkpoint.save(segmenter.state, now=True)
    assert {file.name: file.read_bytes() for file in (tmp_path / "state").iterdir()} == before
    monkeypatch.undo()
    assert checkpoint.load() is not None


@pytest.mark.parametrize("parameter", ["point_segments.method", "boundary.model"])
def test_a_model_that_was_trained_anew_is_another_run(tmp_path, parameter):
    """The evidence of the earlier model was continued with the new one."""
    model = tmp_path / "mine.npz"
    config = tj.Config().set([f"{parameter}={model}"])
    keys = {run_key("scan", config)}
    for content in (b"one", b"two"):
        model.write_bytes(content)
        keys.add(run_key("scan", config))
    assert len(keys) == 3
