"""Record3D's export "EXR + JPG" of the same frames; metadata without the intrinsics of each frame."""

import json

import numpy as np
import OpenEXR

from samples._parts import wall_along_y, write_ply
from samples.record3d import SIZE, jpeg, metadata

FORMAT = "record3d"


def write(folder):
    inside = folder / "scan" / "EXR_RGBD"
    for part in ("rgb", "depth"):
        (inside / part).mkdir(parents=True)
    values = metadata()
    del values["perFrameIntrinsicCoeffs"]
    (inside / "metadata.json").write_text(json.dumps(values))
    for index in range(2):
        (inside / "rgb" / f"{index}.jpg").write_bytes(jpeg(index))
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        image = OpenEXR.File(header, {"R": np.full(SIZE, 2, dtype=np.float32)})
        image.write(str(inside / "depth" / f"{index}.exr"))
    write_ply(folder / "scan" / "cloud.ply", wall_along_y())
    return folder / "scan"
