"""The model of boundaries: probabilities by hand; its file, whole and damaged."""

from __future__ import annotations

import contextlib
import io
import zipfile
from dataclasses import replace

import numpy as np
import pytest
import torch
from reference.boosted_trees import EXAMPLE as BOOSTED_TREES
from torchjoint_lab.training.boundary_model_file import save_boundary_model

from torchjoint.segments.learned import boundary_model as boundary_model_file
from torchjoint.segments.learned.boundary_features import FEATURE_NAMES
from torchjoint.segments.learned.boundary_model import (
    BoostedTrees,
    BoundaryModel,
    MemberModel,
    calibrated,
    load_boundary_model,
)

TREES = BoostedTrees(**{name: array for name, array in BOOSTED_TREES.items() if name != "values"}, baseline=0.5)
PLAIN = torch.tensor([[0.0, 1.0], [0.0, 1.0]], dtype=torch.float64)  # changes nothing
KNOTS = torch.tensor([[0.2, 0.4, 0.8], [0.0, 0.5, 0.6]], dtype=torch.float64)


@pytest.fixture
def model():
    member = MemberModel((0.25, 0.5), FEATURE_NAMES, (TREES, replace(TREES, baseline=0.0)), (KNOTS, KNOTS))
    other = MemberModel((0.25, 0.5), FEATURE_NAMES, (replace(TREES, baseline=-1.0), TREES), (PLAIN, PLAIN))
    return BoundaryModel((member, other))


@pytest.fixture
def path(model, tmp_path):
    path = tmp_path / "model.npz"
    save_boundary_model(path, model)
    return path


def rewrite(path, **changes):
    """The file with other arrays; None leaves one out, bytes are stored as they are."""
    with np.load(path) as arrays:
        stored = dict(arrays) | changes
    with zipfile.ZipFile(path, "w") as archive:
        for name, values in stored.items():
            content = io.BytesIO()
            if isinstance(values, bytes):
                content.write(values)
            elif values is not None:
                np.lib.format.write_array(content, np.asarray(values), version=(1, 0))
            if values is not None:
                archive.writestr(f"{name}.npy", content.getvalue())


def test_probability_by_hand(model):
    values = torch.zeros(2, len(FEATURE_NAMES))
    values[:, 0] = torch.tensor([0.5, 0.6])
    values[:, 1] = torch.tensor([2.0, torch.nan])
    plain = BoundaryModel((MemberModel((0.5,), FEATURE_NAMES, (TREES,), (PLAIN,)),))
    log_odds = torch.tensor([0.5 - 1 + 0.25, 0.5 + 2 + 0.25], dtype=torch.float64)
    expected = log_odds.sigmoid()
    torch.testing.assert_close(plain.probability(0, values), expected, rtol=0, atol=1e-15)
    mean = (calibrated(expected, KNOTS) + (log_odds - 1.5).sigmoid()) / 2
    torch.testing.assert_close(model.probability(0, values), mean, rtol=0, atol=1e-15)
    with pytest.raises(ValueError, match=r"values: expected shape \[B, 94\], got \[2, 93\]"):
        model.probability(0, values[:, 1:])


def test_members_fit_together(model):
    with pytest.raises(ValueError, match="members: expected 1 to 100, got 0"):
        BoundaryModel(())
    other = MemberModel((0.3, 0.5), FEATURE_NAMES, (TREES, TREES), (PLAIN, PLAIN))
    with pytest.raises(ValueError, match="members: number 1 has other thresholds or features than number 0"):
        BoundaryModel((model.members[0], other))


def test_calibration_by_hand():
    at = torch.tensor([0.0, 0.2, 0.3, 0.4, 0.6, 0.8, 1.0], dtype=torch.float64)
    expected = torch.tensor([0.0, 0.0, 0.25, 0.5, 0.55, 0.6, 0.6], dtype=torch.float64)
    torch.testing.assert_close(calibrated(at, KNOTS), expected)


def test_the_file_gives_the_model_back(model, path, tmp_path):
    again = load_boundary_model(path)
    assert (again.thresholds, again.feature_names) == (model.thresholds, model.feature_names)
    values = torch.rand(50, len(FEATURE_NAMES)) * 2
    for number in range(2):
        assert torch.equal(again.probability(number, values), model.probability(number, values))
    save_boundary_model(tmp_path / "again.npz", again)
    assert (tmp_path / "again.npz").read_bytes() == path.read_bytes()


def test_a_shortened_file(path):
    whole = path.read_bytes()
    for length in range(0, len(whole), 97):
        path.write_bytes(whole[:length])
        with pytest.raises(ValueError, match=r"model\.npz: not a model of boundaries: not a whole archive") as error:
            load_boundary_model(path)
        assert "\n" not in str(error.value)


def test_a_changed_byte_raises_nothing_but_value_errors(path):
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(300):
        damaged = bytearray(whole)
        damaged[rng.integers(len(whole))] = rng.integers(256)
        path.write_bytes(damaged)
        with contextlib.suppress(ValueError):
            load_boundary_model(path)


HEADER = b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'fortran_order': False, 'shape': (%s,), }"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": np.array([1])}, r"format: expected \[2\], got \[1\]; from another version"),
        ({"format": None}, "format: missing"),
        (
            {"feature_names": np.array(FEATURE_NAMES[:-1])},
            f"feature_names: trained on 93 .*expected '{FEATURE_NAMES[-1]}', got None",
        ),
        (
            {"feature_names": np.array(FEATURE_NAMES[::-1])},
            f"expected 'crease_mean', got '{FEATURE_NAMES[-1]}'",
        ),
        ({"feature_names": np.zeros(80)}, "feature_names: expected 1 dimensions of kind 'U', got float64"),
        ({"thresholds": np.array([0.25, 1.5])}, r"thresholds: expected numbers in \[0, 1\]"),
        ({"thresholds": np.array([0.25])}, r"baselines: expected \[members, rounds\] for 1 rounds, got \[2, 2\]"),
        (
            {"baselines": np.array([[0.25, 0.0], [0.25, np.nan]])},
            "member1_round1_baseline: expected a finite number, got nan",
        ),
        ({"member0_round1_left": None}, "member0_round1_left: missing"),
        (
            {"member0_round1_left": np.ones((2, 3), np.int32)},
            "member0_round1_left: expected -1 or places after the node's",
        ),
        (
            {"member0_round1_left": np.ones((2, 3), np.int64)},
            "member0_round1_left: expected dtype torch.int32, got torch.int64",
        ),
        (
            {"member0_round0_threshold": np.ones((2, 2))},
            r"member0_round0_threshold: expected shape \[T, M\] = \[2, 3\], got \[2, 2\]",
        ),
        (
            {"member0_round0_threshold": np.full((2, 3), np.inf)},
            "member0_round0_threshold: expected finite numbers, got inf",
        ),
        (
            {"member0_round0_feature": np.full((2, 3), 94, np.int32)},
            r"member0_round0_feature: expected numbers in \[0, 94\), got 94",
        ),
        ({"member0_round0_calibration": np.zeros((2, 1))}, r"round0_calibration: expected shape \[2, C\]"),
        ({"member0_round0_calibration": np.zeros((2, 3))}, "round0_calibration: expected ascending x"),
        (
            {"member0_round0_calibration": np.array([[0, 1], [0, 1.5]])},
            r"member0_round0_calibration: expected numbers in \[0, 1\]",
        ),
        ({"member0_round2_left": np.zeros((1, 1))}, "round2_left: unexpected array"),
        ({"thresholds": b"nothing"}, "magic string"),
        ({"thresholds": (HEADER % b"9" * 1).ljust(127) + b"\n"}, "thresholds.npy: .* expected 72 bytes got 0"),
        (
            {"thresholds": (HEADER % b"99999999999999").ljust(127) + b"\n"},
            r"thresholds.npy: expected a shape that fits .* \[9{14}\]",
        ),
        ({"thresholds": np.array([None, 1])}, "thresholds.npy: expected numbers, or texts .* object"),
    ],
)
def test_damaged_arrays_are_named(path, changes, message):
    rewrite(path, **changes)
    with pytest.raises(ValueError, match=rf"model\.npz: not a model of boundaries: .*{message}") as error:
        load_boundary_model(path)
    assert "\n" not in str(error.value)


def test_too_large(path, monkeypatch):
    monkeypatch.setattr(boundary_model_file, "LARGEST", 1 << 10)
    with pytest.raises(ValueError, match="expected at most 1024 bytes of arrays"):
        load_boundary_model(path)


def test_missing_files(tmp_path, monkeypatch):
    with pytest.raises(FileNotFoundError, match=r"no\.npz: missing; expected a model"):
        load_boundary_model(tmp_path / "no.npz")
    boundary_model_file._packaged_model.cache_clear()
    monkeypatch.setattr(boundary_model_file, "PACKAGED", "no.npz")
    with pytest.raises(FileNotFoundError, match=r"no\.npz: missing; expected a model"):
        load_boundary_model()


def test_the_packaged_model_is_read_once(path, tmp_path, monkeypatch):
    boundary_model_file._packaged_model.cache_clear()
    monkeypatch.setattr(boundary_model_file, "files", lambda package: path.parent)
    monkeypatch.setattr(boundary_model_file, "PACKAGED", path.name)
    assert load_boundary_model() is load_boundary_model()
    boundary_model_file._packaged_model.cache_clear()
