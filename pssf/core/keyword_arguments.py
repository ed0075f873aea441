"""Check keyword arguments: reject unknown names with a suggestion, and accept former names with a warning."""

import inspect
import warnings
from collections.abc import Callable, Collection, Mapping
from functools import wraps
from typing import Any, TypeVar

from .checks import InputError, suggest_name

F = TypeVar("F", bound=Callable[..., Any])
_KEYWORD_KINDS = (inspect.Parameter.KEYWORD_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)


def check_keywords(**earlier: str) -> Callable[[F], F]:
    """Decorate a function or dataclass so that its keyword arguments are checked before it is called.

    An unknown keyword raises InputError, which suggests the most similar valid name. A former name is replaced by the
    current name.

    Parameters
    ----------
    **earlier : str
        Current name of each keyword argument, keyed by former name.

    Returns
    -------
    callable
        Decorator of a function or dataclass.

    Warns
    -----
    DeprecationWarning
        When the decorated function is called with a former name.
    """

    def decorated(target: F) -> F:
        made = inspect.isclass(target)
        function: Any = target.__init__ if made else target  # type: ignore[misc]
        listed = list(inspect.signature(function).parameters.values())[int(made) :]
        names = {one.name: None for one in listed if one.kind in _KEYWORD_KINDS}
        anything = any(one.kind is inspect.Parameter.VAR_KEYWORD for one in listed)

        @wraps(function)
        def checked(*given: Any, **named: Any) -> Any:
            if (earlier or not anything) and named.keys() - names.keys():
                named = _resolve_keywords(target.__name__, named, names, earlier, anything)
            return function(*given, **named)

        if not made:
            return checked  # type: ignore[return-value]
        setattr(target, "__init__", checked)  # noqa: B010
        return target

    return decorated


def _resolve_keywords(
    target_name: str, named: Mapping[str, Any], names: Collection[str], earlier: Mapping[str, str], accepts_any: bool
) -> dict[str, Any]:
    """Replace former names of keyword arguments by current names; reject unknown names and duplicates."""
    resolved = {}
    for name, value in named.items():
        now = earlier.get(name, name)
        if now != name:
            if now in named:
                raise InputError(f"{target_name}: got both {now} and its former name {name}; give only {now}")
            warnings.warn(
                f"{target_name}: {name} is now {now}, but the former name will be removed; use {now}",
                DeprecationWarning,
                stacklevel=3,
            )
        elif name not in names and not accepts_any:
            raise InputError(
                f"{target_name}: keywords must be among {', '.join(names)}, got {name!r}{suggest_name(name, names)}"
            )
        resolved[now] = value
    return resolved


def update_field_names(table: Mapping[str, Any], earlier: Mapping[str, str], label: str) -> dict[str, Any]:
    """Replace former field names by current names in a table that was read from a file.

    Parameters
    ----------
    table : mapping of str to Any
        Field values, keyed by field name.
    earlier : mapping of str to str
        Current field names, keyed by former name.
    label : str
        Name of the file or object, shown at the start of every message.

    Returns
    -------
    dict of str to Any
        Field values, keyed by current field name.

    Raises
    ------
    InputError
        If the table contains both the former and the current name of a field.

    Warns
    -----
    DeprecationWarning
        If the table contains a former name.
    """
    return _resolve_keywords(label, table, (), earlier, accepts_any=True)


def renamed_attribute(name: str) -> property:
    """Make a property for the former name of an attribute.

    Parameters
    ----------
    name : str
        Current name of the attribute or method.

    Returns
    -------
    property
        Property that returns the attribute `name` and issues a DeprecationWarning.
    """

    def get(self: Any) -> Any:
        warnings.warn(
            f"a {type(self).__name__} attribute is now {name}, but the former name will be removed; use {name}",
            DeprecationWarning,
            stacklevel=2,
        )
        return getattr(self, name)

    return property(get)
