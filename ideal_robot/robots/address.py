"""Addresses of devices: ``scheme://host:port/path?name=value``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Self
from urllib.parse import parse_qsl, unquote, urlsplit

from ideal_robot.errors import InputError, did_you_mean

_SHOWN = 80
"""Characters of an address that a message repeats."""


@dataclass(frozen=True)
class Address:
    """The parts of an address.

    Attributes:
        scheme: text before the colon.
        host: empty where none is given.
        port: None where none is given.
        path: with its first slash; empty where none is given.
        options: entries after the question mark.
        text: the whole, for messages.
        option: the command line's name of it, for messages.
    """

    scheme: str
    host: str = ""
    port: int | None = None
    path: str = ""
    options: Mapping[str, str] = field(default_factory=dict)
    text: str = ""
    option: str = "--arm"

    @classmethod
    def parse(cls, text: str, option: str = "--arm", example: str = "rtde://192.168.1.30") -> Self:
        """An address from its text.

        Args:
            text: ``scheme://host:port/path?name=value``; all but the scheme may be missing.
            option: the command line's name of it, for messages.
            example: an address of the kind that is expected, for messages.

        Raises:
            InputError: no address, or no port from 1 to 65535.

        >>> Address.parse("egm://:6510?cycle=0.004").port
        6510
        """
        def refused() -> InputError:
            return InputError(f"expected an address such as {example}", field=option, value=text[:_SHOWN])

        if "://" not in text or not text.isprintable():
            raise refused()
        try:
            parts = urlsplit(text)
            port = parts.port
            pairs = parse_qsl(parts.query, keep_blank_values=True, strict_parsing=bool(parts.query))
        except ValueError as error:
            raise refused() from error
        if not parts.scheme or port == 0 or parts.username is not None or len(dict(pairs)) < len(pairs):
            raise refused()
        return cls(parts.scheme, parts.hostname or "", port, unquote(parts.path), dict(pairs), text, option)

    def at(self, port: int, host: str | None = None) -> tuple[str, int]:
        """Host and port with their defaults; InputError where a host is missing and there is no default."""
        if not (self.host or host):
            raise InputError(f"expected an address with a host such as {self.scheme}://192.168.1.30", field=self.option,
                             value=self.text[:_SHOWN])
        return self.host or str(host), self.port or port

    def knows(self, *names: str) -> None:
        """Raises InputError for an option of the address that is not among these names."""
        for name in self.options:
            if name not in names:
                known = f"expected {', '.join(names)}" if names else "this interface has no options"
                raise InputError(f"{did_you_mean(name, names)}{known}", field=f"{self.option} ?{name[:_SHOWN]}")

    def number(self, name: str, usual: float, low: float, high: float) -> float:
        """An option as a number.

        Args:
            name: of the option.
            usual: default value.
            low, high: limits, themselves allowed.

        Raises:
            InputError: no number, or one beyond the limits.
        """
        text = self.options.get(name)
        if text is None:
            return usual
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not low <= value <= high:
            raise InputError(f"expected a number from {low:g} to {high:g}", field=f"{self.option} ?{name}",
                             value=text[:_SHOWN])
        return value
