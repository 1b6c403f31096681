"""The walks of CONTRIBUTING, done on a copy of the package: each touches the files that it names, and no others."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

import omad
from helpers.command_line import cloud

SOURCE = Path(omad.__file__).parent
GUIDE = Path(__file__).parents[2] / "CONTRIBUTING.md"
pytestmark = pytest.mark.slow


class Walk:
    """A copy of the package to change and run; as before in the end."""

    def __init__(self, root: Path, folder: Path) -> None:
        self.root, self.folder, self.touched = root, folder, set[str]()

    def undo(self) -> None:
        for path in self.touched:
            (self.root / path).unlink()
            if (SOURCE / path).exists():
                shutil.copy2(SOURCE / path, self.root / path)

    def write(self, path: str, text: str) -> None:
        """A new file."""
        assert not (self.root / path).exists()
        (self.root / path).write_text(text)
        self.touched.add(path)

    def change(self, path: str, **inserted: str) -> None:
        """Put ``after`` behind ``where``, an entry say."""
        text = (self.root / path).read_text()
        assert text.count(inserted["where"]) == 1, inserted["where"]
        (self.root / path).write_text(text.replace(inserted["where"], inserted["where"] + inserted["after"]))
        self.touched.add(path)

    def python(self, code: str) -> str:
        """What a program prints that uses the changed copy."""
        return self._run("-c", code)

    def omad(self, *lines: Sequence[str]) -> str:
        """What command lines print, one after the other in one program."""
        return self._run("-c", f"from omad.cli.main import run\nfor line in {lines}:\n    assert run(line) == 0, line")

    def _run(self, *words: str) -> str:
        environment = os.environ | {"PYTHONPATH": str(self.root.parent)}
        environment.pop("NUMBA_CACHE_DIR", None)  # what is compiled came with the copy
        done = subprocess.run(
            [sys.executable, *words], cwd=self.folder, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout


@pytest.fixture(scope="module")
def copy(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("walks") / "omad"
    shutil.copytree(SOURCE, root, ignore=shutil.ignore_patterns("weights"))
    for folder in SOURCE.glob("model/**/weights"):
        (root / folder.relative_to(SOURCE)).symlink_to(folder)
    return root


@pytest.fixture
def walk(copy, tmp_path) -> Iterator[Walk]:
    walk = Walk(copy, tmp_path)
    yield walk
    walk.undo()


def named(heading: str) -> str:
    """The text of one of the guide's walks, which is short."""
    text = re.search(rf"## {heading}\n(.*?)\n## ", GUIDE.read_text(), re.S)
    assert text
    assert len([line for line in text[1].splitlines() if line]) <= 10
    return text[1]


def test_a_category_is_its_spec_its_generator_and_its_weights(walk):
    walk.write(
        "objects/builtin/bin.toml",
        'name = "bin"\nmetres_per_unit = 0.3\nbasis_size = 4\n[[parts]]\nname = "body"\nkeypoints = 6\n'
        '[[parts]]\nname = "lid"\nkeypoints = 6\n'
        '[parts.joint]\ntype = "revolute"\naxis = "-x"\nlimits = [0, 90]\nreach = "+z"\nside = "+y"\n',
    )
    walk.write(
        "data/procedural/storage/bin.py",
        "import numpy as np\nfrom ..shapes import JointedParts, box\n\n\ndef generate(rng, category, unusual):\n"
        "    w, h = rng.uniform(0.1, 0.2), rng.uniform(0.3, 0.5)\n"
        "    body, lid = box((-w, 0, -w), (w, h, w)), box((-w, h, -w), (w, h + 0.03, w))\n"
        "    return JointedParts(parts=(body, lid), pivots=np.array([[0.0, h, -w]]))\n",
    )
    budget = ["--category", "bin", "--objects", "3", "--steps", "3", "--batch", "2", "--threads", "1"]
    said = walk.omad(
        ["train", "prior", *budget, "--output", "bin/prior"],
        ["train", "net", *budget, "--prior", "bin/prior", "--output", "bin"],
        ["eval", "pose", "--category", "bin", "--weights", "bin", "--views", "3", "--json"],
    )
    assert '"category": "bin"' in said
    assert walk.touched == {"objects/builtin/bin.toml", "data/procedural/storage/bin.py"}
    for file in ("objects/builtin/NAME.toml", "data/procedural/GROUP/NAME.py", "model/weights/NAME"):
        assert file in named("A category")


def test_a_joint_type_is_one_file(walk):
    room = "geometry/joint_kinds.py"
    text = (walk.root / room).read_text()
    text = text.replace('"prismatic", "screw"]', '"prismatic", "screw", "geared"]')
    hinge, name = '    return REVOLUTE if type == "revolute"', '    return "screw" if motion.slide'
    text = text.replace(hinge, f'    if type == "geared":\n        return Motion(2.0, 0.0)\n{hinge}')
    text = text.replace(name, f'    if motion.turn == 2:\n        return "geared"\n{name}')
    (walk.root / room).write_text(text)
    walk.touched.add(room)
    spec = (SOURCE / "objects" / "builtin" / "laptop.toml").read_text()
    spec = spec.replace('"laptop"', '"geared_laptop"').replace('"revolute"', '"geared"')
    (walk.folder / "geared.toml").write_text(spec)
    said = walk.python(
        "import omad, numpy as np, torch\n"
        "from omad.geometry.kinematics import joint_transforms\n"
        "category = omad.get_category('geared.toml')\n"
        "one = lambda *v: torch.tensor([[v]], dtype=torch.float64)\n"
        "T = joint_transforms(category.tree, one(1, 0, 0), one(0, 0, 0), torch.tensor([[0.3]], dtype=torch.float64))\n"
        "print(category.joints[0].type, float(torch.atan2(T[0, 0, 2, 1], T[0, 0, 1, 1])))"
    )
    assert said.split()[0] == "geared"
    assert float(said.split()[1]) == pytest.approx(0.6)
    assert room in named("A joint type")


def test_a_loss_is_a_function_and_a_term(walk):
    losses, training = "training/losses.py", "training/train_net.py"
    text = (walk.root / losses).read_text()
    (walk.root / losses).write_text(
        text + "\n\ndef height_loss(keypoints):\n    return keypoints[..., 1].square().mean()\n"
    )
    walk.touched.add(losses)
    walk.change(training, where="    beta: float = 0.01\n", after="    height: float = 0.5\n")
    walk.change(
        training,
        where='        "beta": out.beta.square().mean(),\n',
        after='        "height": losses.height_loss(out.keypoints),\n',
    )
    walk.change(training, where="\nimport torch\n", after="from . import losses\n")
    budget = ["--objects", "2", "--steps", "50", "--batch", "2", "--threads", "1", "--output", "net"]
    walk.omad(["train", "net", "--category", "laptop", *budget])
    assert "height" in next((walk.folder / "net").glob("metrics*")).read_text()
    assert walk.touched == {losses, training}
    assert all(file in named("A loss") for file in walk.touched)


def test_a_backbone_is_a_file_and_an_entry(walk):
    new, table = "model/backbones/mean.py", "model/backbones/__init__.py"
    walk.write(
        new,
        "from dataclasses import dataclass\nfrom torch import nn\n"
        "from .interface import Backbone, BackboneConfig, Features\n\n\n"
        "@dataclass(frozen=True)\nclass MeanConfig(BackboneConfig):\n    kind = 'mean'\n    points: int = 64\n"
        "    @property\n    def pooled(self):\n        return self.dense\n"
        "    def build(self):\n        return Mean(self)\n\n\n"
        "class Mean(Backbone):\n    def __init__(self, config):\n        super().__init__()\n"
        "        self.config, self.layer = config, nn.Linear(3, config.dense)\n"
        "    def forward(self, points):\n        dense = self.layer(points)\n"
        "        return Features(centres=points, dense=dense, pooled=dense.mean(1))\n",
    )
    walk.change(table, where="from .pointnet2 import PointNet2Config\n", after="from .mean import MeanConfig\n")
    walk.change(table, where="BACKBONES: dict[str, BackboneConfig] = {\n", after='    "mean": MeanConfig(),\n')
    budget = ["--objects", "2", "--steps", "2", "--batch", "2", "--threads", "1", "--size", "mean", "--output", "net"]
    walk.omad(
        ["train", "net", "--category", "laptop", *budget],
        ["eval", "pose", "--category", "laptop", "--weights", "net", "--views", "2"],
    )
    assert walk.touched == {new, table}
    assert "model/backbones/NAME.py" in named("A backbone")
    assert table in named("A backbone")


def test_a_data_source_is_a_file_and_an_entry(walk):
    new, table = "data/cubes.py", "data/source.py"
    walk.write(
        new,
        "from .procedural import generate\n\n\ndef is_cubes(source):\n    return source == 'cubes'\n\n\n"
        "def cubes(category, count):\n    return [generate(category, index, 'test', 7) for index in range(count)]\n",
    )
    walk.change(
        table, where="from .rendering.depth_noise import LEVELS\n", after="from .cubes import cubes, is_cubes\n"
    )
    entry = "SourceKind(is_cubes, models=lambda s, category, n, *_: ModelSource(cubes(category, n)))"
    walk.change(table, where="KINDS: dict[str, SourceKind] = {\n", after=f'    "cubes": {entry},\n')
    few = ["--objects", "1", "--views", "1"]
    walk.omad(["render", "--category", "laptop", "--source", "cubes", *few, "--output", "v"])
    assert (walk.folder / "v" / "dataset.json").is_file()
    assert walk.touched == {new, table}
    assert "data/NAME.py" in named("A data source")
    assert table in named("A data source")


def test_an_export_format_is_a_file_and_an_entry(walk):
    new, table = "output/csv.py", "output/formats.py"
    walk.write(
        new,
        "from omad.common.files import write_text\n\n\ndef save_csv(estimate, path):\n"
        "    write_text(path, '\\n'.join(','.join(map(str, point)) for point in estimate.keypoints))\n",
    )
    walk.change(table, where="from .gltf import save_glb\n", after="from .csv import save_csv\n")
    entry = 'lambda export, folder: save_csv(export.estimate, folder / "keypoints.csv")'
    where = "FORMATS: dict[str, Callable[[Export, Path], object]] = {\n"
    walk.change(table, where=where, after=f'    "csv": {entry},\n')
    np.save(walk.folder / "cloud.npy", cloud())
    walk.omad(["estimate", "cloud.npy", "--category", "laptop", "--formats", "csv"])
    assert len((walk.folder / "omad-estimate" / "cloud" / "keypoints.csv").read_text().splitlines()) == 24
    assert walk.touched == {new, table}
    assert "output/NAME.py" in named("An export format")
    assert table in named("An export format")
