"""A small result on disk, made once."""

import pytest

import torchjoint as tj
from torchjoint.results.folder import write_result

CONFIG = tj.Config().set(["point_segments.method=learned", "boundary.detector=gradient"])


@pytest.fixture(scope="package")
def out(scene_of, tmp_path_factory):
    scene = scene_of(3, num_points=6000).scene
    folder = tmp_path_factory.mktemp("viewer") / "out"
    folder.mkdir()
    write_result(folder, scene, tj.JointSegmenter(CONFIG)(scene), CONFIG, "test")
    return folder
