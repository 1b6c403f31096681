"""Tables of the docs, exchanged whole or by category; each page has the marks between which its command writes."""

import re
from pathlib import Path

import make_retrieval_tables
import make_robustness_table
import make_tables
import pytest
from make_tables import replaced

TEXT = "before\n<!-- sizes -->\n| category | size |\n|---|---|\n| laptop | 1 |\n| oven | 2 |\n<!-- end -->\nafter\n"


def test_a_table_is_exchanged_whole():
    assert replaced(TEXT, "sizes", ["| a |", "| b |"]) == "before\n<!-- sizes -->\n| a |\n| b |\n<!-- end -->\nafter\n"


def test_of_some_categories_only_their_rows_are():
    found = replaced(TEXT, "sizes", ["| category | size |", "| oven | 3 |", "| safe | 4 |"], ("oven", "safe"))
    assert found == TEXT.replace("| oven | 2 |", "| oven | 3 |\n| safe | 4 |")


@pytest.mark.parametrize(
    ("page", "names"),
    [
        (make_tables.README, {"accuracy"}),
        (make_tables.PAGE, {"procedural", "models"}),
        (make_tables.SURFACES, {"shares", "surfaces"}),
        (make_retrieval_tables.PAGE, {"table3"}),
        (make_robustness_table.PAGE, {"robustness"}),
    ],
    ids=lambda value: value.name if isinstance(value, Path) else "",
)
def test_pages_have_their_marks(page, names):
    assert names <= set(re.findall(r"^<!-- (\w+) -->$", page.read_text(encoding="utf-8"), re.MULTILINE))


def test_what_retrieval_says_is_a_table():
    shares = dict.fromkeys((*make_retrieval_tables.SHARES, "map_at_10_std"), 0.5)
    method = {"objects": 5, "paper": None, **shares, "chance": shares}
    answer = {"omad": method | {"large": method, "across_states": method}}
    head, _, row, chance = make_retrieval_tables.table({"laptop": answer}, 50)
    assert head.count("|") == row.count("|") == chance.count("|")
    assert "50.0 ± 50.0" in row


def test_values_of_joints_stand_for_all_or_for_each():
    assert make_tables.each(["1", "1", "1"]) == "1"
    assert make_tables.each(["1", "2", "1"]) == "1; 2; 1"


def test_how_far_answers_go_is_told_as_the_weights_have_it():
    text = make_tables.SURFACES.read_text(encoding="utf-8")
    assert replaced(text, "shares", make_tables.shares_table()) == text
