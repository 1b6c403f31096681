"""Random mailboxes, on a post or without one."""

import numpy as np

from omad.data.procedural.vocabulary import Case, JointedParts, box, fitted, handle, leaf, merge_meshes


def generate(rng, category, unusual):
    """One mailbox, shut: the body first, then the flap; metres, y up, the front at +z."""
    width = rng.uniform(0.2, 0.32)
    height, depth = width * rng.uniform(0.7, 1.4), width * rng.uniform(0.6, 1.5)
    wall = rng.uniform(0.003, 0.012)
    case = Case(width, height, depth, left=wall, right=wall, bottom=wall, top=wall * rng.uniform(1, 8), back=wall)
    thickness = rng.uniform(0.004, 0.015)

    flap, frame = fitted(rng, case.front, case.mouth, thickness, let_in=0.3)  # where it goes; perhaps with a frame
    body = [*case.walls(), *frame]
    if rng.random() < 0.4:
        post = rng.uniform(0.02, 0.04)
        body.append(box((-post, -rng.uniform(0.1, 0.3), -depth / 2 - post), (post, 0.0, -depth / 2 + post)))
    moving = leaf(rng, flap, 0.0005, thickness, windows=0.0, panels=0.3)
    moving += handle(rng, flap, thickness, "top", size=0.4)
    hinge = np.array([[0.0, flap.y0, thickness]])
    return JointedParts((merge_meshes(body), merge_meshes(moving)), hinge)
