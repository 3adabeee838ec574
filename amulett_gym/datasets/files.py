"""Folders of Minari data sets: writing one completely or not at all, and finding one to read."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from amulett_gym.errors import AmulettError, install_extra, nearest
from amulett_gym.storage.reading import user_path
from amulett_gym.storage.writing import replace_folder

if TYPE_CHECKING:
    from amulett_gym.datasets.playing import PlayedEpisode, Stage

_NEEDED = ("minari", "h5py")
_DATA = "data"
"""Folder of the files in a data set's own folder, as Minari wants it."""

_OVERHEAD = 2, 30_000
"""Most bytes on the disk for a byte of an episode, and in addition for each episode."""


def check_minari() -> None:
    """Raise an AmulettError that says what to install if Minari is not installed."""
    if absent := [name for name in _NEEDED if find_spec(name) is None]:
        raise AmulettError(
            f"data sets need {' and '.join(absent)}, not installed here. Install the extra 'datasets': "
            f"{install_extra('datasets')}"
        )


def check_name(name: str) -> str:
    """Return a data set's name, like ``amulett/scaling/eq6-held-v0``; AmulettError if Minari would refuse it."""
    from minari.dataset.minari_dataset import DATASET_ID_RE

    match = DATASET_ID_RE.fullmatch(name)
    if match is None or match["version"] is None:
        raise AmulettError(
            f"'{name}' is no name of a data set; write letters, digits, '-' and '_', folders with '/', and at the end "
            "a version, for example amulett/scaling/mine-v0"
        )
    return name


def datasets_folder(root: str | Path | None = None) -> Path:
    """Return the folder of all data sets: `root`, or else what MINARI_DATASETS_PATH names, or else Minari's own.

    It is absolute: Minari cannot write to a relative one.
    """
    from minari.storage import get_dataset_path

    if root is not None:
        return user_path(root).absolute()
    try:
        return get_dataset_path().absolute()
    except OSError as error:
        raise AmulettError(
            f"cannot make the folder of data sets '{error.filename}': {error.strerror}; choose another with --out or "
            "MINARI_DATASETS_PATH"
        ) from error


class DatasetWriter:
    """Writes the episodes of a data set into its folder."""

    def __init__(self, folder: Path, stage: Stage, metadata: Mapping[str, Any]) -> None:
        from minari.dataset.minari_storage import MinariStorage

        spaces = stage.observation_space, stage.action_space
        self._storage = MinariStorage.new(folder, *spaces, env_spec=stage.spec)
        self._storage.update_metadata(dict(metadata))
        self._folder = folder

    def add(self, episodes: Sequence[PlayedEpisode]) -> None:
        """Append episodes; each one's metadata has its seed, its policy, and Minari's sums of the rewards."""
        from minari import EpisodeMetadataCallback
        from minari.data_collector import EpisodeBuffer

        arrays = [array for each in episodes for array in (each.observations, each.actions, each.rewards)]
        _try_room(self._folder, _OVERHEAD[0] * sum(each.nbytes for each in arrays) + _OVERHEAD[1] * len(episodes))
        first = self._storage.total_episodes
        buffers, about = [], []
        for episode in episodes:
            last = np.arange(len(episode.rewards)) == len(episode.rewards) - 1
            buffers.append(
                EpisodeBuffer(
                    seed=episode.seed,
                    options=episode.options,
                    observations=episode.observations,
                    actions=episode.actions,
                    rewards=episode.rewards,
                    terminations=last & episode.failed,
                    truncations=last & (not episode.failed),
                    infos={},
                )
            )
            about.append({"policy": episode.policy, **EpisodeMetadataCallback()({"rewards": episode.rewards})})
        self._storage.update_episodes(buffers)
        self._storage.update_episode_metadata(about, range(first, first + len(episodes)))


@contextmanager
def new_dataset(
    root: Path, name: str, stage: Stage, metadata: Mapping[str, Any], overwrite: bool = False
) -> Iterator[DatasetWriter]:
    """Yield the writer of a new data set, which appears under its name when the block succeeds.

    Parameters
    ----------
    root : Path
        Folder of all data sets.
    name : str
        See `check_name`.
    stage : Stage
    metadata : mapping
        Minari's, and others of JSON types.
    overwrite : bool
        Whether an earlier data set of this name is replaced.

    Raises
    ------
    AmulettError
        If there is one and it is not to be replaced, the folder is something else, or it cannot be written.
    """
    folder = root / name
    check_free(root, name, overwrite)
    made = [parent for parent in folder.parents if not parent.exists()]
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".new-", dir=root) as temporary:
            new = Path(temporary) / "new"
            new.mkdir()
            yield DatasetWriter(new / _DATA, stage, {"dataset_id": name, **metadata})
            _write_namespaces(root, name)
            replace_folder(new, folder, Path(temporary) / "old")
    except BaseException as error:  # Ctrl-C, too
        with suppress(OSError):
            for parent in made:
                parent.rmdir()
        if isinstance(error, OSError):
            raise AmulettError(f"cannot write the data set '{folder}': {error.strerror or error}") from error
        raise


def check_free(root: Path, name: str, overwrite: bool = False) -> None:
    """Raise an AmulettError if a data set of this name cannot be written to the folder of all data sets."""
    folder = root / name
    for parent in folder.parents[: len(Path(name).parts) - 1]:
        if (parent / _DATA).exists():
            raise AmulettError(f"'{parent}' is a data set, which holds no others; choose another --name")
    if not folder.exists():
        return
    if not (folder / _DATA).is_dir():
        raise AmulettError(f"'{folder}' exists and is no data set; choose another --name or --out")
    if not overwrite:
        raise AmulettError(
            f"there is a data set '{name}' in '{root}' already; choose another --name, such as a higher version, or "
            "replace it with --overwrite"
        )


def open_dataset(name: str, root: str | Path | None = None) -> Any:
    """Return a data set as Minari's `MinariDataset`.

    Parameters
    ----------
    name : str
        A name, or the data set's folder.
    root : str or Path, optional
        As of `datasets_folder`.

    Raises
    ------
    AmulettError
        If Minari is not installed, there is no such data set, or it cannot be read.
    """
    check_minari()
    import minari

    own = user_path(name).absolute()
    place = own if (own / _DATA).is_dir() else datasets_folder(root) / name
    if not (place / _DATA).is_dir():
        folder = datasets_folder(root)
        known = sorted(
            path.parents[1].relative_to(folder).as_posix() for path in folder.rglob(f"{_DATA}/metadata.json")
        )
        listed = f"there are {', '.join(known[:10])}" if known else "there are none; amulett record writes one"
        raise AmulettError(f"there is no data set '{name}' in '{folder}': {listed}{nearest(name, known)}")
    try:
        return minari.MinariDataset(place / _DATA)
    except Exception as error:  # whatever a damaged file makes of Minari
        raise AmulettError(f"cannot read the data set '{place}': {error}") from error


def _try_room(folder: Path, size: int) -> None:
    """Raise an OSError if a file of `size` bytes does not fit: where HDF5 finds no room, it crashes the process."""
    block = memoryview(bytes(2**20))
    with tempfile.TemporaryFile(dir=folder, buffering=0) as file:
        while size > 0:
            size -= file.write(block[:size])


def _write_namespaces(root: Path, name: str) -> None:
    """Mark the folders above a data set as Minari's namespaces, as `minari.namespace.create_namespace` does."""
    from minari.namespace import NAMESPACE_METADATA_FILENAME

    for parent in (root / name).parents[: len(Path(name).parts) - 1]:
        mark = parent / NAMESPACE_METADATA_FILENAME
        if not mark.exists():
            mark.write_text("{}")
