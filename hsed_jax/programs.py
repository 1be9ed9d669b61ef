"""Programs with stored traces.

XLA stores compiled programs (`hsed_jax.backend`), but a new process must still trace every program in Python and lower it
before it can find the stored program. This takes several times as long as loading it. Here the lowered program is stored
beside the file of XLA. Its name contains all dependencies: the sources of this package, the versions of other packages, the
static parts of the arguments and the shapes of the arrays. A dependency without such a name, such as a function of the user,
is traced each time.
"""

import dataclasses
import functools
import hashlib
import inspect
import pickle
import shutil
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.core
import jax.numpy as jnp
import numpy as np

from hsed_jax.backend import private

# Dependencies of a trace besides the sources here.
_PACKAGES = ("jax", "jaxlib", "equinox", "diffrax", "optimistix", "lineax", "numpyro", "tinygp", "numpy", "scipy")
_SETTINGS = ("jax_enable_x64", "jax_default_matmul_precision", "jax_numpy_dtype_promotion", "jax_debug_nans")
# Functions and classes of these are known by their names, as long as the versions are.
_KNOWN = {"hsed_jax", "builtins", "functools", *_PACKAGES}
# Routines of LAPACK without a promise of JAX for other versions. This does not matter here: each version has its own
# programs.
_ROUTINES = ("lapack_dormqr_ffi",)
# Number of states of the sources whose programs are kept.
_STATES = 4
# Number of programs of a function in RAM, some 10 MB each: a process with many campaigns would otherwise exceed the
# RAM. A dropped program is read again.
_MOST = 48
_MISSING = object()


class _UnspelledError(Exception):
    """An object has no name that is the same in every process."""


def program[**P, R](function: Callable[P, R]) -> "Program[P, R]":
    """Compile a function of pytrees as `equinox.filter_jit` does, and keep its traces.

    Arguments:
        function: a pure function, whose results are arrays in a tree.
    """
    return Program(function)


class Program[**P, R]:
    """A compiled function: arrays in its arguments are operands, everything else is part of the program."""

    def __init__(self, function: Callable[P, R]):
        functools.update_wrapper(self, function)
        self._function: Callable[..., Any] = function
        self._signature = inspect.signature(function)
        self._traced = eqx.filter_jit(function)
        # By their keys, None if it cannot be stored; the most recently used ones are last.
        self._made: dict[Any, Any] = {}
        self._ordering = threading.Lock()
        self._making: dict[Any, threading.Lock] = {}

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Run the program; within another one, be a part of it."""
        # The form of the call does not change the program.
        given = self._signature.bind(*args, **kwargs)
        given.apply_defaults()
        leaves, structure = jax.tree.flatten((given.args, given.kwargs))
        # By their types: this happens some thousand times in a study.
        types = [type(leaf) for leaf in leaves]
        if any(map(_is_tracer, types)) or not _is_kept():
            return self._traced(*args, **kwargs)
        is_operand = tuple(map(_is_array, types))
        operands = [leaf for leaf, one in zip(leaves, is_operand, strict=True) if one]
        static = tuple([None if one else leaf for leaf, one in zip(leaves, is_operand, strict=True)])
        key = structure, is_operand, static, tuple([_kind(operand) for operand in operands])
        made = self._kept(key)
        if made is _MISSING:
            # One thread makes a program that several threads need; threads that need other programs make them
            # meanwhile.
            with self._ordering:
                making = self._making.setdefault(key, threading.Lock())
            with making:
                made = self._kept(key)
                if made is _MISSING:
                    made = self._keep(key, self._make(structure, is_operand, static, operands))
        return self._traced(*args, **kwargs) if made is None else made(*operands)

    def __get__(self, instance: Any, owner: type | None = None) -> Any:
        """As a method of an object, which is its first argument."""
        return self if instance is None else functools.partial(self, instance)

    def lower(self, *args: P.args, **kwargs: P.kwargs) -> Any:
        """The program before it is compiled, traced anew."""
        return self._traced.lower(*args, **kwargs)

    def _kept(self, key: Any) -> Any:
        """The program of this key, or a mark for a missing program."""
        with self._ordering:
            made = self._made.pop(key, _MISSING)
            return made if made is _MISSING else self._made.setdefault(key, made)

    def _keep(self, key: Any, made: Callable[..., Any] | None) -> Callable[..., Any] | None:
        """Keep a program in RAM; the least recently used ones are dropped."""
        with self._ordering:
            self._made[key] = made
            self._making.pop(key, None)
            for oldest in list(self._made)[:-_MOST]:
                del self._made[oldest]
        return made

    def _make(self, structure, is_operand, static, operands) -> Callable[..., Any] | None:
        """The program for arguments of one kind, as a function of its operands; None if it cannot be stored."""
        # By their kind alone: otherwise the origin of an array would be a part of the program.
        operands = [jax.ShapeDtypeStruct(a.shape, a.dtype, weak_type=a.weak_type) for a in map(jax.typeof, operands)]
        try:
            parts = _spelled(jax.tree.unflatten(structure, static)), is_operand, [_spelled(a) for a in operands]
            name = hashlib.blake2b(repr(parts).encode(), digest_size=16).hexdigest()
        except _UnspelledError:
            return None
        from jax import export  # a check of a study need not load it

        if (folder := _folder()) is None:
            return None
        file = folder / f"{self._function.__qualname__}-{name}"
        kept = _read(file)
        if kept is None:
            kept = self._lowered(structure, is_operand, static, operands)
            if kept is None:
                return None
            _write(file, kept)
        skeleton, lowered = kept
        # Compiled here and once: by itself JAX would compile again for arrays that another kept program has made.
        call, shape = jax.jit(export.deserialize(lowered).call).lower(*operands).compile(), jax.tree.structure(skeleton)
        return lambda *operands: jax.tree.unflatten(shape, call(*operands))

    def _lowered(self, structure, is_operand, static, operands) -> tuple[Any, bytearray] | None:
        """The results' tree, and the lowered program as bytes; None if a part cannot be stored."""
        from jax import export

        skeletons: list[Any] = []

        def flat(*operands):
            rest = iter(operands)
            leaves = [next(rest) if one else leaf for one, leaf in zip(is_operand, static, strict=True)]
            args, kwargs = jax.tree.unflatten(structure, leaves)
            results, shape = jax.tree.flatten(self._function(*args, **kwargs))
            skeletons[:] = [jax.tree.unflatten(shape, range(len(results)))]
            return [jnp.asarray(result) for result in results]

        jitted = jax.jit(flat)
        # A fault of the function itself is an error, and is raised here.
        jitted.trace(*operands)
        try:
            unpromised = [export.DisabledSafetyCheck.custom_call(name) for name in _ROUTINES]
            lowered = export.export(jitted, disabled_checks=unpromised)(*operands).serialize()
            pickle.dumps(skeletons[0])
        except (ValueError, NotImplementedError, pickle.PicklingError, AttributeError):
            return None
        return skeletons[0], lowered


@functools.cache
def _is_tracer(kind: type) -> bool:
    return issubclass(kind, jax.core.Tracer)


@functools.cache
def _is_array(kind: type) -> bool:
    return issubclass(kind, jax.Array | np.ndarray | np.generic)


def _kind(operand: Any) -> tuple[Any, ...]:
    """The properties of an array on which a program depends; arrays of NumPy count like those of JAX."""
    return operand.shape, operand.dtype, getattr(operand, "weak_type", False)


def _is_kept() -> bool:
    config = jax.config
    is_kept = config.jax_enable_compilation_cache and bool(config.jax_compilation_cache_dir)
    return is_kept and not config.jax_disable_jit and len(jax.devices()) == 1


# Names that are the same in every process.


def _spelled(part: Any) -> Any:
    """An object in nested tuples of words and numbers.

    Raises:
        _UnspelledError: its parts do not determine its behaviour.
    """
    if part is None or isinstance(part, bool | int | float | complex | str | bytes):
        return type(part).__name__, part
    if isinstance(part, type) or (callable(part) and hasattr(part, "__qualname__")):
        return _known_by_name(part)
    if isinstance(part, functools.partial):
        return "partial", _spelled(part.func), _spelled(part.args), _spelled(part.keywords)
    if isinstance(part, jax.ShapeDtypeStruct):
        return str(part.dtype), part.shape, part.weak_type
    if isinstance(part, np.ndarray):
        return str(part.dtype), part.shape, hashlib.blake2b(part.tobytes()).hexdigest()
    return _known_by_name(type(part)), *(_spelled(own) for own in _parts(part))


def _parts(part: Any) -> Iterator[Any]:
    if dataclasses.is_dataclass(part):
        # A field without a part in comparisons does not change a program.
        return (getattr(part, field.name) for field in dataclasses.fields(part) if field.compare)
    if isinstance(part, Mapping):
        return iter([pair for item in part.items() for pair in item])
    if isinstance(part, tuple | list):
        return iter(part)
    raise _UnspelledError(type(part))


def _known_by_name(thing: Any) -> tuple[str, str]:
    module, name = thing.__module__, thing.__qualname__
    if str(module).partition(".")[0] not in _KNOWN or hasattr(thing, "__self__"):
        raise _UnspelledError(name)
    found: Any = sys.modules.get(module)
    for word in name.split("."):
        found = getattr(found, word, None)
    if found is not thing:
        raise _UnspelledError(name)
    return module, name


# The folder.


@functools.cache
def _state() -> str:
    """The sources of this package, and the other dependencies of traces."""
    digest = hashlib.blake2b(digest_size=10)
    digest.update(repr((sys.version_info, [(name, version(name)) for name in _PACKAGES])).encode())
    digest.update(repr((jax.default_backend(), [getattr(jax.config, name) for name in _SETTINGS])).encode())
    root = Path(__file__).parent
    for file in sorted(root.rglob("*.py")):
        digest.update(str(file.relative_to(root)).encode() + file.read_bytes())
    return digest.hexdigest()


def _folder() -> Path | None:
    """The folder of the programs of this state of the sources; None if other users may write there."""
    folder = private(Path(jax.config.jax_compilation_cache_dir or "") / "programs")
    return None if folder is None else folder / _state()


def _read(file: Path) -> tuple[Any, bytearray] | None:
    try:
        return pickle.loads(file.read_bytes())
    except Exception:  # a truncated file can raise any exception, and is made again
        return None


def _write(file: Path, kept: tuple[Any, bytearray]) -> None:
    """Store a program; if it cannot be written, it is traced again next time."""
    try:
        if not file.parent.exists():
            file.parent.mkdir(parents=True)
            states = sorted(file.parent.parent.iterdir(), key=lambda folder: folder.stat().st_mtime)
            for old in states[:-_STATES]:
                shutil.rmtree(old, ignore_errors=True)
        with tempfile.NamedTemporaryFile(dir=file.parent, delete=False) as being_written:
            pickle.dump(kept, being_written)
        Path(being_written.name).replace(file)
    except OSError:
        pass
