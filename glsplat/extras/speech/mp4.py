"""Add sound to a silent MP4: a second track, of FLAC, by FFmpeg (PyAV)."""

from __future__ import annotations

import os
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from glsplat.errors import FormatError
from glsplat.extras.speech.sound import Sound
from glsplat.optional import require_package

require_package("sound in an .mp4", "av", "video", "give a .webm, which stays silent")
import av  # noqa: E402 -- the line above names the pip extra

if TYPE_CHECKING:
    from av.audio.frame import AudioFrame

_BLOCK = 4096  # samples of a frame of FLAC


def add_sound(path: Path, sound: Sound) -> None:
    """Add a track of 16 bits to the file; its pictures are not recoded.

    Raises FormatError if the file has no pictures, and OSError if it cannot be written; both leave it unchanged.
    """
    partial = path.with_name(f"{path.name}.part")
    try:
        with av.open(str(path)) as clip, av.open(str(partial), "w", format="mp4") as out:
            pictures = clip.streams.video[0]
            copied = out.add_stream_from_template(pictures)
            coder = out.add_stream("flac", rate=sound.rate, format="s16", layout="mono")
            for packet in clip.demux(pictures):
                if packet.dts is not None:  # the last one is empty
                    packet.stream = copied
                    out.mux(packet)
            for frame in _frames(sound):
                out.mux(coder.encode(frame))
            out.mux(coder.encode(None))
        os.replace(partial, path)
    except OSError:  # some of FFmpeg's errors, too, such as a full disk
        raise
    except (av.error.FFmpegError, IndexError) as error:
        raise FormatError(f"{path}: sound cannot be added ({error}); give a folder/ of pictures") from None
    finally:
        partial.unlink(missing_ok=True)


def _frames(sound: Sound) -> Iterator[AudioFrame]:
    samples = np.rint(sound.samples.astype(np.float64).clip(-1, 1) * 32767).astype(np.int16)
    for first in range(0, len(samples), _BLOCK):
        frame = av.AudioFrame.from_ndarray(samples[None, first : first + _BLOCK], format="s16", layout="mono")
        frame.rate, frame.pts, frame.time_base = sound.rate, first, Fraction(1, sound.rate)
        yield frame
