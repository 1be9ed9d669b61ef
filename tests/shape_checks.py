"""Types and shapes are checked where a function is first called in a test, and not in thousands of calls after that.

`--jaxtyping-packages` has jaxtyping's import hook decorate every function and class of the package.  To be imported before that.
"""

import dataclasses
import functools
import inspect

import jaxtyping

CHECKED_CALLS = 10
"""Of each function, in each test."""

_all_calls = jaxtyping.jaxtyped
_test = 0


def begin_test() -> None:
    """Check first calls again."""
    global _test
    _test += 1


def _at_first(function, checked):
    """The checked function in the first calls of a test, and the function itself in later ones."""
    test, calls = 0, 0

    @functools.wraps(function)
    def called(*args, **kwargs):
        nonlocal test, calls
        if test != _test:
            test, calls = _test, 0
        if calls >= CHECKED_CALLS:
            return function(*args, **kwargs)
        calls += 1
        return checked(*args, **kwargs)

    called.is_checked_at_first = True
    return called


def _first_calls(thing=None, *, typechecker):
    """What the import hook decorates with, in place of jaxtyping's own decorator."""
    if thing is None:
        return functools.partial(_first_calls, typechecker=typechecker)
    if inspect.isfunction(thing):
        return _at_first(thing, _all_calls(thing, typechecker=typechecker))
    if inspect.isclass(thing) and dataclasses.is_dataclass(thing):
        if not hasattr(thing.__init__, "is_checked_at_first"):
            thing.__init__ = _first_calls(thing.__init__, typechecker=typechecker)
        return thing
    return _all_calls(thing, typechecker=typechecker)


jaxtyping.jaxtyped = _first_calls
