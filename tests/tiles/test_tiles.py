"""Superpoints of LAS files in tiles: the same as in one piece, as far as can be; files, restarts, errors."""

import os
import shutil
import struct
import zlib
from contextlib import nullcontext
from functools import partial

import laspy
import numpy as np
import pytest
import torch
from copc_files import write_copc
from las_town import town, write_las

import torchjoint as tj
from torchjoint.config import SuperpointsConfig
from torchjoint.metrics import segmentation_covering
from torchjoint.tiles import run as tiles
from torchjoint.tiles import superpoints_of_files
from torchjoint.tiles.plan import NARROWEST, Survey, plan_tiles, survey
from torchjoint.tiles.stitching import matching_superpoints, stitch
from torchjoint.tiles.tile import (
    AT_RIM,
    OWN,
    SHARED,
    OwnLabels,
    SharedLabels,
    TileTask,
    _cells_of_one_tile,
    _copies,
    point_type,
    read_shared,
    segment_tile,
    split_points,
    tile_file,
)


@pytest.fixture(scope="module")
def cloud(tmp_path_factory):
    return write_las(tmp_path_factory.mktemp("town") / "town.laz", town(8_000, 12))


def labels_of(path):
    return torch.from_numpy(laspy.read(path)["superpoint"].astype(np.int64))


def test_one_tile_is_the_cloud_in_one_piece_and_all_else_stays(cloud, tmp_path):
    made = superpoints_of_files(cloud, tmp_path / "out.laz")
    before, after = laspy.read(cloud), laspy.read(tmp_path / "out.laz")
    expected = tj.superpoints(torch.from_numpy(before.xyz.copy()), torch.full((8_000, 3), 30000 / 65535))
    assert made == (8_000, int(expected.max()) + 1, 1)
    assert torch.equal(labels_of(tmp_path / "out.laz"), expected)
    for name in before.points.array.dtype.names:
        assert (before.points.array[name] == after.points.array[name]).all(), name
    assert before.vlrs.get("WktCoordinateSystemVlr")[0].string == after.vlrs.get("WktCoordinateSystemVlr")[0].string
    assert (after.header.scales == before.header.scales).all()
    assert (after.header.offsets == before.header.offsets).all()
    assert [file.name for file in tmp_path.iterdir()] == ["out.laz"]


def test_tiles_give_nearly_the_labels_of_one_piece(cloud, tmp_path):
    made = superpoints_of_files(cloud, tmp_path / "out.las", tile=7, buffer=1, engine="loky:1")
    assert made.num_tiles >= 4
    whole = tj.superpoints(torch.from_numpy(laspy.read(cloud).xyz.copy()))
    labels = labels_of(tmp_path / "out.las")
    assert segmentation_covering(labels, whole).symmetric > 0.98
    assert labels.unique().tolist() == list(range(made.num_superpoints))
    firsts = [int((labels == label).nonzero()[0]) for label in range(made.num_superpoints)]
    assert firsts == sorted(firsts)  # numbered by their first points


def test_a_run_that_dies_goes_on_tile_by_tile(cloud, tmp_path, monkeypatch):
    made = superpoints_of_files(cloud, tmp_path / "whole.las", tile=7, buffer=1, engine="loky:1")
    done, segment = [], tiles.segment_tile

    def dies(*arguments):
        if len(done) == 2:
            raise KeyboardInterrupt
        done.append(arguments[-1].labels.name)
        return segment(*arguments)

    monkeypatch.setattr(tiles, "segment_tile", dies)
    with pytest.raises(KeyboardInterrupt):
        superpoints_of_files(cloud, tmp_path / "out.las", tile=7, buffer=1, engine="loky:1")
    assert not (tmp_path / "out.las").exists()
    again = []
    monkeypatch.setattr(tiles, "segment_tile", lambda *given: (again.append(given[-1].labels.name), segment(*given)))
    monkeypatch.setattr(tiles, "survey", None)  # the cloud is not read and cut again
    superpoints_of_files(cloud, tmp_path / "out.las", tile=7, buffer=1, engine="loky:1")
    assert sorted(done + again) == sorted({*done, *again})
    assert len(again) == made.num_tiles - 2
    assert (tmp_path / "out.las").read_bytes() == (tmp_path / "whole.las").read_bytes()


def test_damaged_points_of_a_killed_run_are_told(cloud, tmp_path, monkeypatch):
    """A file that had become shorter, or a flipped bit, gave other superpoints in silence."""
    make = partial(superpoints_of_files, cloud, tmp_path / "out.las", tile=7, buffer=1, engine="loky:1")
    monkeypatch.setattr(tiles, "_segment", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        make()
    monkeypatch.undo()
    points = tmp_path / "out.las.tiles" / "points" / "000001.points"
    whole = points.read_bytes()
    for damaged in (whole[: len(whole) // 2], whole[:-9] + bytes([whole[-9] ^ 1]) + whole[-8:], None):
        points.unlink() if damaged is None else points.write_bytes(damaged)
        with pytest.raises(ValueError, match=r"001\.points: damaged or lost; remove .*out\.las\.tiles and start again"):
            make()


def test_exchanged_or_lost_files_of_a_killed_run_are_told(cloud, tmp_path, monkeypatch):
    """Labels of another tile went into the result; a file without arrays gave a KeyError."""
    make = partial(superpoints_of_files, cloud, tmp_path / "out.las", tile=7, buffer=1, engine="loky:1")
    monkeypatch.setattr(tiles, "_stitch", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        make()
    monkeypatch.undo()
    work = tmp_path / "out.las.tiles"
    (labels, other), cut = sorted((work / "labels").iterdir())[:2], work / "cut.npz"
    kept = {file: file.read_bytes() for file in (labels, other, cut)}
    np.savez(tmp_path / "none.npz")
    none = (tmp_path / "none.npz").read_bytes()
    cases = [{labels: kept[other], other: kept[labels]}, {labels: none}, {labels: b""}, {cut: none}, {cut: b""}]
    for changed in cases:
        for file, content in (kept | changed).items():
            file.write_bytes(content)
        with pytest.raises(ValueError, match=r"^\S*out\.las\.tiles: damaged; remove it and start again: ."):
            make()
    shutil.rmtree(work / "labels")
    cut.write_bytes(kept[cut])
    with pytest.raises(ValueError, match=r"000\.points: damaged or lost; remove .*out\.las\.tiles and start again"):
        make()


def test_a_folder_of_files_is_one_cloud(tmp_path):
    points = town(6_000, 10)
    (tmp_path / "parts").mkdir()
    write_las(tmp_path / "parts" / "a.laz", points[:2500])
    write_las(tmp_path / "parts" / "b.las", points[2500:])
    write_las(tmp_path / "all.las", points)
    laspy.LasData(laspy.LasHeader(point_format=3)).write(tmp_path / "parts" / "empty.laz")
    (tmp_path / "parts" / "._a.laz").write_bytes(b"Mac OS X")
    for name, out in (("parts", "out"), ("all.las", "out.las")):
        with pytest.warns(match="1 of 3 files have no points, .*: empty") if out == "out" else nullcontext():
            superpoints_of_files(tmp_path / name, tmp_path / out, tile=5, buffer=1, engine="loky:1")
    (tmp_path / "parts" / "c.laz").symlink_to(tmp_path / "lost")
    with pytest.raises(ValueError, match=r"c\.laz: cannot be read: .* is a link to"):
        superpoints_of_files(tmp_path / "parts", tmp_path / "other")
    parts = [labels_of(tmp_path / "out" / name) for name in ("a.laz", "b.las")]
    assert torch.equal(torch.cat(parts), labels_of(tmp_path / "out.las"))


@pytest.mark.parametrize("content", ["survey", "text", "corrected"])
def test_files_of_a_user_in_a_folder_of_results_stay(cloud, tmp_path, content):
    (tmp_path / "parts").mkdir()
    shutil.copy(cloud, tmp_path / "parts" / "a.laz")
    superpoints_of_files(tmp_path / "parts", tmp_path / "out", engine="loky:1")
    superpoints_of_files(tmp_path / "parts", tmp_path / "out", engine="loky:1", overwrite=True)
    mine = tmp_path / "out" / "a.laz"
    if content == "corrected":
        corrected = laspy.read(mine)
        corrected.superpoint[:9] = 5
        corrected.write(mine)
    else:
        shutil.copy(cloud, mine) if content == "survey" else mine.write_text("by hand")
    before = mine.read_bytes()
    with pytest.raises(
        FileExistsError, match="out: holds more than files of an earlier result, or changed ones; choose another"
    ):
        superpoints_of_files(tmp_path / "parts", tmp_path / "out", engine="loky:1", overwrite=True)
    assert mine.read_bytes() == before


def test_a_file_that_is_there_twice_is_told(cloud, tmp_path):
    (tmp_path / "parts").mkdir()
    for name in ("a.laz", "b.laz"):
        shutil.copy(cloud, tmp_path / "parts" / name)
    with pytest.warns(UserWarning, match="parts: two files have the same box; are their points there twice"):
        superpoints_of_files(tmp_path / "parts", tmp_path / "out", engine="loky:1")


def test_degrees_without_a_coordinate_system_are_told(tmp_path):
    header = laspy.LasHeader(point_format=1, version="1.2")
    header.offsets, header.scales = [7, 48, 280], [1e-8, 1e-8, 0.001]
    degrees = laspy.LasData(header)
    degrees.xyz = town(2_000, 12) * [1e-5, 1e-5, 1] + [7.8, 48, 280]
    degrees.write(tmp_path / "a.las")
    with pytest.warns(UserWarning, match=r"a\.las: are x and y in degrees, z in metres\?"):
        superpoints_of_files(tmp_path / "a.las", tmp_path / "out.las")


def test_a_buffer_of_few_points_is_told(cloud, tmp_path):
    with pytest.warns(UserWarning, match=r"a buffer of 0\.1 m is little; below 0\.\d+ m .*: give a larger buffer"):
        superpoints_of_files(cloud, tmp_path / "out.laz", tile=4, buffer=0.1, engine="loky:1")


def test_many_tiles_are_told(cloud, tmp_path, monkeypatch):
    monkeypatch.setattr(tiles, "MANY", 3)
    with pytest.warns(UserWarning, match=r"\d+ tiles for \d+ points, each a .*: a larger tile, or none, is faster"):
        superpoints_of_files(cloud, tmp_path / "out.laz", tile=4, buffer=1, engine="loky:1")


def test_files_of_several_coordinate_systems_are_told(cloud, tmp_path):
    (tmp_path / "parts").mkdir()
    for name, code in (("a.las", 25832), ("b.las", 25833), ("c.las", None)):
        one = laspy.read(cloud)
        one.x = one.x + 20 * ord(name[0])
        one.header.vlrs.extract("WktCoordinateSystemVlr")
        if code is not None:
            text = f'PROJCS["UTM",GEOGCS["ETRS89"],AUTHORITY["EPSG","{code}"]]'
            one.header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(text))
        one.write(tmp_path / "parts" / name)
    with pytest.warns(UserWarning, match="parts: coordinates of EPSG:25832, EPSG:25833 are taken as those of one"):
        superpoints_of_files(tmp_path / "parts", tmp_path / "out", engine="loky:1")


@pytest.mark.filterwarnings("ignore:.*(feet|one system)")
def test_metres_and_feet_in_one_folder_are_an_error(cloud, tmp_path):
    (tmp_path / "parts").mkdir()
    for name, unit in (("a.las", ""), ("b.las", 'UNIT["US survey foot",0.3],')):
        one = laspy.read(cloud)
        one.header.vlrs.extract("WktCoordinateSystemVlr")
        text = f'PROJCS["A",GEOGCS["B"],{unit}AUTHORITY["EPSG","{2263 if unit else 25832}"]]'
        one.header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(text))
        one.write(tmp_path / "parts" / name)
    with pytest.raises(ValueError, match=r"b\.las: expected .* got feet; .*a\.las has none"):
        superpoints_of_files(tmp_path / "parts", tmp_path / "out", engine="loky:1")


def tiles_of(folder, moved):
    """The town as four files, `moved` to other places."""
    folder.mkdir()
    points = town(4_000, 10)
    for place, part in enumerate(points[points[:, 0].argsort()].reshape(4, -1, 3)):
        write_las(folder / f"{place}.las", moved(place, part))
    return [folder / f"{place}.las" for place in range(4)]


@pytest.mark.parametrize(
    ("moved", "message"),
    [
        (
            lambda place, part: part * (1000 if place == 2 else 1),
            r"2\.las: box and spacing of its points are about 1000 times",
        ),
        (
            lambda place, part: part * (1 if place == 1 else 1000),
            r"1\.las: .* are about 0\.001 times those of other files; has",
        ),
        (lambda place, part: part + 1e5 * (place > 1), r"1\.las and .*2\.las are 100 km apart; have they another unit"),
    ],
)
def test_a_file_of_another_unit_or_origin_is_told(tmp_path, moved, message):
    with pytest.warns(UserWarning, match=message):
        survey(tiles_of(tmp_path / "parts", moved))


@pytest.mark.parametrize(
    "moved",
    [
        lambda place, part: part[part[:, 0] < part[:, 0].min() + 0.01] if place == 0 else part * 200,  # a scrap
        lambda place, part: part[:3] * 1000 if place == 0 else part,  # few points
        lambda place, part: part + 100 * place,
    ],
)
def test_files_of_other_sizes_are_not_told(tmp_path, moved):
    survey(tiles_of(tmp_path / "parts", moved))


@pytest.mark.parametrize("other", ["old/b.LAZ", "b.ply"])
def test_files_in_folders_in_it_are_told(cloud, tmp_path, other):
    (tmp_path / "parts" / "old").mkdir(parents=True)
    for name in ("a.laz", other):
        shutil.copy(cloud, tmp_path / "parts" / name)
    with pytest.warns(
        UserWarning, match=rf"parts: only the \.las and \.laz files in it are read, .* such as .*{other}"
    ):
        superpoints_of_files(tmp_path / "parts", tmp_path / "out", engine="loky:1")


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("kind", ["file", "folder"])
def test_what_comes_meanwhile_stays(cloud, tmp_path, monkeypatch, kind, overwrite):
    given, out = (cloud, tmp_path / "out.laz") if kind == "file" else (tmp_path / "parts", tmp_path / "out")
    if kind == "folder":
        given.mkdir()
        shutil.copy(cloud, given)
    mine = out if kind == "file" else out / "mine.txt"
    if overwrite:
        superpoints_of_files(given, out, engine="loky:1")
    stitch_all = tiles._stitch

    def late(*arguments):
        out.mkdir(exist_ok=True) if kind == "folder" else None
        mine.write_text("by hand")
        return stitch_all(*arguments)

    monkeypatch.setattr(tiles, "_stitch", late)
    with pytest.raises(FileExistsError, match="was made or changed while this run worked, and is kept"):
        superpoints_of_files(given, out, engine="loky:1", overwrite=overwrite)
    assert mine.read_text() == "by hand"
    monkeypatch.undo()
    mine.unlink()
    made = superpoints_of_files(given, out, engine="loky:1", overwrite=True)  # goes on
    assert made.num_points == 8_000
    assert not (tmp_path / f"{out.name}.tiles").exists()


def test_a_cloud_that_changes_meanwhile(cloud, tmp_path, monkeypatch):
    """Labels are in the order of the points: with those of the file before they would be wrong in silence."""
    mine = shutil.copy(cloud, tmp_path / "mine.laz")
    write = tiles._write

    def late(*arguments):
        write_las(mine, town(8_000, 12, seed=1))
        write(*arguments)

    monkeypatch.setattr(tiles, "_write", late)
    with pytest.raises(ValueError, match=r"mine\.laz: changed while it was read; start again"):
        superpoints_of_files(mine, tmp_path / "out.laz", engine="loky:1")
    assert not (tmp_path / "out.laz").exists()


def test_another_cloud_with_the_time_of_the_first(cloud, tmp_path, monkeypatch):
    """A run that was killed does not go on with the tiles of the cloud before."""
    mine = shutil.copy(cloud, tmp_path / "mine.laz")

    def killed(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(tiles, "_segment", killed)
    cut = tmp_path / "out.laz.tiles" / "cut.npz"
    times = []
    for run_number in range(3):
        if run_number == 2:
            status = mine.stat()
            mine.write_bytes(mine.read_bytes())
            os.utime(mine, ns=(status.st_atime_ns, status.st_mtime_ns))
        with pytest.raises(KeyboardInterrupt):
            superpoints_of_files(mine, tmp_path / "out.laz", engine="loky:1")
        times.append(cut.stat().st_mtime_ns)
    assert times[0] == times[1] < times[2]


def test_an_earlier_result_comes_back_after_a_kill(cloud, tmp_path, monkeypatch):
    """The run was killed when the earlier folder had moved aside, and is not started again with the same tiles."""
    (tmp_path / "parts").mkdir()
    shutil.copy(cloud, tmp_path / "parts")
    out = tmp_path / "out"
    superpoints_of_files(tmp_path / "parts", out, engine="loky:1")
    before = (out / "town.laz").read_bytes()

    def killed(new, place, before, aside):
        place.rename(aside)
        raise KeyboardInterrupt

    monkeypatch.setattr(tiles, "put", killed)
    with pytest.raises(KeyboardInterrupt):
        superpoints_of_files(tmp_path / "parts", out, engine="loky:1", overwrite=True)
    assert not out.exists()
    monkeypatch.undo()
    with pytest.raises(FileExistsError, match="out: exists already"):
        superpoints_of_files(tmp_path / "parts", out, engine="loky:1", tile=7, buffer=1)
    assert (out / "town.laz").read_bytes() == before
    superpoints_of_files(tmp_path / "parts", out, engine="loky:1", tile=7, buffer=1, overwrite=True)
    assert [path.name for path in out.glob("[!.]*")] == ["town.laz"]


def test_a_folder_of_tiles_that_no_run_made_stays(cloud, tmp_path):
    work = tmp_path / "out.laz.tiles"
    work.mkdir()
    for name in ("source.txt", "photo.jpg"):
        (work / name).write_text("precious")
    with pytest.raises(FileExistsError, match=r"out\.laz\.tiles: expected the folder of an earlier run; move it"):
        superpoints_of_files(cloud, tmp_path / "out.laz")
    assert (work / "photo.jpg").read_text() == "precious"


def test_the_command(cloud, tmp_path, run, capsys):
    run("superpoints", cloud, "-o", tmp_path / "out.laz", "--tile", 7, "--engine", "loky:1", "--set", "scale=2")
    assert "8000 points in" in capsys.readouterr().out
    with pytest.raises(SystemExit, match=r"out\.laz: exists already"):
        run("superpoints", cloud, "-o", tmp_path / "out.laz")
    with pytest.raises(SystemExit, match="tile: expected at least 4 buffers"):
        run("superpoints", cloud, "-o", tmp_path / "other.laz", "--tile", 3, "--buffer", 1)
    with pytest.raises(SystemExit, match="COPC is read but not written"):
        run("superpoints", cloud, "-o", tmp_path / "other.copc.laz")
    with pytest.raises(SystemExit, match=r"out\.laz: expected no dimension superpoint, got one"):
        run("superpoints", tmp_path / "out.laz", "-o", tmp_path / "other.laz")
    with pytest.raises(SystemExit, match=r"--tile: expected a \.las or \.laz cloud and result"):
        run("superpoints", cloud, "-o", tmp_path / "out.npy", "--tile", 8)
    for unread in (("--viewpoint", 0, 0, 9), ("--columns", "xyz"), ("--set", "scale=2", "convex_factor=0.5")):
        with pytest.raises(SystemExit, match="expected no --viewpoint, --columns or convex_factor in tiles"):
            run("superpoints", cloud, "-o", tmp_path / "other.laz", *unread)
    assert {file.name for file in tmp_path.iterdir()} == {"out.laz"}


def test_copc_is_read_and_its_result_is_not_named_so(tmp_path):
    """The octree goes, the order of the points and the coordinate system stay; laspy takes the result for LAZ."""
    folder, expected = tmp_path / "parts", write_las(tmp_path / "town.las", town(4_000, 9))
    folder.mkdir()
    write_copc(folder / "town.copc.laz", laspy.read(expected))
    superpoints_of_files(expected, tmp_path / "one.las", engine="loky:1")
    superpoints_of_files(folder, tmp_path / "out", engine="loky:1")
    assert [file.name for file in (tmp_path / "out").glob("[!.]*")] == ["town.laz"]
    assert torch.equal(labels_of(tmp_path / "out" / "town.laz"), labels_of(tmp_path / "one.las"))
    made = laspy.read(tmp_path / "out" / "town.laz")
    assert not {"copc"} & {record.user_id for record in (*made.vlrs, *made.evlrs)}
    assert made.vlrs.get("WktCoordinateSystemVlr")
    assert len(tj.load_scene(folder / "town.copc.laz").points) == 4_000
    write_las(folder / "town.laz", town(4_000, 9))
    with pytest.raises(ValueError, match=r"a \.laz and a \.copc\.laz would both become town\.laz"):
        superpoints_of_files(folder, tmp_path / "other", engine="loky:1")


def tile_labels(shared, own=None, cut_off=()):
    """What a tile says, from dictionaries of points and their superpoints; some of these go on beyond the buffer."""
    own = shared if own is None else own
    arrays = [
        (np.array(sorted(labels), np.int64), np.array([labels[point] for point in sorted(labels)], np.int32))
        for labels in (own, shared)
    ]
    size = np.bincount(list((own | shared).values())).astype(np.int32)
    size[[superpoint for superpoint in cut_off if superpoint < len(size)]] = 0
    is_own = np.array([point in own for point in sorted(shared)], bool)
    return OwnLabels(*arrays[0]), SharedLabels(*arrays[1], is_own, size)


def stitched(neighbors, tiles_labels, num_points):
    """The labels of the points 0, 1, ..."""
    labels = np.full(num_points, 99)
    counts = [len(shared.whole_size) for _, shared in tiles_labels]
    own, shared = (lambda tile: tiles_labels[tile][0]), (lambda tile: tiles_labels[tile][1])
    assert stitch(neighbors, counts, own, shared, labels) == len(set(labels))
    return labels.tolist()


def test_superpoints_match_by_the_majority_of_both():
    one = tile_labels({0: 0, 1: 0, 2: 0, 3: 1, 4: 1, 5: 1, 6: 2})[1]
    other = tile_labels({0: 5, 1: 5, 2: 6, 3: 6, 4: 6, 5: 7, 9: 8})[1]
    # 0 and 5 share 2 of 3 and 2 points; 1 and 6 share 2 of 3 and 3; 2 and 8 have no common point; 7 is less than half
    assert matching_superpoints(one, other).tolist() == [[0, 5], [1, 6]]
    # A large superpoint is not united with each of many small ones, nor by one point in a hundred.
    large, small = (tile_labels({point: point // size for point in range(100)})[1] for size in (100, 20))
    assert len(matching_superpoints(large, small)) == 0
    assert len(matching_superpoints(tile_labels({0: 0})[1], tile_labels({1: 0})[1])) == 0


def test_what_a_tile_sees_in_its_buffer_alone_unites_nothing():
    """Tile 1 sees points of tile 0 and of tile 2 as one superpoint: that counts only if it has points of its own."""
    first, middle, last = (dict.fromkeys(points, 0) for points in (range(10), range(5, 15), range(10, 20)))
    for own, expected in (({}, [0] * 10 + [1] * 10), ({20: 0}, [0] * 21)):
        tiles_labels = [
            tile_labels(dict.fromkeys(range(5, 10), 0), first, [0]),
            tile_labels(middle, own, [0]),
            tile_labels(dict.fromkeys(range(10, 15), 0), last, [0]),
        ]
        assert stitched([(0, 1), (1, 2)], tiles_labels, len(expected)) == expected


def test_a_superpoint_that_a_tile_sees_whole_is_not_cut():
    """Points 0-49 are of tile 0, the others of tile 1. One tile sees a street, the other a thing on it, too."""
    street = dict.fromkeys(range(100), 0)
    for thing in (range(46, 58), range(40, 52), range(60, 72)):
        with_thing = street | dict.fromkeys(thing, 1)
        for seen in ([with_thing, street], [street, with_thing]):
            for cut_off, expected in (([0], with_thing), ([], street), ([0, 1], None)):
                tiles_labels = [
                    tile_labels(labels, {point: labels[point] for point in range(50 * tile, 50 * tile + 50)}, cut_off)
                    for tile, labels in enumerate(seen)
                ]
                # The street goes on beyond the buffers; it ends, and is the larger; both go on: the owner decides.
                own = {point: seen[point // 50][point] for point in range(100)}
                expected = own if expected is None else expected
                assert stitched([(0, 1)], tiles_labels, 100) == [expected[point] for point in range(100)], thing


def test_the_choice_among_many_tiles(monkeypatch):
    """Against the rule, point by point; without partners, such that each tile's superpoints stay apart."""
    none = np.empty((0, 2), np.int64)
    monkeypatch.setattr("torchjoint.tiles.stitching.matching_superpoints", lambda one, other: none)
    rng = np.random.default_rng(0)
    for _ in range(20):
        seen = rng.random((3, 60)) < 0.7
        owner = np.array([rng.choice(np.flatnonzero(row)) if row.any() else 0 for row in seen.T])
        seen[owner, np.arange(60)] = True
        superpoint = rng.integers(0, 12, (3, 60))
        superpoint[:, :12] = np.arange(12)  # all are there
        seen[:, :12] = True
        shared = seen.sum(0) > 1
        tiles_labels, chosen = [], []
        for tile in range(3):
            own = {int(point): superpoint[tile, point] for point in np.flatnonzero(owner == tile)}
            both = {int(point): superpoint[tile, point] for point in np.flatnonzero(seen[tile] & shared)}
            tiles_labels.append(tile_labels(both, own, np.flatnonzero(rng.random(12) < 0.4)))
        for point in range(60):
            sizes = {tile: tiles_labels[tile][1].whole_size[superpoint[tile, point]] for tile in range(3)}
            order = [owner[point], *(tile for tile in range(3) if seen[tile, point] and tile != owner[point])]
            best = max(order, key=sizes.get)  # the first of equal ones
            chosen.append((best, superpoint[best, point]))
        labels = stitched([(0, 1), (0, 2), (1, 2)], tiles_labels, 60)
        assert labels == [list(dict.fromkeys(chosen)).index(one) for one in chosen]


def test_a_tile_tells_which_superpoints_may_go_on(tmp_path):
    """Three squares on a tile of 2 x 1 m with a buffer of 1 m: inside, into the buffer, and to its end."""
    grid = torch.cartesian_prod(torch.arange(0, 0.5, 0.05), torch.arange(0, 0.5, 0.05), torch.zeros(1))
    corners = torch.tensor([[0.2, 0.2, 0.0], [2.3, 0.2, 0.0], [0.2, -0.95, 0.0]])
    records = np.zeros(3 * len(grid), point_type(False))
    records["number"], records["kind"] = np.arange(len(records)), OWN | SHARED
    records["xyz"] = (corners[:, None] + grid).reshape(-1, 3)
    records["kind"][records["xyz"][:, 1] < -0.9] |= AT_RIM
    records.tofile(tmp_path / "one.points")
    task = TileTask(tmp_path / "one.points", tmp_path / "one.npz", zlib.crc32(records.data))
    segment_tile(None, SuperpointsConfig(), task)
    assert read_shared(task.labels, task.checksum).whole_size.tolist() == [len(grid), len(grid), 0]
    assert not task.points.exists()


@pytest.mark.parametrize("box", [(0.0, 0.0), (float("nan"), 0.0), (-1e300, 1e300), (1e6, 1e6 + 1)])
def test_a_header_whose_box_is_wrong(cloud, tmp_path, box):
    """The points were all in one cell of 1 mm: no tile could be cut, and float32 rounded them by half a metre."""
    content = bytearray(cloud.read_bytes())
    struct.pack_into("<6d", content, 179, *(3 * box[::-1]))
    (tmp_path / "a.laz").write_bytes(content)
    for name, path in (("whole", cloud), ("wrong", tmp_path / "a.laz")):
        superpoints_of_files(path, tmp_path / f"{name}.las", tile=7, buffer=1, engine="loky:1")
    assert torch.equal(labels_of(tmp_path / "wrong.las"), labels_of(tmp_path / "whole.las"))


@pytest.mark.parametrize(("byte", "kind"), [(131, "scale"), (155, "offset"), (179, "box")])
def test_a_header_with_huge_numbers(tmp_path, byte, kind):
    """Points at 1e300 were one superpoint, in silence; a box of 1e300 was an error that named no file."""
    path = write_las(tmp_path / "a.las", town(500, 12))
    content = bytearray(path.read_bytes())
    struct.pack_into("<d", content, byte, 1e300)
    path.write_bytes(content)
    refused = pytest.raises(ValueError, match=r"a\.las: expected coordinates up to 1e\+12, got")
    with nullcontext() if kind == "box" else refused:
        assert superpoints_of_files(path, tmp_path / "out.las", engine="loky:1").num_points == 500


def test_a_point_that_is_alone_in_its_tile(tmp_path):
    """A bird: a record of one point has gaps that NumPy does not see, and torch refuses."""
    write_las(tmp_path / "town.laz", np.concatenate([town(2_000, 12), [[300.0, 5.0, 80.0]]]))
    made = superpoints_of_files(tmp_path / "town.laz", tmp_path / "out.laz", tile=50, engine="loky:1")
    assert (made.num_points, made.num_tiles) == (2_001, 2)


def test_beams_without_return_are_one_superpoint(tmp_path):
    near = laspy.create()  # in coordinates of a LiDAR, or of a project: the corner of the first tile is (0, 0, 0)
    near.xyz = np.concatenate([np.zeros((50, 3)), abs(town(2_000, 12))])
    near.write(tmp_path / "town.laz")
    with pytest.warns(UserWarning, match="beams without return"):
        superpoints_of_files(tmp_path / "town.laz", tmp_path / "out.laz", engine="loky:1")
    beams, others = labels_of(tmp_path / "out.laz").tensor_split([50])
    assert len(beams.unique()) == 1
    assert beams[0] not in others


@pytest.mark.parametrize("tile", [1e-12, 1e-3, 1e9, 1e300])
def test_a_tile_whose_grid_would_fill_the_memory(cloud, tmp_path, tile):
    with pytest.raises(ValueError, match=r"tile: .* m: expected at most 128000000 cells"):
        superpoints_of_files(cloud, tmp_path / "out.laz", tile=tile)


def test_a_buffer_beyond_the_cloud_is_all_of_it(cloud, tmp_path):
    counts = [superpoints_of_files(cloud, tmp_path / f"{one}.laz", buffer=one)[1] for one in (100.0, 1e300)]
    assert counts[0] == counts[1]


@pytest.mark.parametrize("size", [None, 20.0])
def test_tiles_partition_the_plane_and_fit_the_memory(size):
    counts = np.random.default_rng(0).integers(0, 50, (60, 40)) ** 2 // 20
    counts[:, 20:25] = 0
    survey = Survey(int(counts.sum()), np.zeros(3), 1.0, counts, None)
    plan = plan_tiles(survey, size, 1.0, 3_000)
    held = np.zeros_like(counts)
    for number, tile in enumerate(plan.tiles):
        (x0, y0), (x1, y1) = tile
        held[x0:x1, y0:y1] += 1
        assert (plan.of_cell[x0:x1, y0:y1] == number).all()
        rim = counts[max(x0 - 1, 0) : x1 + 1, max(y0 - 1, 0) : y1 + 1].sum()
        assert rim <= 3_000 or min(x1 - x0, y1 - y0) < 2 * NARROWEST
        assert counts[x0:x1, y0:y1].sum() > 0
    assert ((held == 1) | (counts == 0)).all()
    for one, other in plan.neighbors(survey):
        assert one < other


def test_each_tile_gets_the_points_within_its_buffer():
    """Against the distance of each point to each rectangle; cells without points belong to no tile."""
    rng = np.random.default_rng(0)
    counts = rng.integers(1, 50, (30, 20))
    counts[5:9, :12] = 0
    survey = Survey(int(counts.sum()), np.array([3.0, -2.0, 0.0]), 0.5, counts, None)
    plan = plan_tiles(survey, 5.0, 1.1, 10_000)
    xy = survey.origin[:2] + rng.uniform(0, 1, (3_000, 2)) * np.array(counts.shape) * survey.side
    xy = xy[plan.of_cell[tuple(survey.cells(xy).T)] >= 0]
    row, tile, kind = _copies(xy, survey, plan, _cells_of_one_tile(survey, plan))
    low, high = (survey.origin[:2] + survey.side * np.array(ends) for ends in zip(*plan.tiles, strict=True))
    outside = np.maximum(np.maximum(low - xy[:, None], xy[:, None] - high), 0).max(2)  # [n, tiles] metres
    near, own = outside <= plan.buffer, outside == 0
    assert [row.tolist(), tile.tolist()] == [part.tolist() for part in np.nonzero(near.T)[::-1]]
    assert (((kind & OWN) > 0) == own[row, tile]).all()
    assert (((kind & SHARED) > 0) == (near.sum(1) > 1)[row]).all()


def test_points_of_a_tile_and_those_at_its_rim(cloud, tmp_path):
    """Against the distance of each point to the rectangle of its tile; coordinates are those of the file."""
    found = survey([cloud], 7.0)
    plan = plan_tiles(found, 7.0, 1.0003, 100_000)  # no point of whole millimetres is on the line
    split_points([cloud], found, plan, tmp_path, lambda count: None)
    xyz = laspy.read(cloud).xyz
    for number, tile in enumerate(plan.tiles):
        records = np.fromfile(tile_file(tmp_path, number), point_type(found.whites is not None))
        assert (records["xyz"] == xyz[records["number"]]).all()
        low, high = (found.origin[:2] + found.side * np.array(end) for end in tile)
        outside = np.maximum(low - records["xyz"][:, :2], records["xyz"][:, :2] - high).max(1)
        assert (((records["kind"] & AT_RIM) > 0) == (outside > 0.90027)).all()
        assert (outside > 0.90027).any()


def test_one_tile_of_points_on_a_grid(tmp_path):
    """Neighbours at equal distances are chosen by the last bit, which float32 had changed: other superpoints."""
    grid = np.stack(np.meshgrid(np.arange(60), np.arange(60)), -1).reshape(-1, 2) * 0.0137
    las = laspy.create(point_format=3)
    las.header.scales, las.header.offsets = [1e-4] * 3, [452000.0317, 5411000.0, 0.0]
    las.x, las.y = np.add(grid, (452310.1231, 5411220.4567)).T
    las.z = np.floor(np.sin(grid[:, 0] * 9) * 20) / 100
    las.write(tmp_path / "grid.las")
    superpoints_of_files(tmp_path / "grid.las", tmp_path / "out.las")
    expected = tj.superpoints(torch.from_numpy(laspy.read(tmp_path / "grid.las").xyz.copy()))
    assert torch.equal(labels_of(tmp_path / "out.las"), expected)


@pytest.mark.slow
def test_processes_and_many_tiles(tmp_path):
    """25 tiles in one and in two processes: the same bytes, and nearly the labels of one piece."""
    points = town(120_000, 50)
    cloud = write_las(tmp_path / "town.laz", points)
    superpoints_of_files(cloud, tmp_path / "one.las", tile=10, buffer=1.5, engine="loky:1")
    superpoints_of_files(cloud, tmp_path / "two.las", tile=10, buffer=1.5, engine="loky:2")
    assert (tmp_path / "one.las").read_bytes() == (tmp_path / "two.las").read_bytes()
    whole, labels = tj.superpoints(torch.from_numpy(laspy.read(cloud).xyz.copy())), labels_of(tmp_path / "one.las")
    assert segmentation_covering(labels, whole).symmetric > 0.98


def test_odd_colours_and_normals_are_told_of_tiles_too(tmp_path):
    las = laspy.create(point_format=7, file_version="1.4")
    las.add_extra_dim(laspy.ExtraBytesParams("NormalX", "f4"))
    las.x, las.y, las.z = np.asarray(town(3000, 20)).T[:3]
    las.red = las.green = las.blue = np.linspace(0, 4095, len(las.x)).astype(np.uint16)
    las.write(tmp_path / "a.las")
    bits = pytest.warns(UserWarning, match=r"colours are at most 4095 of 65535, and .*: are they of 12 bits\?")
    with bits, pytest.warns(UserWarning, match=r"a\.las: NormalX: not used in tiles; -o OUT\.npy uses them"):
        superpoints_of_files(tmp_path / "a.las", tmp_path / "b.las")
