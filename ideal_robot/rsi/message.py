"""KUKA RSI's two messages: the controller's ``<Rob>`` and this program's answer ``<Sen>``.

Size, structure and every number of a packet are checked. If a required element (``IPOC``, ``AIPos``) is invalid, the
packet is refused; invalid optional elements are skipped and named. A packet is scanned once from left to right and
nothing is built from it but the numbers, so that invalid packets cost no memory.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.bounded_values import RSI_BYTES
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.robots.robot import Robot

# Errors of the connection to a controller.

class RsiError(IdealRobotError):
    """The link to the controller cannot continue; the arm stays at the controller's setpoint."""


class PacketError(RsiError):
    """The packet is not a valid message of a controller; it is counted and not answered."""


# Names in one controller's messages: tags, sender type, decimals; from its RSI ethernet XML if given.


_NAME = re.compile(r"[A-Za-z_][\w.-]{0,63}", re.ASCII)


@dataclass(frozen=True)
class RsiFormat:
    """Names of the parts of a controller's messages.

    Attributes:
        correction: element with the corrections in our answer; ``AK``, ``AKorr``, ``RKorr`` …
        sender: ``Type`` of our answer, ``SENTYPE`` in the controller's configuration.
        decimals: decimals of a correction in degrees or millimetres.
        hold_on: the controller's correction if no answer came in time: the last values, or none. None where unknown.
        port: UDP port to which the controller sends, where its configuration says so.
        pose: whether the tool's pose is corrected (``X`` to ``C``), in the place of the axes (``A1`` …).
        held: external axes with corrections, ``EK.E1`` …: zeros are sent.

    Raises:
        InputError: a name that no XML element may have, another number of decimals than 1 to 9.
    """

    correction: str = "AK"
    sender: str = "ImFree"
    decimals: int = 6
    hold_on: bool | None = None
    port: int | None = None
    pose: bool = False
    held: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("correction", "sender"):
            if _NAME.fullmatch(getattr(self, name)) is None:
                raise InputError("expected a plain XML name", field=name, value=getattr(self, name)[:64])
        if not 1 <= self.decimals <= 9:
            raise InputError("expected 1 to 9 decimals", field="decimals", value=self.decimals)

    @cached_property
    def still(self) -> str:
        """The part of an answer with zero corrections of external axes."""
        groups: dict[str, list[str]] = {}
        for name in self.held:
            group, _, axis = name.partition(".")
            groups.setdefault(group, []).append(axis)
        nothing = f"{0.0:.{self.decimals}f}"
        return "".join(f"<{group} " + " ".join(f'{axis}="{nothing}"' for axis in axes) + "/>"
                       for group, axes in groups.items())

    @classmethod
    def read(cls, file: str | Path, n: int, correction: str | None = None) -> RsiFormat:
        """Reads the format from the controller's RSI ethernet XML (``CONFIG``, ``SEND``, ``RECEIVE``).

        Args:
            file, n: the file as it lies on the controller, and the number of axes.
            correction: element to be used where several hold corrections; None for the only one of axes, else of the
                pose.

        Raises:
            InputError: unreadable or too large, no such XML, declarations or entities, measured axes or pose not sent,
                no element with ``n`` axis corrections, or those of a whole pose, or several, ``HOLDON`` that differs
                between them, a controller that only sends, corrections of external axes in the place of the arm's.
        """
        root = _root(Path(file))
        if (root.findtext("CONFIG/ONLYSEND") or "").strip().upper() == "TRUE":
            raise InputError("the controller only sends and takes no answers, so nothing can be corrected: set "
                             "ONLYSEND to FALSE", file=file, field="CONFIG.ONLYSEND", value="TRUE")
        sent = {element.get("TAG", "") for element in root.findall("SEND/ELEMENTS/ELEMENT")}
        if "DEF_AIPos" not in sent:
            raise InputError('the controller does not send measured axes; add <ELEMENT TAG="DEF_AIPos" TYPE="DOUBLE" '
                             'INDX="INTERNAL"/> to SEND', file=file, field="SEND")
        received: dict[str, dict[str, str]] = {}
        for element in root.findall("RECEIVE/ELEMENTS/ELEMENT"):
            group, _, axis = element.get("TAG", "").partition(".")
            received.setdefault(group, {})[axis] = element.get("HOLDON", "1")
        wanted = received if correction is None else {correction: received.get(correction, {})}
        group, names = _corrected(wanted, n, file)
        if not group:
            raise InputError(_unsupported(received, n, correction), file=file, field="RECEIVE",
                             value=", ".join(f"{group}.{axis}" for group, attributes in received.items()
                                             for axis in attributes)[:80])
        pose = names is _POSE
        if pose and "DEF_RIst" not in sent:
            raise InputError('the controller does not send its pose, which corrections of it start from; add <ELEMENT '
                             'TAG="DEF_RIst" TYPE="DOUBLE" INDX="INTERNAL"/> to SEND', file=file, field="SEND")
        hold = {received[group][axis].strip() for axis in names}
        if len(hold) != 1 or not hold <= {"0", "1"}:
            raise InputError("expected HOLDON 0 or 1, the same for all of an element", file=file, field="HOLDON",
                             value=sorted(hold))
        held = tuple(f"{other}.{axis}" for other, attributes in received.items() for axis in attributes
                     if other != group and axis in _EXTERNAL)
        port = (root.findtext("CONFIG/PORT") or "").strip()
        if not (port.isascii() and port.isdigit() and 0 < int(port[:6]) < 65536):
            raise InputError("expected a UDP port", file=file, field="CONFIG.PORT", value=port[:40])
        return cls(correction=group, sender=(root.findtext("CONFIG/SENTYPE") or cls.sender).strip(),
                   hold_on=hold == {"1"}, port=int(port), pose=pose, held=held)


_POSE = ("X", "Y", "Z", "A", "B", "C")
"""Attributes of an element that corrects a pose."""
_EXTERNAL = tuple(f"E{i + 1}" for i in range(6))


def _corrected(received: dict[str, dict[str, str]], n: int, file: str | Path) -> tuple[str, tuple[str, ...]]:
    """The element to be used and its attributes: one of all ``n`` axes, else of the whole pose; empty for none."""
    for names in (tuple(f"A{i + 1}" for i in range(n)), _POSE if n == len(_POSE) else ()):
        groups = [group for group, attributes in received.items() if names and set(names) <= set(attributes)]
        if len(groups) > 1:
            raise InputError(f"several elements hold corrections {names[0]} to {names[-1]} in RECEIVE: "
                             f"{', '.join(groups)[:80]}; name one with --tag", file=file, field="RECEIVE")
        if groups:
            return groups[0], names
    return "", ()


def _unsupported(received: dict[str, dict[str, str]], n: int, wanted: str | None) -> str:
    """Why no element corrects the arm's axes, and what to do.

    Args:
        received: attributes of each element that the controller takes.
        n, wanted: the number of the arm's joints, and the element asked for by name.
    """
    if wanted is not None and wanted not in received:
        return f"the controller takes no element {wanted}; --tag has to name one of RECEIVE"
    axes = {group: sum(f"A{i + 1}" in attributes for i in range(6)) for group, attributes in received.items()}
    external = sum(f"E{i + 1}" in attributes for attributes in received.values() for i in range(6))
    most = max(axes.values(), default=0)
    if most and (external or n > 6):
        held = f" and {external} external axes, which are held" if external else ""
        return (f"the controller takes corrections of {most} axes{held}, the robot has {n} joints: give the URDF of "
                "the arm alone, its track or table fixed")
    if not most and any(set("XYZ") & set(attributes) for attributes in received.values()):
        if n != len(_POSE):
            return (f"the controller takes corrections of the pose, which move six axes; the robot has {n} joints: "
                    "correct the axes, by AXISCORR in the place of POSCORR in the RSI context")
        return ("the controller takes a part of the corrections of the pose; all of X, Y, Z, A, B and C are needed in "
                "one element")
    return f"no element holds corrections of all axes, A1 to A{n}"


def _root(file: Path) -> ElementTree.Element:
    """The root of a configuration that is small and declares nothing."""
    if not file.is_file():
        # A device or a pipe, which may never end, is not a file either.
        raise InputError("cannot be read: no such file", file=file)
    try:
        with file.open("rb") as stream:
            text = stream.read(RSI_BYTES.most + 1)
    except OSError as error:
        raise InputError(f"cannot be read ({error})", file=file) from error
    RSI_BYTES.check(len(text), file)
    # Entities can expand small files to large ones; zero bytes of UTF-16 would hide them from this check.
    if b"\0" in text or b"<!DOCTYPE" in text or b"<!ENTITY" in text:
        raise InputError("holds a document type, an entity or zero bytes; none has a place here", file=file)
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise InputError(f"is not XML ({error})", file=file) from error
    if root.tag != "ROOT" or root.find("CONFIG") is None:
        raise InputError("is no RSI ethernet configuration (<ROOT><CONFIG>…)", file=file, value=root.tag[:40])
    return root


MAX_PACKET = 4096
"""Largest packet that is read [bytes]; a controller's has less than 1500."""
_DEPTH = 8
"""Deepest nesting that is followed; a controller's message has two levels."""

_BLANKS = " \t\r\n"
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?", re.ASCII)
_WHOLE = re.compile(r"\d{1,18}", re.ASCII)
_LATE = re.compile(r"(\d{1,9})(?:\.0*)?", re.ASCII)
# Possessive quantifiers prevent backtracking, so the time is linear in the packet's length.
_TAG = re.compile(r"""<(?:!--.*?--|\?.*?\?|(?P<end>/)?+(?P<name>[^\s<>/="'!?]++)
                      (?P<attributes>(?:\s++[^\s<>/="']++\s*+=\s*+(?:"[^"<]*+"|'[^'<]*+'))*+)\s*+(?P<empty>/)?+)>""",
                  re.VERBOSE | re.DOTALL | re.ASCII)
_ATTRIBUTE = re.compile(r"""([^\s<>/="']++)\s*+=\s*+(?:"([^"]*+)"|'([^']*+)')""", re.ASCII)

_Element = tuple[str, str]
"""Attributes and text of one element, as they stand there."""


@dataclass(frozen=True, slots=True)
class RobMessage:
    """The message of a controller in one cycle; angles in degrees with the controller's directions and zeros.

    Attributes:
        ipoc: the controller's time stamp of the cycle; the answer has to repeat it.
        actual: measured axis angles ``(n,)`` [deg], ``AIPos``.
        setpoint: commanded axis angles ``(n,)`` [deg], ``ASPos``; None where it is not sent.
        current: motor currents ``(n,)``, ``MACur``; None where it is not sent.
        late: number of late answers by the controller, ``Delay``; None where it is not sent.
        pose: measured pose of the tool X, Y, Z [mm], A, B, C [deg], ``RIst``; None where it is not sent.
        external: measured external axes ``E1`` … [deg or mm], ``EIPos``; None where they are not sent.
        ignored: optional elements that could not be used.
    """

    ipoc: int
    actual: Array
    setpoint: Array | None = None
    current: Array | None = None
    late: int | None = None
    pose: Array | None = None
    external: Array | None = None
    ignored: tuple[str, ...] = ()


def parse_rob(packet: bytes, n: int, form: RsiFormat | None = None) -> RobMessage:
    """Reads ``<Rob Type="KUKA">…</Rob>`` of an arm with ``n`` axes; elements that are not needed are passed over.

    Args:
        packet, n: as it came, and the number of axes.
        form: layout of the message; a pose is required where it corrects the pose, and external axes are read where it
            holds them.

    Raises PacketError if too large, not such a message, IPOC or AIPos missing, another number of axes, a number that is
    none or not finite.
    """
    if len(packet) > MAX_PACKET:
        raise PacketError(f"packet has more than {MAX_PACKET} bytes")
    # Only ASCII is used; Latin-1 decodes every other byte without failing.
    text = packet.rstrip(b"\0 \t\r\n").decode("latin-1")
    if "\0" in text or "<![" in text or "<!D" in text or "<!E" in text:
        raise PacketError("packet holds a declaration, an entity or a zero byte")
    elements, ignored = _elements(text), list[str]()
    axes = [f"A{i + 1}" for i in range(n)]

    def optional(tag: str, names: Sequence[str] = axes, *, some: bool = False) -> Array | None:
        try:
            return _values(elements, tag, names, some)
        except PacketError:
            ignored.append(tag)
            return None

    actual = _values(elements, "AIPos", axes)
    if actual is None:
        raise PacketError("AIPos is missing; add DEF_AIPos to what the controller sends")
    ipoc = _only(elements, "IPOC")
    if ipoc is None:
        raise PacketError("IPOC is missing")
    if _WHOLE.fullmatch(ipoc[1].strip(_BLANKS)) is None:
        raise PacketError(f"IPOC is no whole number ({ipoc[1][:40]!a})")
    setpoint, current = optional("ASPos"), optional("MACur")
    pose = external = None
    if form is not None and form.pose and (pose := _values(elements, "RIst", _POSE, others=True)) is None:
        raise PacketError("RIst is missing; add DEF_RIst to what the controller sends")
    if form is not None and form.held:
        external = optional("EIPos", _EXTERNAL, some=True)
    late = None
    if "Delay" in elements:
        named = {name: double or single for name, double, single in _ATTRIBUTE.findall(elements["Delay"][0][0])}
        counted = _LATE.fullmatch(named.get("D", "").strip(_BLANKS))
        if counted is None or len(elements["Delay"]) > 1:
            ignored.append("Delay")
        else:
            late = int(counted[1])
    return RobMessage(int(ipoc[1].strip(_BLANKS)), actual, setpoint, current, late, pose, external,
                      tuple(ignored))


def format_sen(correction: Array, ipoc: int, form: RsiFormat) -> bytes:
    """Formats the answer with corrections.

    Args:
        correction: of the axes ``(n,)`` [deg], or of the pose ``(6,)`` [mm, deg].
        ipoc: number of the cycle that is answered.
        form: tags and format that the controller expects.
    """
    names = _POSE if form.pose else [f"A{i + 1}" for i in range(len(correction))]
    told = " ".join(f'{name}="{value:.{form.decimals}f}"' for name, value in zip(names, correction.tolist(),
                                                                               strict=True))
    return (f'<Sen Type="{form.sender}"><{form.correction} {told}/>{form.still}<IPOC>{ipoc}</IPOC></Sen>'
            ).encode("ascii")


def _elements(text: str) -> dict[str, list[_Element]]:
    """The elements directly below ``<Rob>`` by name; PacketError if not well-formed, too deep, of another root."""
    elements: dict[str, list[_Element]] = {}
    open_tags: list[str] = []
    position, attributes, inside, closed = 0, "", 0, False
    while (start := text.find("<", position)) >= 0:
        if (tag := _TAG.match(text, start)) is None or (not open_tags and text[position:start].strip(_BLANKS)):
            raise PacketError(f"packet is not XML (character {start})")
        position, name = tag.end(), tag["name"]
        if name is None:
            continue
        if not open_tags and (closed or name != "Rob" or tag["end"]):
            raise PacketError(f"packet is not XML ({name[:40]!a} outside)" if closed else
                              f"expected <Rob>, got {name[:40]!a}")
        if tag["end"]:
            if open_tags.pop() != name or tag["attributes"] or tag["empty"]:
                raise PacketError(f"packet is not XML ({name[:40]!a} closes another element)")
            if len(open_tags) == 1:
                elements.setdefault(name, []).append((attributes, text[inside:start]))
            closed = not open_tags
        elif tag["empty"]:
            if len(open_tags) == 1:
                elements.setdefault(name, []).append((tag["attributes"], ""))
            closed = not open_tags
        else:
            open_tags.append(name)
            if len(open_tags) == 2:
                attributes, inside = tag["attributes"], position
            if len(open_tags) > _DEPTH:
                raise PacketError(f"packet is nested more than {_DEPTH} levels deep")
    if open_tags or not closed or text[position:].strip(_BLANKS):
        raise PacketError("packet is not XML (it ends before </Rob>, or goes on after it)")
    return elements


def _only(by_name: dict[str, list[_Element]], tag: str) -> _Element | None:
    elements = by_name.get(tag, [])
    if len(elements) > 1:
        raise PacketError(f"{tag} is in the packet {len(elements)} times, expected once")
    return elements[0] if elements else None


def _values(elements: dict[str, list[_Element]], tag: str, names: Sequence[str], some: bool = False,
            others: bool = False) -> Array | None:
    """The numbers of an element's attributes ``(m,)``, None where it is not there.

    Args:
        elements: of the message, by name.
        tag, names: element and attributes.
        some: the first ones may be all there are; else all have to be there.
        others: other attributes may stand beside them.
    """
    element = _only(elements, tag)
    if element is None:
        return None
    pairs = _ATTRIBUTE.findall(element[0])
    # External axes (E1 to E6) may stand beside the arm's own; an A7 would be another arm.
    values = {name: double or single for name, double, single in pairs if names is _EXTERNAL or name[0] != "E"}
    wanted = names[: len(values)] if some and values else names
    sound = set(wanted) <= values.keys() if others else values.keys() == set(wanted)
    if not sound or len({name for name, _, _ in pairs}) != len(pairs):
        raise PacketError(f"{tag} has {' '.join(sorted(values))[:80]!a}, expected {names[0]} to {names[-1]}")
    return np.array([_number(tag, name, values[name]) for name in wanted])


def _number(tag: str, name: str, text: str) -> float:
    # Not strip() without an argument, as Python's blanks differ from those of the pattern and of float().
    if _NUMBER.fullmatch(text := text.strip(_BLANKS)) is None or not math.isfinite(value := float(text)):
        raise PacketError(f"{tag} {name} is no finite number ({text[:40]!a})")
    return value


# The controller's axis angles in degrees and the URDF's joint angles in radians.

@dataclass(frozen=True)
class Axes:
    """Directions and zeros of a controller's axes: ``q = sign · (A - zero)``, joint by joint.

    Attributes:
        sign: 1, or -1 where the controller's direction is opposite to the URDF's ``(n,)``.
        zero: the controller's angle where the URDF's is zero ``(n,)`` [deg].
        known: whether the values are from the robot's data, or assumed equal.
    """

    sign: Array
    zero: Array
    known: bool

    @classmethod
    def of(cls, robot: Robot) -> Axes:
        """The axes by the table ``[rsi]`` of the robot's data: ``axis_sign`` and ``axis_zero`` [deg].

        Raises InputError for a sliding joint, wrong length or values.
        """
        if robot.prismatic.any():
            raise InputError("sliding joints cannot be corrected in degrees; RSI needs an arm with turning joints",
                             file=robot.urdf, field="joint")
        table = robot.data.get("rsi", {})
        sign = _per_axis(table, "axis_sign", np.ones(robot.n))
        if not np.isin(sign, (-1.0, 1.0)).all():
            raise InputError("expected 1 or -1 for every joint", field="rsi.axis_sign", value=sign.tolist())
        return cls(sign, _per_axis(table, "axis_zero", np.zeros(robot.n)), "axis_sign" in table)

    def joints(self, angles: Array) -> Array:
        """Joint angles ``(n,)`` [rad] from axis angles [deg]."""
        return np.asarray(self.sign * np.radians(angles - self.zero))

    def turned(self, degrees: Array) -> Array:
        """Changes of joint angles ``(n,)`` [rad] from changes of axis angles [deg]."""
        return np.asarray(self.sign * np.radians(degrees))

    def angles(self, q: Array) -> Array:
        """Axis angles ``(n,)`` [deg] from joint angles [rad]."""
        return np.asarray(self.sign * np.degrees(q) + self.zero)


def _per_axis(table: dict[str, object], key: str, default: Array) -> Array:
    try:
        values = np.array(table.get(key, default), dtype=float)
    except (TypeError, ValueError):
        values = np.array([])
    if values.shape != default.shape or not np.isfinite(values).all():
        raise InputError(f"expected {len(default)} numbers, one per joint", field=f"rsi.{key}", value=table.get(key))
    return values
