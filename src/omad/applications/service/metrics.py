"""Counts of a service, in the text format of Prometheus (version 0.0.4)."""

from collections import Counter
from dataclasses import dataclass, field

BOUNDS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0)
"""Seconds, of the histogram."""


@dataclass
class Metrics:
    """What was answered since the start."""

    statuses: Counter[int] = field(default_factory=Counter)
    """Requests for estimates, by the status that they were answered with."""
    seconds: Counter[float] = field(default_factory=Counter)
    """Of answers: how many took up to each of ``BOUNDS``, and not to the one before."""
    total_seconds: float = 0.0

    def add(self, status: int, seconds: float) -> None:
        """One answer, and how long it took."""
        self.statuses[status] += 1
        self.seconds[next((bound for bound in BOUNDS if seconds <= bound), float("inf"))] += 1
        self.total_seconds += seconds

    def text(self, **gauges: float) -> str:
        """All of it, with further numbers by their names."""
        lines = ["# HELP omad_requests_total Requests for estimates, by status.", "# TYPE omad_requests_total counter"]
        lines += [f'omad_requests_total{{status="{s}"}} {n}' for s, n in sorted(self.statuses.items())]
        lines += ["# HELP omad_request_seconds From request to answer.", "# TYPE omad_request_seconds histogram"]
        count = 0
        for bound in (*BOUNDS, float("inf")):
            count += self.seconds[bound]
            name = "+Inf" if bound == float("inf") else f"{bound:g}"
            lines.append(f'omad_request_seconds_bucket{{le="{name}"}} {count}')
        lines += [f"omad_request_seconds_sum {self.total_seconds:.6f}", f"omad_request_seconds_count {count}"]
        for name, value in gauges.items():
            lines += [
                f"# TYPE omad_{name} {'counter' if name.endswith('_total') else 'gauge'}",
                f"omad_{name} {value}",
            ]
        return "\n".join(lines) + "\n"
