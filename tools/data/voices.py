"""Synthetic voices with the times of phonemes: espeak-ng by its library, flite by its program.

Both are system packages (Debian: espeak-ng, flite); neither glsplat nor a test needs them.
"""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.speech.sound import Sound, read_wav


@dataclass(frozen=True)
class Said:
    """A sentence: its sound, and (phoneme, begin, end) in seconds."""

    sound: Sound
    phonemes: list[tuple[str, float, float]]


class _Id(ctypes.Union):
    _fields_: ClassVar = [("number", ctypes.c_int), ("name", ctypes.c_char_p), ("string", ctypes.c_char * 8)]


class _Event(ctypes.Structure):  # espeak_EVENT of speak_lib.h
    _fields_: ClassVar = [
        *((name, ctypes.c_int) for name in ("type", "unique_identifier", "text_position", "length")),
        *((name, ctypes.c_int) for name in ("audio_position", "sample")),
        *(("user_data", ctypes.c_void_p), ("id", _Id)),
    ]


_CALLBACK = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.POINTER(ctypes.c_short), ctypes.c_int, ctypes.POINTER(_Event))
_PHONEME = 7
_heard: list[NDArray[np.int16]] = []
_begins: list[tuple[str, float]] = []


def _listen(samples: Any, count: int, events: Any) -> int:
    if samples and count > 0:
        _heard.append(np.ctypeslib.as_array(samples, (count,)).copy())
    i = 0
    while events[i].type:
        if events[i].type == _PHONEME:
            _begins.append((events[i].id.string.decode("utf8", "replace"), events[i].audio_position / 1e3))
        i += 1
    return 0


_callback = _CALLBACK(_listen)


@cache
def _library() -> tuple[Any, int]:
    library = ctypes.CDLL("libespeak-ng.so.1")
    rate = library.espeak_Initialize(2, 0, None, 1)  # synchronous, with events of phonemes
    library.espeak_SetSynthCallback(_callback)
    return library, rate


def espeak(text: str, voice: str, words: int, pitch: int) -> Said:
    """Speak a text by espeak-ng, at ``words`` per minute. Raises ValueError for an unknown voice."""
    library, rate = _library()
    _heard.clear()
    _begins.clear()
    if library.espeak_SetVoiceByName(voice.encode()):
        raise ValueError(f"espeak-ng has no voice {voice}")
    library.espeak_SetParameter(1, words, 0)
    library.espeak_SetParameter(3, pitch, 0)
    data = text.encode()
    library.espeak_Synth(ctypes.c_char_p(data), ctypes.c_size_t(len(data) + 1), 0, 0, 0, 1, None, None)
    library.espeak_Synchronize()
    sound = Sound((np.concatenate(_heard) / 32768).astype(np.float32), rate)
    ends = [begin for _, begin in _begins[1:]] + [sound.seconds]
    return Said(sound, [(name, begin, end) for (name, begin), end in zip(_begins, ends, strict=True)])


def flite(text: str, voice: str) -> Said:
    """Speak a text by flite, with a voice made of recordings of a person: slt, rms, awb, kal16."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "said.wav"
        command = ["flite", "-voice", voice, "-psdur", "-t", text, "-o", str(path)]
        out = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
        sound = read_wav(path)
    phonemes, begin = [], 0.0
    for word in out:
        name, _, end = word.rpartition(":")
        phonemes.append((name, begin, float(end)))
        begin = float(end)
    return Said(sound, phonemes)
