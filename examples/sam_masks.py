"""Masks of SAM and its relatives, for each frame of a recording, in files that torchjoint reads.

    python examples/sam_masks.py transformers recording masks   # or sam2, ultralytics
    torchjoint segment recording -o out --masks masks

All three ran on a CPU with small models of random weights, and thresholds under which such a model finds anything, not
with the published weights: transformers 5.24 (a SAM), ultralytics 8.4.190 (yolov8n-seg.yaml), and sam2 1.1.0 of PyPI, a
copy of Meta's code by somebody else. torchvision's nms was a stand-in, as its build did not fit torch.
"""

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import torch
import tyro

import torchjoint as tj

DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
Recording = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RECORDING")]
Folder = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MASKS")]
CONFIG, CHECKPOINT = "configs/sam2.1/sam2.1_hiera_l.yaml", "checkpoints/sam2.1_hiera_large.pt"


def _pixels(frame: tj.Frame) -> npt.NDArray[np.uint8]:  # [H, W, 3] RGB
    return (255 * frame.image).round().byte().permute(1, 2, 0).numpy()


def sam2(recording: Recording, masks: Folder, config: str = CONFIG, checkpoint: str | None = CHECKPOINT) -> None:
    """SAM 2 by github.com/facebookresearch/sam2. The first SAM's `SamAutomaticMaskGenerator` gives the same dicts."""
    from sam2.automatic_mask_generator import SAM2AutomaticMaskGenerator
    from sam2.build_sam import build_sam2

    generator = SAM2AutomaticMaskGenerator(build_sam2(config, checkpoint, device=DEVICE))
    for frame in tj.load_scene(recording).frames:
        found = generator.generate(_pixels(frame))
        tj.masks.save_masks(masks / f"{frame.name}.npz", tj.masks.from_sam(found, frame.size))


def transformers(recording: Recording, masks: Folder, model: str = "facebook/sam-vit-large") -> None:
    """SAM, SAM 2 (`--model facebook/sam2.1-hiera-large`) and others by Hugging Face's pipeline."""
    from PIL import Image
    from transformers import pipeline

    generator = pipeline("mask-generation", model=model, device=DEVICE)
    for frame in tj.load_scene(recording).frames:
        found = generator(Image.fromarray(_pixels(frame)), points_per_batch=64)
        scored = zip(found["masks"], found["scores"], strict=True)
        records = [{"segmentation": mask, "predicted_iou": float(score)} for mask, score in scored]
        tj.masks.save_masks(masks / f"{frame.name}.npz", tj.masks.from_sam(records, frame.size))


def ultralytics(recording: Recording, masks: Folder, model: str = "yolo11n-seg.pt") -> None:
    """YOLO-seg: the things of its classes, with names; the rest of the image is in no mask. Its licence is AGPL."""
    from ultralytics import YOLO

    network: Any = YOLO(model)
    for frame in tj.load_scene(recording).frames:
        found = network(_pixels(frame)[:, :, ::-1], retina_masks=True)[0]  # takes BGR; masks of the image's size
        stack = torch.zeros(0, *frame.size, dtype=torch.bool) if found.masks is None else found.masks.data
        names = [found.names[number] for number in found.boxes.cls.int().tolist()]
        tj.masks.save_masks(masks / f"{frame.name}.npz", tj.masks.from_stack(stack, found.boxes.conf, names))


if __name__ == "__main__":
    tyro.extras.subcommand_cli_from_dict({one.__name__: one for one in (sam2, transformers, ultralytics)})
