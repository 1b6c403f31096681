"""Views in shards are a source of views: the very ones that a rendered folder holds."""

import json
from dataclasses import asdict, replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

import omad
from omad.applications.cluster.render import RenderWork
from omad.applications.cluster.shards import Plan, run_shards
from omad.common.errors import InputError
from omad.data.rendering.standard_views import View
from omad.data.rendering.view_folder import open_views, render_to_folder
from omad.data.shards.parquet import RUN, import_pyarrow, part_name
from omad.data.shards.store import Store
from omad.data.shards.views import row_of, run_record, view_schema
from omad.data.source import ViewSource, load_models, load_views

pytest.importorskip("pyarrow", reason="shards are Parquet files: pip install 'omad[parquet]'")

TOTAL = 7
CATEGORY = omad.get_category("laptop")


def rendered(place: Path | str, clutter: bool = False, total: int = TOTAL, size: int = 3) -> None:
    work = RenderWork("laptop", "procedural", 2, "test", 0, "off", clutter)
    models = load_models("procedural", CATEGORY, 2, "test", 0).models
    made_of = {**asdict(work), **run_record(CATEGORY, models)}
    run_shards(Plan(Store.of(place), work, total, size), made_of, lambda plan, numbers: map(plan, numbers))


def loaded(place: Path | str, skip: int = 0, name: str = "laptop") -> ViewSource:
    return load_views(str(place), omad.get_category(name), 1, 1, 0, "off", "refuse", skip)


def assert_same(view: View, other: View) -> None:
    for name in ("depth", "labels", "states", "T_camera_base"):
        np.testing.assert_array_equal(getattr(view, name), getattr(other, name), err_msg=name)
    for name in ("axes", "pivots", "limits", "part_boxes"):
        np.testing.assert_array_equal(getattr(view.truth, name), getattr(other.truth, name), err_msg=name)
    assert (view.object, view.camera, view.seed) == (other.object, other.camera, other.seed)
    assert (view.mask is None) == (other.mask is None)
    assert view.mask is None or np.array_equal(view.mask, other.mask)


@pytest.mark.parametrize("clutter", [False, True])
def test_they_are_those_of_a_rendered_folder(clutter, tmp_path):
    total = 3 if clutter else TOTAL
    rendered(tmp_path / "shards", clutter, total, 2 if clutter else 3)
    models = load_models("procedural", CATEGORY, 2, "test", 0).models
    folder = render_to_folder(models, CATEGORY, tmp_path / "folder", total, clutter=clutter)
    found = loaded(tmp_path / "shards")
    assert (found.total, found.noisy) == (total, clutter)
    for view, other in zip(found.views, folder, strict=True):
        assert_same(view, other)


def test_they_say_of_which_hand_the_object_was_and_older_ones_of_none(tmp_path):
    pyarrow = import_pyarrow()
    rendered(tmp_path, total=1, size=1)
    [view] = loaded(tmp_path).views
    other = replace(view, truth=replace(view.truth, of_other_hand=True))
    table = pyarrow.Table.from_pylist([row_of(other, 1e-4)], schema=view_schema(clutter=False))
    for rows, told in ((table, True), (table.drop_columns(["of_other_hand"]), False)):
        pyarrow.parquet.write_table(rows, tmp_path / part_name(0))
        assert [each.truth.of_other_hand for each in loaded(tmp_path).views] == [told]


def test_a_run_does_not_go_on_with_other_objects_of_the_same_names_or_another_spec():
    first, second = load_models("procedural", CATEGORY, 2, "test", 0).models
    told = run_record(CATEGORY, [first, second])
    assert told == run_record(CATEGORY, [first, second])
    wider = second.stretched(np.array([1.1, 1.0, 1.0]))
    around = replace(CATEGORY, views=replace(CATEGORY.views, azimuth=3.0))
    for other in (run_record(CATEGORY, [first, wider]), run_record(CATEGORY, [first]), run_record(around, [first])):
        assert other != told


def test_any_may_be_the_first_whatever_shard_it_is_in(tmp_path):
    rendered(tmp_path / "shards")
    models = load_models("procedural", CATEGORY, 2, "test", 0).models
    render_to_folder(models, CATEGORY, tmp_path / "folder", TOTAL)
    seeds = [view.seed for view in open_views(tmp_path / "folder")]
    for place in ("shards", "folder"):
        for skip in range(TOTAL + 1):
            assert [view.seed for view in loaded(tmp_path / place, skip).views] == seeds[skip:]
    (tmp_path / "shards" / part_name(0)).write_bytes(b"nothing")  # what lies before is not opened
    assert next(iter(loaded(tmp_path / "shards", 3).views)).seed == seeds[3]
    assert next(iter(loaded(tmp_path / "shards", 3).views)).seed == seeds[3]


def test_at_an_address():
    pytest.importorskip("fsspec", reason="addresses need fsspec: pip install 'omad[cluster]'")
    rendered("memory://bucket/views")
    found = loaded("memory://bucket/views")
    assert (found.total, len(list(islice(found.views, 4)))) == (TOTAL, 4)
    with pytest.raises(
        InputError, match=r"no _run\.json there; give a folder or an address that omad render --cluster"
    ):
        loaded("memory://bucket/nothing")
    with pytest.raises(InputError, match="cannot be reached"):
        loaded("nosuch://bucket/views")


def test_what_is_not_whole_or_of_another_kind_is_refused(tmp_path):
    rendered(tmp_path)
    with pytest.raises(InputError, match="views of laptop, not of scissors"):
        loaded(tmp_path, name="scissors")
    with pytest.raises(InputError, match="leave out --broken skip"):
        load_views(str(tmp_path), CATEGORY, 1, 1, 0, "off", "skip")
    run, last = tmp_path / RUN, tmp_path / part_name(2)
    kept, record = last.read_bytes(), json.loads(run.read_text())
    last.unlink()
    with pytest.raises(InputError, match="not all of its 3 shards are there; give the same render command again"):
        loaded(tmp_path)
    last.write_bytes((tmp_path / part_name(0)).read_bytes())
    with pytest.raises(InputError, match=r"part-000002.parquet: 3 views in place of 1; delete it, render again"):
        list(loaded(tmp_path).views)
    last.write_bytes(kept[:-20])
    with pytest.raises(InputError, match=r"part-000002.parquet: not readable as views in shards"):
        list(loaded(tmp_path).views)
    parquet = import_pyarrow().parquet
    parquet.write_table(parquet.read_table(tmp_path / part_name(0)).drop_columns("part_boxes"), tmp_path / part_name(0))
    with pytest.raises(InputError, match="no column part_boxes; render it again"):
        list(loaded(tmp_path).views)
    run.write_text(json.dumps({key: value for key, value in record.items() if key != "format"}))
    with pytest.raises(InputError, match="holds no views with their truth in shards"):
        loaded(tmp_path)
    run.write_text(json.dumps({**record, "total": 10**12, "shard": 1}))
    with pytest.raises(InputError, match="not all of its 1000000000000 shards"):
        loaded(tmp_path)


@pytest.mark.parametrize(
    ("column", "value", "told"),
    [
        ("states", [0.1, 0.2], "states"),
        ("axes", [float("nan"), 0.0, 0.0], "axes: is .*; give finite numbers"),
        ("T_camera_base", [2.0] * 16, "T_camera_base: its 3x3 part is no rotation"),
        ("labels", b"nothing", "labels: not readable as an image"),
        ("depth", None, "not readable as a view"),
        ("intrinsics", [0.0, 1.0, 1.0, 1.0], "camera: fx"),
        ("depth_scale", -1.0, "depth_scale: is -1.0; give a number"),
    ],
)
def test_a_bad_row_is_named(column, value, told, tmp_path):
    rendered(tmp_path, total=2, size=2)
    parquet, file = import_pyarrow().parquet, tmp_path / part_name(0)
    table = parquet.read_table(file)
    rows = table.to_pylist()
    rows[1][column] = value
    parquet.write_table(type(table).from_pylist(rows, table.schema), file)
    views = iter(loaded(tmp_path).views)
    next(views)
    with pytest.raises(InputError, match=rf"part-000000.parquet\[1\].*{told}"):
        next(views)
