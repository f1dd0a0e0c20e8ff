"""The training of the model of boundaries: from two small scenes to a file, and its parts by hand."""

from __future__ import annotations

import io
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import torch
from torchjoint_lab.training import (
    BoundaryModelOptions,
    boundary_examples,
    boundary_model,
    fit_boundary_model,
    labelled_evidence,
    save_boundary_model,
)
from torchjoint_lab.training.scene_merging import SceneMerging
from torchjoint_lab.training.superpoint_graph_files import SuperpointGraphFiles, load_evidence, save_evidence
from torchjoint_lab.training.variation import varied

from torchjoint.runtime.files import write_checked
from torchjoint.scene import Scene, Truth
from torchjoint.segments.learned.agglomeration import judge_of, merge_superpoints, merging_steps
from torchjoint.segments.learned.boundary_features import FEATURE_NAMES, boundary_features
from torchjoint.segments.learned.boundary_model import calibrated, load_boundary_model

QUICK = BoundaryModelOptions(thresholds=(0.2, 0.5), trees=3, leaves=4, folds=2)


@pytest.fixture(scope="module")
def prepared(scene_of):
    scenes = [scene_of(seed).scene for seed in (0, 1)]
    return [labelled_evidence(scene) for scene in scenes]


def test_columns_of_images_and_colours():
    images, colors = (set(boundary_examples.feature_columns(p)) for p in
                      (boundary_examples.IMAGE_FEATURES, boundary_examples.COLOR_FEATURES))  # fmt: skip
    assert not images & colors
    others = {FEATURE_NAMES[i] for i in set(range(len(FEATURE_NAMES))) - images - colors}
    assert not [name for name in others if any(word in name for word in ("color", "chroma", "agreement", "view"))]
    with pytest.raises(ValueError, match="no name begins with 'smell'"):
        boundary_examples.feature_columns(("smell",))


def test_features_without_images_and_colours_are_listed(scene_of):
    """The model learns to do without exactly what a bare cloud does not have."""
    scene = scene_of(0).scene
    columns = set(
        boundary_examples.feature_columns(boundary_examples.IMAGE_FEATURES + boundary_examples.COLOR_FEATURES)
    )
    bare = labelled_evidence(Scene(scene.points, truth=scene.truth))
    values = boundary_examples.boundary_features(bare.evidence)
    assert {i for i in range(len(FEATURE_NAMES)) if values[:, i].isnan().all()} == columns


def test_evidence_without_images_has_oriented_normals(scene_of, prepared):
    """So a model is judged without images, on the same superpoints' points and with the same cameras."""
    evidence, instance = labelled_evidence(scene_of(0).scene, images=False)
    assert torch.equal(instance, prepared[0].instance)
    values = boundary_examples.boundary_features(evidence)
    columns = boundary_examples.feature_columns(boundary_examples.IMAGE_FEATURES)
    assert values[:, columns].isnan().all()
    assert (evidence.boundaries.averages()["unoriented"] < 1).any()
    seen = prepared[0].evidence
    assert not boundary_examples.boundary_features(seen)[:, columns].isnan().all()


def test_labels_and_weights(prepared):
    evidence, instance = prepared[0]
    superpoint = evidence.superpoint
    own = torch.arange(len(evidence))
    exact = boundary_examples.boundary_examples(evidence, own, superpoint)
    assert exact.is_border.all()
    assert np.isclose(exact.weight.sum(), len(exact.weight) ** 0.5)
    np.testing.assert_allclose(exact.weight, exact.weight[0])  # superpoints of one instance each count alike
    half = torch.where(torch.arange(len(superpoint)) % 2 == 0, superpoint, superpoint.max() + 1)
    mixed = boundary_examples.boundary_examples(evidence, own, half)
    assert mixed.weight.min() < 0.6 * mixed.weight.max()  # than superpoints of several
    void = boundary_examples.boundary_examples(evidence, own, torch.where(superpoint == 0, -1, superpoint))
    touches = (exact.pairs == 0).any(0).numpy()
    assert touches.any()
    assert not void.weight[touches].any()
    assert (void.weight[~touches] > 0).all()
    one = boundary_examples.boundary_examples(evidence, own, torch.full_like(instance, 7))
    assert not one.is_border.any()


def test_calibration_maps_shares():
    rng = np.random.default_rng(0)
    probability = rng.random(4000)
    is_border = rng.random(4000) < probability**2
    calibration = boundary_model._calibration(probability, is_border, np.ones(4000))
    assert calibration.shape[1] <= boundary_model.KNOTS
    at = torch.tensor([0.2, 0.5, 0.9], dtype=torch.float64)
    torch.testing.assert_close(calibrated(at, calibration), at**2, rtol=0, atol=0.08)
    always = boundary_model._calibration(np.full(5, 0.3), np.ones(5, bool), np.ones(5))
    assert calibrated(at, always).tolist() == [1.0, 1.0, 1.0]


def test_rows_of_one_kind_make_no_trees():
    sample = boundary_examples.Sample(np.zeros((8, 80), np.float32), np.zeros(8, bool), np.ones(8))
    trees = boundary_model._grow([sample], QUICK)
    torch.testing.assert_close(trees.score(torch.zeros(2, 80)).sigmoid(), torch.full((2,), 0.1, dtype=torch.float64))


def test_evidence_on_disk(prepared, tmp_path):
    path = tmp_path / "scene.pt"
    save_evidence(path, prepared[0])
    (again,) = SuperpointGraphFiles([path])
    assert torch.equal(again.instance, prepared[0].instance)
    expected = boundary_examples.boundary_features(prepared[0].evidence)
    found = boundary_examples.boundary_features(again.evidence)
    torch.testing.assert_close(found, expected, rtol=0, atol=0, equal_nan=True)
    whole = path.read_bytes()
    for damaged in (whole[:1000], whole[:2000] + bytes([whole[2000] ^ 1]) + whole[2001:], b""):
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match=r"scene\.pt: damaged"):
            load_evidence(path)
    content = io.BytesIO()
    torch.save({"evidence": 1}, content)
    write_checked(path, content.getvalue())
    with pytest.raises(ValueError, match="expected the evidence of a scene, got dict"):
        load_evidence(path)


def test_evidence_is_read_by_several_threads(prepared, tmp_path):
    path = tmp_path / "scene.pt"
    save_evidence(path, prepared[0])
    with ThreadPoolExecutor(4) as pool:
        for again in pool.map(load_evidence, [path] * 40):
            assert torch.equal(again.instance, prepared[0].instance)


@pytest.mark.slow
def test_from_scenes_to_segments(prepared, tmp_path, set_threads):
    reports = []
    model = fit_boundary_model(prepared, QUICK, report=reports.append)
    assert [report.threshold for report in reports] == [0.2, 0.5]
    assert sum(one.boundaries for one in reports[0].bins) == reports[0].boundaries > 100
    assert reports[0].auc > 0.7
    save_boundary_model(tmp_path / "a.npz", model)
    loaded = load_boundary_model(tmp_path / "a.npz")
    evidence = prepared[0].evidence
    segments = merge_superpoints(evidence, merging_steps(loaded.thresholds), judge_of(loaded)).cut(0.5)
    assert 1 < int(segments.max()) + 1 < int(evidence.superpoint.max()) + 1
    set_threads(1)
    save_boundary_model(tmp_path / "b.npz", fit_boundary_model(prepared, QUICK))
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


@pytest.mark.slow
def test_members_have_seeds_of_their_own(prepared):
    """The model of two members is the mean of the models of their seeds."""
    reports = []
    found = fit_boundary_model(prepared, replace(QUICK, members=2, seed=3), report=reports.append)
    assert [report.threshold for report in reports] == [0.2, 0.5] * 2
    first, second = (fit_boundary_model(prepared, replace(QUICK, seed=seed)) for seed in (3, 4))
    values = boundary_features(prepared[0].evidence)
    for number in range(2):
        one, other = first.probability(number, values), second.probability(number, values)
        assert not torch.equal(one, other)
        assert torch.equal(found.probability(number, values), torch.stack([one, other]).mean(0))


def test_a_kind_is_judged_by_trees_that_did_not_see_it(monkeypatch):
    judged = []

    def grown(samples, options):
        judged.append({int(values[0, 0]) for values, *_ in samples})
        return boundary_model._constant(0.0)

    monkeypatch.setattr(boundary_model, "_grow", grown)
    samples = [(torch.full((2, 1), float(number)).numpy(), None, None) for number in range(5)]
    fold = boundary_model._parts(np.random.default_rng(0), 5, 4, ["room", "desk", "room", "desk", "room"])
    boundary_model._fit_all(samples, fold, sorted(set(fold.tolist())), QUICK, None)
    assert sorted(map(sorted, judged)) == [[0, 1, 2, 3, 4], [0, 2, 4], [1, 3]]
    of_one_kind = boundary_model._parts(np.random.default_rng(0), 5, 4, ["room"] * 5)
    assert sorted(of_one_kind.tolist()) == [0, 0, 1, 2, 3]


def test_a_varied_scene_may_be_a_cloud_alone(scene_of):
    scene = scene_of(0).scene
    alone = [len(varied(scene, str(key), 0.5).frames) == 0 for key in range(20)]
    assert 5 <= sum(alone) <= 15
    assert all(len(varied(scene, str(key), 0.0).frames) == len(scene.frames) for key in range(3))


def test_training_without_images_and_colours(scene_of):
    scenes = [scene_of(seed).scene for seed in (0, 1)]
    bare = [labelled_evidence(Scene(scene.points, truth=scene.truth)) for scene in scenes]
    model = fit_boundary_model(bare, QUICK)
    columns = boundary_examples.feature_columns(boundary_examples.IMAGE_FEATURES + boundary_examples.COLOR_FEATURES)
    used = {int(column) for trees in model.members[0].rounds for column in trees.feature[trees.left >= 0]}
    assert used
    assert not used & set(columns)


def test_errors():
    points = torch.rand(9, 3)
    for scene in (Scene(points, name="den"), Scene(points, truth=Truth(torch.full((9,), -1)), name="den")):
        with pytest.raises(ValueError, match="den has no true instances of points"):
            labelled_evidence(scene)
    with pytest.raises(ValueError, match="scenes: expected at least two, got 0"):
        fit_boundary_model([])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"folds": 1}, "folds: expected a whole number >= 2, got 1"),
        ({"trees": 0.5}, "trees: expected a whole number >= 1, got 0.5"),
        ({"learning_rate": 0}, "learning_rate: expected a number in"),
        ({"drop_images_share": 2}, "drop_images_share: expected a number in"),
        ({"members": 0}, "members: expected a whole number >= 1, got 0"),
        ({"variants": 0}, "variants: expected a whole number >= 1, got 0"),
        ({"noise": math.inf}, "noise: expected a number >= 0, got inf"),
        ({"thresholds": ()}, "thresholds: expected numbers in"),
        ({"thresholds": (0.5, 0.2)}, "thresholds: expected ascending numbers"),
    ],
)
def test_bad_options(change, message):
    with pytest.raises(ValueError, match=message):
        BoundaryModelOptions(**change)


def test_variants_of_a_merging_differ_by_noise_only(prepared):
    scene = prepared[0]
    member = load_boundary_model().members[0]

    def regions(variant, noise):
        merging = SceneMerging(0, variant)
        merging.start(scene)
        merging.advance(scene, 1, member.rounds[0], member.calibrations[0], BoundaryModelOptions(noise=noise))
        assert (merging.examples.pairs < int(merging.of_superpoint.max()) + 1).all()
        return merging.of_superpoint

    undisturbed = regions(0, 2.0)
    assert torch.equal(regions(1, 0.0), undisturbed)
    assert torch.equal(regions(1, 2.0), regions(1, 2.0))
    assert not torch.equal(regions(1, 2.0), undisturbed)
    assert not torch.equal(regions(1, 2.0), regions(2, 2.0))
