"""A network that is not friendly: whatever comes from elsewhere, the commands are those of an undisturbed run."""

from __future__ import annotations

import gc
import socket
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from ideal_robot.rsi import PacketError
from ideal_robot.rsi.message import parse_rob
from scenes.rsi.run import RsiRun
from scenes.rsi.setup import rsi_server
from tests.ideal_robot.rsi.test_message import PACKET
from tests.scenes.rsi.test_faults import HOME
from tests.scenes.rsi.test_rsi import motion, written
from tests.sim.devices.lagging_controller import LaggingController, playing
from tests.sim.devices.mutator import mutated
from tests.sim.devices.rsi_link import PATIENCE


def test_a_hundred_thousand_mutated_packets_are_refused_or_wholly_sound() -> None:
    rng = np.random.default_rng(16)
    sound, said = 0, set()
    for _ in range(100_000):
        try:
            message = parse_rob(mutated(PACKET, rng), 6)
        except PacketError as error:
            said.add(str(error))
            continue
        sound += 1
        assert 0 <= message.ipoc < 10**18
        assert all(v is None or (v.shape == (6,) and np.isfinite(v).all())
                   for v in (message.actual, message.setpoint, message.current))
    # What a terminal will show has to be short and without control characters.
    assert all(len(text) < 300 and text.isprintable() for text in said)
    # The mutator must leave some sound, or nothing beyond the first check was tried.
    assert 100 < sound < 90_000


def run_of(folder: Path, controller: LaggingController, attacked: bool) -> RsiRun:
    rng = np.random.default_rng(5)
    with (rsi_server(written(folder, motion()), robot="kr6", method="none", port=0, rest=0.4) as server,
          socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger):
        server.link.timeout = PATIENCE
        address, seen = server.link.address, [b""] * 8

        def beside(k: int, packet: bytes) -> list[bytes]:
            if not attacked or k == 0:
                return []
            seen[k % 8] = packet
            for _ in range(40):
                stranger.sendto(mutated(packet, rng), address)
            stranger.sendto(packet, address)
            # From the controller's own address: what is broken, and what is old, in any order.
            return [packet[:200], b"<Rob>" + b"<a>" * 500, *(seen[i] for i in rng.permutation(8) if seen[i] != packet)]

        controller.beside = beside
        with playing(controller, address):
            return server.play(patience=PATIENCE)


@pytest.mark.parametrize("relative", [False, True])
def test_no_command_changes_by_strangers_replays_and_rubbish(tmp_path: Path, relative: bool) -> None:
    quiet, attacked = LaggingController(HOME), LaggingController(HOME)
    quiet_run, run = run_of(tmp_path, quiet, False), run_of(tmp_path, attacked, True)
    assert run.failure is None
    assert quiet_run.failure is None
    assert run.counts["foreign"] > 100 * 41
    assert run.counts["refused"] > 200
    assert run.counts["outdated"] > 500
    N = min(len(quiet.commanded), len(attacked.commanded)) - 1
    np.testing.assert_array_equal(attacked.commanded[:N], quiet.commanded[:N])


def test_memory_does_not_grow_with_what_is_refused() -> None:
    rng = np.random.default_rng(6)
    packets = [mutated(PACKET, rng) for _ in range(500)]

    def all_of_them() -> None:
        for packet in packets:
            try:
                parse_rob(packet, 6)
            except PacketError:
                continue

    all_of_them()
    gc.collect()
    gc.disable()
    tracemalloc.start()
    try:
        all_of_them()
        before = tracemalloc.get_traced_memory()[0]
        for _ in range(5):
            all_of_them()
        assert tracemalloc.get_traced_memory()[0] - before < 2_000
    finally:
        tracemalloc.stop()
        gc.enable()


def test_only_the_controller_that_was_named_is_listened_to(tmp_path: Path) -> None:
    with (rsi_server(written(tmp_path, motion()), robot="kr6", method="none", port=0, controller="10.0.0.7") as server,
          socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger):
        stranger.sendto(PACKET, server.link.address)
        with pytest.raises(Exception, match="no packet from the controller"):
            server.play(patience=0.2)
        assert server.link.counts.foreign == 1


def test_a_server_listens_on_loopback_unless_told_otherwise(tmp_path: Path) -> None:
    with rsi_server(written(tmp_path, motion()), robot="kr6", method="none", port=0) as server:
        assert server.link.address[0] == "127.0.0.1"
