"""Code of a watermark: ids, a CRC, and a convolutional code with soft decoding.

48 bits of ids and CRC-16/CCITT make 64 bits; the rate-1/4 code of constraint length 9 of cdma2000 (3GPP2 C.S0002,
generators 765, 671, 513, 473) makes 256. It is tail-biting: the encoder starts in its final state, which saves the
bits of a tail.
"""

from __future__ import annotations

import binascii
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_GENERATORS = (0o765, 0o671, 0o513, 0o473)
_MEMORY = 8  # bits of the encoder's state
_STATES = 1 << _MEMORY
CHECK_BITS = 16
"""Length of the CRC; decoded noise passes it with probability 2^-16."""
_INFO_BITS = 48 + CHECK_BITS
CODE_BITS = _INFO_BITS * len(_GENERATORS)
"""Length of a code word."""


@dataclass(frozen=True, slots=True)
class Payload:
    """Ids of the server and of the session."""

    server: int  # 16 bits
    session: int  # 32 bits


def _tables() -> tuple[NDArray[np.intp], NDArray[np.float32]]:
    """Return each state's two predecessors [states, 2], and the signs sent in the transitions [states, 2, 4].

    The newest bit is the top bit of a state.
    """
    states = np.arange(_STATES)
    before = np.stack([(states << 1) & (_STATES - 1), (states << 1) & (_STATES - 1) | 1], axis=1)
    register = ((states >> (_MEMORY - 1)) << _MEMORY)[:, None] | before
    parity = np.array([number.bit_count() & 1 for number in range(2 * _STATES)])
    return before, (1 - 2 * parity[register[..., None] & np.array(_GENERATORS)]).astype(np.float32)


_PREDECESSORS, _SIGNS = _tables()


def encode(payload: Payload) -> NDArray[np.float32]:
    """Return the code word [CODE_BITS] as signs, +1 for a 0."""
    info = payload.server.to_bytes(2, "big") + payload.session.to_bytes(4, "big")
    bits = np.unpackbits(np.frombuffer(info + _crc(info), np.uint8)).astype(np.intp)
    state = 0
    for bit in bits[-_MEMORY:]:
        state = state >> 1 | int(bit) << (_MEMORY - 1)
    word = []
    for bit in bits:
        after = state >> 1 | int(bit) << (_MEMORY - 1)
        word.append(_SIGNS[after, state & 1])
        state = after
    return np.concatenate(word)


def decode(soft: NDArray[np.floating]) -> Payload | None:
    """Return the payload of a received word [CODE_BITS], signs times confidence; None if the CRC does not match.

    Viterbi's algorithm, three rounds around the circle from any state; the middle round is kept.
    """
    received = np.asarray(soft, np.float32).reshape(_INFO_BITS, len(_GENERATORS))
    gains = received @ _SIGNS.reshape(-1, len(_GENERATORS)).T  # [info, 2 states]
    gains = gains.reshape(_INFO_BITS, _STATES, 2)
    metric = np.zeros(_STATES, np.float32)
    choices = np.empty((3 * _INFO_BITS, _STATES), bool)
    for step in range(len(choices)):
        candidates = metric[_PREDECESSORS] + gains[step % _INFO_BITS]
        choices[step] = candidates[:, 1] > candidates[:, 0]
        metric = candidates.max(axis=1)
    state = int(metric.argmax())
    bits = np.empty(len(choices), np.uint8)
    for step in range(len(choices) - 1, -1, -1):
        bits[step] = state >> (_MEMORY - 1)
        state = int(_PREDECESSORS[state, int(choices[step, state])])
    data = np.packbits(bits[_INFO_BITS : 2 * _INFO_BITS]).tobytes()
    info, check = data[:6], data[6:]
    if check != _crc(info):
        return None
    return Payload(int.from_bytes(info[:2], "big"), int.from_bytes(info[2:], "big"))


def _crc(info: bytes) -> bytes:
    return binascii.crc_hqx(info, 0xFFFF).to_bytes(2, "big")
