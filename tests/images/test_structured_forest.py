"""The detector that runs a forest, the one that comes with the package, and how a config names detectors."""

from __future__ import annotations

import copy
import pickle
import shutil
from concurrent.futures import ThreadPoolExecutor
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
import torch
from folder_files import write_folder
from torch import Tensor, nn
from torchjoint_lab.datasets.bsds import bsds_images
from torchjoint_lab.evaluation.boundary_scores import evaluate_boundaries

import torchjoint as tj
from torchjoint.config import BoundaryConfig, Config
from torchjoint.images import forest as structured_forest
from torchjoint.images.boundary import GradientBoundary, make_boundary
from torchjoint.images.forest import StructuredForestBoundary
from torchjoint.recordings import segment_recording

MODEL = Path(str(files("torchjoint.models"))) / "bsds500.yml.gz"


class Vertical(nn.Module):
    """Somebody's own detector: one boundary down the middle."""

    def forward(self, images: Tensor) -> Tensor:
        boundary = torch.zeros_like(images[:, 0])
        boundary[..., images.shape[-1] // 2] = 1
        return boundary


class TestStructuredForestBoundary:
    def test_it_sees_objects_and_not_texture(self):
        torch.manual_seed(0)
        rows, columns = torch.meshgrid(torch.arange(120.0), torch.arange(160.0), indexing="ij")
        distance = torch.hypot(rows - 60, columns - 80)
        image = torch.where(distance < 35, torch.tensor([0.7, 0.3, 0.2])[:, None, None], torch.tensor(0.45))
        image = (image + 0.1 * torch.randn(1, 120, 160)).clamp(0, 1)
        boundary = StructuredForestBoundary()(image[None])[0]
        on, off = boundary[(distance - 35).abs() < 1.5], boundary[(distance - 35).abs() > 8]
        assert on.median() > 5 * off.quantile(0.95)
        gradient = GradientBoundary()(image[None])[0]
        assert gradient[(distance - 35).abs() < 1.5].median() < 5 * gradient[(distance - 35).abs() > 8].quantile(0.95)

    @pytest.mark.parametrize("size", [(1, 1), (1, 50), (7, 9), (15, 16), (31, 33), (64, 65), (97, 130)])
    @pytest.mark.parametrize("options", [{}, {"scales": (0.5, 1, 2)}, {"nms": True}])
    def test_any_size(self, size, options):
        torch.manual_seed(0)
        boundary = StructuredForestBoundary(**options)(torch.rand(2, 3, *size))
        assert boundary.shape == (2, *size)
        assert boundary.dtype == torch.float32
        assert ((boundary >= 0) & (boundary <= 1)).all()

    @pytest.mark.parametrize("value", [0.0, 0.3, 1.0])
    def test_constant_images_have_no_boundary(self, value):
        assert StructuredForestBoundary()(torch.full((1, 3, 40, 50), value)).max() < 0.05

    def test_grey_images(self):
        grey = torch.zeros(1, 1, 60, 80)
        grey[..., 40:] = 0.8
        boundary = StructuredForestBoundary()(grey.expand(-1, 3, -1, -1))[0]
        assert (boundary.argmax(dim=1) - 39.5).abs().max() <= 2

    def test_borders_are_like_the_middle(self):
        """Without a margin the detector's votes would fade out towards the image's border."""
        image = torch.zeros(1, 3, 96, 128)
        image[..., 64:] = 0.7
        along = StructuredForestBoundary()(image)[0].amax(dim=1)
        assert along[:4].min() > 0.7 * along.median()
        assert along[-4:].min() > 0.7 * along.median()

    def test_relative_gradient_by_hand(self):
        """On a ramp the gradient is the same everywhere, and so its mean; at a step it stands out."""
        ramp = np.repeat(np.arange(60, dtype=np.float32)[None, None] * 0.01, 40, axis=1).repeat(3, axis=0)
        gradient = 0.01 * 3**0.5
        assert structured_forest.relative_gradient(ramp)[20, 30] == pytest.approx(
            gradient / (gradient + 0.01), rel=1e-4
        )
        step = (ramp > 0.295).astype(np.float32)
        relative = structured_forest.relative_gradient(step)[20]
        assert set(relative.argsort()[-2:]) == {29, 30}
        assert relative.max() > 1.5
        assert not structured_forest.relative_gradient(np.full_like(ramp, 0.3)).any()

    def test_images_are_independent_of_batch_and_threads(self, set_threads):
        torch.manual_seed(0)
        images = torch.rand(3, 3, 50, 61)
        detector = StructuredForestBoundary()
        together = detector(images)
        assert torch.equal(together, torch.stack([detector(image[None])[0] for image in images]))
        for threads in (1, 2, 5):
            set_threads(threads)
            assert torch.equal(detector(images), together)

    def test_options_do_what_they_say(self):
        image = torch.zeros(1, 3, 80, 80)
        image[..., 20:60, 20:60] = 0.7
        every = ({}, {"nms": True}, {"scales": (0.5, 1, 2)}, {"stride": 4})
        plain, nms, multi, sparse = (StructuredForestBoundary(**options)(image) for options in every)
        assert ((nms == plain) | (nms == 0)).all()
        assert 0 < (nms > 0.1).sum() < 0.6 * (plain > 0.1).sum()
        assert not torch.equal(multi, plain)
        assert not torch.equal(sparse, plain)
        assert sparse.mean() == pytest.approx(float(plain.mean()), rel=0.1)  # fewer votes, which weigh more

    def test_it_can_be_copied_and_sent(self):
        image = torch.rand(1, 3, 40, 40)
        detector = StructuredForestBoundary()
        for other in (copy.deepcopy(detector), pickle.loads(pickle.dumps(detector))):
            assert torch.equal(other(image), detector(image))

    def test_errors(self, tmp_path):
        with pytest.raises(FileNotFoundError, match=r"none\.yml\.gz: missing"):
            StructuredForestBoundary(tmp_path / "none.yml.gz")
        (tmp_path / "cut.yml.gz").write_bytes(MODEL.read_bytes()[:100_000])
        with pytest.raises(ValueError, match=r"cut\.yml\.gz: not a whole \.gz file"):
            StructuredForestBoundary(tmp_path / "cut.yml.gz")
        (tmp_path / "foreign.yml").write_text("%YAML:1.0\n---\nsvm: [ 1, 2 ]\n")
        with pytest.raises(ValueError, match=r"foreign\.yml: not a structured forest"):
            StructuredForestBoundary(tmp_path / "foreign.yml")
        for scales in ((), (0,), (-1.0,), (float("nan"),), (9,)):
            with pytest.raises(ValueError, match=r"scales: expected"):
                StructuredForestBoundary(scales=scales)
        with pytest.raises(ValueError, match=r"stride: expected 2 or 4, got 3"):
            StructuredForestBoundary(stride=3)
        for shape in ((3, 4, 5), (1, 1, 4, 5)):
            with pytest.raises(ValueError, match=r"images: expected shape"):
                StructuredForestBoundary()(torch.zeros(shape))
        with pytest.raises(ValueError, match=r"images: expected at most"):
            StructuredForestBoundary()(torch.zeros(1, 3, 1, 20_000))
        assert StructuredForestBoundary()(torch.zeros(0, 3, 4, 5)).shape == (0, 4, 5)

    def test_a_package_whose_model_is_cut_off_says_so(self, tmp_path, monkeypatch):
        (tmp_path / "bsds500.yml.gz").write_bytes(MODEL.read_bytes()[:100_000])
        monkeypatch.setattr(structured_forest, "files", lambda package: tmp_path)
        structured_forest._trees.cache_clear()
        with pytest.raises(ValueError, match=r"bsds500\.yml\.gz: not a whole"):
            StructuredForestBoundary()(torch.rand(1, 3, 8, 8))
        (tmp_path / "bsds500.yml.gz").unlink()
        with pytest.raises(FileNotFoundError, match=r"bsds500\.yml\.gz: missing"):
            StructuredForestBoundary()(torch.rand(1, 3, 8, 8))


class TestModel:
    def test_the_same_from_a_path_until_that_is_another_file(self, tmp_path):
        assert MODEL.stat().st_size < 15e6
        file = tmp_path / "mine.yml.gz"
        shutil.copy(MODEL, file)
        image = torch.rand(1, 3, 40, 40)
        assert torch.equal(StructuredForestBoundary(file)(image), StructuredForestBoundary()(image))
        file.write_bytes(MODEL.read_bytes()[:1000])
        with pytest.raises(ValueError, match=r"mine\.yml\.gz: not a whole"):
            StructuredForestBoundary(file)

    @pytest.mark.slow
    def test_it_finds_peoples_boundaries(self, shared):
        """On a few images, which it has seen: far better than gradients. Scores on unseen ones are the model card's."""
        images = bsds_images(shared / "data" / "bsds500", "val")[::33]
        forest, gradient = (
            evaluate_boundaries(one, images, 7).ods for one in (StructuredForestBoundary(), GradientBoundary())
        )
        assert forest > gradient + 0.05


class TestMakeBoundary:
    def test_the_default_is_the_forest(self):
        detector = make_boundary(BoundaryConfig())
        assert isinstance(detector, StructuredForestBoundary)
        assert detector.scales == (1.0,)
        assert isinstance(tj.JointSegmenter().image_segmenter.boundary, StructuredForestBoundary)

    def test_parameters_arrive(self):
        detector = make_boundary(BoundaryConfig(multi_scale=True, model=str(MODEL)))
        assert (detector.scales, detector.model) == ((0.5, 1.0, 2.0), str(MODEL))
        assert isinstance(make_boundary(BoundaryConfig(detector="gradient")), GradientBoundary)

    def test_a_module_of_ones_own(self, scene_of):
        config = Config().set([f"boundary.detector={__name__}:Vertical"])
        assert isinstance(make_boundary(config.boundary, allow_import=True), Vertical)
        scene = scene_of(0).scene
        assert len(tj.JointSegmenter(config, allow_import=True)(scene).images) == len(scene.frames)

    def test_a_config_of_others_imports_nothing(self, scene_of, tmp_path, monkeypatch):
        """It may come with a result, with the module beside it."""
        (tmp_path / "evil_module.py").write_text("import pathlib\npathlib.Path(__file__).with_name('ran').touch()")
        monkeypatch.syspath_prepend(tmp_path)
        out = shutil.copytree(Path(__file__).parents[1] / "samples" / "result-0.1.0", tmp_path / "out")
        run = out / "run.yaml"
        run.write_text(run.read_text().replace("detector: gradient", "detector: evil_module:Boundary"))
        config = tj.load_result(out).config
        assert config.boundary.detector == "evil_module:Boundary"
        message = (
            r"boundary\.detector: expected gradient or structured_forest, got code, evil_module:Boundary; allow_imp"
        )
        write_folder(tmp_path / "scene", scene_of(0))
        for use in (
            lambda: tj.JointSegmenter(config),
            lambda: tj.JointSegmenter().compute(config=config),
            lambda: segment_recording(tmp_path / "scene", tmp_path / "new", config, tj.RecordingOptions(max_frames=1)),
        ):
            with pytest.raises((ValueError, RuntimeError), match=rf"{message}|call reset"):
                use()
        report = tj.batch(tmp_path / "scene", tmp_path / "batch", engine=ThreadPoolExecutor(1), config=config)
        assert "got code, evil_module:Boundary" in report.failures["scene"]
        assert not (tmp_path / "ran").exists()
        with pytest.raises(ValueError, match="cannot be made"):
            tj.JointSegmenter(config, allow_import=True)
        assert (tmp_path / "ran").exists()

    @pytest.mark.parametrize(
        ("detector", "message"),
        [
            ("sobel", "expected structured_forest, gradient or package.module:Class, got 'sobel'"),
            ("os; rm", "expected structured_forest"),
            ("no_such_package:Boundary", "cannot be made"),
            ("torch.nn:NoSuchClass", "cannot be made"),
            ("torch.nn:Linear", "cannot be made"),
            ("builtins:dict", "to be a torch.nn.Module, got dict"),
        ],
    )
    def test_errors(self, detector, message):
        with pytest.raises(ValueError, match=r"boundary\.detector") as error:
            make_boundary(BoundaryConfig(detector=detector), allow_import=True)
        assert message in str(error.value)

    def test_types(self):
        with pytest.raises(TypeError, match=r"boundary\.multi_scale: expected true or false, got 1"):
            BoundaryConfig(multi_scale=1)
        with pytest.raises(TypeError, match=r"boundary\.model: expected a text, got 3"):
            BoundaryConfig(model=3)
