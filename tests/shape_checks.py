"""Types and shapes are checked in the first call of a function in a test, and not in thousands of calls after that.

`--jaxtyping-packages` has jaxtyping's import hook decorate every function and class of the package.  To be imported before that.
"""

import dataclasses
import functools
import inspect
from types import CodeType

import jaxtyping

_all_calls = jaxtyping.jaxtyped
_test = 0
# The test that called each function last; what a function defines anew in every call of it is one function.
_last: dict[tuple[str, CodeType], int] = {}


def begin_test() -> None:
    """Check first calls again."""
    global _test
    _test += 1


def _at_first(function, typechecker):
    """The checked function in the first call of a test, and the function itself in later ones.

    The checks are made where they are first asked for, as that takes a hundred times as long as a call of them.
    """
    if not function.__annotations__:
        return function
    name, checked = (function.__qualname__, function.__code__), None

    @functools.wraps(function)
    def called(*args, **kwargs):
        nonlocal checked
        if _last.get(name) == _test:
            return function(*args, **kwargs)
        _last[name] = _test
        if checked is None:
            checked = _all_calls(function, typechecker=typechecker)
        return checked(*args, **kwargs)

    called.is_checked_at_first = True
    return called


def _first_calls(thing=None, *, typechecker):
    """What the import hook decorates with, in place of jaxtyping's own decorator."""
    if thing is None:
        return functools.partial(_first_calls, typechecker=typechecker)
    if inspect.isfunction(thing):
        return _at_first(thing, typechecker)
    if inspect.isclass(thing) and dataclasses.is_dataclass(thing):
        if not hasattr(thing.__init__, "is_checked_at_first"):
            thing.__init__ = _first_calls(thing.__init__, typechecker=typechecker)
        return thing
    return _all_calls(thing, typechecker=typechecker)


jaxtyping.jaxtyped = _first_calls
