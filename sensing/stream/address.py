"""Addresses of devices on a network, as one gives them on the command line."""

from __future__ import annotations

from ideal_robot.errors import InputError


def host_and_port(rest: str, field: str, port: int | None = None) -> tuple[str, int]:
    """Host and port of ``//host:port``.

    Args:
        rest: what stands behind the scheme and its colon.
        field: what is addressed, for messages.
        port: usual one; it must be given if None.

    Raises:
        InputError: not of that form.
    """
    place = rest.removeprefix("//").partition("?")[0].rstrip("/")
    host, colon, number = place.rpartition(":")
    if not colon and port is not None:
        host, number = place, str(port)
    if not rest.startswith("//") or not host or not number.isdigit() or not 0 < int(number) < 65536:
        raise InputError("expected an address such as stream://192.168.1.30:50000", field=field, value=rest[:80])
    return host.strip("[]"), int(number)


def options(rest: str, known: dict[str, float], field: str) -> dict[str, float]:
    """Numbers behind a question mark, ``?rate=7000&counts_force=1e6``.

    Args:
        rest: what stands behind the scheme and its colon.
        known: names that may be given, with their usual values.
        field: what is addressed, for messages.

    Raises:
        InputError: another name, or no positive number.
    """
    found = dict(known)
    for piece in filter(None, rest.partition("?")[2].split("&")):
        name, _, text = piece.partition("=")
        try:
            value = float(text)
        except ValueError:
            value = -1.0
        if name not in known or not 0.0 <= value < 1e12:
            raise InputError(f"expected {', '.join(known)} with a number", field=field, value=piece[:40])
        found[name] = value
    return found
