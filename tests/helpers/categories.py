"""The shipped categories."""

from omad.objects.builtin import builtin_names
from omad.objects.category_file import get_category

LAPTOP, EYEGLASSES, DISHWASHER, SCISSORS, DRAWER = ALL = tuple(
    get_category(name) for name in ("laptop", "eyeglasses", "dishwasher", "scissors", "drawer")
)
CATEGORIES = {category.name: category for category in ALL}
"""The paper's, in its order."""
EVERY = {name: get_category(name) for name in builtin_names()}
