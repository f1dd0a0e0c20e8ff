"""Training the model of method scan: gains by hand, the same model twice, the command."""

import math

import numpy as np
import pytest
import torch
from torchjoint_lab.benchmark import real
from torchjoint_lab.benchmark.real_scenes import LabelledScene, RealScene, model_without
from torchjoint_lab.cli.train_scan_model import train_scan_model
from torchjoint_lab.evaluation.partial_truth import PartialTruth
from torchjoint_lab.synthetic import make_domain_scene
from torchjoint_lab.training import scan_model
from torchjoint_lab.training.scan_model import Example, fit_scan_model, gains

from torchjoint.segments.learned.boundary_model import load_boundary_model
from torchjoint.segments.scan.tree import FEATURE_NAMES, Tree

NAMES = ("scan.npz", "without-argo.npz", "without-kitti.npz")


def value(iou):
    return 0.5 * iou + 0.5 / (1 + math.exp(-12 * (iou - 0.5)))


def gain_of(sizes, instance):
    """Of the node that joins superpoints with so many points, each of one instance; -1 = houses."""
    superpoint = torch.arange(len(sizes)).repeat_interleave(torch.tensor(sizes))
    count = len(sizes)
    nodes = torch.tensor([count])
    parent, level = torch.tensor([count] * count + [-1]), torch.tensor([0] * count + [1])
    tree = Tree(torch.arange(len(superpoint)), superpoint, parent, level, nodes, torch.zeros(1, len(FEATURE_NAMES)))
    of_point = torch.tensor(instance)[superpoint]
    things = len(of_point[of_point >= 0].unique())
    return float(gains(tree, PartialTruth(of_point, of_point < 0), torch.ones(things).double())[count])


@pytest.mark.parametrize(
    ("sizes", "instance", "expected"),
    [
        ([20, 20], [0, 1], 2 * (value(1) - value(0.5))),  # two things
        ([30, 10], [5, 5], value(0.75) - value(1) - 0.15 * 10 / 15),  # one thing, and a fragment of it
        ([60, 30, 30], [0, 0, 0], value(0.5) - value(1) - 2 * 0.15),
        ([20, 20], [3, -1], value(1) - value(0.5)),  # a car at a wall
        ([20, 20], [-1, -1], 0.0),
    ],
)
def test_gains_by_hand(sizes, instance, expected):
    assert gain_of(sizes, instance) == pytest.approx(expected)


def examples(sensor=""):
    """Nodes that fall apart if their least gap is large."""
    random = np.random.default_rng(len(sensor))
    features = random.random((300, len(FEATURE_NAMES))).astype(np.float32)
    gain = features[:, FEATURE_NAMES.index("least_gap")] - 0.5
    return [Example(sensor, torch.from_numpy(features), torch.from_numpy(gain).double())]


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """The folder of the models that the command makes of few examples."""
    folder = tmp_path_factory.mktemp("models")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scan_model, "street_examples", lambda seeds: examples())
        patch.setattr(scan_model, "real_examples", lambda data: [*examples("kitti"), *examples("argo")])
        train_scan_model(folder, folder / "scan", (0, 1))
    return folder / "scan"


def test_equal_examples_make_equal_models():
    two = [fit_scan_model([*examples(), *examples("argo")], without, members=1) for without in ("", "", "argo")]
    values = torch.rand(50, len(FEATURE_NAMES))
    first, again, other = (model.probability(0, values) for model in two)
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
    wide = values[:, FEATURE_NAMES.index("least_gap")] > 0.5
    assert float(first[wide].min()) > float(first[~wide].max()) or ((first > 0.5) == wide).float().mean() > 0.9


@pytest.mark.slow
def test_the_command(trained, tmp_path):
    assert sorted(path.name for path in trained.iterdir()) == list(NAMES)
    for name in NAMES:
        assert len(load_boundary_model(trained / name, FEATURE_NAMES).members) == 3
    with pytest.raises(ValueError, match="--seeds: expected 0 <= first < end, got 3 3"):
        train_scan_model(None, tmp_path / "other", (3, 3))


def test_a_judged_sensor_is_left_out():
    assert [model_without(name) for name in ("argo", "semantickitti")] == ["without-argo.npz", "without-kitti.npz"]


@pytest.mark.slow
def test_a_street_is_judged_by_the_model_of_a_file(trained, tmp_path):
    made = make_domain_scene("street", 3, num_views=1, num_points=20_000, lidar="32").scene
    instance = made.truth.points.long()
    labelled = LabelledScene(made.select_points(torch.arange(len(instance))), PartialTruth(instance, instance < -1))
    one = RealScene("argo", "argo-street", lambda: labelled)
    (found,) = real.measure([one], 1, tmp_path, trained)
    assert 0 < found[one][0]["best_iou"] <= 1
