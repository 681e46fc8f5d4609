"""The device's side of a stream for tests: accepts clients one after the other and sends what it is told."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager


def package(kind: int, stamp: float, payload: bytes) -> bytes:
    return struct.pack(">2sBBId", b"IR", 1, kind, len(payload), stamp) + payload


@contextmanager
def device(hello: bytes, messages: Callable[[int], bytes | None], *, clock: Callable[[], float] = time.perf_counter,
           every: float = 0.01) -> Iterator[tuple[str, int]]:
    """Sends ``hello`` and then ``messages(k)`` every so often until it gives None, which closes the connection."""
    stopped, count = threading.Event(), 0
    listener = socket.create_server(("127.0.0.1", 0))
    listener.settimeout(0.05)

    def answers(client: socket.socket) -> None:
        with client:
            while not stopped.is_set():
                try:
                    asked = client.recv(4096)
                except OSError:
                    return
                if not asked:
                    return
                for i in range(0, len(asked) - 23, 24):
                    try:
                        client.sendall(package(6, clock(), asked[i + 16 : i + 24]))
                    except OSError:
                        return

    def serve() -> None:
        nonlocal count
        while not stopped.is_set():
            try:
                client, _ = listener.accept()
            except TimeoutError:
                continue
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            threading.Thread(target=answers, args=(client,), daemon=True).start()
            try:
                client.sendall(hello)
                while not stopped.is_set() and (message := messages(count)) is not None:
                    count += 1
                    client.sendall(message)
                    time.sleep(every)
                count += 1
                client.shutdown(socket.SHUT_RDWR)
            except OSError:
                continue

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield listener.getsockname()
    finally:
        stopped.set()
        thread.join(5.0)
        listener.close()
