"""Check that the links between the built pages lead to existing files and anchors; no network is needed."""

from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.util.typing import ExtensionMetadata


class _Page(HTMLParser):
    """Collect the links and the anchors of one page."""

    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []
        self.anchors: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect the attributes href, src, id and name of a tag."""
        for name, value in attrs:
            if value and name in ("href", "src"):
                self.links.append(value)
            elif value and name in ("id", "name"):
                self.anchors.add(value)


def list_broken_links(html: Path) -> list[str]:
    """List the links of built pages that lead to no file or to no anchor.

    Parameters
    ----------
    html : Path
        Folder of the built site.

    Returns
    -------
    list of str
        One line per broken link: the page and the link.
    """
    pages = {}
    for path in sorted(path for path in html.rglob("*.html") if "_static" not in path.parts):
        pages[path.resolve()] = page = _Page()
        page.feed(path.read_text(encoding="utf-8"))
    broken = []
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc or (not parts.path and not parts.fragment):
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if target.is_dir():
                target /= "index.html"
            missing = not target.exists()
            anchor = unquote(parts.fragment)
            known = pages[target].anchors if target in pages else None
            if missing or (anchor and known is not None and anchor not in known):
                broken.append(f"{path.relative_to(html.resolve())}: {link}")
    return broken


def check_built_links(app: Sphinx, exception: Exception | None) -> None:
    """Raise an error at the end of a build if a link leads to no file or anchor."""
    broken = [] if exception or app.builder.name != "html" else list_broken_links(Path(app.outdir))
    if broken:
        raise ExtensionError("these links of the built pages lead to no file or anchor:\n" + "\n".join(broken))


def setup(app: Sphinx) -> ExtensionMetadata:
    """Register the link check."""
    app.connect("build-finished", check_built_links)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}


if __name__ == "__main__":
    import sys

    print("\n".join(list_broken_links(Path(sys.argv[1]))) or "every link leads to an existing file and anchor")
