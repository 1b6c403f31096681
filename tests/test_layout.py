"""The package reads top to bottom: a module imports only from modules above it, and files stay short."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import omad

ROOT = Path(omad.__file__).parent
REPOSITORY = ROOT.parents[1]
ORDER = [
    "errors",
    "ancsh",
    "experiments",
    "explore",
    "exports",
    "figures",
    "retrieval",
    "tracking",
    "arrays",
    "geometry",
    "kinematics",
    "categories",
    "camera",
    "distortion",
    "files",
    "camera_files",
    "objects",
    "urdf",
    "depth_noise",
    "segmentation",
    "observation",
    "registration",
    "viewpoints",
    "directions",
    "rest_states",
    "spec_file",
    "alignment",
    "sources.links",
    "sources.partnet",
    "sources.folder",
    "sources.procedural.shapes",
    "sources.procedural.laptop",
    "sources.procedural.eyeglasses",
    "sources.procedural.dishwasher",
    "sources.procedural.scissors",
    "sources.procedural.drawer",
    "sources.procedural",
    "render",
    "standard_views",
    "view_folder",
    "sources.artimage.layout",
    "sources.artimage.joints",
    "sources.artimage.objects",
    "sources.artimage.annotations",
    "sources.artimage.images",
    "sources.artimage.writer",
    "sources.artimage.check",
    "sources.artimage",
    "sources.select",
    "views",
    "losses",
    "pointnet2",
    "prior",
    "priornet",
    "omadnet",
    "least_squares",
    "keypoint_jacobian",
    "small_matrices",
    "prior_kernel",
    "refinement_kernel",
    "refinement",
    "refinement_loss",
    "adam_recipe",
    "known",
    "runtime",
    "training",
    "ancsh.coordinates",
    "ancsh.net",
    "ancsh.losses",
    "ancsh.similarity",
    "ancsh.votes",
    "ancsh.chain",
    "ancsh.alignment",
    "retrieval.siamese",
    "checkpoint",
    "train_prior",
    "train_net",
    "ancsh.training",
    "retrieval.siamese_training",
    "retrieval.siamese_encoder",
    "metrics",
    "estimate",
    "estimator",
    "world",
    "evidence",
    "auto_category",
    "checklist",
    "ancsh.estimator",
    "tracking.motion",
    "tracking.shape_belief",
    "tracking.tracker",
    "tracking.summary",
    "tracking.synthetic",
    "report",
    "exports.surfaces",
    "exports.gltf",
    "exports.robot",
    "exports.ros",
    "exports.recording",
    "exports.formats",
    "tracking.pictures",
    "html_report",
    "contact_sheet",
    "retrieval.search",
    "retrieval.approximate",
    "retrieval.signature",
    "retrieval.index",
    "retrieval.picture",
    "retrieval.catalogue",
    "retrieval.metrics",
    "importing",
    "evaluation",
    "object_prior",
    "experiments.paper",
    "experiments.box_iou",
    "experiments.predictions",
    "experiments.released",
    "experiments.table1",
    "experiments.true_keypoints",
    "experiments.variants",
    "experiments.ablation",
    "retrieval.paper",
    "retrieval.shards",
    "retrieval.pool",
    "retrieval.distances",
    "retrieval.experiment",
    "keypoint_check",
    "figures.style",
    "figures.scene",
    "figures.seen",
    "figures.qualitative",
    "figures.correspondence",
    "figures.sweep",
    "figures.occluders",
    "figures.occlusion",
    "figures.tsne",
    "view_check",
    "demo",
    "tables",
    "inputs",
    "explore.drawing",
    "explore.fitting",
    "explore.scene",
    "explore.page",
    "tracking.frames",
    "options",
    "commands",
    "commands_estimate",
    "commands_import",
    "commands_train",
    "commands_eval",
    "commands_tables",
    "commands_retrieval",
    "commands_track",
    "commands_explore",
    "commands_figures",
    "cli",
    "__main__",
]


def modules() -> dict[str, Path]:
    found = {}
    for path in ROOT.rglob("*.py"):
        parts = path.relative_to(ROOT).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        if name and name != "sources":
            found[name] = path
    return found


def imports(name: str, path: Path) -> set[str]:
    """Modules of the package that a module imports."""
    package = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.level:
            base = package[: len(package) - node.level + 1]
            target = base + (node.module.split(".") if node.module else [])
            if node.module:
                found.add(".".join(target))
            else:
                found |= {".".join([*target, alias.name]) for alias in node.names}
    return found - {"__version__", ""}


def test_every_module_has_its_place():
    assert sorted(modules()) == sorted(ORDER)


@pytest.mark.parametrize("name", ORDER)
def test_imports_point_upwards(name):
    above = set(ORDER[: ORDER.index(name)])
    wrong = {other for other in imports(name, modules()[name]) if other in ORDER and other not in above}
    assert not wrong, f"{name} imports {wrong}, which stand below it"


def test_files_stay_short():
    long = {path.name: n for path in modules().values() if (n := len(path.read_text().splitlines())) > 400}
    assert not long


def test_no_code_asks_for_a_category_by_name():
    names = ("laptop", "dishwasher", "drawer")
    allowed = {"categories", "sources.procedural"} | {f"sources.procedural.{name}" for name in names}
    for name, path in modules().items():
        if name in allowed:
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Compare):
                values = [v.value for v in ast.walk(node) if isinstance(v, ast.Constant)]
                assert not set(values) & set(names), f"{path.name}:{node.lineno}"


def test_style_is_clean():
    for command in (["check"], ["format", "--check"]):
        done = subprocess.run(
            [sys.executable, "-m", "ruff", *command, "src", "tests", "benchmarks"],
            cwd=REPOSITORY, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout
