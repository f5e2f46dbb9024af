"""Mutated files of the formats of extras: they load, or raise FormatError; nothing else."""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glsplat.formats import load, save
from tests.formats.scenes import load_spz, random_splats
from tests.formats.test_fuzz import fuzz, only_format_errors, seeds


@fuzz
@given(data=st.data())
def test_mutated_spz(tmp_path: Path, data: st.DataObject) -> None:
    """Headers and tables above all, and what is inside the gzip stream."""
    whole, streams = (next(s for s in seeds() if s[:4] == b"NGSP" and s[4] == version) for version in (3, 4))
    content = bytearray(data.draw(st.sampled_from([whole, streams])))
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(4, 140))
        some = data.draw(st.sampled_from([b"\0", b"\1", b"\4", b"\x7f", b"\xff", b"\xff\xff\xff", b"\0\0\0\x01"]))
        content[at : at + len(some)] = some
    del content[data.draw(st.integers(0, len(content))) if data.draw(st.booleans()) else len(content) :]
    content += bytes(data.draw(st.sampled_from([0, 0, 1, 5000])))
    for packed in (content, gzip.compress(content), gzip.compress(content) + bytes(3), gzip.compress(content)[:-5]):
        (tmp_path / "fuzz.spz").write_bytes(packed)
        only_format_errors(tmp_path / "fuzz.spz", load)
        only_format_errors(tmp_path / "fuzz.spz", load_spz)


@pytest.mark.filterwarnings("error")
def test_nans_that_signal(tmp_path: Path) -> None:
    """Casting one to float64 warns."""
    signals = b"\1\0\x80\x7f"
    save(random_splats(6, 1), tmp_path / "a.compressed.ply")
    head, body = (tmp_path / "a.compressed.ply").read_bytes().split(b"end_header\n")
    (tmp_path / "a.compressed.ply").write_bytes(head + b"end_header\n" + signals * 18 + body[72:])
    only_format_errors(tmp_path / "a.compressed.ply", load)
