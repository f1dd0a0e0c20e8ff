"""What the caller has set as torch's default dtype, device and autocast does not matter."""

import dataclasses
import functools
import subprocess
import sys

import pytest
import torch
from folder_files import write_folder

import torchjoint as tj
from torchjoint.recordings import segment_recording
from torchjoint.results.exports.clouds import export_npz


@pytest.fixture(params=["float64", "bfloat16", "meta", "autocast", "medium", "products"])
def other_default(request):
    if request.param == "autocast":
        with torch.autocast("cpu", dtype=torch.bfloat16):
            yield
        return
    dtype = torch.get_default_dtype()
    if request.param == "medium":
        torch.set_float32_matmul_precision("medium")
    elif request.param == "products":
        torch.backends.mkldnn.matmul.fp32_precision = "bf16"
    elif request.param == "meta":
        torch.set_default_device("meta")
    else:
        torch.set_default_dtype(getattr(torch, request.param))
    yield
    torch.set_float32_matmul_precision("highest")
    torch.set_default_device(None)
    torch.set_default_dtype(dtype)


@pytest.fixture(scope="module")
def scene(scene_of):
    return scene_of(3).scene


METHODS = ["learned", "paper", "scan"]


def segmented(scene, method):
    """Scene and frames are made anew, too."""
    frames = [dataclasses.replace(frame) for frame in scene.frames]
    made = tj.Scene(scene.points, frames, colors=scene.colors)
    own = ["paper.min_size=20"] if method == "paper" else []
    result = tj.JointSegmenter(tj.Config().set([f"point_segments.method={method}", *own]))(made)
    return [result.points, *result.images]


@pytest.fixture(scope="module")
def expected(scene):
    known = {method: segmented(scene, method) for method in METHODS}
    return known | {"superpoints": [tj.superpoints(scene.points, scene.colors)]}


@pytest.mark.parametrize("method", ["learned", *(pytest.param(one, marks=pytest.mark.slow) for one in METHODS[1:])])
def test_segmentation(scene, expected, method, other_default):
    result = segmented(scene, method)
    torch.set_default_device(None)
    assert all(torch.equal(*pair) for pair in zip(result, expected[method], strict=True))


def test_superpoints(scene, expected, other_default):
    labels = tj.superpoints(scene.points, scene.colors)
    torch.set_default_device(None)
    assert torch.equal(labels, expected["superpoints"][0])


LABELS = torch.arange(600) % 7 - 1
STACK = torch.arange(3 * 20 * 30).view(3, 20, 30) % 5 < 2
IN_MASKS = {"segmentation": {"size": [2, 3], "counts": [1, 2, 3]}, "score": 0.5}
CALLS = {
    "covering": lambda: tj.metrics.segmentation_covering(LABELS, LABELS // 2),
    "objects and parts": lambda: tj.metrics.objects_and_parts(LABELS, LABELS // 2),
    "average precision": lambda: tj.metrics.average_precision_parts(LABELS, LABELS // 2),
    "achievable accuracy": lambda: tj.metrics.achievable_segmentation_accuracy(LABELS, LABELS // 2),
    "masks of labels": lambda: tj.masks.from_labels(LABELS.view(20, 30)).labels(),
    "nested masks": lambda: tj.masks.from_stack(STACK).resized((37, 56)).labels(),
    "a score of COCO": lambda: tj.masks.from_coco([IN_MASKS | {"score": 0.7123}], (2, 3)).scores,
    "a score of SAM": lambda: tj.masks.from_sam([IN_MASKS | {"predicted_iou": 0.7123}]).scores,
    "masks of COCO": lambda: tj.masks.from_coco([IN_MASKS], (2, 3)).stack(),
    "a cloud alone": lambda: tj.JointSegmenter()(tj.Scene(CLOUD)).points.tolist(),
    "labels of the nearest": lambda: tj.transforms.transfer_labels(LABELS[:9], POINTS, POINTS + 0.1),
    "confidence": lambda: [fresh().confidence, fresh().point_confidence],
    "records": lambda: fresh().records(),
    "relations": lambda: fresh().graph().relations,
    "a picked point": lambda: fresh().pick(CLOUD[:2], negative=CLOUD[2:3]).superpoints,
}
CLOUD = torch.rand(600, 3, generator=torch.Generator().manual_seed(0))
POINTS = torch.arange(27.0).view(9, 3)


@functools.cache
def found():
    scene = tj.Scene(CLOUD)
    return tj.Result.of(tj.JointSegmenter()(scene), scene)


def fresh():
    """Made before the defaults were changed, with nothing computed yet."""
    return dataclasses.replace(found())


def test_a_default_device_before_the_first_use():
    code = "import torch; torch.set_default_device('meta'); from torchjoint.datasets import cameras, volume"
    code += "; print(cameras.FLIP_YZ.device, volume._STEPS.device)"
    assert subprocess.check_output([sys.executable, "-c", code], text=True) == "cpu cpu\n"


@pytest.fixture(scope="module")
def usual():
    return {name: repr(call()) for name, call in CALLS.items()}


@pytest.mark.parametrize("name", CALLS)
def test_other_functions(usual, name, other_default):
    result = CALLS[name]()
    torch.set_default_device(None)
    torch.set_default_dtype(torch.float32)  # as numbers are shown
    assert repr(result) == usual[name]


@pytest.mark.slow
def test_a_recording_and_its_files(scene_of, tmp_path):
    """Read, segmented, written, and exported by a name without the usual suffix."""

    def files(out):
        segment_recording(tmp_path / "recording", out, config, tj.RecordingOptions())
        export_npz(out / "export", tj.load_result(out))
        return {str(file.relative_to(out)): file.read_bytes() for file in out.rglob("*") if file.is_file()}

    config, made = tj.Config().set(["boundary.detector=gradient"]), scene_of(3)
    few = dataclasses.replace(made.scene, frames=made.scene.frames[:2], truth=None)
    write_folder(tmp_path / "recording", dataclasses.replace(made, scene=few))
    wanted = files(tmp_path / "wanted")
    torch.set_default_device("meta")
    try:
        got = files(tmp_path / "got")
    finally:
        torch.set_default_device(None)
    assert {name for name in wanted if wanted[name] != got.get(name)} <= {"run.yaml"}  # which has the seconds
    assert set(got) == set(wanted)
    assert "export" in got
