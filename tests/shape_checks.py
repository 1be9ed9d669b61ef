"""Types and shapes are checked where a function is first called in a test, and not in thousands of calls after that.

`--jaxtyping-packages` has jaxtyping's import hook decorate every function and class of the package.  To be imported before that.
"""

import dataclasses
import functools
import inspect
from types import CodeType

import jaxtyping

CHECKED_CALLS = 10
"""Of each function, in each test."""

_all_calls = jaxtyping.jaxtyped
_test = 0
# Of each function, the test that called it last and the calls in that; what a function defines anew in every call of it is one.
_calls: dict[tuple[str, CodeType], list[int]] = {}


def begin_test() -> None:
    """Check first calls again."""
    global _test
    _test += 1


def _at_first(function, typechecker):
    """The checked function in the first calls of a test, and the function itself in later ones.

    The checks are made where they are first asked for, as that takes a hundred times as long as a call of them.
    """
    if not function.__annotations__:
        return function
    calls = _calls.setdefault((function.__qualname__, function.__code__), [0, 0])
    checked = None

    @functools.wraps(function)
    def called(*args, **kwargs):
        nonlocal checked
        if calls[0] != _test:
            calls[:] = _test, 0
        if calls[1] >= CHECKED_CALLS:
            return function(*args, **kwargs)
        calls[1] += 1
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
