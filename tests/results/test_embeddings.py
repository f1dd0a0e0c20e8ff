"""Things by words: vectors of segments from an encoder of images.

The encoder of most tests is the mean colour of an image's pixels that are not grey; queries are colours. No package
here ships the weights of a larger one, so a slow test trains a small network on generated rooms.
"""

import json
import resource

import numpy as np
import pytest
import torch
from torch import nn
from torch.nn.functional import cross_entropy, normalize
from torchjoint_lab.synthetic import make_scene

import torchjoint as tj
from torchjoint.results.edits import Edit, Edits, write_edits
from torchjoint.results.embeddings import Embeddings
from torchjoint.results.folder import write_result


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
    read = Embeddings.load(tmp_path / "embeddings.npz")
    assert torch.equal(read.vectors, made.vectors)
    assert torch.equal(read.labels, result.points)
    good = {"vectors": np.ones((2, 2), np.float32), "labels": np.array([0, 1, -1], np.int32)}
    for bad, message in (
        ({"vectors": np.full((2, 2), np.nan, np.float32)}, "expected finite vectors"),
        ({"labels": np.array([0, 2], np.int32)}, "expected labels below 2, got 0 to 2"),
        ({"labels": np.array([0.5])}, r"expected labels \[N\] of int32"),
    ):
        np.savez(tmp_path / "bad.npz", **(good | bad))
        with pytest.raises(ValueError, match=rf"bad\.npz: {message}"):
            Embeddings.load(tmp_path / "bad.npz")


def test_vectors_of_other_segments():
    vectors = torch.tensor([[1.0, 0], [0, 1], [0, 0]])
    made = Embeddings(vectors, torch.tensor([0, 0, 0, 1, 2, -1]))
    assert made.of(made.labels.clone()) is made
    other = made.of(torch.tensor([1, 1, 1, 1, 0, 2]))
    assert torch.allclose(other.vectors, torch.tensor([[0, 0], [3 / 10**0.5, 1 / 10**0.5], [0, 0]]))
    assert other.seen.tolist() == [False, True, False]
    assert torch.equal(made.of(torch.tensor([0, 1, 2, -1, -1, -1])).vectors, vectors[[0, 0, 0]])  # parts inherit


@pytest.fixture
def saved(result, tmp_path):
    """A result on disk with its vectors; its first two segments are joined by hand."""
    folder = tmp_path / "room"
    folder.mkdir()
    write_result(folder, result.scene, result, tj.Config(), "test")
    tj.load_result(folder).embed(ColorEncoder(), size=32).save(folder)
    write_edits(folder, Edits(4, None, (Edit("join", (0, 1)),)))
    return folder


def test_a_result_keeps_its_vectors(saved):
    record = json.loads((saved / "segments.json").read_text())
    assert record["embeddings"] == "embeddings.npz"
    assert [one["embedding"] for one in record["segments"]] == [0, 1, 2, 3]
    assert record["segments"][2]["points"] == 2  # the rest stays
    plain, joined = tj.load_result(saved, edits=False).embeddings, tj.load_result(saved).embeddings
    assert tj.load_result(saved).find(torch.eye(3)[1] - 0.5, k=2) == joined.find(torch.eye(3)[1] - 0.5, k=2)
    assert plain.find(torch.eye(3)[1] - 0.5)[0][0] == 1
    both = nn.functional.normalize(plain.vectors[0] + plain.vectors[1], dim=0)
    assert torch.allclose(joined.vectors[0], both)
    assert torch.equal(joined.vectors[2], plain.vectors[2])  # ids stay
    tj.load_result(saved).embed(ColorEncoder(), size=32).save(saved)  # after the correction
    record = json.loads((saved / "segments.json").read_text())
    assert [one["embedding"] for one in record["segments"]] == [0, 0, 2, 3]
    with pytest.raises(ValueError, match="expected a result of 2 points, got 8"):
        Embeddings(plain.vectors, torch.zeros(2, dtype=torch.int64)).save(saved)
    Embeddings(plain.vectors, torch.zeros(2, dtype=torch.int64)).save(saved / "embeddings.npz")
    with pytest.raises(ValueError, match=r"embeddings\.npz: expected labels of 8 points, got 2; of another result"):
        tj.load_result(saved)


def test_the_layout_of_openmask3d(run, saved, tmp_path):
    """As its `visualization/` and `evaluation/` read it: a column is a mask, a row is its vector."""
    run("export", saved, "--format", "openmask3d", "-o", tmp_path / "out")
    run("export", saved, "--format", "openmask3d", "-o", tmp_path / "out", "--overwrite")
    masks, features = torch.load(tmp_path / "out" / "room_masks.pt"), tmp_path / "out" / "room_openmask3d_features.npy"
    read = tj.load_result(saved)
    assert masks.dtype == torch.bool
    ids, column = read.points.unique(return_inverse=True)  # none of an id that has no point after the correction
    assert torch.equal(masks.int().argmax(1), column)
    assert masks.sum(1).eq(1).all()
    np.testing.assert_array_equal(np.load(features), read.embeddings.vectors[ids])
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1_000, limits[1]))  # for a full disk
    try:
        with pytest.raises(SystemExit, match="full: File too large"):
            run("export", saved, "--format", "openmask3d", "-o", tmp_path / "full")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    (saved / "embeddings.npz").unlink()
    with pytest.raises(SystemExit, match="openmask3d: expected saved embeddings, got none"):
        run("export", saved, "--format", "openmask3d", "-o", tmp_path / "other")
    assert not (tmp_path / "other").exists()


def test_what_is_refused(result):
    for encoder, message in (
        (lambda images: images.mean((1, 2, 3)), r"encoder: expected vectors of shape \[6, D\], got \[6\]"),
        (lambda images: None, "got NoneType"),
        (lambda images: torch.full((len(images), 2), torch.nan), "expected finite vectors"),
    ):
        with pytest.raises(ValueError, match=message):
            result.embed(encoder)
    with pytest.raises(ValueError, match="embeddings: none were saved with this result"):
        result.find(torch.ones(3))
    with pytest.raises(TypeError, match="encoder: expected a module or a function, got int"):
        result.embed(3)
    with pytest.raises(ValueError, match="k, size and margin"):
        result.embed(ColorEncoder(), k=0)
    with pytest.raises(ValueError, match="expected frames, to see the segments, got 0"):
        tj.Result.of(tj.Segmentation(torch.zeros(3).long(), ()), tj.Scene(torch.rand(3, 3))).embed(ColorEncoder())
    made = result.embed(ColorEncoder(), size=16)
    for query in (torch.zeros(3), torch.rand(2), torch.full((3,), torch.inf)):
        with pytest.raises(ValueError, match="query: expected 3 finite numbers, not all 0"):
            made.find(query)
    with pytest.raises(ValueError, match="k: expected at least 1"):
        made.find(torch.rand(3), 0)


WORDS = ("book", "cabinet", "chair", "wall")


class WordEncoder(nn.Module):
    """Images [B, 3, 32, 32] -> [B, 16], in one space with WORDS."""

    def __init__(self):
        super().__init__()
        layers = [(nn.Conv2d(few, many, 3, 2, 1), nn.ReLU()) for few, many in ((3, 16), (16, 32), (32, 32))]
        self.layers = nn.Sequential(*(one for pair in layers for one in pair), nn.Flatten(), nn.Linear(32 * 16, 16))
        self.words = nn.Parameter(torch.randn(len(WORDS), 16))

    def forward(self, images):
        return self.layers(images - 0.5)

    def learn(self, images, word):
        """Draws images to their words. Half of them are mirrored, and all are in another light, step by step."""
        optimizer = torch.optim.Adam(self.parameters(), 2e-3)
        weight = 1 / torch.bincount(word)
        for _ in range(200):
            rows = torch.randint(len(images), (64,))
            batch = images[rows] * (0.7 + 0.6 * torch.rand(64, 3, 1, 1))
            batch = torch.where(torch.rand(64, 1, 1, 1) < 0.5, batch.flip(3), batch)
            cosine = normalize(self(batch), dim=1) @ normalize(self.words, dim=1).T
            optimizer.zero_grad()
            cross_entropy(10 * cosine, word[rows], weight=weight).backward()
            optimizer.step()


def true_room(seed):
    """The name of each thing of a furnished room, and the true segments as a result."""
    made = make_scene(seed)
    names = tuple(frame.name for frame in made.scene.frames)
    segments = tj.Segmentation(made.point_labels, list(made.image_labels), names=names)
    return made.instance_names, tj.Result.of(segments, made.scene)


def labelled_images(seed):
    """The images that `embed` shows an encoder of the things of a room with a name of WORDS, and their words."""
    names, result = true_room(seed)
    shown = []
    seen = result.embed(lambda images: shown.append(images) or images.mean((2, 3)) + 1, size=32).seen
    named = zip(seen.nonzero().flatten().tolist(), shown, strict=True)
    return [(image, WORDS.index(names[thing])) for thing, images in named if names[thing] in WORDS for image in images]


@pytest.mark.slow
def test_a_trained_network_finds_things_by_name():
    images, word = zip(*(one for seed in range(8) for one in labelled_images(seed)), strict=True)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        encoder = WordEncoder()
        encoder.learn(torch.stack(images), torch.tensor(word))
    hits = chance = 0
    for seed in range(40, 44):
        names, result = true_room(seed)
        found = result.embed(encoder, size=32)
        things = found.seen.nonzero().flatten().tolist()
        for name, query in zip(WORDS, encoder.words.detach(), strict=True):
            wanted = sum(names[thing] == name for thing in things)
            if wanted:
                hits += sum(names[thing] == name for thing, _ in found.find(query, k=wanted))
                chance += wanted**2 / len(things)
    assert hits > 2 * chance
