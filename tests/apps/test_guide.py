"""``glsplat avatar guide``: the sheet is drawn, the same every time, with a person in every picture of it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from apps.cli import main


@pytest.mark.check
@pytest.mark.gl
def test_the_guide_is_drawn_and_the_same_every_time(tmp_path, capsys) -> None:
    for name in ("a.png", "b.png"):
        assert main(["avatar", "guide", "-o", str(tmp_path / name)]) == 0
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert capsys.readouterr().out.startswith(f"{tmp_path}/a.png: how to take the photograph, 1600 x 1180 pixels\n")
    sheet = cv2.imread(str(tmp_path / "a.png"))[..., ::-1].astype(int)
    shirt = (sheet[..., 2] - sheet[..., 0] > 60) & (sheet[..., 2] > 110)  # the embedded person wears blue
    small = [(680 + 178 * k, 744, 852 + 178 * k, 1006) for k in range(5)]
    for x0, y0, x1, y1 in ((40, 100, 640, 960), (1200, 200, 1564, 640), *small):
        assert shirt[y0:y1, x0:x1].sum() > 150
    assert (sheet[744:1006, 1036:1208][:2] == sheet[744, 1120]).all(axis=-1).mean() < 1  # "cut off": the head is
    assert np.ptp(sheet[1010:1080, 680:1560]) > 100  # words below
