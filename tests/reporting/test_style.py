"""Figures depend on nothing of the user's matplotlib, and change nothing of it."""

import os
import subprocess
import sys
import textwrap

import matplotlib as mpl
import pytest

from amulett_gym.reporting import style

INLINE = "module://matplotlib_inline.backend_inline"  # what a notebook leaves in the environment of its shells

DRAW = textwrap.dedent(
    """
    import sys
    from amulett_gym.reporting import style

    @style.styled
    def draw():
        figure = style.Figure(figsize=(3, 2), layout="constrained")
        figure.subplots().plot([0, 1], [1, 0])
        return figure

    style.save_figure(draw(), sys.argv[1])
    """
)


@style.styled
def draw() -> style.Figure:
    figure = style.Figure(figsize=(3, 2), layout="constrained")
    figure.subplots().plot([0, 1], [1, 0])
    return figure


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    path = tmp_path_factory.mktemp("figure") / "expected.png"
    style.save_figure(draw(), path)
    return path.read_bytes()


def run(script, cwd, *words, **environment):
    kept = {key: value for key, value in os.environ.items() if not key.startswith(("MPL", "MATPLOTLIB"))}
    done = subprocess.run(
        [sys.executable, "-c", script, *words], cwd=cwd, env=kept | environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("backend", [INLINE, "nonsense", "pdf", ""])
def test_the_backend_of_the_environment_changes_nothing(tmp_path, expected, backend):
    run(DRAW, tmp_path, "figure.png", MPLBACKEND=backend)
    assert (tmp_path / "figure.png").read_bytes() == expected


@pytest.mark.parametrize(
    "content",
    [
        b"\xff\xfe not text \x80",
        b"font.size: huge\nno.such.setting: 1\n:::\n",
        b"font.size: 30\nsavefig.bbox: tight\ntext.usetex: True\nlines.linewidth: 9\nbackend: pdf\n",
    ],
    ids=["no text", "nonsense", "other"],
)
def test_a_matplotlibrc_changes_nothing(tmp_path, expected, content):
    (tmp_path / "matplotlibrc").write_bytes(content)
    run(DRAW, tmp_path, "figure.png")
    assert (tmp_path / "figure.png").read_bytes() == expected


def test_the_environment_and_the_folder_are_as_before(tmp_path):
    (tmp_path / "matplotlibrc").write_bytes(b"\xff")
    script = "import os; from amulett_gym.reporting import style; print(os.environ['MPLBACKEND'], os.getcwd())"
    assert run(script, tmp_path, MPLBACKEND=INLINE).split() == [INLINE, str(tmp_path)]


def test_a_backend_that_works_stays_the_users(tmp_path):
    script = "from amulett_gym.reporting import style; import matplotlib; print(matplotlib.rcParams['backend'])"
    assert run(script, tmp_path, MPLBACKEND="pdf").split() == ["pdf"]


def test_rcparams_of_the_user_change_nothing_and_stay(tmp_path, expected):
    with mpl.rc_context({"font.size": 30, "savefig.bbox": "tight", "savefig.format": "pdf", "text.usetex": True}):
        before = dict(mpl.rcParams)
        style.save_figure(draw(), tmp_path / "figure.png")
        assert dict(mpl.rcParams) == before
    assert (tmp_path / "figure.png").read_bytes() == expected


def test_figures_and_axes_of_pyplot_stay_the_users(tmp_path):
    script = DRAW + textwrap.dedent(
        """
        import matplotlib.pyplot as plt
        mine = plt.figure()
        style.figure_svg(draw(), "a")
        print(plt.get_fignums() == [mine.number], plt.gcf() is mine)
        """
    )
    assert run(script, tmp_path, "figure.png", MPLBACKEND="agg").split() == ["True", "True"]
