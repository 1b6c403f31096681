"""Cutting a thing out of a cloud, by its two steps: planes of known place, and clusters against SciPy's."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from omad.data.rendering.depth_noise import ON, NoiseLevel
from omad.data.rendering.tabletop import Surroundings, Tabletop, draw_tabletop
from omad.sensing.cutting.cloud import Cloud
from omad.sensing.cutting.clusters import GAP, SPARSE, VOXEL, all_clusters, prominent_cluster
from omad.sensing.cutting.pieces import joined
from omad.sensing.cutting.segmentation import segment_on_plane, things_before_planes
from omad.sensing.observation import Observation


def clusters_by_scipy(points: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, float]:
    """``prominent_cluster`` of points (N, 3) in the plainest way."""
    size = VOXEL * np.median(np.linalg.norm(points, axis=1))
    cells, cell_of, count = np.unique(np.floor(points / size), axis=0, return_inverse=True, return_counts=True)
    cell_of = cell_of.ravel()
    dense = count >= SPARSE * np.median(count[cell_of])
    pairs = KDTree(cells).query_pairs(1.8, output_type="ndarray")
    pairs = pairs[dense[pairs].all(1)]
    links = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(cells), len(cells)))
    labels = connected_components(links, directed=False)[1]
    things = range(labels.max() + 1)
    extents = [np.ptp(cells[labels == thing], axis=0) for thing in things]
    counted = [(labels == thing)[cell_of] & dense[cell_of] for thing in things]
    weight = np.array(
        [
            weights[points_of].mean() * ((extent + 1) ** 2).sum() if points_of.any() else 0.0
            for points_of, extent in zip(counted, extents, strict=True)
        ]
    )
    best = int(weight.argmax())
    distance, _ = KDTree(cells[labels == best]).query(cells)
    near = np.unique(labels[dense & (distance < max(GAP * np.linalg.norm(extents[best]), 1.8))])
    others = np.delete(weight, near)
    return (np.isin(labels, near) & dense)[cell_of], others.max(initial=0.0) / weight[best]


@pytest.mark.parametrize("seed", range(12))
def test_clusters_are_those_of_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    centres = rng.normal(0, 0.4, (8, 3)) + (0, 0, 2)
    spread = rng.uniform(0.01, 0.2, 8)[:, None]
    blobs = [
        centre + s * rng.normal(size=(rng.integers(20, 900), 3)) for centre, s in zip(centres, spread, strict=True)
    ]
    points = np.concatenate(blobs).astype(np.float32)
    if seed % 2:
        points = rng.permutation(points)
    weights = rng.random(len(points))
    chosen, rival = prominent_cluster(np.ascontiguousarray(points.T), weights)
    expected, expected_rival = clusters_by_scipy(points, weights)
    assert np.array_equal(chosen, expected)
    assert rival == pytest.approx(expected_rival)


def scene(noise: float, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A ball over a floor before a wall, points (N, 3); which of the three (N,) each belongs to, and the two planes."""
    rng = np.random.default_rng(seed)
    ray = np.stack([*(v.ravel() for v in np.meshgrid(np.linspace(-0.5, 0.5, 200), np.linspace(-0.4, 0.4, 160)))], 1)
    ray = np.concatenate([ray, np.ones((len(ray), 1))], 1)
    planes = np.array([[0, -np.cos(0.5), -np.sin(0.5), -0.9], [np.sin(0.2), 0, -np.cos(0.2), -2.5]])
    with np.errstate(divide="ignore"):
        depths = planes[:, 3:] / (planes[:, :3] @ ray.T)
    depths[depths <= 0] = np.inf
    centre = np.array([0.05, -0.02, 1.5])  # the nearer root of |t ray - centre| = 0.2
    a, b = (ray**2).sum(1), ray @ centre
    root = b**2 - a * (centre @ centre - 0.04)
    ball = np.where(root > 0, (b - np.sqrt(np.maximum(root, 0))) / a, np.inf)
    depths = np.stack([*depths, ball])
    depth = depths.min(0)
    depth = depth + noise * depth**2 * rng.normal(size=depth.shape)
    return ray * depth[:, None], depths.argmin(0), planes


@pytest.mark.parametrize(("noise", "seed"), [(0.0, 0), (0.002, 0), (0.002, 1)])
def test_floor_and_wall_are_found_where_they_are(noise: float, seed: int) -> None:
    points, thing, planes = scene(noise, seed)
    found = segment_on_plane(points)
    assert len(found.planes) == 2
    for plane in planes:
        [same] = [other for other in found.planes if other[:3] @ plane[:3] > 0.9]
        assert np.degrees(np.arccos(min(same[:3] @ plane[:3], 1.0))) < 0.2
        assert same[3] == pytest.approx(plane[3], abs=0.005)
    ball = thing == 2
    assert (found.selected & ball).sum() / (found.selected | ball).sum() > 0.95
    assert found.rival < 0.1


def test_where_to_look_holds_for_the_thing_but_not_for_the_planes() -> None:
    points, thing, _ = scene(0.0, 0)
    inside = (thing == 2) & (points[:, 0] > 0)
    found = segment_on_plane(points, inside)
    assert len(found.planes) == 2
    assert not found.selected[~inside].any()
    assert found.selected[inside].mean() > 0.97


def test_noise_of_a_plane_is_no_thing_and_does_not_join_things() -> None:
    points, thing, _ = scene(0.002, 0)
    far = np.where(np.random.default_rng(0).random(len(points)) < 0.02, 0.97, 1.0)
    noisy = points * np.where(thing == 2, 1.0, far)[:, None]
    found = things_before_planes(noisy, 150)
    [ball] = found.clusters
    assert (thing[ball] == 2).mean() > 0.97
    assert len(found.planes) == 2
    assert 0.001 < found.lowest < 0.05


@pytest.mark.parametrize(
    ("across", "up", "plane", "one"),
    [
        (0.0, 0.3, (0, -1, 0, -1), True),
        (0.8, 0.3, (0, -1, 0, -1), False),  # beside it
        (0.0, 0.0, (0, -1, 0, -1), False),  # in the angle between its parts: both stand
        (0.0, 1.5, (0, -1, 0, -1), False),  # a lamp at the ceiling
        (0.0, 0.3, (0, 0, -1, -3), False),  # before a wall
    ],
)
def test_what_hangs_in_the_air_over_a_thing_is_a_piece_of_it(across, up, plane, one) -> None:
    blocks = np.random.default_rng(0).random((2, 500, 3))
    standing = blocks[0] * (0.6, 0.8, 0.6) + (-0.3, 0.2, 2.0)
    other = blocks[1] * (0.4, 0.3, 0.3) + (across - 0.2, 0.7 - up, 1.8)
    seen = Cloud.of(np.concatenate([other, standing]))
    things = joined(seen, [np.arange(500, 1000), np.arange(500)], np.array([plane], dtype=float))
    assert len(things) == 2 - one
    assert np.array_equal(np.sort(np.concatenate(things)), np.arange(1000))


def test_what_is_half_as_large_as_its_neighbour_is_a_thing_of_its_own() -> None:
    edge = np.stack(np.mgrid[:40, :40], -1).reshape(-1, 2) / 40 - 0.5
    large, half, small = (np.insert(size * edge, 2, 2.0, axis=1) for size in (0.8, 0.4, 0.2))
    seen = np.concatenate([large, half + (0.68, 0, 0), small + (-0.58, 0, 0)])
    assert [len(thing) for thing in all_clusters(seen.T.astype(np.float32), 50)] == [3200, 1600]


def test_of_a_neighbour_that_reaches_in_nothing_is_taken() -> None:
    rows, columns = (axis.ravel() for axis in np.mgrid[:120, :160])
    ray = np.stack([(columns - 79.5) / 160, (rows - 59.5) / 160, np.ones(len(rows))], 1)
    one = (np.abs(columns - 44) < 19) & (np.abs(rows - 60) < 25)
    other = (np.abs(columns - 84) < 19) & (np.abs(rows - 60) < 25)
    points = ray * np.where(one | other, 1.4, 2.0)[:, None]
    found = segment_on_plane(points, (columns > 20) & (columns < 80) & (rows > 30) & (rows < 90))
    assert not found.selected[other].any()
    assert found.selected[one].mean() > 0.99


def test_numbers_far_behind_everything_do_not_decide_what_is_a_plane() -> None:
    points, thing, _ = scene(0.0, 0)
    stray = np.random.default_rng(0).random(len(points)) < 0.05
    points = np.where(stray[:, None], points * (65.535 / points[:, 2:]), points)
    found = things_before_planes(points, 150)
    assert len(found.planes) == 2
    assert max((thing[cluster] == 2).sum() for cluster in found.clusters) > 0.9 * ((thing == 2) & ~stray).sum()


def things_found(drawn: Tabletop, share: float = 0.7) -> tuple[int, int, int]:
    """Objects of which a thing has that share in common, objects there are, and planes found."""
    seen = Observation.from_depth(drawn.depth, drawn.camera)
    found = things_before_planes(seen.points, 150)
    wanted = [placed.mask[tuple(seen.pixels.T[::-1])] for placed in drawn.objects if placed.to_be_found]
    shares = [
        max(np.count_nonzero(mask[thing]) / np.count_nonzero(mask | _of(thing, mask)) for thing in found.clusters)
        for mask in wanted
    ]
    return sum(one > share for one in shares), len(wanted), len(found.planes)


def _of(index: np.ndarray, like: np.ndarray) -> np.ndarray:
    mask = np.zeros_like(like)
    mask[index] = True
    return mask


def table_scene(seed: int, noise: NoiseLevel | None = None, around: Surroundings | None = None) -> Tabletop:
    return draw_tabletop(("laptop", "microwave"), (seed, 3), noise=noise, surroundings=around)


@pytest.mark.parametrize("noise", [None, ON])
@pytest.mark.parametrize("wall", [False, True])
def test_what_stands_on_a_table_over_a_floor_is_found(noise: NoiseLevel | None, wall: bool) -> None:
    found, there, planes = np.sum([things_found(table_scene(i, noise, Surroundings(True, wall))) for i in range(3)], 0)
    on_board, there_too, boards = np.sum([things_found(table_scene(i, noise)) for i in range(3)], 0)
    assert there == there_too
    assert found >= on_board - 1 >= 0.8 * there
    assert planes >= 2 * boards == 6


def test_however_far_the_floor_its_noise_joins_no_things() -> None:
    drawn = draw_tabletop(("dishwasher", "drawer"), (11022, 7), noise=ON, surroundings=Surroundings(wall=True))
    assert np.median(drawn.depth) > 10
    assert things_found(drawn) == (5, 5, 2)


@pytest.mark.parametrize("columns", [60, 150, 300])
def test_however_little_of_the_floor_is_seen(columns: int) -> None:
    over_floor, endless = table_scene(0, None, Surroundings(raised=True)), table_scene(0)
    depth = np.hstack([endless.depth[:, :-columns], over_floor.depth[:, -columns:]])
    found, there, planes = things_found(replace(endless, depth=depth))
    assert (found, planes) == (there, 2)


def test_faces_of_objects_are_no_tables() -> None:
    for kind, names in enumerate((("laptop", "suitcase"), ("dishwasher", "drawer"), ("microwave", "lidded_box"))):
        for i in range(2):
            drawn = draw_tabletop(names, (i, kind), noise=ON)
            assert things_found(drawn)[2] == 1
