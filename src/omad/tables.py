"""Answers of commands as a person reads them: tables for results, plain lines for the rest."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np


def readable(answer: dict[str, Any]) -> str:
    """Text for one command's JSON object."""
    if "results" in answer and answer["results"] and "truth" in answer["results"][0]:
        return demo_table(answer)
    if "comparison" in answer:
        return table1_text(answer)
    if answer.get("table") == "2" or "ablation" in answer:
        return experiment_text(answer)
    if "ranking" in answer:
        return ranking_text(answer)
    if answer and all(isinstance(found, dict) and "omad_initial" in found for found in answer.values()):
        return retrieval_text(answer)
    if "by_object" in answer:
        return pose_table(answer)
    if "joints" in answer:
        return joint_table(answer["joints"])
    if "picture" in answer and "refused" in answer:
        return import_text(answer)
    if "refused" in answer and "results" in answer:
        return estimate_table(answer["results"])
    return "\n".join(f"{key}: {_plain(value)}" for key, value in answer.items())


def demo_table(answer: dict[str, Any]) -> str:
    """Estimate against truth, a line a joint."""
    rows = [["object", "joint", "estimate", "truth", "axis error", "axis distance", "base rotation error"]]
    for result in answer["results"]:
        errors = result["errors"]
        for j, joint in enumerate(result["estimate"]["joints"]):
            turns = joint["type"] == "revolute"
            distance = errors["axis_distance"][j]
            rows.append(
                [
                    result["object"],
                    joint["name"],
                    _state(joint["state"], turns) + " ± " + _state(joint["state_std"], turns),
                    _state(result["truth"]["joint_states"][j], turns),
                    f"{errors['axis_deg'][j]:.1f}°",
                    "-" if distance is None else f"{1000 * distance:.0f} mm",
                    f"{errors['rotation_deg'][0]:.1f}°",
                ]
            )
    pictures = [file for file in answer["files"] if file.endswith(".png")]
    return "\n".join([table(rows), "", "pictures:", *pictures])


def joint_table(joints: list[dict[str, Any]]) -> str:
    """What ``estimate`` found, a line a joint."""
    rows = [["joint", "state", "limits", "travel", "axis", "pivot (m)"]]
    for joint in joints:
        turns = joint["type"] == "revolute"
        rows.append(
            [
                joint["name"],
                _state(joint["state"], turns) + " ± " + _state(joint["state_std"], turns),
                " to ".join(_state(limit, turns) for limit in joint["limits"]),
                f"{joint['fraction']:.0%}" if joint["fraction"] is not None else "-",
                _vector(joint["axis"]),
                "-" if joint["pivot"] is None else _vector(joint["pivot"]),
            ]
        )
    return table(rows)


def estimate_table(results: list[dict[str, Any]]) -> str:
    """What ``estimate`` found in many inputs, a line a joint."""
    rows = [["input", "joint", "state", "travel", "converged"]]
    for result in results:
        for joint in result["joints"]:
            turns = joint["type"] == "revolute"
            state = _state(joint["state"], turns) + " ± " + _state(joint["state_std"], turns)
            share = "-" if joint["fraction"] is None else f"{joint['fraction']:.0%}"
            rows.append([result["input"], joint["name"], state, share, "yes" if result["converged"] else "no"])
    return table(rows)


def import_text(answer: dict[str, Any]) -> str:
    """What became of a folder of models."""
    lines = [f"{answer['category']}: {len(answer['used'])} of {answer['models']} models -> {answer['folder']}"]
    lines += [f"{count} refused: {reason}" for reason, count in answer["reasons"].items()]
    lines += [f"  {refusal['name']}: {refusal['reason']}" for refusal in answer["refused"]]
    lines += [f"note on {note['name']}: {note['reason']}" for note in answer["notes"]]
    if answer["picture"]:
        lines.append(f"see whether they stand alike: {answer['picture']}")
    return "\n".join(lines)


def pose_table(answer: dict[str, Any]) -> str:
    """Errors of ``eval pose``: initial, refined, refined by object; mean, median and 90th percentile."""
    unit = answer["metres_per_unit"]
    rows = [
        [
            "",
            "joint state",
            "axis angle",
            "axis distance (units)",
            "base rotation",
            "within 5° 5 %",
            "flipped",
            "swapped",
        ]
    ]

    def add(label: str, errors: dict[str, Any]) -> None:
        states = [
            _spread(d, 1, "°") if d else _spread(length, 1 / unit, " u")
            for d, length in zip(errors["joint_state_error_deg"], errors["joint_state_error"], strict=True)
        ]
        rows.append(
            [
                label,
                ", ".join(states),
                ", ".join(_spread(e, 1, "°") for e in errors["axis_error_deg"]),
                ", ".join("-" if e is None else _spread(e, 1 / unit, "") for e in errors["axis_distance"]),
                _spread(errors["rotation_error_deg"][0], 1, "°"),
                *(f"{errors[share]:.1%}" for share in ("within_5deg_5percent", "flipped", "swapped")),
            ]
        )

    add("initial", answer["initial"])
    add("refined", answer["refined"])
    if answer["objects"] <= 10:
        for entry in answer["by_object"]:
            add("  " + entry["object"], entry["refined"])
    seconds = {key: "-" if value is None else f"{1000 * value:.1f} ms" for key, value in answer["seconds"].items()}
    head = f"{answer['category']}, {answer['source']}: {answer['views']} views of {answer['objects']} objects"
    lines = [head + ", mean / median / 90th percentile", table(rows)]
    lines.append(
        f"failures {answer['failures']}; per image: network {seconds['network']}, refinement {seconds['refinement']}"
    )
    lines += [f"refused {r['name']}: {r['reason']}" for r in answer.get("refused", [])]
    return "\n".join(lines)


def table1_text(answer: dict[str, Any]) -> str:
    """The paper's Table 1, the paper's own figures under ours."""
    lines = [experiment_text(answer)]
    for name, found in answer["comparison"].items():
        if found:
            times = (f"{found[key]:.1f}" for key in ("alignment_over_refinement", "end_to_end") if found[key])
            lines.append(f"{name}: A-NCSH takes (alignment, end to end) {', '.join(times)} times as long")
    return "\n".join(lines)


def experiment_text(answer: dict[str, Any]) -> str:
    """Methods on the same views, a line each; the paper's own figures under ours where it has some."""
    head = ["category", "method", "joint state (°, u)", "axis (°)", "axis distance (u)", "rotation (°)", "IoU"]
    rows = [[*head, "missing", "time (ms)"]]
    for line in answer["rows"]:
        seconds, paper = line["seconds"]["total"], line.get("paper")
        state_digits = 3 if None in line["axis_distance"] else 1  # lengths, or degrees
        rows.append(
            [
                line["category"],
                line["method"],
                _numbers(line["joint_state"], state_digits),
                _numbers(line["axis_error_deg"], 1),
                _numbers(line["axis_distance"], 3),
                _numbers(line["rotation_error_deg"], 1),
                _numbers(line["iou"], 2),
                str(line["missing"]),
                "-" if seconds is None else f"{1000 * seconds:.1f}",
            ]
        )
        if paper:
            digits = {"joint_state": state_digits, "axis_deg": 1, "axis_distance": 3}
            figures = (_numbers(paper[key], count) for key, count in digits.items())
            time = f"{1000 * paper['seconds']:.0f}" if "seconds" in paper else "-"
            rows.append(["", "  in the paper", *figures, "-", "-", "-", time])
    machines = sorted({line["seconds"]["machine"] for line in answer["rows"]})
    source = answer.get("source", "procedural")
    lines = [f"{source}, means; time of one image at a time on {' and '.join(machines)}", table(rows)]
    if "ablation" in answer:
        lines.append(f"trained on {answer['samples']} views each; shipped: the weights of the package")
    lines += [f"left out {r['category']} {r['method']}: {r['reason']}" for r in answer.get("left_out", [])]
    lines += [f"not trained yet: {name}" for name in answer.get("not_trained", [])]
    return "\n".join(lines)


def ranking_text(answer: dict[str, Any]) -> str:
    """What ``index query`` found, a line an object."""
    rows = [["", "object", "distance", "source"]]
    for number, found in enumerate(answer["ranking"], 1):
        rows.append([str(number), found["object"], f"{found['distance']:.4g} {answer['unit']}", found["source"]])
    return "\n".join([table(rows), f"picture: {answer['picture']}", *answer["warnings"]])


def retrieval_text(answer: dict[str, Any]) -> str:
    """The paper's Table 3, per cent; the chance level beside it."""
    rows = [["category", "method", "mAP@10", "NN", "1st tier", "2nd tier", "all objects", "across states", "paper"]]
    for category, methods in answer.items():
        lines = [(name, found, found["large"], found["across_states"]) for name, found in methods.items()]
        first = methods["omad"]
        lines.append(("chance", *(part["chance"] for part in (first, first["large"], first["across_states"]))))
        for name, found, large, across in lines:
            keys = ("map_at_10", "nearest_neighbour", "first_tier", "second_tier")
            shares = [*(found[key] for key in keys), large["map_at_10"], across["map_at_10"]]
            paper = found.get("paper")
            printed = "-" if paper is None else f"{100 * paper:.1f}"
            rows.append([category, name, *(f"{100 * share:.1f}" for share in shares), printed])
    return table(rows)


def table(rows: list[list[str]]) -> str:
    """Columns padded to the same width; the first row is the head."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    return "\n".join([lines[0], "  ".join("-" * width for width in widths), *lines[1:]])


def _spread(error: dict[str, float], factor: float, unit: str) -> str:
    digits = 1 if unit == "°" else 3
    return " / ".join(f"{factor * error[key]:.{digits}f}{unit}" for key in ("mean", "median", "p90"))


def _numbers(values: Sequence[float | None], digits: int) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in values if value is not None) or "-"


def _state(value: float | None, turns: bool) -> str:
    if value is None:
        return "-"
    return f"{np.degrees(value):.1f}°" if turns else f"{100 * value:.1f} cm"


def _vector(values: list[float]) -> str:
    return "(" + ", ".join(f"{value:.3f}" for value in values) + ")"


def _plain(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key}={inner}" for key, inner in value.items()) or "-"
    if isinstance(value, list):
        return ", ".join(f"{v:.3f}" if isinstance(v, float) else str(v) for v in value) or "-"
    return f"{value:.4f}" if isinstance(value, float) else str(value)
