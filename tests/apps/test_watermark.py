"""``glsplat watermark detect`` on clips and pictures, and what ``glsplat serve`` makes of --watermark."""

from __future__ import annotations

import argparse
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
from apps.serve.keys import watermark_of
from glsplat.errors import GlsplatError
from glsplat.net.guard.kept import WATERMARK, kept_watermark, state_folder
from glsplat.watermark.keys import text_of
from glsplat.watermark.mark import Watermark, WatermarkKey, marked

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
    return path


def detect(*words):
    return cli.main(["watermark", "detect", *map(str, words)])


def test_a_clip_leads_to_its_session(tmp_path, pictures, key, capsys):
    with Clip(tmp_path / "leaked.webm", 30) as clip:
        for picture in pictures:
            clip.add(picture)
    assert detect(tmp_path / "leaked.webm", "--key", key, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told.pop("chance") <= 1e-6 and told.pop("scale") == pytest.approx(1, abs=0.01)
    assert told == {"found": True, "server": "1a2b", "session": "00c0ffee", "pictures": 8, "seen": 8}


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


def test_what_cannot_be_searched(tmp_path, pictures, key, state, capsys):
    picture, text, clip = tmp_path / "a.png", tmp_path / "a.txt", tmp_path / "a.webm"
    cv2.imwrite(str(picture), pictures[0])
    text.write_text("no picture")
    with Clip(clip, 30) as out:
        out.add(pictures[0])
    for words, code, message in (
        ([picture], 1, f"{state}/glsplat/watermark: cannot read the watermark's key (No such file or directory)"),
        ([tmp_path / "none.png", "--key", key], 1, "none.png"),
        ([text, "--key", key], 1, f"{text}: expected a clip, or a picture"),
        ([clip, picture, "--key", key], 2, "give one clip at a time"),
        ([picture, "--key", key, "--window", "0"], 2, "--window needs at least 1 picture"),
    ):
        assert detect(*words) == code
        err = capsys.readouterr().err
        assert err.startswith("glsplat watermark: ") and message in err and err.count("\n") == 1


def arguments(*words):
    parser = argparse.ArgumentParser()
    serve.add_arguments(parser)
    return parser.parse_args(list(map(str, words)))


def test_serve_marks_unless_told_otherwise(state, key, caplog):
    assert watermark_of(arguments("--watermark", "off")) is None and not state.exists()
    made = watermark_of(arguments())
    file = state / "glsplat" / WATERMARK
    assert stat.S_IMODE(file.stat().st_mode) == 0o600 and not caplog.records
    assert made == watermark_of(arguments("--watermark", "on")) == kept_watermark(state_folder())
    assert watermark_of(arguments("--watermark", key)) == OWNER != made
    config = serve.server_config(arguments(), watermark=OWNER)
    assert config.session.watermark == OWNER and serve.server_config(arguments()).session.watermark is None


def test_serve_goes_on_unmarked_where_nothing_can_be_kept(tmp_path, monkeypatch, caplog):
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv("XDG_STATE_HOME", str(blocked))
    with caplog.at_level(logging.WARNING):
        assert watermark_of(arguments()) is None
    (line,) = [record.getMessage() for record in caplog.records]
    assert line.startswith("pictures are not marked: ") and line.endswith("or say --watermark off")
    with pytest.raises(GlsplatError, match="cannot be made"):
        watermark_of(arguments("--watermark", "on"))
