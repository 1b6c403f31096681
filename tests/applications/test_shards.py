"""Work in shards: every input once, whoever is killed on the way, and the answers of a single process."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from helpers.command_line import LAPTOP, K, answer, laptop_view, refused
from helpers.shards import Squares
from omad.applications.cluster import engines
from omad.applications.cluster.engines import in_processes
from omad.applications.cluster.shards import Plan, Report, run_shards
from omad.common.errors import InputError, WorkError
from omad.data.shards.parquet import part_name
from omad.data.shards.store import Store

pytest.importorskip("pyarrow", reason="shards are Parquet files: pip install 'omad[parquet]'")

TOTAL, SIZE = 23, 4


def plan(output: Path | str, work: Squares) -> Plan:
    return Plan(Store.of(output), work, TOTAL, SIZE)


def here(plan: Plan, numbers: list[int]):
    """An engine without processes."""
    return map(plan, numbers)


def assert_all_once(plan: Plan, report: Report) -> None:
    assert [row["number"] for row in plan.rows()] == list(range(TOTAL))
    assert [row["square"] for row in plan.rows()] == [i * i for i in range(TOTAL)]
    assert (report.rows, report.refused, len(report.shards)) == (TOTAL, 3, 6)


def test_what_is_there_is_not_made_again(tmp_path):
    whole = plan(tmp_path / "out", Squares(tmp_path))
    assert_all_once(whole, run_shards(whole, {"a": 1}, here))
    (tmp_path / "out" / part_name(2)).unlink()
    again = run_shards(whole, {"a": 1}, here)
    assert_all_once(whole, again)
    assert again.earlier == TOTAL - SIZE
    assert whole.work.begun() == [0, 4, 8, 12, 16, 20, 8]
    assert not list(tmp_path.rglob(".omad-*"))


def test_a_cluster_may_tell_of_a_shard_twice(tmp_path):
    whole = plan(tmp_path / "out", Squares(tmp_path))
    assert_all_once(whole, run_shards(whole, {}, lambda plan, numbers: map(plan, [*numbers, 0, 3])))
    assert whole.work.begun() == [0, 4, 8, 12, 16, 20]


def test_other_inputs_settings_and_files_are_not_mixed(tmp_path):
    run_shards(plan(tmp_path / "out", Squares(tmp_path)), {"a": 1}, here)
    with pytest.raises(InputError, match="made of other inputs or settings"):
        run_shards(plan(tmp_path / "out", Squares(tmp_path)), {"a": 2}, here)
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / "part-000000.parquet").write_bytes(b"PAR1")
    with pytest.raises(InputError, match="files of another program"):
        run_shards(plan(tmp_path / "foreign", Squares(tmp_path)), {}, here)
    (tmp_path / "out" / "part-000001.parquet").write_bytes(b"PAR1")
    with pytest.raises(InputError, match=r"part-000001\.parquet: is none of this run's files"):
        run_shards(plan(tmp_path / "out", Squares(tmp_path)), {"a": 1}, here)


def test_a_shard_that_lacks_rows_is_not_written(tmp_path):
    with pytest.raises(InputError, match="3 rows of 4 inputs"):
        run_shards(plan(tmp_path / "out", Squares(tmp_path, short=True)), {}, here)
    with pytest.raises(WorkError, match="6 of 6 shards are missing"):
        run_shards(plan(tmp_path / "out", Squares(tmp_path)), {}, lambda plan, numbers: iter(()))
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["_run.json"]


def test_at_an_address(tmp_path):
    pytest.importorskip("fsspec", reason="addresses need fsspec: pip install 'omad[cluster]'")
    whole = plan("memory://bucket/deep/out", Squares(tmp_path))
    assert_all_once(whole, run_shards(whole, {}, here))
    assert run_shards(whole, {}, here).earlier == TOTAL
    assert whole.store.names() == {"_run.json", *map(part_name, range(6))}
    assert plan(Path("memory://bucket/deep/out"), Squares(tmp_path)).store == whole.store
    with pytest.raises(InputError, match="cannot be reached"):
        Store.of("nosuch://bucket")


def test_what_is_put_at_an_address_is_there_when_all_of_it_is(tmp_path, monkeypatch):
    fsspec = pytest.importorskip("fsspec", reason="addresses need fsspec: pip install 'omad[cluster]'")
    store, system = Store.of(f"file://{tmp_path}/out"), fsspec.filesystem("file")
    store.write("part", b"first")
    put = type(system).pipe_file

    def killed(self, path: str, value: bytes, **options: object) -> None:
        put(self, path, value[:2], **options)
        raise OSError("no network")

    with monkeypatch.context() as patched:
        patched.setattr(type(system), "pipe_file", killed)
        for name in ("part", "other"):
            with pytest.raises(OSError, match="no network"):
                store.write(name, b"second")
    assert (store.names(), store.read("part"), store.has("other")) == ({"part"}, b"first", False)
    store.write("part", b"second")
    assert (store.names(), store.read("part")) == ({"part"}, b"second")


def test_processes_do_what_failed_or_was_killed_again(tmp_path, begun_quickly, monkeypatch):
    monkeypatch.setattr(engines, "PAUSE", 0.01)
    whole = plan(tmp_path / "out", Squares(tmp_path, fails=(4, 12), kills=(8,)))
    assert_all_once(whole, run_shards(whole, {}, lambda plan, numbers: in_processes(plan, numbers, 2)))
    assert not list(tmp_path.rglob(".omad-*"))


def test_bad_input_ends_a_run_in_one_line_and_is_not_tried_again(tmp_path):
    whole = plan(tmp_path / "out", Squares(tmp_path, bad=(4,)))
    with pytest.raises(InputError, match="4: is bad"):
        run_shards(whole, {}, lambda plan, numbers: in_processes(plan, numbers, 1))
    assert whole.work.begun().count(4) == 1
    mended = plan(tmp_path / "out", Squares(tmp_path))
    assert_all_once(mended, run_shards(mended, {}, here))


@pytest.fixture
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.save("stack.npy", np.stack([np.roll(laptop_view().depth, 4 * i, 1) for i in range(24)]))


@pytest.fixture
def without_ray(monkeypatch):
    found = engines.importlib.util.find_spec
    monkeypatch.setattr(engines.importlib.util, "find_spec", lambda name: None if name == "ray" else found(name))


def shard_rows(folder: str) -> list[dict]:
    import pyarrow.parquet

    files = sorted(Path(folder).glob("part-*.parquet"))
    return [row for file in files for row in pyarrow.parquet.read_table(file).to_pylist()]


def assert_same_rows(folder: str, lines: str) -> None:
    found, expected = shard_rows(folder), [json.loads(line) for line in Path(lines).read_text().splitlines()]
    assert [Path(row["name"]).name for row in found] == [Path(row["name"]).name for row in expected]
    for row, other in zip(found, expected, strict=True):
        assert row["refused"] == other["refused"]
        if other["refused"] is None:
            assert row["joints"][0]["state"] == pytest.approx(other["joints"][0]["state"], abs=1e-6)
            np.testing.assert_allclose(row["T_camera_part"], other["T_camera_part"], atol=1e-6)


@pytest.mark.slow
def test_what_is_rendered_in_shards_is_estimated_and_measured(
    in_a_folder_of_its_own, without_ray, begun_quickly, capsys
):
    """Without Ray the same commands use processes."""
    objects = [*LAPTOP, "--objects", "2", "--views", "10"]
    made = answer(capsys, "render", *objects, "--cluster", "--shard", "4", "--output", "views", "--workers", "2")
    assert (made["images"], made["shards"], made["done_before"]) == (10, 3, 0)
    told = answer(capsys, "bulk", "views", *LAPTOP, "--cluster", "--shard", "5", "--batch", "5", "--output", "out")
    assert (told["images"], told["refused"]) == (10, 0)
    answer(capsys, "bulk", "views", *LAPTOP, "--batch", "5", "--output", "out.jsonl")
    assert_same_rows("out", "out.jsonl")
    answer(capsys, "render", *objects, "--output", "folder")
    answer(capsys, "bulk", "folder/laptop-test-0-00000", *LAPTOP, "--batch", "5", "--output", "folder.jsonl")
    plain = [json.loads(line) for line in Path("folder.jsonl").read_text().splitlines()]
    first = [row for row in shard_rows("out") if row["name"].startswith("laptop-test-0-00000/")]
    assert len(first) == len(plain) == 5
    for row, other in zip(first, plain, strict=True):
        assert row["joints"][0]["state"] == pytest.approx(other["joints"][0]["state"], abs=1e-6)
    measured = answer(capsys, "eval", "pose", *objects, "--cluster", "--shard", "5", "--output", "errors")
    whole = answer(capsys, "eval", "pose", *objects)
    for key in ("initial", "refined", "interval", "by_object", "failures", "views", "objects"):
        assert json.dumps(measured[key]) == json.dumps(whole[key]) or np.allclose(
            [*_numbers(measured[key])],
            [*_numbers(whole[key])],
            atol=1e-4,
            equal_nan=True,  # degrees, by other batches
        )
    assert "--output: is missing" in refused(capsys, "eval", "pose", *objects, "--cluster")
    once = ["eval", "pose", *objects, "--cluster", "--shard", "5", "--output"]
    assert "other inputs or settings" in refused(capsys, *once, "errors", "--to-surface")
    further = answer(capsys, *once, "further", "--to-surface")
    assert further["initial"]["joint_state_error_deg"] == measured["initial"]["joint_state_error_deg"]
    assert further["refined"]["joint_state_error_deg"] != measured["refined"]["joint_state_error_deg"]
    assert further["seconds"].keys() == {"network", "refinement", "surface"}
    assert measured["seconds"].keys() == {"network", "refinement"}
    answer(capsys, "export", *LAPTOP, "--output", "own")
    answer(capsys, *once, "of-own", "--weights", "own")
    Path("own/confidence.json").unlink()  # other weights, called as before
    assert "other inputs or settings" in refused(capsys, *once, "of-own", "--weights", "own")
    assert "--broken" in refused(capsys, *once, "errors", "--broken", "skip")


@pytest.mark.slow
def test_accuracy_is_measured_on_what_was_rendered(in_a_folder_of_its_own, without_ray, begun_quickly, capsys):
    """With and without --cluster, and as on the same views of a folder."""
    objects = [*LAPTOP, "--objects", "2", "--views", "10"]
    answer(capsys, "render", *objects, "--cluster", "--shard", "4", "--output", "views", "--workers", "1")
    answer(capsys, "render", *objects, "--output", "folder", "--workers", "1")
    folder = answer(capsys, "eval", "pose", *LAPTOP, "--source", "folder")
    shards = answer(capsys, "eval", "pose", *LAPTOP, "--source", "views")
    cluster = ["--cluster", "--shard", "6", "--output", "errors", "--workers", "1"]
    sharded = answer(capsys, "eval", "pose", *LAPTOP, "--source", "views", *cluster)
    assert (folder["views"], shards["views"], sharded["views"]) == (10, 10, 10)
    for key in ("refined", "initial", "by_object"):
        assert shards[key] == folder[key]
    errors = [told["refined"]["joint_state_error"] for told in (sharded, shards)]
    for found, other in zip(*errors, strict=True):
        assert found == pytest.approx(other, abs=1e-6)
    answer(capsys, "render", *objects, "--seed", "1", "--output", "others", "--workers", "1")
    Path("views").rename("before")
    Path("others").rename("views")  # other views where the measured ones were
    assert "other inputs or settings" in refused(capsys, "eval", "pose", *LAPTOP, "--source", "views", *cluster)
    Path("views").rename("others")
    Path("before").rename("views")
    line = refused(capsys, "eval", "pose", *LAPTOP, "--source", "errors")
    assert "holds no views with their truth" in line
    line = refused(capsys, "eval", "pose", "--category", "scissors", "--source", "views")
    assert "views of laptop, not of scissors" in line
    line = refused(capsys, "eval", "pose", *LAPTOP, "--source", "views", "--depth-noise", "on")
    assert "is rendered already" in line


def _numbers(value):
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        for each in value:
            yield from _numbers(each)
    elif isinstance(value, int | float):
        yield float(value)


@pytest.mark.slow
def test_a_killed_run_in_shards_goes_on_where_it_was(in_a_folder_of_its_own, without_ray, capsys):
    arguments = ["bulk", "stack.npy", *LAPTOP, *K, "--batch", "2", "--cluster", "--shard", "2", "--workers", "1"]
    script = "import sys, importlib.util as u; f = u.find_spec; u.find_spec = lambda n: None if n == 'ray' else f(n)\n"
    script += "if __name__ == '__main__':\n    from omad.__main__ import main; main()"
    Path("without_ray.py").write_text(script)
    command = [sys.executable, "without_ray.py", *arguments, "--output", "out"]
    process = subprocess.Popen(command)
    while len(list(Path("out").glob("part-*"))) < 2:
        assert process.poll() is None
        time.sleep(0.01)
    process.kill()
    process.wait()
    told = answer(capsys, *arguments, "--output", "out")
    assert 4 <= told["done_before"] < 24
    answer(capsys, "bulk", "stack.npy", *LAPTOP, *K, "--batch", "2", "--output", "whole.jsonl")
    assert_same_rows("out", "whole.jsonl")
    assert "other inputs or settings" in refused(capsys, *arguments, "--output", "out", "--depth-scale", "2")


def test_without_a_cluster_to_reach_the_run_ends_in_one_line(tmp_path, monkeypatch):
    ray = pytest.importorskip("ray", reason="needs Ray: pip install 'omad[cluster]'")
    pytest.importorskip("ray.data")

    def init(**options):
        raise ConnectionError("nobody\nanswers")

    monkeypatch.setattr(ray, "init", init)
    with pytest.raises(WorkError, match=r"no cluster can be reached or started \(nobody answers\); see RAY_ADDRESS"):
        run_shards(plan(tmp_path / "out", Squares(tmp_path)), {}, engines.on_cluster)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="a cluster of several nodes on one machine is for Linux")
def test_a_cluster_that_loses_a_node_loses_and_doubles_nothing(in_a_folder_of_its_own, capsys, monkeypatch):
    pytest.importorskip("ray.data", reason="needs Ray: pip install 'omad[cluster]'")
    from ray.cluster_utils import Cluster

    monkeypatch.setenv("RAY_worker_niceness", "0")  # or its workers wait for other tests
    small = {"num_cpus": 1, "object_store_memory": 100_000_000}
    cluster = Cluster(initialize_head=True, head_node_args=small | {"include_dashboard": False})
    try:
        other = cluster.add_node(**small)
        cluster.wait_for_nodes(timeout=120)
        arguments = ["bulk", "stack.npy", *LAPTOP, *K, "--batch", "2"]
        command = [sys.executable, "-m", "omad", *arguments, "--cluster", "--shard", "2", "--output", "out", "--json"]
        environment = os.environ | {"RAY_ADDRESS": cluster.address}
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
        while len(list(Path("out").glob("part-*"))) < 2:
            assert process.poll() is None
            time.sleep(0.05)
        done = len(list(Path("out").glob("part-*")))
        cluster.remove_node(other, allow_graceful=False)
        told, _ = process.communicate(timeout=500)
    finally:
        cluster.shutdown()
    assert process.returncode == 0
    assert done < 12
    found = json.loads(told)
    assert (found["images"], found["refused"], found["shards"], found["done_before"]) == (24, 0, 12, 0)
    answer(capsys, *arguments, "--output", "whole.jsonl")
    assert_same_rows("out", "whole.jsonl")
    assert not list(Path().rglob(".omad-*"))
