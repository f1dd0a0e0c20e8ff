"""Every command that writes: OUT is never what it reads, and what comes to OUT while it works stays there."""

import json
import re
import shutil

import pytest

import torchjoint as tj
from torchjoint.datasets.files.ply import write_cloud
from torchjoint.results.folder import parts_of, write_result
from torchjoint.runtime import outputs

pytestmark = pytest.mark.filterwarnings("ignore:boxes stand along z")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made") / "result"
    folder.mkdir()
    scene = tj.synthetic.make_scene(seed=3, num_points=400, num_views=2, height=48, width=64).scene
    segmenter = tj.JointSegmenter(tj.Config().set(["boundary.detector=gradient"]))
    write_result(folder, scene, segmenter(scene), segmenter.config, "made")
    return folder


@pytest.fixture
def result(made, tmp_path):
    return shutil.copytree(made, tmp_path / "result")


@pytest.fixture
def cloud(result, tmp_path):
    scene = tj.load_result(result).scene
    write_cloud(tmp_path / "cloud.ply", scene.points, scene.colors)
    return tmp_path / "cloud.ply"


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("link", [False, True])
@pytest.mark.parametrize(
    "arguments",
    [
        ("superpoints", "cloud.ply", "-o", "cloud.ply", "--overwrite"),
        ("superpoints", "result/points.npz", "-o", "result/points.npz", "--overwrite"),
        ("label", "result", "cloud.ply", "-o", "cloud.ply", "--overwrite"),
        ("label", "result", "cloud.ply", "-o", "result/points.ply", "--overwrite"),
        ("label", "result", "clouds/cloud.ply", "-o", "clouds", "--overwrite"),
        ("export", "result", "--format", "npz", "-o", "result/points.npz", "--overwrite"),
        ("export", "result", "--format", "ply", "-o", "result", "--overwrite"),
        ("show", "cloud.ply", "--static", "cloud.ply", "--overwrite"),
        ("show", "result", "--static", "result/run.yaml", "--overwrite"),
        ("show", "result", "--static", "clouds/cloud.ply", "--overwrite"),
        ("live", "result", "-o", "out", "--rerun", "result/run.yaml", "--overwrite"),
        ("export", "result", "--format", "coco", "-o", "result/segments.json", "--overwrite"),
        ("edits", "import", "result", "result/segments.json"),
        ("live", "result", "-o", "out", "--rerun", "out"),
        ("live", "result", "-o", "result/new", "--rerun", "result/new/../new"),
        ("live", "result", "-o", "clouds/../clouds", "--rerun", "clouds/a.rrd", "--overwrite"),
    ],
)
def test_an_output_is_no_input(run, result, cloud, tmp_path, monkeypatch, arguments, link):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "clouds").mkdir()
    shutil.copy(cloud, tmp_path / "clouds")
    given = list(arguments)
    if link:
        (tmp_path / "link").symlink_to(tmp_path)
        given = [f"link/{one}" if (tmp_path / one).exists() and index > 2 else one for index, one in enumerate(given)]
    before = contents(tmp_path)
    with pytest.raises(
        SystemExit,
        match=r"(-o|--static|--rerun|FILE): expected (another path than the in|a folder that|a path outside|.*\.html)",
    ):
        run(*given)
    assert contents(tmp_path) == before


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize(
    ("arguments", "out"),
    [
        (("superpoints", "cloud.ply", "--no-picture", "-o"), "out.ply"),
        (("superpoints", "cloud.ply", "--no-picture", "-o"), "out.npy"),
        (("superpoints", "cloud.ply", "-o", "other.npz"), "other.npz.png"),
        (("label", "result", "cloud.ply", "-o"), "out.ply"),
        (("label", "result", "cloud.ply", "-o"), "parts/"),
        (("export", "result", "--format", "npz", "-o"), "out.npz"),
        (("export", "result", "--format", "labelcloud", "-o"), "out.json"),
        (("export", "result", "--format", "scannet", "-o"), "instances/"),
        (("show", "result", "--static"), "page.html"),
    ],
)
def test_what_comes_meanwhile_stays(run, result, cloud, tmp_path, monkeypatch, arguments, out, overwrite):
    monkeypatch.chdir(tmp_path)
    mine = tmp_path / out / "mine.txt" if out.endswith("/") else tmp_path / out
    put = outputs.put

    def late(new, place, before, aside):
        if place.resolve() == tmp_path / out:
            mine.parent.mkdir(exist_ok=True)
            mine.write_text("by hand")
        put(new, place, before, aside)

    monkeypatch.setattr(outputs, "put", late)
    more = ([] if out == "other.npz.png" else [out]) + ["--overwrite"] * overwrite
    with pytest.raises(SystemExit, match="was made or changed while this run worked, and is kept; move it"):
        run(*arguments, *more)
    assert mine.read_text() == "by hand"
    assert not list(tmp_path.rglob(".partial-*"))


@pytest.mark.parametrize("arguments", [("export", "result", "--format", "ply"), ("label", "result", "cloud.ply")])
def test_a_link_to_a_folder_stays(run, result, cloud, tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "link").symlink_to("empty")
    with pytest.raises(SystemExit, match=r"link: expected no link, and a folder; choose another name"):
        run(*arguments, "-o", "link", "--overwrite")
    assert (tmp_path / "link").is_symlink()


@pytest.mark.parametrize("form", ["csv", "ply"])
def test_a_hyphen_is_no_file(run, result, tmp_path, monkeypatch, form):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit, match="-o: expected the name of a file or folder, got -"):
        run("export", result, "--format", form, "-o", "-")
    assert not (tmp_path / "-").exists()


@pytest.mark.parametrize(
    ("form", "names", "ends"),
    [("csv", ["report", "report.geojson"], r"\.csv"), ("geojson", ["a.csv"], r"\.geojson or \.json"),
     ("openpcdet", ["boxes"], r"\.txt"), ("las", ["a"], r"\.las or \.laz"), ("npz", ["a.npy"], r"\.npz")],
)  # fmt: skip
def test_a_file_of_one_format_has_its_suffix(run, result, tmp_path, form, names, ends):
    for name in names:
        with pytest.raises(SystemExit, match=rf"-o: expected a name that ends in {ends}, got .*{name}"):
            run("export", result, "--format", form, "-o", tmp_path / name)
    assert list(tmp_path.iterdir()) == [result]


def test_labelcloud_reads_names_and_format_beside_the_boxes(run, result, tmp_path, capsys):
    """A new project of labelCloud has neither: it took degrees for radians. What a project has, stays."""
    run("export", result, "--format", "labelcloud", "-o", tmp_path / "boxes.json")
    classes = json.loads((tmp_path / "_classes.json").read_text())
    assert (classes["format"], classes["type"]) == ("centroid_abs", "object_detection")
    assert [(one["name"], one["id"]) for one in classes["classes"]] == [("thing", classes["default"])]
    assert re.fullmatch("#[0-9a-f]{6}", classes["classes"][0]["color"])
    assert "_classes.json: the names" in capsys.readouterr().out
    (tmp_path / "_classes.json").write_text("mine")
    run("export", result, "--format", "labelcloud", "-o", tmp_path / "boxes.json", "--overwrite")
    assert (tmp_path / "_classes.json").read_text() == "mine"
    assert "_classes.json: was there, and stays" in capsys.readouterr().out


def test_a_page_may_lie_in_its_result(run, result):
    run("show", result, "--static", result / "page.html")
    with pytest.raises(SystemExit, match=r"page\.html: exists already; choose another name with --static, or --overw"):
        run("show", result, "--static", result / "page.html")
    run("show", result, "--static", result / "page.html", "--overwrite")
    assert (result / "page.html").stat().st_size > 1000
    tj.load_result(result)


@pytest.mark.parametrize(
    "name", ["edits.json", "EDITS.json", "masks.json", "cloud-5mm.ply", "images/x.png", "pieces/a"]
)
def test_what_is_new_takes_no_name_of_a_part_of_a_result(run, result, name):
    """It would be read as the part: with other edits.json, a result cannot be opened any more."""
    before = contents(result)
    for command in (("show", result, "--static"), ("export", result, "--format", "coco", "-o")):
        with pytest.raises(SystemExit, match=r"(-o|--static): expected a path outside of the parts of a result"):
            run(*command, result / name)
    assert contents(result) == before


def test_parts_are_all_that_a_result_has(result, tmp_path):
    assert set(parts_of(result)) == set(result.iterdir())
    assert parts_of(result / "points.ply") == [result / "points.ply"]


@pytest.mark.parametrize("option", ["--preset={}.yaml", "--set=point_segments.method={}.npz"])
def test_parameters_that_lie_in_the_output(run, result, tmp_path, option):
    for name in ("mine.yaml", "mine.npz"):
        (tmp_path / "result" / name).write_text("")
    option = option.format(result / "mine")
    for command in ("segment", "live"):
        with pytest.raises(SystemExit, match=r"-o: expected a folder that does not contain the input, .*mine\.[yn]"):
            run(command, tmp_path, "-o", result, option, "--overwrite")
