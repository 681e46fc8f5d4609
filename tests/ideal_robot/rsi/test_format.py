"""The controller's own configuration: what is read from it, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ideal_robot.errors import InputError
from ideal_robot.rsi.format import MAX_FILE, RsiFormat
from ideal_robot.rsi.message import format_sen

AXES = "".join(f'<ELEMENT TAG="AKorr.A{i}" TYPE="DOUBLE" INDX="{i}" HOLDON="1"/>' for i in range(1, 7))
CONFIG = ('<?xml version="1.0"?><ROOT><CONFIG><IP_NUMBER>10.0.0.1</IP_NUMBER><PORT>6008</PORT><SENTYPE>Mine</SENTYPE>'
          '<ONLYSEND>FALSE</ONLYSEND></CONFIG><!-- sent --><SEND><ELEMENTS><ELEMENT TAG="DEF_AIPos" TYPE="DOUBLE" '
          'INDX="INTERNAL"/><ELEMENT TAG="DEF_Delay" TYPE="LONG" INDX="INTERNAL"/></ELEMENTS></SEND><RECEIVE><ELEMENTS>'
          f'<ELEMENT TAG="RKorr.X" TYPE="DOUBLE" INDX="9" HOLDON="1"/>{AXES}</ELEMENTS></RECEIVE></ROOT>')


def written(folder: Path, text: str) -> Path:
    file = folder / "ethernet.xml"
    file.write_text(text, encoding="latin-1")
    return file


def test_tag_sender_port_and_hold_are_the_controllers(tmp_path: Path) -> None:
    form = RsiFormat.read(written(tmp_path, CONFIG), 6)
    assert form == RsiFormat("AKorr", "Mine", 6, True, 6008, True)
    assert format_sen(np.array([0.5, -1.0]), 7, RsiFormat("AKorr", "Mine", 3)) == (
        b'<Sen Type="Mine"><AKorr A1="0.500" A2="-1.000"/><IPOC>7</IPOC></Sen>')


def test_of_two_elements_with_axes_one_has_to_be_named(tmp_path: Path) -> None:
    file = written(tmp_path, CONFIG.replace(AXES, AXES + AXES.replace("AKorr", "AK")))
    with pytest.raises(InputError, match=r"AKorr, AK.*--tag"):
        RsiFormat.read(file, 6)
    assert RsiFormat.read(file, 6, "AK").correction == "AK"


@pytest.mark.parametrize(("old", "new", "says"), [
    ("DEF_AIPos", "DEF_RIst", "does not send measured axes"),
    ("AKorr.A6", "AKorr.E6", "found none"),
    ('INDX="6" HOLDON="1"', 'INDX="6" HOLDON="0"', "the same for all axes"),
    ("6008", "99999", "expected a UDP port"),
    ("<ROOT>", '<!DOCTYPE ROOT [<!ENTITY a SYSTEM "file:///etc/passwd">]><ROOT>', "entity"),
    ("<SEND>", "<SEND><SEND>", "is not XML"),
    ("ROOT>", "RUT>", "no RSI ethernet configuration"),
    ("Mine", "a b", "plain XML name"),
    ("<SEND>", "<SEND>" + " " * MAX_FILE, "more than"),
])
def test_what_cannot_be_used_is_refused_and_named(tmp_path: Path, old: str, new: str, says: str) -> None:
    assert old in CONFIG
    with pytest.raises(InputError, match=says):
        RsiFormat.read(written(tmp_path, CONFIG.replace(old, new)), 6)
    with pytest.raises(InputError, match="cannot be read"):
        RsiFormat.read(tmp_path / "missing.xml", 6)
