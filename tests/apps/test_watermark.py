"""``glsplat watermark detect`` on clips and pictures, and what ``glsplat serve`` makes of --watermark."""

from __future__ import annotations

import json
import logging
import re
import stat

import cv2
import numpy as np
import pytest

from apps import cli
from apps.clip import Clip
from apps.serve import command as serve
from apps.serve import keys
from apps.serve.keys import watermark_of
from glsplat.errors import GlsplatError
from glsplat.extras.watermark.keys import WATERMARK, kept_watermark, text_of
from glsplat.extras.watermark.mark import Watermark, WatermarkKey, marked
from glsplat.net.guard.state_dir import state_folder
from tests.apps.cli import mistake, serving

OWNER = WatermarkKey(0x1A2B, b"sixteen bytes 01")


@pytest.fixture
def pictures():
    """[8, 200, 240, 3] a grey slope under the mark of session 00c0ffee."""
    image = np.zeros((200, 240, 4), np.float32)
    image[..., :3] = np.linspace(0.2, 0.8, 240)[None, :, None]
    image[..., 3] = 1
    image = marked(image, Watermark(OWNER.server, 0xC0FFEE, OWNER.key))
    return np.repeat(np.round(image[None, ..., :3] * 255).astype(np.uint8), 8, axis=0)


@pytest.fixture
def key(tmp_path):
    path = tmp_path / "key"
    path.write_text(text_of(OWNER))
    path.chmod(0o600)
    return path


def detect(*words):
    return cli.main(["watermark", "detect", *map(str, words)])


@pytest.mark.extra(name="authoring")  # the command needs it
def test_a_clip_leads_to_its_session(tmp_path, pictures, key, capsys):
    picture = tmp_path / "a.png"
    cv2.imwrite(str(picture), pictures[0])
    leaked = tmp_path / "leaked.webm"
    with Clip(leaked, 30) as clip:
        for one in pictures:
            clip.add(one)
    assert "give one clip at a time" in mistake(capsys, "watermark", "detect", leaked, picture, "--key", key)
    assert detect(leaked, "--key", key, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told.pop("chance") <= 1e-6 and told.pop("scale") == pytest.approx(1, abs=0.01)
    assert told == {"found": True, "server": "1a2b", "session": "00c0ffee", "pictures": 8, "seen": 8}


@pytest.mark.check
def test_pictures_do_too_by_the_key_that_serve_keeps(tmp_path, pictures, state, capsys):
    (state_folder() / WATERMARK).write_text(text_of(OWNER))
    names = [tmp_path / f"{i}.png" for i in range(2)]
    for name, picture in zip(names, pictures, strict=False):
        cv2.imwrite(str(name), picture[..., ::-1])
    assert detect(*names) == 0
    line = capsys.readouterr().out
    assert re.fullmatch(
        r"server 1a2b, session 00c0ffee \(false alarm: \de-\d\d\), in 2 pictures at scale 1\.00\d\n", line
    )
    (state_folder() / WATERMARK).write_text(text_of(WatermarkKey(1, b"sixteen bytes 02")))
    assert detect(*names) == 1 and capsys.readouterr().out == "no mark of this key in 2 pictures\n"
    assert detect(*names, "--json") == 1
    assert json.loads(capsys.readouterr().out) == {"found": False, "seen": 2}


def test_serve_marks_unless_told_otherwise(state, key, caplog):
    assert watermark_of(serving("watermark=off")) is None and not state.exists()
    made = watermark_of(serving())
    file = state / "glsplat" / WATERMARK
    assert stat.S_IMODE(file.stat().st_mode) == 0o600 and not caplog.records
    assert made == watermark_of(serving("watermark=on")) == kept_watermark(state_folder())
    assert watermark_of(serving(f"watermark={key}")) == OWNER != made
    config = serve.server_config(serving(), watermark=OWNER)
    assert config.session.watermark == OWNER and serve.server_config(serving()).session.watermark is None


def test_serve_goes_on_unmarked_where_nothing_can_be_kept(tmp_path, monkeypatch, caplog):
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv("XDG_STATE_HOME", str(blocked))
    with caplog.at_level(logging.WARNING):
        assert watermark_of(serving()) is None
    (line,) = [record.getMessage() for record in caplog.records]
    assert line.startswith("pictures are not marked: ") and line.endswith("or set watermark to off")
    with pytest.raises(GlsplatError, match="cannot be made"):
        watermark_of(serving("watermark=on"))


def test_serve_goes_on_unmarked_without_the_extra(state, monkeypatch, caplog):
    monkeypatch.setattr(keys, "has_extra", lambda name: False)
    with caplog.at_level(logging.WARNING):
        assert watermark_of(serving()) is None
    (line,) = [record.getMessage() for record in caplog.records]
    assert line.startswith("pictures are not marked: ") and "glsplat.extras.watermark" in line
