"""The code word: what comes back, through how much noise, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.errors import GlsplatError
from glsplat.extras.watermark.code import CODE_BITS, Payload, decode, encode
from glsplat.extras.watermark.keys import new_watermark, read_watermark, text_of
from glsplat.extras.watermark.mark import Watermark, WatermarkKey

KEY = b"sixteen bytes 01"


def test_a_word_comes_back() -> None:
    for ids in ((0, 0), (0xFFFF, 0xFFFFFFFF), (0x1A2B, 0x00C0FFEE)):
        word = encode(Payload(*ids))
        assert word.shape == (CODE_BITS,) and set(np.unique(word)) <= {-1.0, 1.0}
        assert decode(0.01 * word) == Payload(*ids)


def test_the_word_of_a_payload_stays_what_it_is() -> None:
    """Pictures that were marked by earlier versions are read."""
    signs = int("".join("01"[int(value < 0)] for value in encode(Payload(0x9D31, 0x4E6F2A55))), 2)
    assert signs == 0x920C660948EAD03A3ED856DC971ACFCBD1FD6549F6616B90ACC4F7B6F79E86F6


def test_errors_are_corrected_and_noise_is_refused(rng: np.random.Generator) -> None:
    """At 3 dB a bit, where one sign in six arrives wrong, every word of 30 is read."""
    deviation, wrong, read = np.sqrt(4 / (2 * 10**0.3)), 0.0, 0
    for _ in range(30):
        payload = Payload(int(rng.integers(1 << 16)), int(rng.integers(1 << 32)))
        word = encode(payload)
        received = word + deviation * rng.normal(size=CODE_BITS)
        wrong += float((np.sign(received) != word).mean()) / 30
        read += decode(received) == payload
    assert 0.12 < wrong < 0.2 and read == 30
    assert not any(decode(rng.normal(size=CODE_BITS)) for _ in range(50))  # one in 65,536 would be right


def test_a_mark_is_checked() -> None:
    for words, message in (
        ((1 << 16, 0, KEY), "server is a whole number of 16 bits"),
        ((0, -1, KEY), "session is a whole number of 32 bits"),
        ((True, 0, KEY), "server is a whole number"),
        ((0, 0, KEY[:-1]), "key is at least 16 bytes, not 15"),
        ((0, 0, KEY.hex()), "key is at least 16 bytes, not str"),
    ):
        with pytest.raises(GlsplatError, match=message):
            Watermark(*words)


def test_the_key_file(tmp_path) -> None:
    made = new_watermark()
    path = tmp_path / "watermark"
    path.write_text(text_of(made))
    assert read_watermark(path) == made and made.key.hex() not in repr(made) and made != new_watermark()
    assert made.new_mark().session != made.new_mark().session
    for text in ("", "1a2b", "1a2b " + KEY[:-1].hex(), "12345 " + KEY.hex(), "1a2b nothex", "1a2b é"):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(GlsplatError, match=f"{path}: a watermark's key file is one line"):
            read_watermark(path)
    with pytest.raises(GlsplatError, match="nothing: cannot read the watermark's key"):
        read_watermark(tmp_path / "nothing")
    with pytest.raises(GlsplatError, match="16 bits"):
        WatermarkKey(1 << 16, KEY)
