"""ScanNet++: two fisheye images and their undistorted copies, a mesh, its objects."""

import json

import numpy as np
from scipy.spatial.transform import Rotation

from samples._parts import ALONG_Y, HEIGHT, WIDTH, wall_along_y, write_noise, write_ply


def write_scan(scene):
    """The mesh of 40 vertices; object 2 lies in object 1, object 3 begins where they end."""
    (scene / "scans").mkdir(parents=True)
    write_ply(scene / "scans" / "mesh_aligned_0.05.ply", wall_along_y())
    (scene / "scans" / "segments.json").write_text(json.dumps({"segIndices": list(range(40))}))
    groups = [(2, range(5, 10)), (1, range(20)), (3, range(20, 30))]
    record = [{"id": i, "objectId": i, "segments": list(part), "label": "chair"} for i, part in groups]
    (scene / "scans" / "segments_anno.json").write_text(json.dumps({"segGroups": record}))


def write(folder):
    scene = folder / "data" / "1ada7a0617"
    write_scan(scene)
    colmap, nerfstudio = scene / "dslr" / "colmap", scene / "dslr" / "nerfstudio"
    colmap.mkdir(parents=True)
    nerfstudio.mkdir()
    (colmap / "cameras.txt").write_text(f"1 OPENCV_FISHEYE {WIDTH} {HEIGHT} 13 13 8 6 0.01 0 0 0\n")
    x, y, z, w = Rotation.from_matrix(ALONG_Y).as_quat()
    lines = []
    for index in range(3):  # the last image is hidden, as those of the test set
        translation = -ALONG_Y @ np.array([0.1 * index, 0, 0])
        lines += [" ".join(map(str, (index + 1, w, x, y, z, *translation, 1, f"DSC0{index}.JPG"))), ""]
    (colmap / "images.txt").write_text("\n".join(lines) + "\n")
    for index in range(2):
        write_noise(scene / "dslr" / "resized_images" / f"DSC0{index}.JPG", index)
        write_noise(scene / "dslr" / "resized_undistorted_images" / f"DSC0{index}.JPG", index)
    # The poses of this file are of another world.
    values = {"w": WIDTH, "h": HEIGHT, "fl_x": 14.0, "fl_y": 14.0, "cx": 8.0, "cy": 6.0, "camera_model": "PINHOLE"}
    frames = [{"file_path": f"DSC0{index}.JPG", "transform_matrix": np.eye(4).tolist()} for index in range(2)]
    values |= {"k1": 0.0, "k2": 0.0, "k3": 0.0, "k4": 0.0, "frames": frames, "test_frames": []}
    (nerfstudio / "transforms_undistorted.json").write_text(json.dumps(values))
    return scene
