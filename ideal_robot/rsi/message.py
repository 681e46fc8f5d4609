"""KUKA RSI's two messages: the controller's ``<Rob>`` and our answer ``<Sen>``.

Whatever comes over the network is suspect: size, characters, structure and every number are checked before they count.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.rsi.rsi_error import PacketError

MAX_PACKET = 4096
"""Largest packet that is read [bytes]; a controller's has less than 1500."""
DECIMALS = 6
"""Decimals of a correction in degrees."""

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?", re.ASCII)
_WHOLE = re.compile(r"\d{1,18}", re.ASCII)


@dataclass(frozen=True)
class RobMessage:
    """What a controller tells in one cycle; angles as it counts them, in degrees.

    Attributes:
        ipoc: the controller's time stamp of the cycle [ms]; the answer has to repeat it.
        actual: measured axis angles ``(n,)`` [deg], ``AIPos``.
        setpoint: commanded axis angles ``(n,)`` [deg], ``ASPos``; None where it is not sent.
        current: motor currents ``(n,)``, ``MACur``; None where it is not sent.
        late: answers the controller has counted as late, ``Delay``.
    """

    ipoc: int
    actual: Array
    setpoint: Array | None = None
    current: Array | None = None
    late: int = 0


def parse_rob(packet: bytes, n: int) -> RobMessage:
    """Reads ``<Rob Type="KUKA">…</Rob>`` of an arm with ``n`` axes; elements that are not needed are passed over.

    Raises:
        PacketError: too large, not such a message, IPOC or AIPos missing, another number of axes, a number that is
            none or not finite.
    """
    if len(packet) > MAX_PACKET:
        raise PacketError(f"packet has more than {MAX_PACKET} bytes")
    # A declaration or entity has no place in a message, and entities are how small packets become large ones.
    if b"<!" in packet or b"\0" in packet:
        raise PacketError("packet holds a declaration, comment, entity or zero byte")
    try:
        root = ElementTree.fromstring(packet.decode("utf-8"))
    except (UnicodeDecodeError, ElementTree.ParseError, ValueError) as error:
        raise PacketError(f"packet is not XML ({error})") from error
    if root.tag != "Rob":
        raise PacketError(f"expected <Rob>, got <{root.tag[:40]}>")
    actual = _axes(root, "AIPos", n)
    if actual is None:
        raise PacketError("AIPos is missing; add DEF_AIPos to what the controller sends")
    delay = _only(root, "Delay")
    return RobMessage(
        ipoc=_whole("IPOC", _text(root, "IPOC")), actual=actual, setpoint=_axes(root, "ASPos", n),
        current=_axes(root, "MACur", n), late=0 if delay is None else _whole("Delay", delay.get("D", "")))


def format_sen(correction: Array, ipoc: int, sen_type: str = "ImFree") -> bytes:
    """The answer with axis corrections ``(n,)`` [deg] to the cycle ``ipoc``."""
    axes = " ".join(f'A{i + 1}="{value:.{DECIMALS}f}"' for i, value in enumerate(correction))
    return f'<Sen Type="{sen_type}"><AK {axes}/><IPOC>{ipoc}</IPOC></Sen>'.encode("ascii")


def _only(root: ElementTree.Element, tag: str) -> ElementTree.Element | None:
    found = root.findall(tag)
    if len(found) > 1:
        raise PacketError(f"{tag} stands there {len(found)} times")
    return found[0] if found else None


def _text(root: ElementTree.Element, tag: str) -> str:
    element = _only(root, tag)
    if element is None:
        raise PacketError(f"{tag} is missing")
    return element.text or ""


def _whole(name: str, text: str) -> int:
    if _WHOLE.fullmatch(text.strip()) is None:
        raise PacketError(f"{name} is no whole number ({text[:40]!r})")
    return int(text)


def _axes(root: ElementTree.Element, tag: str, n: int) -> Array | None:
    element = _only(root, tag)
    if element is None:
        return None
    names = [f"A{i + 1}" for i in range(n)]
    if set(element.keys()) != set(names):
        raise PacketError(f"{tag} has {' '.join(sorted(element.keys()))[:80] or 'no axes'}, expected A1 to A{n}")
    return np.array([_number(f"{tag} {name}", element.get(name, "")) for name in names])


def _number(name: str, text: str) -> float:
    if _NUMBER.fullmatch(text.strip()) is None or not math.isfinite(value := float(text)):
        raise PacketError(f"{name} is no finite number ({text[:40]!r})")
    return value
