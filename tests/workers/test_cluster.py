"""Calls on a Ray cluster of two nodes on this machine give what they give here, whatever is killed meanwhile."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from helpers import SMALL_RECIPE, wait_until

from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.search.law_recipe import Recipe
from amulett_gym.evaluation.search.laws import tune_all
from amulett_gym.workers import report
from amulett_gym.workers.call import MOST_LOST, Call, Workers
from amulett_gym.workers.run import results

ray = pytest.importorskip("ray")


@pytest.fixture(scope="module")
def cluster():
    """Start a cluster with two nodes of one processor, whose workers import nothing from the folder of tests."""
    from ray.cluster_utils import Cluster

    ray.cloudpickle.register_pickle_by_value(sys.modules[__name__])
    # On a busy machine a node that answers late is not dead; one that is refuses the connection.
    patient = {"health_check_timeout_ms": 300_000, "health_check_period_ms": 1000, "health_check_failure_threshold": 3}
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_AUTH_MODE", "disabled")  # whatever tokens this user has
        patch.setenv("RAY_worker_niceness", "0")  # as this process, also then
        patch.setenv("RAY_CLIENT_SERVER_CHECK_CHANNEL_TIMEOUT_S", "300")
        made = Cluster()
        client = {"ray_client_server_port": _free_port()}
        made.add_node(num_cpus=1, include_dashboard=False, _system_config=patient, **client)
        made.add_node(num_cpus=1)
        yield made
        ray.shutdown()
        made.shutdown()


def _free_port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


@pytest.fixture
def workers(cluster):
    return Workers(ray=cluster.address)


def _square(number):
    report.advance(number)
    if number < 0:
        raise ValueError("negative")
    return number * number, ray.get_runtime_context().get_node_id()


def test_results_come_from_both_nodes_with_their_progress(workers):
    units = []
    calls = {f"of {number}": Call(_slow_square, (number,)) for number in range(6)}
    found = dict(results(calls, workers, units.append))
    assert {name: result for name, (result, _) in found.items()} == {f"of {k}": k * k for k in range(6)}
    assert sum(units) == 15
    assert len({node for _, node in found.values()}) == 2
    assert dict(results({}, workers)) == {}


def _slow_square(number):
    time.sleep(0.5)
    return _square(number)


def test_an_error_names_call_and_host(workers):
    with pytest.raises(ValueError, match="negative") as caught:
        dict(results({"wrong": Call(_square, (-1,))}, workers))
    trace, where = caught.value.__notes__
    assert where == f"amulett: in wrong, on {os.uname().nodename}" and "in _square" in trace
    with pytest.raises(AmulettError, match=f"^wrong, on {os.uname().nodename}: it is odd$"):
        dict(results({"wrong": Call(_refuse)}, workers))


def _refuse():
    raise AmulettError("it is odd")


def _count_on(folder, end, killed_at, note):
    """Count on from the number in the folder, which is kept; this process is killed once at each of some numbers."""
    from amulett_gym.workers import cluster as engine

    engine._BETWEEN = engine._SHARE = 0  # in this worker: files are copied each time, however long that takes
    path = folder / "number"
    for number in range(int(path.read_text()) if path.exists() else 0, end):
        with note.open("a") as file:
            file.write(f"{number}\n")
        report.advance(1)
        path.write_text(str(number + 1))
        (folder / f"part-{number}").write_text("")
        (folder / f"part-{number - 2}").unlink(missing_ok=True)
        time.sleep(0.05)
        report.keep()
        mark = note.with_name(f"{note.name}-{number}")
        if number + 1 in killed_at and not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
    return str(folder)


def test_a_call_whose_worker_is_killed_continues_from_what_it_kept(workers, tmp_path):
    units = []
    for name in ("killed", "other"):
        (tmp_path / name).mkdir()
    calls = {
        name: Call(_count_on, (20, at, tmp_path / f"{name}.txt"), tmp_path / name)
        for name, at in (("killed", (5, 6, 7, 8, 9, 12)), ("other", ()))
    }
    found = dict(results(calls, workers, units.append))
    assert all(not place.startswith(str(tmp_path)) for place in found.values())  # a copy, as on another machine
    for name in calls:
        lines = (tmp_path / f"{name}.txt").read_text().splitlines()
        assert lines == sorted(lines, key=int)
        assert 20 <= len(lines) <= (20 if name == "other" else 26)  # at most the one that was not yet kept, again
        assert sorted(path.name for path in (tmp_path / name).iterdir()) == ["number", "part-18", "part-19"]
        assert (tmp_path / name / "number").read_text() == "20"


def test_a_call_that_kills_its_worker_again_and_again_is_named(workers):
    with pytest.raises(AmulettError, match=rf"^bad: its worker was killed {MOST_LOST + 1} times \(WorkerCrashedError"):
        dict(results({"bad": Call(_end)}, workers))


def _end():
    os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(60)


def test_a_node_that_leaves_loses_no_call(cluster, workers, tmp_path):
    node = cluster.add_node(num_cpus=2)

    def remove():
        wait_until(lambda: any(node.node_id in path.read_text() for path in tmp_path.iterdir()))
        cluster.remove_node(node, allow_graceful=False)

    removing = threading.Thread(target=remove)
    removing.start()
    calls = {f"of {k}": Call(_wait_there, (tmp_path / str(k), k)) for k in range(4)}
    assert dict(results(calls, workers)) == {f"of {k}": k for k in range(4)}
    removing.join()
    places = [(tmp_path / str(k)).read_text().splitlines() for k in range(4)]
    assert max(map(len, places)) == 2  # once there, and once again elsewhere
    assert all(names[-1] != node.node_id for names in places if len(names) == 2)


def _wait_there(note, number):
    with note.open("a") as file:
        file.write(ray.get_runtime_context().get_node_id() + "\n")
    time.sleep(5.0)
    return number


@pytest.mark.parametrize(("number", "together"), [(1, 1), (None, 2)])
def test_no_more_calls_run_at_a_time_than_the_number_given(cluster, number, together):
    calls = {f"of {k}": Call(_times) for k in range(10)}
    times = sorted(time for _, times in results(calls, Workers(number, cluster.address)) for time in times)
    running, most = 0, 0
    for _, change in times:
        running += change
        most = max(most, running)
    assert most == together


def _times():
    begun = time.time()
    time.sleep(0.3)
    return (begun, 1), (time.time(), -1)


def test_the_next_call_begins_while_a_result_is_used(cluster, tmp_path):
    calls = {f"of {k}": Call(Path.touch, (tmp_path / str(k),)) for k in range(3)}
    with contextlib.closing(results(calls, Workers(1, cluster.address))) as finished:
        next(finished)
        wait_until(lambda: len(list(tmp_path.iterdir())) == 2)


def test_files_are_copied_at_most_once_a_second(workers, tmp_path):
    found = dict(results({"often": Call(_keep_often, (), tmp_path / "often")}, workers))
    assert found["often"] in (2, 3)  # at once, and in the two seconds after that
    assert (tmp_path / "often" / "number").read_text() == "last"


def _keep_often(folder):
    """Keep the folder every 10 ms, and return how often it was copied."""
    from amulett_gym.workers import cluster as engine

    copies, changes = [], engine._Messenger.changes
    engine._Messenger.changes = lambda self: copies.append(changes(self)) or copies[-1]
    try:
        end = time.monotonic() + 2.5
        while time.monotonic() < end:
            (folder / "number").write_text(str(time.monotonic()))
            report.keep()
            time.sleep(0.01)
        (folder / "number").write_text("last")
        return len(copies)
    finally:
        engine._Messenger.changes = changes


def test_a_law_is_tuned_alike_on_a_cluster(workers, tmp_path):
    recipe = Recipe("eq6-tuned", seeds=(1, 2), population=6, generations=((2, 3), (3, 2)), validation=3)
    here = tune_all(tmp_path / "here", [recipe])
    assert tune_all(tmp_path / "there", [recipe], workers=workers) == here
    assert _files(tmp_path / "here") == _files(tmp_path / "there")


def _files(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


LONGER = Recipe("eq6-tuned", seeds=(1, 2), population=6, generations=((2, 30),), validation=3)


def test_a_driver_that_is_killed_goes_on_where_it_was(workers, tmp_path):
    script = (
        "import sys\n"
        "from amulett_gym.evaluation.search.law_recipe import Recipe\n"
        "from amulett_gym.evaluation.search.laws import tune_all\n"
        "from amulett_gym.workers.call import Workers\n"
        f"recipe = Recipe('eq6-tuned', seeds=(1, 2), population=6, generations={LONGER.generations}, validation=3)\n"
        "tune_all(sys.argv[1], [recipe], workers=Workers(ray=sys.argv[2]))\n"
    )
    there, begun = tmp_path / "there", []
    driver = subprocess.Popen([sys.executable, "-c", script, str(there), workers.ray])
    wait_until(lambda: list(there.glob("stages/[!.]*.json")))
    driver.kill()
    driver.wait()
    tune_all(there, [LONGER], begin=begun.append, workers=workers)
    assert 0 < begun[0] < LONGER.episodes  # what was kept is not simulated again
    tune_all(tmp_path / "here", [LONGER])
    assert _files(tmp_path / "here") == _files(there)


def test_seeds_are_trained_alike_though_their_workers_are_killed(workers, tmp_path):
    config = pytest.importorskip("amulett_agents.config")
    training = pytest.importorskip("amulett_agents.training")
    recipe = config.load_train_config(None, [*SMALL_RECIPE, "checkpoint_seconds=0", "total_steps=20480"])
    here, there = tmp_path / "here", tmp_path / "there"

    def kill():
        wait_until(lambda: (there / "seed-1" / "evaluations.csv").is_file())
        assert _kill(f"ray::amulett: training run '{there}")

    killing = threading.Thread(target=kill)
    killing.start()
    results_there = training.train_seeds(recipe, [0, 1], there, workers, progress=False)
    killing.join()
    results_here = training.train_seeds(recipe, [0, 1], here, progress=False)
    for found, expected in zip(results_there, results_here, strict=True):
        assert (found.best_cost, found.last_cost, found.steps) == (
            expected.best_cost,
            expected.last_cost,
            expected.steps,
        )
        for bundle in ("best", "last"):
            weights = [result.out / bundle / "weights.safetensors" for result in (found, expected)]
            assert weights[0].read_bytes() == weights[1].read_bytes()
    names = [{name for name in _files(folder) if "tensorboard" not in name.parts} for folder in (here, there)]
    assert names[0] == names[1]


def _kill(title):
    """Kill the processes whose titles begin so, and return how many they were."""
    found = 0
    for place in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if (place / "cmdline").read_bytes().decode().startswith(title):
                os.kill(int(place.name), signal.SIGKILL)
                found += 1
    return found


@pytest.mark.parametrize("address", ["127.0.0.1:1", "ray://127.0.0.1:1"])
def test_a_cluster_that_is_not_there_is_an_error_that_says_what_to_do(address):
    with pytest.raises(AmulettError, match=f"no Ray cluster can be used at '{address}': .*ray start --head"):
        dict(results({"one": Call(_refuse)}, Workers(ray=address)))


@pytest.mark.parametrize("answer", [b"", b"HTTP/1.1 400 Bad Request\r\n\r\n"])
@pytest.mark.parametrize("address", ["127.0.0.1:{}", "ray://127.0.0.1:{}"])
def test_another_program_at_the_address_is_an_error_at_once(monkeypatch, answer, address):
    monkeypatch.setattr("amulett_gym.workers.cluster._KNOCK", 0.5)
    connections = []
    with socket.create_server(("127.0.0.1", 0)) as server:

        def listen():
            connection, _ = server.accept()
            connection.sendall(answer)
            connections.append(connection)  # stays open

        listening = threading.Thread(target=listen)
        listening.start()
        begun = time.monotonic()
        with pytest.raises(AmulettError, match="a program that is not Ray listens there"):
            dict(results({"one": Call(_refuse)}, Workers(ray=address.format(server.getsockname()[1]))))
        assert time.monotonic() - begun < 30.0
        listening.join()
    for connection in connections:
        connection.close()


def test_a_cluster_without_a_free_processor_is_reported(workers, monkeypatch, capsys):
    dict(results({"one": Call(bytes, (1,))}, workers))  # connects
    assert "no call has begun" not in capsys.readouterr().err
    monkeypatch.setattr("amulett_gym.workers.cluster._PATIENCE", 1.0)
    taken = [ray.remote(num_cpus=1)(_wait).remote(12.0) for _ in range(2)]
    time.sleep(3.0)  # both have begun
    assert dict(results({"one": Call(bytes, (1,))}, workers)) == {"one": b"\0"}
    said = capsys.readouterr().err
    assert said.count("no call has begun for 1 s") == 1 and "which has 2, none of them free" in said
    ray.get(taken)


def _wait(seconds):
    time.sleep(seconds)


class _Unreadable:
    """Cannot be unpickled."""

    def __reduce__(self):
        return _fail, ()


def _fail():
    raise ValueError("cannot be unpickled")


def _make_unreadable():
    return _Unreadable()


def test_what_cannot_be_sent_names_its_call(workers):
    with pytest.raises(AmulettError, match=r"^sent, on [\d.]+: the worker cannot make the call: .*cannot be unpickled"):
        dict(results({"sent": Call(len, (_Unreadable(),))}, workers))
    with pytest.raises(AmulettError, match="^returned: its result cannot be read here: .*cannot be unpickled"):
        dict(results({"returned": Call(_make_unreadable)}, workers))
    with pytest.raises(TypeError) as caught:
        dict(results({"locked": Call(len, (threading.Lock(),))}, workers))
    assert "amulett: in locked" in caught.value.__notes__
    found = results({"good": Call(len, ("abc",)), "locked": Call(len, (threading.Lock(),))}, Workers(1, workers.ray))
    assert next(found) == ("good", 3)  # what is finished comes first
    with pytest.raises(TypeError):
        next(found)


def test_results_come_before_the_error_of_one_that_ended_with_them(workers, tmp_path):
    go, marks = tmp_path / "go", [tmp_path / "bad", tmp_path / "good"]
    calls = {
        "first": Call(len, ("abc",)),
        "bad": Call(_make_after, (go, marks[0], _make_unreadable)),
        "good": Call(_make_after, (go, marks[1], int)),
    }
    with contextlib.closing(results(calls, workers)) as found:
        assert next(found) == ("first", 3)
        go.touch()
        wait_until(lambda: all(mark.exists() for mark in marks))
        time.sleep(2.0)  # both results arrive while the first one is used
        assert next(found) == ("good", 0)
        with pytest.raises(AmulettError, match="^bad: its result cannot be read here"):
            next(found)


def _make_after(go, mark, make):
    while not go.exists():
        time.sleep(0.05)
    mark.touch()
    return make()


def test_progress_takes_back_what_a_lost_worker_did_not_keep(workers, tmp_path):
    units = []
    assert dict(results({"lost": Call(_end_once, (tmp_path / "mark",))}, workers, units.append)) == {"lost": None}
    assert sum(units) == 10 and min(units) == -10


def _end_once(mark):
    report.advance(5)
    time.sleep(1.5)
    report.advance(5)  # reports both
    if not mark.exists():
        mark.touch()
        time.sleep(3.0)  # the driver reads them
        os.kill(os.getpid(), signal.SIGKILL)


def test_from_outside_the_cluster_it_is_the_same(cluster, tmp_path):
    pytest.importorskip("grpc")
    port = cluster.head_node._ray_params.ray_client_server_port
    (tmp_path / "counted").mkdir()
    calls = {"counted": Call(_count_on, (3, (2,), tmp_path / "counted.txt"), tmp_path / "counted")}
    try:
        assert "counted" in dict(results(calls, Workers(ray=f"ray://127.0.0.1:{port}")))
    finally:
        ray.shutdown()
    assert (tmp_path / "counted" / "number").read_text() == "3"
    assert (tmp_path / "counted.txt").read_text().split() in (["0", "1", "2"], ["0", "1", "1", "2"])
