"""The shipped categories, in the paper's order."""

from omad.objects.category_file import get_category

LAPTOP, EYEGLASSES, DISHWASHER, SCISSORS, DRAWER = ALL = tuple(
    get_category(name) for name in ("laptop", "eyeglasses", "dishwasher", "scissors", "drawer")
)
CATEGORIES = {category.name: category for category in ALL}
