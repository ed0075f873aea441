"""Show the signature of a class whose base class is not installed, such as a data set of PyTorch."""

import inspect
from typing import Any

from sphinx.application import Sphinx
from sphinx.util.typing import ExtensionMetadata


def find_signature(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, signature: str | None, returned: str | None
) -> tuple[str, str | None] | None:
    """Return the signature of ``__init__`` for a class whose signature the replaced base class hides."""
    if what != "class" or signature != "(*args, **kwargs)":
        return None
    of_init = inspect.signature(obj.__init__)
    shown = [
        one.replace(annotation=inspect.Parameter.empty) for key, one in of_init.parameters.items() if key != "self"
    ]
    return str(inspect.Signature(shown)), returned


def setup(app: Sphinx) -> ExtensionMetadata:
    """Register the event handler."""
    app.connect("autodoc-process-signature", find_signature)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
