"""Live: the cloud grows with the frames, and each result is that of the offline method with the cloud so far."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import pytest
import torch

import torchjoint as tj
from torchjoint.datasets.fusion import GRID, fuse_cloud
from torchjoint.datasets.volume import Volume

VOXEL = 0.08


@pytest.fixture(scope="module")
def frames():
    return tj.synthetic.make_scene(0, num_views=4, num_points=500, height=48, width=64).scene.frames


def played(frames, **options) -> tj.LiveSegmenter:
    segmenter = tj.LiveSegmenter(voxel_size=VOXEL, **options)
    for frame in frames:
        segmenter.update(frame)
    return segmenter


def test_a_result_is_that_of_the_offline_method(frames):
    live = played(frames, step=0).result()
    points, colors, _ = fuse_cloud(frames, VOXEL)
    assert torch.equal(live.cloud.points, points)
    assert torch.equal(live.cloud.colors, colors)
    offline = tj.JointSegmenter(tj.Config.from_dict({"point_segments": {"method": "learned"}}))(
        tj.Scene(points, frames, colors=colors)
    )
    assert torch.equal(live.segmentation.points, offline.points)
    assert live.segmentation.names == offline.names == tuple(frame.name for frame in frames)
    for one, other in zip(live.segmentation.images, offline.images, strict=True):
        assert torch.equal(one, other)


def test_a_forked_process_does_not_share_the_voxels(frames):
    """It wrote to the same temporary file: frames were fused twice in both processes, silently."""
    segmenter = played(frames[:2], step=0, memory=0)
    if not (child := os.fork()):
        try:
            segmenter.update(frames[2])
        except RuntimeError as error:
            os._exit("a forked process shares the temporary file" not in str(error))
        os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    segmenter.update(frames[2:])
    assert torch.equal(segmenter.result().labels, played(frames, step=0).result().labels)


def test_an_interrupted_first_frame_moves_no_later_one(frames, monkeypatch):
    """It was fused, but the place of the volume was taken from the next frame, which was elsewhere."""
    centers = torch.stack([torch.linalg.inv(frame.world_to_camera)[:3, 3] for frame in frames[:2]])
    shift = torch.eye(4, dtype=torch.float64)
    shift[:3, 3] = centers.mean(0) - 0.5 * GRID * VOXEL  # the two cameras are in different cells of the grid
    moved = [replace(frame, world_to_camera=frame.world_to_camera @ shift) for frame in frames[:2]]
    segmenter, whole = tj.LiveSegmenter(voxel_size=VOXEL), played(moved)

    def interrupted(*arguments):
        integrate(*arguments)
        raise KeyboardInterrupt

    integrate = Volume.integrate
    with monkeypatch.context() as patch:
        patch.setattr(Volume, "integrate", interrupted)
        with pytest.raises(KeyboardInterrupt):
            segmenter.update(moved[0])
    segmenter.update(moved[1])
    assert segmenter.names == whole.names[1:]
    assert torch.equal(segmenter.result().cloud.points, whole.result().cloud.points)


def test_results_in_between_and_batches_change_no_label(frames):
    often = tj.LiveSegmenter(voxel_size=VOXEL)
    for frame in frames:
        often.update(frame)
        last = often.result(images=False)
    at_once = tj.LiveSegmenter(voxel_size=VOXEL)
    at_once.update(frames)
    once = at_once.result(images=False)
    assert torch.equal(last.cloud.points, once.cloud.points)
    assert torch.equal(last.segmentation.points, once.segmentation.points)
    assert len(once.changes.born) == len(once.ids)
    assert len(last.changes.born) < len(last.ids)


def test_a_thing_keeps_its_id_while_the_cloud_grows(frames):
    segmenter = played(frames[:2])
    before = segmenter.result(images=False)
    segmenter.update(frames[2:])
    after = segmenter.result(images=False)
    assert len(after.cloud.points) > len(before.cloud.points)
    again = segmenter.result(images=False)
    assert torch.equal(again.ids, after.ids)
    assert again.changes == ((), (), {}, {})
    nearest = torch.cdist(before.cloud.points, after.cloud.points).argmin(1)
    kept = set(before.ids.tolist()) & set(after.ids.tolist())
    assert len(kept) > len(before.ids) / 2
    for number in kept:
        assert (after.labels[nearest[before.labels == number]] == number).float().mean() > 0.5


def test_a_tracker_may_write_each_frame_into_the_same_tensors(frames):
    segmenter = tj.LiveSegmenter(voxel_size=VOXEL)
    depth, intrinsics, pose = frames[0].depth.clone(), frames[0].intrinsics.clone(), torch.eye(4, dtype=torch.float64)
    for frame in frames:
        depth.copy_(frame.depth), pose.copy_(frame.world_to_camera)
        segmenter.update(tj.Frame(frame.image, intrinsics, pose, depth, name=frame.name))
    depth.zero_(), intrinsics.zero_(), pose.zero_()
    expected = played(frames)
    assert segmenter.names == expected.names
    assert torch.equal(segmenter.result().labels, expected.result().labels)


def test_only_frames_from_elsewhere_are_keyframes(frames):
    assert len(played([frames[0]] * 5).names) == 1
    assert len(played([frames[0]] * 5, step=0).names) == 5
    moved = frames[0].world_to_camera.clone()
    moved[0, 3] += 0.2
    assert len(played([frames[0], replace(frames[0], world_to_camera=moved)]).names) == 2
    turn = torch.eye(4, dtype=torch.float64)
    turn[:2, :2] = torch.tensor([[0.9397, -0.3420], [0.3420, 0.9397]], dtype=torch.float64)  # 20 degrees
    turned = replace(frames[0], world_to_camera=turn @ frames[0].world_to_camera)
    assert len(played([frames[0], turned]).names) == 2
    assert len(played([frames[0], turned], turn=30, step=10).names) == 1


def test_a_frame_without_depth_adds_only_evidence(frames):
    with_it = played([*frames[:2], replace(frames[2], depth=None)]).result(images=False)
    without = played(frames[:2]).result(images=False)
    assert torch.equal(with_it.cloud.points, without.cloud.points)
    assert len(with_it.segmentation.points) == len(without.segmentation.points)


def test_a_frame_that_fails_is_not_half_added(frames, monkeypatch):
    segmenter = tj.LiveSegmenter(voxel_size=VOXEL)
    for frame in frames:
        with monkeypatch.context() as broken:
            broken.setattr("torchjoint.live.segmenter.pack", lambda _: 1 / 0)
            with pytest.raises(ZeroDivisionError):
                segmenter.update(frame)
        segmenter.update(frame)
    assert segmenter.names == (expected := played(frames)).names
    assert torch.equal(segmenter.result().labels, expected.result().labels)


def test_masks_are_taken(frames):
    masks = torch.zeros(1, 48, 64, dtype=torch.bool)
    masks[:, 10:30, 10:30] = True
    result = played([replace(frame, masks=masks) for frame in frames[:2]]).result()
    assert torch.equal(result.segmentation.initial_images[0] == 0, masks[0])  # and no other labels are there
    assert int(result.segmentation.initial_images[0].max()) == 0
    assert len(result.segmentation.images) == 2


def test_a_long_walk_has_few_keyframes(frames, tmp_path):
    assert len(played(list(frames) * 10, step=0, views=0).names) == 40
    segmenter = played(frames * 3, step=0, views=3, keep_depth=True)
    count = len(segmenter.names)
    assert len(frames) <= count <= 3 * len(frames)
    blank = replace(frames[0], depth=None)
    segmenter.update(blank)
    assert len(segmenter.names) == count + 1  # without depth, nothing tells what it shows
    poses = {frame.name: frame.world_to_camera for frame in frames}
    segmenter.set_poses(torch.stack([poses[name] for name in segmenter.names]))
    segmenter.save(tmp_path / "state")
    restored = tj.LiveSegmenter(voxel_size=VOXEL, step=0, views=3, keep_depth=True)
    restored.restore(tmp_path / "state")
    for one in (segmenter, restored):
        one.update(list(frames) * 2)
        assert len(one.names) == count + 1


@pytest.mark.slow
def test_less_memory_changes_no_label(frames, tmp_path):
    small = played(frames, step=0, memory=0)
    small.save(tmp_path / "state")
    restored = tj.LiveSegmenter(voxel_size=VOXEL, step=0, memory=0)
    restored.restore(tmp_path / "state")
    expected = played(frames, step=0).result()
    for segmenter in (small, restored):
        assert not any(isinstance(one.image.content, bytes) for one in segmenter._keyframes)
        found = segmenter.result()
        assert torch.equal(found.segmentation.points, expected.segmentation.points)
        for one, other in zip(found.segmentation.images, expected.segmentation.images, strict=True):
            assert torch.equal(one, other)
    with pytest.raises(ValueError, match="memory: expected a size such as '2GB'"):
        tj.LiveSegmenter(memory="much")


def test_wrong_input_is_named(frames):
    with pytest.raises(RuntimeError, match=r"call update\(frame\) first"):
        tj.LiveSegmenter().result()
    with pytest.raises(ValueError, match=r"voxel_size: expected 0\.0001 to 10 metres, got 0"):
        tj.LiveSegmenter(voxel_size=0)
    with pytest.raises(ValueError, match="turn: expected a number >= 0, got nan"):
        tj.LiveSegmenter(turn=float("nan"))
    with pytest.raises(ValueError, match=r"config: expected point_segments\.method learned"):
        tj.LiveSegmenter(tj.Config.from_preset("paper"))
    with pytest.raises(ValueError, match="depth: the frames so far give no surface"):
        played([replace(frames[0], depth=None)]).result()
    in_millimetres = replace(frames[0], depth=1000 * frames[0].depth)
    with pytest.raises(ValueError, match=r"depth: expected metres.* these are probably millimetres"):
        played([in_millimetres]).result()
    with pytest.warns(UserWarning, match="not fused: in millimetres, after others in metres"):
        played([*frames[1:], in_millimetres])
    segmenter = tj.LiveSegmenter(voxel_size=VOXEL, step=0)
    for _ in range(2):  # the frame with the error is not added, and the next one has it, too
        with pytest.raises(ValueError, match=r"depth: expected metres.* these are probably metres where"):
            segmenter.update([replace(frame, depth=frame.depth / 1000) for frame in frames] * 3)
        assert len(segmenter.names) == 11


def test_an_image_that_measured_nothing_is_no_error(frames):
    blind = replace(frames[1], depth=torch.zeros_like(frames[1].depth))
    assert len(played([blind, frames[0], blind]).result(images=False).ids)


@pytest.mark.slow
def test_new_poses_move_the_cloud_and_the_evidence(frames):
    shift = torch.eye(4, dtype=torch.float64)
    shift[:3, 3] = torch.tensor([4 * VOXEL, 0, -2 * VOXEL])
    segmenter = played(frames, keep_depth=True)
    assert len(segmenter.names) == len(frames)
    before = segmenter.result()
    segmenter.set_poses(torch.stack([frame.world_to_camera for frame in frames]))
    again = segmenter.result()
    assert torch.cdist(again.cloud.points, before.cloud.points).amin(1).max() < 0.1 * VOXEL  # depth was rounded
    assert len(again.cloud.points) > 0.99 * len(before.cloud.points)
    segmenter.set_poses(torch.stack([frame.world_to_camera @ shift for frame in frames]))
    after = segmenter.result()
    assert torch.allclose(after.cloud.points, again.cloud.points - shift[:3, 3].float(), atol=1e-4)
    assert torch.equal(after.segmentation.points, again.segmentation.points)
    for one, other in zip(after.segmentation.images, again.segmentation.images, strict=True):
        assert torch.equal(one, other)


def test_new_poses_are_checked(frames):
    poses = torch.stack([frame.world_to_camera for frame in frames])
    with pytest.raises(RuntimeError, match="give keep_depth=True"):
        (segmenter := played(frames)).set_poses(poses)
    with pytest.raises(AttributeError, match="no setter"):  # of the frames so far there is no depth
        segmenter.keep_depth = True
    segmenter = played(frames, keep_depth=True)
    with pytest.raises(ValueError, match=r"expected \[4, 4, 4\], a pose for each keyframe, got \[2, 4, 4\]"):
        segmenter.set_poses(poses[:2])
    poses[1] *= 2
    with pytest.raises(ValueError, match=r"world_to_camera\[1\]: expected a rigid transform"):
        segmenter.set_poses(poses)
    tj.LiveSegmenter(keep_depth=True).set_poses(poses[:0])


def test_poses_of_few_keyframes_are_compared_with_a_result(frames):
    """Only a dozen keyframes had been compared, and new poses never."""
    inverted = torch.stack([torch.linalg.inv(frame.world_to_camera) for frame in frames])
    wrong = [replace(frame, world_to_camera=pose) for frame, pose in zip(frames, inverted, strict=True)]
    with pytest.warns(tj.PoseWarning, match="the poses look inverted"):
        played(wrong).result(images=False)
    with pytest.warns(tj.PoseWarning, match="the poses look inverted"):
        played(frames, keep_depth=True).set_poses(inverted)


def test_equal_poses_of_a_camera_that_moves_are_told_once(frames):
    still = [replace(frames[0], name=f"{index}") for index in range(20)]
    played(still)
    told = [replace(frame, world_to_camera=frames[0].world_to_camera) for frame in (frames[0], *(8 * frames[1:]))]
    told = [frames[0], *told]
    with pytest.warns(tj.PoseWarning, match=r"all poses are equal, but depth images differ by \d+") as found:
        played(told)
    assert len(found) == 1
    with pytest.warns(tj.PoseWarning, match=r"all poses are equal, but .*: are the poses missing\?"):
        fuse_cloud(told[:5], VOXEL)


def test_what_hides_a_camera_at_rest_for_a_moment_is_not_told(frames):
    near = replace(frames[0], depth=frames[0].depth / 2)
    played([near if index in (4, 8) else frames[0] for index in range(20)])


@pytest.mark.slow
def test_dark_frames_are_fused_again_as_they_were_taken(frames):
    dark = [replace(frame, image=frame.image / 8) for frame in frames]
    segmenter = played(dark, step=0, keep_depth=True)
    before = segmenter.result(images=False)
    segmenter.set_poses(torch.stack([frame.world_to_camera for frame in dark]))
    after = segmenter.result(images=False)
    assert after.cloud.colors.mean() == pytest.approx(before.cloud.colors.mean().item(), abs=0.005)


@pytest.mark.parametrize("stop", [pytest.param(0, marks=pytest.mark.slow), 2])
def test_a_saved_segmenter_goes_on_to_the_bit(frames, tmp_path, stop):
    masks = torch.zeros(1, 48, 64, dtype=torch.bool)
    masks[:, 10:30, 10:30] = True
    frames = [frames[0], replace(frames[1], masks=masks), *frames[2:]]
    first = played(frames[:stop], keep_depth=True)
    if stop:
        first.result(images=False)
    first.save(tmp_path / "state")
    second = tj.LiveSegmenter(voxel_size=VOXEL, keep_depth=True)
    second._at_rest = [replace(frames[0], depth=frames[0].depth / 2)]  # of another recording
    second.restore(tmp_path / "state")
    assert second._at_rest == []
    for segmenter in (first, second):
        segmenter.update(frames[stop:])
    one, other = first.result(), second.result()
    assert torch.equal(one.cloud.points, other.cloud.points)
    assert torch.equal(one.labels, other.labels)
    assert one.changes == other.changes
    for a, b in zip(one.segmentation.images, other.segmentation.images, strict=True):
        assert torch.equal(a, b)


def test_a_wrong_state_is_named(frames, tmp_path):
    played(frames[:1]).save(tmp_path / "state")
    with pytest.raises(ValueError, match=r"expected a state with \{'voxel_size': 0.02.*got \{'voxel_size': 0.08"):
        tj.LiveSegmenter().restore(tmp_path / "state")
    content = bytearray((tmp_path / "state").read_bytes())
    content[-10] ^= 1
    (tmp_path / "state").write_bytes(content)
    with pytest.raises(ValueError, match="damaged"):
        tj.LiveSegmenter(voxel_size=VOXEL).restore(tmp_path / "state")
    with pytest.raises(OSError, match="no-such"):
        tj.LiveSegmenter().restore(tmp_path / "no-such")


def test_a_state_for_which_the_disk_is_full_changes_nothing(frames, tmp_path, monkeypatch):
    segmenter = played(frames[:1], memory=1)
    expected = segmenter.result(images=False).cloud.points
    played(frames, memory=1).save(tmp_path / "state")
    with monkeypatch.context() as full:
        full.setattr("torchjoint.live.segmenter.OffloadFile.write", lambda *_: (_ for _ in ()).throw(OSError("full")))
        with pytest.raises(OSError, match="full"):
            segmenter.restore(tmp_path / "state")
    assert torch.equal(segmenter.result(images=False).cloud.points, expected)


@pytest.mark.slow
def test_superpoints_live_keep_their_ids_too(frames):
    segmenter = played(frames[:3], granularity=1.0)
    first = segmenter.result(images=False)
    segmenter.update(frames[3])
    second = segmenter.result(images=False)
    things = played(frames).result(images=False).segmentation
    assert torch.equal(second.segmentation.points, things.hierarchy.superpoint)
    assert len(second.ids) > things.num_point_segments
    assert len(set(first.ids.tolist()) & set(second.ids.tolist())) > len(first.ids) / 2
    with pytest.raises(ValueError, match="granularity: expected"):
        tj.LiveSegmenter(granularity=2)


#: For each line that comes, a process that saves again and again, and says so: a fork, because importing takes seconds.
SAVING = """
import os, sys
import torch, torchjoint as tj
torch.set_num_threads(1)  # threads do not survive a fork
frames = tj.synthetic.make_scene(0, num_views=4, num_points=500, height=48, width=64).scene.frames
tj.LiveSegmenter(voxel_size=0.08).update(frames[0])  # what is made with the first frame is made once
for _ in sys.stdin:
    process = os.fork()
    if process:
        os.waitpid(process, 0)
        print("dead", flush=True)
        continue
    segmenter = tj.LiveSegmenter(voxel_size=0.08)
    while True:
        for frame in frames:
            segmenter.update(frame)
            segmenter.save(sys.argv[1])
            print(os.getpid(), flush=True)
"""


@pytest.mark.slow
def test_a_state_survives_a_kill(frames, tmp_path):
    """However a process dies while it saves, the file is that of one of its saves."""
    state, sizes = tmp_path / "state", set()
    command = [sys.executable, "-c", SAVING, str(state)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as program:
        for delay in (0, 0.003, 0.01, 0.03):
            print(file=program.stdin, flush=True)
            saves = [int(program.stdout.readline()) for _ in range(1 + int(1000 * delay) % 4)]
            time.sleep(delay)
            os.kill(saves[0], signal.SIGKILL)
            assert "dead\n" in program.stdout  # reads up to there
            segmenter = tj.LiveSegmenter(voxel_size=VOXEL)
            segmenter.restore(state)
            sizes.add(len(segmenter.names))
            assert len(segmenter.result(images=False).labels)
        program.stdin.close()
    assert len(sizes) > 1


DEVICE = pytest.param(lambda: torch.device("meta"), marks=pytest.mark.slow)


@pytest.mark.parametrize("around", [torch.inference_mode, DEVICE], ids=["inference", "device"])
def test_inference_mode_and_a_default_device_change_no_label(frames, around, tmp_path):
    expected = played(frames).result()
    with around():
        begun = played(frames[:2])
        begun.save(tmp_path / "state")
        segmenter = tj.LiveSegmenter(voxel_size=VOXEL)
        segmenter.restore(tmp_path / "state")
        segmenter.update(frames[2])
        segmenter.result(images=False)
    segmenter.update(frames[3:])  # what was made inside can be changed here
    with around():
        result = segmenter.result()
    assert torch.equal(result.segmentation.points, expected.segmentation.points)
    for one, other in zip(result.segmentation.images, expected.segmentation.images, strict=True):
        assert torch.equal(one, other)


def test_a_result_is_shown_in_one_line(frames):
    result = played(frames[:3]).result(images=False)
    assert repr(result).startswith(f"LiveResult({len(result.cloud.points)} points, {len(result.ids)} things, ")
    assert "tensor" not in repr(result)
