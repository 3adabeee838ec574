"""Links of the pages to files of the repository that are no pages.

The pages are read on GitHub, too, so that they link as `../configs/ppo.yaml`. On the site, such a link leads to a copy
of the file, and one to README.md, CONTRIBUTING.md or CHANGELOG.md to the page that holds it. Of a link to a folder, its
text stays.
"""

from __future__ import annotations

import re
from pathlib import Path

from sphinx.application import Sphinx

PAGES = {"README.md": "readme.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
LINK = re.compile(r"\]\((?P<up>(?:\.\./)+)(?P<file>[A-Z]+\.md)(?=[)#])")
INCLUDED = re.compile(r"^```\{include\} \.\./(?P<file>[A-Z]+\.md)\n```$", flags=re.MULTILINE)
AT_THE_ROOT = re.compile(r"\]\((?!https?:|#)(?P<docs>docs/)?")
FOLDER = re.compile(r"\[(?P<text>[^\]]+)\]\((?P<folder>(?:\.\./)+[\w./-]+)\)")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the extension with Sphinx."""
    app.connect("source-read", lead_to_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def lead_to_pages(app: Sphinx, docname: str, source: list[str]) -> None:
    """Let links to files at the root lead to their pages, drop those to folders, and include files of the root."""

    def content(match: re.Match[str]) -> str:
        path = Path(app.srcdir).parent / match["file"]
        app.env.note_dependency(path)
        return AT_THE_ROOT.sub(lambda link: "](" if link["docs"] else "](../", path.read_text(encoding="utf-8"))

    def page(match: re.Match[str]) -> str:
        beyond = len(Path(docname).parents)  # levels up from the page to the repository
        if match["up"].count("../") != beyond or match["file"] not in PAGES:
            return match[0]
        return f"]({'../' * (beyond - 1)}{PAGES[match['file']]}"

    def text(match: re.Match[str]) -> str:
        return match["text"] if (Path(app.srcdir) / docname).parent.joinpath(match["folder"]).is_dir() else match[0]

    source[0] = FOLDER.sub(text, LINK.sub(page, INCLUDED.sub(content, source[0])))
