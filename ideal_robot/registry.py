"""Registries of implementations by name: those of this project, and those of other packages.

A package outside adds one by ``register`` or, without being imported by anybody, by an entry point:

    [project.entry-points."ideal_robot.feedforward"]
    my_method = "my_package.my_module:MyFeedforward"

Built-in implementations are given as ``"module:attribute"`` and imported on first use.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib import metadata
from typing import Generic, TypeVar, cast

from ideal_robot.errors import InputError

T = TypeVar("T")


def imported(implementation: T | str) -> T:
    """The object named by ``"module:attribute"``; any other argument is returned unchanged."""
    if not isinstance(implementation, str):
        return implementation
    return cast(T, metadata.EntryPoint("", implementation, "").load())


def in_words(name: str) -> str:
    """A registered name, or another key of files, in words: ``gear_play`` as "gear play"."""
    return name.replace("_", " ")


class Registry(Generic[T]):
    """Implementations of one interface by name.

    Args:
        seam: name of the interface, in the singular, for messages (``"effect"``).
        group: entry-point group of other packages.
        built_in: name → ``"module:attribute"``, in the order of tables.
        wanted, fits: expected form of a name, in words, and a check of it; by default every name is accepted.
    """

    def __init__(self, seam: str, group: str, built_in: dict[str, str], wanted: str = "a name",
                 fits: Callable[[str], bool] = bool) -> None:
        self.seam, self.group = seam, group
        self._wanted, self._fits = wanted, fits
        self._known: dict[str, T | str] = dict(built_in)
        self._read_entry_points = False

    def register(self, name: str, implementation: T) -> None:
        """Adds an implementation; raises InputError for a name that is not accepted or already used."""
        self._read()
        if not self._fits(name):
            raise InputError(f"expected {self._wanted}", field="key", value=name)
        if name in self._known and self._known[name] is not implementation:
            raise InputError(f"another {self.seam} has that name already; choose another name", field=self.seam,
                             value=name)
        self._known[name] = implementation

    def unregister(self, name: str) -> None:
        """Removes an implementation that ``register`` added; does nothing if there is none."""
        self._known.pop(name, None)

    def names(self) -> tuple[str, ...]:
        """All names, the built-in ones first."""
        self._read()
        return tuple(self._known)

    def get(self, name: str) -> T:
        """The implementation of a name; raises InputError for an unknown name, or a failed import."""
        self._read()
        if name not in self._known:
            raise InputError(f"expected one of {', '.join(self._known)}", field=self.seam, value=name)
        try:
            implementation = self._known[name] = imported(self._known[name])
        except (AttributeError, ImportError) as error:
            raise InputError(f"cannot be imported ({error}); mend the entry point, or uninstall the package that has "
                             "it", field=self.seam, value=f"{name} = {self._known[name]}") from error
        return implementation

    def __iter__(self) -> Iterator[tuple[str, T]]:
        return ((name, self.get(name)) for name in self.names())

    def __contains__(self, name: object) -> bool:
        self._read()
        return name in self._known

    def _read(self) -> None:
        if self._read_entry_points:
            return
        for point in metadata.entry_points(group=self.group):
            wrong = "" if self._fits(point.name) else f"expected {self._wanted}"
            if not wrong and self._known.setdefault(point.name, point.value) != point.value:
                wrong = f"another {self.seam} has that name already"
            if wrong:
                raise InputError(f"{wrong}; rename the entry point of the installed package, or uninstall it",
                                 field=self.group, value=f"{point.name} = {point.value}")
        self._read_entry_points = True
