"""Recordings of Rerun: what is read back from the file is what was seen, with the lasting ids as classes."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image
from scipy.spatial.transform import Rotation

import torchjoint as tj
from torchjoint.live import RerunLog
from torchjoint.scene.frame import camera_center

pytest.importorskip("rerun", reason="recordings of Rerun need rerun: pip install 'torchjoint[rerun]'")
from rerun.chunk import RrdReader


@pytest.fixture(scope="module")
def frames():
    return tj.synthetic.make_scene(11, num_views=3, num_points=500, height=48, width=64).scene.frames


def results_of(frames):
    """A result after each frame, the last one with the labels of the images."""
    segmenter = tj.LiveSegmenter(voxel_size=0.05, step=0)
    for index, frame in enumerate(frames):
        segmenter.update(frame)
        yield segmenter.result(images=index == len(frames) - 1)


@pytest.fixture(scope="module")
def results(frames):
    return list(results_of(frames))


def written(path, frames, results, numbers):
    with RerunLog.to_file(path) as log:
        for number, frame, result in zip(numbers, frames, results, strict=True):
            log.camera(frame, number)
            log.show(result, number)
    return columns(path)


def columns(path):
    """{entity: {column: {number of the frame, or None: its values}}}"""
    found = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        rows = batch.to_pydict()
        numbers = rows.get("frame", [None] * batch.num_rows)
        for name, values in rows.items():
            found.setdefault(chunk.entity_path, {}).setdefault(name, {}).update(zip(numbers, values, strict=True))
    return found


def test_points_have_the_ids_of_their_things(tmp_path, frames, results):
    things = written(tmp_path / "a.rrd", frames, results, [1, 4, 5])["/world/things"]
    assert set(things["Points3D:positions"]) == {1, 4, 5}
    for number, result in zip([1, 4, 5], results, strict=True):
        assert np.array_equal(things["Points3D:positions"][number], result.cloud.points.numpy())
        assert things["Points3D:class_ids"][number] == (result.labels + 1).tolist()


def test_changes_are_told_and_classes_have_colors(tmp_path, frames, results):
    found = written(tmp_path / "a.rrd", frames, results, [1, 2, 3])
    texts = [text for (text,) in found["/changes"]["TextLog:text"].values()]
    assert texts[0] == f"born {', '.join(map(str, range(len(results[0].ids))))}"
    merged = results[1].changes.merged
    assert f"merged {', '.join(f'{one}: {other}' for one, other in merged.items())}" in texts[1]
    assert len(merged) > 0
    (classes,) = found["/"]["AnnotationContext:context"][None]
    infos = [one["class_description"]["info"] for one in classes]
    assert [one["id"] for one in infos] == list(range(int(results[-1].ids.max()) + 2))
    assert len({one["color"] for one in infos}) == len(infos)


def test_cameras_and_images_are_those_of_the_frames(tmp_path, frames, results):
    found = written(tmp_path / "a.rrd", frames, results, [1, 2, 3])
    camera, images = found["/world/camera"], found["/world/camera/image"]["EncodedImage:blob"]
    for number, frame in enumerate(frames, start=1):
        (place,), (turn,) = (camera[f"Transform3D:{name}"][number] for name in ("translation", "quaternion"))
        assert np.allclose(place, camera_center(frame.world_to_camera), atol=1e-6)
        assert np.allclose(Rotation.from_quat(turn).as_matrix(), frame.world_to_camera[:3, :3].T, atol=1e-6)
        (lens,) = camera["Pinhole:image_from_camera"][number]
        expected = frame.intrinsics.double() + torch.tensor([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
        assert np.allclose(np.reshape(lens, (3, 3)).T, expected)
        pixels = np.asarray(Image.open(io.BytesIO(bytes(images[number][0]))), np.float32) / 255
        assert abs(pixels - frame.image.permute(1, 2, 0).numpy()).mean() < 0.05


def test_label_images_are_at_their_own_frames(tmp_path, frames, results):
    things = written(tmp_path / "a.rrd", frames, results, [1, 4, 5])["/world/camera/things"]
    assert set(things["SegmentationImage:buffer"]) == {1, 4, 5}
    assert set(things["Clear:is_recursive"]) == {2, 6}
    last = results[-1]
    for number, labels in zip([1, 4, 5], last.segmentation.images, strict=True):
        classes = np.frombuffer(bytes(things["SegmentationImage:buffer"][number][0]), np.uint16).reshape(labels.shape)
        known = ((labels >= 0) & (labels < len(last.ids))).numpy()
        assert known.any()
        assert np.array_equal(classes[known], last.ids[labels[known]] + 1)
        assert (classes[~known] == 0).all()


@pytest.mark.slow
def test_far_from_the_origin_places_are_relative(tmp_path, frames):
    far = torch.tensor([500_000.0, -4_000_000.0, 0.0], dtype=torch.float64)
    moved = []
    for frame in frames:
        pose = frame.world_to_camera.double().clone()
        pose[:3, 3] -= pose[:3, :3] @ far
        moved.append(replace(frame, world_to_camera=pose))
    results = list(results_of(moved))
    found = written(tmp_path / "far.rrd", moved, results, [1, 2, 3])
    near = (results[-1].cloud.points - far).float().numpy()
    assert np.array_equal(found["/world/things"]["Points3D:positions"][3], near)
    (place,) = found["/world/camera"]["Transform3D:translation"][3]
    assert np.allclose(place, camera_center(frames[2].world_to_camera), atol=1e-4)


@pytest.mark.slow
def test_after_the_last_class_comes_the_first(tmp_path, frames, results):
    many = [results[-1]._replace(ids=results[-1].ids + 65_535 - results[-1].ids.max())]
    found = written(tmp_path / "a.rrd", frames[:1], many, [1])
    classes = found["/world/things"]["Points3D:class_ids"][1]
    assert classes == (many[0].labels % 65_535 + 1).tolist()
    assert min(classes) == 1
    assert max(classes) == 65_535
    assert len(found["/"]["AnnotationContext:context"][None][0]) == 65_536


def test_a_log_that_fails_leaves_no_file(tmp_path, frames):
    (tmp_path / "a.rrd").write_text("an earlier one")
    with pytest.raises(IndexError), RerunLog.to_file(tmp_path / "a.rrd") as log:
        [log.camera(frames[index], index) for index in range(len(frames) + 1)]
    with pytest.raises(FileNotFoundError, match="nowhere"), RerunLog.to_file(tmp_path / "nowhere" / "a.rrd"):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["a.rrd"]
    assert (tmp_path / "a.rrd").read_text() == "an earlier one"
