import numpy as np
import pytest
import torch

from torchjoint import Config, Frame, Masks, Scene, load_scene, ops, superpoints
from torchjoint.masks import from_instances, from_labels
from torchjoint.metrics import mean_best_iou
from torchjoint.recordings.segment import RecordingOptions
from torchjoint.scene import Truth
from torchjoint.transforms import transfer_labels

K = torch.tensor([[100.0, 0, 31.5], [0, 100, 23.5], [0, 0, 1]])
POSE = torch.eye(4)
IMAGE = torch.rand(3, 48, 64, generator=torch.Generator().manual_seed(0))


def test_dtypes_and_sizes():
    frame = Frame(IMAGE, K, POSE, depth=torch.ones(48, 64, dtype=torch.float64), labels=torch.zeros(48, 64).int())
    assert frame.size == (48, 64)
    assert frame.intrinsics.dtype == frame.world_to_camera.dtype == torch.float64
    assert frame.depth.dtype == torch.float32
    assert frame.labels.dtype == torch.int64


def test_masked_arrays_of_numpy():
    """Their masks would be lost without a word, and what they hide would count."""
    hidden = np.ma.masked_array(np.ones((48, 64), np.float32), mask=True)
    with pytest.raises(TypeError, match=r"depth.*: expected no masked array, whose mask would be lost"):
        Frame(IMAGE, K, POSE, depth=hidden)
    with pytest.raises(TypeError, match="expected no masked array"):
        superpoints(np.ma.masked_array(np.ones((9, 3)), mask=True))
    with pytest.raises(TypeError, match=r"labels: expected a torch\.Tensor or a NumPy array, got MaskedArray"):
        from_labels(hidden.astype(int))


@pytest.mark.parametrize("thin", [0.0, -1.0, float("nan"), float("inf")])
def test_lengths_that_thin_nothing_or_all(thin):
    with pytest.raises(ValueError, match="--thin: expected more than 0 metres, got"):
        RecordingOptions(thin=thin).check(Config())


@pytest.mark.parametrize("channels", [1, 3])
def test_arrays_of_numpy(channels):
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (4, 6, channels), dtype=np.uint8)
    masks, scores = rng.random((2, 4, 6)) < 0.5, np.array([0.5, 1.0], np.float32)
    frame = Frame(image[:, ::-1], np.eye(3), np.eye(4), depth=np.ones((4, 6)), masks=masks, mask_scores=scores)
    expected = torch.from_numpy(image[:, ::-1].transpose(2, 0, 1).copy()).float().div(255).expand(3, -1, -1)
    assert torch.equal(frame.image, expected)
    assert torch.equal(frame.depth, torch.ones(4, 6))
    assert torch.equal(frame.masks.labels(), Frame(expected, torch.eye(3), torch.eye(4), masks=torch.from_numpy(masks),
                                                   mask_scores=torch.from_numpy(scores)).masks.labels())  # fmt: skip
    assert torch.equal(Frame(expected.numpy(), np.eye(3), np.eye(4)).image, expected)  # channels may come first
    with pytest.raises(TypeError, match="image: expected numbers, got an array of object"):
        Frame(np.full((4, 6, 3), None), np.eye(3), np.eye(4))


def test_what_was_given_may_change_later():
    points, scores = torch.rand(9, 3), torch.ones(1)
    scene, before = Scene(points), points.clone()
    frame = Frame(IMAGE, K, POSE, masks=torch.ones(1, 48, 64, dtype=torch.bool), mask_scores=scores)
    points.zero_(), scores.zero_()
    assert torch.equal(scene.points, before)
    assert frame.masks.scores.tolist() == [1.0]


def test_arrays_of_another_byte_order():
    frame = Frame(IMAGE.numpy().astype(">f4"), K.numpy().astype(">f8"), POSE.numpy().astype(">f4"))
    assert torch.equal(frame.image, IMAGE)
    assert torch.equal(frame.intrinsics, K.double())


def test_an_image_divided_by_255_twice_is_told():
    """It is black, so that the cloud alone decided, in silence."""
    with pytest.warns(UserWarning, match=r"^image of frame 'f': got values up to 0\.0039 of 1; were they divided"):
        Frame(torch.linspace(0, 1 / 255, 64).view(8, 8), torch.eye(3), torch.eye(4), name="f")


def test_intrinsics_may_be_integers():
    matrix = np.array([[50, 0, 32], [0, 50, 24], [0, 0, 1]])
    assert Frame(IMAGE, matrix, POSE).intrinsics.tolist() == matrix.tolist()


@pytest.mark.parametrize("shape", [(48, 64), (1, 48, 64)])
def test_grey_images_are_repeated(shape):
    frame = Frame(torch.full(shape, 0.5), K, POSE)
    assert frame.image.shape == (3, 48, 64)
    assert (frame.image == 0.5).all()


def test_8_bit_images_are_divided_by_255():
    assert Frame(torch.full((3, 4, 4), 255, dtype=torch.uint8), K, POSE).image.max() == 1.0


def rotation_scaled(factor):
    pose = torch.eye(4)
    pose[:3, :3] *= factor
    return pose


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"image": [1, 2]}, TypeError, r"image of frame 'f': expected a torch.Tensor, got list"),
        (
            {"image": torch.rand(4, 5, 6)},
            ValueError,
            r"image of frame 'f': expected shape \[3, H, W\].*got \[4, 5, 6\]",
        ),
        ({"image": torch.rand(3, 0, 6)}, ValueError, r"image of frame 'f': expected at least one pixel"),
        ({"image": IMAGE * 255}, ValueError, r"image of frame 'f': expected values in \[0, 1\]"),
        ({"image": IMAGE / 0 - IMAGE / 0}, ValueError, r"image of frame 'f': expected finite values"),
        (
            {"world_to_camera": POSE.half()},
            TypeError,
            "world_to_camera of frame 'f': .* got torch.float16; give float32",
        ),
        ({"intrinsics": K.bfloat16()}, TypeError, "intrinsics of frame 'f': .* got torch.bfloat16; give float32"),
        ({"image": IMAGE.long()}, TypeError, r"image of frame 'f': expected a floating dtype"),
        ({"intrinsics": torch.eye(4)}, ValueError, r"intrinsics of frame 'f': expected shape \[3, 3\], got \[4, 4\]"),
        # Skew was accepted, and not applied.
        ({"intrinsics": torch.tensor([[9.0, 1, 4], [0, 9, 4], [0, 0, 1]])}, ValueError, r"expected \[\[fx, 0, cx\]"),
        ({"intrinsics": torch.zeros(3, 3)}, ValueError, r"intrinsics of frame 'f': expected \[\[fx, 0, cx\]"),
        ({"world_to_camera": torch.eye(3)}, ValueError, r"world_to_camera of frame 'f': expected shape \[4, 4\]"),
        ({"world_to_camera": POSE * torch.nan}, ValueError, r"world_to_camera of frame 'f': expected finite values"),
        ({"world_to_camera": rotation_scaled(2)}, ValueError, r"world_to_camera of frame 'f': expected a rigid"),
        ({"world_to_camera": rotation_scaled(-1)}, ValueError, r"expected a rigid transform.*det R = -1"),
        ({"depth": torch.ones(4, 4)}, ValueError, r"depth of frame 'f': expected shape \[48, 64\], got \[4, 4\]"),
        ({"depth": -torch.ones(48, 64)}, ValueError, r"depth of frame 'f': expected metres above 0 .*, got none"),
        (
            {"depth": np.ones((48, 64), np.uint16)},
            TypeError,
            "depth of frame 'f': expected metres as float32, got torch.u",
        ),
        (
            {"masks": torch.ones(48, 64, 5).bool()},
            ValueError,
            r"masks of frame 'f': expected \[M, H, W\], got \[H, W, M",
        ),
        ({"labels": torch.ones(48, 64)}, TypeError, r"labels of frame 'f': expected an integer dtype"),
        (
            {"labels": torch.ones(48, 64).long().to_sparse()},
            TypeError,
            "labels of frame 'f': expected a dense tensor, got one of torch.sparse_coo",
        ),
        ({"name": 5}, TypeError, "name: expected a text, got 5"),
        ({"depth": torch.ones(48, 64).to_sparse()}, TypeError, r"depth of frame 'f'.*: expected a dense tensor"),
        ({"labels": torch.full((48, 64), -2)}, ValueError, r"labels of frame 'f': expected labels >= -1.*got -2"),
    ],
)
def test_bad_frames(change, error, message):
    arguments = {"image": IMAGE, "intrinsics": K, "world_to_camera": POSE, "name": "f"} | change
    with pytest.raises(error, match=message):
        Frame(**arguments)


NUMBERS = torch.ones(4, 3)


@pytest.mark.parametrize(
    "call",
    [
        Scene,
        lambda odd: Scene(NUMBERS, colors=odd),
        lambda odd: Frame(odd, K, POSE),
        lambda odd: Frame(IMAGE, odd, POSE),
        lambda odd: Frame(IMAGE, K, POSE, masks=odd),
        superpoints,
        Masks.from_labels,
        lambda odd: transfer_labels(odd, NUMBERS, NUMBERS),
        lambda odd: ops.nearest_neighbors(odd, NUMBERS, 1),
        lambda odd: mean_best_iou(odd, NUMBERS.long()),
        lambda odd: from_instances({"pred_masks": odd}),
    ],
)
@pytest.mark.filterwarnings("ignore:.*(nested|quantize)")
@pytest.mark.parametrize(
    "make",
    [
        lambda: torch.nested.nested_tensor([NUMBERS, NUMBERS[:2]]),
        lambda: NUMBERS.to("meta"),
        lambda: torch.quantize_per_tensor(NUMBERS, 0.1, 0, torch.quint8),
    ],
    ids=["nested", "meta", "quantized"],
)
def test_tensors_without_numbers_in_a_row(call, make):
    with pytest.raises((TypeError, ValueError), match=r"^[\w ]+: expected"):
        call(make())


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"points": torch.zeros(0, 3)}, ValueError, "points: expected at least one point, got an empty cloud"),
        ({"points": torch.zeros(5, 2)}, ValueError, r"points: expected shape \[N, 3\], got \[5, 2\]"),
        ({"points": torch.zeros(5, 3) / 0}, ValueError, "points: 5 of 5 points are NaN or infinite"),
        ({"points": [[0, 0, 0]]}, TypeError, "points: expected a torch.Tensor, got list"),
        ({"points": torch.zeros(5, 3).long()}, TypeError, "points: expected a floating dtype, got torch.int64"),
        (
            {"points": torch.zeros(5, 3).to_sparse()},
            TypeError,
            "points: expected a dense tensor, got one of torch.spar",
        ),
        ({"points": torch.zeros(5, 3) * 1j}, TypeError, "points: expected a floating dtype, got torch.complex64"),
        ({"points": torch.zeros(5, 3, device="meta")}, ValueError, "points: expected a CPU tensor, got one on meta"),
        ({"points": torch.zeros(5, 3), "colors": torch.zeros(4, 3)}, ValueError, r"colors: expected shape \[5, 3\]"),
        (
            {"points": torch.zeros(5, 3), "colors": torch.eye(5).to_sparse()},
            TypeError,
            "colors: expected a dense tensor",
        ),
        (
            {"points": torch.full((5, 3), 5.4e13)},
            ValueError,
            r"points: expected coordinates up to 1e\+12, got 5\.4e\+13",
        ),
        (
            {"points": torch.zeros(5, 3), "colors": torch.ones(5, 3) * 300},
            ValueError,
            r"colors: expected values in \[0",
        ),
        (
            {"points": torch.zeros(5, 3), "normals": torch.zeros(5, 3)},
            ValueError,
            "normals: expected unit vectors, got 5",
        ),
        (
            {"points": torch.zeros(5, 3), "frames": iter([])},
            TypeError,
            "frames: expected a sequence of Frame, got list_it",
        ),
        ({"points": torch.zeros(5, 3), "normals": torch.zeros(5)}, ValueError, r"normals: expected shape \[5, 3\]"),
    ],
)
def test_bad_scenes(arguments, error, message):
    with pytest.raises(error, match=message):
        Scene(**arguments)


class TestTruth:
    def scene(self):
        frames = [Frame(IMAGE, K, POSE, name=str(i)) for i in range(3)]
        truth = Truth(torch.tensor([0, 1, -1, 2]), [torch.full((48, 64), i) for i in range(3)])
        return Scene(torch.rand(4, 3), frames, colors=torch.rand(4, 3), truth=truth)

    def test_some_points_take_theirs_along(self):
        some = self.scene().select_points(torch.tensor([True, False, False, True]))
        assert some.points.shape == some.colors.shape == (2, 3)
        assert some.truth.points.tolist() == [0, 2]
        assert len(some.truth.images) == 3

    def test_some_frames_take_theirs_along(self):
        some = self.scene().select_frames([2, 0])
        assert [frame.name for frame in some.frames] == ["2", "0"]
        assert [int(image[0, 0]) for image in some.truth.images] == [2, 0]
        assert len(some.truth.points) == 4
        for mask in ([True, False, True], torch.tensor([True, False, True]), np.array([True, False, True])):
            assert [frame.name for frame in self.scene().select_frames(mask).frames] == ["0", "2"]
        with pytest.raises(IndexError, match="boolean index did not match"):
            self.scene().select_frames([True, False])

    def test_a_list_of_frames_may_be_used_again(self):
        frames = list(self.scene().frames)
        scene = Scene(torch.rand(4, 3), frames)
        frames.clear()
        assert len(scene.frames) == 3

    def test_truth_of_another_size(self):
        with pytest.raises(ValueError, match=r"truth\.points: expected shape \[4\], got \[3\]"):
            Scene(torch.rand(4, 3), truth=Truth(torch.zeros(3, dtype=torch.int64)))


@pytest.mark.parametrize("kind", ["tensor", ".npy", ".npz"])
def test_coordinates_of_16_bits_are_told(tmp_path, kind):
    """500 m from the origin they are multiples of half a metre."""
    points = np.random.default_rng(0).uniform(500, 510, (60, 3)).astype(np.float16)
    np.save(tmp_path / "a.npy", points)
    np.savez(tmp_path / "a.npz", points=points)
    with pytest.warns(UserWarning, match=r"torch\.float16 keeps only 0\.5 m this far from the origin"):
        Scene(torch.from_numpy(points)) if kind == "tensor" else load_scene(tmp_path / f"a{kind}")
