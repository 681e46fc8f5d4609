"""Compiled functions whose machine code is cached beside the source, robust against old or damaged files.

Machine code holds the numbers and the functions of other modules that a function names, as they were when it was
compiled. The cache key is therefore the *meaning* of a function: its own bytecode and that of all compiled functions
that it calls, with the values of all they name. numba's ``cache=True`` looks at the time of the function's own file:
after a number in another file has changed it goes on with the old one, and after a checkout it compiles all anew.

numba also keeps an index and a data file a signature, and trusts both. Here every signature has one file with a
checksum: a file that is cut off, empty or altered counts as missing, and two processes that compile at a time cannot
mix up what belongs to whom. Where no folder can be written, code that is there is used, and other code is compiled in
every run; an index that is cut off ends the first call with ``cache=True`` with an error of ``pickle``, and in an
installation of another user the code that was compiled there is not looked for.
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any, TypeVar

import numba
import numpy as np
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile
from numba.core.dispatcher import Dispatcher
from numba.core.serialize import dumps

_Function = TypeVar("_Function", bound=Callable[..., Any])
_IN_TREE = CompileResultCacheImpl._locator_classes[1]
"""numba's way to the folder beside the source."""
_DIGEST = 32  # bytes of SHA-256


def jit(**options: Any) -> Callable[[_Function], _Function]:
    """Compiles a function as ``numba.njit(**options)`` does, at its first call with such arguments; caches the code."""
    def compiled(function: _Function) -> _Function:
        dispatcher = numba.njit(**options)(function)
        dispatcher._cache = _KeptCode(dispatcher)
        compiled: _Function = dispatcher
        return compiled

    return compiled


@cache
def meaning(function: FunctionType) -> str:
    """Digest of everything that a function's machine code depends on; it changes when the code has to be recompiled.

    That is its bytecode, and the values of the globals and the closure that it names; of a compiled function among
    them, the meaning. Line numbers, comments and other functions of the file are not in it.
    """
    digest = hashlib.sha256()
    cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    values = {name: cell.cell_contents for name, cell in cells}
    codes = [function.__code__]
    while codes:
        code = codes.pop()
        codes += [c for c in code.co_consts if isinstance(c, CodeType)]
        numbers = [c for c in code.co_consts if not isinstance(c, CodeType) and c != function.__doc__]
        digest.update(code.co_code + " ".join(map(_repeated, numbers)).encode())
        values |= {name: function.__globals__[name] for name in code.co_names if name in function.__globals__}
        digest.update(repr(code.co_names).encode())
    digest.update(repr(function.__defaults__).encode())
    for name in sorted(values):
        digest.update(f"{name} {_told(function, values[name])}".encode())
    return digest.hexdigest()


def _told(user: FunctionType, value: Any) -> str:
    """What a value is to the compiled code of its user; types and modules by name: numba's version is kept as well."""
    if isinstance(value, Dispatcher):
        # A recursive function is in its own bytecode.
        return "itself" if value.py_func is user else _compiled_from(value)
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {value.tobytes().hex()}"
    if isinstance(value, type):
        return f"{value.__qualname__} {getattr(value, '_fields', '')}"
    return getattr(value, "__name__", None) or _repeated(value)


def _repeated(value: Any) -> str:
    """The value as text that is the same in every process: the ``repr`` of a set of words has them in any order."""
    return repr(sorted(value) if isinstance(value, (set, frozenset)) else value)


def _compiled_from(dispatcher: Dispatcher) -> str:
    """What a compiled function means, and how it is compiled: whether it is written into its callers, and rounding."""
    options = {name: _repeated(value) for name, value in dispatcher.targetoptions.items()}
    return f"{meaning(dispatcher.py_func)} {sorted(options.items())}"


class _Beside(_IN_TREE):  # type: ignore[valid-type, misc]
    """The folder beside the source where it cannot be written, e.g. an installation of another user."""

    def ensure_cache_path(self) -> None:
        """What is there can be read; nothing is made."""


class _Places(CompileResultCacheImpl):
    _locator_classes = [*CompileResultCacheImpl._locator_classes, _Beside]  # noqa: RUF012


class _KeptFiles(IndexDataCacheFile):
    """One file a signature: a digest, then what it belongs to and the code."""

    def __init__(self, cache_path: str, name: str, dispatcher: Dispatcher) -> None:
        super().__init__(cache_path, name, None)
        self._dispatcher = dispatcher

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
        return self._version, _compiled_from(self._dispatcher), key

    def _path(self, key: Any) -> Path:
        # The third is a digest of the function's own code: changed code replaces its old file.
        signature, target, _ = key
        name = hashlib.sha256(repr((signature, target)).encode()).hexdigest()[:16]
        return Path(self._cache_path) / f"{self._index_name.removesuffix('.nbi')}.{name}.nbc"


class _KeptCode(FunctionCache):
    _impl_class = _Places

    def __init__(self, dispatcher: Dispatcher) -> None:
        super().__init__(dispatcher.py_func)
        self._cache_file = _KeptFiles(self.cache_path, self._impl.filename_base, dispatcher)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keeps what was compiled; where that cannot be, the next process compiles again."""
        with suppress(OSError):
            super().save_overload(sig, data)
