"""Live: the cloud grows with the frames, and each result is that of the offline method with the cloud so far."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

import torchjoint as tj
from torchjoint.datasets.fusion import fuse_cloud

VOXEL = 0.05


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
    points, colors = fuse_cloud(frames, VOXEL)
    assert torch.equal(live.cloud.points, points)
    assert torch.equal(live.cloud.colors, colors)
    offline = tj.JointSegmenter(tj.Config.from_dict({"point_segments": {"method": "learned"}}))(
        tj.Scene(points, frames, colors=colors)
    )
    assert torch.equal(live.segmentation.points, offline.points)
    assert live.segmentation.names == offline.names == tuple(frame.name for frame in frames)
    for one, other in zip(live.segmentation.images, offline.images, strict=True):
        assert torch.equal(one, other)


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


def test_masks_are_taken(frames):
    masks = torch.zeros(1, 48, 64, dtype=torch.bool)
    masks[:, 10:30, 10:30] = True
    result = played([replace(frame, masks=masks) for frame in frames[:2]]).result()
    assert result.segmentation.confidence is None  # as with masks
    assert len(result.segmentation.images) == 2


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
    with pytest.raises(ValueError, match=r"depth: expected metres.* these are probably metres where"):
        played([replace(frame, depth=frame.depth / 1000) for frame in frames] * 3, step=0)


def test_an_image_that_measured_nothing_is_no_error(frames):
    blind = replace(frames[1], depth=torch.zeros_like(frames[1].depth))
    assert len(played([blind, frames[0], blind]).result(images=False).ids)
