"""Things by words: vectors of segments from an encoder of images.

The encoder is real but small: the mean colour of an image's pixels that are not grey, in a basis of its own. Queries
are colours. No package here ships the weights of a larger one.
"""

import numpy as np
import pytest
import torch
from torch import nn

import torchjoint as tj
from torchjoint.results.embeddings import Embeddings


class ColorEncoder(nn.Module):
    """[B, 3, H, W] -> [B, 3]: how much the saturated pixels differ from grey."""

    def forward(self, images):
        assert not self.training
        return (images - 0.5).mean((2, 3)) * 2 + 1e-6


@pytest.fixture(scope="module")
def result():
    """A red, a green and a blue square before three cameras, and a point that none sees."""
    image = torch.full((3, 60, 90), 0.5)
    labels = torch.full((60, 90), -1)
    colors = torch.eye(3)
    for index in range(3):
        image[:, 15:45, 30 * index + 5 : 30 * index + 25] = colors[index][:, None, None]
        labels[15:45, 30 * index + 5 : 30 * index + 25] = index
    camera = torch.tensor([[60.0, 0, 45], [0, 60, 30], [0, 0, 1]])
    points = torch.tensor([[(30 * i + 15 - 45) / 60, 0.0, 1.0] for i in range(3)] + [[0.0, 0, -5]])
    points = torch.cat([points, points + torch.tensor([0.01, 0.01, 0])])
    frames = [tj.Frame(image, camera, torch.eye(4), name=f"f{i}") for i in range(3)]
    of_points = torch.tensor([0, 1, 2, 3] * 2)
    return tj.Result.of(tj.Segmentation(of_points, [labels] * 3, names=("f0", "f1", "f2")), tj.Scene(points, frames))


def test_a_colour_finds_its_thing(result):
    encoder = ColorEncoder().train()
    found = result.embed(encoder, size=32)
    assert encoder.training
    assert found.vectors.shape == (4, 3)
    assert found.seen.tolist() == [True, True, True, False]
    for index, color in enumerate(torch.eye(3)):
        best = found.find(color - 0.5)
        assert len(best) == 3  # not the one that no frame sees
        assert best[0][0] == index
        assert best[0][1] > 0.95
        assert best[1][1] < 0.5
    assert torch.allclose(found.vectors[:3].norm(dim=1), torch.ones(3))


def test_it_is_the_mean_of_both_images_of_all_views(result):
    seen = []

    def encoder(images):
        seen.append(images)
        return images.mean((2, 3))

    found = result.embed(encoder, k=2, size=16, margin=0.0)
    assert [len(images) for images in seen] == [4, 4, 4]
    vectors = nn.functional.normalize(seen[0].mean((2, 3)), dim=1).mean(0)
    assert torch.allclose(found.vectors[0], nn.functional.normalize(vectors, dim=0))
    assert torch.allclose(seen[0][0][:, 8, 8], torch.tensor([1.0, 0, 0]))  # the thing
    assert torch.allclose(seen[0][0][:, 8, 0], torch.full((3,), 0.5))  # 20 x 30 pixels: bars at the sides


def test_saved_and_loaded(result, tmp_path):
    made = result.embed(ColorEncoder(), size=16)
    made.save(tmp_path / "embeddings.npz")
    assert torch.equal(Embeddings.load(tmp_path / "embeddings.npz").vectors, made.vectors)
    np.savez(tmp_path / "bad.npz", vectors=np.full((2, 2), np.nan, np.float32))
    with pytest.raises(ValueError, match=r"bad\.npz: expected finite vectors"):
        Embeddings.load(tmp_path / "bad.npz")


def test_what_is_refused(result):
    for encoder, message in (
        (lambda images: images.mean((1, 2, 3)), r"encoder: expected vectors of shape \[6, D\], got \[6\]"),
        (lambda images: None, "got NoneType"),
        (lambda images: torch.full((len(images), 2), torch.nan), "expected finite vectors"),
    ):
        with pytest.raises(ValueError, match=message):
            result.embed(encoder)
    with pytest.raises(ValueError, match="k, size and margin"):
        result.embed(ColorEncoder(), k=0)
    with pytest.raises(ValueError, match="expected frames, to see the segments, got 0"):
        tj.Result.of(tj.Segmentation(torch.zeros(3).long(), ()), tj.Scene(torch.rand(3, 3))).embed(ColorEncoder())
    made = result.embed(ColorEncoder(), size=16)
    for query in (torch.zeros(3), torch.rand(2), torch.full((3,), torch.inf)):
        with pytest.raises(ValueError, match="query: expected 3 finite numbers that are not all 0"):
            made.find(query)
    with pytest.raises(ValueError, match="k: expected at least 1"):
        made.find(torch.rand(3), 0)
