"""Batches whose workers end as `deadly_boundary` says, and what their results are compared with."""

import json
import os
from pathlib import Path

import pytest
import yaml

import torchjoint as tj

TESTS = Path(__file__).parent
CONFIG = tj.Config().set(["boundary.detector=deadly_boundary:DeadlyBoundary"])
OPTIONS = tj.RecordingOptions(max_frames=2, thin=0.1)
ENGINES = ["loky:2", "dask:2", "ray:2"]


def make_known(folder, patch):
    patch.setenv("TORCHJOINT_TEST_DEATHS", str(folder))
    patch.setenv("PYTHONPATH", os.pathsep.join([str(TESTS), os.environ.get("PYTHONPATH", "")]))


def contents(folder):
    """All files of a result; run.yaml without the seconds and the path of the recording."""
    files = {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    record, manifest = yaml.safe_load(files.pop("run.yaml")), json.loads(files.pop("manifest.json"))
    return files, record["counts"], record["config"], manifest["files"]


def assert_complete(out, expected):
    """Exactly the expected results, the tables, and nothing half-written."""
    assert {path.name for path in out.iterdir()} == {*expected, "batch.yaml", "summary.csv"}
    for name, files in expected.items():
        assert contents(out / name) == files


def undisturbed(scans, out):
    """What :func:`contents` says of each scene after a run that nothing disturbs; the scenes are copies."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TORCHJOINT_TEST_DEATHS", str(out))
        patch.syspath_prepend(TESTS)
        tj.recordings.segment_recording(scans / "a", out / "a", CONFIG, OPTIONS, allow_import=True)
    return dict.fromkeys("abc", contents(out / "a"))
