"""A controller's clock in a process of its own: sends a packet every cycle and notes when its answer is there.

    python -m scenes.rsi.pacer PORT CYCLE_MS PACKETS A1 … An

prints the delays in ms as a JSON list, null for no answer. Only the standard library: it shall disturb nothing.
"""

from __future__ import annotations

import json
import socket
import sys
import time


def delays(port: int, cycle: float, packets: int, axes: list[float]) -> list[float | None]:
    """From each packet to its answer [ms]; None where there was none within four cycles.

    Args:
        port: UDP port of the server, on this computer.
        cycle: time between packets [s].
        packets: how many.
        axes: axis angles it tells, always the same [deg].
    """
    told = " ".join(f'A{i + 1}="{angle:.6f}"' for i, angle in enumerate(axes))
    sent = [0.0] * packets
    found: list[float | None] = [None] * packets
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        begin = time.perf_counter() + cycle
        for k in range(packets + 4):
            while (left := begin + k * cycle - time.perf_counter()) > 0:
                link.settimeout(left)
                try:
                    answer = link.recv(4096)
                except (TimeoutError, ConnectionError):
                    continue
                stamp = int(answer.split(b"<IPOC>")[1].split(b"<")[0])
                at = (stamp - 1000) // round(1e3 * cycle)
                if found[at] is None:
                    found[at] = 1e3 * (time.perf_counter() - sent[at])
            if k < packets:
                stamp = 1000 + k * round(1e3 * cycle)
                sent[k] = time.perf_counter()
                link.sendto(f'<Rob Type="KUKA"><AIPos {told}/><IPOC>{stamp}</IPOC></Rob>'.encode(),
                            ("127.0.0.1", port))
    return found


if __name__ == "__main__":
    print(json.dumps(delays(int(sys.argv[1]), 1e-3 * int(sys.argv[2]), int(sys.argv[3]),
                            [float(angle) for angle in sys.argv[4:]])))
