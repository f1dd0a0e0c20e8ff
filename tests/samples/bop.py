"""BOP: two images of a scene with two objects of one kind, listed in another order in the second image; a cloud."""

import json

import numpy as np
from PIL import Image

from samples._parts import HEIGHT, WIDTH, wall, write_depth, write_noise, write_ply


def write(folder):
    scene = folder / "test" / "000048"
    scene.mkdir(parents=True)
    cameras, truth = {}, {}
    eye = np.eye(3).ravel().tolist()
    for number in (1, 36):
        x = 1.0 * number  # millimetres, as all lengths here
        cameras[str(number)] = {
            "cam_K": [20.0, 0.0, 7.5, 0.0, 20.0, 5.5, 0.0, 0.0, 1.0],
            "depth_scale": 0.1,
            "cam_R_w2c": eye,
            "cam_t_w2c": [-x, 0.0, 0.0],
        }
        objects = [("left", -300.0), ("right", 300.0)][:: 1 if number == 1 else -1]
        truth[str(number)] = [
            {"obj_id": 5, "cam_R_m2c": eye, "cam_t_m2c": [place - x, 0.0, 2000.0]} for _, place in objects
        ]
        write_noise(scene / "rgb" / f"{number:06d}.png", number)
        write_depth(scene / "depth" / f"{number:06d}.png", 20000)
        (scene / "mask_visib").mkdir(exist_ok=True)
        for place, (side, _) in enumerate(objects):
            mask = np.zeros((HEIGHT, WIDTH), np.uint8)
            mask[2:9, slice(1, 6) if side == "left" else slice(10, 15)] = 255
            Image.fromarray(mask).save(scene / "mask_visib" / f"{number:06d}_{place:06d}.png")
    (scene / "scene_camera.json").write_text(json.dumps(cameras))
    (scene / "scene_gt.json").write_text(json.dumps(truth))
    write_ply(scene / "cloud.ply", wall())
    return scene
