"""Wrong poses are found from depth alone, before a cloud is fused."""

import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
import torch
from folder_files import write_folder
from scipy.spatial.transform import Rotation

import torchjoint as tj
from torchjoint.datasets.formats.folder import read_frames
from torchjoint.datasets.fusion import _residual, fuse_or_recall, warn_of_poses
from torchjoint.scene.frame import PoseDoubt

TURN = torch.diag(torch.tensor([1.0, -1, -1, 1], dtype=torch.float64))
READ = {
    "inverted: camera-to-world where world-to-camera is expected, or the reverse?": torch.linalg.inv,
    "turned in y and z: OpenGL axes where OpenCV axes are expected, or the reverse?": lambda pose: TURN @ pose,
    "inverted, and turned in y and z: ": lambda pose: torch.linalg.inv(TURN @ pose),
}


def with_poses(frames, change):
    return [replace(frame, world_to_camera=change(frame.world_to_camera)) for frame in frames]


@pytest.mark.parametrize("seed", [0, 1, 5])
@pytest.mark.parametrize("said", READ)
def test_the_convention_is_named(scene_of, seed, said):
    frames = scene_of(seed).scene.frames
    with pytest.warns(tj.PoseWarning, match=re.escape(said)):
        warn_of_poses(with_poses(frames, READ[said]))


@pytest.mark.parametrize(("said", "places"), [(said, {3, 4, 5}) for said in READ] + [("in one recording?", {1, 3, 5})])
def test_some_poses_are_of_another_convention(scene_of, said, places):
    frames = scene_of(0).scene.frames
    other = with_poses(frames, READ.get(said, lambda pose: TURN @ pose))
    with pytest.warns(tj.PoseWarning, match=re.escape(said)):
        warn_of_poses([(other if place in places else frames)[place] for place in range(6)])


@pytest.mark.parametrize("seed", [0, 1, 5])
@pytest.mark.parametrize("wrong", ["reversed", "mirrored"])
def test_colours_of_other_places(scene_of, seed, wrong):
    """Depth fits, so that no check of the fused cloud finds it: its colours are means of these images."""
    frames = scene_of(seed).scene.frames
    images = [one.image for one in frames[::-1]] if wrong == "reversed" else [one.image.flip(2) for one in frames]
    with pytest.warns(PoseDoubt, match="colours of the same places do not .*: are the colour images those of other"):
        warn_of_poses([replace(frame, image=image) for frame, image in zip(frames, images, strict=True)])


@pytest.mark.parametrize("factor", [100, 1000])
def test_positions_in_another_unit(scene_of, factor):
    """Each depth image would fit its own part of the cloud, and no other check finds it."""
    unit = torch.ones(4, 4, dtype=torch.float64)
    unit[:3, 3] = factor
    with pytest.warns(tj.PoseWarning, match="farther apart than their depth images reach: are positions in metres"):
        warn_of_poses(with_poses(scene_of(0).scene.frames, lambda pose: pose * unit))


@pytest.mark.parametrize(("factor", "said"), [(0.2, "too small: millimetres where .* 5000"), (5, "too large: 5000")])
def test_depth_in_another_unit(scene_of, factor, said):
    frames = [replace(frame, depth=frame.depth * factor) for frame in scene_of(0).scene.frames]
    with pytest.warns(tj.PoseWarning, match=f"depth looks 5 times {said}"):
        warn_of_poses(frames)


def test_poses_that_fit_in_no_way(scene_of):
    def reordered(pose):
        x, y, z, w = Rotation.from_matrix(torch.linalg.inv(pose)[:3, :3]).as_quat()
        other = torch.linalg.inv(pose)
        other[:3, :3] = torch.from_numpy(Rotation.from_quat([w, x, y, z]).as_matrix())
        return torch.linalg.inv(other)

    with pytest.warns(PoseDoubt, match="differ by .*%.*: wrong poses, order of quaternions, intrinsics or units"):
        warn_of_poses(with_poses(scene_of(0).scene.frames, reordered))


def test_what_looks_wrong_is_told_of_a_kept_cloud_too(scene_of, tmp_path, monkeypatch):
    """The cloud itself fits its poses, however wrong they are: no later check finds them."""
    monkeypatch.setenv("TORCHJOINT_CACHE", str(tmp_path / "cache"))
    frames = with_poses(scene_of(0).scene.frames, torch.linalg.inv)
    (recording := tmp_path / "recording").mkdir()
    for _ in range(2):
        with pytest.warns(tj.PoseWarning, match=rf"^{re.escape(str(recording))}: the poses look inverted"):
            fuse_or_recall(recording, frames, 0.05, False)
    assert len([*(tmp_path / "cache" / "clouds").iterdir()]) == 1


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
    monkeypatch.setattr("torchjoint.datasets.fusion.add_frame", lambda *_: 1 / 0)
    with pytest.raises(SystemExit, match=r"recording: the poses look inverted: .* or the reverse\? .*--ignore-poses"):
        run("segment", folder, "-o", tmp_path / "out")
