"""The structured forest, against its slow reference, and against OpenCV's detector."""

from __future__ import annotations

import gzip
from importlib.resources import files
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from reference.structured_forest import structured_forest_reference
from torch import Tensor
from torchjoint_lab.datasets.bsds import bsds_images
from torchjoint_lab.training.forest_file import write_forest

from torchjoint.images.forest import Forest, read_forest
from torchjoint.ops.internal import structured_forest

MODEL = Path(str(files("torchjoint.models"))) / "bsds500.yml.gz"
NUM_FEATURES = 7228


def random_trees(seed: int, num_trees: int = 3, length: int = 15) -> dict[str, Tensor]:
    """Trees that test random features near their typical values, with leaves at several depths."""
    rng = np.random.default_rng(seed)
    children = np.zeros((num_trees, length), np.int32)
    for tree in children:
        free = 1
        for place in range(length):
            # The first nodes are inner ones; a node that no parent names may be one, too.
            if free + 1 < length and free > place and rng.random() < 0.8:
                tree[place], free = free + 1, free + 2
    counts = np.where(children == 0, rng.integers(0, 6, children.shape), 0).astype(np.int32)
    features = rng.integers(0, NUM_FEATURES, children.shape).astype(np.int32)
    # Single values are about .3, differences about 0.
    thresholds = np.where(features < 3328, rng.uniform(0, 0.6, children.shape), rng.normal(0, 0.05, children.shape))
    pixels = rng.integers(0, 256, counts.sum()).astype(np.uint8)
    arrays = (children, features, thresholds.astype(np.float32), counts, pixels)
    names = ("children", "features", "thresholds", "boundary_counts", "boundary_pixels")
    return {name: torch.from_numpy(array) for name, array in zip(names, arrays, strict=True)}


def of_forest(forest: Forest) -> dict[str, object]:
    names = ("children", "features", "thresholds", "boundary_counts", "boundary_pixels")
    arrays = {name: torch.from_numpy(getattr(forest, name)) for name in names}
    return arrays | {"trees_per_site": forest.trees_per_site}


def random_images(seed: int, height: int, width: int, count: int = 1) -> Tensor:
    """Blurred noise, partly constant, so that there are gradients of all strengths."""
    rng = np.random.default_rng(seed)
    images = rng.random((count, height, width, 3)).astype(np.float32)
    images = np.stack([cv2.GaussianBlur(image, (0, 0), 1.5).reshape(height, width, 3) for image in images])
    images[:, : height // 4] = 0.5
    return torch.from_numpy(images).permute(0, 3, 1, 2)


@pytest.fixture(scope="module", params=[2, 4])
def random_forest(request, tmp_path_factory):
    """Random trees, a stride, and OpenCV's detector with them, which reads few nodes faster than many."""
    folder, trees = tmp_path_factory.mktemp("forest"), random_trees(7, num_trees=8, length=401)
    path = folder / "forest.yml.gz"
    write_forest(path, Forest(*(array.numpy() for array in trees.values()), trees_per_site=4))
    if request.param == 4:
        path = with_stride(path, folder / "sparse.yml", 4)
    return trees, request.param, cv2.ximgproc.createStructuredEdgeDetection(str(path))


class TestStructuredForest:
    @settings(max_examples=12, deadline=None)
    @given(
        seed=st.integers(0, 10**6), height=st.integers(1, 32), width=st.integers(1, 32), per_site=st.integers(1, 3),
        stride=st.sampled_from([2, 4]),
    )  # fmt: skip
    def test_it_is_the_reference(self, seed, height, width, per_site, stride):
        images, trees = random_images(seed, height, width, 2), random_trees(seed)
        found = structured_forest(images, **trees, trees_per_site=per_site, stride=stride)
        expected = structured_forest_reference(images, **trees, trees_per_site=per_site, stride=stride)
        # A feature within rounding of a threshold is as good as impossible with few, random trees.
        torch.testing.assert_close(found, expected, rtol=0, atol=1e-6)

    @pytest.mark.parametrize("size", [(480, 64), (64, 480), (66, 50), (38, 36), (20, 22), (2, 2)])
    def test_it_is_opencvs(self, random_forest, size):
        trees, stride, detector = random_forest
        images = random_images(0, *size)
        expected = detector.detectEdges(np.ascontiguousarray(images[0].permute(1, 2, 0).numpy()))
        found = structured_forest(images, **trees, trees_per_site=4, stride=stride)[0]
        assert found.max() > 0 or min(size) < 20
        assert (np.abs(found.numpy() - expected) > 1e-6).mean() < 0.01

    def test_photographs_are_opencvs(self, shared):
        """Among 300,000 walks a few come within the last bit of a threshold, and go the other way."""
        trees = of_forest(read_forest(MODEL))
        detector = cv2.ximgproc.createStructuredEdgeDetection(str(MODEL))
        for record in bsds_images(shared / "data" / "bsds500", "val")[:2]:
            image = record.image[:, :320, :320].contiguous()
            expected = detector.detectEdges(np.ascontiguousarray(image.permute(1, 2, 0).numpy()))
            found = structured_forest(image[None], **trees)[0].numpy()
            assert expected.max() > 0.1
            assert (np.abs(found - expected) > 1e-6).mean() < 0.005
            assert np.abs(found - expected).max() < 0.05

    def test_threads_and_batches_do_not_matter(self, set_threads):
        images, trees = random_images(1, 90, 130, 3), random_trees(1, length=201)
        together = structured_forest(images, **trees, trees_per_site=2)
        assert together.max() > 0
        for threads in (1, 2, 5):
            set_threads(threads)
            one = torch.cat([structured_forest(image[None], **trees, trees_per_site=2) for image in images])
            assert torch.equal(one, together)


def with_stride(forest: Path, path: Path, stride: int) -> Path:
    text = gzip.decompress(forest.read_bytes()).replace(b"stride: 2", f"stride: {stride}".encode())
    path.write_bytes(text)
    return path
