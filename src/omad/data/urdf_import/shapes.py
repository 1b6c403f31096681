"""The shapes of a URDF's links: meshes in files, and simple solids."""

import io
import os
import re
import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TextIO
from urllib.parse import unquote

import numpy as np
import trimesh

from omad.common.errors import InputError
from omad.common.incoming import check_file, is_file, read_bytes, readable
from omad.common.limits import check_limit, limits
from omad.geometry.mesh import Mesh, merge_meshes

MissingMeshes = Literal["refuse", "skip"]
"""What to do about mesh files that a URDF names and that are not there."""
MESH_FORMATS = (".obj", ".stl", ".dae", ".ply", ".glb", ".gltf", ".off")
"""Others that trimesh knows unpack archives or start programs."""
PACKAGED = "urdf"
"""Folder of a ROS package, with meshes beside it, in which its URDF lies."""
GIT_LFS = b"version https://git-lfs"
"""How files begin that stand for others which were not fetched."""
LARGEST = 1e6
"""Of a coordinate, in the file's own unit."""
LONGEST_LINE = 2**20


@dataclass(frozen=True)
class MeshFiles:
    """Where the meshes of a URDF may lie. It may come from a stranger: files elsewhere are not for it to open."""

    urdf: Path
    missing: MissingMeshes = "refuse"
    folder: Path | None = None
    """With all that is in it, besides the URDF's own folder, or its ROS package."""
    skipped: list[str] = field(default_factory=list)
    """Names of those that were missing, where ``missing`` says to skip them."""
    empty: list[str] = field(default_factory=list)
    """Names of those without a triangle."""

    def find(self, filename: str) -> Path | None:
        """The file in one of these folders, with or without its package's name or the folders of another machine, in
        capitals or not, as Windows does not tell, and with what is escaped in addresses; None where it is in none."""
        beside = self.urdf.resolve().parent
        names = [name for written in dict.fromkeys((filename, unquote(filename))) for name in _names(written)]
        for as_on_disk in (lambda place, root: place, _any_case):
            for root in self._roots():
                within = [place for place in (beside, *beside.parents) if place.is_relative_to(root)]
                for place in (as_on_disk(place / each, root) for place in within or [root] for each in names):
                    if is_file(place) and (found := place.resolve()).is_relative_to(root):
                        return found
        return None

    def _roots(self) -> list[Path]:
        beside = self.urdf.resolve().parent
        usual = beside.parent if beside.name == PACKAGED else beside
        package = next((place for place in beside.parents if is_file(place / "package.xml")), usual)
        return [package] if self.folder is None else [package, self.folder.resolve()]


def _names(filename: str) -> list[Path]:
    """What a mesh may be called, likeliest first."""
    plain = re.sub(r"^((package|model)://|file:///(?=[A-Za-z]:)|file://)", "", filename).replace("\\", "/")
    name = Path(plain)
    if re.match("(package|model)://", filename):
        return [name, Path(*name.parts[1:])]
    elsewhere = name.is_absolute() or re.match("[A-Za-z]:/", plain)
    return [name, *(Path(*name.parts[start:]) for start in range(1, len(name.parts)))] if elsewhere else [name]


def _any_case(place: Path, root: Path) -> Path:
    """A path as it is written on the disk, as far as it lies in the folder ``root``."""
    found = Path(place.anchor)
    for part in place.parts[1:]:
        if (
            part != ".."
            and not os.path.lexists(found / part)
            and found.resolve().is_relative_to(root)
            and found.is_dir()
        ):
            part = next((each.name for each in found.iterdir() if _alike(each.name) == _alike(part)), part)
        found /= part
    return found


def _alike(name: str) -> str:
    """The same for names that differ in capitals, or in how accents are composed, as on a Mac."""
    return unicodedata.normalize("NFC", name).lower()


def link_mesh(link: Any, T_model_link: np.ndarray, files: MeshFiles) -> Mesh:
    """All shapes of a link in the model frame, in the file's units."""
    meshes = []
    for element in link.visuals or link.collisions:
        mesh = _shape(link.name, element.geometry, files)
        if mesh is not None:
            T = T_model_link if element.origin is None else T_model_link @ element.origin
            if not np.isfinite(T).all():
                raise InputError(
                    f"{files.urdf}: link {link.name!r} has a shape of no proper origin; give finite numbers"
                )
            meshes.append(mesh.carried(T))
    return merge_meshes(meshes)


def _shape(link: str, geometry: Any, files: MeshFiles) -> Mesh | None:
    make, owner = trimesh.creation, f"{files.urdf}: link {link!r}"
    if (box := geometry.box) is not None:
        return _as_mesh(make.box(extents=_sizes(box.size, 3, owner)))
    if (bar := geometry.cylinder) is not None:
        radius, height = _sizes([bar.radius, bar.length], 2, owner)
        return _as_mesh(make.cylinder(radius=radius, height=height))
    if (ball := geometry.sphere) is not None:
        [radius] = _sizes([ball.radius], 1, owner)
        return _as_mesh(make.icosphere(subdivisions=3, radius=radius))
    if geometry.mesh is None:
        raise InputError(f"{owner} has a geometry of no known shape; give a mesh, box, cylinder or sphere")
    file = files.find(geometry.mesh.filename or "")
    if file is None:
        if files.missing == "skip":
            files.skipped.append(geometry.mesh.filename)
            return None
        ways = "name the folder that it is in (--mesh-folder), or use what is there (--missing-meshes skip)"
        cure = f"restore it; or to omad import {ways}"
        raise InputError(f"{files.urdf}: mesh {geometry.mesh.filename!r} of link {link!r} is missing; {cure}")
    mesh, scale = _load_mesh(file), geometry.mesh.scale
    if not len(mesh.faces):
        files.empty.append(geometry.mesh.filename)
    scale = np.ones(3) if scale is None else np.broadcast_to(_numbers(scale, (1, 3), owner), 3)
    faces = mesh.faces[:, ::-1] if np.prod(scale) < 0 else mesh.faces
    return Mesh(mesh.vertices * scale, faces)


def _sizes(values: Any, count: int, owner: str) -> np.ndarray:
    found = _numbers(values, (count,), owner)
    if not (found > 0).all():
        raise InputError(f"{owner} has a shape of no size; give numbers above 0")
    return found


def _numbers(values: Any, counts: tuple[int, ...], owner: str) -> np.ndarray:
    try:
        found = np.asarray(values, dtype=np.float64).ravel()
    except (TypeError, ValueError):
        found = np.zeros(0)
    if len(found) not in counts or not (np.abs(found) <= LARGEST).all():
        raise InputError(f"{owner} has a shape that is not readable; give {counts[-1]} numbers for it")
    return found


def _as_mesh(solid: Any) -> Mesh:
    return Mesh(np.asarray(solid.vertices, np.float64), np.asarray(solid.faces, np.int64))


def _load_mesh(file: Path) -> Mesh:
    suffix = file.suffix.lower()
    if suffix not in MESH_FORMATS:
        raise InputError(f"{file}: unknown mesh format {suffix!r}; known ones are {', '.join(MESH_FORMATS)}")
    cure = "give a .glb, which has all in one file" if suffix == ".gltf" else "export it again"
    with readable(file, "a mesh", cure):
        check_file(file)
        with file.open("rb") as start:
            if start.read(len(GIT_LFS)) == GIT_LFS:
                raise InputError(f"{file}: is only a pointer of Git LFS; run git lfs pull where it comes from")
        if suffix == ".obj":
            check_limit("data_bytes", file.stat().st_size, f"{file}: the file")
            with file.open(encoding="utf-8", errors="replace") as lines:
                mesh = _parse_obj(lines, str(file))
        else:  # the content alone, so that no other file is opened which it names
            content = io.BytesIO(read_bytes(file))
            plain: dict[str, Any] = {"skip_materials": True} if suffix == ".ply" else {}  # its texture is elsewhere
            solid: Any = trimesh.load(content, file_type=suffix[1:], force="mesh", process=False, **plain)
            if suffix == ".dae":  # the one format that tells its unit, as RViz and Gazebo take it
                solid.convert_units("meters")
            mesh = _as_mesh(solid)
        mesh = Mesh(mesh.vertices.reshape(-1, 3), mesh.faces.reshape(-1, 3))
        check_limit("mesh_faces", max(len(mesh.faces), len(mesh.vertices)), f"{file}: the mesh")
        if mesh.faces.size and not 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.vertices):
            raise ValueError("a face names a vertex that is not there")
    if not (np.abs(mesh.vertices) <= LARGEST).all():
        raise InputError(f"{file}: has vertices that are not finite, or far too large; export it again")
    return mesh


def _parse_obj(lines: TextIO, name: str) -> Mesh:
    """Positions and triangles alone, in the file's order: texture coordinates and normals would split vertices."""
    vertices, faces, most = list[list[float]](), list[tuple[int, int, int]](), limits().mesh_faces
    for line in _whole_lines(lines):
        kind, *fields = line.partition("#")[0].split() or [""]
        if kind == "v":
            vertices.append([float(field) for field in fields[:3]])
        elif kind == "f":
            corners = [int(field.split("/")[0]) for field in fields]
            corners = [c - 1 if c > 0 else len(vertices) + c for c in corners]
            faces += [(corners[0], b, c) for b, c in zip(corners[1:-1], corners[2:], strict=True)]
        if max(len(vertices), len(faces)) > most:
            check_limit("mesh_faces", max(len(vertices), len(faces)), f"{name}: the mesh")
    return Mesh(np.array(vertices, np.float64), np.array(faces, np.int64))


def _whole_lines(lines: TextIO) -> Iterator[str]:
    """A line that ends in a backslash goes on in the next."""
    while line := lines.readline(LONGEST_LINE):
        while line.endswith("\\\n") and len(line) < LONGEST_LINE:
            line = line[:-2] + " " + lines.readline(LONGEST_LINE)
        if len(line) >= LONGEST_LINE:
            raise ValueError("a line without end")
        yield line
