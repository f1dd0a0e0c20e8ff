"""The programs of pages for other tools run; what they write is read as the other tools read it."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import torch

import torchjoint as tj
from torchjoint.datasets.files.ply import write_cloud

ROOT = Path(__file__).parents[1]
SCENE = "scene0000_00"


def program(name):
    text = (ROOT / "docs" / "superpoints.md").read_text(encoding="utf-8")
    return re.search(rf"<!-- {name} -->\n```python\n(.*?)```", text, flags=re.DOTALL)[1]


def execute(name, **given):
    """The names that a program of the page leaves, which begins with those that are given."""
    exec(compile(program(name), "superpoints.md", "exec"), given)
    return given


@pytest.fixture(params=[300, pytest.param(100_000, marks=pytest.mark.slow)])
def labels(request, monkeypatch, tmp_path, run):
    """Superpoints of a bumpy surface, in the folder of the data."""
    monkeypatch.chdir(tmp_path)
    points = np.random.default_rng(0).random((request.param, 3))
    points[:, 2] = np.round(2 * points[:, 0]) * 0.2
    np.save(f"{SCENE}.npy", points)
    Path("superpoints").mkdir()
    run("superpoints", f"{SCENE}.npy", "-o", f"superpoints/{SCENE}.npy", "--no-picture")
    labels = np.load(f"superpoints/{SCENE}.npy")
    assert labels.shape == (request.param,)
    return labels


def batched(superpoints):
    """As SPFormer and ISBNet put scenes together: in place, numbers of the later scenes after those of the earlier."""
    offset, joined = 0, []
    for one in superpoints:
        one = torch.from_numpy(np.unique(one, return_inverse=True)[1])
        one += offset
        offset = int(one.max()) + 1
        joined.append(one)
    return torch.cat(joined).long()


def test_pooling():
    random = torch.Generator().manual_seed(0)
    labels, features = torch.tensor([0, 2, 1, 0, 2, 2]), torch.rand(6, 4, generator=random)
    found = execute("pooling", labels=labels, features=features, torch=torch)["of_points"]
    assert torch.allclose(found, torch.stack([features[labels == label].mean(0) for label in labels]))


def test_superpoint_files(labels):
    execute("superpoint files")
    # OneFormer3D reads bytes as int64, one for each row of points/SCENE.bin.
    raw = np.frombuffer(Path(f"super_points/{SCENE}.bin").read_bytes(), dtype=np.int64).copy()
    assert np.array_equal(raw, labels)
    stored = torch.load(f"superpoints/{SCENE}.pth", weights_only=False)  # ISBNet
    both = batched([stored, stored])
    assert torch.equal(both[: len(labels)] + labels.max() + 1, both[len(labels) :])
    # Mask3D makes numbers of its own of segIndices, and keeps them as float32 beside coordinates, colours and normals.
    segments = json.loads(Path(f"superpoints/{SCENE}_vh_clean_2.0.010000.segs.json").read_text())
    own = np.unique(np.array(segments["segIndices"]), return_inverse=True)[1]
    table = np.hstack((np.zeros((len(labels), 9)), own[..., None])).astype(np.float32)
    assert np.array_equal(table[:, 9].astype(np.int64), labels)


def test_superpoints_in_larger_files(labels):
    rng = np.random.default_rng(1)
    coordinates, colors = rng.random((2, len(labels), 3))
    wrong = rng.integers(0, 9, len(labels))
    Path("scannetv2/val").mkdir(parents=True)
    Path("scannetv2/test").mkdir()
    Path("processed/scannet/validation").mkdir(parents=True)
    whole = (coordinates, colors, wrong, wrong + 1.0, wrong - 100.0)
    torch.save(whole, f"scannetv2/val/{SCENE}_inst_nostuff.pth")
    torch.save(whole[:3], f"scannetv2/test/{SCENE}_inst_nostuff.pth")
    before = rng.random((len(labels), 12)).astype(np.float32)
    np.save("processed/scannet/validation/0000_00.npy", before)
    execute("superpoint files")
    xyz, rgb, superpoint, semantic, instance = torch.load(f"scannetv2/val/{SCENE}_inst_nostuff.pth", weights_only=False)
    for got, expected in zip((xyz, rgb, semantic, instance), (*whole[:2], *whole[3:]), strict=True):
        assert np.array_equal(got, expected)
    _, _, tested = torch.load(f"scannetv2/test/{SCENE}_inst_nostuff.pth", weights_only=False)
    both = batched([superpoint, tested])
    assert torch.equal(both[: len(labels)], torch.from_numpy(labels))
    after = np.load("processed/scannet/validation/0000_00.npy")
    assert after.dtype == np.float32
    assert np.array_equal(after[:, 9].astype(np.int64), labels)
    assert np.array_equal(np.delete(after, 9, axis=1), np.delete(before, 9, axis=1))


def bumpy(count, seed):
    points = torch.rand(count, 3, generator=torch.Generator().manual_seed(seed))
    points[:, 2] = (2 * points[:, 0]).round() * 0.2
    return points


def test_training_with_superpoints_on_disk(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    Path("clouds").mkdir()
    for number in range(2):
        points = bumpy(300 + number, number)
        write_cloud(Path(f"clouds/{number}.ply"), points, points.clamp(0, 1))
    np.save("clouds/0.npy", bumpy(302, 2).numpy())
    Path("clouds/README.md").write_text("no cloud")
    found = execute("training", __name__="training")
    for _ in range(2):  # the second time from the disk
        sizes = []
        for batch in found["loader"]:
            assert batch["offset"].tolist() == batch["ptr"][1:].tolist()
            sizes += batch["ptr"].diff().tolist()
        assert sorted(sizes) == [300, 301, 302]
        assert len(list(Path("kept").iterdir())) == 3
    samples = [found["loader"].dataset[number] for number in (1, 2)]
    batch = found["collate"](samples)
    read = [tj.datasets.load_cloud(f"clouds/{number}.ply") for number in (0, 1)]
    together = tj.superpoints(batch["points"], torch.cat([one.colors for one in read]), ptr=batch["ptr"])
    assert torch.equal(batch["superpoints"], together)


def test_superpoints_in_pointcept(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    scene = Path("data/scannet/train/scene0000_00")
    scene.mkdir(parents=True)
    coord, color = bumpy(300, 0).numpy(), (255 * bumpy(300, 0)).numpy()
    np.save(scene / "coord.npy", coord)
    np.save(scene / "color.npy", color)
    execute("for Pointcept")
    labels = torch.from_numpy(np.load(scene / "superpoint.npy"))
    assert torch.equal(labels, tj.superpoints(torch.from_numpy(coord), torch.from_numpy(color).to(torch.uint8)))
    few = labels[::7]  # a sample has gaps in its numbers
    given = {"superpoint": torch.cat([few, few]), "offset": torch.tensor([len(few), 2 * len(few)])}
    both = execute("in Pointcept", torch=torch, **given)["superpoint"]
    assert torch.equal(both, batched([few.numpy(), few.numpy()]))
