"""The paper's own figures (Tables 1 to 3, ArtImage), as printed: degrees, category units, seconds an image, shares."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PaperAblation:
    """One line of the paper's Table 2; a number per joint."""

    joint_state: tuple[float, ...]
    """Degrees, or category units where the state is a length."""
    axis_deg: tuple[float, ...]
    axis_distance: tuple[float, ...]
    """Category units; empty where axes have no place."""


@dataclass(frozen=True)
class PaperRow(PaperAblation):
    """One line of the paper's Table 1."""

    seconds: float


TABLE1: dict[str, dict[str, PaperRow]] = {
    "laptop": {
        "ancsh": PaperRow((3.5,), (1.7,), (0.09,), 9.0),
        "omad_initial": PaperRow((5.9,), (19.5,), (0.14,), 0.4),
        "omad_refined": PaperRow((3.3,), (3.7,), (0.03,), 1.6),
    },
    "eyeglasses": {
        "ancsh": PaperRow((12.8, 14.2), (3.1, 3.1), (0.07, 0.06), 11.9),
        "omad_initial": PaperRow((19.1, 19.4), (17.3, 17.3), (0.18, 0.17), 0.7),
        "omad_refined": PaperRow((4.9, 5.2), (4.2, 4.6), (0.05, 0.04), 2.5),
    },
    "dishwasher": {
        "ancsh": PaperRow((3.8,), (6.1,), (0.11,), 5.5),
        "omad_initial": PaperRow((17.6,), (15.7,), (0.17,), 0.6),
        "omad_refined": PaperRow((3.7,), (4.6,), (0.09,), 1.6),
    },
    "scissors": {
        "ancsh": PaperRow((4.4,), (0.8,), (0.04,), 6.5),
        "omad_initial": PaperRow((5.8,), (18.7,), (0.14,), 0.7),
        "omad_refined": PaperRow((3.2,), (2.7,), (0.05,), 1.7),
    },
    "drawer": {
        "ancsh": PaperRow((0.38, 0.45, 0.41), (2.6, 2.7, 5.2), (), 16.5),
        "omad_initial": PaperRow((0.18, 0.17, 0.18), (15.2, 15.2, 15.2), (), 1.0),
        "omad_refined": PaperRow((0.11, 0.11, 0.09), (3.2, 3.2, 3.2), (), 1.9),
    },
}
"""By category and method; a category of one's own has none."""

TABLE2: dict[str, dict[str, PaperAblation]] = {
    "laptop": {
        "no attention": PaperAblation((4.7,), (5.4,), (0.04,)),
        "attention": PaperAblation((3.3,), (3.7,), (0.03,)),
        "true keypoints": PaperAblation((1.1,), (0.8,), (0.01,)),
    },
    "eyeglasses": {
        "no attention": PaperAblation((9.8, 11.2), (9.2, 9.2), (0.10, 0.09)),
        "attention": PaperAblation((4.9, 5.2), (4.2, 4.6), (0.05, 0.04)),
        "true keypoints": PaperAblation((1.1, 1.2), (1.2, 2.1), (0.02, 0.01)),
    },
    "dishwasher": {
        "no attention": PaperAblation((5.0,), (5.8,), (0.10,)),
        "attention": PaperAblation((3.7,), (4.6,), (0.09,)),
        "true keypoints": PaperAblation((0.4,), (0.4,), (0.02,)),
    },
    "scissors": {
        "no attention": PaperAblation((3.9,), (3.9,), (0.05,)),
        "attention": PaperAblation((3.2,), (2.7,), (0.05,)),
        "true keypoints": PaperAblation((0.4,), (1.8,), (0.01,)),
    },
    "drawer": {
        "no attention": PaperAblation((0.173, 0.187, 0.181), (15.2, 15.2, 15.2), ()),
        "attention": PaperAblation((0.110, 0.114, 0.093), (3.2, 3.2, 3.2), ()),
        "true keypoints": PaperAblation((0.001, 0.001, 0.003), (0.5, 0.5, 0.5), ()),
    },
}
"""By category and what keypoints the refinement is given."""


@dataclass(frozen=True)
class PaperRetrieval:
    """One column of the paper's Table 3: mAP."""

    objects: int
    """Test objects, which make the gallery."""
    omad: float
    siamese: float


TABLE3: dict[str, PaperRetrieval] = {
    "laptop": PaperRetrieval(5, 0.452, 0.439),
    "eyeglasses": PaperRetrieval(6, 0.935, 0.962),
    "dishwasher": PaperRetrieval(4, 0.777, 0.757),
    "scissors": PaperRetrieval(4, 0.985, 0.968),
    "drawer": PaperRetrieval(3, 0.967, 0.736),
}
"""By category; a category of one's own has none."""
USUAL_OBJECTS = 5
"""In a gallery of such a category."""
