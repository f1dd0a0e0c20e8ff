"""LAS: the code of a survey's coordinate system."""

import laspy
import pytest
from laspy.vlrs.known import GeoKeyDirectoryVlr, GeoKeyEntryStruct, WktCoordinateSystemVlr

from torchjoint.datasets.files.las import epsg_of

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
    cloud = laspy.LasData(laspy.LasHeader(point_format=3))
    cloud.x = cloud.y = cloud.z = [0.0, 1, 2]
    cloud.header.vlrs.extend([] if record is None else [record])
    cloud.write(tmp_path / "a.las")
    assert epsg_of(tmp_path / "a.las") == code
