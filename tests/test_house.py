"""The picture of the floors is that of the imports."""

from __future__ import annotations

from xml.etree import ElementTree

from tests import house


def test_the_picture_is_up_to_date() -> None:
    assert house.PICTURE.read_text(encoding="utf-8") == house.drawn(), "python -m tests.house draws it anew"


def test_floors() -> None:
    rows = house.floors()
    where = {room: level for level, row in enumerate(rows) for rooms in row for room in rooms}
    assert where["errors"] == 0 and where["apps"] == len(rows) - 1
    assert where["skinning"] < where["passes"] < where["renderer"] < where["evaluate"]
    assert where["splats"] < where["formats"]
    names = [text.text for text in ElementTree.fromstring(house.drawn()).iter() if text.tag.endswith("text")]
    assert sorted(map(str, names)) == sorted(where)
