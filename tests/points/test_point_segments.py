"""Step 6 as a whole: each method is the one that was asked for, images count as they should, and runs never matter."""

import dataclasses

import pytest
import torch

import torchjoint as tj
from torchjoint import ops
from torchjoint.points import segments as point_segments
from torchjoint.points.edge_weights import geometric_weights
from torchjoint.points.graph import PointGraph
from torchjoint.points.lidar.scan_segments import segment_scan
from torchjoint.points.orientation import orient_normals
from torchjoint.points.region_merging import merge
from torchjoint.points.segments import segment_points
from torchjoint.views.propagation import disagreement
from torchjoint.views.state import JointState

#: Those whose step 6 is another one; the tabletop's is the one that bridges.
PRESETS = {name: tj.Config.from_preset(name) for name in ("indoor", "tabletop", "paper")}


@pytest.fixture(scope="module")
def synthetic():
    return tj.synthetic.make_scene(seed=3, size="small")


def seen(scene: tj.Scene, config: tj.Config) -> tuple[PointGraph, JointState]:
    """The graph, and what all frames say."""
    segmenter = tj.JointSegmenter(config)
    segmenter.reset(scene.points, scene.colors)
    segmenter.update(list(scene.frames))
    return segmenter._require_graph(), segmenter.state


@pytest.fixture(scope="module", params=PRESETS)
def case(request, synthetic):
    config = PRESETS[request.param]
    return config, *seen(synthetic.scene, config)


@pytest.fixture(scope="module")
def indoor(synthetic):
    return seen(synthetic.scene, tj.Config())


class TestMethods:
    def test_edges_are_those_of_eq_3(self, indoor):
        graph, state = indoor
        config = tj.Config().set(
            [
                "point_segments.method=edges",
                "point_segments.scale=2",
                "point_segments.min_size=9",
                "propagation.weight=0.42",
            ]
        )
        normals, oriented = orient_normals(graph, state.facing)
        weights = geometric_weights(graph.points, graph.edge_index, normals, oriented, config.point_graph)
        weights += 0.42 * disagreement(state.views, state.overlap_sum, 6, config.propagation)
        expected = ops.felzenszwalb(graph.edge_index, weights, graph.num_points, 2.0, 9)
        assert torch.equal(segment_points(graph, state, config), expected)

    def test_a_scan_asks_no_image(self, indoor):
        graph, state = indoor
        config = tj.Config().set(["point_segments.method=scan"])
        expected = segment_scan(graph.points, config.scan)
        assert torch.equal(segment_points(graph, state, config), expected)
        empty = JointState.empty(graph.edge_index.shape[1], graph.num_points)
        assert torch.equal(segment_points(graph, empty, config), expected)

    def test_regions_are_the_default(self, indoor):
        results = [
            segment_points(*indoor, tj.Config().set(changes))
            for changes in ([], *([f"point_segments.method={name}"] for name in ("regions", "edges", "scan")))
        ]
        assert torch.equal(results[0], results[1])
        assert len({tuple(result.tolist()) for result in results}) == 3

    def test_every_step_of_regions_has_its_turn(self, indoor, monkeypatch):
        called = []
        planes = ["small_regions", "one_sided_planes", "crease_costs"]
        pieces = ["with_images", "merge", "piece_disagreement"]
        segments = ["with_images", "merge", "bridge", "best_overlaps", "absorb"]
        for name in {*planes, *pieces, *segments}:
            original = getattr(point_segments, name)

            def spy(*arguments, name=name, original=original):
                called.append(name)
                return original(*arguments)

            monkeypatch.setattr(point_segments, name, spy)
        segment_points(*indoor, tj.Config())
        assert called == planes + pieces + segments
        called.clear()
        segment_points(*indoor, tj.Config().set(["pieces.threshold=null", "image_support.min_size=0"]))
        assert called == planes + segments[:3]
        called.clear()
        segment_points(*indoor, tj.Config().set(["propagation.weight=0"]))
        assert called == [*planes, "merge"]

    def test_pieces_come_first_and_segments_are_made_of_them(self, indoor, monkeypatch):
        given, made = [], []

        def spy(region, edge_index, cost, threshold, min_size):
            given.append((region, threshold, min_size))
            made.append(merge(region, edge_index, cost, threshold, min_size))
            return made[-1]

        monkeypatch.setattr(point_segments, "merge", spy)
        names = {
            "pieces.threshold": 0.02,
            "pieces.min_size": 5,
            "region_merging.threshold": 0.33,
            "region_merging.min_size": 12,
        }
        segment_points(*indoor, tj.Config().set([f"{name}={value}" for name, value in names.items()]))
        assert [how for _, *how in given] == [[0.02, 5], [0.33, 12]]
        assert torch.equal(given[0][0], torch.arange(indoor[0].num_points))
        assert torch.equal(given[1][0], made[0])
        assert indoor[0].num_points > made[0].max() > made[1].max()

    def test_r_is_the_mean_of_that_of_edges_and_of_pieces(self, indoor, monkeypatch):
        graph, state = indoor
        given = []
        monkeypatch.setattr(point_segments, "with_images", lambda crease, r, *_: given.append(r) or crease)
        of_pieces = torch.rand(graph.edge_index.shape[1], generator=torch.Generator().manual_seed(0))
        monkeypatch.setattr(point_segments, "piece_disagreement", lambda *_: of_pieces)
        segment_points(graph, state, tj.Config())
        assert len(given) == 2
        assert torch.equal(given[1], (given[0] + of_pieces) / 2)

    def test_labels_leave_no_number_out(self, case):
        config, graph, state = case
        labels = segment_points(graph, state, config)
        assert labels.dtype == torch.int64
        assert labels.unique().tolist() == list(range(int(labels.max()) + 1))
        assert labels.max() > 3


class TestWeight0:
    def test_no_image_has_a_say(self, case):
        """As with no frames at all, once the normals' signs are known."""
        config, graph, state = case
        config = config.set(
            [
                "propagation.weight=0",
                "occlusion_bridging.min_votes=1",
                "occlusion_bridging.share=0",
                "occlusion_bridging.flatness=1",
            ]
        )
        blind = JointState.empty(graph.edge_index.shape[1], graph.num_points)
        blind.facing = state.facing
        assert torch.equal(segment_points(graph, state, config), segment_points(graph, blind, config))

    def test_otherwise_they_have(self, case):
        config, graph, state = case
        blind = JointState.empty(graph.edge_index.shape[1], graph.num_points)
        blind.facing = state.facing
        assert not torch.equal(segment_points(graph, state, config), segment_points(graph, blind, config))

    def test_the_heaviest(self, case):
        """No weight that a config may have makes costs too large for the operators."""
        config, graph, state = case
        labels = segment_points(graph, state, config.set(["propagation.weight=1000"]))
        assert labels.shape == (graph.num_points,)
        assert labels.max() > 3


class TestSameLabels:
    @pytest.fixture
    def labels(self, case):
        config, graph, state = case
        return segment_points(graph, state, config)

    @pytest.mark.parametrize("threads", [1, 2, 4])
    def test_on_any_number_of_threads(self, case, labels, threads):
        config, graph, state = case
        before = torch.get_num_threads()
        try:
            torch.set_num_threads(threads)
            assert torch.equal(segment_points(graph, state, config), labels)
        finally:
            torch.set_num_threads(before)

    def test_from_frames_in_another_order(self, synthetic, case, labels):
        config, graph, _ = case
        frames = [synthetic.scene.frames[i] for i in (4, 0, 5, 2, 1, 3)]
        _, state = seen(dataclasses.replace(synthetic.scene, frames=frames), config)
        assert torch.equal(segment_points(graph, state, config), labels)

    def test_from_two_segmenters_merged(self, synthetic, case, labels):
        scene, (config, _, _) = synthetic.scene, case
        first, second = tj.JointSegmenter(config), tj.JointSegmenter(config)
        for segmenter, frames in ((first, scene.frames[1::2]), (second, scene.frames[::2])):
            segmenter.reset(scene.points, scene.colors)
            segmenter.update(list(frames))
        first.merge(second)
        assert torch.equal(first.compute(images=False).points, labels)


def things_on_a_table() -> tuple[tj.Scene, torch.Tensor]:
    """A table-top of 1 m, a point every 2 cm, with a magazine and a pen that are flat and of its colour; three views
    from above, whose labels tell them apart. Truth: 0 table, 1 magazine, 2 pen."""

    def instance(x, y):
        magazine = (x - 0.3).abs().lt(0.15) & (y - 0.5).abs().lt(0.2)
        pen = (x - 0.75).abs().lt(0.025) & (y - 0.5).abs().lt(0.13)
        return magazine.long() + 2 * pen.long()

    x, y = (grid.flatten() for grid in torch.meshgrid(*[torch.arange(50) / 50 + 0.01] * 2, indexing="ij"))
    points = torch.stack([x, y, torch.zeros_like(x)], 1)
    intrinsics = torch.tensor([[100.0, 0, 60], [0, 100.0, 60], [0, 0, 1]], dtype=torch.float64)
    row, column = torch.meshgrid(torch.arange(120.0), torch.arange(120.0), indexing="ij")
    frames = []
    for k, center in enumerate(([0.5, 0.5, 1.0], [0.45, 0.5, 1.1], [0.55, 0.45, 1.0])):
        pose = torch.diag(torch.tensor([1.0, -1, -1, 1], dtype=torch.float64))  # looks down
        pose[:3, 3] = -(pose[:3, :3] @ torch.tensor(center, dtype=torch.float64))
        at_x = center[0] + (column - 60) / 100 * center[2]
        at_y = center[1] - (row - 60) / 100 * center[2]
        image = torch.full((3, 120, 120), 0.5)
        frames.append(tj.Frame(image, intrinsics, pose, labels=instance(at_x, at_y), name=f"{k}"))
    return tj.Scene(points, frames), instance(x, y)


@pytest.fixture(scope="module")
def table():
    scene, truth = things_on_a_table()
    return truth, *seen(scene, tj.Config())


class TestThingsOnATable:
    """What no geometry can see: only images tell flat things from what they lie on."""

    @staticmethod
    def best_iou(labels, truth, instance):
        thing = truth == instance
        return max(float(((labels == k) & thing).sum() / ((labels == k) | thing).sum()) for k in labels[thing].unique())

    @pytest.mark.parametrize("method", ["regions", "edges"])
    def test_images_find_the_magazine(self, table, method):
        truth, graph, state = table
        config = tj.Config().set([f"point_segments.method={method}"])
        with_images = segment_points(graph, state, config)
        assert self.best_iou(with_images, truth, 1) > 0.8
        without = segment_points(graph, state, config.set(["propagation.weight=0"]))
        assert without.max() == 0

    def test_images_confirm_the_pen(self, table):
        truth, graph, state = table
        assert int((truth == 2).sum()) < tj.Config().image_support.min_size
        labels = segment_points(graph, state, tj.Config())
        assert self.best_iou(labels, truth, 2) > 0.8
        # Where each image sees stripes of three kinds, none of them is the pen.
        stripe = torch.arange(120)[:, None] // 2 % 3
        torn = [
            dataclasses.replace(o, labels=torch.where(o.labels == 2, 2 + stripe, o.labels).int())
            for o in state.observations
        ]
        without = segment_points(graph, dataclasses.replace(state, observations=torn), tj.Config())
        assert torch.equal(without, torch.where(labels == labels[truth == 2].mode().values, 0, labels))
        assert self.best_iou(without, truth, 1) > 0.9  # large enough to need no image
