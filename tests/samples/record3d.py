"""Record3D: a zip of two frames that look along y, depth and confidence packed by the reference encoder."""

import json
import zipfile
from io import BytesIO

import lzfse
import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from samples._parts import HEIGHT, WIDTH, pose_along_y

#: Of a depth image.
SIZE = (HEIGHT // 2, WIDTH // 2)


def metadata():
    poses = [pose_along_y(index) for index in range(2)]
    rows = [[*Rotation.from_matrix(pose[:3, :3]).as_quat().tolist(), *pose[:3, 3].tolist()] for pose in poses]
    return {
        "w": WIDTH, "h": HEIGHT, "dw": SIZE[1], "dh": SIZE[0], "fps": 60,
        "K": [14.0, 0.0, 0.0, 0.0, 14.0, 0.0, 7.5, 5.5, 1.0],
        "perFrameIntrinsicCoeffs": [[14.0, 14.0, 7.5, 5.5]] * 2,
        "poses": rows, "initPose": [0, 0, 0, 1, 0, 0, 0], "frameTimestamps": [0.0, 1 / 60],
    }  # fmt: skip


def jpeg(seed):
    pixels, stream = np.random.default_rng(seed).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8), BytesIO()
    Image.fromarray(pixels).save(stream, "JPEG")
    return stream.getvalue()


def write(folder):
    with zipfile.ZipFile(folder / "2026-01-02--03-04-05.r3d", "w") as archive:
        archive.writestr("metadata", json.dumps(metadata()))
        for index in range(2):
            archive.writestr(f"rgbd/{index}.jpg", jpeg(index))
            depth = np.full(SIZE, 2, dtype=np.float32)
            archive.writestr(f"rgbd/{index}.depth", lzfse.compress(depth.tobytes()))
            archive.writestr(f"rgbd/{index}.conf", lzfse.compress(np.full(SIZE, 2, dtype=np.uint8).tobytes()))
        archive.writestr("icon", jpeg(2))
    return folder / "2026-01-02--03-04-05.r3d"
