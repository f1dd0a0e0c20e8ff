"""The recipes of docs/masks.md and examples/, run with stand-ins that return what the networks do, in their formats."""

from __future__ import annotations

import re
import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
import torch
from torchjoint_lab.synthetic import with_network_masks

import torchjoint as tj

ROOT = Path(__file__).parents[2]
DOCUMENT = (ROOT / "docs" / "masks.md").read_text(encoding="utf-8")
SIZE = 6, 8


def masks_in(image):
    """Two masks of an image whose first channel is red or blue: BGR and RGB must not be confused."""
    assert image.shape == (*SIZE, 3)
    assert image.dtype == np.uint8
    stack = torch.zeros(2, *SIZE, dtype=torch.bool)
    stack[0, :, :4] = stack[1, :3] = True
    return stack


class Sam2:
    def __init__(self, model):
        assert model == "model"

    def generate(self, image):
        assert image[0, 0].tolist() == [255, 0, 0]
        return [
            {
                "segmentation": mask.numpy(),
                "area": int(mask.sum()),
                "bbox": [0, 0, 4, 6],
                "predicted_iou": 0.5,
                "point_coords": [[1.0, 2.0]],
                "stability_score": 0.9,
                "crop_box": [0, 0, 8, 6],
            }
            for mask in masks_in(image)
        ]


def pipeline(task, model, device):
    def generate(image, points_per_batch):
        assert np.asarray(image)[0, 0].tolist() == [255, 0, 0]
        return {"masks": list(masks_in(np.asarray(image))), "scores": torch.tensor([0.45, 0.45])}

    assert (task, model) == ("mask-generation", "facebook/sam-vit-large")
    return generate


class CropFormer:
    def __init__(self, cfg):
        assert cfg.MODEL.WEIGHTS

    def run_on_image(self, image):
        assert image[0, 0].tolist() == [0, 0, 255]
        stack = torch.cat([masks_in(image), torch.zeros(1, *SIZE, dtype=torch.bool)])
        scores = torch.tensor([0.45, 0.45, 0.01]) + 0.1
        return {"instances": SimpleNamespace(pred_masks=stack.float(), scores=scores, pred_classes=torch.zeros(3))}


class Yolo:
    def __init__(self, weights):
        self.calls = 0

    def __call__(self, image, retina_masks):
        assert retina_masks
        assert image[0, 0].tolist() == [0, 0, 255]
        self.calls += 1
        if self.calls == 2:
            return [SimpleNamespace(masks=None, boxes=SimpleNamespace(conf=torch.zeros(0), cls=torch.zeros(0)))]
        stack = masks_in(image).float()
        boxes = SimpleNamespace(conf=torch.tensor([0.45, 0.45]), cls=torch.tensor([56.0, 0.0]))
        names = {0: "person", 56: "chair"}
        return [SimpleNamespace(masks=SimpleNamespace(data=stack, orig_shape=SIZE), boxes=boxes, names=names)]


STAND_INS = {
    "sam2": {
        "sam2.automatic_mask_generator": {"SAM2AutomaticMaskGenerator": Sam2},
        "sam2.build_sam": {"build_sam2": lambda *_, **__: "model"},
    },
    "CropFormer": {
        "demo_cropformer.predictor": {"VisualizationDemo": CropFormer},
        "detectron2.config": {"get_cfg": lambda: SimpleNamespace(MODEL=SimpleNamespace(), merge_from_file=str)},
        "detectron2.projects.deeplab": {"add_deeplab_config": id},
        "mask2former": {"add_maskformer2_config": id},
    },
    "transformers": {"transformers": {"pipeline": pipeline}},
    "ultralytics": {"ultralytics": {"YOLO": Yolo}},
}


@pytest.fixture
def scene(monkeypatch, tmp_path):
    camera = {"intrinsics": torch.eye(3), "world_to_camera": torch.eye(4)}
    red = torch.zeros(3, *SIZE)
    red[0] = 1
    scene = tj.Scene(torch.rand(5, 3), [tj.Frame(red, **camera, name=name) for name in ("a", "b")])
    monkeypatch.setattr(tj, "load_scene", lambda _: scene)
    monkeypatch.chdir(tmp_path)
    return scene


@pytest.mark.parametrize("name", STAND_INS)
def test_a_recipe_writes_masks_for_the_folder(scene, monkeypatch, name):
    for full, content in STAND_INS[name].items():
        parts = full.split(".")
        for length in range(1, len(parts) + 1):
            if ".".join(parts[:length]) not in sys.modules:
                monkeypatch.setitem(sys.modules, ".".join(parts[:length]), ModuleType(".".join(parts[:length])))
        for key, value in content.items():
            monkeypatch.setattr(sys.modules[full], key, value, raising=False)
    if name == "CropFormer":
        code = re.search(rf"<!-- {name} -->\n```python\n(.*?)```", DOCUMENT, flags=re.DOTALL)[1]
        exec(compile(code, name, "exec"), {})
    else:
        runpy.run_path(str(ROOT / "examples" / "sam_masks.py"))[name](Path("recording"), Path("masks"))
    first, second = (frame.masks for frame in tj.masks.read_folder("masks", scene).frames)
    assert len(first) == 2
    assert first.covered().sum() == 6 * 4 + 3 * 4
    assert first.scores.tolist() == pytest.approx([0.55 if name == "CropFormer" else 0.45] * 2)
    assert len(second) == (0 if name == "ultralytics" else 2)
    assert first.names == (("chair", "person") if name == "ultralytics" else ())


def test_the_lines_of_the_readme(monkeypatch, tmp_path):
    scene = tj.synthetic.make_scene(2, num_views=2, num_points=1500, height=60, width=80).scene
    monkeypatch.setattr(tj, "load_scene", lambda _: scene)
    monkeypatch.chdir(tmp_path)
    for frame in with_network_masks(scene, "sam-like").frames:
        tj.masks.save_masks(f"masks/{frame.name}.npz", frame.masks)
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    assert "tj.masks.read_folder" in code
    names = {"tj": tj}
    exec(compile(code, "README.md", "exec"), names)
    assert names["result"].points.shape == (1500,)
    assert all(frame.masks is not None for frame in names["scene"].frames)
