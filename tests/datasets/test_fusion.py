"""Wrong poses are found from depth alone, before a cloud is fused."""

import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
import torch
from folder_files import write_folder

import torchjoint as tj
from torchjoint.datasets.formats.folder import read_frames
from torchjoint.datasets.fusion import _residual, warn_of_poses

TURN = torch.diag(torch.tensor([1.0, -1, -1, 1], dtype=torch.float64))
READ = {
    "inverted: expected world_to_camera": torch.linalg.inv,
    "to be in OpenGL axes": lambda pose: TURN @ pose,
    "to be camera-to-world in OpenGL axes": lambda pose: torch.linalg.inv(TURN @ pose),
}


def with_poses(frames, change):
    return [replace(frame, world_to_camera=change(frame.world_to_camera)) for frame in frames]


@pytest.mark.parametrize("seed", [0, 1, 5])
@pytest.mark.parametrize("said", READ)
def test_the_convention_is_named(scene_of, seed, said):
    frames = scene_of(seed).scene.frames
    with pytest.warns(tj.PoseWarning, match=re.escape(said)):
        warn_of_poses(with_poses(frames, READ[said]))


@pytest.mark.parametrize(
    "change",
    [
        lambda frames: frames,
        lambda frames: frames[:1],
        lambda frames: [],
        lambda frames: [replace(frame, depth=None) for frame in frames],
        lambda frames: [frames[0]] * 5,  # a camera at rest
        lambda frames: with_poses([frames[0]] * 5, torch.linalg.inv),
    ],
)
def test_right_poses_and_what_cannot_be_judged(scene_of, change):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_poses(change(list(scene_of(0).scene.frames)))


def test_right_poses_of_real_frames(shared):
    frames = read_frames(shared / "data" / "kitchen")
    frames = [frames[index] for index in range(0, len(frames), 10)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_poses(frames)
    with pytest.warns(tj.PoseWarning, match="OpenGL"):
        warn_of_poses(with_poses(frames, lambda pose: TURN @ pose))


def test_a_wall_by_hand():
    # The second camera stands half a metre nearer to a wall, which the first sees at 2 m; it sees it at 1.6 m, not 1.5.
    camera = torch.tensor([[50.0, 0, 9.5], [0, 50, 7.5], [0, 0, 1]])
    near = torch.eye(4, dtype=torch.float64)
    near[2, 3] = -0.5
    one, other = (
        tj.Frame(torch.zeros(3, 16, 20), camera, pose, depth=torch.full((16, 20), depth))
        for pose, depth in ((torch.eye(4), 2.0), (near, 1.6))
    )
    assert _residual(one, other, near) == pytest.approx(0.1 / 1.6)


def test_a_run_ends_before_it_fuses(tmp_path, scene_of, run, monkeypatch):
    folder = write_folder(tmp_path / "recording", scene_of(0), cloud=False)
    for file in folder.glob("*.pose.txt"):
        np.savetxt(file, np.linalg.inv(np.loadtxt(file)))
    monkeypatch.setattr("torchjoint.datasets.fusion.Volume", lambda *_: 1 / 0)
    with pytest.raises(SystemExit, match=r"the poses look inverted.*--ignore-poses"):
        run("segment", folder, "-o", tmp_path / "out")
