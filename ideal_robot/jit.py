"""Compiled functions whose machine code is kept beside the source: what is kept may be damaged, or not be writable.

numba keeps an index and a data file a signature, and trusts both. Here every signature has one file with a checksum: a
file that is cut off, empty or altered counts as missing, and two processes that compile at a time cannot mix up what
belongs to whom. Where no folder can be written, code that is there is used, and other code is compiled in every run.

``cache=True`` alone does neither: an index that is cut off ends the first call with an error of ``pickle``, and in an
installation of another user the code that was compiled there is not looked for.
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile
from numba.core.serialize import dumps

_Function = TypeVar("_Function", bound=Callable[..., Any])
_IN_TREE = CompileResultCacheImpl._locator_classes[1]
"""numba's way to the folder beside the source."""
_DIGEST = 32  # bytes of SHA-256


def jit(**options: Any) -> Callable[[_Function], _Function]:
    """Compiles a function as ``numba.njit(**options)`` does, at its first call with such arguments; keeps the code."""
    def compiled(function: _Function) -> _Function:
        dispatcher = numba.njit(**options)(function)
        dispatcher._cache = _KeptCode(function)
        compiled: _Function = dispatcher
        return compiled

    return compiled


class _Beside(_IN_TREE):  # type: ignore[valid-type, misc]
    """The folder beside the source where it cannot be written, e.g. an installation of another user."""

    def ensure_cache_path(self) -> None:
        """What is there can be read; nothing is made."""


class _Places(CompileResultCacheImpl):
    _locator_classes = [*CompileResultCacheImpl._locator_classes, _Beside]  # noqa: RUF012


class _KeptFiles(IndexDataCacheFile):
    """One file a signature: a digest, then what it belongs to and the code."""

    def load(self, key: Any) -> Any:
        """What is kept under ``key``; None where nothing sound is."""
        try:
            raw = self._path(key).read_bytes()
        except OSError:
            return None
        if raw[:_DIGEST] != hashlib.sha256(raw[_DIGEST:]).digest():
            return None
        whose, data = pickle.loads(raw[_DIGEST:])
        return data if whose == self._whose(key) else None

    def save(self, key: Any, data: Any) -> None:
        """Keeps ``data`` under ``key``, whole or not at all; raises OSError."""
        raw = dumps((self._whose(key), data))
        with self._open_for_write(str(self._path(key))) as file:
            file.write(hashlib.sha256(raw).digest() + raw)

    def _whose(self, key: Any) -> tuple[Any, ...]:
        return self._version, self._source_stamp, key

    def _path(self, key: Any) -> Path:
        # The third is a digest of the function's own code: what changed takes the file of what was before.
        signature, target, _ = key
        name = hashlib.sha256(repr((signature, target)).encode()).hexdigest()[:16]
        return Path(self._cache_path) / f"{self._index_name.removesuffix('.nbi')}.{name}.nbc"


class _KeptCode(FunctionCache):
    _impl_class = _Places

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._cache_file = _KeptFiles(self.cache_path, self._impl.filename_base,
                                      self._impl.locator.get_source_stamp())

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keeps what was compiled; where that cannot be, the next process compiles again."""
        with suppress(OSError):
            super().save_overload(sig, data)
