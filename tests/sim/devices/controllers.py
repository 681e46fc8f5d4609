"""A controller in lockstep around axes that follow with a first-order lag: quick, repeatable, with faults to order.

No clock decides anything: the controller waits for each answer and then takes or leaves it as it was told to.
"""

from __future__ import annotations

import re
import socket
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from sim.arm.arm import SimulatedArm
from sim.devices.rsi_controller import ControllerRun, RsiController
from sim.devices.rtde_controller import RtdeController

# A controller in a thread and what listens to it, on loopback only.

PATIENCE = 20.0
"""No test waits longer for the other side [s]."""
ENDLESS = 1_000_000
"""Cycles of a controller that ends with the block."""


@contextmanager
def controlled(arm: SimulatedArm, port: int, cycles: int = ENDLESS, **options: Any) -> Iterator[Future[ControllerRun]]:
    """Plays the controller in a thread while the block runs; yields what it will have seen."""
    controller = RsiController(arm, ("127.0.0.1", port), **{"timeout": PATIENCE, **options})
    with ThreadPoolExecutor(1) as pool:
        try:
            future = pool.submit(controller.run, cycles)
            yield future
        finally:
            # With a number of cycles it ends by itself, and the last answer may still be on its way.
            wait([future], PATIENCE if cycles < ENDLESS else 0.0)
            controller.stop()


def never(_: int) -> bool:
    return False


def nothing(_: int, __: bytes) -> list[bytes]:
    return []


def unchanged(_: int, measured: Array) -> Array:
    return measured


@dataclass
class LaggingController:
    """Args are what it is like; ``commanded`` [deg] is what it has in force in each cycle.

    Attributes:
        start: measured and commanded axes when RSI begins ``(n,)`` [deg].
        cycle: interpolation cycle [s].
        lag: time constant of the axes [s].
        adds_up: whether it adds corrections up.
        goes_on: whether it repeats an increment where no answer came.
        rise: what its time stamp rises by in a cycle; None for the cycle in ms.
        tag: element it reads corrections from.
        gain: what each axis makes of its correction ``(n,)``; -1 turns it round, 0 keeps it still.
        tells_delay: whether it sends ``Delay``.
        lost: whether the packet of a cycle gets lost.
        late: whether the answer of a cycle comes too late.
        held_back: whether the packet of a cycle waits, to arrive together with the next that does not.
        beside: what else comes from its address before the packet of a cycle.
        measured: what it says of its measured axes in a cycle.
    """

    start: Array
    cycle: float = 0.012
    lag: float = 0.03
    adds_up: bool = False
    goes_on: bool = False
    rise: int | None = None
    tag: str = "AK"
    gain: Array = field(default_factory=lambda: np.ones(6))
    tells_delay: bool = True
    lost: Callable[[int], bool] = never
    late: Callable[[int], bool] = never
    held_back: Callable[[int], bool] = never
    beside: Callable[[int, bytes], list[bytes]] = nothing
    measured: Callable[[int, Array], Array] = unchanged
    first_stamp: int = 4208163634
    commanded: list[Array] = field(default_factory=list)
    answers: int = 0
    stopped: threading.Event = field(default_factory=threading.Event)

    def run(self, address: tuple[str, int]) -> None:
        """Plays until it is stopped or no answer comes."""
        position, actual, step, missed = self.start.copy(), self.start.copy(), np.zeros(len(self.start)), 0
        share, waiting = 1.0 - np.exp(-self.cycle / self.lag), []
        rise = round(1e3 * self.cycle) if self.rise is None else self.rise
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
            link.settimeout(0.05)
            for k in range(10**7):
                stamp = (self.first_stamp + k * rise) % 2**32
                packet = self._packet(self.measured(k, actual.copy()), missed, stamp)
                answer = None
                if self.held_back(k):
                    waiting.append(packet)
                elif not self.lost(k):
                    for piece in (*waiting, *self.beside(k, packet), packet):
                        link.sendto(piece, address)
                    waiting = []
                    answer = self._answer(link, stamp)
                    if self.stopped.is_set():
                        return
                    if self.late(k):
                        answer = None
                if answer is None:
                    missed, step = missed + 1, step if self.goes_on else 0.0 * step
                elif self.adds_up:
                    step = self.gain * answer
                else:
                    step = self.start + self.gain * answer - position
                position = position + step
                self.commanded.append(position)
                actual = actual + share * (position - actual)

    def _packet(self, at: Array, missed: int, stamp: int) -> bytes:
        def axes(tag: str, values: Array) -> str:
            return f"<{tag} " + " ".join(f'A{i + 1}="{value:.6f}"' for i, value in enumerate(values)) + "/>"

        delay = f'<Delay D="{missed}"/>' if self.tells_delay else ""
        return (f'<Rob Type="KUKA">{axes("AIPos", at)}{axes("ASPos", self.start)}{delay}<IPOC>{stamp}</IPOC></Rob>'
                ).encode()

    def _answer(self, link: socket.socket, stamp: int) -> Array | None:
        for _ in range(round(PATIENCE / 0.05)):
            try:
                text = link.recv(4096).decode()
            except (TimeoutError, ConnectionError):
                if self.stopped.is_set():
                    return None
                continue
            if f"<IPOC>{stamp}</IPOC>" in text:
                self.answers += 1
                match = re.search(f"<{self.tag} ([^>]*)/>", text)
                return np.zeros(len(self.start)) if match is None else np.array(
                    [float(value) for value in re.findall(r'"([^"]+)"', match[1])])
        self.stopped.set()
        return None


@contextmanager
def playing(controller: LaggingController, address: tuple[str, int]) -> Iterator[Future[None]]:
    """Plays the controller in a thread while the block runs."""
    with ThreadPoolExecutor(1) as pool:
        future = pool.submit(controller.run, address)
        try:
            yield future
        finally:
            controller.stopped.set()
            wait([future], PATIENCE)


# Packets as a hostile or broken network makes them, from a sound one: the same for the same generator.

_PIECES = (b"<", b">", b"/>", b"</Rob>", b"<Rob>", b"<a>", b"<!--", b"-->", b"<![CDATA[", b"<!DOCTYPE a [", b"&amp;",
           b"\0", b"\xff\xfe", b"nan", b"inf", b"1e308", b"-1e999", b'"', b"=", b"A1", b"IPOC", b"9" * 30, b" " * 500)


def mutated(packet: bytes, rng: np.random.Generator) -> bytes:
    """One to four changes: bytes flipped, cut, doubled, or pieces of XML put in."""
    data = bytearray(packet)
    for _ in range(int(rng.integers(1, 5))):
        start, length = int(rng.integers(0, len(data) + 1)), int(rng.integers(1, 40))
        kind = int(rng.integers(0, 5))
        if kind == 0 and start < len(data):
            data[start] ^= 1 << int(rng.integers(0, 8))
        elif kind == 1:
            del data[start : start + length]
        elif kind == 2:
            data[start:start] = data[start : start + length]
        elif kind == 3:
            data[start:start] = _PIECES[int(rng.integers(0, len(_PIECES)))]
        else:
            data[start:start] = rng.bytes(length)
    return bytes(data)


# An RTDE controller in a thread, on loopback only.

@contextmanager
def serving(controller: RtdeController) -> Iterator[RtdeController]:
    """Plays the controller in a thread while the block runs."""
    with ThreadPoolExecutor(1) as pool:
        future = pool.submit(controller.run)
        try:
            yield controller
        finally:
            controller.stop()
            future.result(20.0)
