"""Meshes that lie elsewhere than their URDF, and in units of their own."""

import shutil
import unicodedata
from pathlib import Path

import numpy as np
import pytest
import trimesh

import omad
from helpers.own_models import SPECS, microwave
from omad.common.errors import InputError
from omad.data.urdf_import.folder import import_model, load_folder
from omad.data.urdf_import.importing import import_folder
from omad.objects.urdf import write_urdf

MICROWAVE = omad.get_category(SPECS / "microwave.toml")


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_meshes_elsewhere_in_a_package_or_folder_are_watched_and_links_keep_their_names():
    """Robots' packages have their meshes beside the folder of URDFs."""
    for index, place in enumerate(("package", "kept")):
        write_urdf(microwave(width=0.5 + 0.05 * index), f"{place}/urdf/oven/oven.urdf")
        shutil.move(f"{place}/urdf/oven/meshes", f"{place}/meshes")
    Path("package/package.xml").write_text("<package/>")
    Path("models").mkdir()
    for index, place in enumerate(("package", "kept")):
        Path(f"models/{index}").symlink_to(f"../{place}/urdf/oven")

    def widths() -> list[float]:
        found = import_folder(Path("models"), MICROWAVE, Path("ours"), mesh_folder=Path("kept"))
        assert found.used == ["0", "1"]
        assert [model.name for model in load_folder("ours", MICROWAVE).models] == found.used
        return [round(float(np.ptp(model.part_boxes()[0, :, 0])), 6) for model in found.models]

    assert widths() == [0.5, 0.55]
    for index, place in enumerate(("package", "kept")):
        write_urdf(microwave("oven", width=0.6 + 0.05 * index), f"new{index}/oven.urdf")
        shutil.copytree(f"new{index}/meshes", f"{place}/meshes", dirs_exist_ok=True)
    assert widths() == [0.6, 0.65]


def test_a_package_is_one_object_and_two_of_one_name_are_refused():
    write_urdf(microwave(), "package/urdf/oven.urdf")
    shutil.move("package/urdf/meshes", "package/meshes")
    Path("package/package.xml").write_text("<package/>")
    found = load_folder("package", MICROWAVE)
    assert ([model.name for model in found.models], found.refused) == (["package"], [])
    write_urdf(microwave("x", width=0.5), "models/x.urdf")
    write_urdf(microwave("x", width=0.6), "models/x/oven.urdf")
    for read in (lambda: load_folder("models", MICROWAVE), lambda: import_folder("models", MICROWAVE, Path("ours"))):
        with pytest.raises(InputError, match=r"x\.urdf: is called as models/x is; rename one"):
            read()


def test_a_mesh_that_tells_its_unit_is_taken_in_it():
    made = microwave()
    file = write_urdf(made, Path("oven.urdf"))
    for mesh in Path("meshes").glob("*.obj"):
        solid = trimesh.load(mesh, process=False)
        collada = solid.apply_scale(1000.0).export(file_type="dae").decode()
        mesh.with_suffix(".dae").write_text(collada.replace("<up_axis>", '<unit name="mm" meter="0.001"/><up_axis>'))
    file.write_text(file.read_text().replace(".obj", ".dae"))
    np.testing.assert_allclose(import_model(file, MICROWAVE).part_boxes(), made.part_boxes(), atol=1e-9)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("meshes/", "meshes\\"),
        ("meshes/", "Meshes/"),
        (".obj", ".OBJ"),
        ("meshes/", "model://oven/meshes/"),
        ("meshes/", "file:///home/someone/oven/meshes/"),
        ("meshes/", "C:\\Users\\someone\\oven\\meshes\\"),
    ],
)
def test_a_mesh_may_be_named_as_on_windows_in_gazebo_or_elsewhere(before, after):
    made = microwave()
    file = write_urdf(made, Path("oven/oven.urdf"))
    file.write_text(file.read_text().replace(before, after))
    np.testing.assert_allclose(import_model(file, MICROWAVE).part_boxes(), made.part_boxes(), atol=1e-9)


@pytest.mark.parametrize("form", ["NFC", "NFD"])
@pytest.mark.parametrize("written", ["für mich/", "f%C3%BCr%20mich/"])
def test_names_may_be_escaped_and_accents_composed_otherwise(written, form):
    made = microwave()
    file = write_urdf(made, Path("oven/oven.urdf"))
    Path("oven/meshes").rename(f"oven/{unicodedata.normalize(form, 'für mich')}")
    file.write_text(file.read_text().replace("meshes/", written), encoding="utf-8")
    np.testing.assert_allclose(import_model(file, MICROWAVE).part_boxes(), made.part_boxes(), atol=1e-9)


def test_a_mesh_that_was_not_fetched_is_named():
    file = write_urdf(microwave(), Path("oven/oven.urdf"))
    for mesh in Path("oven/meshes").iterdir():
        mesh.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:12\nsize 34\n")
    with pytest.raises(InputError, match=r"\.obj: is only a pointer of Git LFS; run git lfs pull"):
        import_model(file, MICROWAVE)


def test_a_line_of_an_obj_may_end_in_a_comment():
    made = microwave()
    file = write_urdf(made, Path("oven/oven.urdf"))
    for mesh in Path("oven/meshes").glob("*.obj"):
        mesh.write_text("\n".join(f"{line} # as exported" for line in mesh.read_text().splitlines()))
    np.testing.assert_allclose(import_model(file, MICROWAVE).part_boxes(), made.part_boxes(), atol=1e-9)


def test_an_object_may_be_a_ros_package():
    for name in ("oven", "other"):
        write_urdf(microwave(), f"models/{name}/urdf/{name}.urdf")
        shutil.move(f"models/{name}/urdf/meshes", f"models/{name}/meshes")
        file = Path(f"models/{name}/urdf/{name}.urdf")
        file.write_text(file.read_text().replace("meshes/", f"package://{name}/meshes/"))
    assert import_folder(Path("models"), MICROWAVE, Path("ours")).used == ["other", "oven"]
