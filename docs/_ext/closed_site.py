"""Checks the finished site: every link within it leads somewhere; HTML and CSS load nothing from elsewhere."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

from sphinx.application import Sphinx
from sphinx.util import logging

LOADED = {"src", "srcset", "poster", "data"}
"""Attributes whose address a browser loads; `href` is one of a link element, not of an anchor."""

IN_CSS = re.compile(r"""(?:url\(\s*["']?|@import\s+["'])([^"')]+)""")


class Page(HTMLParser):
    """A page's identifiers, the addresses that it links to and those that it loads."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.ids: set[str] = set()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self._style = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Keep an element's identifier and addresses."""
        self._style = tag == "style"
        for key, value in attrs:
            if value is None:
                continue
            if key == "id" or (tag == "a" and key == "name"):
                self.ids.add(value)
            elif key == "style":
                self.loaded += IN_CSS.findall(value)
            elif key in LOADED or (key == "href" and tag == "link"):
                self.loaded.append(value)
            elif key == "href":
                self.links.append(value)

    def handle_data(self, data: str) -> None:
        """Keep the addresses of a style sheet in the page."""
        if self._style:
            self.loaded += IN_CSS.findall(data)

    def handle_endtag(self, tag: str) -> None:
        """Note the end of a style sheet."""
        if tag == "style":
            self._style = False


def problems(site: Path) -> list[str]:
    """Return what is wrong with a site's pages and style sheets, a line for each."""
    read = cache(lambda path: Page(path.read_text(encoding="utf-8")))
    found = []
    for path in sorted(site.rglob("*.html")):
        page, name = read(path), path.relative_to(site)
        found += [f"{name} loads {address}" for address in page.loaded if is_elsewhere(address)]
        for address in (*page.links, *page.loaded):
            if not is_elsewhere(address) and (wrong := missing(address, path, site, read)):
                found.append(f"{name} links to {address}: {wrong}")
    for path in sorted(site.rglob("*.css")):
        addresses = IN_CSS.findall(path.read_text(encoding="utf-8"))
        found += [f"{path.relative_to(site)} loads {address}" for address in addresses if is_elsewhere(address)]
    return found


def is_elsewhere(address: str) -> bool:
    """Return whether an address is outside of the site."""
    parts = urlsplit(address)
    return bool(parts.netloc) or parts.scheme not in ("", "data", "javascript", "mailto")


def missing(address: str, path: Path, site: Path, read: Callable[[Path], Page]) -> str:
    """Return why an address within the site leads nowhere; an empty string if it leads somewhere."""
    parts = urlsplit(address)
    if parts.scheme:
        return ""
    target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
    target = target / "index.html" if target.is_dir() else target
    if not target.is_file() or not target.is_relative_to(site.resolve()):
        return "no such file"
    if parts.fragment and target.suffix == ".html" and unquote(parts.fragment) not in read(target).ids:
        return "no such anchor"
    return ""


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the extension with Sphinx."""
    app.connect("build-finished", check)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def check(app: Sphinx, error: Exception | None) -> None:
    """Warn of each problem of a site that was built without an error."""
    if error is None and app.builder.format == "html":
        for problem in problems(Path(app.outdir)):
            logging.getLogger(__name__).warning(problem, type="site")
