"""The paper's own figures (Table 3, ArtImage), as printed, as shares."""

from __future__ import annotations

from dataclasses import dataclass


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
