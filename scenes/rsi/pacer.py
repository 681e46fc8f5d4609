"""A controller's clock in a process of its own: sends a packet every cycle and notes when its answer is there.

    python -m scenes.rsi.pacer PORT CYCLE_MS PACKETS A1 … An

prints the delays in ms as a JSON list, null for no answer. Only the standard library: it shall disturb nothing.
"""

from __future__ import annotations

import json
import os
import socket
import struct
import sys
import time
from contextlib import suppress

_TIMESTAMP = 35
"""``SO_TIMESTAMPNS`` of Linux, which Python does not name."""
_PATIENCE = 20.0
"""How long the first answer is waited for [s]."""
_AFTER = 4
"""Packets behind the last that counts."""


def delays(port: int, cycle: float, packets: int, axes: list[float]) -> list[float | None]:
    """From each packet to its answer [ms], from the first that was answered on; None where there was none.

    Args:
        port: UDP port of the server, on this computer.
        cycle: time between packets [s].
        packets: how many, from the first that was answered on.
        axes: axis angles it tells, always the same [deg].
    """
    told = " ".join(f'A{i + 1}="{angle:.6f}"' for i, angle in enumerate(axes))
    step = round(1e3 * cycle)
    most = packets + round(_PATIENCE / cycle)
    sent, first = [0.0] * most, most
    found: list[float | None] = [None] * most
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        if sys.platform.startswith("linux"):
            link.setsockopt(socket.SOL_SOCKET, _TIMESTAMP, 1)
        due = time.time() + cycle
        for k in range(most):
            if k >= first + packets + _AFTER:
                break
            while (left := due - time.time()) > 0:
                link.settimeout(left)
                try:
                    answer, arrived = _received(link)
                except (TimeoutError, ConnectionError):
                    continue
                at = (int(answer.split(b"<IPOC>")[1].split(b"<")[0]) - 1000) // step
                if found[at] is None:
                    found[at], first = 1e3 * (arrived - sent[at]), min(first, at)
            now = time.time()
            # Late itself, it goes on from now: two packets at once would be no fault of the server's.
            due = max(due, now - 0.1 * cycle) + cycle
            sent[k] = now
            link.sendto(f'<Rob Type="KUKA"><AIPos {told}/><IPOC>{1000 + k * step}</IPOC></Rob>'.encode(),
                        ("127.0.0.1", port))
    return found[first : first + packets]


def _received(link: socket.socket) -> tuple[bytes, float]:
    """A packet and when the system had it [s], which is before this process was let run."""
    packet, extra, _, _ = link.recvmsg(4096, 64)
    for level, kind, data in extra:
        if (level, kind) == (socket.SOL_SOCKET, _TIMESTAMP):
            seconds, nanoseconds = struct.unpack("@ll", data[: struct.calcsize("@ll")])
            return packet, seconds + 1e-9 * nanoseconds
    return packet, time.time()


if __name__ == "__main__":
    # A controller is punctual; where that is not permitted, some of its lateness counts as the server's.
    if hasattr(os, "sched_setscheduler"):
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(60))
    print(json.dumps(delays(int(sys.argv[1]), 1e-3 * int(sys.argv[2]), int(sys.argv[3]),
                            [float(angle) for angle in sys.argv[4:]])))
