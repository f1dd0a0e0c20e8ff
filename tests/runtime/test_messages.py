"""A plain installation: what it lacks is told in one way, and nothing else needs it."""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path

import pytest
import torch
from torchjoint_lab.synthetic.models import load_parts

import torchjoint as tj
from torchjoint.live import RerunLog
from torchjoint.results.exports.clouds import export_las
from torchjoint.runtime.messages import needed_for

#: What each missing module stops, and the extra that brings it.
MISSING = {
    "open3d": (lambda path, result: load_parts(path, None, None), "Open3D", "open3d"),
    "torchmetrics": (lambda path, result: tj.metrics.ScannetAveragePrecisionMetric, "torchmetrics", "metrics"),
    "laspy": (lambda path, result: export_las(path, result), "laspy", "export"),
    "rerun": (lambda path, result: RerunLog(None), "rerun", "rerun"),
}


@pytest.mark.parametrize("module", MISSING)
def test_what_is_missing_is_told(module, tmp_path, monkeypatch):
    use, package, extra = MISSING[module]
    for name in [name for name in sys.modules if name.startswith((module.split(".")[0], "torchjoint.metrics.modules"))]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delattr(tj.metrics, "modules", raising=False)
    monkeypatch.setitem(sys.modules, module.split(".")[0], None)
    result = tj.Result.of(tj.Segmentation(torch.zeros(5, dtype=torch.int64), ()), tj.Scene(torch.rand(5, 3)))
    message = re.escape(f"needs {package}: pip install 'torchjoint[{extra}]'")
    with pytest.raises(ModuleNotFoundError, match=message):
        use(tmp_path / "file", result)


def test_a_package_that_does_not_load_is_not_called_missing():
    with (
        pytest.raises(ModuleNotFoundError, match=r"fusing needs Open3D: installed, but .*: libusb-1.0.so.0"),
        needed_for("fusing", "Open3D", "torchjoint[open3d]"),
    ):
        raise ImportError("libusb-1.0.so.0: cannot open shared object file")


def test_only_the_extra_viewer_brings_the_viewer():
    pyproject = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))
    extras = {"": pyproject["project"]["dependencies"], **pyproject["project"]["optional-dependencies"]}
    bringing = {extra for extra, needed in extras.items() if any(re.match("viser", name) for name in needed)}
    assert bringing == {"viewer"}
    through = {extra for extra, needed in extras.items() if any("[" in name and "viewer" in name for name in needed)}
    assert through == {"all"}
