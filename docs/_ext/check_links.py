"""Check the links between the built pages: files and anchors, without a network."""

from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class _Page(HTMLParser):
    """Collect the links and the anchors of one page."""

    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []
        self.anchors: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Keep href, src, id and name."""
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


if __name__ == "__main__":
    import sys

    print("\n".join(list_broken_links(Path(sys.argv[1]))) or "every link leads to a file and an anchor")
