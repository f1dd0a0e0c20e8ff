"""Step 6, method regions: what each stage decides, images count as they should, and runs never matter."""

import dataclasses
from itertools import pairwise

import pytest
import torch
from hand_graph import graph_of
from hand_wall import LEFT, RIGHT, wall_behind_a_strip
from torchjoint_lab.regions import PRESETS, REGIONS, RegionsConfig, occlusion_bridging, segmenter
from torchjoint_lab.regions import method as regions_method

import torchjoint as tj
from torchjoint.cloud.graph import PointGraph
from torchjoint.views.evidence import Evidence
from torchjoint.views.observations import Observations


@pytest.fixture(scope="module")
def synthetic(scene_of):
    return scene_of(3)


def segment_points(graph: PointGraph, state: Evidence, config: RegionsConfig) -> torch.Tensor:
    return REGIONS.segment(graph, state, config)


def graph_and_state(scene: tj.Scene, config: RegionsConfig) -> tuple[PointGraph, Evidence]:
    """The graph, and what all frames say."""
    joint = tj.JointSegmenter(config, method=REGIONS)
    joint.reset(scene.points, scene.colors)
    joint.update(list(scene.frames))
    return joint.graph, joint.state


@pytest.fixture(scope="module", params=PRESETS)
def case(request, synthetic):
    config = RegionsConfig.from_preset(request.param)
    return config, *graph_and_state(synthetic.scene, config)


class TestConfig:
    def test_it_has_the_package_s_stages(self):
        assert RegionsConfig.stages().items() >= tj.Config.stages().items()
        assert RegionsConfig.from_preset("regions") == RegionsConfig()

    def test_an_unknown_preset(self):
        with pytest.raises(ValueError, match="preset: expected one of regions, indoor, tabletop, or a YAML file, got "):
            segmenter("x")

    def test_a_config_without_the_parameters(self):
        with pytest.raises(TypeError, match="config: method regions expected a RegionsConfig, got Config"):
            tj.JointSegmenter(method=REGIONS).reset(torch.rand(20, 3))

    def test_parameters_can_be_tried_after_all_frames(self, synthetic):
        joint = segmenter("regions")
        joint.reset(synthetic.scene.points)
        joint.update(list(synthetic.scene.frames))
        for preset in PRESETS:
            expected = segmenter(preset)
            expected.reset(synthetic.scene.points)
            expected.update(list(synthetic.scene.frames))
            again = joint.compute(images=False, config=RegionsConfig.from_preset(preset))
            assert torch.equal(again.points, expected.compute(images=False).points)
        with pytest.raises(ValueError, match=r"stored evidence depends on region_costs\.normal_neighbors; add"):
            joint.compute(config=RegionsConfig().set(["region_costs.normal_neighbors=20"]))


def test_labels_leave_no_number_out(case):
    config, graph, state = case
    labels = segment_points(graph, state, config)
    assert labels.dtype == torch.int64
    assert labels.unique().tolist() == list(range(int(labels.max()) + 1))
    assert labels.max() > 3


#: Method regions with nothing but region merging up to 0.41; each test adds the stage that it is about.
BARE = RegionsConfig().set(
    [
        "region_costs.weight=1",
        "superpoints.threshold=null",
        "region_merging.threshold=0.41",
        "region_merging.min_size=0",
        "image_support.min_size=0",
    ]
)


def row_of_points(r, *observations, normals=None):
    """Points in a row, flat unless normals are given: the edges between them have these r. The graph, and the state."""
    count = len(r) + 1
    points = torch.stack([torch.arange(count).float(), torch.zeros(count), torch.zeros(count)], 1)
    normals = torch.tensor([[0.0, 0, 1]]).repeat(count, 1) if normals is None else normals
    edges = [[i, i + 1] for i in range(count - 1)]
    overlaps = 1 - torch.tensor(r, dtype=torch.float64)  # of the one image that saw both ends
    facing = torch.zeros(count, dtype=torch.int64)
    contours = torch.zeros(2, count - 1, dtype=torch.int32)
    views = torch.ones(count - 1, dtype=torch.int64)
    state = Evidence(views, overlaps, facing, *contours, Observations(observations))
    return graph_of(points, edges, normals), state


def labels_of(case, *changes):
    return segment_points(*case, BARE.set(changes)).tolist()


class TestStagesByHand:
    """What each stage of method regions decides, where nothing else does."""

    @pytest.fixture(autouse=True)
    def no_smallest_sizes(self, monkeypatch):
        # each point keeps its normal
        monkeypatch.setattr(regions_method, "small_regions", lambda graph, *_: torch.arange(graph.num_points))
        monkeypatch.setattr(regions_method, "MIN_SUPERPOINT", 0)

    def test_borders_merge_up_to_the_threshold(self, seen):
        case = row_of_points([0.0, 0.3, 0.5, 0.0], seen(range(5), [0] * 5))
        assert labels_of(case) == [0, 0, 0, 1, 1]
        assert labels_of(case, "region_merging.threshold=0.2") == [0, 0, 1, 2, 2]
        assert labels_of(case, "region_merging.threshold=0.6") == [0] * 5

    def test_small_segments_join_across_the_cheapest_border(self, seen):
        case = row_of_points([0.0, 0.0, 0.9, 0.6, 0.0, 0.0], seen(range(7), [0] * 7))
        assert labels_of(case) == [0, 0, 0, 1, 2, 2, 2]
        assert labels_of(case, "region_merging.min_size=2") == [0, 0, 0, 1, 1, 1, 1]

    def test_without_images_flat_points_are_one(self, seen):
        views = seen(range(6), [0] * 3 + [1] * 3)
        case = row_of_points([0.0, 0.0, 1.0, 0.0, 0.0], views)
        assert labels_of(case) == [0, 0, 0, 1, 1, 1]
        assert labels_of(case, "region_costs.weight=0") == [0] * 6
        assert labels_of(row_of_points([0.0, 0.0, 1.0, 0.0, 0.0])) == [0] * 6  # no frame came

    def test_superpoints_part_what_edges_alone_do_not(self, seen):
        """An edge across the border costs 0.3. Its two superpoints have no label in common: (0.3 + 1) / 2."""
        case = row_of_points([0.0, 0.0, 0.3, 0.0, 0.0], seen(range(6), [0] * 3 + [1] * 3))
        assert labels_of(case) == [0] * 6
        superpoints = ["superpoints.threshold=0.1"]
        assert labels_of(case, *superpoints) == [0, 0, 0, 1, 1, 1]
        # It is the mean that decides.
        assert labels_of(case, *superpoints, "region_merging.threshold=0.64") == [0, 0, 0, 1, 1, 1]
        assert labels_of(case, *superpoints, "region_merging.threshold=0.66") == [0] * 6

    def test_superpoints_join_what_edges_alone_do_not(self, seen):
        """The other way round: an edge costs 0.6, and the superpoints have the same label: (0.6 + 0) / 2."""
        case = row_of_points([0.0, 0.0, 0.6, 0.0, 0.0], seen(range(6), [7] * 6))
        assert labels_of(case) == [0, 0, 0, 1, 1, 1]
        superpoints = ["superpoints.threshold=0.1"]
        assert labels_of(case, *superpoints) == [0] * 6
        assert labels_of(case, *superpoints, "region_merging.threshold=0.29") == [0, 0, 0, 1, 1, 1]

    def test_segments_are_made_of_superpoints(self, seen, monkeypatch):
        """A superpoint is never split: what is too small for one has gone, although its borders are dear."""
        case = row_of_points([0.0, 0.0, 0.9, 0.6, 0.0, 0.0], seen(range(7), [0] * 3 + [1] + [2] * 3))
        assert labels_of(case, "superpoints.threshold=0.1") == [0, 0, 0, 1, 2, 2, 2]
        with monkeypatch.context() as patch:
            patch.setattr(regions_method, "MIN_SUPERPOINT", 2)
            assert labels_of(case, "superpoints.threshold=0.1") == [0, 0, 0, 1, 1, 1, 1]
        # Up to the superpoints' own threshold, borders of 0.3 are no borders, whatever region merging would make of
        # them.
        soft = row_of_points([0.0, 0.0, 0.3, 0.0, 0.0], seen(range(6), [0] * 3 + [1] * 3))
        assert labels_of(soft, "superpoints.threshold=0.35") == [0] * 6

    def test_a_small_segment_needs_an_image_s_support(self, seen):
        """Points 3-6 are a segment of their own. An image with a segment of that shape keeps it; one without does not,
        and it goes across its cheaper border."""
        r = [0.0, 0.0, 0.7, 0.0, 0.0, 0.0, 0.9, *[0.0] * 5]
        its_own, torn = [0] * 3 + [1] * 4 + [2] * 6, [0] * 3 + [1, 2, 1, 2] + [3] * 6
        small = ["image_support.min_size=5", "image_support.overlap=0.7"]
        for labels in (its_own, torn):
            assert labels_of(row_of_points(r, seen(range(13), labels))) == its_own
        supported = row_of_points(r, seen(range(13), its_own))
        assert labels_of(supported, *small) == its_own
        assert labels_of(row_of_points(r, seen(range(13), torn)), *small) == [0] * 7 + [1] * 6
        # A large segment needs none.
        assert labels_of(row_of_points(r, seen(range(13), torn)), "image_support.min_size=4") == its_own

    def test_images_take_back_a_part_of_a_crease(self, seen):
        """A concave right angle costs 1, and 1 - a where images see one segment on both sides of it."""
        normals = torch.tensor([[0.0, 0, 1]] * 3 + [[-1.0, 0, 0]] * 3)
        case = row_of_points([0.0] * 5, seen(range(6), [4] * 6), normals=normals)
        assert labels_of(case, "region_merging.agreement=0") == [0, 0, 0, 1, 1, 1]
        assert labels_of(case, "region_merging.agreement=0.5") == [0, 0, 0, 1, 1, 1]
        assert labels_of(case, "region_merging.agreement=0.7") == [0] * 6

    def test_the_parts_of_a_wall_behind_a_strip_are_bridged(self, monkeypatch):
        part, planes, observations = wall_behind_a_strip()
        order = part.argsort(stable=True)  # within a part each point is joined to the next one, and to no other part
        edges = [[int(i), int(j)] for i, j in pairwise(order) if part[i] == part[j]]
        graph = graph_of(planes.mean, edges, planes.normal)
        state = Evidence.zeros(len(edges), len(part))
        state.observations = Observations(observations)
        apart = segment_points(graph, state, BARE)
        monkeypatch.setattr(occlusion_bridging, "CELL", 1)
        together = segment_points(graph, state, BARE.set(["occlusion_bridging.min_votes=3"]))
        assert torch.equal(apart, part)
        assert torch.equal(together, torch.where(part == RIGHT, LEFT, part))


class TestWeight0:
    def test_no_image_has_a_say(self, case, monkeypatch):
        """As with no frames at all, once the normals' signs are known."""
        config, graph, state = case
        config = config.set(["region_costs.weight=0", "occlusion_bridging.min_votes=1"])
        monkeypatch.setattr(occlusion_bridging, "AGREEING_SHARE", 0)
        monkeypatch.setattr(occlusion_bridging, "FLATNESS", 1)
        blind = Evidence.empty(graph)
        blind.facing = state.facing
        assert torch.equal(segment_points(graph, state, config), segment_points(graph, blind, config))

    def test_otherwise_they_have(self, case):
        config, graph, state = case
        blind = Evidence.empty(graph)
        blind.facing = state.facing
        assert not torch.equal(segment_points(graph, state, config), segment_points(graph, blind, config))

    def test_the_heaviest(self, case):
        """No weight that a config may have makes costs too large for the operators."""
        config, graph, state = case
        labels = segment_points(graph, state, config.set(["region_costs.weight=1000"]))
        assert labels.shape == (graph.num_points,)
        assert labels.max() > 3


class TestSameLabels:
    @pytest.fixture
    def labels(self, case):
        config, graph, state = case
        return segment_points(graph, state, config)

    @pytest.mark.parametrize("threads", [1, 2, 4])
    def test_on_any_number_of_threads(self, case, labels, threads, set_threads):
        config, graph, state = case
        set_threads(threads)
        assert torch.equal(segment_points(graph, state, config), labels)

    def test_from_frames_in_another_order(self, synthetic, case, labels):
        config, graph, _ = case
        frames = [synthetic.scene.frames[i] for i in (4, 0, 5, 2, 1, 3)]
        _, state = graph_and_state(dataclasses.replace(synthetic.scene, frames=frames), config)
        assert torch.equal(segment_points(graph, state, config), labels)

    def test_from_two_segmenters_merged(self, synthetic, case, labels):
        scene, (config, _, _) = synthetic.scene, case
        first, second = (tj.JointSegmenter(config, method=REGIONS) for _ in range(2))
        for joint, frames in ((first, scene.frames[1::2]), (second, scene.frames[::2])):
            joint.reset(scene.points, scene.colors)
            joint.update(list(frames))
        first.merge(second)
        assert torch.equal(segment_points(first.graph, first.state, config), labels)


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
    graph, state = graph_and_state(scene, RegionsConfig())
    place = torch.cdist(graph.points, scene.points - scene.points.mean(0) + graph.points.mean(0)).argmin(1)
    return truth[place], graph, state


class TestThingsOnATable:
    """What no geometry can see: only images tell flat things from what they lie on."""

    #: Images weigh much here. With the default they do not find what lies flat: on real data prints would count, too.
    CONFIG = RegionsConfig.from_preset("indoor")

    @staticmethod
    def best_iou(labels, truth, instance):
        thing = truth == instance
        return max(float(((labels == k) & thing).sum() / ((labels == k) | thing).sum()) for k in labels[thing].unique())

    def test_images_find_the_magazine(self, table):
        truth, graph, state = table
        assert self.best_iou(segment_points(graph, state, self.CONFIG), truth, 1) > 0.8
        without = segment_points(graph, state, self.CONFIG.set(["region_costs.weight=0"]))
        assert without.max() == 0

    def test_images_confirm_the_pen(self, table):
        truth, graph, state = table
        assert int((truth == 2).sum()) < self.CONFIG.image_support.min_size
        labels = segment_points(graph, state, self.CONFIG)
        assert self.best_iou(labels, truth, 2) > 0.8
        # Where each image sees stripes of three kinds, none of them is the pen.
        stripe = torch.arange(120)[:, None] // 2 % 3
        torn = [
            dataclasses.replace(o, labels=torch.where(o.labels == 2, 2 + stripe, o.labels).int())
            for o in state.observations
        ]
        without = segment_points(graph, dataclasses.replace(state, observations=Observations(torn)), self.CONFIG)
        assert torch.equal(without, torch.where(labels == labels[truth == 2].mode().values, 0, labels))
        assert self.best_iou(without, truth, 1) > 0.9  # large enough to need no image
