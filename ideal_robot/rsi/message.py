"""KUKA RSI's two messages: the controller's ``<Rob>`` and our answer ``<Sen>``.

Whatever comes over the network is suspect: size, structure and every number are checked before they count. What is
needed (``IPOC``, ``AIPos``) has to be sound, or the packet is refused; what is optional and not sound is passed over
and named. A packet is scanned once from left to right and nothing is built from it but the numbers, so that rubbish
costs neither memory nor work for the garbage collection.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.rsi.format import RsiFormat
from ideal_robot.rsi.rsi_error import PacketError

MAX_PACKET = 4096
"""Largest packet that is read [bytes]; a controller's has less than 1500."""
_DEPTH = 8
"""Deepest nesting that is followed; a controller's message has two levels."""

_BLANKS = " \t\r\n"
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?", re.ASCII)
_WHOLE = re.compile(r"\d{1,18}", re.ASCII)
_LATE = re.compile(r"(\d{1,9})(?:\.0*)?", re.ASCII)
# Possessive quantifiers: no input makes the scan go back, so its time grows with the packet's length and not faster.
_TAG = re.compile(r"""<(?:!--.*?--|\?.*?\?|(?P<end>/)?+(?P<name>[^\s<>/="'!?]++)
                      (?P<attributes>(?:\s++[^\s<>/="']++\s*+=\s*+(?:"[^"<]*+"|'[^'<]*+'))*+)\s*+(?P<empty>/)?+)>""",
                  re.VERBOSE | re.DOTALL | re.ASCII)
_ATTRIBUTE = re.compile(r"""([^\s<>/="']++)\s*+=\s*+(?:"([^"]*+)"|'([^']*+)')""", re.ASCII)

_Element = tuple[str, str]
"""Attributes and text of one element, as they stand there."""


@dataclass(frozen=True, slots=True)
class RobMessage:
    """What a controller tells in one cycle; angles as it counts them, in degrees.

    Attributes:
        ipoc: the controller's time stamp of the cycle; the answer has to repeat it.
        actual: measured axis angles ``(n,)`` [deg], ``AIPos``.
        setpoint: commanded axis angles ``(n,)`` [deg], ``ASPos``; None where it is not sent.
        current: motor currents ``(n,)``, ``MACur``; None where it is not sent.
        late: answers the controller has counted as late, ``Delay``; None where it is not sent.
        ignored: optional elements that stood there and could not be used.
    """

    ipoc: int
    actual: Array
    setpoint: Array | None = None
    current: Array | None = None
    late: int | None = None
    ignored: tuple[str, ...] = ()


def parse_rob(packet: bytes, n: int) -> RobMessage:
    """Reads ``<Rob Type="KUKA">…</Rob>`` of an arm with ``n`` axes; elements that are not needed are passed over.

    Raises:
        PacketError: too large, not such a message, IPOC or AIPos missing, another number of axes, a number that is
            none or not finite.
    """
    if len(packet) > MAX_PACKET:
        raise PacketError(f"packet has more than {MAX_PACKET} bytes")
    # What counts is ASCII; Latin-1 gives every other byte some character without ever failing.
    text = packet.rstrip(b"\0 \t\r\n").decode("latin-1")
    if "\0" in text or "<![" in text or "<!D" in text or "<!E" in text:
        raise PacketError("packet holds a declaration, an entity or a zero byte")
    found, ignored = _elements(text), []

    def optional(tag: str) -> Array | None:
        try:
            return _axes(found, tag, n)
        except PacketError:
            ignored.append(tag)
            return None

    actual = _axes(found, "AIPos", n)
    if actual is None:
        raise PacketError("AIPos is missing; add DEF_AIPos to what the controller sends")
    ipoc = _only(found, "IPOC")
    if ipoc is None:
        raise PacketError("IPOC is missing")
    if _WHOLE.fullmatch(ipoc[1].strip(_BLANKS)) is None:
        raise PacketError(f"IPOC is no whole number ({ipoc[1][:40]!a})")
    setpoint, current = optional("ASPos"), optional("MACur")
    late = None
    if "Delay" in found:
        counted = _LATE.fullmatch(_attributes(found["Delay"][0][0]).get("D", "").strip(_BLANKS))
        if counted is None or len(found["Delay"]) > 1:
            ignored.append("Delay")
        else:
            late = int(counted[1])
    return RobMessage(int(ipoc[1].strip(_BLANKS)), actual, setpoint, current, late, tuple(ignored))


def format_sen(correction: Array, ipoc: int, form: RsiFormat) -> bytes:
    """The answer with axis corrections ``(n,)`` [deg] to the cycle ``ipoc``.

    Args:
        correction: of the axes ``(n,)`` [°].
        ipoc: number of the cycle that is answered.
        form: tags and format that the controller expects.
    """
    axes = " ".join(f'A{i + 1}="{value:.{form.decimals}f}"' for i, value in enumerate(correction.tolist()))
    tag = form.correction
    return f'<Sen Type="{form.sender}"><{tag} {axes}/><IPOC>{ipoc}</IPOC></Sen>'.encode("ascii")


def _elements(text: str) -> dict[str, list[_Element]]:
    """The elements directly below ``<Rob>`` by name.

    Raises:
        PacketError: not well-formed, nested too deeply, another root.
    """
    found: dict[str, list[_Element]] = {}
    open_tags: list[str] = []
    at, attributes, inside, closed = 0, "", 0, False
    while (start := text.find("<", at)) >= 0:
        if (tag := _TAG.match(text, start)) is None or (not open_tags and text[at:start].strip(_BLANKS)):
            raise PacketError(f"packet is not XML (character {start})")
        at, name = tag.end(), tag["name"]
        if name is None:
            continue
        if not open_tags and (closed or name != "Rob" or tag["end"]):
            raise PacketError(f"packet is not XML ({name[:40]!a} outside)" if closed else
                              f"expected <Rob>, got {name[:40]!a}")
        if tag["end"]:
            if open_tags.pop() != name or tag["attributes"] or tag["empty"]:
                raise PacketError(f"packet is not XML ({name[:40]!a} closes another element)")
            if len(open_tags) == 1:
                found.setdefault(name, []).append((attributes, text[inside:start]))
            closed = not open_tags
        elif tag["empty"]:
            if len(open_tags) == 1:
                found.setdefault(name, []).append((tag["attributes"], ""))
            closed = not open_tags
        else:
            open_tags.append(name)
            if len(open_tags) == 2:
                attributes, inside = tag["attributes"], at
            if len(open_tags) > _DEPTH:
                raise PacketError(f"packet is nested more than {_DEPTH} levels deep")
    if open_tags or not closed or text[at:].strip(_BLANKS):
        raise PacketError("packet is not XML (it ends before </Rob>, or goes on after it)")
    return found


def _attributes(text: str) -> dict[str, str]:
    return {name: double or single for name, double, single in _ATTRIBUTE.findall(text)}


def _only(found: dict[str, list[_Element]], tag: str) -> _Element | None:
    elements = found.get(tag, [])
    if len(elements) > 1:
        raise PacketError(f"{tag} stands there {len(elements)} times")
    return elements[0] if elements else None


def _axes(found: dict[str, list[_Element]], tag: str, n: int) -> Array | None:
    element = _only(found, tag)
    if element is None:
        return None
    pairs = _ATTRIBUTE.findall(element[0])
    # External axes (E1 to E6) may stand beside the arm's own; an A7 would be another arm.
    values = {name: double or single for name, double, single in pairs if not name.startswith("E")}
    names = [f"A{i + 1}" for i in range(n)]
    if values.keys() != set(names) or len({name for name, _, _ in pairs}) != len(pairs):
        raise PacketError(f"{tag} has {' '.join(sorted(values))[:80]!a}, expected A1 to A{n}")
    return np.array([_number(tag, name, values[name]) for name in names])


def _number(tag: str, name: str, text: str) -> float:
    # Not strip() without an argument: what Python takes for blanks, the pattern above or float() may not.
    if _NUMBER.fullmatch(text := text.strip(_BLANKS)) is None or not math.isfinite(value := float(text)):
        raise PacketError(f"{tag} {name} is no finite number ({text[:40]!a})")
    return value
