"""Polycam's raw data: two corrected frames that look along y, one more that was not corrected, depth, confidence."""

import json

import numpy as np
from PIL import Image

from samples._parts import HEIGHT, WIDTH, pose_along_y, wall_along_y, write_depth, write_noise, write_ply


def write(folder):
    keyframes = folder / "scan" / "keyframes"
    for index in range(3):
        stem = str(9_999_999 + index)
        camera = {"fx": 14.0, "fy": 14.0, "cx": 7.5, "cy": 5.5, "width": WIDTH, "height": HEIGHT, "blur_score": 99.5}
        rows = pose_along_y(index)[:3]
        camera |= {f"t_{row}{column}": rows[row, column] for row in range(3) for column in range(4)}
        for kind in ("", "corrected_")[: 1 if index == 2 else 2]:
            write_noise(keyframes / f"{kind}images" / f"{stem}.jpg", index)
            (keyframes / f"{kind}cameras").mkdir(exist_ok=True)
            (keyframes / f"{kind}cameras" / f"{stem}.json").write_text(json.dumps(camera))
        write_depth(keyframes / "depth" / f"{stem}.png", 2000)
        (keyframes / "confidence").mkdir(exist_ok=True)
        Image.fromarray(np.full((HEIGHT, WIDTH), 255, np.uint8)).save(keyframes / "confidence" / f"{stem}.png")
    (folder / "scan" / "mesh_info.json").write_text(json.dumps({"alignmentTransform": np.eye(4).flatten().tolist()}))
    write_ply(folder / "scan" / "cloud.ply", wall_along_y())
    return folder / "scan"
