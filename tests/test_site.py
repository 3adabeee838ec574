"""The documentation's site: what is wrong in a page ends its build (`.ci/run` builds the whole site)."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("sphinx", reason="the extra docs is not installed")

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "docs" / "_ext"))

from closed_site import problems  # noqa: E402
from environment_pages import as_markdown  # noqa: E402
from repository_links import lead_to_pages  # noqa: E402


def build(folder: Path, pages: dict[str, str]) -> subprocess.CompletedProcess[str]:
    """Build a site of a few pages with the settings of the real one."""
    source = folder / "docs"
    source.mkdir()
    for name in ("conf.py", "_ext", "_static"):
        place = ROOT / "docs" / name
        (shutil.copytree if place.is_dir() else shutil.copy)(place, source / name)
    for name, text in pages.items():
        (source / name).write_text(text)
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-q",
        "-W",
        "--keep-going",
        "-b",
        "html",
        str(source),
        str(folder / "site"),
    ]
    return subprocess.run(command, capture_output=True, text=True)


def test_a_page_with_an_environment_a_notebook_and_links_is_built(tmp_path: Path):
    (tmp_path / "data.yaml").write_text("a: 1\n")
    index = """# Title

```{environment} amulett_gym.envs.single:TensionEnv
```

[a file](../data.yaml), [a section](#action-space)
"""
    notebook = """---
file_format: mystnb
kernelspec: {name: python3}
---

# Notebook

```{code-cell} ipython3
import matplotlib.pyplot as plt

plt.plot([0, 1])
print(6 * 7)
```
"""
    pages = {"index.md": index + "\n```{toctree}\nnotebook\n```\n", "notebook.md": notebook}
    built = build(tmp_path, pages)
    assert built.returncode == 0, built.stderr
    assert 'id="action-space"' in (tmp_path / "site" / "index.html").read_text()
    assert list((tmp_path / "site" / "_downloads").rglob("data.yaml"))
    shown = (tmp_path / "site" / "notebook.html").read_text()
    assert "42" in shown
    assert ".png" in shown


def test_each_fault_of_a_page_is_named_and_ends_the_build(tmp_path: Path):
    index = """# Title

[no page](missing.md), [no section](#nowhere), {term}`no word`

<a href="gone.html">raw HTML</a> <script src="https://cdn.example/a.js"></script>

```{toctree}
notebook
```
"""
    notebook = """---
file_format: mystnb
kernelspec: {name: python3}
---

# Notebook

```{code-cell} ipython3
1 / 0
```
"""
    built = build(tmp_path, {"index.md": index})
    assert built.returncode != 0
    for named in ("missing.md", "nowhere", "no word", "gone.html", "https://cdn.example/a.js"):
        assert named in built.stderr
    shutil.rmtree(tmp_path / "docs")
    built = build(tmp_path, {"index.md": "# Title\n\n```{toctree}\nnotebook\n```\n", "notebook.md": notebook})
    assert built.returncode != 0
    assert "ZeroDivisionError" in built.stderr


@pytest.mark.parametrize(
    "loading",
    [
        '<script src="https://cdn.example/a.js"></script>',
        '<script src="//cdn.example/a.js"></script>',
        '<link rel="stylesheet" href="http://cdn.example/a.css">',
        '<img src="https://cdn.example/a.png">',
        '<iframe src="https://cdn.example/"></iframe>',
        '<p style="background: url(https://cdn.example/a.png)">',
        "<style>@import 'https://cdn.example/a.css';</style>",
        '<style>@font-face { src: url("https://cdn.example/a.woff") }</style>',
    ],
)
def test_a_page_that_loads_from_elsewhere_is_a_problem(loading: str, tmp_path: Path):
    (tmp_path / "page.html").write_text(f"<html><body>{loading}</body></html>")
    (problem,) = problems(tmp_path)
    assert "page.html loads " in problem
    assert "cdn.example" in problem


def test_a_style_sheet_that_loads_from_elsewhere_is_a_problem(tmp_path: Path):
    (tmp_path / "a.css").write_text(
        "@import url(https://cdn.example/b.css); p { background: url(data:image/png;base64,AA) }"
    )
    assert problems(tmp_path) == ["a.css loads https://cdn.example/b.css"]


def test_links_within_a_site_have_to_lead_somewhere(tmp_path: Path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "page.html").write_text(
        '<a href="../index.html#here">up</a><a href="../index.html#there">up</a>'
    )
    links = [
        "https://example.org",
        "mailto:a@example.org",
        "sub/page.html",
        "#here",
        "sub/gone.html",
        "../outside.html",
    ]
    body = "".join(f'<a href="{link}">link</a>' for link in links)
    (tmp_path / "index.html").write_text(f'<p id="here">{body}<img src="data:image/png;base64,AA"></p>')
    assert problems(tmp_path) == [
        "index.html links to sub/gone.html: no such file",
        "index.html links to ../outside.html: no such file",
        "sub/page.html links to ../index.html#there: no such anchor",
    ]


def test_a_docstring_becomes_markdown():
    text = "See :class:`ScalingEnv` and ``a``::\n\n    def f():\n        return 1\n\n\n    f()\n\nThe end."
    code = "```python\ndef f():\n    return 1\n\n\nf()\n```"
    assert as_markdown(text) == f"See {{py:class}}`ScalingEnv` and ``a``:\n\n{code}\n\nThe end."


@pytest.mark.parametrize(
    ("docname", "link", "expected"),
    [
        ("training", "[a](../README.md)", "[a](readme.md)"),
        ("training", "[a](../CONTRIBUTING.md#rules)", "[a](contributing.md#rules)"),
        ("tutorials/first-law", "[a](../../README.md)", "[a](../readme.md)"),
        ("tutorials/first-law", "[a](../README.md)", "[a](../README.md)"),
        ("training", "[a](../configs/ppo.yaml)", "[a](../configs/ppo.yaml)"),
        ("training", "[a](../configs/logs)", "a"),
        ("tutorials/first-law", "[a](../../configs/logs)", "a"),
    ],
)
def test_links_to_files_at_the_root_lead_to_their_pages(docname: str, link: str, expected: str):
    source = [link]
    lead_to_pages(SimpleNamespace(srcdir=ROOT / "docs"), docname, source)
    assert source == [expected]


def test_a_file_of_the_root_is_included_with_its_links(tmp_path: Path):
    (tmp_path / "README.md").write_text(
        "[a](docs/a.md#b), [b](CHANGELOG.md), ![c](docs/c.png), [d](https://d.example), [e](#e)"
    )
    app = SimpleNamespace(srcdir=tmp_path / "docs", env=SimpleNamespace(note_dependency=lambda path: None))
    source = ["```{include} ../README.md\n```"]
    lead_to_pages(app, "readme", source)
    assert source == ["[a](a.md#b), [b](changelog.md), ![c](c.png), [d](https://d.example), [e](#e)"]
