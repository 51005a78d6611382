"""Random damage to bytes."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import random
    from collections.abc import Callable

WORDS = tuple(
    struct.pack("<d", value)
    for value in (float("nan"), float("inf"), -float("inf"), 0.0, -0.0, 1e300, -1e300, 5e-324, 1.0, -1.0)
)
"""Numbers of 8 bytes that programs handle badly."""
MOST_BITS = 8


def _flip_bit(data: bytearray, chance: random.Random) -> None:
    data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)


def _flip_bits(data: bytearray, chance: random.Random) -> None:
    for _ in range(chance.randint(1, MOST_BITS)):
        _flip_bit(data, chance)


def _set_byte(data: bytearray, chance: random.Random) -> None:
    data[chance.randrange(len(data))] = chance.choice((0, 1, 0x7F, 0x80, 0xFF, chance.randrange(256)))


def _set_word(data: bytearray, chance: random.Random) -> None:
    begin = _place(data, chance)
    data[begin : begin + 8] = chance.choice(WORDS)


def _swap_words(data: bytearray, chance: random.Random) -> None:
    one, other = _place(data, chance), _place(data, chance)
    data[one : one + 8], data[other : other + 8] = data[other : other + 8], data[one : one + 8]


def _cut(data: bytearray, chance: random.Random) -> None:
    del data[chance.randrange(len(data)) :]


def _insert(data: bytearray, chance: random.Random) -> None:
    begin = chance.randrange(len(data))
    data[begin:begin] = chance.randbytes(chance.randint(1, 16))


def _remove(data: bytearray, chance: random.Random) -> None:
    begin = chance.randrange(len(data))
    del data[begin : begin + chance.randint(1, 16)]


def _randomise(data: bytearray, chance: random.Random) -> None:
    begin = chance.randrange(len(data))
    length = min(chance.randint(1, 32), len(data) - begin)
    data[begin : begin + length] = chance.randbytes(length)


def _place(data: bytearray, chance: random.Random) -> int:
    """Return where a number of 8 bytes may begin: aligned as in CDR, behind the encapsulation header of 4 bytes."""
    return 4 + 8 * chance.randrange(max(1, (len(data) - 4) // 8))


MUTATIONS: tuple[Callable[[bytearray, random.Random], None], ...] = (
    *(_flip_bit, _flip_bits, _set_byte, _set_word, _swap_words, _cut, _insert, _remove, _randomise),
)


def mutate(data: bytes, chance: random.Random) -> bytes:
    """Return damaged bytes: one kind of damage at a random place; may equal ``data`` by chance."""
    if not data:
        return chance.randbytes(1)
    changed = bytearray(data)
    chance.choice(MUTATIONS)(changed, chance)
    return bytes(changed)
