"""What is read from the network, and above all what is not."""

from __future__ import annotations

import gc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ideal_robot.bounded_values import RSI_BYTES
from ideal_robot.errors import InputError
from ideal_robot.rsi import PacketError
from ideal_robot.rsi.message import MAX_PACKET, RsiFormat, format_sen, parse_rob

PACKET = (b'<Rob Type="KUKA"><RIst X="1.0" Y="2.0" Z="3.0" A="0.0" B="0.0" C="0.0"/>'
          b'<AIPos A1="0.5" A2="-90.25" A3="90.0" A4="1e-3" A5="+45." A6="-.5"/>'
          b'<ASPos A1="0.0" A2="-90.0" A3="90.0" A4="0.0" A5="45.0" A6="0.0"/>'
          b'<MACur A1="1.5" A2="-2.5" A3="3.5" A4="0.1" A5="0.2" A6="0.3"/>'
          b'<Delay D="3"/><Tech C11="0.0"/><IPOC>4208163634</IPOC></Rob>')


def test_a_controllers_packet_is_read() -> None:
    message = parse_rob(PACKET, 6)
    assert message.ipoc == 4208163634
    assert message.late == 3
    np.testing.assert_array_equal(message.actual, [0.5, -90.25, 90.0, 1e-3, 45.0, -0.5])
    np.testing.assert_array_equal(message.setpoint, [0.0, -90.0, 90.0, 0.0, 45.0, 0.0])
    np.testing.assert_array_equal(message.current, [1.5, -2.5, 3.5, 0.1, 0.2, 0.3])


def test_what_is_not_sent_is_none() -> None:
    message = parse_rob(b'<Rob><AIPos A1="1" A2="2"/><IPOC>7</IPOC></Rob>', 2)
    assert (message.setpoint, message.current, message.late) == (None, None, None)


def test_the_answer_is_what_a_controller_expects() -> None:
    answer = format_sen(np.array([0.1, -2.0, 1e-9]), 4208163634, RsiFormat())
    assert answer == (b'<Sen Type="ImFree"><AK A1="0.100000" A2="-2.000000" A3="0.000000"/>'
                      b"<IPOC>4208163634</IPOC></Sen>")


@pytest.mark.parametrize(("old", "new", "says"), [
    (b"<Rob", b"<Sen", "expected <Rob>, got 'Sen'"),
    (b"Rob", b"Sen", "expected <Rob>"),
    (b"</Rob>", b"", "not XML"),
    (b"<Tech", b"\0<Tech", "zero byte"),
    (b"<Tech", b"<![CDATA[<Tech]]><Tech", "declaration"),
    (b"<Tech", b"<a><Tech", "closes another"),
    (b"<Tech", b"<a>" * 20 + b"<Tech", "nested more than"),
    (b"</Rob>", b"</Rob><Rob></Rob>", "outside"),
    (b"</Rob>", b"</Rob>more", "goes on after"),
    (b"<AIPos", b'<AIPos/><AIPos', "AIPos is in the packet 2 times"),
    (b'A1="0.5"', b'A1="0.5" A1="0.7"', "AIPos has"),
    (b"<Rob", b'<!DOCTYPE Rob [<!ENTITY a "b">]><Rob', "entity"),
    (b"<IPOC>4208163634</IPOC>", b"", "IPOC is missing"),
    (b"4208163634", b"-4", "IPOC is no whole number"),
    (b"4208163634", b"12.5", "IPOC is no whole number"),
    (b"4208163634", b"9" * 40, "IPOC is no whole number"),
    (b"<IPOC>", b"<IPOC>1</IPOC><IPOC>", "IPOC is in the packet 2 times"),
    (b"AIPos", b"APos", "AIPos is missing"),
    (b'A1="0.5"', b'A1="nan"', "AIPos A1 is no finite number"),
    (b'A1="0.5"', b'A1="inf"', "AIPos A1"),
    (b'A1="0.5"', b'A1="1e999"', "AIPos A1"),
    (b'A1="0.5"', b'A1="1_0"', "AIPos A1"),
    (b'A1="0.5"', b'A1=""', "AIPos A1"),
    (b'A1="0.5"', b'A1="\x1e0.5"', "AIPos A1"),
    (b'A1="0.5" ', b"", "expected A1 to A6"),
    (b'A1="0.5"', b'A1="0.5" A7="0"', "expected A1 to A6"),
    (b"<Tech", b" " * MAX_PACKET + b"<Tech", "more than"),
])
def test_what_is_wrong_is_refused_and_named(old: bytes, new: bytes, says: str) -> None:
    assert old in PACKET
    with pytest.raises(PacketError, match=says):
        parse_rob(PACKET.replace(old, new, 1 if old == b"<Rob" else -1), 6)


@pytest.mark.parametrize(("old", "new"), [
    (b"<Tech", b"<!-- A1=\"7\" <b> --><Tech"),
    (b"</Rob>", b"</Rob>\0\0\r\n"),
    (b"<Rob", b'<?xml version="1.0" encoding="ISO-8859-1"?>\n<Rob'),
    (b"<Tech", b"<Name>M\xfcller</Name><Tech"),
    (b"<Tech", b"<EStr>robot info: &lt;</EStr><a><b><AIPos/></b></a><Tech"),
    (b'Type="KUKA"', b"TYPE='KUKA'"),
    (b'A1="0.5" A2="-90.25"', b'A2="-90.25"\n\tA1 = "0.5" E1="12.5"'),
    (b'D="3"', b'D="3.0"'),
])
def test_what_controllers_do_besides_is_no_reason_to_refuse(old: bytes, new: bytes) -> None:
    assert old in PACKET
    message, plain = parse_rob(PACKET.replace(old, new, 1), 6), parse_rob(PACKET, 6)
    assert (message.ipoc, message.late, message.ignored) == (plain.ipoc, plain.late, ())
    np.testing.assert_array_equal(message.actual, plain.actual)


@pytest.mark.parametrize(("old", "new", "name"), [
    (b'D="3"', b'D="x"', "Delay"), (b'D="3"', b"", "Delay"), (b'D="3"/>', b'D="3"/><Delay D="4"/>', "Delay"),
    (b'A1="1.5"', b'A1="nan"', "MACur"), (b'<ASPos A1="0.0"', b"<ASPos", "ASPos"),
    (b"<ASPos", b"<ASPos/><ASPos", "ASPos"),
])
def test_what_is_optional_and_wrong_is_left_out_and_named(old: bytes, new: bytes, name: str) -> None:
    assert old in PACKET
    message = parse_rob(PACKET.replace(old, new, 1), 6)
    assert message.ignored == (name,)
    assert {"Delay": message.late, "ASPos": message.setpoint, "MACur": message.current}[name] is None
    assert message.ipoc == 4208163634


def test_rubbish_leaves_nothing_for_the_garbage_collection() -> None:
    packet = b"<Rob>" + b"<a>" * 1300
    gc.collect()
    gc.disable()
    try:
        for _ in range(200):
            with pytest.raises(PacketError):
                parse_rob(packet, 6)
        assert gc.collect() < 20
    finally:
        gc.enable()


@given(st.binary(max_size=300))
def test_no_bytes_raise_anything_else(packet: bytes) -> None:
    with pytest.raises(PacketError):
        parse_rob(packet, 6)


@given(st.lists(st.floats(-1e6, 1e6), min_size=6, max_size=6), st.integers(0, 10**12))
def test_numbers_survive_the_way_there(angles: list[float], ipoc: int) -> None:
    axes = " ".join(f'A{i + 1}="{value!r}"' for i, value in enumerate(angles))
    message = parse_rob(f'<Rob Type="KUKA"><AIPos {axes}/><IPOC>{ipoc}</IPOC></Rob>'.encode(), 6)
    assert message.actual.tolist() == angles
    assert message.ipoc == ipoc


# The controller's own configuration: what is read from it, and what is refused.

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
    assert form == RsiFormat("AKorr", "Mine", 6, True, 6008)
    assert format_sen(np.array([0.5, -1.0]), 7, RsiFormat("AKorr", "Mine", 3)) == (
        b'<Sen Type="Mine"><AKorr A1="0.500" A2="-1.000"/><IPOC>7</IPOC></Sen>')


def test_of_two_elements_with_axes_one_has_to_be_named(tmp_path: Path) -> None:
    file = written(tmp_path, CONFIG.replace(AXES, AXES + AXES.replace("AKorr", "AK")))
    with pytest.raises(InputError, match=r"AKorr, AK.*--tag"):
        RsiFormat.read(file, 6)
    assert RsiFormat.read(file, 6, "AK").correction == "AK"


def pose_config(group: str, names: str = "XYZABC") -> str:
    """A configuration that takes corrections of the pose."""
    pose = "".join(f'<ELEMENT TAG="{group}.{axis}" TYPE="DOUBLE" INDX="{i}" HOLDON="1"/>'
                   for i, axis in enumerate(names, 1))
    return CONFIG.replace(AXES, pose).replace("<SEND><ELEMENTS>", '<SEND><ELEMENTS><ELEMENT TAG="DEF_RIst"/>')


@pytest.mark.parametrize("group", ["RKorr", "POSCORR", "Seam"])
def test_corrections_of_the_pose_are_read_where_the_axes_are_not_corrected(group: str, tmp_path: Path) -> None:
    file = written(tmp_path, pose_config(group))
    for tag in (None, group):
        form = RsiFormat.read(file, 6, tag)
        assert form.pose
        assert form.correction == group
    with pytest.raises(InputError, match="no element Other"):
        RsiFormat.read(file, 6, "Other")
    both = written(tmp_path, pose_config(group).replace("<RECEIVE><ELEMENTS>", "<RECEIVE><ELEMENTS>" + AXES))
    assert not RsiFormat.read(both, 6).pose
    assert RsiFormat.read(both, 6, group).pose
    answer = format_sen(np.array([1.5, -2.0, 0.25, 0.1, 0.0, -0.5]), 7, replace(form, decimals=3))
    assert f'<{group} X="1.500" Y="-2.000" Z="0.250" A="0.100" B="0.000" C="-0.500"/>'.encode() in answer


@pytest.mark.parametrize(("config", "n", "says"), [
    (pose_config("RKorr", "XYZ"), 6, "all of X, Y, Z, A, B and C"),
    (pose_config("RKorr"), 7, "move six axes; the robot has 7 joints"),
    (pose_config("RKorr").replace("DEF_RIst", "DEF_RSol"), 6, "does not send its pose"),
    (pose_config("RKorr").replace('INDX="6" HOLDON="1"', 'INDX="6" HOLDON="0"'), 6, "the same for all"),
])
def test_poses_that_cannot_be_corrected_are_refused(config: str, n: int, says: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=says):
        RsiFormat.read(written(tmp_path, config), n)


def test_a_pose_is_needed_where_it_is_corrected_and_external_axes_are_read_where_they_are_held() -> None:
    pose = PACKET.replace(b'C="0.0"/>', b'C="6" S="2" T="35"/><EIPos E1="7" E2="8"/>', 1)
    form = RsiFormat("RKorr", pose=True, held=("EK.E1", "EK.E2"))
    message = parse_rob(pose, 6, form)
    assert message.pose is not None
    np.testing.assert_array_equal(message.pose, [1, 2, 3, 0, 0, 6])
    np.testing.assert_array_equal(message.external, [7, 8])
    with pytest.raises(PacketError, match="RIst"):
        parse_rob(pose.replace(b"RIst", b"RSol"), 6, form)
    assert parse_rob(pose.replace(b"RIst", b"RSol"), 6).pose is None
    assert b'<EK E1="0.000000" E2="0.000000"/>' in format_sen(np.zeros(6), 7, form)


@pytest.mark.parametrize("count", [1, 3])
def test_external_axes_are_held_and_an_arm_with_its_track_is_told_so(count: int, tmp_path: Path) -> None:
    track = "".join(f'<ELEMENT TAG="EK.E{i}" TYPE="DOUBLE" INDX="{6 + i}" HOLDON="1"/>' for i in range(1, count + 1))
    file = written(tmp_path, CONFIG.replace(AXES, AXES + track))
    form = RsiFormat.read(file, 6)
    assert form.correction == "AKorr"
    assert form.held == tuple(f"EK.E{i}" for i in range(1, count + 1))
    with pytest.raises(InputError, match=f"6 axes and {count} external axes, which are held, the robot has 7 joints"):
        RsiFormat.read(file, 7)


@pytest.mark.parametrize(("old", "new", "says"), [
    ("DEF_AIPos", "DEF_RIst", "does not send measured axes"),
    ("AKorr.A6", "AKorr.E6", "corrections of 5 axes and 1 external axes"),
    ("AKorr.A6", "AKorr.A7", "no element holds corrections of all axes"),
    ("<CONFIG>", "<CONFIG><ONLYSEND>true</ONLYSEND>", "ONLYSEND to FALSE"),
    ('INDX="6" HOLDON="1"', 'INDX="6" HOLDON="0"', "the same for all of an element"),
    ("6008", "99999", "expected a UDP port"),
    ("<ROOT>", '<!DOCTYPE ROOT [<!ENTITY a SYSTEM "file:///etc/passwd">]><ROOT>', "entity"),
    ("<SEND>", "<SEND><SEND>", "is not XML"),
    ("ROOT>", "RUT>", "no RSI ethernet configuration"),
    ("Mine", "a b", "plain XML name"),
    ("<SEND>", "<SEND>" + " " * RSI_BYTES.most, "at most 65536"),
])
def test_what_cannot_be_used_is_refused_and_named(tmp_path: Path, old: str, new: str, says: str) -> None:
    assert old in CONFIG
    with pytest.raises(InputError, match=says):
        RsiFormat.read(written(tmp_path, CONFIG.replace(old, new)), 6)
    with pytest.raises(InputError, match="cannot be read"):
        RsiFormat.read(tmp_path / "missing.xml", 6)
