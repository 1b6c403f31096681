"""``omad bulk --cluster``: shards of depth images to rows of numbers."""

from dataclasses import dataclass
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

from omad.common.errors import InputError
from omad.estimation.estimator import Estimator, EstimatorConfig
from omad.sensing.input_options import FrameOptions, InputOptions

from ..bulk.results import row, row_schema
from ..bulk.sources import Source, open_sources
from ..bulk.stream import estimate_stream


@dataclass(frozen=True)
class BulkWork:
    """Estimates of the images of ``omad bulk``."""

    inputs: tuple[Path, ...]
    """Reached by every machine: on a disk that they share, or addresses of Parquet files."""
    reading: InputOptions
    frame: FrameOptions
    weights: str | Path
    device: str
    fast: bool
    batch: int

    def __call__(self, start: int, stop: int) -> list[dict[str, Any]]:
        """Rows of the images from ``start`` to before ``stop``."""
        source, estimator = _loaded(self)
        frames = islice(source.after(start), stop - start)
        return [row(outcome) for outcome in estimate_stream(estimator, frames, 1, self.batch)]

    def schema(self) -> Any:
        """pyarrow.Schema of the rows."""
        return row_schema()

    def refused(self, row: dict[str, Any]) -> bool:
        """Whether a row only tells why there is no answer."""
        return row["refused"] is not None

    def open(self) -> Source:
        """The images. Raises InputError."""
        return open_sources(self.inputs, self.reading, self.frame)


@cache
def _loaded(work: BulkWork) -> tuple[Source, Estimator]:
    """Once a process."""
    config = EstimatorConfig.fast() if work.fast else None
    source, estimator = work.open(), Estimator.from_pretrained(work.weights, work.device, config)
    if not source.total:
        raise InputError(f"{work.inputs[0]}: holds no image; give depth images")
    return source, estimator
