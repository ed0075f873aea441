"""keywords: unknown keyword arguments are refused with the nearest name, and earlier names work with a warning."""

import inspect
import warnings
from collections.abc import Callable, Collection, Mapping
from functools import wraps
from typing import Any, TypeVar

from .checks import InputError, hint

F = TypeVar("F", bound=Callable[..., Any])
_NAMED = (inspect.Parameter.KEYWORD_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)


def keywords(**earlier: str) -> Callable[[F], F]:
    """Check the keyword arguments of a function or a dataclass before it is called.

    An unknown keyword raises InputError with the nearest name that is taken. A keyword by an earlier name is taken
    under its name of now, with a DeprecationWarning.

    Parameters
    ----------
    **earlier
        Earlier name -> name of now.

    Returns
    -------
    callable
        A decorator.
    """

    def decorated(target: F) -> F:
        made = inspect.isclass(target)
        function: Any = target.__init__ if made else target  # type: ignore[misc]
        listed = list(inspect.signature(function).parameters.values())[int(made) :]
        names = {one.name: None for one in listed if one.kind in _NAMED}
        anything = any(one.kind is inspect.Parameter.VAR_KEYWORD for one in listed)

        @wraps(function)
        def checked(*given: Any, **named: Any) -> Any:
            if (earlier or not anything) and named.keys() - names.keys():
                named = _resolved(target.__name__, named, names, earlier, anything)
            return function(*given, **named)

        if not made:
            return checked  # type: ignore[return-value]
        setattr(target, "__init__", checked)  # noqa: B010
        return target

    return decorated


def _resolved(
    called: str, named: Mapping[str, Any], names: Collection[str], earlier: Mapping[str, str], anything: bool
) -> dict[str, Any]:
    """Keyword arguments under their names of now."""
    resolved = {}
    for name, value in named.items():
        now = earlier.get(name, name)
        if now != name:
            if now in named:
                raise InputError(f"{called}: {now} must be given once, got {name} as well, which is its earlier name")
            warnings.warn(
                f"{called}: {name} is now {now}; the earlier name will be removed", DeprecationWarning, stacklevel=3
            )
        elif name not in names and not anything:
            raise InputError(f"{called} takes no keyword {name!r}{hint(name, names)}; allowed: {', '.join(names)}")
        resolved[now] = value
    return resolved
