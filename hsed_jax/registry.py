"""Parts with one file each: the file registers its class, and the folder is the registry.

A study names a part by the name of its file.  The names are known without executing a file, and a file is executed when its part
is first asked for: a wrong name is refused before JAX is loaded.
"""

import difflib
from collections.abc import Collection, Iterator, Mapping
from functools import cached_property
from importlib import import_module
from importlib.util import find_spec
from pkgutil import iter_modules
from types import ModuleType
from typing import Any

from hsed_jax.plain import shown


def register[T: type[Any]](cls: T) -> T:
    """Class decorator: the class is a part of the package, or of the study that names the file.

    Example:
        >>> from hsed_jax.physics.effects import AbstractSpringEffect
        >>> @hx.register
        ... class Mine(AbstractSpringEffect):
        ...     name, family, reference = "mine", "elastic", "my thesis"
        >>> "mine" in hx.effects(hx.load_study("study.yaml").with_own_effects(Mine)).index
        True
    """
    cls.registered = True
    return cls


def registered(module: ModuleType) -> tuple[Any, ...]:
    """The classes that a module has registered, in order; imported classes are not registered there."""
    # The mark of a class is not that of its subclasses.
    return tuple(item for item in vars(module).values() if isinstance(item, type) and "registered" in vars(item))


class Parts[T](Mapping[str, type[T]]):
    """The parts of one kind by name, in alphabetical order.

    Arguments:
        folder: dotted name of the folder; each of its files is a part.
        noun: name of a part in a message.
        helpers: files of the folder that are not parts.
    """

    def __init__(self, folder: str, noun: str, helpers: Collection[str] = ("base",)):
        self._folder, self._noun, self._helpers = folder, noun, helpers

    @cached_property
    def _names(self) -> tuple[str, ...]:
        # The folder itself is not imported for its names.
        spec = find_spec(self._folder)
        assert spec is not None
        files = iter_modules(spec.submodule_search_locations)
        return tuple(sorted(file.name for file in files if file.name not in self._helpers))

    def __getitem__(self, name: str) -> type[T]:
        """The class that the file of this name registers.

        Raises:
            KeyError: there is no such file.
            TypeError: the file does not register exactly one class.
        """
        if name not in self._names:
            raise KeyError(name)
        module = import_module(f"{self._folder}.{name}")
        found = [part for part in registered(module) if part.__module__ == module.__name__]
        if len(found) != 1:
            raise TypeError(f"{module.__name__} registers {len(found)} classes; a file registers exactly one")
        return found[0]

    def __contains__(self, name: object) -> bool:
        """Whether there is a file of this name."""
        return name in self._names

    def __iter__(self) -> Iterator[str]:
        """The names."""
        return iter(self._names)

    def __len__(self) -> int:
        """The number of parts."""
        return len(self._names)

    def known(self, name: str) -> str:
        """The name of a part.

        Raises:
            ValueError: there is no such part; the message lists the existing ones.
        """
        if name not in self:
            close = difflib.get_close_matches(name, self, n=1)
            hint = f" (did you mean {close[0]}?)" if close else ""
            raise ValueError(f"there is no {self._noun} {shown(name)}{hint}; allowed are {', '.join(self)}")
        return name
