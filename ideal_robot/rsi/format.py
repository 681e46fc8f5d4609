"""How one controller's messages are named: tags, sender type, decimals; read from its own RSI ethernet XML if given."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from ideal_robot.errors import InputError

MAX_FILE = 65536
"""Largest configuration that is read [bytes]; a controller's has two to six thousand."""

_NAME = re.compile(r"[A-Za-z_][\w.-]{0,63}", re.ASCII)


@dataclass(frozen=True)
class RsiFormat:
    """What a controller calls the parts of its messages.

    Attributes:
        correction: element with the axis corrections in our answer; ``AK``, ``AKorr`` …
        sender: ``Type`` of our answer, ``SENTYPE`` in the controller's configuration.
        decimals: decimals of a correction in degrees.
        hold_on: what the controller takes where no answer came in time: the last values again, or none. None where
            nothing says so.
        port: UDP port to which the controller sends, where its configuration says so.
        sends_delay: whether the controller tells the answers it counted as late; None where nothing says so.

    Raises:
        InputError: a name that no XML element may have, another number of decimals than 1 to 9.
    """

    correction: str = "AK"
    sender: str = "ImFree"
    decimals: int = 6
    hold_on: bool | None = None
    port: int | None = None
    sends_delay: bool | None = None

    def __post_init__(self) -> None:
        for name in ("correction", "sender"):
            if _NAME.fullmatch(getattr(self, name)) is None:
                raise InputError("expected a plain XML name", field=name, value=getattr(self, name)[:64])
        if not 1 <= self.decimals <= 9:
            raise InputError("expected 1 to 9 decimals", field="decimals", value=self.decimals)

    @classmethod
    def read(cls, file: str | Path, n: int, correction: str | None = None) -> RsiFormat:
        """From the controller's RSI ethernet XML (``CONFIG``, ``SEND``, ``RECEIVE``).

        Args:
            file: the file as it lies on the controller.
            n: number of axes.
            correction: element to be used where several hold axis corrections; None if there is only one.

        Raises:
            InputError: unreadable or too large, no such XML, declarations or entities, measured axes not sent, no
                element with ``n`` axis corrections or several, ``HOLDON`` that differs between axes.
        """
        root = _root(Path(file))
        sent = {element.get("TAG", "") for element in root.findall("SEND/ELEMENTS/ELEMENT")}
        if "DEF_AIPos" not in sent:
            raise InputError('the controller does not send measured axes; add <ELEMENT TAG="DEF_AIPos" TYPE="DOUBLE" '
                             'INDX="INTERNAL"/> to SEND', file=file, field="SEND")
        received: dict[str, dict[str, str]] = {}
        for element in root.findall("RECEIVE/ELEMENTS/ELEMENT"):
            group, _, axis = element.get("TAG", "").partition(".")
            received.setdefault(group, {})[axis] = element.get("HOLDON", "1")
        axes = [f"A{i + 1}" for i in range(n)]
        groups = [group for group, found in received.items() if all(axis in found for axis in axes)]
        if correction is not None:
            groups = [group for group in groups if group == correction]
        if len(groups) != 1:
            raise InputError(f"expected one element with corrections A1 to A{n} in RECEIVE, found "
                             f"{', '.join(groups)[:80] or 'none'}; name it with --tag", file=file, field="RECEIVE")
        hold = {received[groups[0]][axis].strip() for axis in axes}
        if len(hold) != 1 or not hold <= {"0", "1"}:
            raise InputError("expected HOLDON 0 or 1, the same for all axes", file=file, field="HOLDON",
                             value=sorted(hold))
        port = (root.findtext("CONFIG/PORT") or "").strip()
        if not (port.isascii() and port.isdigit() and 0 < int(port[:6]) < 65536):
            raise InputError("expected a UDP port", file=file, field="CONFIG.PORT", value=port[:40])
        return cls(correction=groups[0], sender=(root.findtext("CONFIG/SENTYPE") or cls.sender).strip(),
                   hold_on=hold == {"1"}, port=int(port), sends_delay="DEF_Delay" in sent)


def _root(file: Path) -> ElementTree.Element:
    """The root of a configuration that is small and declares nothing."""
    if not file.is_file():
        # One that is read without an end, or waits for a writer, is none either.
        raise InputError("cannot be read: no such file", file=file)
    try:
        with file.open("rb") as stream:
            text = stream.read(MAX_FILE + 1)
    except OSError as error:
        raise InputError(f"cannot be read ({error})", file=file) from error
    if len(text) > MAX_FILE:
        raise InputError(f"has more than {MAX_FILE} bytes", file=file)
    # Entities are how small files become large ones; a zero byte is how UTF-16 would hide them from this check.
    if b"\0" in text or b"<!DOCTYPE" in text or b"<!ENTITY" in text:
        raise InputError("holds a document type, an entity or zero bytes; none has a place here", file=file)
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise InputError(f"is not XML ({error})", file=file) from error
    if root.tag != "ROOT" or root.find("CONFIG") is None:
        raise InputError("is no RSI ethernet configuration (<ROOT><CONFIG>…)", file=file, value=root.tag[:40])
    return root
