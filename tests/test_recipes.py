"""The programs of docs/recipes.md run, on small files of the kinds that they read."""

import json
import re
from pathlib import Path

import numpy as np
import torch

ROOT = Path(__file__).parents[1]


def program(name):
    text = (ROOT / "docs" / "recipes.md").read_text(encoding="utf-8")
    return re.search(rf"<!-- {name} -->\n```python\n(.*?)```", text, flags=re.DOTALL)[1]


def test_superpoint_files(monkeypatch, tmp_path, run):
    monkeypatch.chdir(tmp_path)
    np.save("scene0000_00.npy", np.random.default_rng(0).random((300, 3)))
    Path("superpoints").mkdir()
    run("superpoints", "scene0000_00.npy", "-o", "superpoints/scene0000_00.npy", "--no-picture")
    labels = np.load("superpoints/scene0000_00.npy")
    exec(compile(program("superpoint files"), "recipes.md", "exec"), {})
    assert np.array_equal(np.fromfile("super_points/scene0000_00.bin", np.int64), labels)
    assert np.array_equal(torch.load("superpoints/scene0000_00.pth", weights_only=False), labels)
    segments = json.loads(Path("superpoints/scene0000_00_vh_clean_2.0.010000.segs.json").read_text())
    assert segments["segIndices"] == labels.tolist()
