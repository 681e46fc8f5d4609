"""What is under way from a device to the controller."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Generic, Protocol, TypeVar


class Late(Protocol):
    """Something that is available some time after it was measured."""

    @property
    def t_arrival(self) -> float:
        """Controller time at which it is available [s]."""
        ...


T = TypeVar("T", bound=Late)


class Arrivals(Generic[T]):
    """Holds what was sent until it arrives."""

    def __init__(self) -> None:
        self._under_way: list[T] = []

    def send(self, items: Iterable[T]) -> None:
        """Puts items on their way."""
        self._under_way.extend(items)

    def arrived(self, t: float) -> list[T]:
        """What has arrived by ``t`` [s], in order of arrival, each once."""
        here = sorted((item for item in self._under_way if item.t_arrival <= t), key=lambda item: item.t_arrival)
        self._under_way = [item for item in self._under_way if item.t_arrival > t]
        return here
