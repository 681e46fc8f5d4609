"""Packets mutated by the structure of their protocol, and a socket whose other side has said all it will say."""

from __future__ import annotations

import math
import random
import struct
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

EPISODE = 30
"""Packets after which a connection is begun anew."""
SHARE = 0.3
"""Of the packets that are mutated."""
FLOATS = (math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, 0.0, -0.0, 1.0, -1.0, 1e9, -1e9)


@dataclass
class Told:
    """What became of the packets.

    Attributes:
        mutated: mutated packets that were read.
        packets: all that were read.
        taken: states, pictures or readings that came of them.
    """

    mutated: int = 0
    packets: int = 0
    taken: int = 0


class Wire:
    """A socket that brings piece after piece, as if the next were not there yet when nobody waits for it.

    Args:
        pieces: what the other side says, and whether it is mutated.
        told: counts what is read.
        sender: of datagrams.
    """

    def __init__(self, pieces: Sequence[tuple[bytes, int]], told: Told, sender: Any = None) -> None:
        self.pieces, self._told, self._sender = deque(pieces), told, sender
        self._timeout, self._brought = 1.0, False

    def settimeout(self, seconds: float) -> None:
        """How long is waited; with 0 there is nothing after every piece."""
        self._timeout = seconds

    def recv(self, size: int) -> bytes:
        """The next piece; b"" behind the last, as of a closed connection."""
        self._brought = not self._brought
        if self._timeout == 0.0 and not self._brought:
            raise BlockingIOError
        if not self.pieces:
            return b""
        piece, mutated = self.pieces.popleft()
        if len(piece) > size:
            self.pieces.appendleft((piece[size:], mutated))
            return piece[:size]
        self._told.packets += 1
        self._told.mutated += mutated
        return piece

    def recvmsg(self, size: int, _: int) -> tuple[bytes, list[Any], int, Any]:
        """As ``recv``, of a datagram."""
        if not self.pieces:
            raise BlockingIOError if self._timeout == 0.0 else TimeoutError
        return self.recv(1 << 16)[:size], [], 0, self._sender

    def send(self, data: bytes) -> int:
        """All of it, to nobody."""
        return len(data)

    def getsockname(self) -> tuple[str, int]:
        """Every address."""
        return "0.0.0.0", 1

    def __getattr__(self, name: str) -> Callable[..., None]:
        return lambda *_: None


def odd(code: str, value: Any, rng: random.Random) -> Any:
    """Another value of the same type, one at its limits as likely as any.

    Args:
        code: of ``struct``, one letter.
        value: the sound one.
        rng: draws.
    """
    if code == "d":
        kind = rng.randrange(3)
        if kind == 0:
            return rng.choice(FLOATS)
        return struct.unpack("d", rng.randbytes(8))[0] if kind == 1 else value * 10.0 ** rng.randint(-9, 9)
    bits = 8 * struct.calcsize(f">{code}")
    low = -(1 << (bits - 1)) if code.islower() else 0
    return rng.choice((low, low + (1 << bits) - 1, 0, 1, low + rng.getrandbits(bits)))


def fields(layout: str, values: Sequence[Any], rng: random.Random) -> bytes:
    """Packed values, one to three of them odd.

    Args:
        layout: codes of ``struct``, a letter each.
        values: sound ones.
        rng: draws.
    """
    changed = list(values)
    for place in rng.sample(range(len(values)), min(rng.randint(1, 3), len(values))):
        changed[place] = odd(layout[place], changed[place], rng)
    return struct.pack(f">{layout}", *changed)


def scrambled(packet: bytes, rng: random.Random) -> bytes:
    """Bytes flipped, cut, doubled or put in."""
    data = bytearray(packet)
    for _ in range(rng.randint(1, 4)):
        place, length = rng.randrange(len(data) + 1), rng.randint(1, 40)
        kind = rng.randrange(4)
        if kind == 0 and place < len(data):
            data[place] ^= 1 << rng.randrange(8)
        elif kind == 1:
            del data[place : place + length]
        elif kind == 2:
            data[place:place] = data[place : place + length]
        else:
            data[place:place] = rng.randbytes(length)
    return bytes(data)


def episode(sound: Sequence[bytes], changed: Callable[[int], bytes], rng: random.Random) -> list[tuple[bytes, int]]:
    """Packets and whether they are mutated: some changed, doubled, in another order or in two pieces.

    Args:
        sound: packets of a sound connection.
        changed: mutates one of them, by its number.
        rng: draws.
    """
    pieces: list[tuple[bytes, int]] = []
    for k, packet in enumerate(sound):
        if rng.random() >= SHARE:
            pieces.append((packet, 0))
            continue
        kind = rng.randrange(8)
        if kind < 4:
            pieces.append((changed(k), 1))
        elif kind == 4:
            pieces.append((scrambled(packet, rng), 1))
        elif kind == 5:
            pieces += [(packet, 0), (packet, 1)]
        elif kind == 6:
            pieces.insert(max(len(pieces) - rng.randint(1, 3), 0), (packet, 1))
        else:
            cut = rng.randrange(len(packet) + 1)
            pieces += [(packet[:cut], 1), (packet[cut:], 0)]
    return pieces
