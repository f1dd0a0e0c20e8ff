"""Superpoints in data pipelines: dicts, objects, DataLoader workers; labels carried to other points."""

import copy
import re
from types import MappingProxyType

import pytest
import torch
from torch.utils.data import DataLoader, Dataset

import torchjoint as tj
from torchjoint.transforms import AddSuperpoints, transfer_labels


def cloud(seed):
    return torch.rand(300 + seed, 3, generator=torch.Generator().manual_seed(seed))


class Clouds(Dataset):
    """Five clouds as dicts."""

    def __init__(self, transform=None):
        self.transform = transform

    def __len__(self):
        return 5

    def __getitem__(self, index):
        sample = {"points": cloud(index), "index": index}
        return self.transform(sample) if self.transform else sample


class Data:
    """What torch_geometric's Data looks like from outside."""

    def __init__(self, **attributes):
        self.__dict__.update(attributes)


def test_a_dict_gets_labels_and_is_not_changed():
    sample = {"points": cloud(0), "colors": cloud(0), "name": "a", "normals": None}
    before = dict(sample)
    result = AddSuperpoints(color_weight=1.0)(sample)
    assert sample == before
    assert result is not sample
    assert torch.equal(result["superpoints"], tj.superpoints(cloud(0), cloud(0), color_weight=1.0))
    assert result["points"] is sample["points"]
    renamed = AddSuperpoints(points="xyz", colors=None, to="sp", preset="scan")({"xyz": cloud(0), "colors": "blue"})
    assert torch.equal(renamed["sp"], tj.superpoints(cloud(0), preset="scan"))


def test_an_object_gets_labels_and_is_not_changed():
    faces = torch.randint(300, (3, 500), generator=torch.Generator().manual_seed(1))
    data = Data(pos=cloud(0), face=faces, y=3)
    result = AddSuperpoints(points="pos", faces="face", preset="segmentator")(data)
    assert not hasattr(data, "superpoints")
    assert isinstance(result, Data)
    assert result.y == 3
    assert torch.equal(result.superpoints, tj.superpoints(cloud(0), faces=faces.T, preset="segmentator"))


def test_three_triangles_in_the_columns_of_torch_geometric():
    points, rows = torch.rand(9, 3), torch.arange(9).view(3, 3)
    expected = tj.superpoints(points, faces=rows, scale=0.1)
    for name, faces in (("face", rows.T), ("faces", rows)):
        data = Data(pos=points, **{name: faces})
        assert torch.equal(AddSuperpoints("pos", faces=name, scale=0.1)(data).superpoints, expected)


@pytest.mark.filterwarnings("ignore:.* beams without return")
def test_a_name_that_torch_geometric_offsets():
    class Offset(Data):
        def __inc__(self, key, value):
            return int(value.max()) + 1 if "batch" in key else 0

    result = AddSuperpoints(points="pos")(Offset(pos=cloud(0)))
    assert torch.equal(result.superpoints_batch, tj.superpoints(cloud(0)))
    assert not hasattr(result, "superpoints")
    assert hasattr(AddSuperpoints(points="pos", to="superpoints")(Offset(pos=cloud(0))), "superpoints")
    with pytest.warns(UserWarning, match="superpoints_batch: in a batch, label -1 becomes one"):
        AddSuperpoints(points="pos")(Offset(pos=torch.cat([torch.zeros(100, 3), cloud(0)])))


def test_torch_geometric_s_own_data():
    data_module = pytest.importorskip("torch_geometric.data", reason="not installed; `Data` above stands for it")
    data = data_module.Data(pos=cloud(0))
    result = AddSuperpoints(points="pos")(data)
    assert "superpoints_batch" not in data
    assert torch.equal(result.superpoints_batch, tj.superpoints(cloud(0)))
    other = AddSuperpoints(points="pos")(data_module.Data(pos=cloud(1)))
    both = data_module.Batch.from_data_list([result, other])
    ptr = torch.tensor([0, len(cloud(0)), len(cloud(0)) + len(cloud(1))])
    assert torch.equal(both.superpoints_batch, tj.superpoints(torch.cat([cloud(0), cloud(1)]), ptr=ptr))


def test_a_batch_keeps_its_clouds_apart():
    batch = {"points": torch.cat([cloud(0), cloud(1)]), "ptr": torch.tensor([0, 300, 601])}
    labels = AddSuperpoints()(batch)["superpoints"]
    first, second = tj.superpoints(cloud(0)), tj.superpoints(cloud(1))
    assert torch.equal(labels, torch.cat([first, second + first.max() + 1]))


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
@pytest.mark.parametrize("start", ["fork", pytest.param("spawn", marks=pytest.mark.slow)])
def test_workers_of_a_loader(start):
    transform = AddSuperpoints()
    # Here first: a fork must not mind that torch has started threads.
    expected = [transform({"points": cloud(index)})["superpoints"] for index in range(5)]
    loader = DataLoader(Clouds(transform), batch_size=None, num_workers=2, multiprocessing_context=start, timeout=600)
    for sample in loader:
        assert torch.equal(sample["superpoints"], expected[sample["index"]])


def test_errors_name_what_is_missing():
    with pytest.raises(KeyError, match=r"points: expected the points .* under this name, got dict with pos, x"):
        AddSuperpoints()({"pos": cloud(0), "x": 1})
    with pytest.raises(KeyError, match="pos: expected the points of the sample under this name, got Data with points"):
        AddSuperpoints("pos")(Data(points=cloud(0)))
    with pytest.raises(KeyError, match="superpoints: expected a sample without this entry"):
        AddSuperpoints()({"points": cloud(0), "superpoints": cloud(0)})
    with pytest.raises(ValueError, match="colors: color_weight > 0 needs the colours"):
        AddSuperpoints(color_weight=1.0)({"points": cloud(0)})
    with pytest.raises(ValueError, match=r"superpoints\.sclae: unknown parameter"):
        AddSuperpoints(sclae=1.0)
    assert "scale=3.0" in repr(AddSuperpoints(scale=3.0))


def test_transform_can_be_copied():
    transform = copy.deepcopy(AddSuperpoints(scale=2.0))
    assert transform.config.scale == 2.0


@pytest.mark.parametrize("seed", range(3))
def test_labels_of_the_nearest(seed):
    source, target = cloud(seed), cloud(seed + 10)
    labels = torch.arange(len(source)) * 10
    distances = torch.cdist(target.double(), source.double())
    nearest = distances.argmin(dim=1)
    assert torch.equal(transfer_labels(labels, source, target), nearest * 10)
    limited = transfer_labels(labels, source, target, max_distance=0.05)
    assert torch.equal(limited, torch.where(distances.amin(dim=1) <= 0.05, nearest * 10, -1))
    assert (limited == -1).any()


def test_ties_take_the_lowest_index():
    corners = torch.cartesian_prod(*[torch.tensor([0.0, 1.0])] * 3)[torch.randperm(8)].repeat(4, 1)
    middle = torch.tensor([[0.5, 0.5, 0.5], [0.0, 0.5, 0.5], [0.1, 0.1, 0.1]])
    distances = torch.cdist(middle.double(), corners.double())
    labels = transfer_labels(torch.arange(32), corners, middle)
    assert labels[:2].tolist() == [0, int(corners[:, 0].argmin())]
    assert labels[2] == (distances[2] == distances[2].min()).nonzero()[0]
    assert transfer_labels(torch.arange(50), torch.zeros(50, 3), middle).tolist() == [0, 0, 0]


def test_many_equal_points_take_little_memory():
    """As beams without return: each was a candidate for each."""
    points = torch.cat([torch.ones(1, 3), torch.zeros(100_000, 3)])
    assert transfer_labels(torch.arange(len(points)), points, points).unique().tolist() == [0, 1]


def test_labels_there_and_back():
    points = cloud(3)
    labels = tj.superpoints(points)
    sample = points[::3]
    assert torch.equal(transfer_labels(labels, points, sample, max_distance=0.0), labels[::3])
    features = torch.rand(len(points), 4)
    assert torch.equal(transfer_labels(features, points, sample), features[::3])


def test_labels_of_points_that_were_rounded():
    """500 km from the origin float32 keeps 6 cm: most labels were those of others, silently."""
    points = cloud(3).double() + 5e5
    labels = torch.arange(len(points))
    assert torch.equal(transfer_labels(labels, points, points), labels)
    for source, target in ((points, points.float()), (points.float(), points), (points.float(), points.float())):
        with pytest.warns(UserWarning, match=r"coordinates keep only 0\.06 m, but neighbours are 0\.0\d+ m apart"):
            transfer_labels(labels, source, target)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"labels": [1]}, TypeError, "labels: expected a torch.Tensor, got list"),
        ({"labels": torch.zeros(7)}, ValueError, "labels: expected one for each of 300 from_points, got [7]"),
        ({"labels": torch.zeros(300).to(torch.uint16)}, TypeError, "labels: expected a dtype that has -1"),
        ({"from_points": cloud(0)[:0]}, ValueError, "from_points: expected at least one point"),
        ({"to_points": cloud(0)[:, :2]}, ValueError, "to_points: expected shape [N, 3], got [300, 2]"),
        ({"max_distance": -1.0}, ValueError, "max_distance: expected a number >= 0 or None, got -1.0"),
        ({"max_distance": float("nan")}, ValueError, "max_distance: expected a number >= 0 or None, got nan"),
    ],
)
def test_bad_transfers(change, error, message):
    arguments = {"labels": torch.zeros(300).long(), "from_points": cloud(0), "to_points": cloud(0), "max_distance": 1.0}
    with pytest.raises(error, match=re.escape(message)):
        transfer_labels(**(arguments | change))


def test_other_mappings_are_left_alone():
    frozen = MappingProxyType({"points": cloud(0)})
    assert torch.equal(AddSuperpoints()(frozen)["superpoints"], tj.superpoints(cloud(0)))
    assert list(frozen) == ["points"]
