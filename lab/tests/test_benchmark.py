"""The benchmark: its baselines by hand, its search, and the command from end to end."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import yaml
from folder_files import write_folder, write_truth
from torchjoint_lab.benchmark import suites
from torchjoint_lab.benchmark.case import Case
from torchjoint_lab.benchmark.known_images import KnownImages
from torchjoint_lab.benchmark.method import Method, Result
from torchjoint_lab.benchmark.methods import METHODS
from torchjoint_lab.benchmark.paint import paint
from torchjoint_lab.benchmark.planes import planes_and_clusters
from torchjoint_lab.benchmark.search import Budget, run_scores, search
from torchjoint_lab.benchmark.settings import read_settings, write_settings
from torchjoint_lab.benchmark.space import Between, Choice, draw, near
from torchjoint_lab.benchmark.suites import SUITES
from torchjoint_lab.benchmark.vote import vote
from torchjoint_lab.regions import PRESETS, RegionsConfig, segmenter

import torchjoint as tj
from torchjoint.config import presets
from torchjoint.views.visibility import Visible, in_any_view


@pytest.fixture(scope="module")
def scene(scene_of):
    return scene_of(2).scene


@pytest.fixture(scope="module")
def case(scene):
    return Case(scene, tj.Config())


def pixels_of(point, row, column, z=None):
    """Points in pixels of a view."""
    point, row, column = (torch.tensor(values) for values in (point, row, column))
    z = torch.ones(len(point)) if z is None else torch.tensor(z)
    return Visible(point, row, column, column.float(), row.float(), z)


class TestPaint:
    def test_every_pixel_has_the_nearest_point(self):
        labels = paint(pixels_of([0, 2], [0, 0], [0, 4]), torch.tensor([7, 8, 9]), (2, 5))
        assert labels[0].tolist()[:2] == [7, 7]
        assert labels[0].tolist()[3:] == [9, 9]
        assert labels[1, 0] == 7

    def test_in_one_pixel_the_nearer_one_counts(self):
        far_first = paint(pixels_of([0, 1], [0, 0], [0, 0], [2.0, 1.0]), torch.tensor([5, 6]), (1, 1))
        near_first = paint(pixels_of([0, 1], [0, 0], [0, 0], [1.0, 2.0]), torch.tensor([5, 6]), (1, 1))
        tie = paint(pixels_of([0, 1], [0, 0], [0, 0], [1.0, 1.0]), torch.tensor([5, 6]), (1, 1))
        assert (int(far_first), int(near_first), int(tie)) == (6, 5, 5)

    def test_no_point(self):
        assert (paint(pixels_of([], [], []), torch.tensor([1]), (2, 2)) == -1).all()


class TestVote:
    POINTS = torch.tensor([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0], [4, 0, 0]])

    def test_one_view(self):
        image = torch.tensor([[5, 5, 9, -1]])
        labels = vote([image], [pixels_of([0, 1, 2, 3], [0] * 4, [0, 1, 2, 3])], self.POINTS)
        assert labels.tolist() == [0, 0, 1, 1, 1]  # the last two take that of the nearest labelled one

    def test_a_segment_goes_on_in_the_next_view(self):
        first, second = torch.tensor([[0, 0, 1]]), torch.tensor([[3, 3, 3]])
        views = [pixels_of([0, 1, 2], [0] * 3, [0, 1, 2]), pixels_of([1, 2, 3], [0] * 3, [0, 1, 2])]
        # Half of the second view's known points are 0, half are 1: the lower goes on.
        assert vote([first, second], views, self.POINTS).tolist()[:4] == [0, 0, 1, 0]

    def test_a_segment_without_a_majority_is_new(self):
        first, second = torch.tensor([[0, 1, 2]]), torch.tensor([[0, 0, 0, 0]])
        views = [pixels_of([0, 1, 2], [0] * 3, [0, 1, 2]), pixels_of([0, 1, 2, 3], [0] * 4, [0, 1, 2, 3])]
        assert vote([first, second], views, self.POINTS).tolist()[:4] == [0, 1, 2, 3]

    def test_no_view(self):
        assert vote([], [], self.POINTS).tolist() == [0] * 5


class TestPlanes:
    def test_a_floor_and_two_boxes(self):
        random = torch.Generator().manual_seed(0)
        floor = torch.rand(2000, 3, generator=random) * torch.tensor([4.0, 4.0, 0.002])
        boxes = [torch.rand(300, 3, generator=random) * 0.3 + torch.tensor([x, 1.0, 0.1]) for x in (0.5, 2.5)]
        points = torch.cat([floor, *boxes])
        truth = torch.arange(3).repeat_interleave(torch.tensor([2000, 300, 300]))
        labels = planes_and_clusters(points, 0.01, 0.3, 4, 0.15, 5)
        assert tj.metrics.objects_and_parts(labels, truth).f == 1
        assert torch.equal(labels, planes_and_clusters(points, 0.01, 0.3, 4, 0.15, 5))

    def test_noise_joins_the_nearest(self):
        points = torch.cat([torch.zeros(20, 3), torch.ones(20, 3), torch.full((1, 3), 0.8)])
        labels = planes_and_clusters(points + torch.rand(41, 3) * 1e-3, 1e-9, 0.9, 1, 0.1, 5)
        assert labels.tolist() == [0] * 20 + [1] * 21

    @pytest.mark.parametrize("count", [1, 2, 3])
    def test_few_points(self, count):
        assert len(planes_and_clusters(torch.rand(count, 3), 0.1, 0.1, 3, 0.1, 2)) == count


class TestCase:
    def test_points_in_view(self, scene):
        inside = in_any_view(scene.points, scene.frames)
        assert inside.float().mean() > 0.99  # the cloud was made from these very frames
        assert not in_any_view(scene.points, []).any()

    def test_every_point_was_seen_from_a_camera_that_sees_it(self, case, scene):
        centers = torch.stack([-(f.world_to_camera[:3, :3].T @ f.world_to_camera[:3, 3]) for f in scene.frames]).float()
        chosen = (case.viewpoints[:, None] == centers).all(2)
        assert chosen.any(1).all()
        sees = torch.stack([torch.zeros(len(scene.points)).index_fill(0, v.point, 1).bool() for v in case.visible], 1)
        ours = chosen.float().argmax(1)
        has_any = sees.any(1)
        assert sees[has_any, ours[has_any]].all()
        distance = (scene.points[:, None] - centers).norm(dim=2).masked_fill(~sees, torch.inf)
        assert torch.equal(distance.argmin(1)[has_any], ours[has_any])

    def test_what_is_kept(self, case):
        calls = []
        for key in (1, 1, 2, 1):
            case.keep("x", key, lambda key=key: calls.append(key))
        assert calls == [1, 2, 1]

    @pytest.mark.slow
    def test_known_images_are_those_of_the_segmenter(self, case, scene):
        frames = list(scene.frames)
        segmenter = tj.JointSegmenter()
        plain = segmenter(scene)
        segmenter.image_segmenter = KnownImages(segmenter.config, frames)
        again = segmenter(tj.Scene(scene.points, frames, scene.colors))
        assert torch.equal(again.points, plain.points)
        assert all(torch.equal(a, b) for a, b in zip(again.images, plain.images, strict=True))


SETTINGS = {
    "scikit_image": {"scale": 100, "sigma": 0.8, "min_size": 20},
    "normals": {"scale": 0.01},
    "ransac_dbscan": {"distance": 0.02, "min_share": 0.05, "max_planes": 6, "eps": 0.1, "min_points": 4},
}


class TestMethods:
    def test_presets_have_nothing_to_search(self):
        expected = {f"preset_{name}" for name in (*presets(), *PRESETS)}
        assert {name for name in METHODS if name.startswith("preset_")} == expected
        assert METHODS["preset_paper"].space_in("mosd") == {}

    @pytest.mark.parametrize("name", METHODS)
    def test_points_and_images(self, case, name):
        setting = SETTINGS.get(name, {})
        result = METHODS[name].run(case, setting, True)
        assert result.points.shape == (3000,)
        assert [tuple(image.shape) for image in result.images] == [frame.size for frame in case.frames]
        points_alone = METHODS[name].run(case, setting, False)
        assert len(points_alone.images) == 0
        assert torch.equal(points_alone.points, result.points)
        assert set(run_scores(METHODS[name], setting, case, True)) == {"3D", "2D"}

    #: Two in a row, and three among the slow tests.
    @pytest.mark.parametrize(
        "settings",
        [
            [{"propagation.window": 3}, {"image_segments.scale": 10.0}],
            pytest.param(
                [{"refinement.color_weight": 50.0}, {"propagation.window": 3}, {"image_segments.scale": 10.0}],
                marks=pytest.mark.slow,
            ),
        ],
    )
    def test_joint_is_the_segmenter(self, case, scene, settings):
        """Whatever is kept from setting to setting, the labels are those of a run from scratch."""
        for setting in settings:
            result = METHODS["joint"].run(case, setting, True)
            values = [f"{name}={value}" for name, value in setting.items()]
            expected = tj.JointSegmenter(tj.Config().set(values))(scene)
            assert torch.equal(result.points, expected.points), setting
            assert all(torch.equal(a, b) for a, b in zip(result.images, expected.images, strict=True)), setting

    def test_joint_is_the_segmenter_of_the_suite_s_preset(self, scene):
        case = Case(scene, tj.Config(), RegionsConfig.from_preset("indoor"))
        expected = segmenter("indoor")(scene)
        assert torch.equal(METHODS["joint"].run(case, {}, False).points, expected.points)
        merged = METHODS["joint"].run(case, {"region_merging.threshold": 0.6}, False).points
        assert merged.max() < expected.points.max()

    def test_geometry_does_without_images(self, scene):
        case = Case(scene, tj.Config(), RegionsConfig.from_preset("indoor"))
        assert torch.equal(
            METHODS["geometry"].run(case, {}, False).points,
            METHODS["joint"].run(case, {"region_costs.weight": 0.0}, False).points,
        )

    @pytest.mark.parametrize("suite", SUITES)
    @pytest.mark.parametrize("name", METHODS)
    def test_every_setting_of_the_space_is_allowed(self, name, suite):
        """Names and ranges are those of the methods' parameters."""
        random = np.random.default_rng(0)
        space = METHODS[name].space_in(suite)
        for _ in range(20 if space else 0):
            setting = near(draw(space, random), space, random)
            assert list(setting) == list(space)
            METHODS[name].check(setting)  # raises for what the method cannot be given

    def test_settings_that_ship(self):
        for suite in SUITES:
            for name, setting in read_settings(suite).items():
                assert set(setting) <= set(METHODS[name].space_in(suite)), (suite, name)
                assert setting


class TestSpace:
    def test_draws_and_steps_stay_inside(self):
        random = np.random.default_rng(0)
        some, whole, zero = Between(0.1, 10), Between(5, 500, whole=True), Between(0.1, 1, or_zero=True)
        drawn = [(some.draw(random), whole.draw(random), zero.draw(random)) for _ in range(300)]
        assert all(0.1 <= a <= 10 and 5 <= b <= 500 and b == int(b) and (c == 0 or 0.1 <= c <= 1) for a, b, c in drawn)
        assert 60 < sum(c == 0 for *_, c in drawn) < 140
        assert 100 < sum(a < 1 for a, *_ in drawn) < 200  # evenly on a logarithmic scale
        values = [10.0]
        for _ in range(300):
            values.append(some.near(values[-1], random))
        assert all(0.1 <= value <= 10 for value in values)
        assert zero.near(0, random) == 0.1

    def test_choices_move_by_one(self):
        random = np.random.default_rng(0)
        choice = Choice((1, 3, 5))
        assert {choice.near(3, random) for _ in range(20)} == {1, 5}
        assert {choice.near(5, random) for _ in range(20)} == {3, 5}


class TestSearch:
    @staticmethod
    def method(calls):
        def run_(case, setting, images):
            calls.append(setting)
            cut = round(setting["cut"])
            return Result((torch.arange(100) >= cut).long())

        return Method("cut", "Cut", run_, {"": {"cut": Between(1, 99)}})

    @pytest.fixture
    def cases(self):
        truth = tj.scene.Truth((torch.arange(100) >= 30).long())
        frame = tj.Frame(torch.zeros(3, 4, 4), torch.eye(3), torch.eye(4))
        return [Case(tj.Scene(torch.rand(100, 3), [frame], truth=truth), tj.Config())]

    def test_it_finds_the_best(self, cases, tmp_path):
        best = search(self.method([]), "x", cases, Budget(20, 40), tmp_path / "log")
        assert best.score > 0.98
        assert best.score > search(self.method([]), "x", cases, Budget(20, 0), tmp_path / "draws").score

    def test_it_is_the_same_every_time_and_resumed(self, cases, tmp_path):
        first, again, resumed = [], [], []
        best = search(self.method(first), "x", cases, Budget(10, 10), tmp_path / "a")
        assert search(self.method(again), "x", cases, Budget(10, 10), tmp_path / "b") == best
        assert first == again
        lines = (tmp_path / "a").read_text().splitlines()
        assert len(lines) == 1 + 20
        (tmp_path / "a").write_text("\n".join(lines[:16]) + "\n")
        assert search(self.method(resumed), "x", cases, Budget(10, 10), tmp_path / "a") == best
        assert resumed == first[15:]
        assert (tmp_path / "a").read_text().splitlines() == lines

    def test_logs_of_something_else(self, cases, tmp_path):
        log = tmp_path / "log"
        search(self.method([]), "x", cases, Budget(2, 0), log)
        log.write_text(log.read_text() + "no\n")
        with pytest.raises(ValueError, match="log, line 4: not a trial of a search"):
            search(self.method([]), "x", cases, Budget(3, 0), log)
        log.write_text("no\n")
        with pytest.raises(ValueError, match="log: is of a search on other scenes or in other ranges"):
            search(self.method([]), "x", cases, Budget(1, 0), log)

    def test_a_log_of_other_scenes(self, cases, tmp_path):
        search(self.method([]), "x", cases, Budget(2, 0), tmp_path / "log")
        other = tj.Scene(cases[0].scene.points + 1, cases[0].frames, truth=cases[0].scene.truth)
        with pytest.raises(ValueError, match="log: is of a search on other scenes"):
            search(self.method([]), "x", [Case(other, tj.Config())], Budget(2, 0), tmp_path / "log")

    def test_trials_of_other_settings_are_not_believed(self, cases, tmp_path):
        search(self.method([]), "x", cases, Budget(1, 0), tmp_path / "log")
        wrong = json.dumps({"setting": {"cut": 31.0}, "score": 2.0})
        first = (tmp_path / "log").read_text().splitlines()[0]
        (tmp_path / "log").write_text(f"{first}\n{wrong}\n")
        assert search(self.method([]), "x", cases, Budget(3, 0), tmp_path / "log").score <= 1

    def test_scenes_without_truth(self, cases, tmp_path):
        void = tj.Scene(cases[0].scene.points, cases[0].frames, truth=tj.scene.Truth(torch.full((100,), -1)))
        assert run_scores(self.method([]), {"cut": 3}, Case(void, tj.Config())) == {}
        both = [Case(void, tj.Config()), *cases]
        best = search(self.method([]), "x", cases, Budget(5, 5), tmp_path / "a")
        assert search(self.method([]), "x", both, Budget(5, 5), tmp_path / "b") == best
        with pytest.raises(ValueError, match="expected scenes with truth"):
            search(self.method([]), "x", both[:1], Budget(5, 5), tmp_path / "c")


class TestSettings:
    def test_round_trip(self, tmp_path):
        file = tmp_path / "mine.yaml"
        write_settings(file, SETTINGS, "mine")
        assert read_settings("mosd", file) == SETTINGS
        assert [path.name for path in tmp_path.iterdir()] == ["mine.yaml"]

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("jiont: {}", "jiont: unknown method"),
            ("joint: 3", "joint: expected parameters by name"),
            ("joint: {point_segments.nope: 1}", r"joint: point_segments\.nope: unknown parameter"),
            ("normals: {nope: 1}", r"normals: .*nope: unknown parameter"),
            ("ransac_dbscan: {eps: hello}", "ransac_dbscan: eps: expected a number, got 'hello'"),
            ("scikit_image: {scaale: 3}", "scikit_image: scaale: unknown parameter"),
        ],
    )
    def test_mistakes(self, tmp_path, text, message):
        (tmp_path / "mine.yaml").write_text(text)
        with pytest.raises((ValueError, TypeError), match=f"mine.yaml: {message}"):
            read_settings("mosd", tmp_path / "mine.yaml")


class TestSuites:
    @pytest.fixture
    def data(self, tmp_path, scene_of):
        (data := tmp_path / "data").mkdir()
        for index in (1, 2, 10):
            scene = scene_of(index, num_views=2)
            write_truth(write_folder(data / f"scene{index}", scene), scene)
        return data

    def test_halves(self, data):
        assert list(SUITES["scannet"].scenes("tuning", data)) == ["scene1", "scene10"]
        assert list(SUITES["scannet"].scenes("checking", data)) == ["scene2"]
        assert len(next(suites.load_all(SUITES["scannet"].scenes("checking", data))).points) == 3000

    def test_scans_of_one_room_stay_together(self, monkeypatch):
        names = ["scene0000_00", "scene0000_01", "scene0001_00", "scene0002_00", "scene0002_01", "scene0003_00"]
        monkeypatch.setattr(suites, "list_scenes", lambda _: {name: Path(name) for name in names})
        tuning, checking = (list(SUITES["scannet"].scenes(half, Path())) for half in ("tuning", "checking"))
        assert tuning == ["scene0000_00", "scene0000_01", "scene0002_00", "scene0002_01"]
        assert checking == ["scene0001_00", "scene0003_00"]

    def test_folders_that_do_not_do(self, tmp_path, scene_of):
        with pytest.raises(ValueError, match="suite mosd needs the folder of its data"):
            SUITES["mosd"].scenes("tuning", None)
        write_truth(write_folder(tmp_path / "one", synthetic := scene_of(0, num_views=2)), synthetic)
        with pytest.raises(ValueError, match="holds too few scenes: none is left for checking"):
            SUITES["mosd"].scenes("checking", tmp_path)
        (tmp_path / "empty").mkdir()
        with pytest.raises(ValueError, match=r"is of no known format: it has no files"):
            SUITES["mosd"].scenes("checking", tmp_path / "empty")
        with pytest.raises(FileNotFoundError, match="nowhere does not exist"):
            SUITES["mosd"].scenes("checking", tmp_path / "nowhere")

    def test_seeds_that_are_tuned_on_are_not_checked_on(self):
        synthetic = SUITES["synthetic"]
        assert not set(synthetic.scenes("tuning", None)) & set(synthetic.scenes("checking", None))

    def test_synthetic_scenes(self, monkeypatch):
        made = {}

        def make(seed, size, **arguments):
            made[seed] = arguments
            whole = tj.Scene(torch.rand(120_000, 3))
            return SimpleNamespace(scene=whole)

        monkeypatch.setattr(suites, "make_scene", make)
        for name, num_points in (("synthetic", 120_000), ("sparse", 20_000)):
            scenes = SUITES[name].scenes("checking", None)
            assert list(scenes) == [str(seed) for seed in range(10)]
            assert len(scenes["3"]().points) == num_points
            assert made == {3: {"num_views": 24, "num_points": 120_000, "depth_ripple": 0.002, "hard": True}}

    @pytest.mark.slow
    def test_sparse_is_set_as_synthetic(self, monkeypatch, tmp_path, capsys, run_lab):
        small = tj.synthetic.make_scene
        monkeypatch.setattr(suites, "make_scene", lambda seed, size, **_: small(seed, num_views=2, num_points=3000))
        monkeypatch.setitem(
            SUITES,
            "sparse",
            replace(SUITES["sparse"], checking=lambda _: dict([*SUITES["synthetic"].checking(None).items()][:2])),
        )
        out = tmp_path / "out"
        run_lab("benchmark", "sparse", "-o", out, "--methods", "normals")
        used = yaml.safe_load((out / "settings.yaml").read_text())
        assert used == {"normals": read_settings("synthetic")["normals"]}
        table = (out / "table.md").read_text()
        assert "flat IoU" in table
        assert "concave IoU" in table
        assert "flat_iou" in (out / "scores.csv").read_text().splitlines()[0]
        assert "not tuned" not in capsys.readouterr().out
        with pytest.raises(SystemExit, match="--tuning: suite sparse uses the settings of suite synthetic; tune that"):
            run_lab("benchmark", "sparse", "-o", tmp_path / "other", "--tuning", 1, 1)

    #: Two of them in every run, all of them among the slow tests.
    @pytest.mark.slow
    @pytest.mark.parametrize("methods", [("joint", "ransac_dbscan"), METHODS])
    def test_the_command(self, methods, data, run_lab, tmp_path, capsys):
        page = tmp_path / "page.md"
        page.write_text("# Page\n\n<!-- benchmark scannet -->\nold\n<!-- end benchmark scannet -->\nrest\n")
        common = ["--data", data, "-o", tmp_path / "out"]
        chosen = [] if methods is METHODS else ["--methods", *methods]
        draws, steps = (1, 1) if chosen else (2, 1)
        tuning = ["--tuning", draws, steps]
        run_lab("benchmark", "scannet", *common, *tuning, "--methods", "joint_painted", "ransac_dbscan")
        assert set(yaml.safe_load((tmp_path / "out" / "settings.yaml").read_text())) == {"ransac_dbscan"}
        if chosen:
            with pytest.raises(SystemExit, match="--page: is for the table of all methods"):
                run_lab("benchmark", "scannet", *common, *tuning, *chosen, "--page", page, "--overwrite")
        else:
            tuning += ["--page", page]
        run_lab("benchmark", "scannet", *common, *tuning, *chosen, "--overwrite")
        printed = capsys.readouterr().out
        out = tmp_path / "out"
        names = {"table.md", "scores.csv", "scores.png", "settings.yaml", "search"}
        assert {path.name for path in out.iterdir()} == names
        table = (out / "table.md").read_text()
        assert "joint (final)" in table
        assert "RANSAC" in table
        assert "scene2" in table
        head, _, tail = page.read_text().partition("<!-- benchmark scannet -->\n")
        filled, _, rest = tail.partition("<!-- end benchmark scannet -->")
        assert (head, rest) == ("# Page\n\n", "\nrest\n")
        if chosen:
            assert filled == "old\n"
        else:
            assert filled.strip() in printed
            assert table.startswith(filled)
        assert len((out / "search" / "ransac_dbscan.jsonl").read_text().splitlines()) == 1 + draws + steps
        found = yaml.safe_load((out / "settings.yaml").read_text())
        assert set(found) == {name for name in methods if METHODS[name].space_in("scannet")}
        before = (out / "scores.csv").read_text()
        again = ("benchmark", "scannet", *common, *chosen, "--overwrite", "--settings")
        with pytest.raises(SystemExit, match="expected another path than the input's"):
            run_lab(*again, out / "settings.yaml")
        kept = (out / "settings.yaml").rename(tmp_path / "kept.yaml")
        run_lab(*again, kept)
        assert (out / "scores.csv").read_text() == before
        with pytest.raises(SystemExit, match="exists already; choose another name with -o, or --overwrite"):
            run_lab("benchmark", "scannet", *common)

    def test_mistakes_on_the_command_line(self, run_lab, tmp_path):
        out = ["-o", tmp_path / "out"]
        with pytest.raises(SystemExit, match="--methods: expected some of joint"):
            run_lab("benchmark", "synthetic", *out, "--methods", "jiont")
        with pytest.raises(SystemExit, match="--data: suite mosd needs the folder"):
            run_lab("benchmark", "mosd", *out)
        with pytest.raises(SystemExit, match=r"--settings: .*nope\.yaml does not exist"):
            run_lab("benchmark", "synthetic", *out, "--settings", Path("nope.yaml"))
        with pytest.raises(SystemExit, match="--tuning: expected draws >= 1 and steps >= 0, got 0 0"):
            run_lab("benchmark", "synthetic", *out, "--tuning", 0, 0)
        with pytest.raises(SystemExit, match=r"--page: .*nope\.md has no part"):
            run_lab("benchmark", "synthetic", *out, "--page", "nope.md")
        with pytest.raises(SystemExit, match="--scenes: only suite masks has it, got suite table"):
            run_lab("benchmark", "table", *out, "--scenes", 1)
        assert list(tmp_path.iterdir()) == []
