"""LAS: the code of a survey's coordinate system."""

import multiprocessing
import warnings

import laspy
import numpy as np
import pytest
import torch
from laspy.vlrs.known import GeoKeyDirectoryVlr, GeoKeyEntryStruct, WktCoordinateSystemVlr

from torchjoint.datasets.files.clouds import read_cloud_file, up_of
from torchjoint.datasets.files.las import epsg_of, read_las
from torchjoint.results.labelled_file import write_labelled
from torchjoint.tiles.plan import _bounds

UTM = 'PROJCS["UTM 32N",GEOGCS["WGS 84",AUTHORITY["EPSG","4326"]],UNIT["metre",1,AUTHORITY["EPSG","9001"]]'
HEIGHT = 'VERT_CS["DHHN2016",AUTHORITY["EPSG","7837"]]'


def keys(**values):
    record = GeoKeyDirectoryVlr()
    record.geo_keys = [GeoKeyEntryStruct(id=int(key[1:]), count=1, value_offset=value) for key, value in values.items()]
    return record


@pytest.mark.parametrize(
    ("record", "code"),
    [
        (WktCoordinateSystemVlr(f'{UTM},AUTHORITY["EPSG","32632"]]'), 32632),
        (WktCoordinateSystemVlr(f'COMPD_CS["both",{UTM},AUTHORITY["EPSG","25832"]],{HEIGHT}]'), 25832),
        # As pyproj writes EPSG:5555: only the whole has a code.
        (
            WktCoordinateSystemVlr(
                'COMPOUNDCRS["both",PROJCRS["UTM",LENGTHUNIT["metre",1]],VERTCRS["h"],ID["EPSG",5555]]'
            ),
            5555,
        ),
        (WktCoordinateSystemVlr(f'COMPD_CS["both",{UTM}],{HEIGHT}]'), None),
        (laspy.VLR("LASF_Projection", 2112, "", f'{UTM}, "ü",AUTHORITY["EPSG","32632"]]'.encode("latin-1")), 32632),
        (WktCoordinateSystemVlr('PROJCRS["UTM", CONVERSION["x",ID["EPSG",16032]], ID["EPSG", 32633]]\n'), 32633),
        (WktCoordinateSystemVlr('GEOGCS["WGS 84",AUTHORITY["EPSG","4326"]]'), 4326),
        (WktCoordinateSystemVlr(f"{UTM}]"), None),  # of its own; its parts have codes
        (keys(k1024=1, k3072=2056), 2056),
        (keys(k2048=4326), 4326),
        (keys(k3072=32767), None),
        (None, None),
    ],
)
def test_the_code_of_the_coordinate_system(tmp_path, record, code):
    file = las(tmp_path / "a.las", record)
    assert epsg_of(file) == code
    assert (None if code is None else [0, 0, 1]) == (None if (up := up_of(file)) is None else up.tolist())


def las(path, record):
    cloud = laspy.LasData(laspy.LasHeader(point_format=3))
    cloud.x = cloud.y = cloud.z = [0.0, 1, 2]
    cloud.header.vlrs.extend([] if record is None else [record])
    cloud.write(path)
    return path


@pytest.mark.parametrize(
    ("record", "is_told"),
    [
        (WktCoordinateSystemVlr('PROJCS["Texas",GEOGCS["NAD83"],UNIT["US survey foot",0.304800609601219]]'), True),
        (WktCoordinateSystemVlr(f'COMPD_CS["both",{UTM}],VERT_CS["NAVD88",UNIT["foot",0.3048]]]'), True),
        (WktCoordinateSystemVlr('PROJCS["Texas",GEOGCS["NAD83"],UNIT["ftUS",0.304800609601219]]'), True),
        (WktCoordinateSystemVlr('PROJCRS["of a plant",CS[Cartesian,2],LENGTHUNIT["millimetre", 0.001]]'), True),
        (keys(k1024=1, k3072=2277, k3076=9003), True),
        (keys(k1024=1, k3072=2263), True),  # by EPSG, of New York
        (keys(k1024=1, k3072=26743), True),  # of California, NAD27
        (keys(k1024=1, k3072=6418), True),  # of California, NAD83(2011)
        (keys(k1024=1, k3072=6417), False),  # the same in metres
        (keys(k1024=1, k3072=25832, k4096=6360), True),
        (keys(k1024=1, k3072=32632, k3076=9001, k4099=9003), True),  # only heights
        (keys(k1024=1, k3072=32767, k3076=1025), True),
        (WktCoordinateSystemVlr(f"{UTM}]"), False),
        (WktCoordinateSystemVlr('PROJCS["x", GEOGCS["y"], UNIT["Meter", 1.0]]'), False),
        (WktCoordinateSystemVlr('PROJCS["x",GEOGCS["y",UNIT["Degree",0.017453]],UNIT["Meter",1.0]]'), False),
        (WktCoordinateSystemVlr('PROJCRS["x",CS[Cartesian,2],ANGLEUNIT["degree",0.0174],LENGTHUNIT["m",1]]'), False),
        (keys(k1024=1, k3072=2056, k3076=9001, k4099=9001), False),
    ],
)
def test_lengths_that_are_no_metres(tmp_path, record, is_told):
    path = las(tmp_path / "a.las", record)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        read_las(path)
        _bounds([path])
    message = f"{path}: its coordinate system has feet or other units; taken as metres"
    assert [str(one.message) for one in told] == [message] * 2 * is_told


@pytest.mark.parametrize(
    "record",
    [
        WktCoordinateSystemVlr('GEOGCS["WGS 84",UNIT["degree",0.0174532925199433]]'),
        WktCoordinateSystemVlr(f'COMPD_CS["both", GEOGCS["WGS 84"],{HEIGHT}]'),
        keys(k1024=2, k2048=4326),
        keys(k1024=3, k2048=4978),  # z is not up
    ],
)
def test_degrees_are_an_error(tmp_path, record):
    path = las(tmp_path / "a.las", record)
    for read in (read_las, lambda one: _bounds([one])):
        with pytest.raises(ValueError, match=r"a\.las: expected coordinates in metres, got degrees, or geocentric"):
            read(path)


@pytest.mark.parametrize("points_of_header", [0, 3])
def test_a_file_without_chunks(tmp_path, points_of_header):
    """As a program leaves it that was stopped before it wrote points."""
    path = tmp_path / "a.laz"
    laspy.LasData(laspy.LasHeader(point_format=3, version="1.2")).write(path)
    data = bytearray(path.read_bytes())
    data[107:111] = points_of_header.to_bytes(4, "little")
    path.write_bytes(data)
    told = "3 points in its header, no chunks of points" if points_of_header else "no points"
    with pytest.raises(ValueError, match=rf"a\.laz: not a whole LAS file: .*{told}"):
        read_las(path)


def test_a_file_that_the_library_cannot_read(tmp_path):
    path = las(tmp_path / "a.laz", None)
    path.write_bytes(path.read_bytes().replace(b"laszip encoded", b"laszip unknown"))
    with pytest.raises(ValueError, match=r"a\.laz: .*: expected a header and points that laspy reads, got"):
        read_las(path)


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_a_wide_count_of_0_beside_the_narrow_one(tmp_path, suffix):
    cloud = laspy.LasData(laspy.LasHeader(point_format=3, version="1.4"))
    cloud.xyz = np.eye(3)
    cloud.write(tmp_path / f"a{suffix}")
    data = bytearray((tmp_path / f"a{suffix}").read_bytes())
    data[107:111], data[247:255] = (3).to_bytes(4, "little"), bytes(8)
    (tmp_path / f"a{suffix}").write_bytes(data)
    assert read_las(tmp_path / f"a{suffix}").points.tolist() == np.eye(3).tolist()


def test_a_chunk_of_more_points_than_memory_holds(tmp_path):
    """lazrs makes room for a whole chunk, and would abort."""
    cloud = laspy.LasData(laspy.LasHeader(point_format=3, version="1.2"))
    cloud.xyz = np.eye(3)
    cloud.write(tmp_path / "a.laz")
    data = (tmp_path / "a.laz").read_bytes()
    size = (50_000).to_bytes(4, "little")
    assert data.count(size) == 1
    (tmp_path / "a.laz").write_bytes(data.replace(size, b"\xfe\xff\xff\xff"))
    with pytest.raises(ValueError, match=r"a\.laz: not a whole LAS file: expected at most \d+ bytes when"):
        read_las(tmp_path / "a.laz")


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_process_reads_and_writes(tmp_path):
    """As a worker of a data loader: it lacks the threads that lazrs started in the process that it is forked from."""
    cloud = laspy.LasData(laspy.LasHeader(point_format=3, version="1.2"))
    cloud.xyz = np.arange(600_000).reshape(-1, 3) / 1000
    cloud.write(tmp_path / "a.laz")

    def copy(name):
        torch.set_num_threads(1)  # as a data loader does in its workers
        write_labelled(tmp_path / "a.laz", tmp_path / name, {"label": np.arange(200_000)})
        assert len(read_las(tmp_path / name).points) == 200_000

    copy("here.laz")
    worker = multiprocessing.get_context("fork").Process(target=copy, args=("there.laz",))
    worker.start()
    worker.join(60)
    worker.kill()
    assert worker.exitcode == 0
    assert (tmp_path / "here.laz").read_bytes() == (tmp_path / "there.laz").read_bytes()


def test_other_dimensions_are_said_to_stay_in_the_file(tmp_path):
    header = laspy.LasHeader(point_format=2)
    header.add_extra_dim(laspy.ExtraBytesParams("Amplitude", np.float32))
    cloud = laspy.LasData(header)
    cloud.xyz = np.eye(3)
    cloud.write(tmp_path / "a.laz")
    with pytest.warns(UserWarning, match="Amplitude: no .* names; kept by `label`, without effect"):
        read_cloud_file(tmp_path / "a.laz")
