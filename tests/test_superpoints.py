"""Superpoints: what they are for, that they never depend on what they must not, and every bad input by name."""

import dataclasses
import re
from itertools import pairwise
from typing import get_type_hints

import numpy as np
import pytest
import torch
import yaml

import torchjoint as tj
from torchjoint.cloud.mesh import face_edges, vertex_normals
from torchjoint.config import SuperpointsConfig, presets, superpoint_table
from torchjoint.oversegmentation import SuperpointsParameters


def random(seed):
    return torch.Generator().manual_seed(seed)


def box_on_floor(spacing=0.02, seed=0):
    """A floor of 1 m x 1 m and the five visible sides of a box of 0.3 m on it: points, truth (0 floor, 1-5 sides)."""
    steps = torch.arange(0, 1, spacing)
    x, y = torch.meshgrid(steps, steps, indexing="ij")
    floor = torch.stack([x.flatten(), y.flatten(), torch.zeros(x.numel())], 1)
    floor = floor[~((floor[:, :2] > 0.35) & (floor[:, :2] < 0.65)).all(1)]
    a, b = (steps[steps < 0.3] + spacing / 2 for _ in range(2))
    u, v = (grid.flatten() for grid in torch.meshgrid(a, b, indexing="ij"))
    low, high = torch.full_like(u, 0.35), torch.full_like(u, 0.65)
    sides = [
        torch.stack([u + 0.35, v + 0.35, torch.full_like(u, 0.3)], 1),
        torch.stack([low, u + 0.35, v], 1),
        torch.stack([high, u + 0.35, v], 1),
        torch.stack([u + 0.35, low, v], 1),
        torch.stack([u + 0.35, high, v], 1),
    ]
    points = torch.cat([floor, *sides])
    truth = torch.cat([torch.full((len(part),), k) for k, part in enumerate([floor, *sides])])
    return points + 1e-3 * torch.randn(points.shape, generator=random(seed)), truth


def purity(labels, truth):
    """The share of points that are in the majority of their superpoint."""
    counts = torch.zeros(int(labels.max()) + 1, int(truth.max()) + 1).index_put_(
        (labels, truth), torch.ones(len(labels)), accumulate=True
    )
    return float(counts.max(dim=1).values.sum() / len(labels))


def random_mesh(seed, side=24):
    """A bumpy sheet of (side - 1)^2 x 2 triangles, some of them missing: points, faces."""
    height = np.random.default_rng(seed).normal(0, 0.3, (side, side))
    jitter = np.random.default_rng(seed + 1).uniform(-0.3, 0.3, (side, side, 2))
    x, y = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    points = np.stack([x + jitter[..., 0], y + jitter[..., 1], height], -1).reshape(-1, 3).astype(np.float32)
    i = (x * side + y)[:-1, :-1].ravel()
    faces = np.concatenate([np.stack([i, i + side, i + 1], 1), np.stack([i + 1, i + side, i + side + 1], 1)])
    faces = np.random.default_rng(seed + 2).permutation(faces)[: int(0.95 * len(faces))]
    return torch.from_numpy(points), torch.from_numpy(faces)


def scannet_superpoints(points, faces, threshold, min_size):
    """ScanNet's recipe once more, one number at a time, with none of the package's code."""
    p = points.numpy()
    one = np.float32(1)
    normals = np.zeros_like(p)
    counts = np.zeros(len(p), dtype=int)
    edges = []
    for a, b, c in faces.tolist():
        edges += [(a, b), (a, c), (c, b)]
        u, v = p[b] - p[a], p[c] - p[a]
        n = np.array([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]])
        n = n / np.sqrt((n[0] * n[0] + n[1] * n[1]) + n[2] * n[2])
        for vertex in (a, b, c):
            share = one / np.float32(counts[vertex] + 1)
            normals[vertex] = share * n + (one - share) * normals[vertex]
            counts[vertex] += 1
    weights = []
    for a, b in edges:
        d = p[b] - p[a]
        d = d / np.sqrt((d[0] * d[0] + d[1] * d[1]) + d[2] * d[2])
        x, y = normals[a], normals[b]
        w = one - ((x[0] * y[0] + x[1] * y[1]) + x[2] * y[2])
        weights.append(w * w if (y[0] * d[0] + y[1] * d[1]) + y[2] * d[2] > 0 else w)
    order = np.argsort(np.array(weights), kind="stable")
    group = [{i} for i in range(len(p))]
    limit = dict.fromkeys(range(len(p)), np.float32(threshold))
    of = list(range(len(p)))  # the component of each vertex

    def join(a, b):
        for i in group[b]:
            of[i] = a
        group[a] |= group[b]

    for e in order:
        a, b = of[edges[e][0]], of[edges[e][1]]
        if a != b and weights[e] <= limit[a] and weights[e] <= limit[b]:
            join(a, b)
            limit[a] = weights[e] + np.float32(threshold) / np.float32(len(group[a]))
    for e in order:
        a, b = of[edges[e][0]], of[edges[e][1]]
        if a != b and min(len(group[a]), len(group[b])) < min_size:
            join(a, b)
    number = {}
    return torch.tensor([number.setdefault(component, len(number)) for component in of])


@pytest.mark.parametrize("seed", range(4))
def test_segmentator_is_scannet_s(seed):
    points, faces = random_mesh(seed)
    for parameters in ({}, {"scale": 0.1, "min_size": 5}):
        expected = scannet_superpoints(points, faces, parameters.get("scale", 0.01), parameters.get("min_size", 20))
        assert expected.max() > 3
        assert torch.equal(tj.superpoints(points, faces=faces, preset="segmentator", **parameters), expected)


def test_mesh_edges_and_normals_by_hand():
    points = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [9, 9, 9]])
    faces = torch.tensor([[0, 1, 2], [0, 3, 1], [2, 2, 1]])  # normals +z and +y; the last has no area
    assert face_edges(faces).T.tolist()[:4] == [[0, 1], [0, 2], [2, 1], [0, 3]]
    normals = vertex_normals(points, faces)
    expected = [[0, 0.5, 0.5], [0, 0.5, 0.5], [0, 0, 1], [0, 1, 0], [0, 0, 0]]
    assert normals.tolist() == expected


@pytest.mark.parametrize(
    ("preset", "size", "parameters"), [("default", 1, {}), ("scan", 10, {}), ("segmentator", 1, {"scale": 0.1})]
)
def test_sides_of_a_box_are_separate(preset, size, parameters):
    points, truth = box_on_floor()
    points = size * points  # a box of 0.3 m, or 3 m
    labels = tj.superpoints(points, preset=preset, **parameters)
    assert labels.dtype == torch.int64
    assert labels.unique().tolist() == list(range(int(labels.max()) + 1))
    assert purity(labels, truth) > 0.9
    assert len(labels.unique()) < 80


def test_colours_separate_what_is_flat():
    points, _ = box_on_floor()
    points = points[points[:, 2] < 0.01]
    carpet = points[:, 0] > 0.7
    colors = torch.where(carpet[:, None], torch.tensor([0.8, 0.1, 0.1]), torch.tensor([0.2, 0.2, 0.6]))
    plain = tj.superpoints(points, colors, color_weight=0)
    assert torch.equal(plain, tj.superpoints(points))
    colored = tj.superpoints(points, colors, color_weight=1.0)
    assert purity(plain, carpet.long()) < 0.99
    assert purity(colored, carpet.long()) == 1
    assert torch.equal(colored, tj.superpoints(points, (colors * 255).to(torch.uint8), color_weight=1.0))


def test_a_viewpoint_makes_convex_edges_cheap():
    points, truth = box_on_floor()
    sensor = torch.tensor([-3.0, -3.0, 5.0])
    top, left, right = (points[truth == k] for k in (1, 2, 4))  # the sides that it sees
    seen = torch.cat([top, left, right])
    unsigned = tj.superpoints(seen)
    signed = tj.superpoints(seen, viewpoint=sensor)
    assert len(signed.unique()) < len(unsigned.unique())
    assert torch.equal(signed, tj.superpoints(seen, viewpoint=sensor.repeat(len(seen), 1)))
    assert torch.equal(signed, tj.superpoints(seen, viewpoint=sensor.repeat(1, 1)))


def test_normals_that_are_given_are_used():
    points, truth = box_on_floor()
    outwards = torch.tensor([[0.0, 0, 1], [0, 0, 1], [-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0]])[truth]
    labels = tj.superpoints(points, normals=5 * outwards, convex_factor=1.0)
    assert purity(labels, truth) == 1


def test_pieces_join_by_border_and_size():
    # Turns of 0.2 and 0.4 rad along a line: 0.2 x 1 x 1 / 2 = 0.1, then 0.4 x 2 x 1 / 3 = 0.267.
    angle = torch.tensor([0.0, 0.2, 0.6])
    normals = torch.stack([angle.sin(), torch.zeros(3), angle.cos()], 1)
    given = {"normals": normals, "edges": torch.tensor([[0, 1], [1, 2]]), "convex_factor": 1, "scale": 0, "min_size": 0}
    for joining, expected in ((0, [0, 1, 2]), (0.09, [0, 1, 2]), (0.11, [0, 0, 1]), (0.26, [0, 0, 1]), (0.27, [0] * 3)):
        assert tj.superpoints(torch.rand(3, 3), joining=joining, **given).tolist() == expected


def test_more_joining_gives_larger_superpoints():
    points = tj.synthetic.make_scene(0, num_views=2, num_points=4000, height=60, width=80).scene.points
    finer = [tj.superpoints(points, scale=0.1, joining=joining) for joining in (0, 2, 8, 1000)]
    assert [len(labels.unique()) for labels in finer] == sorted({len(one.unique()) for one in finer}, reverse=True)
    for fine, coarse in pairwise(finer):  # nested: the same joins, and more of them
        assert len(torch.unique(torch.stack([fine, coarse]), dim=1)[0]) == len(fine.unique())


def test_edges_of_ones_own():
    points = torch.rand(6, 3, generator=random(0))
    normals = torch.tensor([[0.0, 0, 1]]).repeat(6, 1)
    edges = torch.tensor([[0, 1, 3, 4], [1, 2, 4, 5]])
    labels = tj.superpoints(points, normals=normals, edges=edges, min_size=0)
    assert labels.tolist() == [0, 0, 0, 1, 1, 1]
    assert tj.superpoints(points, edges=edges.int(), min_size=3).tolist() == labels.tolist()
    assert tj.superpoints(points, normals=normals, edges=edges[:, :0], min_size=0).tolist() == list(range(6))


def clouds_of_several_kinds():
    box, _ = box_on_floor()
    uneven = torch.rand(5000, 3, generator=random(1)) ** 3
    beams = torch.cat([torch.zeros(20, 3), box[:777]])  # more than one in a hundred, but not of all points
    few = torch.cat([torch.zeros(5, 3), box[:300]])
    return [uneven, torch.rand(1, 3, generator=random(1)), box, torch.zeros(30, 3), beams, few, few]


@pytest.mark.filterwarnings("ignore:.*beams without return")
@pytest.mark.parametrize("preset", ["default", "scan"])
@pytest.mark.parametrize("threads", [1, 2, 3])
def test_a_cloud_in_a_batch_is_the_cloud_alone(threads, preset, set_threads):
    clouds = clouds_of_several_kinds()
    viewpoints = torch.rand(len(clouds), 3, generator=random(2))
    ptr = torch.tensor([0, *np.cumsum([len(cloud) for cloud in clouds])])
    alone = [tj.superpoints(cloud, preset=preset, viewpoint=v) for cloud, v in zip(clouds, viewpoints, strict=True)]
    set_threads(threads)
    together = tj.superpoints(torch.cat(clouds), ptr=ptr, viewpoint=viewpoints, preset=preset)
    again = tj.superpoints(clouds[0], preset=preset, viewpoint=viewpoints[0])
    assert torch.get_num_threads() == threads
    assert torch.equal(again, alone[0])
    offset = 0
    for labels, part in zip(alone, together.split([len(cloud) for cloud in clouds]), strict=True):
        assert torch.equal(part, torch.where(labels < 0, -1, labels + offset))
        offset += int(labels.max()) + 1
    assert (together < 0).sum() == 20


def test_meshes_in_a_batch_are_the_meshes_alone():
    meshes = [random_mesh(seed) for seed in (5, 6)]
    size = len(meshes[0][0])
    faces = torch.cat([meshes[0][1], meshes[1][1] + size])
    faces = faces[torch.randperm(len(faces), generator=random(3))]  # of both meshes, mixed
    order = [faces[(faces < size).all(1)], faces[(faces >= size).all(1)] - size]
    alone = [tj.superpoints(m[0], faces=f, preset="segmentator") for m, f in zip(meshes, order, strict=True)]
    points, ptr = torch.cat([m[0] for m in meshes]), torch.tensor([0, size, 2 * size])
    together = tj.superpoints(points, faces=faces, ptr=ptr.int(), preset="segmentator")
    assert torch.equal(together, torch.cat([alone[0], alone[1] + alone[0].max() + 1]))


class TestInvalidPoints:
    """What remains is segmented as if the points that are NaN or infinite had never been there."""

    POINTS = torch.rand(300, 3, generator=torch.Generator().manual_seed(0)) * torch.tensor([1.0, 1.0, 0.05])
    BAD = torch.arange(300) % 7 == 3

    def broken(self):
        points = self.POINTS.clone()
        points[self.BAD] = torch.tensor([float("nan"), 1.0, float("inf")])
        return points

    def check(self, labels, expected):
        assert torch.equal(labels[~self.BAD], expected)
        assert (labels[self.BAD] == -1).all()

    def test_a_cloud(self):
        colors = torch.rand(300, 3, generator=torch.Generator().manual_seed(1))
        expected = tj.superpoints(self.POINTS[~self.BAD], colors[~self.BAD], color_weight=1.0)
        with pytest.warns(UserWarning, match="points: 43 of 300 points are NaN or infinite; they are left out"):
            labels = tj.superpoints(self.broken(), colors, drop_invalid=True, color_weight=1.0)
        self.check(labels, expected)
        with pytest.warns(UserWarning, match="43 of 300"):
            assert (tj.Superpoints(color_weight=1.0)(self.broken(), colors, drop_invalid=True) == labels).all()
        with pytest.warns(UserWarning, match="43 of 300"):
            array = tj.superpoints(self.broken().numpy(), colors.numpy(), drop_invalid=True, color_weight=1.0)
        assert array.tolist() == labels.tolist()

    def test_a_batch_with_viewpoints(self):
        views = torch.tensor([[0.0, 0, 5], [0, 0, -5]])[(torch.arange(300) >= 100).long()]
        kept = ~self.BAD
        expected = tj.superpoints(
            self.POINTS[kept], ptr=torch.tensor([0, int(kept[:100].sum()), int(kept.sum())]), viewpoint=views[kept]
        )
        with pytest.warns(UserWarning, match="43 of 300"):
            labels = tj.superpoints(self.broken(), ptr=torch.tensor([0, 100, 300]), viewpoint=views, drop_invalid=True)
        self.check(labels, expected)

    @pytest.mark.parametrize(("name", "columns"), [("edges", 2), ("faces", 3)])
    def test_a_graph(self, name, columns):
        nodes = torch.randint(300, (4000, columns), generator=torch.Generator().manual_seed(2))
        nodes = nodes[(nodes[:, :1] != nodes[:, 1:]).all(1)]
        number = (~self.BAD).cumsum(0) - 1
        kept = number[nodes[~self.BAD[nodes].any(1)]]
        as_given = (lambda rows: rows.T) if name == "edges" else (lambda rows: rows)
        expected = tj.superpoints(self.POINTS[~self.BAD], **{name: as_given(kept)})
        with pytest.warns(UserWarning, match="43 of 300"):
            labels = tj.superpoints(self.broken(), **{name: as_given(nodes)}, drop_invalid=True)
        self.check(labels, expected)

    def test_nothing_is_left_out_of_a_whole_cloud(self):
        assert torch.equal(tj.superpoints(self.POINTS, drop_invalid=True), tj.superpoints(self.POINTS))

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ({"points": torch.full((5, 3), float("nan"))}, "points: 5 of 5 points are NaN or infinite"),
            ({"points": torch.rand(5)}, r"points: expected shape \[N, 3\], got \[5\]"),
            ({"points": torch.rand(5, 3), "edges": torch.tensor([[0], [5]])}, r"edges: expected point numbers in"),
            ({"points": torch.rand(5, 3), "ptr": torch.tensor([0, 4])}, "ptr: expected to go from 0 to N = 5"),
            ({"points": torch.rand(5, 3), "colors": torch.rand(4, 3)}, r"colors: expected shape \[5, 3\]"),
        ],
    )
    def test_errors(self, arguments, message):
        with pytest.raises(ValueError, match=message):
            tj.superpoints(**arguments, drop_invalid=True)


def test_strange_clouds():
    assert tj.superpoints(torch.tensor([[1.0, 2, 3]])).tolist() == [0]
    assert tj.superpoints(torch.zeros(100, 3)).tolist() == [0] * 100  # all in one place
    assert len(tj.superpoints(torch.rand(5, 3, generator=random(4)))) == 5  # fewer than neighbours
    line = torch.arange(50.0)[:, None] * torch.tensor([1.0, 2.0, 3.0])
    assert len(tj.superpoints(line)) == 50
    doubled = box_on_floor()[0].repeat(2, 1)
    assert purity(tj.superpoints(doubled), box_on_floor()[1].repeat(2)) > 0.8
    points = box_on_floor()[0]
    strided = torch.stack([points, points], 2)[:, :, 0]
    assert not strided.is_contiguous()
    assert torch.equal(tj.superpoints(strided), tj.superpoints(points))
    assert torch.equal(tj.superpoints(points.double()), tj.superpoints(points))


def test_no_gradient_and_no_change_of_the_input():
    points = box_on_floor()[0].requires_grad_()
    before = points.detach().clone()
    assert not tj.superpoints(points, viewpoint=torch.zeros(3)).requires_grad
    assert torch.equal(points.detach(), before)


POINTS = torch.rand(30, 3, generator=torch.Generator().manual_seed(5))
NAN = torch.full((30, 3), float("nan"))
EDGES = torch.tensor([[0, 1], [1, 2]])
ERRORS = [
    ({"points": [[0.0, 0, 0]]}, TypeError, "points: expected a torch.Tensor, got list"),
    ({"points": POINTS.to_sparse()}, TypeError, "points: expected a dense tensor, got one of torch.sparse_coo"),
    ({"points": POINTS.long()}, TypeError, "points: expected a floating dtype, got torch.int64"),
    ({"points": POINTS[:, :2]}, ValueError, "points: expected shape [N, 3], got [30, 2]"),
    ({"points": POINTS[:0]}, ValueError, "points: expected at least one point, got an empty cloud"),
    ({"points": NAN}, ValueError, "points: 30 of 30 points are NaN or infinite"),
    ({"points": POINTS + 1e13}, ValueError, "points: expected coordinates up to 1e+12, got 1e+13"),
    ({"colors": POINTS[:5]}, ValueError, "colors: expected shape [30, 3], got [5, 3]"),
    ({"colors": POINTS - 1}, ValueError, "colors: expected values in [0, 1] (or uint8)"),
    ({"color_weight": 1.0}, ValueError, "colors: color_weight > 0 needs the colours of the points, got None"),
    ({"normals": NAN}, ValueError, "normals: expected finite values"),
    ({"normals": 0 * POINTS}, ValueError, "normals: expected unit vectors, got 30 of length 0"),
    ({"edges": EDGES, "faces": EDGES}, ValueError, "edges: expected edges or faces, got both"),
    ({"edges": EDGES.T.float()}, TypeError, "edges: expected dtype torch.int32 or torch.int64, got torch.float32"),
    ({"edges": [[0], [1]]}, TypeError, "edges: expected a torch.Tensor, got list"),
    ({"edges": torch.zeros(3, 2).long()}, ValueError, "edges: expected shape [2, E], got [3, 2]"),
    ({"edges": EDGES + 29}, ValueError, "edges: expected point numbers in [0, 30), got 29 to 31"),
    ({"edges": EDGES - 1}, ValueError, "edges: expected point numbers in [0, 30), got -1 to 1"),
    ({"edges": EDGES, "ptr": torch.tensor([0, 1, 30])}, ValueError, "edges: expected points of one cloud, got [0, 1]"),
    ({"faces": EDGES}, ValueError, "faces: expected shape [F, 3], got [2, 2]"),
    ({"faces": torch.tensor([[0, 1, 30]])}, ValueError, "faces: expected point numbers in [0, 30), got 0 to 30"),
    ({"ptr": [0, 30]}, TypeError, "ptr: expected a torch.Tensor, got list"),
    ({"ptr": torch.tensor([0.0, 30])}, TypeError, "ptr: expected dtype torch.int32 or torch.int64"),
    ({"ptr": torch.tensor([0])}, ValueError, "ptr: expected shape [B + 1], B >= 1, got [1]"),
    ({"ptr": torch.tensor([0, 20])}, ValueError, "ptr: expected to go from 0 to N = 30, got 0 to 20"),
    ({"ptr": torch.tensor([1, 30])}, ValueError, "ptr: expected to go from 0 to N = 30, got 1 to 30"),
    ({"ptr": torch.tensor([0, 20, 10, 30])}, ValueError, "ptr: expected ascending numbers (no cloud is empty), got 20"),
    ({"ptr": torch.tensor([0, 20, 20, 30])}, ValueError, "got 20, 20 for cloud 1"),
    ({"viewpoint": (0, 0, 0)}, TypeError, "viewpoint: expected a torch.Tensor, got tuple"),
    ({"viewpoint": torch.zeros(2, 3)}, ValueError, "viewpoint: expected shape [3], [1, 3] or [30, 3], got [2, 3]"),
    ({"viewpoint": NAN[0]}, ValueError, "viewpoint: expected finite values"),
    ({"preset": "nope"}, ValueError, "preset: expected one of default, scan, segmentator, or a YAML file, got 'nope'"),
    ({"scale": -1.0}, ValueError, "superpoints.scale: expected >= 0, got -1.0"),
    ({"neighbors": 0}, ValueError, "superpoints.neighbors: expected >= 1, got 0"),
    ({"weight": "magic"}, ValueError, "superpoints.weight: expected one of angle, segmentator, got 'magic'"),
    ({"convex_factor": 2}, ValueError, "superpoints.convex_factor: expected <= 1, got 2"),
]


@pytest.mark.parametrize(("change", "error", "message"), ERRORS)
def test_errors_name_the_argument(change, error, message):
    with pytest.raises(error, match=re.escape(message)):
        tj.superpoints(**({"points": POINTS} | change))


def test_module_is_the_function():
    points, _ = box_on_floor()
    module = tj.Superpoints("scan", scale=0.5)
    assert torch.equal(module(points), tj.superpoints(points, preset="scan", scale=0.5))
    ptr = torch.tensor([0, 100, len(points)])
    assert torch.equal(module(points, ptr=ptr), tj.superpoints(points, ptr=ptr, preset=module.config))
    assert "scale=0.5" in repr(module)
    with pytest.raises(ValueError, match=r"superpoints\.sclae: unknown parameter, expected one of neighbors, "):
        tj.Superpoints(sclae=0.5)


def test_presets(tmp_path):
    assert set(presets("superpoints")) == {"default", "scan", "segmentator"}
    assert set(presets("superpoints")) & set(presets()) == {"default", "scan"}  # one vocabulary
    assert SuperpointsConfig.from_preset("default") == SuperpointsConfig()
    for name in presets("superpoints"):
        config = SuperpointsConfig.from_preset(name)
        assert f"`{name}`" in superpoint_table()
        file = tmp_path / "mine.yaml"
        file.write_text(yaml.safe_dump(dataclasses.asdict(config)))
        assert SuperpointsConfig.from_preset(str(file)) == config
    for text, message in (
        ("scael: 1", r"mine\.yaml: superpoints\.scael: unknown parameter, expected one of neighbors, "),
        ("scale: {a: 1}", r"mine\.yaml: superpoints\.scale: expected float"),
        ("- 1", r"mine\.yaml: expected parameters by name, got a list"),
        ("a: [", r"mine\.yaml: not valid YAML"),
    ):
        file.write_text(text)
        with pytest.raises((ValueError, TypeError), match=message):
            tj.superpoints(POINTS, preset=str(file))


def test_every_parameter_is_documented_and_an_argument():
    """What each argument does stands in the docstring; an unknown one is refused by name."""
    names = [spec.name for spec in dataclasses.fields(SuperpointsConfig)]
    assert [name for name in names if f"``{name}``" not in tj.superpoints.__doc__] == []
    points = torch.rand(30, 3)
    for name in names:
        value = getattr(SuperpointsConfig(), name)
        given = {name: 0.0 if name == "color_weight" else value}
        assert len(tj.superpoints(points, viewpoint=points[0], **given)) == 30
    with pytest.raises(ValueError, match=r"superpoints\.scael: unknown parameter, expected one of neighbors"):
        tj.superpoints(points, scael=1.0)


def test_parameters_that_do_not_count_are_told():
    """Whoever gave one believed that it was tuned."""
    points, _ = box_on_floor()
    normals, faces = torch.nn.functional.normalize(points + 1, dim=1), torch.arange(len(points) // 3 * 3).view(-1, 3)
    given = {"neighbors": 9, "reach": 0.2, "normal_neighbors": 20, "convex_factor": 0.3, "scale": 2.0}
    for of_cloud, unread in (
        ({}, "convex_factor"),
        ({"normals": normals}, "normal_neighbors"),
        ({"normals": normals, "preset": "segmentator"}, "normal_neighbors, convex_factor"),
        ({"edges": faces[:, :2].T}, "neighbors, convex_factor"),
        ({"faces": faces}, "neighbors, reach, normal_neighbors"),
    ):
        with pytest.warns(UserWarning, match=f"^{unread}: without effect here"):
            tj.superpoints(points, **of_cloud, **given)
    tj.superpoints(points, viewpoint=points[0], **given)


def test_outdoor_joins_the_rings_of_a_lidar():
    """The road near the sensor is seen as rings, 0.3 m apart, with a point every 2 cm."""
    rings = []
    for radius in torch.arange(4.0, 9.0, 0.3).tolist():
        angle = torch.arange(-0.6, 0.6, 0.02 / radius)
        rings.append(torch.stack([radius * angle.cos(), radius * angle.sin(), torch.zeros_like(angle)], dim=1))
    road = torch.cat(rings)
    road = road + 0.01 * torch.randn(road.shape, generator=random(0))
    share = tj.superpoints(road, preset="scan").bincount().max() / len(road)
    share_without = tj.superpoints(road, preset="scan", reach=0.0).bincount().max() / len(road)
    assert share > 0.9
    assert share_without < 0.5


def test_type_checkers_know_every_parameter():
    """Else ``superpoints(points, scal=2.0)`` would pass them."""
    assert get_type_hints(SuperpointsParameters) == get_type_hints(SuperpointsConfig)


def test_a_mesh_in_float64_is_that_of_segmentator_in_float32():
    """Open3D writes doubles, and ScanNet's segmentator reads them as floats."""
    generator = torch.Generator().manual_seed(0)
    vertices = torch.cartesian_prod(torch.arange(150.0), torch.arange(150.0), torch.zeros(1)).double() / 20
    vertices[:, 2] = (3 * vertices[:, 0]).sin().round() * 0.3
    vertices += 0.004 * torch.randn(len(vertices), 3, generator=generator) + torch.tensor([900.0, 5, 1])
    index = torch.arange(22500).reshape(150, 150)
    corners = [index[:-1, :-1], index[1:, :-1], index[:-1, 1:]], [index[1:, 1:], index[:-1, 1:], index[1:, :-1]]
    faces = torch.cat([torch.stack(one, dim=-1).reshape(-1, 3) for one in corners])
    labels = tj.superpoints(vertices, faces=faces.numpy(), preset="segmentator")  # arrays of both kinds
    assert torch.equal(labels, tj.superpoints(vertices.float(), faces=faces, preset="segmentator"))
