"""Jobs in several processes: all are done, and an error is passed on."""

from functools import partial
from pathlib import Path

import pytest

from amulett_gym.errors import AmulettError
from amulett_gym.profile import load_profile
from amulett_gym.studies.benchmark.processes import work_ahead


def test_all_jobs_are_done_and_errors_are_passed_on(tmp_path):
    files = [tmp_path / str(k) for k in range(3)]
    work_ahead([partial(Path.mkdir, file) for file in files], 1, "jobs")
    assert not any(file.exists() for file in files)  # one process: the caller does them
    work_ahead([partial(Path.mkdir, file) for file in files], 2, "jobs")
    assert all(file.exists() for file in files)
    with pytest.raises(AmulettError, match="nonesuch"):
        work_ahead([partial(load_profile, "nonesuch")], 2, "jobs")
