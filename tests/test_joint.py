"""The whole method: same labels however it is run, and right answers or clear errors at the edges."""

import dataclasses
import pickle
import warnings
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch
from torch import nn
from torchjoint_lab.synthetic import make_domain_scene

import torchjoint as tj
from torchjoint.cloud.graph import build_edgeless_graph
from torchjoint.cloud.local import LocalFrame
from torchjoint.cloud.neighbors import nearest_neighbors
from torchjoint.cloud.normals import estimate_normals
from torchjoint.recordings.segment import run
from torchjoint.results.checkpoint import Checkpoint, run_key
from torchjoint.results.folder import write_result
from torchjoint.scene.frame import PoseWarning
from torchjoint.segments.method import LEARNED
from torchjoint.segments.scan.method import segment_levels
from torchjoint.views.pose_check import NUM_FRAMES, PoseCheck

CONFIG = tj.Config().set(["image_segments.min_size=20"])
REGIONS = CONFIG.set(["point_segments.method=paper", "paper.min_size=20"])
PAPER = tj.Config.from_preset("paper").set(["paper.min_size=20", "image_segments.min_size=20"])


@pytest.fixture(scope="module")
def synthetic(scene_of):
    return scene_of(3)


@pytest.fixture(scope="module", params=[CONFIG, PAPER], ids=["default", "paper"])
def config(request):
    return request.param


@pytest.fixture(scope="module")
def result(synthetic, config):
    return tj.JointSegmenter(config)(synthetic.scene)


@pytest.fixture(scope="module")
def plain(synthetic):
    """The result with CONFIG."""
    return tj.JointSegmenter(CONFIG)(synthetic.scene)


def assert_same(first, second):
    assert torch.equal(first.points, second.points)
    assert sorted(first.names) == sorted(second.names)
    for index, name in enumerate(first.names):
        assert torch.equal(first.images[index], second.images[second.names.index(name)]), name


class TestSameLabels:
    def test_from_one_thread_and_three(self, synthetic, config, result, set_threads):
        for count in (1, 3):
            set_threads(count)
            assert_same(result, tj.JointSegmenter(config)(synthetic.scene))
            assert torch.get_num_threads() == count

    @pytest.mark.slow
    def test_from_two_threads_with_one_segmenter(self, synthetic, plain):
        segmenter, other = tj.JointSegmenter(CONFIG), synthetic.scene.select_points(torch.arange(1500))
        with ThreadPoolExecutor(4) as threads:
            found = list(threads.map(segmenter, [synthetic.scene, other, other]))
        expected = [plain, *[tj.JointSegmenter(CONFIG)(other)] * 2]
        assert [len(one.points) for one in found] == [len(one.points) for one in expected]
        for one, of in zip(found, expected, strict=True):
            assert_same(one, of)

    def test_from_frames_in_another_order(self, synthetic, config, result):
        scene = dataclasses.replace(synthetic.scene, frames=[synthetic.scene.frames[i] for i in (4, 0, 5, 2, 1, 3)])
        other = tj.JointSegmenter(config)(scene)
        assert other.names[0] == synthetic.scene.frames[4].name
        assert_same(result, other)

    @pytest.mark.slow
    def test_from_unnamed_frames_in_another_order(self, synthetic, config):
        order = (4, 0, 5, 2, 1, 3)
        frames = [dataclasses.replace(frame, name="") for frame in synthetic.scene.frames]
        first = tj.JointSegmenter(config)(dataclasses.replace(synthetic.scene, frames=frames))
        other = tj.JointSegmenter(config)(dataclasses.replace(synthetic.scene, frames=[frames[i] for i in order]))
        assert torch.equal(first.points, other.points)
        for place, index in enumerate(order):
            assert torch.equal(first.images[index], other.images[place])

    @pytest.mark.parametrize("batch_size", [1, pytest.param(4, marks=pytest.mark.slow)])
    def test_from_batches_of_another_size(self, synthetic, config, result, batch_size):
        assert_same(result, tj.JointSegmenter(config)(synthetic.scene, batch_size=batch_size))

    def test_what_fails_neither_forgets_nor_mixes_frames(self, synthetic, monkeypatch):
        scene, segmenter = synthetic.scene, tj.JointSegmenter()
        segmenter.reset(scene.points, scene.colors)
        segmenter.update(scene.frames[0])
        for start in (segmenter, lambda points: next(segmenter.steps(points))):
            with pytest.raises(TypeError, match="scene: expected a Scene"):
                start(scene.points)
        with pytest.raises(ValueError, match="batch_size: expected at least 1 frame, got 0"):
            segmenter(scene, batch_size=0)
        assert len(segmenter.state.observations) == 1
        monkeypatch.setattr("torchjoint.joint.warn_of_rounding", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            segmenter.reset(scene.points[1:])
        with pytest.raises(RuntimeError, match="call reset"):
            segmenter.compute()

    def test_no_batches_of_less_than_one_frame(self, synthetic):
        with pytest.raises(ValueError, match="batch_size: expected at least 1 frame, got -1"):  # it saw no frame
            tj.JointSegmenter()(synthetic.scene, batch_size=-1)

    def test_from_update_and_compute(self, synthetic, config, result):
        scene, segmenter = synthetic.scene, tj.JointSegmenter(config)
        segmenter.reset(scene.points, scene.colors)
        for number, frame in enumerate(scene.frames):
            segmenter.update(frame)
            if number in (0, 3):
                segmenter.compute()  # at any time, and without consequence
        assert_same(result, segmenter.compute())

    def test_from_the_state_of_another_one(self, synthetic, config, result):
        """Which sees more frames meanwhile: these counted for both."""
        scene, one, other = synthetic.scene, tj.JointSegmenter(config), tj.JointSegmenter(config)
        for segmenter in (one, other):
            segmenter.reset(scene.points, scene.colors)
        one.update(scene.frames[:2])
        other.state = one.state
        one.update(scene.frames[2:])
        assert len(other.state.observations) == 2
        other.update(scene.frames[2:])
        assert_same(result, one.compute())
        assert_same(result, other.compute())

    @pytest.mark.slow
    def test_from_frames_beyond_the_memory(self, synthetic, plain, tmp_path):
        """The second and later frames are in a file: of a run at once, frame by frame, resumed, and at finer levels."""
        scene, memory = synthetic.scene, {"memory": "400kB", "offload": tmp_path}
        checkpoint = Checkpoint(tmp_path / "state", "key")
        segmenter = tj.JointSegmenter(CONFIG, **memory)
        offloaded = run(segmenter, scene, checkpoint)
        assert 0 < segmenter.state.observations._in_memory < 400_000
        assert_same(plain, offloaded)
        assert_same(plain.at(0.9), offloaded.at(0.9))
        assert all(map(torch.equal, plain.initial_images, offloaded.initial_images))
        again = tj.JointSegmenter(CONFIG, **memory)
        assert_same(plain, run(again, scene, checkpoint))
        assert_same(plain, again.compute(config=CONFIG))

    def test_from_a_full_disk_with_room_made(self, synthetic, plain, tmp_path):
        """The frame that could not be written can be given again."""
        scene = synthetic.scene
        segmenter = tj.JointSegmenter(CONFIG, memory=0, offload=tmp_path / "gone")
        segmenter.reset(scene.points, scene.colors)
        with pytest.raises(OSError, match="memory: data beyond this limit go to a temporary file"):
            segmenter.update(scene.frames)
        assert int(segmenter.state.views.sum()) == len(segmenter.state.observations) == 0
        (tmp_path / "gone").mkdir()
        segmenter.update(scene.frames)
        assert torch.equal(plain.points, segmenter.compute(images=False).points)

    def test_from_two_segmenters_merged(self, synthetic, config, result):
        scene = synthetic.scene
        first, second = tj.JointSegmenter(config), tj.JointSegmenter(config)
        for segmenter, frames in ((first, scene.frames[1::2]), (second, scene.frames[::2])):
            segmenter.reset(scene.points, scene.colors)
            segmenter.update(frames)
        first.merge(second)
        assert_same(result, first.compute())

    def test_from_a_run_that_died_and_was_resumed(self, synthetic, config, result, tmp_path):
        scene = synthetic.scene
        key = run_key("synthetic 3", config)

        class Dies(list):
            def __getitem__(self, index):
                if index == 4:
                    raise KeyboardInterrupt
                return super().__getitem__(index)

        checkpoint = Checkpoint(tmp_path / "state", key)
        segmenter = tj.JointSegmenter(config)
        dying = dataclasses.replace(scene, frames=Dies(scene.frames))
        with pytest.raises(KeyboardInterrupt):
            run(segmenter, dying, checkpoint, batch_size=2)
        checkpoint.save(segmenter.state, now=True)
        loads = []

        class Counts(list):
            def __getitem__(self, index):
                loads.append(index)
                return super().__getitem__(index)

        resumed = dataclasses.replace(scene, frames=Counts(scene.frames))
        again = run(tj.JointSegmenter(config), resumed, Checkpoint(tmp_path / "state", key), batch_size=2)
        assert_same(result, again)
        assert loads[-2:] == [4, 5]
        with (tmp_path / "state" / "sums.pt").open("r+b") as file:
            file.truncate(100)
        with pytest.warns(UserWarning, match="state: damaged, starting again"):
            assert Checkpoint(tmp_path / "state", key).load() is None
        assert Checkpoint(tmp_path / "state", run_key("synthetic 4", config)).load() is None
        assert [file.name for file in (tmp_path / "state").iterdir()] == ["key.txt"]


class TestIdSpace:
    def test_points_are_numbered_by_first_appearance(self, result):
        _, first = torch.unique(result.points, return_inverse=True)
        highest = torch.cummax(result.points, 0).values
        assert result.points[0] == 0
        assert (highest[1:] - highest[:-1] <= 1).all()
        assert int(first.max()) + 1 == result.num_point_segments

    def test_ids_without_points_are_private_to_an_image(self, result):
        seen = set()
        for labels in result.images:
            private = set(labels[labels >= result.num_point_segments].tolist())
            assert not private & seen
            seen |= private
        assert seen == set(range(result.num_point_segments, result.num_point_segments + len(seen)))

    def test_types(self, synthetic, result):
        assert result.points.dtype == torch.int64
        assert result.images[0].dtype == torch.int64
        assert [labels.shape for labels in result.images] == [frame.size for frame in synthetic.scene.frames]
        assert len(result.images[1:3]) == 2


class TestOtherSegmentations:
    """Step 1-2 replaced by somebody else's segmentation."""

    @pytest.mark.slow
    def test_frames_that_bring_labels(self):
        """With true image labels even what geometry cannot see is found."""
        made = make_domain_scene("desk", 42, num_views=6, num_points=10_000)
        frames = [
            dataclasses.replace(frame, labels=labels)
            for frame, labels in zip(made.scene.frames, made.image_labels, strict=True)
        ]
        plain, helped = (
            tj.JointSegmenter()(scene) for scene in (made.scene, dataclasses.replace(made.scene, frames=frames))
        )
        iou_plain, iou_helped = (tj.metrics.mean_best_iou(r.points, made.point_labels) for r in (plain, helped))
        assert iou_helped > iou_plain  # by .06; the rays of the scene differ by processor
        covering = [
            [tj.metrics.segmentation_covering(image, truth).symmetric for image, truth in pairs]
            for pairs in (zip(result.images, made.image_labels, strict=True) for result in (plain, helped))
        ]
        assert sum(covering[1]) > sum(covering[0])

    def test_labels_may_be_any_numbers_and_leave_pixels_out(self, synthetic):
        frame, labels = synthetic.scene.frames[0], synthetic.image_labels[0]
        strange = labels * 10**12 + 7
        strange[:20] = -1
        dense = labels.clone()
        dense[:20] = -1
        results = [
            tj.JointSegmenter(CONFIG)(
                dataclasses.replace(synthetic.scene, frames=[dataclasses.replace(frame, labels=given)])
            )
            for given in (strange, dense)
        ]
        assert_same(*results)
        assert (results[0].images[0][:20] == -1).all()
        assert (results[0].images[0][20:] >= 0).all()

    def test_a_mask_s_background_is_no_segment(self, synthetic):
        mask = synthetic.image_labels[0] == 2
        frame = dataclasses.replace(synthetic.scene.frames[0], labels=mask)
        assert torch.equal(frame.labels, torch.where(mask, 0, -1))
        with pytest.raises(ValueError, match=r"labels of frame .*: got only 0 and 255, as in the image of a mask"):
            dataclasses.replace(frame, labels=mask.byte() * 255)

    def test_any_module_may_segment_images(self, synthetic):
        class Quarters(nn.Module):
            def forward(self, images):
                _, _, height, width = images.shape
                rows, columns = torch.arange(height) * 2 // height, torch.arange(width) * 2 // width
                return (rows[:, None] * 2 + columns).expand(images.shape[0], -1, -1)

        segmenter = tj.JointSegmenter(REGIONS, image_segmenter=Quarters())
        result = segmenter(synthetic.scene)
        assert result.initial_images[0].unique().tolist() == [0, 1, 2, 3]

    def test_any_module_may_detect_boundaries(self, synthetic, plain):
        class Flat(nn.Module):
            def __init__(self):
                super().__init__()
                self.level = nn.Parameter(torch.tensor(0.5))

            def forward(self, images):
                return images.new_ones(images[:, 0].shape) * self.level

        result = tj.JointSegmenter(CONFIG, boundary=Flat())(synthetic.scene)
        assert not result.points.requires_grad
        assert not torch.equal(result.initial_images[0], plain.initial_images[0])

    def test_a_network_s_batch_statistics_do_not_count(self, synthetic):
        class Net(nn.Sequential):
            def forward(self, images):
                return (super().forward(images)[:, 0] > 0).long()

        torch.manual_seed(0)
        net = Net(nn.Conv2d(3, 1, 3, padding=1), nn.BatchNorm2d(1))
        results = [tj.JointSegmenter(REGIONS, image_segmenter=net)(synthetic.scene, batch_size=size) for size in (1, 4)]
        assert_same(*results)

    def test_modules_with_wrong_output(self, synthetic):
        class Wrong(nn.Module):
            def forward(self, images):
                return images

        with pytest.raises(ValueError, match=r"boundary: expected \[B, H, W\]"):
            tj.JointSegmenter(CONFIG, boundary=Wrong())(synthetic.scene)
        with pytest.raises(TypeError, match="image_segmenter's output: expected an integer dtype"):
            tj.JointSegmenter(CONFIG, image_segmenter=Wrong())(synthetic.scene)

        class Strong(nn.Module):
            def forward(self, images):
                return images[:, 0] * 255

        class Many(nn.Module):
            def forward(self, images):
                return torch.zeros(len(images) + 1, *images.shape[2:], dtype=torch.int64)

        with pytest.raises(ValueError, match=r"boundary: expected numbers in \[0, 1\]"):
            tj.JointSegmenter(CONFIG, boundary=Strong())(synthetic.scene)
        with pytest.raises(ValueError, match="image_segmenter's output: expected 6 images, got 7"):
            tj.JointSegmenter(CONFIG, image_segmenter=Many())(synthetic.scene)


class TestEdges:
    def test_no_frames_is_plain_3d_segmentation(self, synthetic):
        scene = dataclasses.replace(synthetic.scene, frames=())
        result = tj.JointSegmenter(CONFIG)(scene)
        assert len(result.images) == 0
        assert 3 < result.num_point_segments < len(scene.points) / 20 + 1

    def test_one_frame(self, synthetic):
        scene = dataclasses.replace(synthetic.scene, frames=synthetic.scene.frames[:1])
        result = tj.JointSegmenter(CONFIG)(scene)
        assert len(result.images) == 1
        assert len(set(result.images[0].unique().tolist()) & set(result.points.unique().tolist())) > 2

    def test_a_frame_that_sees_nothing(self, synthetic, plain):
        away = synthetic.scene.frames[0].world_to_camera.clone()
        away[:3, 3] += 1000 * torch.tensor([0.0, 0.0, -1.0], dtype=torch.float64)
        blind = dataclasses.replace(synthetic.scene.frames[0], world_to_camera=away, name="blind")
        frames = [*synthetic.scene.frames, blind]
        result = tj.JointSegmenter(CONFIG)(dataclasses.replace(synthetic.scene, frames=frames))
        assert torch.equal(result.points, plain.points)
        assert (result.images[-1] >= result.num_point_segments).all()

    def test_no_frame_sees_anything(self, synthetic):
        away = synthetic.scene.frames[0].world_to_camera.clone()
        away[2, 3] = -1000
        blind = dataclasses.replace(synthetic.scene.frames[0], world_to_camera=away)
        with (
            pytest.warns(PoseWarning, match="no point of the cloud is in view"),
            pytest.raises(ValueError, match="frames: none of the 1 images sees a point; wrong poses"),
        ):
            tj.JointSegmenter(CONFIG)(dataclasses.replace(synthetic.scene, frames=[blind]))

    def test_images_of_different_sizes(self, synthetic):
        first, second = synthetic.scene.frames[:2]
        half = torch.nn.functional.avg_pool2d(second.image[None], 2)[0]
        scale = torch.tensor([[0.5, 1, 0.5], [1, 0.5, 0.5], [1, 1, 1]], dtype=torch.float64)
        shift = torch.tensor([[0, 0, -0.25], [0, 0, -0.25], [0, 0, 0]], dtype=torch.float64)
        small = tj.Frame(half, second.intrinsics * scale + shift, second.world_to_camera, name="small")
        result = tj.JointSegmenter(CONFIG)(dataclasses.replace(synthetic.scene, frames=[first, small, second]))
        assert [tuple(labels.shape) for labels in result.images] == [first.size, (60, 80), second.size]
        big, little = result.images[2][::2, ::2], result.images[1]
        assert tj.metrics.segmentation_covering(little, big).symmetric > 0.5  # the same view, the same ids
        assert (big == little).float().mean() > 0.6

    @pytest.mark.parametrize("count", [1, 2, 3])
    def test_few_points(self, synthetic, count):
        frame = synthetic.scene.frames[0]
        center = -(frame.world_to_camera[:3, :3].T @ frame.world_to_camera[:3, 3])
        ahead = (center + 2 * frame.world_to_camera[2, :3]).float()
        points = ahead + 0.01 * torch.rand(count, 3, generator=torch.Generator().manual_seed(0))
        result = tj.JointSegmenter(CONFIG)(tj.Scene(points, [dataclasses.replace(frame, depth=None)]))
        assert result.points.tolist() == [0] * count
        assert (result.images[0] == 0).any()

    def test_duplicate_points(self, synthetic, config):
        points = synthetic.scene.points.repeat(2, 1)
        result = tj.JointSegmenter(config)(tj.Scene(points, synthetic.scene.frames))
        assert torch.equal(result.points[: len(points) // 2], result.points[len(points) // 2 :])

    def test_a_point_at_the_camera(self, synthetic, config):
        pose = synthetic.scene.frames[0].world_to_camera
        center = -(pose[:3, :3].T @ pose[:3, 3]).float()
        points = torch.cat([synthetic.scene.points, center[None]])
        result = tj.JointSegmenter(config)(tj.Scene(points, synthetic.scene.frames))
        assert len(result.points) == len(points)

    def test_grey_images(self, synthetic):
        frames = [dataclasses.replace(f, image=f.image.mean(0)) for f in synthetic.scene.frames]
        result = tj.JointSegmenter(CONFIG)(dataclasses.replace(synthetic.scene, frames=frames))
        assert result.num_point_segments > 3

    def test_nan_points(self, synthetic):
        points = synthetic.scene.points.clone()
        points[5, 1] = torch.nan
        with pytest.raises(ValueError, match=r"points: 1 of \d+ points are NaN"):
            tj.JointSegmenter(CONFIG).reset(points)

    def test_given_normals_are_used(self, synthetic):
        points = synthetic.scene.points
        flat = torch.tensor([0.0, 0.0, 1.0]).expand(len(points), -1)
        config = PAPER.set(["paper.distance_weight=0", "paper.min_size=0"])
        result = tj.JointSegmenter(config)(tj.Scene(points, normals=flat))
        assert result.num_point_segments < 10  # all is flat: the segments are the graph's components

    def test_normals_that_are_all_equal_count_as_none(self, synthetic):
        """Some programs write (0, 0, 1) for a cloud without normals."""
        points = synthetic.scene.points
        flat = torch.tensor([0.0, 0.0, 1.0]).expand(len(points), -1)
        assert torch.equal(*(tj.JointSegmenter()(tj.Scene(points, normals=n)).points for n in (None, flat)))
        assert torch.equal(*(tj.superpoints(points, normals=n) for n in (None, flat)))

    def test_cameras_decide_the_signs_of_given_normals(self, synthetic):
        points = synthetic.scene.points
        normals = estimate_normals(points, nearest_neighbors(points, 30).indices)
        signs = torch.where(torch.rand(len(points), 1, generator=torch.Generator().manual_seed(0)) < 0.5, -1.0, 1.0)
        scenes = [dataclasses.replace(synthetic.scene, normals=n) for n in (normals, signs * normals)]
        results = [tj.JointSegmenter(REGIONS)(scene) for scene in scenes]
        seen = tj.JointSegmenter(REGIONS)
        seen.reset(points)
        seen.update(synthetic.scene.frames)
        looked_at = seen.state.facing != 0
        assert looked_at.float().mean() > 0.9
        first, second = (result.points[looked_at] for result in results)
        # Segments are numbered by their first points, looked at or not: so each is compared with the one of most of it.
        pairs = torch.zeros(int(first.max()) + 1, int(second.max()) + 1).index_put_(
            (first, second), torch.ones(len(first)), accumulate=True
        )
        agree = first == pairs.argmax(0)[second]
        assert agree.float().mean() > 0.95  # 0.975: points that no camera looks at keep the signs they came with
        assert tj.metrics.segmentation_covering(results[0].points, results[1].points).symmetric > 0.85

    def test_use_before_reset(self, synthetic):
        with pytest.raises(RuntimeError, match=r"call reset\(points\)"):
            tj.JointSegmenter().update(synthetic.scene.frames[0])
        with pytest.raises(RuntimeError, match=r"call reset\(points\)"):
            tj.JointSegmenter().compute()

    def test_merging_what_does_not_belong_together(self, synthetic):
        first, second = tj.JointSegmenter(CONFIG), tj.JointSegmenter(CONFIG)
        first.reset(synthetic.scene.points)
        with pytest.raises(ValueError, match="other: expected a segmenter that was reset with the same points"):
            first.merge(second)
        second.reset(synthetic.scene.points + 1)
        with pytest.raises(ValueError, match="same points"):
            first.merge(second)
        second.reset(synthetic.scene.points, synthetic.scene.colors)
        with pytest.raises(ValueError, match="same points and colours"):
            first.merge(second)
        with pytest.raises(ValueError, match="same config"):
            first.merge(tj.JointSegmenter(PAPER))
        with pytest.raises(ValueError, match="same config and networks"):
            first.merge(tj.JointSegmenter(CONFIG, boundary=torch.nn.Identity()))
        second.reset(synthetic.scene.points)
        for segmenter in (first, second):
            segmenter.update(synthetic.scene.frames[0])
        with pytest.raises(ValueError, match=r"saw other frames, both saw \['frame-000000'\]"):
            first.merge(second)
        with pytest.raises(ValueError, match="saw other frames"):
            first.merge(first)


class TestPoseCheck:
    """With the quicker method: the check comes before any, and runs of the default would not be silent elsewhere."""

    def warnings_of(self, scene):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            segmenter = tj.JointSegmenter(REGIONS)
            try:
                segmenter(scene)
            except ValueError as error:
                assert "sees a point" in str(error)  # noqa: PT017
        return [str(w.message) for w in caught if issubclass(w.category, PoseWarning)]

    def changed(self, synthetic, change):
        return dataclasses.replace(synthetic.scene, frames=[change(frame) for frame in synthetic.scene.frames])

    def test_right_poses_are_silent(self, synthetic):
        assert self.warnings_of(synthetic.scene) == []

    def test_red_and_blue_exchanged_are_told(self, synthetic):
        bgr = self.changed(synthetic, lambda frame: dataclasses.replace(frame, image=frame.image.flip(0)))
        (message,) = self.warnings_of(bgr)
        assert message.endswith("is one of them BGR?")

    @pytest.mark.parametrize(("scale", "fits"), [(1.1, 0.91), (1 / 1.1, "1.10")])
    def test_a_focal_length_that_is_somewhat_wrong(self, synthetic, scale, fits):
        scales = torch.tensor([[scale, 1, 1], [1, scale, 1], [1, 1, 1]], dtype=torch.float64)
        wrong = self.changed(synthetic, lambda frame: dataclasses.replace(frame, intrinsics=frame.intrinsics * scales))
        (message,) = self.warnings_of(wrong)
        assert f"the depth images fit focal lengths {fits} times as large better (they differ by 0." in message

    def test_a_cloud_that_was_moved_by_10_cm(self, synthetic):
        points = synthetic.scene.points + torch.tensor([0, 0.1, 0])
        (message,) = self.warnings_of(dataclasses.replace(synthetic.scene, points=points))
        assert "the depth images fit a cloud moved by -0.1 m along y better" in message

    @pytest.mark.parametrize("with_depth", [True, False])
    def test_inverted_poses(self, synthetic, with_depth):
        def invert(frame):
            pose = torch.linalg.inv(frame.world_to_camera)
            return dataclasses.replace(frame, world_to_camera=pose, depth=frame.depth if with_depth else None)

        messages = self.warnings_of(self.changed(synthetic, invert))
        assert len(messages) == 1
        assert "the poses look inverted" in messages[0]

    @pytest.mark.parametrize("with_depth", [True, False])
    @pytest.mark.parametrize("is_inverse", [True, False])
    def test_wrong_axes(self, synthetic, is_inverse, with_depth):
        opengl = torch.diag(torch.tensor([1.0, -1, -1, 1], dtype=torch.float64))

        def turn(frame):
            pose = opengl @ frame.world_to_camera
            depth = frame.depth if with_depth else None
            return dataclasses.replace(
                frame, world_to_camera=torch.linalg.inv(pose) if is_inverse else pose, depth=depth
            )

        messages = self.warnings_of(self.changed(synthetic, turn))
        assert len(messages) == 1
        what = "inverted, and turned in y and z: " if is_inverse else "turned in y and z: OpenGL axes where OpenCV"
        assert f"the poses look {what}" in messages[0]

    @pytest.mark.parametrize("with_depth", [True, False])
    @pytest.mark.parametrize("what", ["inverted", "turned in y and z"])
    def test_two_frames_of_another_convention(self, synthetic, what, with_depth):
        opengl = torch.diag(torch.tensor([1.0, -1, -1, 1], dtype=torch.float64))
        frames = [dataclasses.replace(f, depth=f.depth if with_depth else None) for f in synthetic.scene.frames]
        for place, warns in ((1, False), (4, True)):  # of one alone nothing is said
            pose = frames[place].world_to_camera
            pose = opengl @ pose if "turned" in what else torch.linalg.inv(pose)
            frames[place] = dataclasses.replace(frames[place], world_to_camera=pose)
            messages = self.warnings_of(dataclasses.replace(synthetic.scene, frames=frames))
            told = f"the poses of 2 of 6 checked frames look {what}"
            assert any(told in message for message in messages) == warns

    def test_a_shifted_pose(self, synthetic):
        def shift(frame):
            pose = frame.world_to_camera.clone()
            pose[:3, 3] += 1.0
            return dataclasses.replace(frame, world_to_camera=pose)

        messages = self.warnings_of(self.changed(synthetic, shift))
        assert any("the depth images and the cloud disagree" in message for message in messages)

    def test_intrinsics_of_another_image_size(self, synthetic):
        double = torch.tensor([[2.0, 1, 2], [1, 2, 2], [1, 1, 1]], dtype=torch.float64)
        messages = self.warnings_of(
            self.changed(synthetic, lambda f: dataclasses.replace(f, intrinsics=f.intrinsics * double))
        )
        assert any("those of another image size" in message for message in messages)

    def test_poses_in_reversed_order(self, synthetic):
        frames = synthetic.scene.frames
        poses = [frame.world_to_camera for frame in frames][::-1]
        pairs = list(zip(frames, poses, strict=True))
        depth = [dataclasses.replace(f, world_to_camera=pose) for f, pose in pairs]
        messages = self.warnings_of(dataclasses.replace(synthetic.scene, frames=depth))
        assert any("the depth images and the cloud disagree" in message for message in messages)
        colors = [dataclasses.replace(frame, depth=None) for frame in depth]
        messages = self.warnings_of(dataclasses.replace(synthetic.scene, frames=colors))
        assert any("agree no more than by chance" in message for message in messages)

    def test_something_without_points_before_a_camera(self, synthetic):
        frames = [*synthetic.scene.frames]
        spacing = torch.full((len(synthetic.scene.points),), 0.03)
        for place, warns in ((0, False), (1, True)):  # one frame of six may disagree, two may not
            frames[place] = dataclasses.replace(frames[place], depth=torch.full_like(frames[place].depth, 0.1))
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                check = PoseCheck(synthetic.scene.cloud, spacing, CONFIG.visibility, LocalFrame.of_world())
                check.check_all(frames)
                check.warn()
            assert any("the depth images and the cloud disagree" in str(one.message) for one in caught) == warns

    @pytest.mark.parametrize(
        "axis", [pytest.param(0, marks=pytest.mark.slow), pytest.param(1, marks=pytest.mark.slow), 2]
    )
    def test_a_cloud_shifted_by_half_a_metre(self, synthetic, axis):
        frames = [dataclasses.replace(frame, depth=None) for frame in synthetic.scene.frames]
        assert self.warnings_of(dataclasses.replace(synthetic.scene, frames=frames)) == []
        points = synthetic.scene.points + 0.5 * torch.eye(3)[axis]
        messages = self.warnings_of(dataclasses.replace(synthetic.scene, points=points, frames=frames))
        assert any("agree no more than by chance" in message for message in messages)

    def test_blank_images_say_nothing_about_colours(self, synthetic):
        frames = [
            dataclasses.replace(frame, depth=None, image=torch.full_like(frame.image, 0.4))
            for frame in synthetic.scene.frames
        ]
        colors = torch.full_like(synthetic.scene.points, 0.41)
        assert self.warnings_of(dataclasses.replace(synthetic.scene, colors=colors, frames=frames)) == []

    def streamed(self, scene, frames, compute):
        segmenter = tj.JointSegmenter(REGIONS)
        segmenter.reset(scene.points, scene.colors)
        for frame in frames:
            segmenter.update(frame)
        return segmenter.compute(images=False) if compute else None

    def test_frames_that_come_one_by_one_are_checked(self, synthetic):
        def invert(frame):
            return dataclasses.replace(frame, world_to_camera=torch.linalg.inv(frame.world_to_camera), depth=None)

        frames = [invert(frame) for frame in synthetic.scene.frames]
        with pytest.warns(PoseWarning, match="the poses look inverted"):
            self.streamed(synthetic.scene, frames, compute=True)
        many = [dataclasses.replace(frame, name=f"{i}") for i in range(6) for frame in frames]
        with pytest.warns(PoseWarning, match="the poses look inverted") as caught:
            self.streamed(synthetic.scene, many, compute=False)  # before the end of the stream
        assert len(caught) == 1  # each problem once

    def test_millimetres_that_come_one_by_one(self, synthetic):
        def millimetres(frame):
            pose = frame.world_to_camera.clone()
            pose[:3, 3] *= 1000
            return dataclasses.replace(frame, world_to_camera=pose, depth=None)

        frames = [millimetres(frame) for frame in synthetic.scene.frames]
        with pytest.warns(PoseWarning, match="agree no more than by chance|no point of the cloud is in view"):
            self.streamed(synthetic.scene, frames, compute=True)

    def test_frames_that_come_one_by_one_and_see_nothing(self, synthetic):
        away = synthetic.scene.frames[0].world_to_camera.clone()
        away[2, 3] = -1000
        blind = dataclasses.replace(synthetic.scene.frames[0], world_to_camera=away)
        with (
            pytest.warns(PoseWarning, match="no point of the cloud is in view"),
            pytest.raises(ValueError, match="frames: none of the 1 images sees a point; wrong poses"),
        ):
            self.streamed(synthetic.scene, [blind], compute=True)

    def test_right_poses_that_come_one_by_one_are_silent(self, synthetic):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            self.streamed(synthetic.scene, synthetic.scene.frames, compute=True)


def test_points_alone_are_segmented_without_the_images(synthetic):
    segmenter = tj.JointSegmenter()
    whole = segmenter(synthetic.scene)
    alone = segmenter.compute(images=False)
    assert torch.equal(alone.points, whole.points)
    assert len(alone.images) == 0


class Counting(list):
    """Frames that know how often each of them was decoded."""

    def __init__(self, frames):
        super().__init__(frames)
        self.decoded = [0] * len(self)

    def __getitem__(self, index):
        self.decoded[index] += 1
        return super().__getitem__(index)

    def __iter__(self):
        return (self[index] for index in range(len(self)))


@pytest.fixture(scope="module")
def many_frames(synthetic):
    """More than the check of the poses looks at."""
    frames = synthetic.scene.frames
    return [dataclasses.replace(frames[i % len(frames)], name=f"frame-{i:06d}") for i in range(NUM_FRAMES + 5)]


@pytest.mark.parametrize("method", ["learned", "scan"])
@pytest.mark.parametrize("count", [2, NUM_FRAMES + 5])
def test_each_frame_is_decoded_once(synthetic, many_frames, method, count):
    """Those that the check of the poses looked at are kept until their turn."""
    frames = Counting(many_frames[:count])
    segmenter = tj.JointSegmenter(CONFIG.set([f"point_segments.method={method}", "boundary.detector=gradient"]))
    result = segmenter(dataclasses.replace(synthetic.scene, frames=frames), batch_size=4)
    assert frames.decoded == [1] * count
    assert list(result.names) == [frame.name for frame in many_frames[:count]]


@pytest.mark.parametrize("method", ["learned", "paper", "scan"])
def test_a_segmenter_can_be_pickled(synthetic, method):
    segmenter = tj.JointSegmenter(CONFIG.set([f"point_segments.method={method}"]))
    segmenter.reset(synthetic.scene.points)
    segmenter.update(synthetic.scene.frames[:2])
    again = pickle.loads(pickle.dumps(segmenter))
    assert torch.equal(again.compute(images=False).points, segmenter.compute(images=False).points)


def test_a_segmentation_can_be_pickled(synthetic):
    scene = dataclasses.replace(synthetic.scene, frames=synthetic.scene.frames[:2])
    result = tj.JointSegmenter(CONFIG)(scene)
    again = pickle.loads(pickle.dumps(result))
    for name in ("images", "initial_images", "superpoint_images"):
        assert all(map(torch.equal, getattr(again, name), getattr(result, name)))
    assert all(map(torch.equal, again.at(0.3).images, result.at(0.3).images))


def test_what_cannot_be_is_told_before_all_frames(synthetic):
    with pytest.raises(ValueError, match=r"granularity: expected 0\.5, because method paper has one level"):
        tj.JointSegmenter(PAPER, granularity=0.3).reset(synthetic.scene.points)
    with pytest.raises(TypeError, match=r"method: expected a torchjoint\.segments\.method\.Method, got function"):
        tj.JointSegmenter(method=lambda config, points: None)
    segmenter = tj.JointSegmenter(CONFIG)
    segmenter.reset(synthetic.scene.points)
    with pytest.raises(TypeError, match="config: expected a Config, got str"):
        segmenter.compute(config="paper")
    bare = LEARNED._replace(prepare=lambda cloud, config, _: build_edgeless_graph(cloud))
    with pytest.raises(ValueError, match=r"method: learned\.prepare gave a graph of 0 points, expected its `of_given`"):
        tj.JointSegmenter(method=bare).reset(synthetic.scene.points)


def test_steps_under_another_default_device(synthetic):
    segmenter = tj.JointSegmenter(CONFIG, memory=0)
    torch.set_default_device("meta")
    try:
        assert list(segmenter.steps(synthetic.scene, batch_size=3)) == [0, 3, 6]
    finally:
        torch.set_default_device(None)
    assert len(segmenter.compute(images=False).points) == len(synthetic.scene.points)


@pytest.mark.parametrize("preset", [None, *(pytest.param(name, marks=pytest.mark.slow) for name in ("scan", "paper"))])
def test_beams_without_return_have_no_label(synthetic, preset, tmp_path):
    """As those of files: they are told, and change nothing of the other points."""
    scene = synthetic.scene.sample_frames(2)
    rows = torch.arange(len(scene.points) + 100).roll(7)
    rows = torch.where(rows < 100, 0, rows - 99)
    first = torch.cat([torch.zeros(1, 3), scene.points])
    colors = torch.cat([torch.zeros(1, 3), scene.colors])
    given = tj.Scene(first[rows], scene.frames, colors[rows])
    kept = rows > 0
    segmenter = tj.JointSegmenter() if preset is None else tj.JointSegmenter.from_preset(preset)
    expected = segmenter(given.select_points(kept))
    with pytest.warns(
        UserWarning, match=r"points: 100 of 3100 points are \(0, 0, 0\), beams without return; they are le"
    ):
        result = segmenter(given)
    assert torch.equal(result.points[kept], expected.points)
    assert (result.points[~kept] == -1).all()
    assert all(map(torch.equal, result.images, expected.images))
    write_result(tmp_path, given, result, segmenter.config, "scene")
    assert torch.equal(tj.load_result(tmp_path).points, expected.points)
    if preset is None:
        whole = tj.Result.of(result, given)
        assert torch.equal(whole.scene.points, given.points[kept])
        assert torch.equal(result.at(0.9).points[kept], expected.at(0.9).points)
        assert all(map(torch.equal, result.at(0.9).images, expected.at(0.9).images))
        assert torch.equal(result.point_confidence[kept], expected.point_confidence)
        assert not result.point_confidence[~kept].any()
        assert torch.equal(result.hierarchy.at(0.2)[kept], expected.hierarchy.at(0.2))
        assert torch.equal(whole.confidence, expected.confidence)


def test_another_level(synthetic):
    fine, default = (tj.JointSegmenter(granularity=level)(synthetic.scene) for level in (0.8, 0.5))
    expected = default.at(0.8)
    assert torch.equal(fine.points, expected.points)
    assert all(map(torch.equal, fine.images, expected.images))
    with pytest.raises(ValueError, match=r"granularity: expected a number from 0 \(coarse\) to 1 \(fine\), got 2"):
        tj.JointSegmenter(granularity=2)


SCAN = CONFIG.set(["point_segments.method=scan"])


@pytest.fixture(scope="module")
def scanner(synthetic):
    segmenter = tj.JointSegmenter(SCAN)
    segmenter.reset(synthetic.scene.points)
    segmenter.update(synthetic.scene.frames[:2])
    return segmenter


class TestScan:
    """Method scan asks points alone: neither a graph nor what images say about its edges is made."""

    def test_it_builds_no_edges(self, synthetic, scanner):
        assert scanner.state.views.shape == scanner.state.overlap_sum.shape == (0,)
        assert len(scanner.state.observations) == 2
        assert scanner.state.facing.shape == (len(synthetic.scene.points),)
        result = scanner.compute()
        assert torch.equal(result.points, segment_levels(synthetic.scene.points, SCAN.scan).at())
        assert len(result.images) == 2

    def test_other_parameters_of_the_scan_can_be_tried_out(self, synthetic, scanner):
        coarse = SCAN.set(["scan.min_size=200"])
        expected = segment_levels(synthetic.scene.points, coarse.scan).at()
        assert torch.equal(scanner.compute(images=False, config=coarse).points, expected)

    def test_images_that_have_no_say_are_told(self, synthetic, caplog):
        segmenter = tj.JointSegmenter(SCAN)
        segmenter.reset(synthetic.scene.points)
        frame = dataclasses.replace(synthetic.scene.frames[0], labels=synthetic.image_labels[0])
        with caplog.at_level("INFO"), pytest.warns(UserWarning, match="these labels have no effect on the points"):
            segmenter.update([frame, frame])
        assert "segments the points without images" in caplog.text

    @pytest.mark.parametrize("method", ["learned", "paper"])
    def test_another_method_would_miss_the_edges(self, synthetic, scanner, method):
        other = CONFIG.set([f"point_segments.method={method}"])
        message = r"config: stored evidence depends on point_segments\.method; add the frames again"
        with pytest.raises(ValueError, match=message):
            scanner.compute(config=other)
        seen = tj.JointSegmenter(other)
        seen.reset(synthetic.scene.points)
        with pytest.raises(ValueError, match=message):  # nor the other way round
            seen.compute(config=SCAN)
