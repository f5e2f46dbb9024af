"""``glsplat render --speech``: a mouth that moves with a sound, and a clip that has it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from apps.cli import main
from glsplat.formats import save
from glsplat.speech.sound import Sound, read_wav, wav_bytes
from tests.apps.cli import mistake
from tests.skinning.faces import expressive

SPOKEN = Path(__file__).parents[1] / "speech" / "data" / "balloon.wav"


@pytest.fixture
def face(tmp_path: Path) -> Path:
    save(expressive(300), tmp_path / "face.glb")
    return tmp_path / "face.glb"


def rendered(face: Path, *words: str) -> int:
    return main(["render", str(face), "--size", "48", "--fps", "10", *words])


@pytest.mark.gl
def test_a_clip_is_as_long_as_the_sound_and_has_it(
    face: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    av = pytest.importorskip("av")
    out = tmp_path / "a.mp4"
    assert rendered(face, "--speech", str(SPOKEN), "-o", str(out)) == 0
    assert "sound of FLAC" in capsys.readouterr().out
    with av.open(str(out)) as file:
        pictures = [frame.to_ndarray(format="rgb24").astype(int) for frame in file.decode(video=0)]
    with av.open(str(out)) as file:
        sound = np.concatenate([frame.to_ndarray().ravel() for frame in file.decode(audio=0)])
    spoken = read_wav(SPOKEN)
    assert len(pictures) == round(spoken.seconds * 10)
    assert np.array_equal(sound, np.rint(spoken.samples.astype(float) * 32767).astype(np.int16))
    assert max(np.abs(one - pictures[0]).max() for one in pictures) > 20, "the face moves"


@pytest.mark.gl
def test_silence_moves_nothing_and_an_expression_stays(
    face: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "quiet.wav").write_bytes(wav_bytes(Sound(np.zeros(8000, np.float32), 16000)))
    for words in ([], ["--expression", "eyeBlinkLeft=1"]):
        out = tmp_path / f"{len(words)}"
        assert rendered(face, "--speech", str(tmp_path / "quiet.wav"), *words, "-o", f"{out}/") == 0
        files = [path.read_bytes() for path in sorted(out.iterdir())]
        assert len(files) == 5 and len(set(files)) == 1
    assert (tmp_path / "0" / "00000.png").read_bytes() != (tmp_path / "2" / "00000.png").read_bytes()
    assert rendered(face, "--speech", str(tmp_path / "quiet.wav"), "-o", str(tmp_path / "a.webm")) == 0
    assert "silent: only .mp4 takes the sound" in capsys.readouterr().out


def test_sounds_and_faces_that_are_none(face: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.wav").write_bytes(b"RIFF0000WAVE")
    (tmp_path / "slow.wav").write_bytes(wav_bytes(Sound(np.zeros(80, np.float32), 8000)))
    for sound, says in (("a.wav", "without sound"), ("slow.wav", "16000 to 384000")):
        assert says in mistake(capsys, "render", face, "--speech", tmp_path / sound, "-o", tmp_path / "b.mp4")
        assert not (tmp_path / "b.mp4").exists()
